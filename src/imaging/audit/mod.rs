//! Audits: they measure how far the images of an imager are from the exact ones.

pub mod column_statistics;
pub mod kept_audits;
mod options;
mod places;
pub mod power_spectrum;
pub mod region_audit;
