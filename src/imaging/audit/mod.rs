//! Audits: they measure how far the images of an imager are from the exact ones.

pub(crate) mod column_statistics;
pub(crate) mod kept_audits;
mod options;
mod places;
pub(crate) mod power_spectrum;
pub(crate) mod region_audit;
