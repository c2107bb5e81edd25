//! The file of a checkpoint: written beside its place and renamed, so that it is there complete or not at all.
//!
//! ```text
//! isobar checkpoint 4, version 0.1.0⏎      format and program
//! the checkpoint                            postcard
//! length, memory                            of each method: the length in 8 bytes, little-endian
//! checksum                                  CRC-32 of all before it, 4 bytes, little-endian
//! ```

use super::{Checkpoint, Plan};
use crate::output::SinkError;
use crate::output::directory::{CHECKPOINT_PREFIX, checkpoints};
use crate::safe_file::{self, sync_directory};
use crate::text::clean;
use std::fs::{self, File};
use std::io::{self, BufReader, BufWriter, Read, Seek, Write};
use std::path::{Path, PathBuf};

/// The beginning of checkpoints of this format.
const FORMAT: &str = "isobar checkpoint 4, version ";

/// The beginning of checkpoints of any format; the number of the format follows.
const ANY_FORMAT: &str = "isobar checkpoint ";

/// The longest first line, with room for the versions to come \[bytes\].
const LONGEST_BEGINNING: u64 = 200;

/// CRC-32 of anything that is followed by its own CRC-32, little-endian.
const RESIDUE: u32 = 0x2144_df1c;

const DAMAGED: &str = "it is damaged: its checksum is not that of its contents";

/// How many checkpoints are kept.
const KEPT: usize = 2;

/// Writes a checkpoint and removes those that are no longer needed.
///
/// # Errors
/// If it cannot be written; those that were there are as they were.
pub fn write(directory: &Path, checkpoint: &Checkpoint, memories: &[Vec<u8>]) -> Result<(), SinkError> {
    let path = directory.join(format!("{CHECKPOINT_PREFIX}{:010}", checkpoint.cycle));
    let temporary = path.with_extension("new");
    let head = postcard::to_stdvec(checkpoint).map_err(|error| failure(&path, &error))?;
    let written = write_new(&temporary, &head, memories)
        .and_then(|()| fs::rename(&temporary, &path))
        .and_then(|()| sync_directory(directory));
    if let Err(error) = written {
        let _ = fs::remove_file(&temporary);
        return Err(failure(&path, &error));
    }
    for (_, old) in checkpoints(directory).into_iter().skip(KEPT) {
        // One more than needed does no harm.
        let _ = fs::remove_file(old);
    }
    Ok(())
}

fn write_new(path: &Path, head: &[u8], memories: &[Vec<u8>]) -> io::Result<()> {
    let mut output =
        Checksummed { output: BufWriter::new(safe_file::create(path)?), checksum: crc32fast::Hasher::new() };
    output.put(format!("{FORMAT}{}\n", env!("CARGO_PKG_VERSION")).as_bytes())?;
    output.put(head)?;
    for memory in memories {
        output.put(&(memory.len() as u64).to_le_bytes())?;
        output.put(memory)?;
    }
    let Checksummed { mut output, checksum } = output;
    output.write_all(&checksum.finalize().to_le_bytes())?;
    output.into_inner().map_err(io::IntoInnerError::into_error)?.sync_all()
}

/// An output, and the checksum of what went into it.
struct Checksummed<W> {
    output: W,
    checksum: crc32fast::Hasher,
}

impl<W: Write> Checksummed<W> {
    fn put(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.checksum.update(bytes);
        self.output.write_all(bytes)
    }
}

/// Gives a checkpoint that cannot be used another name.
pub fn put_aside(path: &Path) {
    let name = path.file_name().unwrap_or_default().to_string_lossy().replace(CHECKPOINT_PREFIX, "damaged-");
    // If that fails, it is only read and refused again.
    let _ = fs::rename(path, path.with_file_name(name));
}

/// Reads a checkpoint.
///
/// # Errors
/// In words, if it is damaged or was written by another version.
pub fn read(path: &Path) -> Result<(Checkpoint, Vec<Vec<u8>>), String> {
    let words = |error: io::Error| error.to_string();
    let mut file = safe_file::open(path).map_err(words)?;
    // Only once beginning and checksum are right is memory taken: a file may be a hole of a terabyte.
    check(&mut file)?;
    file.rewind().map_err(words)?;
    let mut bytes = Vec::new();
    file.read_to_end(&mut bytes).map_err(words)?;
    parse(&bytes)
}

