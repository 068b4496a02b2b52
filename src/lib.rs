//! stemgen simulates scanning transmission electron microscopy and generates whole simulated
//! specimens ("worlds").
//!
//! Data flows one way: recipe -> specimen -> slices -> engine -> detector image -> tiles -> file.
//! From the ground up: `error`, `constants`, `rng`, `progress`, `atomic`, `disk`, `fft`; `structure`,
//! `potential`; `optics`, `resample`, `detect`; `engine`; `io`, `render`; `world`; `validate`.

pub mod atomic;
pub mod constants;
pub mod detect;
pub mod disk;
pub mod engine;
pub mod error;
pub mod fft;
pub mod io;
mod matrix;
pub mod optics;
pub mod potential;
pub mod progress;
pub mod render;
pub mod resample;
pub mod rng;
mod simd;
pub mod structure;
pub mod validate;
pub mod world;

pub use error::{Error, Result};
