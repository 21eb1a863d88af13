//! Actions of the client after each answer of a device.

use super::super::block::Taken;
use super::super::wire::{BlockFrame, Initiate, Response};
use super::*;

impl SdoClient {
    pub(super) fn step(&mut self, now: Time, payload: &wire::Payload) -> Step {
        let mine = self.at;
        match (self.phase, wire::decode_response(payload)) {
            // A device without block transfer.
            (Phase::BlockUploadInitiate, Response::Abort { at, code: AbortCode::COMMAND }) if at == mine => {
                self.is_block = false;
                self.phase = Phase::UploadInitiate;
                Step::Send(wire::upload_request(mine))
            }
            (Phase::BlockDownloadInitiate { .. }, Response::Abort { at, code: AbortCode::COMMAND }) if at == mine => {
                self.phase = Phase::DownloadInitiate;
                Step::Send(wire::download_request(mine, &self.data))
            }
            // The end was repeated: the device may be done since the first one, and have nothing to end any more.
            (Phase::BlockDownloadEnd { is_repeated: true, .. }, Response::Abort { at, code: AbortCode::COMMAND })
                if at == mine =>
            {
                Step::End(SdoOutcome::TimedOut { at, may_be_written: true })
            }
            (_, Response::Abort { at, code }) if at == mine => {
                Step::End(SdoOutcome::Aborted { at, code, is_by_device: true })
            }
            (Phase::UploadInitiate | Phase::BlockUploadInitiate, Response::Upload { at, initiate }) if at == mine => {
                self.upload(initiate)
            }
            (Phase::UploadSegments { toggle, declared }, Response::UploadSegment(segment)) => {
                if segment.toggle != toggle {
                    return Step::Abort(AbortCode::TOGGLE);
                }
                self.data_segment(segment.data, segment.last, toggle, declared)
            }
            (Phase::DownloadInitiate, Response::Download { at }) if at == mine => {
                if wire::is_expedited(self.data.len()) {
                    return Step::End(SdoOutcome::Downloaded { at });
                }
                self.next_segment(false, 0)
            }
            (Phase::DownloadSegments { toggle, sent }, Response::DownloadSegment { toggle: echoed }) => {
                if echoed != toggle {
                    Step::Abort(AbortCode::TOGGLE)
                } else if sent >= self.data.len() {
                    Step::End(SdoOutcome::Downloaded { at: mine })
                } else {
                    self.next_segment(!toggle, sent)
                }
            }
            (Phase::BlockUploadInitiate, Response::BlockUpload { at, size, has_crc }) if at == mine => {
                self.block_upload(*payload, size, has_crc)
            }
            (Phase::BlockDownloadInitiate { unanswered }, Response::BlockDownload { at, block_size, has_crc })
                if at == mine =>
            {
                match BlockSender::new(now, block_size) {
                    Ok(sender) => {
                        self.phase = Phase::BlockDownload { sender, unanswered, has_crc };
                        Step::Stream
                    }
                    Err(code) => Step::Abort(code),
                }
            }
            (Phase::BlockDownload { .. }, Response::BlockDownload { at, .. }) if at == mine => self.repeat_first(now),
            (Phase::BlockDownload { .. }, Response::BlockAcknowledge { acknowledged, block_size }) => {
                self.acknowledge(now, acknowledged, block_size)
            }
            (Phase::BlockDownloadEnd { has_crc, .. }, Response::BlockAcknowledge { .. }) => {
                self.phase = Phase::BlockDownloadEnd { has_crc, is_repeated: true };
                Step::Send(wire::block_end(&self.data, has_crc))
            }
            (Phase::BlockDownloadEnd { .. }, Response::BlockEndConfirmed) => {
                Step::End(SdoOutcome::Downloaded { at: mine })
            }
            // Late answers to earlier transfers; a device that really lost step runs into the time limit.
            _ => Step::Ignore,
        }
    }

    fn upload(&mut self, initiate: Initiate<'_>) -> Step {
        match initiate {
            Initiate::Expedited { data, is_size_indicated } => {
                self.data.extend_from_slice(data);
                self.has_size = is_size_indicated;
                Step::End(SdoOutcome::Uploaded { at: self.at, len: data.len(), is_size_indicated })
            }
            Initiate::Segmented { size } => {
                let declared = size.map(|size| size as usize);
                if declared.is_some_and(|size| size > self.capacity) {
                    return Step::Abort(AbortCode::OUT_OF_MEMORY);
                }
                self.phase = Phase::UploadSegments { toggle: false, declared };
                Step::Send(wire::upload_segment_request(false))
            }
        }
    }

    fn data_segment(&mut self, data: &[u8], is_last: bool, toggle: bool, declared: Option<usize>) -> Step {
        let len = self.data.len() + data.len();
        if declared.is_some_and(|size| len > size) {
            return Step::Abort(AbortCode::TOO_LONG);
        }
        if len > self.capacity {
            return Step::Abort(AbortCode::OUT_OF_MEMORY);
        }
        self.data.extend_from_slice(data);
        if is_last {
            return match declared {
                Some(size) if len < size => Step::Abort(AbortCode::TOO_SHORT),
                _ => Step::End(SdoOutcome::Uploaded { at: self.at, len, is_size_indicated: true }),
            };
        }
        // An empty segment that is not the last would let a device keep the transfer open for ever.
        if data.is_empty() {
            return Step::Abort(AbortCode::LENGTH);
        }
        self.phase = Phase::UploadSegments { toggle: !toggle, declared };
        Step::Send(wire::upload_segment_request(!toggle))
    }

