//! The table `[surface]`: amorphous carbon on the faces of a specimen.

use serde::{Deserialize, Serialize};

/// Greatest thickness of a layer in nm.
const MOST_NM: f64 = 6.0;
/// Greatest standard deviation of its atoms' displacements in Angstrom.
const MOST_SIGMA_ANGSTROM: f64 = 0.5;

/// Layers of amorphous carbon, 2.0 g/cm3. The ground truth lists none of their atoms.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SurfaceTable {
    /// Thickness in nm of the layer on the face that the beam enters.
    #[serde(default)]
    pub entrance_nm: f64,
    /// Thickness in nm of the layer on the face that it leaves.
    #[serde(default)]
    pub exit_nm: f64,
    /// Standard deviation in Angstrom of each Cartesian component of its atoms' displacements.
    #[serde(default = "sigma_of_carbon")]
    pub sigma_angstrom: f64,
}

fn sigma_of_carbon() -> f64 {
    0.08
}

impl SurfaceTable {
    /// The first value outside its limits: its key, the value, and what is allowed.
    pub fn fault(&self) -> Option<(&'static str, f64, String)> {
        let values = [
            ("entrance_nm", self.entrance_nm, MOST_NM),
            ("exit_nm", self.exit_nm, MOST_NM),
            ("sigma_angstrom", self.sigma_angstrom, MOST_SIGMA_ANGSTROM),
        ];
        let wrong = values.into_iter().find(|(_, v, most)| !(0.0..=*most).contains(v))?;
        Some((wrong.0, wrong.1, format!("expected 0 to {}", wrong.2)))
    }
}
