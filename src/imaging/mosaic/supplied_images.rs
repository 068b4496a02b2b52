//! The list of supplied images, independent of the files on this machine.
//!
//! The method by which a field is imaged must not depend on the contents of a disk. So the program contains the names of the images of its
//! library (`library/`, `supplied_library`) as digests of eight bytes each, ascending.

use sha2::{Digest, Sha256};

/// The digests. `STEMGEN_UPDATE=1 cargo test --test worlds library::` renews them.
const DIGESTS: &[u8] = include_bytes!("supplied_images.bin");

/// The digest of an image in the list.
pub fn digest(material: &str, key: &str) -> [u8; 8] {
    let digest = Sha256::digest(format!("{material}/{key}"));
    std::array::from_fn(|i| digest[i])
}

/// Whether the image of a material with this name in a cache is in the supplied library.
pub(crate) fn is_supplied(material: &str, key: &str) -> bool {
    DIGESTS.as_chunks().0.binary_search(&digest(material, key)).is_ok()
}
