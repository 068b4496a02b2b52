//! Images, against other programs, published numbers and each other, and what they are made of: atoms, optics, detectors, recordings.

mod accuracy;
mod acquisition;
mod anisotropic;
mod carbon;
#[path = "../common/cases.rs"]
mod cases;
#[path = "../common/mod.rs"]
mod common;
mod contamination;
mod crystals;
mod detectability;
mod detector_response;
mod engines;
mod golden;
mod numerics;
mod optics;
mod particles;
mod patterns;
mod read_right;
mod settings;
mod structure_files;
mod surface;
mod validate;
