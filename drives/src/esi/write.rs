//! Writing a file.

use super::{Device, Esi, Module, Pdo, Slot};
use std::fmt::Write as _;

/// A text as it stands between tags; what XML does not take is left out.
fn escaped(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for char in text.chars() {
        match char {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            char if char.is_control() || matches!(char, '\u{fffe}' | '\u{ffff}') => {}
            char => escaped.push(char),
        }
    }
    escaped
}

/// Lines of a file, indented by depth.
struct Lines {
    text: String,
    depth: usize,
}

impl Lines {
    fn line(&mut self, line: &str) {
        // Writing to a string does not fail.
        let _ = writeln!(self.text, "{:1$}{line}", "", 2 * self.depth);
    }

    fn inside(&mut self, start: &str, name: &str, body: impl FnOnce(&mut Self)) {
        self.line(&format!("<{start}>"));
        self.depth += 1;
        body(self);
        self.depth -= 1;
        self.line(&format!("</{name}>"));
    }

    fn element(&mut self, name: &str, content: impl std::fmt::Display) {
        self.line(&format!("<{name}>{}</{name}>", escaped(&content.to_string())));
    }
}

impl Esi {
    /// The file, as [`Esi::read`] reads it.
    pub fn write(&self) -> String {
        let mut lines = Lines { text: "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n".to_owned(), depth: 0 };
        lines.inside("EtherCATInfo", "EtherCATInfo", |lines| {
            lines.inside("Vendor", "Vendor", |lines| {
                lines.element("Id", format_args!("#x{:08X}", self.vendor_id));
                lines.element("Name", &self.vendor);
            });
            lines.inside("Descriptions", "Descriptions", |lines| {
                lines.inside("Groups", "Groups", |lines| {
                    let mut groups: Vec<&str> = self.devices.iter().map(|device| device.group.as_str()).collect();
                    groups.sort_unstable();
                    groups.dedup();
                    for group in groups {
                        lines.inside("Group", "Group", |lines| {
                            lines.element("Type", group);
                            lines.element("Name", group);
                        });
                    }
                });
                lines.inside("Devices", "Devices", |lines| self.devices.iter().for_each(|device| write(lines, device)));
                if !self.modules.is_empty() {
                    lines.inside("Modules", "Modules", |lines| {
                        self.modules.iter().for_each(|module| write_module(lines, module));
                    });
                }
            });
        });
        lines.text
    }
}

fn write(lines: &mut Lines, device: &Device) {
    lines.inside(&format!("Device Physics=\"{}\"", escaped(&device.physics)), "Device", |lines| {
        let (product, revision) = (device.product_code, device.revision);
        let kind = escaped(&device.type_name);
        lines.line(&format!("<Type ProductCode=\"#x{product:08X}\" RevisionNo=\"#x{revision:08X}\">{kind}</Type>"));
        lines.element("Name", &device.name);
        info(lines, device);
        lines.element("GroupType", &device.group);
        if let Some(profile) = device.profile {
            lines.inside("Profile", "Profile", |lines| lines.element("ProfileNo", profile));
        }
        device.fmmus.iter().for_each(|fmmu| lines.element("Fmmu", fmmu));
        for manager in &device.sync_managers {
            let mut line = "<Sm".to_owned();
            for (name, size) in
                [("MinSize", manager.min_size), ("MaxSize", manager.max_size), ("DefaultSize", manager.default_size)]
            {
                if let Some(size) = size {
                    let _ = write!(line, " {name}=\"{size}\"");
                }
            }
            let (start, control) = (manager.start, manager.control);
            let (enable, kind) = (u8::from(manager.is_enabled), escaped(&manager.kind));
            let rest = format!(
                " StartAddress=\"#x{start:04X}\" ControlByte=\"#x{control:02X}\" Enable=\"{enable}\">{kind}</Sm>"
            );
            lines.line(&(line + &rest));
        }
        device.rx_pdos.iter().for_each(|pdo| write_pdo(lines, pdo, "RxPdo"));
        device.tx_pdos.iter().for_each(|pdo| write_pdo(lines, pdo, "TxPdo"));
        if device.coe.is_some() || device.has_eoe || device.has_foe {
            lines.inside("Mailbox DataLinkLayer=\"1\"", "Mailbox", |lines| {
                for (is_there, line) in [(device.has_eoe, "<EoE/>"), (device.has_foe, "<FoE/>")] {
                    is_there.then(|| lines.line(line));
                }
                let Some(coe) = device.coe else { return };
                let mut line = "<CoE".to_owned();
                for (name, is_set) in [
                    ("SdoInfo", coe.information),
                    ("PdoAssign", coe.pdo_assign),
                    ("PdoConfig", coe.pdo_configuration),
                    ("CompleteAccess", coe.complete_access),
                    ("SegmentedSdo", coe.segmented),
                ] {
                    let _ = write!(line, " {name}=\"{}\"", u8::from(is_set));
                }
                lines.line(&(line + "/>"));
            });
        }
        if !device.op_modes.is_empty() {
            lines.inside("Dc", "Dc", |lines| {
                for mode in &device.op_modes {
                    lines.inside("OpMode", "OpMode", |lines| {
                        lines.element("Name", &mode.name);
                        lines.element("AssignActivate", format_args!("#x{:04X}", mode.assign_activate));
                        let (factor, cycle) = (mode.sync0_factor, mode.sync0_cycle_ns);
                        lines.line(&format!("<CycleTimeSync0 Factor=\"{factor}\">{cycle}</CycleTimeSync0>"));
                        lines.element("ShiftTimeSync0", mode.sync0_shift_ns);
                        if mode.has_sync1() {
                            lines.element("CycleTimeSync1", mode.sync1_cycle_ns);
                            lines.element("ShiftTimeSync1", mode.sync1_shift_ns);
                        }
                    });
                }
            });
        }
        if !device.slots.is_empty() {
            lines.inside("Slots", "Slots", |lines| device.slots.iter().for_each(|slot| write_slot(lines, slot)));
        }
        if device.eeprom_bytes.is_some() || !device.categories.is_empty() {
            lines.inside("Eeprom", "Eeprom", |lines| {
                device.eeprom_bytes.into_iter().for_each(|bytes| lines.element("ByteSize", bytes));
                for (name, digits) in [("ConfigData", &device.config_data), ("BootStrap", &device.bootstrap)] {
                    (!digits.is_empty()).then(|| lines.element(name, digits));
                }
                for category in &device.categories {
                    lines.inside("Category", "Category", |lines| {
                        lines.element("CatNo", category.number);
                        let digits: String = category.bytes.iter().map(|byte| format!("{byte:02X}")).collect();
                        lines.element("Data", digits);
                    });
                }
            });
        }
    });
}

