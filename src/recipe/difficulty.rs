//! Tiers of difficulty.

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};

/// A tier of difficulty.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum Difficulty {
    /// Many defects, high dose.
    Easy,
    /// Fewer defects and less dose than easy, more than hard.
    Medium,
    /// Few defects, low dose.
    Hard,
}

impl Difficulty {
    /// All tiers.
    pub const ALL: [Difficulty; 3] = [Difficulty::Easy, Difficulty::Medium, Difficulty::Hard];

    /// Returns the name that recipes and the command line use.
    pub fn name(self) -> &'static str {
        match self {
            Difficulty::Easy => "easy",
            Difficulty::Medium => "medium",
            Difficulty::Hard => "hard",
        }
    }
}

impl std::str::FromStr for Difficulty {
    type Err = Error;
    fn from_str(text: &str) -> Result<Self> {
        let found = Difficulty::ALL.into_iter().find(|d| d.name() == text);
        found.ok_or_else(|| {
            Error::invalid(crate::Setting::Difficulty, text, "expected easy, medium or hard")
        })
    }
}
