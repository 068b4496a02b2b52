//! Reads all descriptions of the first page of a TIFF.
//!
//! A page should have one description. abTEM 1.0.11 passes a description to tifffile, which adds a second, `{"shape": [6, 4]}`, and
//! decoders keep the last.

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;

const IMAGE_DESCRIPTION: u16 = 270;
const ASCII: u16 = 2;
/// Largest number of tags of a page that are read and of descriptions that are kept, and largest size of each description.
const MOST_TAGS: u64 = 4096;
const MOST_DESCRIPTIONS: usize = 8;
const MOST_BYTES: u64 = 1 << 20;

/// Returns the descriptions in the order of the file, without those that cannot be read.
pub fn all(path: &Path) -> Vec<String> {
    let mut found = Vec::new();
    // The decoder reports a file that ends too early.
    let _ = File::open(path).and_then(|file| collect(&mut BufReader::new(file), &mut found));
    found
}

/// Byte order and size of the numbers in a file.
#[derive(Clone, Copy)]
struct Layout {
    little: bool,
    /// Whether the file is BigTIFF, with offsets and counts of eight bytes.
    big: bool,
}

impl Layout {
    /// Reads a number of `bytes` bytes.
    fn number(self, input: &mut impl Read, bytes: usize) -> std::io::Result<u64> {
        let mut raw = [0_u8; 8];
        input.read_exact(&mut raw[..bytes])?;
        if !self.little {
            raw[..bytes].reverse();
        }
        Ok(u64::from_le_bytes(raw))
    }

    /// Reads an offset or a count.
    fn offset(self, input: &mut impl Read) -> std::io::Result<u64> {
        self.number(input, self.offset_bytes())
    }

    fn offset_bytes(self) -> usize {
        if self.big { 8 } else { 4 }
    }
}

fn collect(input: &mut (impl Read + Seek), found: &mut Vec<String>) -> std::io::Result<()> {
    let mut order = [0_u8; 2];
    input.read_exact(&mut order)?;
    let mut layout = Layout { little: &order == b"II", big: false };
    layout.big = layout.number(input, 2)? == 43;
    if layout.big {
        // The size of offsets, and two zero bytes.
        layout.number(input, 4)?;
    }
    let directory = layout.offset(input)?;
    input.seek(SeekFrom::Start(directory))?;
    let count = layout.number(input, if layout.big { 8 } else { 2 })?;
    for _ in 0..count.min(MOST_TAGS) {
        let tag = layout.number(input, 2)?;
        let kind = layout.number(input, 2)?;
        let length = layout.offset(input)?;
        let value = input.stream_position()?;
        let wanted = tag == u64::from(IMAGE_DESCRIPTION) && kind == u64::from(ASCII);
        if wanted && length <= MOST_BYTES && found.len() < MOST_DESCRIPTIONS {
            if length > layout.offset_bytes() as u64 {
                let place = layout.offset(input)?;
                input.seek(SeekFrom::Start(place))?;
            }
            let mut text = vec![0; length as usize];
            input.read_exact(&mut text)?;
            // ImageJ writes Latin-1.
            let text = String::from_utf8(text)
                .unwrap_or_else(|e| e.into_bytes().into_iter().map(char::from).collect());
            found.push(text.trim_end_matches('\0').to_owned());
        }
        input.seek(SeekFrom::Start(value + layout.offset_bytes() as u64))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Cursor;

    /// A directory of two descriptions: a long one, and one that fits into its tag.
    fn file(little: bool, big: bool) -> Vec<u8> {
        let number = |value: u64, bytes: usize| {
            let mut raw = value.to_le_bytes()[..bytes].to_vec();
            if !little {
                raw.reverse();
            }
            raw
        };
        let offset = if big { 8 } else { 4 };
        let mut out = if little { b"II".to_vec() } else { b"MM".to_vec() };
        out.extend(number(if big { 43 } else { 42 }, 2));
        if big {
            out.extend([number(8, 2), number(0, 2)].concat());
        }
        let directory = out.len() as u64 + offset as u64;
        out.extend(number(directory, offset));
        out.extend(number(2, if big { 8 } else { 2 }));
        let entry = 4 + 2 * offset as u64;
        let after = out.len() as u64 + 2 * entry;
        out.extend(
            [number(270, 2), number(2, 2), number(12, offset), number(after, offset)].concat(),
        );
        out.extend([number(270, 2), number(2, 2), number(3, offset)].concat());
        out.extend(b"ab\0\0\0\0\0\0"[..offset].to_vec());
        out.extend(b"twelve byte\0");
        out
    }

    #[test]
    fn both_descriptions_are_found_in_any_layout() {
        for (little, big) in [(true, false), (false, false), (true, true), (false, true)] {
            let mut found = Vec::new();
            collect(&mut Cursor::new(file(little, big)), &mut found).unwrap();
            assert_eq!(found, ["twelve byte", "ab"], "{little} {big}");
        }
    }

    #[test]
    fn damaged_directories_end_the_search() {
        let whole = file(true, false);
        for length in 0..whole.len() {
            let _ = collect(&mut Cursor::new(&whole[..length]), &mut Vec::new());
        }
        let mut huge = whole;
        huge[14..18].copy_from_slice(&u32::MAX.to_le_bytes());
        let mut found = Vec::new();
        collect(&mut Cursor::new(&huge), &mut found).unwrap();
        assert_eq!(found, ["ab"]);
    }
}
