//! The journal: the events of a run in their order, appended as they happen.
//!
//! After a line with the format's number come frames: length (8 bytes) and CRC-32 (4 bytes, both little-endian) of an entry
//! in postcard. The first entry is the run's [`Plan`], each other an [`Event`].

use super::Plan;
use crate::event::{Event, RunInfo};
use crate::output::SinkError;
use crate::output::directory::JOURNAL_FILE;
use crate::safe_file;
use serde::{Deserialize, Serialize};
use std::fs::File;
use std::io::{self, BufReader, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// The beginning of a journal.
const FORMAT: &[u8] = b"isobar journal 6\n";

/// The longest plan \[bytes\]: of the largest scenario with the longest options.
const LONGEST_PLAN: u64 = 10_000_000;

/// Bytes that are read at a time to check them.
const CHUNK: u64 = 1 << 16;

/// The journal of a run under way.
#[derive(Debug)]
pub struct Journal {
    path: PathBuf,
    output: BufWriter<File>,
    bytes: u64,
    frame: Vec<u8>,
}

impl Journal {
    /// Begins a journal; its plan is durable.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn create(directory: &Path, plan: &Plan) -> Result<Self, SinkError> {
        let path = directory.join(JOURNAL_FILE);
        let mut file = safe_file::create(&path).map_err(|error| failure(&path, &error))?;
        file.write_all(FORMAT).map_err(|error| failure(&path, &error))?;
        let output = BufWriter::with_capacity(1 << 18, file);
        let mut journal = Self { path, output, bytes: FORMAT.len() as u64, frame: Vec::new() };
        journal.put(plan)?;
        journal.sync()?;
        Ok(journal)
    }

    /// Continues a journal after its first bytes; what follows them is cut off.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn resume(directory: &Path, bytes: u64) -> Result<Self, SinkError> {
        let path = directory.join(JOURNAL_FILE);
        let failed = |error: io::Error| failure(&path, &error);
        let mut file = safe_file::open_to_change(&path).map_err(failed)?;
        file.set_len(bytes).map_err(failed)?;
        file.seek(SeekFrom::Start(bytes)).map_err(failed)?;
        Ok(Self { output: BufWriter::with_capacity(1 << 18, file), path, bytes, frame: Vec::new() })
    }

    /// Takes note of an event, unless the run's plan implies it.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn record(&mut self, event: &Event<'_>) -> Result<(), SinkError> {
        match event {
            Event::Started(_) | Event::Resumed(_) | Event::Warning(_) | Event::Finished(_) => Ok(()),
            _ => self.put(event),
        }
    }

    fn put(&mut self, entry: &impl Serialize) -> Result<(), SinkError> {
        self.frame.clear();
        self.frame = postcard::to_extend(entry, std::mem::take(&mut self.frame))
            .map_err(|error| SinkError { path: self.path.clone(), reason: error.to_string() })?;
        let (length, checksum) = (self.frame.len() as u64, crc32fast::hash(&self.frame));
        for bytes in [&length.to_le_bytes()[..], &checksum.to_le_bytes(), &self.frame] {
            self.output.write_all(bytes).map_err(|error| failure(&self.path, &error))?;
            self.bytes += bytes.len() as u64;
        }
        Ok(())
    }

    /// Makes everything so far durable; the length of the journal \[bytes\].
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn sync(&mut self) -> Result<u64, SinkError> {
        let written = self.output.flush().and_then(|()| self.output.get_ref().sync_data());
        written.map_err(|error| failure(&self.path, &error))?;
        Ok(self.bytes)
    }
}

/// The plan at the beginning of a journal.
///
/// # Errors
/// In words, if there is none.
pub fn plan(directory: &Path) -> Result<Plan, String> {
    let mut frames = open(directory, None)?;
    frames.left = frames.left.min(LONGEST_PLAN);
    let frame = frames.next()?.ok_or("it is empty")?;
    decode(frame)
}

