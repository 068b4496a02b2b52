//! Which images come along with the program, whether their files are there or not.
//!
//! How a field is imaged must not depend on what lies on a disk. So the program knows the names of the images of its library
//! (`library/`, [`super::supplied_library`]) by heart: eight bytes of a digest each, ascending.

use sha2::{Digest, Sha256};

/// `STEMGEN_UPDATE=1 cargo test --test worlds library::` renews it.
const DIGESTS: &[u8] = include_bytes!("supplied_images.bin");

/// What stands for an image in the list.
pub fn digest(material: &str, key: &str) -> [u8; 8] {
    let digest = Sha256::digest(format!("{material}/{key}"));
    std::array::from_fn(|i| digest[i])
}

/// Whether the image of a material with this name in a cache comes along.
pub fn is_supplied(material: &str, key: &str) -> bool {
    DIGESTS.as_chunks().0.binary_search(&digest(material, key)).is_ok()
}
