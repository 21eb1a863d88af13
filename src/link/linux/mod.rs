//! SocketCAN.
//!
//! The link has one socket for process data and one for services. A flood of one kind then cannot fill the other's queue, and a long
//! transfer cannot delay a set-point: process data use a higher band of the interface's queue.
//!
//! A frame carries the controller's time stamp where there is one, converted to the clock of the loop, and otherwise the kernel's stamp.
//!
//! An SDO client, which waits long for its answer on one socket, waits in the receive call. This takes one system call instead of three
//! (the time, the wait, the frame), which matters where calls are expensive. The receive call's own timeout is as coarse as the kernel's
//! ticks, so that `ppoll` times the end of every wait.

mod adapter;
mod controller_clock;
mod error;
mod facts;
mod filter;
mod message;
mod queue;
mod several;
mod wall;

pub use adapter::Attachment;
pub use error::LinkError;
pub use facts::{ControllerState, InterfaceFacts, interfaces};
pub use filter::CobFilter;
pub(super) use several::MOST_PORTS;
pub use several::SocketCans;

use std::cell::Cell;
use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::time::Duration;

use rustix::event::{PollFd, PollFlags};
use rustix::io::Errno;
use socketcan::{CanSocket, Socket, SocketOptions};

use super::clock::{monotonic, wait_for_any};
use super::hold::Hold;
use super::{Arrival, CanLink, ErrorFrame, OtherFrame, Received, Role, SendError};
use controller_clock::ControllerClock;
use filter::Identifiers;
use message::{ControlMessages, Message};
use wall::Wall;
use yieldwall_fieldbus::canopen::{BusId, Frame};
use yieldwall_fieldbus::time::Time;

/// Stamps of the kernel, and of the controller where it has a clock.
const STAMPS: u32 = libc::SOF_TIMESTAMPING_RX_SOFTWARE
    | libc::SOF_TIMESTAMPING_SOFTWARE
    | libc::SOF_TIMESTAMPING_RX_HARDWARE
    | libc::SOF_TIMESTAMPING_RAW_HARDWARE;

/// Longest wait in the call that receives.
const NAP: Duration = Duration::from_millis(20);
/// A wait that ends further ahead than this begins in the receive call. The value is more than twice [`NAP`], so that the receive call ends
/// before that moment although the link knows only the time that it reported last.
const FAR: Duration = Duration::from_millis(50);

/// Frames that a link takes, and its requirements for the interface.
#[derive(Clone, Debug)]
pub struct SocketCanSettings {
    /// Name of the interface, as `ip link` shows it.
    pub interface: String,
    /// Process data of both ways, SYNC included: own frames among them come back as [`Received::Echo`].
    pub process: Vec<CobFilter>,
    /// Everything else that is wanted. Own frames among it come back too, unless there are no process data. If one of the two
    /// is empty there is one socket only.
    pub services: Vec<CobFilter>,
    /// Bit rate in bit/s that the interface has to have; an interface without one, such as vcan, passes.
    pub bit_rate: Option<u32>,
    /// Memory in bytes for what nobody has taken yet, per socket. A frame takes about 1 kB of it.
    pub receive_buffer: usize,
    /// Roles of the link that only one process of this computer may have on the interface, for as long as the link lives. A process that
    /// only listens needs none.
    pub roles: Vec<Role>,
    /// Whether frames other than CANopen come as well, as [`Received::Other`]: with 29-bit identifiers, and of CAN FD.
    pub hears_others: bool,
}

impl SocketCanSettings {
    /// Returns settings for every frame of the bus over one socket, own ones included, as an observer wants it.
    pub fn everything(interface: &str) -> Self {
        Self { process: vec![CobFilter::EVERYTHING], ..Self::services(interface, Vec::new()) }
    }

    /// Returns settings for the frames that these filters let through, without own frames, as a device or a client needs them.
    pub fn services(interface: &str, services: Vec<CobFilter>) -> Self {
        let interface = interface.to_owned();
        Self {
            interface,
            process: Vec::new(),
            services,
            bit_rate: None,
            receive_buffer: 4 << 20,
            roles: Vec::new(),
            hears_others: false,
        }
    }
}

/// One socket and its state.
#[derive(Debug)]
struct Port {
    socket: CanSocket,
    /// Frames that it had lost when it was asked last.
    lost: u32,
    /// Message that arrived during a wait.
    heard: Option<io::Result<Message>>,
    /// Arrival that came together with a loss. The loss is reported first.
    pending: Option<Arrival>,
}

