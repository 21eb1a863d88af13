//! An interface of this machine.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use yieldwall::canopen::Frame;
use yieldwall::link::{Arrival, CanLink, CobFilter, Received, SocketCan, SocketCanSettings};

use super::{Network, Participant};

/// How long a device sleeps at most before it looks whether it is to end.
const NAP: Duration = Duration::from_millis(100);

/// A bus behind an interface of this machine; each device has a thread and a socket of its own.
pub struct Real {
    interface: String,
    is_over: Arc<AtomicBool>,
    devices: Vec<JoinHandle<()>>,
}

impl Real {
    /// The interface that the environment names as `YIELDWALL_CAN`, else `vcan0`. It has no other nodes on it.
    pub fn new() -> Self {
        let interface = std::env::var("YIELDWALL_CAN").unwrap_or_else(|_| "vcan0".to_owned());
        Self { interface, is_over: Arc::default(), devices: Vec::new() }
    }

    /// Name of the interface.
    pub fn interface(&self) -> &str {
        &self.interface
    }

    /// A link for an SDO client of one node, which sees nothing but the answers.
    ///
    /// # Panics
    /// If the interface cannot be used; the message says why.
    pub fn client(&self, node: u8) -> SocketCan {
        let answers = CobFilter::only(0x580 + u16::from(node));
        Self::open(&SocketCanSettings::services(&self.interface, vec![answers]))
    }

    /// A link with these settings.
    ///
    /// # Panics
    /// If the interface cannot be used; the message says why.
    pub fn open(settings: &SocketCanSettings) -> SocketCan {
        SocketCan::open(settings).unwrap_or_else(|error| panic!("{error}"))
    }
}

impl Default for Real {
    fn default() -> Self {
        Self::new()
    }
}

impl Network for Real {
    type Link = SocketCan;

    fn attach(&mut self, mut device: impl Participant + 'static) {
        let mut link = Self::open(&SocketCanSettings::services(&self.interface, vec![CobFilter::EVERYTHING]));
        let is_over = self.is_over.clone();
        self.devices.push(std::thread::spawn(move || {
            let mut out = Vec::new();
            device.switch_on(link.now(), &mut out);
            let mut now = link.now();
            while !is_over.load(Ordering::Relaxed) {
                send(&mut link, &mut out);
                if device.next_deadline() <= now {
                    device.poll(now, &mut out);
                    continue;
                }
                // The moment of a frame is that of the device: reading the clock costs a system call in some kernels.
                match link.wait(device.next_deadline().min(now + NAP)).then(|| link.receive()).flatten() {
                    Some(Arrival { time, what, .. }) => {
                        now = time.max(now);
                        if let Received::Frame(frame) = what {
                            device.on_frame(now, &frame, &mut out);
                        }
                    }
                    None => now = link.now(),
                }
            }
        }));
    }

    fn link(&mut self) -> SocketCan {
        Self::open(&SocketCanSettings::everything(&self.interface))
    }
}

impl Drop for Real {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Relaxed);
        let ends: Vec<_> = self.devices.drain(..).map(JoinHandle::join).collect();
        assert!(std::thread::panicking() || ends.iter().all(Result::is_ok), "a device has failed");
    }
}

fn send(link: &mut SocketCan, out: &mut Vec<Frame>) {
    for frame in out.drain(..) {
        link.send(&frame).unwrap_or_else(|error| panic!("{:03X}h: {error}", frame.id()));
    }
}
