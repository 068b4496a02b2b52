//! The window for a requested error: from a table ([`window_for`]), or measured on the specimen ([`settings_for_accuracy`]).

mod accuracy_found;
mod error_estimate;
mod exact_probes;
mod probe_sample;
mod settings_choice;
mod window_table;

pub use accuracy_found::{AccuracyFound, TriedWindow};
pub(crate) use exact_probes::ExactEngine;
pub(crate) use settings_choice::mean_heights;
pub use settings_choice::settings_for_accuracy;
pub use window_table::{WindowChoice, window_for};
