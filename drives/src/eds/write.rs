//! Device configuration files.

use std::fmt::Write as _;

use super::{Access, Eds, Entry, Kind, Node, Object, Value};

impl Eds {
    /// A device configuration file for a node: all objects with the values that they are set to.
    ///
    /// [`Eds::read`] reads the output back without a finding: it finds the same objects and values.
    pub fn to_dcf(&self, node: &Node) -> String {
        let mut text = String::new();
        self.head(&mut text, node);
        let listed = |range: fn(u16) -> bool| self.objects.keys().copied().filter(|index| range(*index)).collect();
        let is_mandatory = |index: u16| matches!(index, 0x1000 | 0x1001 | 0x1018);
        let mandatory: Vec<u16> = listed(|index| matches!(index, 0x1000 | 0x1001 | 0x1018));
        let manufacturer: Vec<u16> = listed(|index| (0x2000..0x6000).contains(&index));
        let others =
            self.objects.keys().copied().filter(|index| !is_mandatory(*index) && !(0x2000..0x6000).contains(index));
        let lists = [
            ("MandatoryObjects", mandatory),
            ("OptionalObjects", others.collect()),
            ("ManufacturerObjects", manufacturer),
        ];
        for (name, indices) in lists {
            line(&mut text, format_args!("[{name}]"));
            line(&mut text, format_args!("SupportedObjects={}", indices.len()));
            for (number, index) in indices.iter().enumerate() {
                line(&mut text, format_args!("{}=0x{index:04X}", number + 1));
            }
            text.push('\n');
        }
        for (index, object) in &self.objects {
            object.write(&mut text, *index);
        }
        text
    }

    fn head(&self, text: &mut String, node: &Node) {
        line(text, format_args!("[FileInfo]\nFileVersion=1\nFileRevision=0\nEDSVersion=4.0\n"));
        let device = &self.device;
        line(
            text,
            format_args!("[DeviceInfo]\nVendorName={}\nProductName={}", plain(&device.vendor), plain(&device.product)),
        );
        let numbers = [
            ("VendorNumber", device.vendor_number),
            ("ProductNumber", device.product_number),
            ("RevisionNumber", device.revision_number),
        ];
        for (key, number) in numbers {
            if let Some(number) = number {
                line(text, format_args!("{key}=0x{number:08X}"));
            }
        }
        for rate in &device.bit_rates_kbit_per_s {
            line(text, format_args!("BaudRate_{rate}=1"));
        }
        for (key, count) in [("NrOfRXPDO", device.rpdos), ("NrOfTXPDO", device.tpdos)] {
            if let Some(count) = count {
                line(text, format_args!("{key}={count}"));
            }
        }
        line(text, format_args!("LSS_Supported={}\n", u8::from(device.has_lss)));
        line(text, format_args!("[DeviceComissioning]"));
        if node.id > 0 {
            line(text, format_args!("NodeID=0x{:02X}", node.id));
        }
        line(text, format_args!("NodeName={}", plain(&node.name)));
        if let Some(rate) = node.bit_rate_kbit_per_s {
            line(text, format_args!("Baudrate={rate}"));
        }
        text.push_str("\n[DummyUsage]\n");
        // Readers expect the first seven types whether they can be mapped or not.
        for dummy in (1..=7).chain(self.dummies.range(8..).copied()) {
            line(text, format_args!("Dummy{dummy:04X}={}", u8::from(self.dummies.contains(&dummy))));
        }
        text.push('\n');
    }
}

impl Object {
    fn write(&self, text: &mut String, index: u16) {
        line(
            text,
            format_args!("[{index:04X}]\nParameterName={}\nObjectType=0x{:X}", plain(&self.name), self.kind as u8),
        );
        if matches!(self.kind, Kind::Variable | Kind::Domain | Kind::TypeDefinition) {
            self.entries.values().take(1).for_each(|entry| entry.write(text));
            text.push('\n');
            return;
        }
        line(text, format_args!("SubNumber={}\n", self.entries.len()));
        for (sub, entry) in &self.entries {
            line(text, format_args!("[{index:04X}sub{sub:X}]\nParameterName={}\nObjectType=0x7", plain(&entry.name)));
            entry.write(text);
            text.push('\n');
        }
    }
}

impl Entry {
    fn write(&self, text: &mut String) {
        let access = match self.access {
            Access::Constant => "const",
            Access::ReadOnly => "ro",
            Access::WriteOnly => "wo",
            Access::ReadWrite => "rw",
            Access::ReadWriteInput => "rwr",
            Access::ReadWriteOutput => "rww",
        };
        line(text, format_args!("DataType=0x{:04X}\nAccessType={access}", self.data_type));
        let values = [
            ("LowLimit", &self.low),
            ("HighLimit", &self.high),
            ("DefaultValue", &self.default),
            ("ParameterValue", &self.value),
        ];
        for (key, value) in values {
            if let Some(value) = value {
                line(text, format_args!("{key}={}", value.text()));
            }
        }
        line(text, format_args!("PDOMapping={}", u8::from(self.is_mappable)));
        if self.is_kept_from_download {
            line(text, format_args!("ObjFlags=1"));
        }
    }
}

impl Value {
    fn text(&self) -> String {
        match self {
            Value::Integer(number) => number.to_string(),
            Value::OfNode(number) => format!("$NODEID+0x{number:X}"),
            Value::Real(number) => format!("{number:?}"),
            Value::Text(text) => plain(text),
            Value::Bytes(bytes) => bytes.iter().fold(String::new(), |mut text, byte| {
                let _ = write!(text, "{byte:02X}");
                text
            }),
        }
    }
}

/// A text on one line, without what would end it early.
fn plain(text: &str) -> String {
    text.chars()
        .map(|one| if one.is_control() { ' ' } else { one })
        .collect::<String>()
        .replace(" ;", ",")
        .trim()
        .to_owned()
}

fn line(text: &mut String, content: std::fmt::Arguments<'_>) {
    // A String takes whatever is written into it.
    let _ = writeln!(text, "{content}");
}
