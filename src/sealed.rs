//! Files of a version of isobar with a checksum: checkpoints, the final states of runs, and what recordings are made of.
//!
//! ```text
//! isobar checkpoint 7, version 0.1.0⏎      format and program
//! the head                                  postcard
//! length, memory                            of each method: the length in 8 bytes, little-endian
//! checksum                                  CRC-32 of all before it, 4 bytes, little-endian
//! ```

use crate::safe_file;
use crate::text::clean;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::fs::File;
use std::io::{self, BufReader, BufWriter, Read, Seek, Write};
use std::path::Path;

/// The longest first line, with room for the versions to come \[bytes\].
const LONGEST_BEGINNING: u64 = 200;

/// CRC-32 of anything that is followed by its own CRC-32, little-endian.
const RESIDUE: u32 = 0x2144_df1c;

const DAMAGED: &str = "it is damaged: its checksum is not that of its contents";

/// A kind of such files.
#[derive(Debug)]
pub struct Format {
    /// What it is called in the first line, and in messages after "a".
    pub name: &'static str,
    /// The number of its format.
    pub number: u32,
}

/// What a file holds.
#[derive(Debug)]
pub struct Contents<T> {
    /// The head.
    pub head: T,
    /// The memories of methods.
    pub memories: Vec<Vec<u8>>,
    /// The checksum.
    pub checksum: u32,
}

impl Format {
    /// Writes a durable file; each memory is made when it is its turn.
    ///
    /// # Errors
    /// Those of the file system and of the memories.
    pub fn write(
        &self,
        path: &Path,
        head: &impl Serialize,
        memories: &mut dyn Iterator<Item = io::Result<Vec<u8>>>,
    ) -> io::Result<()> {
        let head = postcard::to_stdvec(head).map_err(io::Error::other)?;
        let mut output =
            Checksummed { output: BufWriter::new(safe_file::create(path)?), checksum: crc32fast::Hasher::new() };
        output.put(format!("{}{}\n", self.beginning(), env!("CARGO_PKG_VERSION")).as_bytes())?;
        output.put(&head)?;
        for memory in memories {
            let memory = memory?;
            output.put(&(memory.len() as u64).to_le_bytes())?;
            output.put(&memory)?;
        }
        let Checksummed { mut output, checksum } = output;
        output.write_all(&checksum.finalize().to_le_bytes())?;
        output.into_inner().map_err(io::IntoInnerError::into_error)?.sync_all()
    }

    /// Reads a file.
    ///
    /// # Errors
    /// In words, if it is damaged or was written by another version.
    pub fn read<T: DeserializeOwned>(&self, path: &Path) -> Result<Contents<T>, String> {
        let words = |error: io::Error| error.to_string();
        let mut file = safe_file::open(path).map_err(words)?;
        // Only once beginning and checksum are right is memory taken: a file may be a hole of a terabyte.
        self.check(&mut file)?;
        file.rewind().map_err(words)?;
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes).map_err(words)?;
        self.parse(&bytes)
    }

    /// Whether a file begins as one of this format, and whether its checksum is right.
    fn check(&self, file: &mut File) -> Result<(), String> {
        let words = |error: io::Error| error.to_string();
        let length = file.metadata().map_err(words)?.len();
        let mut input = BufReader::with_capacity(1 << 18, file);
        let mut beginning = Vec::new();
        input.by_ref().take(LONGEST_BEGINNING).read_to_end(&mut beginning).map_err(words)?;
        self.after_first_line(&beginning)?;
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

    /// What a file of these bytes holds.
    ///
    /// # Errors
    /// As [`Format::read`].
    pub fn parse<T: DeserializeOwned>(&self, bytes: &[u8]) -> Result<Contents<T>, String> {
        let body = self.after_first_line(bytes)?;
        let damaged = || DAMAGED.to_string();
        let (contents, checksum) = bytes.split_last_chunk::<4>().ok_or_else(damaged)?;
        let checksum = u32::from_le_bytes(*checksum);
        if crc32fast::hash(contents) != checksum {
            return Err(damaged());
        }
        let body = body.split_last_chunk::<4>().ok_or_else(damaged)?.0;
        let (head, mut rest): (T, _) =
            postcard::take_from_bytes(body).map_err(|error| format!("it cannot be understood: {error}"))?;
        let mut memories = Vec::new();
        while let Some((length, after)) = rest.split_first_chunk::<8>() {
            let length = usize::try_from(u64::from_le_bytes(*length)).ok().filter(|&length| length <= after.len());
            let (memory, after) = after.split_at(length.ok_or("the memory of a method is cut off")?);
            memories.push(memory.to_vec());
            rest = after;
        }
        if rest.is_empty() {
            Ok(Contents { head, memories, checksum })
        } else {
            Err("there is something behind its end".into())
        }
    }

    /// The first line up to the version.
    fn beginning(&self) -> String {
        format!("isobar {} {}, version ", self.name, self.number)
    }

    /// What follows the first line, if that is the one of a file of this format and version.
    fn after_first_line<'a>(&self, bytes: &'a [u8]) -> Result<&'a [u8], String> {
        let name = self.name;
        let version = bytes.strip_prefix(self.beginning().as_bytes()).ok_or_else(|| {
            if bytes.starts_with(format!("isobar {name} ").as_bytes()) {
                format!("it is a {name} of another format, written by another version of isobar: begin the run anew")
            } else {
                format!("it is not a {name}")
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
