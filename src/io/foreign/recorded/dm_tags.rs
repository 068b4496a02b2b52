//! Reads the tags of DigitalMicrograph's files: DM3 and DM4, as described by C. B. Boothroyd ("Digital Micrograph file format", Nanyang
//! Technological University) and G. Jefferis (the DM3 page of ImageJ); Gatan publishes no description.
//!
//! A file is a tree of named groups. Numbers that describe tags are big-endian, with 8 bytes in DM4 where DM3 has 4; values have the byte
//! order that the header of the file gives. Values of arrays are only read on request.

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use crate::error::{Error, Result};

/// Largest depth of nested groups.
const DEEPEST: usize = 64;
/// Largest number of tags in a file.
const MOST_TAGS: u64 = 1 << 20;
/// Largest number of numbers that describe the type of one value.
const MOST_TYPE_NUMBERS: u64 = 1 << 12;
/// Largest number of letters in a text.
const LONGEST_TEXT: u64 = 1 << 12;
/// Number of bytes of the shortest tag.
const SHORTEST_TAG: u64 = 3;

/// Result with the reason for which a file is refused.
pub(super) type Tagged<T> = std::result::Result<T, String>;

/// A tag.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum DmTag {
    /// Tags with their names, which may be empty.
    Group(Vec<(String, DmTag)>),
    /// A single number.
    Number(f64),
    /// Many numbers.
    Array(DmArray),
    /// A record, or a type that this program does not use.
    Other,
}

/// Place of an array's numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct DmArray {
    /// Code of the type of a number; 0 for records.
    pub code: u64,
    /// Number of bytes of an entry.
    pub entry_bytes: u64,
    /// Number of entries.
    pub count: u64,
    /// Offset of the first entry in the file.
    pub at: u64,
}

impl DmTag {
    /// Returns the tag at the end of a path of names; `#2` is the third tag of a group.
    pub fn get(&self, path: &[&str]) -> Option<&DmTag> {
        let Some((name, rest)) = path.split_first() else { return Some(self) };
        let DmTag::Group(tags) = self else { return None };
        let found = match name.strip_prefix('#') {
            Some(number) => tags.get(number.parse::<usize>().ok()?),
            None => tags.iter().find(|(own, _)| own == name),
        };
        found?.1.get(rest)
    }

    /// Returns the number at the end of a path.
    pub fn number(&self, path: &[&str]) -> Option<f64> {
        match self.get(path)? {
            DmTag::Number(number) => Some(*number),
            _ => None,
        }
    }

    /// Returns the tags of a group, without their names.
    pub fn entries(&self) -> impl Iterator<Item = &DmTag> {
        let tags = match self {
            DmTag::Group(tags) => tags.as_slice(),
            _ => &[],
        };
        tags.iter().map(|(_, tag)| tag)
    }
}

/// A file, open for reading.
pub(super) struct DmFile {
    from: BufReader<File>,
    bytes: u64,
    at: u64,
    /// Whether it is DM4.
    pub is_dm4: bool,
    big_endian: bool,
    tags: u64,
}

impl DmFile {
    /// Opens a file and reads its header.
    pub fn open(path: &Path) -> Result<Self> {
        let file = File::open(path).map_err(|e| Error::io(path, "read", e))?;
        let bytes = file.metadata().map_err(|e| Error::io(path, "read", e))?.len();
        let from = BufReader::new(file);
        let mut dm = DmFile { from, bytes, at: 0, is_dm4: false, big_endian: false, tags: 0 };
        dm.head().map_err(|reason| dm.refused(path, &reason))?;
        Ok(dm)
    }

    /// Returns an error about this file.
    pub fn refused(&self, path: &Path, reason: &str) -> Error {
        let name = if self.is_dm4 { "DM4" } else { "DM3" };
        Error::parse(path, 0, format!("is no readable {name} file: {reason}"))
    }

    fn head(&mut self) -> Tagged<()> {
        self.is_dm4 = match self.big(4)? {
            3 => false,
            4 => true,
            other => return Err(format!("its version is {other}, expected 3 or 4")),
        };
        // The length of the file, which is ignored: programs that write it count differently.
        self.size()?;
        self.big_endian = match self.big(4)? {
            0 => true,
            1 => false,
            other => return Err(format!("the order of its bytes is {other}, expected 0 or 1")),
        };
        Ok(())
    }

