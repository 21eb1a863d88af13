//! Frames as text, in the log format of candump.

use std::io::{self, Write};

use yieldwall_fieldbus::canopen::Frame;
use yieldwall_fieldbus::time::Time;

/// Writes frames as lines `(seconds.micros) interface id#data`, the log format that can-utils and most analysers read.
///
/// Times are virtual and start at 0; nanoseconds are cut off.
#[derive(Debug)]
pub struct CandumpWriter<W> {
    out: W,
    interfaces: Vec<String>,
}

impl<W: Write> CandumpWriter<W> {
    /// Creates a log that names in each line one of the `interfaces`: the first for frames of the first bus ([`Frame::bus`]), and so on; a
    /// bus without one is `-`. `out` should be buffered.
    pub fn new<I: Into<String>>(out: W, interfaces: impl IntoIterator<Item = I>) -> Self {
        CandumpWriter { out, interfaces: interfaces.into_iter().map(Into::into).collect() }
    }

    /// Appends one frame.
    ///
    /// # Errors
    /// Errors of the writer.
    pub fn record(&mut self, time: Time, frame: &Frame) -> io::Result<()> {
        let micros = time.0 / 1000;
        let interface = self.interfaces.get(frame.bus().index()).map_or("-", String::as_str);
        write!(self.out, "({:010}.{:06}) {interface} {:03X}#", micros / 1_000_000, micros % 1_000_000, frame.id())?;
        if frame.is_remote() {
            write!(self.out, "R")?;
            if frame.length_code() > 0 {
                write!(self.out, "{}", frame.length_code())?;
            }
        }
        for byte in frame.data() {
            write!(self.out, "{byte:02X}")?;
        }
        writeln!(self.out)
    }

    /// Hands what was appended on to the writer's end.
    ///
    /// # Errors
    /// Errors of the writer.
    pub fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }

    /// Flushes and returns the writer.
    ///
    /// # Errors
    /// Errors of the writer.
    pub fn finish(mut self) -> io::Result<W> {
        self.out.flush()?;
        Ok(self.out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use yieldwall_fieldbus::canopen::BusId;

    #[test]
    fn lines_are_those_of_candump() {
        let mut log = CandumpWriter::new(Vec::new(), ["vcan0", "can1"]);
        log.record(Time(1_002_003_999), &Frame::new(0x181, &[0x37, 0x16, 0x00])).unwrap();
        log.record(Time(61_000_000_000), &Frame::new(0x80, &[])).unwrap();
        log.record(Time(62_000_000_000), &Frame::remote(0x705, 1)).unwrap();
        log.record(Time(63_000_000_000), &Frame::remote(0x705, 0).on_bus(BusId::new(1))).unwrap();
        let text = String::from_utf8(log.finish().unwrap()).unwrap();
        let expected = [
            "(0000000001.002003) vcan0 181#371600",
            "(0000000061.000000) vcan0 080#",
            "(0000000062.000000) vcan0 705#R1",
            "(0000000063.000000) can1 705#R",
        ];
        assert_eq!(text.lines().collect::<Vec<_>>(), expected);
    }
}
