//! Connection of an interface to this computer, as the file system of the kernel shows it.

use std::fs;
use std::path::Path;

/// Folder in which the kernel describes its interfaces.
pub(super) const NET: &str = "/sys/class/net";

/// Shortest cycle in us for an adapter that moves frames in steps of 1 ms, each way. The cycle holds a request, its answer and the next
/// command, with a step in reserve.
const SHORTEST_FULL_SPEED_US: u32 = 4000;
/// Shortest cycle in us for a serial line: a frame of 8 bytes is about 22 characters, 2 ms at 115 200 baud, and a cycle has half a dozen.
const SHORTEST_SERIAL_US: u32 = 20_000;
/// Shortest cycle in us for an adapter that moves frames in steps of 125 us.
const SHORTEST_HIGH_SPEED_US: u32 = 1000;

/// Connection between the computer and the controller.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Attachment {
    /// Nothing: the kernel knows of no device. This is the case for a virtual interface, and of a serial line on older kernels.
    Virtual,
    /// USB of this speed in Mbit/s, where the kernel reports it.
    Usb {
        /// 12 is full speed, 480 high speed.
        mbit_per_s: Option<u32>,
    },
    /// A serial line.
    Serial,
    /// A bus of the computer itself, such as `pci`, `platform` or `spi`.
    Direct(String),
    /// A device that says nothing of its bus, or an interface that is not described.
    Unknown,
}

/// Contents of an interface's folder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Folder {
    pub(super) attachment: Attachment,
    pub(super) driver: Option<String>,
    pub(super) has_echo: Option<bool>,
    pub(super) tx_queue_len: Option<u32>,
}

impl Folder {
    /// Reads the folder of interface `name` in `net`. A file that cannot be read counts as unknown.
    pub(super) fn read(net: &Path, name: &str) -> Self {
        let folder = net.join(name);
        let text = |path: &str| fs::read_to_string(folder.join(path)).ok().map(|text| text.trim().to_owned());
        let link = |path: &str| {
            let target = fs::read_link(folder.join(path)).ok()?;
            Some(target.file_name()?.to_string_lossy().into_owned())
        };
        let flags = text("flags").and_then(|flags| u32::from_str_radix(flags.trim_start_matches("0x"), 16).ok());
        let is_described = folder.exists();
        let attachment = match link("device/subsystem").as_deref() {
            _ if name.starts_with("slcan") => Attachment::Serial,
            Some("usb") => {
                // The interface of the device, of which the speed is told, or the device itself.
                let speed = text("device/speed").or_else(|| text("device/../speed"));
                Attachment::Usb {
                    mbit_per_s: speed.and_then(|speed| speed.parse::<f64>().ok()).map(|speed| speed as u32),
                }
            }
            Some("tty" | "serial" | "serial-base") => Attachment::Serial,
            Some(bus) => Attachment::Direct(bus.to_owned()),
            None if is_described && !folder.join("device").exists() => Attachment::Virtual,
            None => Attachment::Unknown,
        };
        Self {
            attachment,
            driver: link("device/driver"),
            has_echo: flags.map(|flags| flags & libc::IFF_ECHO as u32 != 0),
            tx_queue_len: text("tx_queue_len").and_then(|len| len.parse().ok()),
        }
    }
}

impl Attachment {
    /// Returns why a cycle of so many us is too short for it, and the remedy; `None` if the cycle may be long enough.
    pub fn too_slow_for(&self, period_us: u32) -> Option<(String, &'static str)> {
        let (shortest_us, why, help) = match self {
            Attachment::Usb { mbit_per_s: Some(0..=12) } => (
                SHORTEST_FULL_SPEED_US,
                "is on full-speed USB, which moves frames once a millisecond each way",
                "take a cycle of 5 ms, such as that of config/paper-admittance-5ms.yaml, or an adapter for high-speed USB \
                 or PCIe; docs/adapters.md says which cycle takes which",
            ),
            Attachment::Usb { .. } => (
                SHORTEST_HIGH_SPEED_US,
                "is on USB, which moves frames eight times a millisecond at best",
                "take a cycle of 1 ms or more, or a controller on PCIe or on the processor's own bus",
            ),
            Attachment::Serial => (
                SHORTEST_SERIAL_US,
                "is on a serial line, on which one frame takes some 2 ms at 115 200 baud",
                "a serial line is for looking at a bus; take an adapter for USB or PCIe",
            ),
            _ => return None,
        };
        (period_us < shortest_us).then(|| (format!("{why}, and cannot carry a cycle of {period_us} us"), help))
    }
}

