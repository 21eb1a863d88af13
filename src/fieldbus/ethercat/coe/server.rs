//! The device's end of CoE.

use super::super::u16_at;
use super::complete;
use super::information::{self, ListKind, operation};
use super::wire::{self, Request, Service};
use crate::ethercat::mailbox::MailboxError;
use crate::objects::{AbortCode, Address, ServedDevice};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Idle,
    Upload {
        toggle: bool,
        sent: usize,
    },
    Download {
        toggle: bool,
        declared: usize,
        is_complete: bool,
    },
    /// Fragments of an answer to a request for information.
    Information {
        operation: u8,
        sent: usize,
    },
}

/// One server: SDO expedited, normal and segmented, complete access, and SDO information. A new request drops what runs.
///
/// Its buffer is taken at the start; serving does not allocate.
#[derive(Clone, Debug)]
pub struct CoeServer {
    phase: Phase,
    at: Address,
    value: Vec<u8>,
    capacity: usize,
}

impl CoeServer {
    /// Creates a server of what a device has: its buffer holds its longest object by complete access, and its longest list.
    pub fn new<D: ServedDevice + ?Sized>(device: &D) -> Self {
        let od = device.od();
        let mut capacity = 2 + 2 * od.descriptions().count();
        let mut index = Some(0);
        while let Some(next) = index.and_then(|index| od.next_index(index)) {
            let members = od.under(next.at.index);
            capacity =
                capacity.max(members.map(|member| member.capacity.max(member.name.len() + 10)).sum::<usize>() + 2);
            index = next.at.index.checked_add(1);
        }
        CoeServer { phase: Phase::Idle, at: Address::new(0, 0), value: Vec::with_capacity(capacity), capacity }
    }

    /// Forgets what runs.
    pub fn reset(&mut self) {
        self.phase = Phase::Idle;
        self.value.clear();
    }

    /// Takes a message and writes the answer; gives its bytes, 0 for none.
    ///
    /// # Errors
    /// What the mailbox has to be answered with instead: too short, or a service that devices do not take.
    pub fn on_message<D: ServedDevice + ?Sized>(
        &mut self,
        message: &[u8],
        device: &mut D,
        answer: &mut [u8],
    ) -> Result<usize, MailboxError> {
        if message.len() < wire::HEADER {
            return Err(MailboxError::SIZE_TOO_SHORT);
        }
        match Service::of(message) {
            Some(Service::SdoRequest) => {
                let request = wire::request(message).ok_or(MailboxError::SIZE_TOO_SHORT)?;
                let result = self.serve(request, device, answer);
                Ok(result.unwrap_or_else(|code| {
                    self.reset();
                    wire::abort(answer, self.at, code)
                }))
            }
            Some(Service::Information) => {
                let result = self.inform(message, device, answer)?;
                Ok(result.unwrap_or_else(|code| {
                    self.reset();
                    information::error(answer, code)
                }))
            }
            _ => Err(MailboxError::SERVICE_NOT_SUPPORTED),
        }
    }

    /// Writes the next fragment of an answer that did not fit one mailbox; gives its bytes, 0 for none.
    pub fn poll(&mut self, answer: &mut [u8]) -> usize {
        let Phase::Information { operation, sent } = self.phase else { return 0 };
        let (len, taken) = information::fragment(answer, operation, &self.value, sent);
        let sent = sent + taken;
        self.phase =
            if taken == 0 || sent >= self.value.len() { Phase::Idle } else { Phase::Information { operation, sent } };
        len
    }

    /// Whether [`CoeServer::poll`] has something.
    pub fn has_more(&self) -> bool {
        matches!(self.phase, Phase::Information { .. })
    }

    fn start(&mut self, at: Address) {
        self.reset();
        self.at = at;
    }

