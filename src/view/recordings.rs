//! Recordings on disk as packets.

use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::pin::Pin;
use std::task::{Context, Poll};

use axum::body::{Body, Bytes};
use hyper::body::Frame;
use tokio::sync::mpsc;
use tokio::task::spawn_blocking;
use yieldwall_record::recording::{Damage, Layout, ReadError, Reader, Recorded, Recording, layout, open};

use crate::hello::{Description, RecordingMessage};
use crate::packet::Packet;

/// Records in a packet of a recording.
const RECORDS: u32 = 1024;
/// Packets that are read ahead of the client.
const AHEAD: usize = 2;

/// A recording that a server shows.
#[derive(Clone, Debug)]
pub struct RecordingFile {
    path: PathBuf,
    records: u64,
    layout: Layout,
    damage: Vec<Damage>,
    machine: Description,
}

impl RecordingFile {
    /// Opens a recording of a machine and counts its records. The server reads the file again for each client that asks for it.
    ///
    /// # Errors
    /// If the file cannot be read, or is no recording that this program can use.
    pub fn open(path: &Path, machine: Description) -> Result<Self, ReadError> {
        let mut recording = open(path)?;
        let (records, layout) = match &mut recording {
            Recording::Rig(reader) => count(reader)?,
            Recording::Device(reader) => count(reader)?,
        };
        let damage = recording.damage().to_vec();
        Ok(Self { path: path.to_owned(), records, layout, damage, machine })
    }

    /// Returns the places at which something of the file is lost.
    pub fn damage(&self) -> &[Damage] {
        &self.damage
    }

    /// Its part of the first message: its name is that of the file, and of the folder that it is in.
    pub(crate) fn message(&self) -> RecordingMessage<'_> {
        let parts: Vec<_> = self.path.iter().rev().take(2).map(|part| part.to_string_lossy()).collect();
        let name = parts.into_iter().rev().collect::<Vec<_>>().join("/");
        RecordingMessage { name, records: self.records, machine: &self.machine }
    }

    /// Returns the path.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the number of records that could be read.
    pub fn records(&self) -> u64 {
        self.records
    }

    pub(crate) fn layout(&self) -> &Layout {
        &self.layout
    }

    /// Opens the file again, and returns its records as the body of a response.
    ///
    /// # Errors
    /// As [`RecordingFile::open`], and if the file has changed its kind. An error that comes later cuts the body.
    pub(crate) async fn body(&self) -> Result<Body, ReadError> {
        let path = self.path.clone();
        let opened = spawn_blocking(move || open(&path)).await.map_err(io::Error::other)??;
        let (sender, packets) = mpsc::channel(AHEAD);
        match opened {
            Recording::Rig(reader) => self.send(reader, sender)?,
            Recording::Device(reader) => self.send(reader, sender)?,
        }
        Ok(Body::new(Packets(packets)))
    }

    fn send<R, T>(&self, mut reader: Reader<R, T>, sender: mpsc::Sender<io::Result<Bytes>>) -> Result<(), ReadError>
    where
        R: Read + Send + 'static,
        T: Recorded,
    {
        if layout::<T>() != self.layout {
            return Err(io::Error::other("holds records of another kind than before").into());
        }
        let mut packet = Packet::new(RECORDS, self.layout.stride);
        spawn_blocking(move || {
            loop {
                let is_over = match reader.next_record() {
                    Ok(Some(record)) => {
                        packet.push(&record);
                        false
                    }
                    Ok(None) => true,
                    Err(error) => {
                        let _ = sender.blocking_send(Err(io::Error::other(error)));
                        return;
                    }
                };
                if is_over || packet.count() == RECORDS {
                    let Some(bytes) = packet.take(0) else { return };
                    // An error means that the client is gone.
                    if sender.blocking_send(Ok(bytes)).is_err() || is_over {
                        return;
                    }
                }
            }
        });
        Ok(())
    }
}

fn count<R: Read, T: Recorded>(reader: &mut Reader<R, T>) -> Result<(u64, Layout), ReadError> {
    let mut records = 0;
    while reader.next_record()?.is_some() {
        records += 1;
    }
    Ok((records, layout::<T>()))
}

/// The body of a response.
struct Packets(mpsc::Receiver<io::Result<Bytes>>);

impl hyper::body::Body for Packets {
    type Data = Bytes;
    type Error = io::Error;

    fn poll_frame(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<io::Result<Frame<Bytes>>>> {
        self.0.poll_recv(context).map(|packet| packet.map(|bytes| bytes.map(Frame::data)))
    }
}