    /// Reads all tags.
    pub fn tree(&mut self) -> Tagged<DmTag> {
        self.group(0)
    }

    fn group(&mut self, depth: usize) -> Tagged<DmTag> {
        if depth > DEEPEST {
            return Err(format!("it has groups more than {DEEPEST} deep in each other"));
        }
        // Flags for sorted and open groups, which are ignored.
        self.big(2)?;
        let count = self.size()?;
        self.tags = self.tags.saturating_add(count);
        if count > self.left() / SHORTEST_TAG || self.tags > MOST_TAGS {
            return Err(format!(
                "a group announces {count} tags at byte {}, where {} bytes are left",
                self.at,
                self.left()
            ));
        }
        let mut tags = Vec::new();
        for _ in 0..count {
            tags.push(self.entry(depth)?);
        }
        Ok(DmTag::Group(tags))
    }

    fn entry(&mut self, depth: usize) -> Tagged<(String, DmTag)> {
        let kind = self.big(1)?;
        let length = self.big(2)?;
        let mut name = vec![0; length as usize];
        self.fill(&mut name)?;
        if self.is_dm4 {
            // Number of bytes of the tag.
            self.size()?;
        }
        let tag = match kind {
            20 => self.group(depth + 1)?,
            21 => self.data()?,
            other => {
                return Err(format!(
                    "a tag is of kind {other} at byte {}, expected 20 or 21",
                    self.at
                ));
            }
        };
        Ok((String::from_utf8_lossy(&name).into_owned(), tag))
    }

    fn data(&mut self) -> Tagged<DmTag> {
        let mut mark = [0; 4];
        self.fill(&mut mark)?;
        let count = self.size()?;
        if mark != *b"%%%%" || count == 0 || count > MOST_TYPE_NUMBERS {
            return Err(format!("a value has no type at byte {}", self.at));
        }
        let mut numbers = Vec::new();
        for _ in 0..count {
            numbers.push(self.size()?);
        }
        let bytes = bytes_of(&numbers, 0)?;
        if bytes > self.left() {
            return Err(format!(
                "a value announces {bytes} bytes at byte {}, where {} are left; the file is damaged or truncated",
                self.at,
                self.left()
            ));
        }
        if let [20, entry @ .., count] = &numbers[..] {
            let entry_bytes = bytes_of(entry, 0)?;
            let code = if entry.len() == 1 { entry[0] } else { 0 };
            let array = DmArray { code, entry_bytes, count: *count, at: self.at };
            self.skip(bytes)?;
            return Ok(DmTag::Array(array));
        }
        match numbers[..] {
            [code] => {
                let mut value = vec![0; bytes as usize];
                self.fill(&mut value)?;
                Ok(number_of(code, &value, self.big_endian).map_or(DmTag::Other, DmTag::Number))
            }
            _ => {
                self.skip(bytes)?;
                Ok(DmTag::Other)
            }
        }
    }

    /// Reads a text, which is an array of UTF-16 letters.
    pub fn text(&mut self, tag: Option<&DmTag>) -> Option<String> {
        let Some(DmTag::Array(DmArray { code: 4, count, at, .. })) = tag else { return None };
        if *count > LONGEST_TEXT {
            return None;
        }
        let bytes = self.part(*at, 2 * *count).ok()?;
        let order = if self.big_endian { u16::from_be_bytes } else { u16::from_le_bytes };
        let letters: Vec<u16> = bytes.chunks_exact(2).map(|b| order([b[0], b[1]])).collect();
        Some(String::from_utf16_lossy(&letters).trim_end_matches('\0').to_owned())
    }

    /// Reads `bytes` bytes at an offset.
    pub fn part(&mut self, at: u64, bytes: u64) -> Tagged<Vec<u8>> {
        if at.checked_add(bytes).is_none_or(|end| end > self.bytes) {
            return Err("a value lies beyond its end".into());
        }
        self.from.seek(SeekFrom::Start(at)).map_err(|e| e.to_string())?;
        self.at = at;
        let mut part = vec![0; bytes as usize];
        self.fill(&mut part)?;
        Ok(part)
    }

