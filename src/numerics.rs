//! The version of the numerics, and the kind of processor.

/// Raise this by one with every change that changes pixel values by more than 1e-5 of the brightest: in the engine, in
/// imaging, in the displacements of atoms. It is part of the key of everything that is kept on disk (the library of mosaics,
/// the sub-tiles of an interrupted build), so images of different versions never meet in one world, and it stands in world
/// files. Settings of the engine are part of these keys too: where a change comes with other settings, old and new do not meet anyway. `tests/physics/numerics.rs` holds the images of this version.
pub const NUMERICS_VERSION: u32 = 10;

/// The kind of processor, as far as it decides how results are rounded: `x86_64 V3`. Images of two kinds differ by less than 1e-5 of
/// the brightest.
pub fn processor() -> String {
    let vectors = format!("{:?}", pulp::Arch::new());
    let vectors = vectors.split(|c: char| !c.is_alphanumeric()).next().unwrap_or_default();
    format!("{} {vectors}", std::env::consts::ARCH)
}
