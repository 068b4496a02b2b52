//! Converts words from Python to values of the library.

use crate::errors::Fault;
use pyo3::prelude::*;
use stemgen::Setting;
use stemgen::engine::Expansion;

/// A word or a number.
#[derive(FromPyObject)]
pub enum WordOrNumber {
    #[pyo3(transparent)]
    Number(f64),
    #[pyo3(transparent)]
    Word(String),
}

fn refuse<T>(setting: Setting, value: impl ToString, expected: &str) -> Result<T, Fault> {
    Err(Fault::Value(setting, value.to_string(), expected.to_owned()))
}

/// Returns the value of a word.
pub fn choice<T: Copy>(setting: Setting, word: &str, known: &[(&str, T)]) -> Result<T, Fault> {
    match known.iter().find(|(name, _)| *name == word) {
        Some((_, value)) => Ok(*value),
        None => {
            let names: Vec<String> = known.iter().map(|(name, _)| format!("\"{name}\"")).collect();
            refuse(setting, format!("\"{word}\""), &format!("choose one of {}", names.join(", ")))
        }
    }
}

/// Reads an expansion: `auto`, `off`, or per cent of an amplitude.
pub fn expansion(given: &WordOrNumber) -> Result<Expansion, Fault> {
    match given {
        WordOrNumber::Number(percent) if *percent > 0.0 && percent.is_finite() => {
            Ok(Expansion::Error(percent / 100.0))
        }
        WordOrNumber::Number(percent) => {
            refuse(Setting::ExpansionPercent, percent, "expected per cent above 0")
        }
        WordOrNumber::Word(word) => {
            let known = [("auto", Expansion::Auto), ("off", Expansion::Off)];
            choice(Setting::ExpansionPercent, word, &known)
        }
    }
}
