//! An interface of this machine.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use yieldwall::canopen::Outbox;
use yieldwall::link::{Arrival, CanLink, CobFilter, LinkOutbox, Received, SocketCan, SocketCanSettings};

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
        Self::on(&std::env::var("YIELDWALL_CAN").unwrap_or_else(|_| "vcan0".to_owned()))
    }

    /// This interface.
    pub fn on(interface: &str) -> Self {
        Self { interface: interface.to_owned(), is_over: Arc::default(), devices: Vec::new() }
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
            let mut now = link.now();
            send(&mut link, |out| device.switch_on(now, out));
            while !is_over.load(Ordering::Relaxed) {
                if device.next_deadline() <= now {
                    send(&mut link, |out| device.poll(now, out));
                    continue;
                }
                // The moment of a frame is that of the device: reading the clock costs a system call in some kernels.
                match link.wait(device.next_deadline().min(now + NAP)).then(|| link.receive()).flatten() {
                    Some(Arrival { time, what, .. }) => {
                        now = time.max(now);
                        if let Received::Frame(frame) = what {
                            send(&mut link, |out| device.on_frame(now, &frame, out));
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

/// Has a device send at once, so that it knows what there was no room for.
fn send(link: &mut SocketCan, act: impl FnOnce(&mut dyn Outbox)) {
    let mut out = LinkOutbox::new(link);
    act(&mut out);
    assert_eq!(out.failure(), None);
}