fn info(lines: &mut Lines, device: &Device) {
    let (pre_op, safe_op) = (device.pre_op_ms, device.safe_op_ms);
    if pre_op.or(safe_op).or(device.mailbox_response_ms).is_none() && device.e_bus_ma.is_none() {
        return;
    }
    lines.inside("Info", "Info", |lines| {
        if let Some(ma) = device.e_bus_ma {
            lines.inside("Electrical", "Electrical", |lines| lines.element("EBusCurrent", ma));
        }
        if pre_op.is_some() || safe_op.is_some() {
            lines.inside("StateMachine", "StateMachine", |lines| {
                lines.inside("Timeout", "Timeout", |lines| {
                    pre_op.into_iter().for_each(|ms| lines.element("PreopTimeout", ms));
                    safe_op.into_iter().for_each(|ms| lines.element("SafeopOpTimeout", ms));
                });
            });
        }
        if let Some(ms) = device.mailbox_response_ms {
            lines.inside("Mailbox", "Mailbox", |lines| {
                lines.inside("Timeout", "Timeout", |lines| lines.element("ResponseTimeout", ms));
            });
        }
    });
}

fn write_slot(lines: &mut Lines, slot: &Slot) {
    let start = format!(
        "Slot MinInstances=\"{}\" MaxInstances=\"{}\" SlotPdoIncrement=\"{}\" SlotIndexIncrement=\"{}\"",
        slot.min_instances, slot.max_instances, slot.pdo_increment, slot.index_increment
    );
    lines.inside(&start, "Slot", |lines| {
        lines.element("Name", &slot.name);
        for ident in &slot.idents {
            let default = u8::from(slot.default == Some(*ident));
            lines.line(&format!("<ModuleIdent Default=\"{default}\">#x{ident:08X}</ModuleIdent>"));
        }
        for class in &slot.classes {
            lines.inside("ModuleClass", "ModuleClass", |lines| lines.element("Class", class));
        }
    });
}

fn write_module(lines: &mut Lines, module: &Module) {
    lines.inside("Module", "Module", |lines| {
        let (class, kind) = (escaped(&module.class), escaped(&module.type_name));
        lines.line(&format!("<Type ModuleIdent=\"#x{:08X}\" ModuleClass=\"{class}\">{kind}</Type>", module.ident));
        lines.element("Name", &module.name);
        module.rx_pdos.iter().for_each(|pdo| write_pdo(lines, pdo, "RxPdo"));
        module.tx_pdos.iter().for_each(|pdo| write_pdo(lines, pdo, "TxPdo"));
    });
}

/// An index, with the mark of one that depends on its slot.
fn index(lines: &mut Lines, index: u16, depends_on_slot: bool) {
    let mark = if depends_on_slot { " DependOnSlot=\"1\"" } else { "" };
    lines.line(&format!("<Index{mark}>#x{index:04X}</Index>"));
}

fn write_pdo(lines: &mut Lines, pdo: &Pdo, kind: &str) {
    let (fixed, mandatory) = (u8::from(pdo.is_fixed), u8::from(pdo.is_mandatory));
    let manager = pdo.sync_manager.map_or(String::new(), |manager| format!(" Sm=\"{manager}\""));
    lines.inside(&format!("{kind} Fixed=\"{fixed}\" Mandatory=\"{mandatory}\"{manager}"), kind, |lines| {
        index(lines, pdo.index, pdo.depends_on_slot);
        lines.element("Name", &pdo.name);
        pdo.excludes.iter().for_each(|index| lines.element("Exclude", format_args!("#x{index:04X}")));
        for entry in &pdo.entries {
            lines.inside("Entry", "Entry", |lines| {
                index(lines, entry.index, entry.depends_on_slot);
                lines.element("SubIndex", entry.sub);
                lines.element("BitLen", entry.bits);
                lines.element("Name", &entry.name);
                lines.element("DataType", &entry.data_type);
            });
        }
    });
}
