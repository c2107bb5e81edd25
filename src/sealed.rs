//! Files of a version of isobar with a checksum: checkpoints, the final states of runs, and what recordings are made of.
//!
//! ```text
//! isobar checkpoint 8, version 0.1.0⏎      format and program
//! the head                                  postcard
//! memories                                  of the methods
//! lengths, number                           of the memories, each number in 8 bytes, little-endian
//! checksum                                  CRC-32 of all before it, 4 bytes, little-endian
//! ```

use crate::safe_file;
use crate::text::clean;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::fs::File;
use std::io::{self, BufReader, BufWriter, Cursor, Read, Seek, SeekFrom, Write};
use std::ops::Range;
use std::path::Path;

/// The longest first line, with room for the versions to come \[bytes\].
const LONGEST_BEGINNING: u64 = 200;

const DAMAGED: &str = "it is damaged: its checksum is not that of its contents";

/// A kind of such files.
#[derive(Debug)]
pub struct Format {
    /// What it is called in the first line, and in messages after "a".
    pub name: &'static str,
    /// The number of its format.
    pub number: u32,
}

/// What a file holds, or the bytes of one.
#[derive(Debug)]
pub struct Contents<T, F> {
    /// The head.
    pub head: T,
    /// The memories of methods.
    pub memories: Memories<F>,
    /// The checksum.
    pub checksum: u32,
}

/// The memories of methods, which stay in the file until they are read.
#[derive(Debug)]
pub struct Memories<F> {
    input: F,
    /// Where each of them is \[bytes\].
    places: Vec<Range<u64>>,
}

impl<F: Read + Seek> Memories<F> {
    /// How many there are.
    pub fn count(&self) -> usize {
        self.places.len()
    }

    /// One of them.
    ///
    /// # Errors
    /// Those of the file system.
    pub fn open(&mut self, number: usize) -> io::Result<impl Read> {
        let Range { start, end } = self.places[number];
        self.input.seek(SeekFrom::Start(start))?;
        Ok(BufReader::with_capacity(1 << 18, &mut self.input).take(end - start))
    }
}

impl Format {
    /// Writes a durable file with this number of memories, each of which `save` writes.
    ///
    /// # Errors
    /// Those of the file system and of the memories.
    pub fn write(
        &self,
        path: &Path,
        head: &impl Serialize,
        memories: usize,
        save: &dyn Fn(usize, &mut dyn Write) -> io::Result<()>,
    ) -> io::Result<()> {
        let output = BufWriter::new(safe_file::create(path)?);
        let mut output = Checksummed { output, checksum: crc32fast::Hasher::new(), length: 0 };
        output.write_all(format!("{}{}\n", self.beginning(), env!("CARGO_PKG_VERSION")).as_bytes())?;
        output.write_all(&postcard::to_stdvec(head).map_err(io::Error::other)?)?;
        let mut lengths = Vec::with_capacity(memories);
        for number in 0..memories {
            let before = output.length;
            save(number, &mut output)?;
            lengths.push(output.length - before);
        }
        for number in lengths.iter().copied().chain([memories as u64]) {
            output.write_all(&number.to_le_bytes())?;
        }
        let Checksummed { mut output, checksum, .. } = output;
        output.write_all(&checksum.finalize().to_le_bytes())?;
        output.into_inner().map_err(io::IntoInnerError::into_error)?.sync_all()
    }

    /// Reads a file but for the memories.
    ///
    /// # Errors
    /// In words, if it is damaged or was written by another version.
    pub fn read<T: DeserializeOwned>(&self, path: &Path) -> Result<Contents<T, File>, String> {
        self.read_from(safe_file::open(path).map_err(in_words)?)
    }

