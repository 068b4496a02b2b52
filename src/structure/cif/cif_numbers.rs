//! Reads numbers of a CIF, which may have an uncertainty.

use super::tokens::CifValue;
use crate::error::Result;
use crate::structure::source_text::SourceText;

/// Reads a number such as `3.905(1)`.
pub fn with_uncertainty(text: &SourceText, line: usize, what: &str, word: &str) -> Result<f64> {
    let plain = match word.split_once('(') {
        Some((value, rest)) => match rest.strip_suffix(')') {
            Some(digits) if digits.chars().all(|c| c.is_ascii_digit() || c == '.') => value,
            _ => word,
        },
        None => word,
    };
    text.number(line, what, plain)
}

/// Reads a coordinate; `most` is the largest accepted value, and `expected` describes a valid coordinate.
pub fn coordinate(
    text: &SourceText,
    value: &CifValue,
    tag: &str,
    (most, expected): (f64, &str),
) -> Result<f64> {
    let Some(word) = value.known() else {
        return Err(text.error(value.line, format!("`{tag}` of this atom is not known")));
    };
    let x = with_uncertainty(text, value.line, tag, word)?;
    if x.abs() > most {
        return Err(text.error(value.line, format!("`{tag}` is {word}, expected {expected}")));
    }
    Ok(x)
}
