//! Simulation of detector images from atoms: plan, then execute.
//!
//! From the ground up:
//! - inputs: [`Settings`], [`Site`], [`Scan`], `phonons`;
//! - the plan: [`Grid`], `grid_choice`, [`Plan`], `probe_patches` (which probes share a window), [`Cost`];
//! - potentials to transmission functions: `slice_coverage`, `phase_grating`, `transmission`;
//! - waves: `stepper` (one slice after the other), `probe`, `basis` (probes expanded in fewer waves);
//! - the algorithms: `multislice`, `prism` with `prism_reduce`, `probe_tail` and `single_scattering`;
//! - [`simulate()`], `simulate_series`, [`simulate_part`] and [`ScanPart`] (shared by several processes), `simulate_places`, `lens_image`, `SourceBlur`, [`measure_speed`], [`check_memory`];
//! - `accuracy`: settings for a requested error, from a sample of probes; `direct_beam`: the beam's share that cropped probes lack.

mod accuracy;
mod basis;
mod bright_detectors;
mod coherent_tail;
mod cost;
mod detector_images;
mod direct_beam;
mod free_memory;
mod grid;
mod grid_choice;
mod lens;
mod multislice;
mod padded_box;
pub(crate) mod patterns;
mod phase_grating;
pub(crate) mod phonons;
mod plan;
mod prism;
mod prism_reduce;
mod probe;
mod probe_patches;
mod probe_raster;
mod probe_scan;
mod probe_tail;
mod probe_width;
mod scan_part;
mod series;
pub(crate) mod settings;
mod simulate;
mod single_precision;
pub(crate) mod single_scattering;
mod slice_coverage;
mod source_size;
mod speed;
mod stepper;
mod transmission;
mod workspace_pool;

pub(crate) use crate::structure::Site;
pub use accuracy::{AccuracyFound, TriedWindow, WindowChoice, settings_for_accuracy, window_for};
pub(crate) use accuracy::{ExactEngine, mean_heights};
pub use cost::Cost;
pub(crate) use cost::PlannedScan;
pub use detector_images::Images;
pub use free_memory::check_memory;
pub use grid::Grid;
pub(crate) use lens::lens_image;
pub use patterns::{
    PatternRows, PatternSettings, pattern_rows, simulate_pattern_rows, simulate_patterns,
};
pub use phonons::displaced;
pub use plan::Plan;
pub use probe_raster::ProbeRaster;
pub(crate) use probe_raster::probe_margin_angstrom;
pub use probe_scan::Scan;
pub use scan_part::{ScanPart, series_digest};
pub use series::simulate_part;
pub(crate) use series::{simulate_places, simulate_series};
pub(crate) use settings::sees_tail;
pub use settings::{
    Algorithm, BeyondLimit, DEFAULT_BAND_FRACTION, EXACT_BAND_FRACTION, Expansion, GridChoice,
    Phonons, ProbeBox, ProbeStep, Settings,
};
pub(crate) use simulate::elements;
pub use simulate::{Simulation, exit_wave, probe_exit_waves, simulate};
pub(crate) use simulate::{diffraction, has_exit_waves, mean_diffraction};
pub use single_scattering::{ScatteringMap, SingleScattering};
pub use source_size::Source;
pub(crate) use source_size::SourceBlur;
pub use speed::{Speed, measure_speed};