    fn serve<D: ServedDevice + ?Sized>(
        &mut self,
        request: Request<'_>,
        device: &mut D,
        answer: &mut [u8],
    ) -> Result<usize, AbortCode> {
        match request {
            Request::Abort => {
                self.reset();
                Ok(0)
            }
            Request::Upload { at, is_complete } => {
                self.start(at);
                if is_complete {
                    complete::read(device, at, &mut self.value, self.capacity)?;
                } else {
                    device.od().read(at)?;
                    device.before_read(at)?;
                    self.value.extend_from_slice(device.od().read(at)?);
                }
                let (len, sent) = wire::initiate(answer, Service::SdoResponse, 0x40, at, is_complete, &self.value);
                if sent < self.value.len() {
                    self.phase = Phase::Upload { toggle: false, sent };
                }
                Ok(len)
            }
            Request::UploadSegment { toggle } => match self.phase {
                Phase::Upload { toggle: expected, .. } if toggle != expected => Err(AbortCode::TOGGLE),
                Phase::Upload { sent, .. } => {
                    let (len, taken, is_last) = wire::segment(answer, Service::SdoResponse, &self.value, sent, toggle);
                    let rest = Phase::Upload { toggle: !toggle, sent: sent + taken };
                    self.phase = if is_last { Phase::Idle } else { rest };
                    Ok(len)
                }
                _ => Err(AbortCode::COMMAND),
            },
            Request::Download { at, is_complete, size, data } => {
                self.start(at);
                let size = size as usize;
                if size > self.capacity || data.len() > size {
                    // The length of an object of a basic type is told more precisely.
                    if !is_complete {
                        device.od().check_write_len(at, size)?;
                    }
                    return Err(AbortCode::TOO_LONG);
                }
                if data.len() == size {
                    Self::store(device, at, is_complete, data)?;
                } else {
                    if !is_complete {
                        device.od().check_write_len(at, size)?;
                    }
                    self.value.extend_from_slice(data);
                    self.phase = Phase::Download { toggle: false, declared: size, is_complete };
                }
                Ok(wire::download_response(answer, at, is_complete))
            }
            Request::DownloadSegment { toggle, is_last, data } => {
                let Phase::Download { toggle: expected, declared, is_complete } = self.phase else {
                    return Err(AbortCode::COMMAND);
                };
                if toggle != expected {
                    return Err(AbortCode::TOGGLE);
                }
                if self.value.len() + data.len() > declared {
                    return Err(AbortCode::TOO_LONG);
                }
                self.value.extend_from_slice(data);
                if is_last {
                    if self.value.len() < declared {
                        return Err(AbortCode::TOO_SHORT);
                    }
                    Self::store(device, self.at, is_complete, &self.value)?;
                    self.phase = Phase::Idle;
                } else {
                    self.phase = Phase::Download { toggle: !toggle, declared, is_complete };
                }
                Ok(wire::toggled(answer, Service::SdoResponse, 0x20, toggle))
            }
            Request::Unknown { at } => {
                self.start(at);
                Err(AbortCode::COMMAND)
            }
        }
    }

    fn store<D: ServedDevice + ?Sized>(
        device: &mut D,
        at: Address,
        is_complete: bool,
        data: &[u8],
    ) -> Result<(), AbortCode> {
        if is_complete { complete::write(device, at, data) } else { complete::write_one(device, at, data) }
    }

    /// Answers a request for information.
    fn inform<D: ServedDevice + ?Sized>(
        &mut self,
        message: &[u8],
        device: &D,
        answer: &mut [u8],
    ) -> Result<Result<usize, AbortCode>, MailboxError> {
        let request = information::decode(message).ok_or(MailboxError::SIZE_TOO_SHORT)?;
        self.start(Address::new(0, 0));
        let needed = match request.operation {
            operation::LIST | operation::OBJECT => 2,
            operation::ENTRY => 4,
            _ => 0,
        };
        if request.data.len() < needed {
            return Err(MailboxError::SIZE_TOO_SHORT);
        }
        let (od, word, value) = (device.od(), u16_at(request.data, 0), &mut self.value);
        let found = match (request.operation, request.data) {
            (operation::LIST, _) => match ListKind::from_number(word) {
                Some(kind) => {
                    information::list(od, kind, value);
                    Ok(())
                }
                None => Err(AbortCode::VALUE),
            },
            (operation::OBJECT, _) => information::describe_object(od, word, value),
            (operation::ENTRY, [_, _, sub, ..]) => information::describe_entry(od, Address::new(word, *sub), value),
            _ => Err(AbortCode::COMMAND),
        };
        Ok(found.map(|()| {
            self.phase = Phase::Information { operation: request.operation + 1, sent: 0 };
            self.poll(answer)
        }))
    }
}