/// An interface of SocketCAN.
#[derive(Debug)]
pub struct SocketCan {
    /// For process data; for everything if there is no other.
    first: Port,
    /// For services.
    second: Option<Port>,
    /// Identifiers of the frames that use the first of two ports.
    is_process: Identifiers,
    facts: InterfaceFacts,
    receive_buffer: usize,
    latest: Time,
    /// The moment that was asked for or came with a frame last.
    told: Cell<Time>,
    wall: Wall,
    controller: ControllerClock,
    _holds: Vec<Hold>,
    stamps: Stamps,
}

/// Number of arrivals by the clock of their time stamp.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stamps {
    /// The controller's, the best: it is taken at the wire.
    pub hardware: u64,
    /// The kernel's, taken when the driver handed the frame over.
    pub kernel: u64,
    /// None: the moment at which the frame was taken from the socket.
    pub none: u64,
}

impl SocketCan {
    /// Opens an interface and checks that it can be used: that it is there, is a CAN interface, is up, is not bus-off and
    /// has the wanted bit rate. Takes the roles on it.
    ///
    /// # Errors
    /// What is wrong with it or who has one of the roles, and what to try next.
    pub fn open(settings: &SocketCanSettings) -> Result<Self, LinkError> {
        let name = settings.interface.as_str();
        let index = facts::find(name, settings.bit_rate)?;
        let failed = |step| move |source| LinkError::System { interface: name.to_owned(), step, source };
        let take = |&role| Hold::take(name, role).map_err(|error| LinkError::not_held(name, role, error));
        let holds = settings.roles.iter().map(take).collect::<Result<_, _>>()?;
        let has_process = !settings.process.is_empty();
        let (filters, others) = if has_process {
            (settings.process.as_slice(), settings.services.as_slice())
        } else {
            (settings.services.as_slice(), [].as_slice())
        };
        let first = Port::open(name, index, filters)?;
        if settings.hears_others {
            first.hear_others().map_err(failed("have frames of others than CANopen come"))?;
        }
        let facts = facts::query(name, index, &first.socket)?;
        facts.check(settings.bit_rate)?;
        first.socket.set_error_filter_accept_all().map_err(failed("have error frames come"))?;
        let second = if others.is_empty() { None } else { Some(Port::open(name, index, others)?) };
        if has_process {
            for port in std::iter::once(&first).chain(&second) {
                port.socket.set_recv_own_msgs(true).map_err(failed("have own frames come back"))?;
            }
            // The highest that needs no privilege. Queues that know no bands ignore it.
            let priority = first.socket.set_socket_option_int(libc::SOL_SOCKET, libc::SO_PRIORITY, 6);
            priority.map_err(failed("set the priority of process data"))?;
        }
        let mut receive_buffer = usize::MAX;
        for port in std::iter::once(&first).chain(&second) {
            let got = port.reserve(settings.receive_buffer).map_err(failed("reserve memory for frames"))?;
            receive_buffer = receive_buffer.min(got);
        }
        let is_process = Identifiers::passing(filters);
        Ok(Self {
            first,
            second,
            is_process,
            facts,
            receive_buffer,
            latest: Time(0),
            told: Cell::new(monotonic()),
            wall: Wall::default(),
            controller: ControllerClock::default(),
            _holds: holds,
            stamps: Stamps::default(),
        })
    }

    /// Returns the numbers of arrivals so far, by the clock of their time stamp.
    pub fn stamps(&self) -> Stamps {
        self.stamps
    }

    /// Returns the state of the interface when it was opened.
    pub fn facts(&self) -> &InterfaceFacts {
        &self.facts
    }

    /// Returns the memory in bytes that each socket got for frames that nobody has taken yet. Without the privilege
    /// `CAP_NET_ADMIN` it is at most what `net.core.rmem_max` allows.
    pub fn receive_buffer(&self) -> usize {
        self.receive_buffer
    }

    /// Whether something was taken from a socket and not asked for yet.
    fn has_pending(&self) -> bool {
        self.ports().any(|port| port.pending.is_some() || port.heard.is_some())
    }

    fn ports(&self) -> impl Iterator<Item = &Port> {
        std::iter::once(&self.first).chain(&self.second)
    }

