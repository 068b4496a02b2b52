//! The table `[surface]`: amorphous carbon on the faces of a specimen.

use serde::{Deserialize, Serialize};

use crate::setting::{Fault, check_range};

/// Greatest thickness of a layer in nm.
const MOST_NM: f64 = 6.0;
/// Greatest standard deviation of the atoms' displacements in Angstrom.
const MOST_SIGMA_ANGSTROM: f64 = 0.5;

/// Layers of amorphous carbon, 2.0 g/cm3. The ground truth lists none of their atoms.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SurfaceTable {
    /// Thickness in nm of the layer on the face that the beam enters.
    #[serde(default)]
    pub entrance_nm: f64,
    /// Thickness in nm of the layer on the face that the beam leaves.
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
    /// Checks every value against its limits.
    ///
    /// # Errors
    /// The first value outside its limits.
    pub(crate) fn check(&self) -> Result<(), Fault> {
        check_range("entrance_nm", self.entrance_nm, [0.0, MOST_NM])?;
        check_range("exit_nm", self.exit_nm, [0.0, MOST_NM])?;
        check_range("sigma_angstrom", self.sigma_angstrom, [0.0, MOST_SIGMA_ANGSTROM])
    }
}
