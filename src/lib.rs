//! stemgen simulates scanning transmission electron microscopy and generates whole simulated
//! specimens ("worlds").
//!
//! Data flows one way: recipe -> specimen -> slices -> engine -> detector image -> tiles -> file.
//! From the ground up: `setting`, `error`, `constants`, `rng`, `progress`, `files`, `fft`; `structure`,
//! `potential`; `optics`, `resample`, `detect`, `phonons`; `engine`; `io`, `render`; `world`; `validate`.

pub mod constants;
pub mod detect;
pub mod engine;
pub mod error;
pub mod fft;
pub mod files;
pub mod imaging;
pub mod io;
mod matrix;
pub mod numerics;
pub mod optics;
pub mod potential;
pub mod progress;
pub mod recipe;
#[cfg(feature = "render")]
pub mod render;
pub mod resample;
pub mod rng;
pub mod setting;
mod simd;
pub mod specimen;
pub mod structure;
#[cfg(feature = "report")]
pub mod validate;
pub mod world;

pub use error::{Error, Result};
pub use setting::Setting;
