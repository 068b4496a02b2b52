//! Upper estimates of the disk space of results.

use crate::recipe::tables::Field;
use crate::structure::Format;

/// Bytes of a pixel of a tile; noise compresses to about half of them.
const PIXEL: u64 = 4;
/// Bytes of a site in a world: 3 to 4 in a perfect crystal, 14 where no two positions are alike.
const WORLD_SITE: u64 = 16;
/// Bytes of the sub-tiles kept during a build, for each pixel; their overlaps count twice.
const SUBTILE_PIXEL: u64 = 6;
/// Bytes of a world besides pixels and sites, and of each of its tiles: the overhead of HDF5.
const WORLD: u64 = 200_000;
const TILE: u64 = 4_000;
/// Bytes of a picture of a world, at most: 1024 x 1024 pixels.
pub const PICTURE: u64 = 2_000_000;
/// Bytes of a sub-tile's file besides pixels, and of the work folder besides sub-tiles and library.
const SUBTILE: u64 = 4_200;
const WORK_FOLDER: u64 = 100_000;
/// Bytes of a site in extended XYZ and in CIF.
const XYZ_SITE: u64 = 56;
const CIF_SITE: u64 = 72;

/// Estimates the bytes of a world's file with `images` images: one for each detector, or two where the noise-free ones are stored too.
pub fn world_bytes(field: &Field, sites: u64, images: usize) -> u64 {
    let [rows, columns] = field.built_grid().map(|n| n as u64);
    let tile = (field.tile_px * field.tile_px) as u64 * PIXEL + TILE;
    WORLD + rows * columns * images as u64 * tile + sites * WORLD_SITE
}

/// Estimates the bytes of the work folder of a build with these numbers of sub-tiles and detectors, without a library.
pub fn work_bytes(field: &Field, subtiles: usize, detectors: usize) -> u64 {
    let [height, width] = field.pixels(field.built_grid()).map(|n| n as u64);
    WORK_FOLDER + height * width * detectors as u64 * SUBTILE_PIXEL + subtiles as u64 * SUBTILE
}

/// Estimates the bytes of a file of atoms.
pub fn atoms_bytes(format: Format, sites: u64) -> u64 {
    sites * if format == Format::Cif { CIF_SITE } else { XYZ_SITE }
}

/// Counts the bytes of the files in a folder and its sub-folders; 0 if there is no folder.
#[cfg(feature = "hdf5")]
pub(super) fn folder_bytes(folder: &std::path::Path) -> u64 {
    let Ok(entries) = std::fs::read_dir(folder) else { return 0 };
    let of = |entry: std::fs::DirEntry| match entry.file_type() {
        Ok(kind) if kind.is_dir() => folder_bytes(&entry.path()),
        _ => entry.metadata().map_or(0, |m| m.len()),
    };
    entries.flatten().map(of).sum()
}