impl std::fmt::Display for Attachment {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Attachment::Virtual => f.write_str("virtual"),
            Attachment::Usb { mbit_per_s: Some(speed) } => write!(f, "USB at {speed} Mbit/s"),
            Attachment::Usb { mbit_per_s: None } => f.write_str("USB of unknown speed"),
            Attachment::Serial => f.write_str("serial line"),
            Attachment::Direct(bus) => write!(f, "bus {bus}"),
            Attachment::Unknown => f.write_str("unknown"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;
    use std::path::PathBuf;

    /// A tree such as that of `/sys`, removed in the end.
    struct Tree(PathBuf);

    impl Tree {
        fn new(name: &str) -> Self {
            let root = std::env::temp_dir().join(format!("yieldwall-sysfs-{name}-{}", std::process::id()));
            let _ = fs::remove_dir_all(&root);
            fs::create_dir_all(root.join("net")).unwrap();
            Self(root)
        }

        fn file(&self, path: &str, text: &str) {
            let path = self.0.join(path);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, text).unwrap();
        }

        fn link(&self, path: &str, target: &str) {
            fs::create_dir_all(self.0.join(target)).unwrap();
            let path = self.0.join(path);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            symlink(self.0.join(target), path).unwrap();
        }

        /// Creates an interface on USB whose device has this speed.
        fn usb(name: &str, speed: Option<&str>) -> Self {
            let tree = Self::new(name);
            tree.file("net/can0/flags", "0x40081\n");
            tree.file("net/can0/tx_queue_len", "10\n");
            tree.link("net/can0/device", "devices/usb1/1-1/1-1:1.0");
            tree.link("devices/usb1/1-1/1-1:1.0/subsystem", "bus/usb");
            tree.link("devices/usb1/1-1/1-1:1.0/driver", "bus/usb/drivers/gs_usb");
            if let Some(speed) = speed {
                tree.file("devices/usb1/1-1/speed", speed);
            }
            tree
        }

        fn read(&self, name: &str) -> Folder {
            Folder::read(&self.0.join("net"), name)
        }
    }

    impl Drop for Tree {
        fn drop(&mut self) {
            let _ = fs::remove_dir_all(&self.0);
        }
    }

    #[test]
    fn the_speed_of_an_adapter_is_that_of_the_device_behind_its_interface() {
        let expected = Folder {
            attachment: Attachment::Usb { mbit_per_s: Some(12) },
            driver: Some("gs_usb".to_owned()),
            has_echo: Some(true),
            tx_queue_len: Some(10),
        };
        assert_eq!(Tree::usb("full", Some("12\n")).read("can0"), expected);
        let attachment = |name: &str, speed| Tree::usb(name, speed).read("can0").attachment;
        assert_eq!(attachment("high", Some("480\n")), Attachment::Usb { mbit_per_s: Some(480) });
        assert_eq!(attachment("low", Some("1.5\n")), Attachment::Usb { mbit_per_s: Some(1) });
        // What cannot be read is unknown.
        for (name, speed) in [("none", None), ("odd", Some("fast\n"))] {
            assert_eq!(attachment(name, speed), Attachment::Usb { mbit_per_s: None });
        }
    }

    #[test]
    fn an_interface_without_a_device_is_virtual_and_one_that_says_nothing_unknown() {
        let tree = Tree::new("kinds");
        tree.file("net/vcan0/flags", "0xc1\n");
        tree.file("net/vcan0/tx_queue_len", "0\n");
        tree.file("net/slcan0/flags", "nonsense");
        tree.link("net/can1/device", "devices/pci/0000:01");
        tree.link("devices/pci/0000:01/subsystem", "bus/pci");
        tree.link("net/can2/device", "devices/odd");
        let virtually =
            Folder { attachment: Attachment::Virtual, driver: None, has_echo: Some(false), tx_queue_len: Some(0) };
        assert_eq!(tree.read("vcan0"), virtually);
        let serial = Folder { attachment: Attachment::Serial, driver: None, has_echo: None, tx_queue_len: None };
        assert_eq!(tree.read("slcan0"), serial);
        assert_eq!(tree.read("can1").attachment, Attachment::Direct("pci".to_owned()));
        for name in ["can2", "can3"] {
            assert_eq!(tree.read(name).attachment, Attachment::Unknown, "{name}");
        }
    }

    #[test]
    fn a_cycle_is_judged_by_how_frames_move() {
        let usb = |mbit_per_s| Attachment::Usb { mbit_per_s };
        let is_too_slow = |attachment: Attachment, us| attachment.too_slow_for(us).is_some();
        assert!(
            is_too_slow(usb(Some(12)), 1000) && is_too_slow(usb(Some(12)), 3999) && !is_too_slow(usb(Some(12)), 4000)
        );
        assert!(is_too_slow(usb(Some(480)), 500) && !is_too_slow(usb(Some(480)), 1000));
        assert!(is_too_slow(usb(None), 999) && !is_too_slow(usb(None), 1000));
        assert!(is_too_slow(Attachment::Serial, 10_000) && !is_too_slow(Attachment::Serial, 20_000));
        for attachment in [Attachment::Virtual, Attachment::Unknown, Attachment::Direct("pci".to_owned())] {
            assert!(!is_too_slow(attachment, 100));
        }
        let (why, help) = usb(Some(12)).too_slow_for(1000).unwrap();
        assert!(why.contains("once a millisecond") && why.ends_with("cannot carry a cycle of 1000 us"), "{why}");
        assert!(help.contains("paper-admittance-5ms.yaml"), "{help}");
    }
}
