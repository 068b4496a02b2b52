//! The defects that can be asked for, and their text.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::setting::Setting;
use crate::structure::elements;

/// The change that a defect makes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DefectForm {
    /// One atom of an element (atomic number) is missing.
    Vacancy(u8),
    /// One atom of an element is replaced by an atom of another element (atomic numbers).
    Substitution(u8, u8),
    /// All atoms of a column that holds an element (atomic number) are missing.
    Column(u8),
}

/// The place of a defect along the beam.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum DefectDepth {
    /// At this fraction of the thickness, from 0 (entrance surface) to 1 (exit surface).
    Fraction(f64),
    /// Unknown: all depths are equally likely.
    Any,
}

/// A defect at a depth. As text: `vacancy:O`, `substitution:Ti:Nb`, `column:O`, with `@top`, `@middle`, `@bottom`, `@any` or a fraction
/// of the thickness, `vacancy:O@0.25`. Without a depth it is the middle.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct AskedDefect {
    /// The change.
    pub form: DefectForm,
    /// The depth; without effect for a missing column.
    pub depth: DefectDepth,
}

/// The form of a defect's text, for messages.
const EXPECTED: &str = "expected vacancy:O, substitution:Ti:Nb or column:O, with a depth if wanted: \
                        @top, @middle, @bottom, @any, or a fraction of the thickness such as @0.25";

impl AskedDefect {
    /// The element of the atom that is missing or replaced (atomic number).
    pub(crate) fn element(&self) -> u8 {
        match self.form {
            DefectForm::Vacancy(number)
            | DefectForm::Substitution(number, _)
            | DefectForm::Column(number) => number,
        }
    }

    /// The defect in words: `a missing O atom in the middle`.
    pub(crate) fn words(&self) -> String {
        let symbol = elements::symbol;
        let what = match self.form {
            DefectForm::Vacancy(number) => format!("missing {} atom", symbol(number)),
            DefectForm::Substitution(number, by) => {
                format!("{} atom in place of {}", symbol(by), symbol(number))
            }
            DefectForm::Column(number) => return format!("missing column of {}", symbol(number)),
        };
        let depth = match self.depth {
            DefectDepth::Any => "at an unknown depth".to_owned(),
            DefectDepth::Fraction(0.0) => "at the entrance surface".to_owned(),
            DefectDepth::Fraction(0.5) => "in the middle".to_owned(),
            DefectDepth::Fraction(1.0) => "at the exit surface".to_owned(),
            DefectDepth::Fraction(part) => format!("at {part} of the thickness"),
        };
        format!("{what} {depth}")
    }
}

impl FromStr for AskedDefect {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let bad = || Error::invalid(Setting::Defect, text, EXPECTED);
        let (change, depth) = match text.split_once('@') {
            Some((change, depth)) => (change, depth.trim().parse().map_err(|()| bad())?),
            None => (text, DefectDepth::Fraction(0.5)),
        };
        let (kind, rest) = change.trim().split_once(':').ok_or_else(bad)?;
        let form = match kind.trim() {
            "vacancy" => DefectForm::Vacancy(elements::atomic_number(rest)?),
            "column" => DefectForm::Column(elements::atomic_number(rest)?),
            "substitution" => {
                let parts = rest.split_once("->").or_else(|| rest.split_once(':'));
                let (host, guest) = parts.ok_or_else(bad)?;
                let (host, guest) =
                    (elements::atomic_number(host)?, elements::atomic_number(guest)?);
                if host == guest {
                    let expected = "replaces an element by itself; name two elements";
                    return Err(Error::invalid(Setting::Defect, text, expected));
                }
                DefectForm::Substitution(host, guest)
            }
            _ => return Err(bad()),
        };
        Ok(AskedDefect { form, depth })
    }
}

impl FromStr for DefectDepth {
    type Err = ();

    fn from_str(text: &str) -> std::result::Result<Self, ()> {
        match text {
            "top" => Ok(DefectDepth::Fraction(0.0)),
            "middle" => Ok(DefectDepth::Fraction(0.5)),
            "bottom" => Ok(DefectDepth::Fraction(1.0)),
            "any" => Ok(DefectDepth::Any),
            number => {
                let part = number.parse::<f64>().ok().filter(|part| (0.0..=1.0).contains(part));
                part.map(DefectDepth::Fraction).ok_or(())
            }
        }
    }
}

impl fmt::Display for AskedDefect {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let symbol = elements::symbol;
        match self.form {
            DefectForm::Vacancy(number) => write!(f, "vacancy:{}", symbol(number))?,
            DefectForm::Column(number) => return write!(f, "column:{}", symbol(number)),
            DefectForm::Substitution(number, by) => {
                write!(f, "substitution:{}:{}", symbol(number), symbol(by))?;
            }
        }
        match self.depth {
            DefectDepth::Any => f.write_str("@any"),
            DefectDepth::Fraction(0.0) => f.write_str("@top"),
            DefectDepth::Fraction(0.5) => f.write_str("@middle"),
            DefectDepth::Fraction(1.0) => f.write_str("@bottom"),
            DefectDepth::Fraction(part) => write!(f, "@{part}"),
        }
    }
}

impl TryFrom<String> for AskedDefect {
    type Error = Error;

    fn try_from(text: String) -> Result<Self> {
        text.parse()
    }
}

impl From<AskedDefect> for String {
    fn from(defect: AskedDefect) -> String {
        defect.to_string()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_are_read_and_written() {
        for (text, written) in [
            ("vacancy:O", "vacancy:O@middle"),
            ("vacancy:o@top", "vacancy:O@top"),
            ("substitution:Ti->Nb@any", "substitution:Ti:Nb@any"),
            ("substitution:22:41@0.25", "substitution:Ti:Nb@0.25"),
            ("column:O@any", "column:O"),
        ] {
            let defect: AskedDefect = text.parse().unwrap();
            assert_eq!(defect.to_string(), written);
            assert_eq!(written.parse::<AskedDefect>().unwrap().to_string(), written);
        }
    }

    #[test]
    fn other_texts_are_refused_with_the_form() {
        for text in
            ["O", "vacancy", "vacancies:O", "vacancy:O@2", "vacancy:O@deep", "substitution:Ti"]
        {
            let said = text.parse::<AskedDefect>().unwrap_err().to_string();
            assert!(said.contains("substitution:Ti:Nb"), "{text}: {said}");
        }
        assert!("substitution:Ti:Ti".parse::<AskedDefect>().is_err());
        assert!("vacancy:Xx".parse::<AskedDefect>().is_err());
    }
}