    /// Returns the next arrival of one socket.
    fn take(&mut self, is_first: bool) -> Option<Arrival> {
        let port = if is_first { Some(&mut self.first) } else { self.second.as_mut() }?;
        if let Some(arrival) = port.pending.take() {
            return Some(arrival);
        }
        // An interrupted call is tried again, and what is no frame passed over; both are rare.
        for _ in 0..4 {
            let heard = port.heard.take().unwrap_or_else(|| message::receive(port.socket.as_fd(), libc::MSG_DONTWAIT));
            let message = match heard {
                Ok(message) => message,
                Err(error) => match Errno::from_io_error(&error) {
                    Some(Errno::NETDOWN) => return Some(self.arrive(ControlMessages::default(), Received::Down)),
                    Some(Errno::NODEV) => return Some(self.arrive(ControlMessages::default(), Received::Gone)),
                    Some(Errno::AGAIN) => return None,
                    _ => continue,
                },
            };
            let lost = message.told.lost.map_or(0, |lost| lost.wrapping_sub(std::mem::replace(&mut port.lost, lost)));
            let arrival = self.arrive(message.told, decode(&message));
            if lost == 0 {
                return Some(arrival);
            }
            let port = if is_first { Some(&mut self.first) } else { self.second.as_mut() }?;
            port.pending = Some(arrival);
            return Some(Arrival { what: Received::Overflow { frames: lost }, ..arrival });
        }
        None
    }

    /// Puts the stamps on the monotonic clock. A wall clock that is set in between cannot move them past now or before the
    /// arrival before it.
    fn arrive(&mut self, ControlMessages { software, hardware, .. }: ControlMessages, what: Received) -> Arrival {
        *match (software, hardware) {
            (Some(_), Some(_)) => &mut self.stamps.hardware,
            (Some(_), None) => &mut self.stamps.kernel,
            (None, _) => &mut self.stamps.none,
        } += 1;
        let time = match (software.map(|stamp| self.wall.moment_of(stamp)), hardware) {
            (Some(software), Some(hardware)) => self.controller.moment_of(software, hardware),
            (software, _) => software.unwrap_or_else(monotonic),
        };
        self.latest = time.max(self.latest);
        self.told.set(self.latest);
        Arrival { time: self.latest, bus: BusId::FIRST, what }
    }
}

/// The socket for process data, which is the only one of a link without services.
impl AsFd for SocketCan {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.first.as_fd()
    }
}

impl CanLink for SocketCan {
    fn now(&self) -> Time {
        let now = monotonic();
        self.told.set(now);
        now
    }

    fn receive(&mut self) -> Option<Arrival> {
        self.take(true).or_else(|| self.take(false))
    }

    fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
        let port = match &self.second {
            Some(services) if !self.is_process.has(frame.id()) => services,
            _ => &self.first,
        };
        match port.socket.as_raw_socket().send_with_flags(&encode(frame), libc::MSG_DONTWAIT) {
            Ok(_) => Ok(()),
            Err(error) => Err(match Errno::from_io_error(&error) {
                Some(Errno::NOBUFS | Errno::AGAIN) => SendError::Full,
                Some(Errno::NETDOWN) => SendError::Down,
                Some(Errno::NODEV | Errno::NXIO) => SendError::Gone,
                other => SendError::System { errno: other.map_or(0, Errno::raw_os_error) },
            }),
        }
    }

    fn wait(&mut self, until: Time) -> bool {
        if self.has_pending() {
            return true;
        }
        while self.second.is_none() && until.since(self.told.get()) > FAR {
            match message::receive(self.first.socket.as_fd(), 0) {
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => self.now(),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => return false,
                heard => {
                    self.first.heard = Some(heard);
                    return true;
                }
            };
        }
        let first = PollFd::new(&self.first, PollFlags::IN);
        match &self.second {
            Some(second) => wait_for_any(&mut [first, PollFd::new(second, PollFlags::IN)], until),
            None => wait_for_any(&mut [first], until),
        }
    }
}

impl Port {
    fn open(name: &str, index: u32, filters: &[CobFilter]) -> Result<Self, LinkError> {
        let failed = |step| move |source| LinkError::System { interface: name.to_owned(), step, source };
        let socket =
            CanSocket::open_iface(index).map_err(|source| LinkError::from_open(name, source, facts::interfaces))?;
        let filters: Vec<_> = filters.iter().map(CobFilter::of_kernel).collect();
        socket.set_filters(&filters).map_err(failed("filter frames"))?;
        socket.set_read_timeout(NAP).map_err(failed("wait so long only"))?;
        socket.set_timestamping(STAMPS).map_err(failed("stamp frames with the time"))?;
        let overflow = socket.set_socket_option_int(libc::SOL_SOCKET, libc::SO_RXQ_OVFL, 1);
        overflow.map_err(failed("count lost frames"))?;
        Ok(Self { socket, lost: 0, heard: None, pending: None })
    }

