//! Files of diffraction patterns.

mod hspy_patterns;
pub(crate) mod pattern_file;
pub(crate) mod pattern_format;
pub(crate) mod pattern_parts;
pub(crate) mod pattern_run;
mod raw_patterns;
