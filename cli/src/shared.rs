//! What other front ends share with the command line: the Python package. Not for use elsewhere; it changes without notice.

pub use super::audit_command::{imaging_of, planned};
pub use super::build_plan::DryRun;
pub use super::estimate::threads;
pub use super::hdf5_check::survive;
pub use super::pictures::{of_world, png};
pub use super::plan_report::PlanReport;
pub use super::plane_wave::{Conventional, run as plane_wave, settings as plane_wave_settings};
pub use super::recipe_args::WorldEngine;
pub use super::slips::{
    azimuth_in_degrees, check_scan, detector_in_radians, energy_in_ev, semiangle_in_radians,
};
pub use super::specimen_command::draw_specimen;
pub use super::structure_args::Prepared;
pub use super::view_picture::{ColormapName, Overlay, PictureArgs, WorldPart};
pub use anyhow::Error as CommandError;