    /// What a file of these bytes holds.
    ///
    /// # Errors
    /// As [`Format::read`].
    pub fn parse<'a, T: DeserializeOwned>(&self, bytes: &'a [u8]) -> Result<Contents<T, Cursor<&'a [u8]>>, String> {
        self.read_from(Cursor::new(bytes))
    }

    fn read_from<T: DeserializeOwned, F: Read + Seek>(&self, mut input: F) -> Result<Contents<T, F>, String> {
        // Only once beginning and checksum are right is memory taken: a file may be a hole of a terabyte.
        let Checked { begin, end, checksum } = self.check(&mut input)?;
        let cut_off = || "the memory of a method is cut off".to_string();
        let mut number_before = |end: u64| -> Result<u64, String> {
            let place = end.checked_sub(8).filter(|&place| place >= begin).ok_or_else(cut_off)?;
            let mut bytes = [0; 8];
            input.seek(SeekFrom::Start(place)).and_then(|_| input.read_exact(&mut bytes)).map_err(in_words)?;
            Ok(u64::from_le_bytes(bytes))
        };
        let count = number_before(end)?;
        let table = count.checked_mul(8).and_then(|bytes| (end - 8).checked_sub(bytes)).ok_or_else(cut_off)?;
        let (mut places, mut last) = (Vec::new(), table);
        for number in (0..count).rev() {
            let length = number_before(table + 8 * (number + 1))?;
            let first = last.checked_sub(length).filter(|&first| first >= begin).ok_or_else(cut_off)?;
            places.push(first..last);
            last = first;
        }
        places.reverse();
        let mut head = Vec::new();
        input.seek(SeekFrom::Start(begin)).map_err(in_words)?;
        input.by_ref().take(last - begin).read_to_end(&mut head).map_err(in_words)?;
        match postcard::take_from_bytes(&head) {
            Ok((head, [])) => Ok(Contents { head, memories: Memories { input, places }, checksum }),
            Ok(_) => Err("there is something behind its end".into()),
            Err(error) => Err(format!("it cannot be understood: {error}")),
        }
    }

    /// Fails unless it begins as one of this format and its checksum is right.
    fn check(&self, input: &mut (impl Read + Seek)) -> Result<Checked, String> {
        let length = input.seek(SeekFrom::End(0)).map_err(in_words)?;
        input.rewind().map_err(in_words)?;
        let mut input = BufReader::with_capacity(1 << 18, input);
        let mut beginning = Vec::new();
        input.by_ref().take(LONGEST_BEGINNING).read_to_end(&mut beginning).map_err(in_words)?;
        let begin = (beginning.len() - self.after_first_line(&beginning)?.len()) as u64;
        let end = length.checked_sub(4).filter(|&end| end >= begin).ok_or(DAMAGED)?;
        let (mut of_contents, mut chunk) = (crc32fast::Hasher::new(), vec![0; 1 << 16]);
        input.rewind().map_err(in_words)?;
        let mut left = end;
        while left > 0 {
            let part = &mut chunk[..left.min(1 << 16) as usize];
            input.read_exact(part).map_err(in_words)?;
            of_contents.update(part);
            left -= part.len() as u64;
        }
        let mut last = [0; 4];
        input.read_exact(&mut last).map_err(in_words)?;
        let checksum = u32::from_le_bytes(last);
        if of_contents.finalize() == checksum { Ok(Checked { begin, end, checksum }) } else { Err(DAMAGED.into()) }
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

/// Where the contents of a file are, whose checksum is right.
struct Checked {
    /// Behind the first line \[bytes\].
    begin: u64,
    /// Before the checksum \[bytes\].
    end: u64,
    checksum: u32,
}

fn in_words(error: io::Error) -> String {
    error.to_string()
}

/// An output, and the checksum of what went into it.
struct Checksummed<W> {
    output: W,
    checksum: crc32fast::Hasher,
    /// Bytes so far.
    length: u64,
}

impl<W: Write> Write for Checksummed<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.output.write(bytes)?;
        self.checksum.update(&bytes[..written]);
        self.length += written as u64;
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.output.flush()
    }
}
