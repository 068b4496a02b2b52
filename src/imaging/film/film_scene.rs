//! The data that the parts of the film imager share: specimen, film, engine and samples.

use std::sync::Arc;

use crate::engine::Site;
use crate::imaging::displaced_atoms::mean_atoms;
use crate::imaging::simulator::Simulator;
use crate::recipe::{CheckedRecipe, Region};
use crate::specimen::{Specimen, ThinFilm};

/// Particles on a film, and the settings of their images.
pub struct FilmScene {
    pub recipe: CheckedRecipe,
    pub specimen: Arc<dyn Specimen>,
    pub film: ThinFilm,
    /// Simulates the particles, and the film behind them.
    pub simulator: Simulator,
    pub window_angstrom: f64,
    /// Distance of samples in Angstrom; sample 0 is at pixel 0 of the full field.
    pub step: f64,
}

impl FilmScene {
    /// Atoms of a region at their mean positions, in Angstrom from its corner.
    pub fn atoms(&self, region: &Region) -> Vec<Site> {
        mean_atoms(&*self.specimen, region, &self.recipe.phonons)
    }

    /// Mean heights in Angstrom of atoms at their mean positions. The film's heights are rounded to slices of this thickness.
    pub fn heights(&self, atoms: &[Site], film_slice_angstrom: f64) -> Vec<f64> {
        let height = |s: &Site| {
            let z = s.position[2];
            let of_film = self.film.holds(s.key);
            if of_film { self.film.slice_height_angstrom(z, film_slice_angstrom) } else { z }
        };
        atoms.iter().map(height).collect()
    }
}
