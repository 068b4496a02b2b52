//! Edges of layers, and vacancies that lie beside each other: tables of `[stack]`.

use serde::{Deserialize, Serialize};

fn first() -> usize {
    1
}

/// A straight edge of a layer, with vacuum beyond it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StackEdge {
    /// Number of the layer that ends.
    #[serde(default = "first")]
    pub layer: usize,
    /// Miller indices of the plane along which the layer ends, which holds the beam direction. Its normal points into the vacuum.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub plane: Option<String>,
    /// Instead of `plane`: the angle in degrees, from +x to +y, of the direction into the vacuum.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub angle_deg: Option<f64>,
    /// A point (x, y) of the edge in nm. An edge along a plane moves to the middle of the nearest wide gap between two atomic planes.
    pub position_nm: [f64; 2],
}

/// The atoms of each column that are missing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MissingAtoms {
    /// The first along the beam.
    Entrance,
    /// The last along the beam.
    Exit,
    /// All.
    #[default]
    All,
}

/// Rows of vacancies along a direction of a layer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VacancyLines {
    /// Number of the layer.
    #[serde(default = "first")]
    pub layer: usize,
    /// Symbol of the element that is missing.
    pub element: String,
    /// Direction of the rows in indices of the layer's crystal, perpendicular to the beam.
    pub direction: String,
    /// Length of each row in nm, rounded to whole steps of the lattice: as many columns lack atoms as there are steps, at least 2.
    pub length_nm: f64,
    /// The atoms of each column of the element that are missing.
    #[serde(default)]
    pub missing: MissingAtoms,
    /// Mean number of rows per square micrometre, at random places.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub per_um2: Option<f64>,
    /// Places (x, y) in nm of the middles of the rows, instead of random ones.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub positions_nm: Vec<[f64; 2]>,
}

/// Which two atoms a double vacancy lacks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum VacancyPair {
    /// Two neighbours along the beam: the two chalcogens of a column of MoS2.
    Column,
    /// Nearest neighbours beside each other: the two ends of a bond of graphene.
    Neighbours,
}

impl VacancyPair {
    /// Returns the name that recipes use.
    pub(crate) fn name(self) -> &'static str {
        match self {
            VacancyPair::Column => "column",
            VacancyPair::Neighbours => "neighbours",
        }
    }
}

/// Pairs of vacancies in a layer, at random places.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DoubleVacancies {
    /// Number of the layer.
    #[serde(default = "first")]
    pub layer: usize,
    /// Symbol of the element that is missing.
    pub element: String,
    /// Which two atoms are missing.
    pub pair: VacancyPair,
    /// Fraction of all sites of the element in the layer that are vacant because of double vacancies.
    pub rate: f64,
}