/// Whether a file begins as a checkpoint, and whether its checksum is right.
fn check(file: &mut File) -> Result<(), String> {
    let words = |error: io::Error| error.to_string();
    let length = file.metadata().map_err(words)?.len();
    let mut input = BufReader::with_capacity(1 << 18, file);
    let mut beginning = Vec::new();
    input.by_ref().take(LONGEST_BEGINNING).read_to_end(&mut beginning).map_err(words)?;
    after_first_line(&beginning)?;
    let mut checksum = crc32fast::Hasher::new();
    checksum.update(&beginning);
    // Of the last four bytes too: the checksum of a text and its checksum is always the same.
    let mut chunk = vec![0; 1 << 16];
    let mut left = length.saturating_sub(beginning.len() as u64);
    while left > 0 {
        let part = &mut chunk[..left.min(1 << 16) as usize];
        input.read_exact(part).map_err(words)?;
        checksum.update(part);
        left -= part.len() as u64;
    }
    if checksum.finalize() == RESIDUE { Ok(()) } else { Err(DAMAGED.into()) }
}

/// A checkpoint from the bytes of its file.
///
/// # Errors
/// As [`read`].
pub fn parse(bytes: &[u8]) -> Result<(Checkpoint, Vec<Vec<u8>>), String> {
    let body = after_first_line(bytes)?;
    let damaged = || DAMAGED.to_string();
    let (contents, checksum) = bytes.split_last_chunk::<4>().ok_or_else(damaged)?;
    if crc32fast::hash(contents) != u32::from_le_bytes(*checksum) {
        return Err(damaged());
    }
    let body = body.split_last_chunk::<4>().ok_or_else(damaged)?.0;
    let (checkpoint, mut rest): (Checkpoint, _) =
        postcard::take_from_bytes(body).map_err(|error| format!("it cannot be understood: {error}"))?;
    let mut memories = Vec::new();
    while let Some((length, after)) = rest.split_first_chunk::<8>() {
        let length = usize::try_from(u64::from_le_bytes(*length)).ok().filter(|&length| length <= after.len());
        let (memory, after) = after.split_at(length.ok_or("the memory of a method is cut off")?);
        memories.push(memory.to_vec());
        rest = after;
    }
    if rest.is_empty() { Ok((checkpoint, memories)) } else { Err("there is something behind its end".into()) }
}

/// What follows the first line, if that is the one of a checkpoint of this version.
fn after_first_line(bytes: &[u8]) -> Result<&[u8], String> {
    let version = bytes.strip_prefix(FORMAT.as_bytes()).ok_or_else(|| {
        if bytes.starts_with(ANY_FORMAT.as_bytes()) {
            "it is a checkpoint of another format, written by another version of isobar: begin the run anew".to_string()
        } else {
            "it is not a checkpoint".to_string()
        }
    })?;
    let end = version.iter().take(100).position(|&byte| byte == b'\n').ok_or("its first line has no end")?;
    let (own, version) = (env!("CARGO_PKG_VERSION"), version.split_at(end));
    if version.0 != own.as_bytes() {
        let version = clean(&String::from_utf8_lossy(version.0));
        return Err(format!("it was written by isobar {version}, and this is isobar {own}"));
    }
    Ok(&version.1[1..])
}

/// The newest checkpoint that can be used, and those that cannot.
pub struct Newest {
    /// The checkpoint.
    pub checkpoint: Checkpoint,
    /// The methods' memories.
    pub memories: Vec<Vec<u8>>,
    /// The newer ones, and why they cannot be used.
    pub damaged: Vec<(PathBuf, String)>,
}

/// Finds the newest checkpoint of a run in its working directory.
///
/// # Errors
/// In words, if none can be used.
pub fn newest(working: &Path, plan: &Plan) -> Result<Newest, String> {
    let mut damaged = Vec::new();
    for (_, path) in checkpoints(working) {
        match read(&path).and_then(|(checkpoint, memories)| match plan.difference(&checkpoint.plan) {
            None => Ok((checkpoint, memories)),
            Some(difference) => Err(difference),
        }) {
            Ok((checkpoint, memories)) => return Ok(Newest { checkpoint, memories, damaged }),
            Err(reason) => damaged.push((path, reason)),
        }
    }
    let reasons = damaged
        .iter()
        .map(|(path, reason)| format!("{}: {reason}", clean(&path.file_name().unwrap_or_default().to_string_lossy())));
    Err(format!("no checkpoint can be used ({})", reasons.collect::<Vec<_>>().join("; ")))
}

fn failure(path: &Path, error: &dyn std::fmt::Display) -> SinkError {
    SinkError { path: path.to_path_buf(), reason: error.to_string() }
}
