//! Computes checksums of whole files.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use sha2::{Digest, Sha256};

use crate::error::{Error, Result};

/// Number of bytes that are read at a time.
const BLOCK: usize = 1 << 20;

/// Returns the SHA-256 of a file as hexadecimal text, and its size in bytes.
///
/// # Errors
/// [`Error::Io`].
pub fn sha256_of_file(path: &Path) -> Result<(String, u64)> {
    let read = || -> std::io::Result<(String, u64)> {
        let (mut file, mut hasher, mut size) = (File::open(path)?, Sha256::new(), 0);
        let mut block = vec![0; BLOCK];
        loop {
            let n = file.read(&mut block)?;
            if n == 0 {
                return Ok((hexadecimal(&hasher.finalize()), size));
            }
            hasher.update(&block[..n]);
            size += n as u64;
        }
    };
    read().map_err(|e| Error::io(path, "read", e))
}

/// Returns the SHA-256 of some bytes as hexadecimal text.
pub(crate) fn sha256_of_bytes(bytes: &[u8]) -> String {
    hexadecimal(&Sha256::digest(bytes))
}

fn hexadecimal(digest: &[u8]) -> String {
    digest.iter().map(|b| format!("{b:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_checksum_is_that_of_the_standard() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("abc");
        std::fs::write(&path, "abc").unwrap();
        let expected = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(sha256_of_file(&path).unwrap(), (expected.to_owned(), 3));
        assert_eq!(sha256_of_bytes(b"abc"), expected);
    }
}
