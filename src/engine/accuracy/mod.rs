//! The window for a requested error: from a table ([`window_for`]), or measured on the specimen ([`settings_for_accuracy`]).

mod error_estimate;
mod exact_probes;
mod probe_sample;
mod settings_choice;
mod window_table;

pub use exact_probes::ExactEngine;
pub use settings_choice::{AccuracyFound, TriedWindow, mean_heights, settings_for_accuracy};
pub(super) use window_table::LEAST_INNER_SEMIANGLES;
pub use window_table::{WindowChoice, window_for};
