//! What agents declare, and what the truth says, in the same form.

use serde::{Deserialize, Serialize};

/// A defect at a place.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PlacedDefect {
    /// Its type: `vacancy`, `substitution`.
    pub kind: String,
    /// (x, y) in nm from the centre of pixel (0, 0) of the field.
    pub position_nm: [f64; 2],
}

/// A particle.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FoundParticle {
    /// (x, y) of its centre in nm from the centre of pixel (0, 0) of the field.
    pub position_nm: [f64; 2],
    /// Diameter in nm.
    pub diameter_nm: f64,
    /// Its shape: `icosahedron`.
    pub morphology: String,
}

/// An atomic column, and how sure it is that it holds a defect.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FoundColumn {
    /// (x, y) in nm from the centre of pixel (0, 0) of the field.
    pub position_nm: [f64; 2],
    /// Any number that is greater where a defect is more likely.
    pub score: f64,
}
