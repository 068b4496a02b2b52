//! The image of a world as a file for HyperSpy.

use std::path::Path;

use ndarray::{Array2, Axis};

use stemgen::Result;
use stemgen::detect::Detector;
use stemgen::engine::check_memory;
use stemgen::io::{HspyFacts, ImageStack, WorldFile, create_hspy};
use stemgen::recipe::CheckedRecipe;

use super::text;

/// Ending of the name of a noise-free image.
const CLEAN: &str = "_clean";

/// Bytes of memory for each pixel of an image: the value as read, and as a fraction of the beam.
const BYTES: u64 = 8;

/// Most bytes of a file beside the pixels, for each image.
const AROUND: u64 = 1 << 16;

/// Returns the most bytes of a file with so many images of a shape [rows, columns].
pub fn most_bytes([rows, columns]: [usize; 2], images: usize) -> u64 {
    images as u64 * ((rows * columns * size_of::<f32>()) as u64 + AROUND)
}

/// Writes the images of a world as signals, in fractions of the beam (a centre of mass in mrad), to `path`, which is moved to `place` later.
/// There is one signal for each detector of the recipe, and one named `DETECTOR_clean` for each noise-free image of the world.
///
/// # Errors
/// [`stemgen::Error::Memory`] for a world that does not fit into memory; errors of reading and writing.
pub fn write_world(
    (path, place): (&Path, &Path),
    world: &WorldFile,
    recipe: &CheckedRecipe,
) -> Result<()> {
    let detectors = recipe.detector.all();
    let [rows, columns] = world.shape();
    let each = if world.has_clean() { 2 } else { 1 };
    let bytes = (rows * columns * each * detectors.len()) as u64 * BYTES;
    check_memory(bytes, "leave --hspy out: the world's own file opens in h5py, part by part")?;
    let mut images: Vec<(String, Array2<f32>, &Detector)> = Vec::new();
    for detector in &detectors {
        let own = match world.detectors().is_empty() {
            true => None,
            false => Some(world.on_detector(&detector.name)?),
        };
        let world = own.as_ref().unwrap_or(world);
        let [scale, offset] = world.metadata().scaling.unwrap_or([1.0, 0.0]);
        let fraction = |v: f32| (f64::from(v) * scale + offset) as f32;
        let image = world.stitched(0..rows, 0..columns)?.mapv_into(fraction);
        images.push((detector.name.clone(), image, detector));
        if world.has_clean() {
            let clean = world.stitched_clean(0..rows, 0..columns)?;
            images.push((format!("{}{CLEAN}", detector.name), clean, detector));
        }
    }
    let pixel = 10.0 * world.metadata().pixel_size_nm;
    let metadata = world.metadata();
    let dose = metadata.dose_electrons_per_angstrom2.filter(|_| metadata.noise == Some(true));
    let stacks: Vec<ImageStack> = images
        .iter()
        .map(|(name, image, detector)| ImageStack {
            name,
            data: image.view().insert_axis(Axis(0)),
            units: detector.units(),
            step_angstrom: [pixel; 2],
            origin_angstrom: [0.0; 2],
            thicknesses_angstrom: &[],
            defocus_angstrom: None,
            annulus_mrad: Some([detector.inner_mrad, detector.outer_mrad]),
            sector_degrees: detector.sector_degrees,
            electrons_per_pixel: dose
                .map(|dose| dose * pixel * pixel)
                .filter(|_| !name.ends_with(CLEAN)),
        })
        .collect();
    create_hspy(path, place, &stacks, &facts(recipe, dose))
}

fn facts(recipe: &CheckedRecipe, dose: Option<f64>) -> HspyFacts {
    let optics = &recipe.optics;
    HspyFacts {
        command_line: text::command_line(),
        plane_wave: false,
        energy_kev: Some(optics.energy_kv),
        semiangle_mrad: Some(optics.convergence_mrad),
        defocus_angstrom: Some(optics.defocus_angstrom),
        tilt_mrad: Some(optics.mistilt_mrad),
        dose,
        texts: vec![("recipe", recipe.to_toml())],
    }
}