    /// Whether the high bytes of values come first.
    pub fn big_endian(&self) -> bool {
        self.big_endian
    }

    fn left(&self) -> u64 {
        self.bytes.saturating_sub(self.at)
    }

    fn skip(&mut self, bytes: u64) -> Tagged<()> {
        // The bytes were checked to lie in the file, whose length fits into the type.
        self.from.seek_relative(bytes as i64).map_err(|e| e.to_string())?;
        self.at += bytes;
        Ok(())
    }

    /// Reads a length: 4 bytes in DM3, 8 in DM4.
    fn size(&mut self) -> Tagged<u64> {
        self.big(if self.is_dm4 { 8 } else { 4 })
    }

    /// Reads a big-endian number of `bytes` bytes.
    fn big(&mut self, bytes: usize) -> Tagged<u64> {
        let mut word = [0; 8];
        self.fill(&mut word[8 - bytes..])?;
        Ok(u64::from_be_bytes(word))
    }

    fn fill(&mut self, out: &mut [u8]) -> Tagged<()> {
        self.from.read_exact(out).map_err(|_| format!("it ends at byte {}", self.bytes))?;
        self.at += out.len() as u64;
        Ok(())
    }
}

/// Returns the number of bytes of a value whose type these numbers describe.
fn bytes_of(numbers: &[u64], depth: usize) -> Tagged<u64> {
    let unknown = || {
        format!("a value has the type {:?}, which is not known", &numbers[..numbers.len().min(8)])
    };
    if depth > DEEPEST {
        return Err(unknown());
    }
    match numbers {
        [code] => scalar_bytes(*code).ok_or_else(unknown),
        [18, length] => Ok(*length),
        [15, _, fields, rest @ ..] => {
            let pairs = rest.chunks_exact(2);
            if rest.len() as u64 != fields.saturating_mul(2) {
                return Err(unknown());
            }
            let sizes = pairs.map(|pair| scalar_bytes(pair[1]).ok_or_else(unknown));
            sizes.sum()
        }
        [20, entry @ .., count] if !entry.is_empty() => {
            let entry = bytes_of(entry, depth + 1)?;
            entry.checked_mul(*count).ok_or_else(unknown)
        }
        _ => Err(unknown()),
    }
}

/// Returns the number of bytes of a number.
fn scalar_bytes(code: u64) -> Option<u64> {
    match code {
        8..=10 => Some(1),
        2 | 4 => Some(2),
        3 | 5 | 6 => Some(4),
        7 | 11 | 12 => Some(8),
        _ => None,
    }
}

fn number_of(code: u64, bytes: &[u8], big_endian: bool) -> Option<f64> {
    let mut word = [0; 8];
    for (k, byte) in bytes.iter().enumerate() {
        word[if big_endian { bytes.len() - 1 - k } else { k }] = *byte;
    }
    let raw = u64::from_le_bytes(word);
    Some(match code {
        2 => f64::from(raw as u16 as i16),
        3 => f64::from(raw as u32 as i32),
        4 | 5 | 8 | 10 | 12 => raw as f64,
        6 => f64::from(f32::from_bits(raw as u32)),
        7 => f64::from_bits(raw),
        9 => f64::from(raw as u8 as i8),
        11 => raw as i64 as f64,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn types_have_their_sizes() {
        assert_eq!(bytes_of(&[20, 4, 5], 0), Ok(10));
        assert_eq!(bytes_of(&[15, 0, 2, 0, 7, 0, 3], 0), Ok(12));
        assert_eq!(bytes_of(&[20, 15, 0, 2, 0, 2, 0, 2, 3], 0), Ok(12));
        for bad in [&[][..], &[1], &[20, 4], &[15, 0, 3, 0, 7], &[20, 7, u64::MAX], &[99]] {
            assert!(bytes_of(bad, 0).is_err(), "{bad:?}");
        }
    }

    #[test]
    fn numbers_have_their_signs_and_orders() {
        assert_eq!(number_of(2, &(-3_i16).to_le_bytes(), false), Some(-3.0));
        assert_eq!(number_of(6, &0.5_f32.to_be_bytes(), true), Some(0.5));
        assert_eq!(number_of(11, &(-4_i64).to_be_bytes(), true), Some(-4.0));
        assert_eq!(number_of(15, &[], true), None);
    }
}
