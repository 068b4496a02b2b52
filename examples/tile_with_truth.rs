//! Makes one tile of a world with its truth, without a file: images for training as they are needed.
//!
//!     cargo run --release -p stemgen --no-default-features --features render --example tile_with_truth [FILE.png]
//!
//! Prints the sites, columns and vacancies of a tile of SrTiO3, the counted electrons, and where the columns with vacancies lie in
//! pixels; then writes the counts as a picture, with these columns marked, to `tile.png` unless a file is named.

use std::path::Path;

use stemgen::imaging::{Cache, PixelRect};
use stemgen::progress::Silent;
use stemgen::recipe::CheckedRecipe;
use stemgen::render::{Marker, MarkerShape, Picture};
use stemgen::specimen::specimen;
use stemgen::world::{BuildOptions, ColumnTruth, field_tile};

/// Electrons per square Angstrom.
const DOSE: f64 = 2e4;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let own = std::env::args().nth(1);
    run(Path::new(own.as_deref().unwrap_or("tile.png")))
}

/// Makes a tile, prints its truth and writes the picture.
pub fn run(picture: &Path) -> Result<(), Box<dyn std::error::Error>> {
    let recipe = CheckedRecipe::load("test", None)?;
    let specimen = specimen(&recipe)?;
    let options = BuildOptions { cache: Cache::none(), ..BuildOptions::default() };
    let mut imager = options.policy(&recipe)?.imaging.imager(&recipe, &specimen)?;
    imager.prepare(&Silent)?; // once for all tiles

    // Rows and columns 40 to 168 of the field: about its left part.
    let pixels = PixelRect::new([40, 40], [128, 128]);
    let tile = field_tile(&recipe, &*specimen, &*imager, &pixels, Some(DOSE), &Silent)?;
    let counts = tile.counts.as_ref().expect("a dose was given");
    println!("{} sites in {} columns", tile.sites.len(), tile.columns.len());
    println!("{} electrons counted", counts.iter().map(|&n| u64::from(n)).sum::<u64>());

    let mut markers = Vec::new();
    let vacant = |column: &&ColumnTruth| column.vacancies > 0;
    for column in tile.columns.iter().filter(vacant) {
        let position = tile.place_px(column.position_nm.map(f64::from));
        println!("row {:6.2}, column {:6.2}: {}", position[0], position[1], column.composition());
        let (shape, color) = (MarkerShape::Circle, [255, 120, 0]);
        markers.push(Marker { position, radius: 4.0, shape, color });
    }
    let values = counts.mapv(|n| n as f32).into_raw_vec_and_offset().0;
    let mut shown = Picture::new(&values, pixels.shape)?;
    shown.pixel_angstrom = Some(10.0 * tile.pixel_nm);
    shown.markers = markers;
    shown.write_png(picture)?;
    Ok(())
}
