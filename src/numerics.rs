//! The version of the numerics, and the kind of processor.

/// Version of pixel values. Raise it by one with every change in the engine, in imaging or in the displacements of atoms that changes pixel
/// values by more than 1e-5 of the brightest. It is part of the key of every file that is kept on disk (the library of mosaics, the
/// sub-tiles of an interrupted build), so images of different versions never mix in one world. World files contain it. Settings of the
/// engine are part of these keys too: a change with new settings keeps old and new files apart anyway. `tests/physics/numerics.rs` holds
/// the images of this version.
pub const NUMERICS_VERSION: u32 = 10;

/// The kind of processor, as far as it affects rounding: `x86_64 V3`. Images from two kinds differ by less than 1e-5 of the brightest.
pub fn processor() -> String {
    let vectors = format!("{:?}", pulp::Arch::new());
    let vectors = vectors.split(|c: char| !c.is_alphanumeric()).next().unwrap_or_default();
    format!("{} {vectors}", std::env::consts::ARCH)
}