    /// Lets every frame come, those with 29-bit identifiers and those of CAN FD too.
    fn hear_others(&self) -> io::Result<()> {
        self.socket.set_filters(&[filter::no_filter()])?;
        self.socket.set_socket_option_int(libc::SOL_CAN_RAW, libc::CAN_RAW_FD_FRAMES, 1)
    }

    /// Asks for memory for frames; what there is then.
    fn reserve(&self, bytes: usize) -> io::Result<usize> {
        // The kernel doubles what it is asked for.
        let half = i32::try_from(bytes / 2).unwrap_or(i32::MAX);
        let option = |name| self.socket.set_socket_option_int(libc::SOL_SOCKET, name, half);
        option(libc::SO_RCVBUFFORCE).or_else(|_| option(libc::SO_RCVBUF))?;
        self.socket.as_raw_socket().recv_buffer_size()
    }
}

impl AsFd for Port {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.socket.as_fd()
    }
}

/// Returns the content of a message.
fn decode(message: &Message) -> Received {
    let Message { frame, is_own, is_fd, .. } = message;
    if frame.can_id & libc::CAN_ERR_FLAG != 0 {
        return Received::Error(ErrorFrame::decode(frame.can_id & libc::CAN_ERR_MASK, &frame.data));
    }
    let is_extended = frame.can_id & libc::CAN_EFF_FLAG != 0;
    if is_extended || *is_fd {
        let mask = if is_extended { libc::CAN_EFF_MASK } else { libc::CAN_SFF_MASK };
        let (id, length) = (frame.can_id & mask, frame.can_dlc);
        return Received::Other(OtherFrame { id, is_extended, is_fd: *is_fd, length });
    }
    let id = (frame.can_id & libc::CAN_SFF_MASK) as u16;
    let frame = if frame.can_id & libc::CAN_RTR_FLAG != 0 {
        Frame::remote(id, frame.can_dlc)
    } else {
        Frame::from_bits(id, u64::from_le_bytes(frame.data), frame.can_dlc)
    };
    if *is_own { Received::Echo(frame) } else { Received::Frame(frame) }
}

/// Returns a `can_frame` of `include/uapi/linux/can.h`: identifier with flags, length, three bytes of nothing and the data.
fn encode(frame: &Frame) -> [u8; 16] {
    let flag = if frame.is_remote() { libc::CAN_RTR_FLAG } else { 0 };
    let [a, b, c, d] = (u32::from(frame.id()) | flag).to_ne_bytes();
    let [e, f, g, h, i, j, k, l] = *frame.bytes();
    [a, b, c, d, frame.length_code(), 0, 0, 0, e, f, g, h, i, j, k, l]
}

#[cfg(all(test, target_endian = "little"))]
mod tests {
    use super::*;

    #[test]
    fn frames_are_laid_out_as_the_kernel_wants_them() {
        #[rustfmt::skip]
        assert_eq!(
            encode(&Frame::new(0x6a5, &[0x11, 0x22, 0x33])),
            [0xa5, 0x06, 0, 0, 3, 0, 0, 0, 0x11, 0x22, 0x33, 0, 0, 0, 0, 0]
        );
        assert_eq!(encode(&Frame::remote(0x701, 1)), [0x01, 0x07, 0, 0x40, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
    }

    #[test]
    fn frames_that_are_none_of_canopen_are_told_apart() {
        let decoded = |can_id, can_dlc, is_fd| {
            let mut frame = socketcan::frame::can_frame_default();
            (frame.can_id, frame.can_dlc) = (can_id, can_dlc);
            decode(&Message { frame, is_own: false, is_fd, told: ControlMessages::default() })
        };
        let other = |id, is_extended, is_fd, length| Received::Other(OtherFrame { id, is_extended, is_fd, length });
        assert_eq!(decoded(0x98ff_1234, 8, false), other(0x18ff_1234, true, false, 8));
        assert_eq!(decoded(0x8000_0181, 2, false), other(0x181, true, false, 2), "as short as one of 11 bits");
        assert_eq!(decoded(0x181, 64, true), other(0x181, false, true, 64));
        assert_eq!(decoded(0x98ff_1234, 12, true), other(0x18ff_1234, true, true, 12));
        assert_eq!(decoded(0x181, 0, false), Received::Frame(Frame::new(0x181, &[])));
    }
}
