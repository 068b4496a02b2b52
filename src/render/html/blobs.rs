//! Byte strings within a page.

use std::io::Write;

use flate2::Compression;
use flate2::write::DeflateEncoder;

/// Deflated byte strings in base64, in the order in which the page will hold them.
#[derive(Debug, Default)]
pub(super) struct Blobs {
    texts: Vec<String>,
}

impl Blobs {
    /// Adds a byte string and returns its number.
    pub fn add(&mut self, bytes: &[u8]) -> usize {
        self.add_packed([pack(bytes)])
    }

    /// Adds what [`pack`] returned; returns the number of the first.
    pub fn add_packed(&mut self, packed: impl IntoIterator<Item = String>) -> usize {
        let first = self.texts.len();
        self.texts.extend(packed);
        first
    }

    /// Length of all in the page.
    pub fn bytes(&self) -> usize {
        self.texts.iter().map(|t| t.len() + 60).sum()
    }

    /// Writes the elements that hold them.
    pub fn append_to(&self, html: &mut String) {
        for (number, text) in self.texts.iter().enumerate() {
            *html += &format!("<script type=\"text/plain\" id=\"b{number}\">");
            *html += text;
            *html += "</script>\n";
        }
    }
}

/// Deflates (RFC 1951) and writes in base64 (RFC 4648).
pub(super) fn pack(bytes: &[u8]) -> String {
    let mut encoder = DeflateEncoder::new(Vec::new(), Compression::default());
    // Writing to memory cannot fail.
    let _ = encoder.write_all(bytes);
    base64(&encoder.finish().unwrap_or_default())
}

fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for group in bytes.chunks(3) {
        let at = |k: usize| u32::from(group.get(k).copied().unwrap_or(0)) << (16 - 8 * k);
        let word = at(0) | at(1) | at(2);
        for k in 0..4 {
            let digit = DIGITS[(word >> (18 - 6 * k)) as usize & 63];
            out.push(if k <= group.len() { char::from(digit) } else { '=' });
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_is_that_of_the_standard() {
        let cases = [
            "", "", "f", "Zg==", "fo", "Zm8=", "foo", "Zm9v", "foob", "Zm9vYg==", "fooba",
            "Zm9vYmE=",
        ];
        for pair in cases.chunks(2) {
            assert_eq!(base64(pair[0].as_bytes()), pair[1]);
        }
        assert_eq!(base64(&[0xfb, 0xff, 0xbf]), "+/+/");
    }
}
