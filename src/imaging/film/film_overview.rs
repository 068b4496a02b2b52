//! Overviews of particles on a film: all atoms of particles scatter independently, and the film has no atoms.
//!
//! An atom of a particle adds its cross section on the detector, spread over a Gaussian as wide as the probe is at its depth. The film has
//! its mean brightness everywhere. Particles lie on a plane instead of on the film's atoms, since none of these are made.
//!
//! Neglected: channelling and multiple scattering, vibrations (a twentieth of the width), interference, the grain of the film, and all
//! aberrations but defocus. tests/worlds/film.rs measures the error of these approximations.

use std::collections::BTreeMap;
use std::f64::consts::SQRT_2;

use ndarray::Array2;

use super::film_scene::FilmScene;
use crate::engine::single_scattering::cross_section_angstrom2;
use crate::error::Result;
use crate::imaging::turned_raster::TurnedRaster;
use crate::lengths;
use crate::optics::Optics;
use crate::specimen::SiteKind;

/// Standard deviation of a Gaussian with the width at half maximum of an Airy disc, in units of wavelength over semiangle.
const AIRY_SIGMA: f64 = 0.218;
/// Radius of a Gaussian's pixels in standard deviations.
const CUT: f64 = 4.0;

/// The mean intensity in each pixel of a raster, [row, column], as fraction of the beam.
///
/// # Errors
/// [`crate::Error::UnknownElement`] for an element that the tables lack.
pub fn film_overview(scene: &FilmScene, raster: &TurnedRaster) -> Result<Array2<f64>> {
    let settings = scene.simulator.settings();
    let section = |number: u8| cross_section_angstrom2(settings, number);
    let of_film = section(scene.film.number)? * 0.01 * scene.film.atoms_per_nm2;
    let mut image = Array2::from_elem(raster.shape, of_film);
    let depth = lengths::angstrom(scene.film.depth_nm[0]);
    let reach = CUT * probe_sigma(&settings.optics, 0.0).max(probe_sigma(&settings.optics, depth));
    let region = raster.region().grown(lengths::nm(reach));
    let mut sections = BTreeMap::new();
    for site in scene.specimen.particles_on_a_plane(&region).sites {
        if site.kind == SiteKind::Vacancy {
            continue;
        }
        let section = match sections.get(&site.number) {
            Some(known) => *known,
            None => *sections.entry(site.number).or_insert(section(site.number)?),
        };
        let [x, y, z] = site.position_nm;
        let sigma = probe_sigma(&settings.optics, lengths::angstrom(z));
        add_gaussian(&mut image, raster, [x, y], section, sigma);
    }
    Ok(image)
}

/// Standard deviation in Angstrom of a probe's intensity along x or y at a depth in Angstrom, from diffraction and the cone's disc.
fn probe_sigma(optics: &Optics, depth: f64) -> f64 {
    let semiangle = 1e-3 * optics.semiangle_mrad;
    let airy = AIRY_SIGMA * optics.wavelength_angstrom() / semiangle;
    // The variance of an even disc along x is a quarter of its squared radius.
    let disc = 0.5 * semiangle * (depth - optics.aberrations.defocus_angstrom());
    airy.hypot(disc)
}

/// Adds a Gaussian of this volume in square Angstrom at a place (x, y) in nm; each pixel gets the mean over its area.
fn add_gaussian(
    image: &mut Array2<f64>,
    raster: &TurnedRaster,
    place: [f64; 2],
    volume: f64,
    sigma: f64,
) {
    let pixel = raster.pixel_angstrom();
    let at = raster.place_px(place);
    let shares = |k: usize| -> (usize, Vec<f64>) {
        let reach = CUT * sigma / pixel;
        let first = (at[k] - reach + 0.5).floor().max(0.0) as usize;
        let end = (at[k] + reach + 0.5).ceil().clamp(0.0, raster.shape[k] as f64) as usize;
        let below = |edge: f64| 0.5 * libm::erf((edge - at[k]) * pixel / (SQRT_2 * sigma));
        let edges: Vec<f64> = (first..=end.max(first)).map(|n| below(n as f64 - 0.5)).collect();
        (first, edges.windows(2).map(|edges| edges[1] - edges[0]).collect())
    };
    let ((top, down), (left, across)) = (shares(0), shares(1));
    let height = volume / (pixel * pixel);
    for (i, of_y) in down.iter().enumerate() {
        for (j, of_x) in across.iter().enumerate() {
            image[[top + i, left + j]] += height * of_y * of_x;
        }
    }
}
