//! stemgen simulates scanning transmission electron microscopy and generates whole simulated
//! specimens ("worlds").
//!
//! Data flows one way: recipe -> specimen -> slices -> engine -> detector image -> tiles -> file.
//! A module uses only those above it in this list.

pub mod engine;
pub mod error;
pub mod io;
pub mod progress;
pub mod rng;
pub mod structure;
pub mod world;

pub use error::{Error, Result};