    fn next_segment(&mut self, toggle: bool, sent: usize) -> Step {
        let (payload, len) = wire::segment(&self.data, sent, toggle);
        self.phase = Phase::DownloadSegments { toggle, sent: sent + len };
        Step::Send(payload)
    }

    fn block_upload(&mut self, answer: wire::Payload, size: Option<u32>, has_crc: bool) -> Step {
        let declared = size.map(|size| size as usize);
        if declared.is_some_and(|size| size > self.capacity) {
            return Step::Abort(AbortCode::OUT_OF_MEMORY);
        }
        let start = wire::block_start();
        let receiver = BlockReceiver::new(self.block_size, declared.unwrap_or(self.capacity), start);
        self.phase = Phase::BlockUpload { receiver, answer, declared, has_crc };
        Step::Send(start)
    }

    /// Takes a frame while blocks of an upload are on their way.
    pub(super) fn take_block_frame(&mut self, payload: &wire::Payload) -> Step {
        let Phase::BlockUpload { receiver, answer, declared, has_crc } = &mut self.phase else { return Step::Ignore };
        let frame = wire::decode_block(payload);
        if let BlockFrame::Abort { at, code } = frame {
            let is_mine = at == self.at;
            return if is_mine {
                Step::End(SdoOutcome::Aborted { at, code, is_by_device: true })
            } else {
                Step::Ignore
            };
        }
        if receiver.is_complete() {
            let Some(end) = wire::decode_block_end(payload) else { return Step::Ignore };
            return match receiver.finish(end, *has_crc, *declared, &mut self.data) {
                Ok(()) => {
                    let len = self.data.len();
                    let outcome = SdoOutcome::Uploaded { at: self.at, len, is_size_indicated: true };
                    Step::Confirm(wire::block_end_confirmed(), outcome)
                }
                Err(code) => Step::Abort(code),
            };
        }
        // The request was repeated because its answer was late, and here is the second one.
        if receiver.is_untouched() && payload == answer {
            return Step::Ignore;
        }
        match receiver.take(frame, &mut self.data) {
            Ok(Taken::Nothing) => Step::Wait,
            Ok(Taken::Acknowledge(acknowledgement)) => Step::Send(acknowledgement),
            Err(AbortCode::TOO_LONG) if declared.is_none() => Step::Abort(AbortCode::OUT_OF_MEMORY),
            Err(code) => Step::Abort(code),
        }
    }

    /// The device says once more that the first block may come: nothing of it has arrived, unless this is only the
    /// answer to a request that was repeated.
    fn repeat_first(&mut self, now: Time) -> Step {
        match &mut self.phase {
            Phase::BlockDownload { unanswered, .. } if *unanswered > 0 => {
                *unanswered -= 1;
                Step::Ignore
            }
            Phase::BlockDownload { sender, .. } if sender.is_first_block() => {
                sender.restart(now).map_or_else(Step::Abort, |()| Step::Stream)
            }
            _ => Step::Ignore,
        }
    }

    fn acknowledge(&mut self, now: Time, acknowledged: u8, block_size: u8) -> Step {
        let Phase::BlockDownload { sender, has_crc, .. } = &mut self.phase else { return Step::Ignore };
        match sender.acknowledge(now, acknowledged, block_size, self.data.len()) {
            Ok(false) => Step::Stream,
            Ok(true) => {
                let end = wire::block_end(&self.data, *has_crc);
                self.phase = Phase::BlockDownloadEnd { has_crc: *has_crc, is_repeated: false };
                Step::Send(end)
            }
            Err(code) => Step::Abort(code),
        }
    }

    /// Returns the frame to repeat in a block transfer; nothing while the device has to acknowledge a block.
    pub(super) fn repetition(&mut self) -> Result<Option<wire::Payload>, AbortCode> {
        Ok(match &mut self.phase {
            Phase::BlockUploadInitiate => Some(wire::block_upload_request(self.at, self.block_size, SWITCH_BELOW)),
            Phase::BlockUpload { receiver, .. } => Some(receiver.on_silence()?),
            Phase::BlockDownloadInitiate { unanswered } => {
                *unanswered = unanswered.saturating_add(1);
                Some(wire::block_download_request(self.at, self.data.len()))
            }
            Phase::BlockDownloadEnd { has_crc, is_repeated } => {
                *is_repeated = true;
                Some(wire::block_end(&self.data, *has_crc))
            }
            _ => None,
        })
    }

    /// Whether the frame that makes the device write the object has been sent.
    pub(super) fn may_be_written(&self) -> bool {
        match self.phase {
            Phase::DownloadInitiate => wire::is_expedited(self.data.len()),
            Phase::DownloadSegments { sent, .. } => sent >= self.data.len(),
            Phase::BlockDownloadEnd { .. } => true,
            _ => false,
        }
    }
}