/// Sends the events in the first bytes of a journal again.
///
/// # Errors
/// In words, if the journal is damaged or that of another run, or those of `send`.
pub fn replay(
    directory: &Path,
    bytes: u64,
    info: &RunInfo,
    send: &mut dyn FnMut(Event<'_>) -> Result<(), SinkError>,
) -> Result<(), String> {
    // Only once all checksums are right is memory taken: a length may be that of a hole of a terabyte.
    open(directory, Some(bytes))?.check()?;
    replay_frames(open(directory, Some(bytes))?, info, send)
}

/// As [`replay`], of the frames of a journal.
///
/// # Errors
/// As there.
pub fn replay_bytes(
    journal: &[u8],
    info: &RunInfo,
    send: &mut dyn FnMut(Event<'_>) -> Result<(), SinkError>,
) -> Result<(), String> {
    replay_frames(Frames { input: journal, left: journal.len() as u64, frame: Vec::new() }, info, send)
}

fn replay_frames(
    mut frames: Frames<impl Read>,
    info: &RunInfo,
    send: &mut dyn FnMut(Event<'_>) -> Result<(), SinkError>,
) -> Result<(), String> {
    frames.next()?;
    while let Some(frame) = frames.next()? {
        let event: Event<'_> = decode(frame)?;
        if !event.fits(info) {
            return Err("an event is not one of this run".into());
        }
        send(event).map_err(|error| error.to_string())?;
    }
    Ok(())
}

fn decode<'a, T: Deserialize<'a>>(frame: &'a [u8]) -> Result<T, String> {
    match postcard::take_from_bytes(frame) {
        Ok((entry, [])) => Ok(entry),
        Ok(_) => Err("an entry is too long".into()),
        Err(error) => Err(format!("an entry cannot be understood: {error}")),
    }
}

/// The frames of a journal, one after the other.
struct Frames<R> {
    input: R,
    left: u64,
    frame: Vec<u8>,
}

/// The frames of a journal, all or those in the first bytes.
fn open(directory: &Path, bytes: Option<u64>) -> Result<Frames<BufReader<File>>, String> {
    let mut file = safe_file::open(&directory.join(JOURNAL_FILE)).map_err(|error| error.to_string())?;
    let length = file.metadata().map_err(|error| error.to_string())?.len();
    let left = bytes.unwrap_or(length);
    if length < left {
        return Err(format!("it has {length} bytes, {left} are needed"));
    }
    let mut format = [0; FORMAT.len()];
    if file.read_exact(&mut format).is_err() || format != FORMAT {
        return Err("it is not a journal of this format: another version of isobar wrote it, begin the run anew".into());
    }
    let left = left.saturating_sub(FORMAT.len() as u64);
    Ok(Frames { input: BufReader::with_capacity(1 << 18, file), left, frame: Vec::new() })
}

impl<R: Read> Frames<R> {
    /// The length and the checksum of the next frame; `None` at the end.
    fn head(&mut self) -> Result<Option<(u64, u32)>, String> {
        if self.left == 0 {
            return Ok(None);
        }
        let (mut length, mut checksum) = ([0; 8], [0; 4]);
        let head = self.input.read_exact(&mut length).and_then(|()| self.input.read_exact(&mut checksum));
        head.map_err(|error| error.to_string())?;
        let length = u64::from_le_bytes(length);
        // No longer than the file: a damaged length must not allocate all memory.
        self.left = self.left.checked_sub(12).and_then(|left| left.checked_sub(length)).ok_or("a frame is cut off")?;
        // A hole would be read as frames without end.
        if length == 0 { Err("a frame is empty".into()) } else { Ok(Some((length, u32::from_le_bytes(checksum)))) }
    }

    fn next(&mut self) -> Result<Option<&[u8]>, String> {
        let Some((length, checksum)) = self.head()? else { return Ok(None) };
        self.frame.resize(usize::try_from(length).map_err(|error| error.to_string())?, 0);
        self.input.read_exact(&mut self.frame).map_err(|error| error.to_string())?;
        if crc32fast::hash(&self.frame) == checksum { Ok(Some(&self.frame)) } else { Err(DAMAGED.into()) }
    }

    /// Whether all checksums are right, without memory for more than a chunk.
    fn check(mut self) -> Result<(), String> {
        let mut chunk = vec![0; CHUNK as usize];
        while let Some((mut length, checksum)) = self.head()? {
            let mut of_frame = crc32fast::Hasher::new();
            while length > 0 {
                let part = &mut chunk[..length.min(CHUNK) as usize];
                self.input.read_exact(part).map_err(|error| error.to_string())?;
                of_frame.update(part);
                length -= part.len() as u64;
            }
            if of_frame.finalize() != checksum {
                return Err(DAMAGED.into());
            }
        }
        Ok(())
    }
}

const DAMAGED: &str = "it is damaged: a checksum is not that of its contents";

fn failure(path: &Path, error: &io::Error) -> SinkError {
    SinkError { path: path.to_path_buf(), reason: error.to_string() }
}
