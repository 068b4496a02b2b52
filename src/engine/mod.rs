//! Simulation of detector images from atoms: plan, then execute.

mod accuracy;
mod basis;
mod exponential;
mod images;
mod imaging;
pub mod independent;
mod multislice;
mod occupancy;
pub mod plan;
mod prism;
mod prism_reduce;
mod probe;
mod raster;
pub mod settings;
mod spare;
mod speed;
mod stepper;
mod tail;
mod transmission;
mod windows;

pub use accuracy::{WindowChoice, window_for};
pub(crate) use images::elements;
pub use images::{Images, Simulation, diffraction, exit_wave, simulate};
pub use imaging::lens_image;
pub use plan::Plan;
pub use raster::{ProbeRaster, probe_margin_angstrom};
pub use settings::{
    Algorithm, BeyondLimit, Expansion, GridChoice, Phonons, ProbeBox, ProbeStep, Settings,
};
pub use speed::{Speed, measure_speed};

pub use crate::structure::Site;

/// A rectangular raster of probe positions: `origin + (column, row) * step`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scan {
    /// Position (x, y) of the first probe in Angstrom.
    pub origin_angstrom: [f64; 2],
    /// Distance (x, y) between neighbouring probes in Angstrom.
    pub step_angstrom: [f64; 2],
    /// Number of probes (rows along y, columns along x).
    pub shape: [usize; 2],
}

impl Scan {
    /// Number of probe positions.
    pub fn len(&self) -> usize {
        self.shape[0] * self.shape[1]
    }
    /// Whether there is no probe position.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
    /// Position (x, y) of probe `index` (row-major) in Angstrom.
    pub fn position(&self, index: usize) -> [f64; 2] {
        let (row, column) = (index / self.shape[1], index % self.shape[1]);
        [
            self.origin_angstrom[0] + column as f64 * self.step_angstrom[0],
            self.origin_angstrom[1] + row as f64 * self.step_angstrom[1],
        ]
    }
}
