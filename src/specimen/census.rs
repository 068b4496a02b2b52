//! Counts the sites of a specimen in the built field.

use rayon::prelude::*;

use crate::error::Result;
use crate::progress::Progress;
use crate::recipe::region::Region;
use crate::recipe::tables::Field;
use crate::specimen::specimen_trait::Specimen;
use crate::specimen::stripes::for_each_stripe;

/// Number of samples along each axis.
const SAMPLES: usize = 8;
/// Width of a sample in nm.
const SAMPLE_NM: f64 = 2.5;

/// Estimates the number of lattice sites in the built field: the number that the specimen expects, or else a count in samples that cover
/// 400 nm2 of the field (exact where the field is not larger). The error is about 1 % where the density is even.
pub fn estimated_sites(specimen: &dyn Specimen, field: &Field) -> u64 {
    let built = field.built_region();
    if let Some(expected) = &specimen.facts().expected_sites {
        return expected.within(&built);
    }
    let extent = [built.x[1] - built.x[0], built.y[1] - built.y[0]];
    let width = SAMPLE_NM * SAMPLES as f64;
    if extent.iter().any(|e| *e <= width) {
        return specimen.query(&built).sites.len() as u64;
    }
    // Each sample lies near the middle of its cell; the small shift keeps the samples out of step with any lattice.
    let place = |k: usize, other: usize, range: [f64; 2], extent: f64| {
        let shift = 0.3 * ((k * 5 + other * 3) % SAMPLES) as f64 / SAMPLES as f64 - 0.15;
        let middle = range[0] + extent * (k as f64 + 0.5 + shift) / SAMPLES as f64;
        [middle - 0.5 * SAMPLE_NM, middle + 0.5 * SAMPLE_NM]
    };
    let count = |n: usize| {
        let (i, j) = (n % SAMPLES, n / SAMPLES);
        let x = place(i, j, built.x, extent[0]);
        let y = place(j, i, built.y, extent[1]);
        specimen.query(&Region { x, y }).sites.len() as u64
    };
    let found: u64 = (0..SAMPLES * SAMPLES).into_par_iter().map(count).sum();
    let density = found as f64 / (width * width);
    (density * extent[0] * extent[1]).round() as u64
}

/// Counts the lattice sites in the built field one by one.
///
/// # Errors
/// [`crate::Error::Interrupted`].
pub fn counted_sites(
    specimen: &dyn Specimen,
    field: &Field,
    progress: &dyn Progress,
) -> Result<u64> {
    let mut count = 0;
    for_each_stripe(specimen, field, "counting sites", progress, |stripe| {
        count += stripe.sites.sites.len() as u64;
        Ok(())
    })?;
    Ok(count)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::progress::Silent;
    use crate::recipe::{Difficulty, Recipe};
    use crate::specimen::factory::specimen;

    #[test]
    fn the_estimate_is_near_the_count() {
        for (grid, tolerance) in [([40, 10], 0.01), ([9, 9], 0.01), ([2, 3], 0.0)] {
            let recipe = Recipe::load("srtio3", Difficulty::Medium).unwrap();
            let recipe = recipe.with_grid(grid[0], grid[1]).unwrap();
            let field = recipe.field.clone();
            let specimen = specimen(&recipe.checked().unwrap()).unwrap();
            let exact = counted_sites(&*specimen, &field, &Silent).unwrap() as f64;
            let estimate = estimated_sites(&*specimen, &field) as f64;
            assert!((estimate / exact - 1.0).abs() <= tolerance, "{estimate} of {exact}");
        }
    }
}
