//! Byte strings within a page.

use std::io::Write;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
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
    STANDARD.encode(encoder.finish().unwrap_or_default())
}
