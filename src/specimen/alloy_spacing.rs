//! The spacing of planes in an alloy that is coherent with its substrate: the stretch along x.
//!
//! Along x the cell has the length of Vegard's law at the mean composition there. If stiffness constants
//! are given, the biaxial strain that coherence imposes lengthens it by Poisson's effect,
//! eps_perp = -2 (C13 / C33) eps_par (C12 / C11 for a cubic crystal along a cube axis).

use rayon::prelude::*;

use super::coherent::Stretch;
use super::composition::Composition;
use crate::error::{Error, Result};
use crate::recipe::CheckedRecipe;
use crate::recipe::limits::BEYOND_FIELD_NM;
use crate::recipe::region::Region;
use crate::recipe::tables::Alloy;
use crate::structure::columns::ColumnCrystal;

/// Steps in which the stretch is tabulated, in nm.
const STEP_NM: f64 = 0.01;
/// Largest misfit of the end member.
const LARGEST_MISFIT: f64 = 0.2;

/// Lattice parameters of the alloy.
pub struct Spacing {
    /// Edge along x of the end member divided by that edge of the host crystal.
    along: f64,
    /// The ratio of the edges across x: the mean over y and the beam.
    across: f64,
    c13: [f64; 2],
    c33: [f64; 2],
}

impl Spacing {
    /// Derives the spacing from the crystals of host and end member.
    ///
    /// # Errors
    /// [`Error::Invalid`] for an end member of another structure.
    pub fn new(recipe: &CheckedRecipe, alloy: &Alloy, host: &ColumnCrystal) -> Result<Self> {
        let edges = recipe.second_crystal()?.orthogonal_box()?;
        let ratios = [0, 1, 2].map(|k| edges[k] / host.cell[k]);
        if let Some(k) = (0..3).find(|&k| (ratios[k] - 1.0).abs() > LARGEST_MISFIT) {
            let value = format!("{:.4} A along axis {}", edges[k], ["x", "y", "z"][k]);
            let expected = format!(
                "the same structure as the crystal, {:.4} A within {} %",
                host.cell[k],
                100.0 * LARGEST_MISFIT
            );
            return Err(Error::invalid(crate::Setting::AlloyEndMember, value, expected));
        }
        Ok(Spacing {
            along: ratios[0],
            across: (ratios[1] * ratios[2]).sqrt(),
            c13: alloy.c13_gpa.unwrap_or([0.0; 2]),
            c33: alloy.c33_gpa.unwrap_or([1.0; 2]),
        })
    }

    /// Edge along x where `fraction` of the hosts are guests, divided by that edge of the host crystal.
    pub fn relative(&self, fraction: f64) -> f64 {
        let vegard = |end: f64| 1.0 + fraction * (end - 1.0);
        let mix = |[host, end]: [f64; 2]| host + fraction * (end - host);
        let strain = 1.0 / vegard(self.across) - 1.0;
        vegard(self.along) * (1.0 - 2.0 * mix(self.c13) / mix(self.c33) * strain)
    }

    /// Returns the stretch of a field of this composition, with this fraction in its wells (see [`Composition::fraction`]).
    pub fn stretch(&self, composition: &TabulatedComposition, fraction: f64) -> TabulatedStretch {
        let TabulatedComposition { field_start, start, beyond, shares } = composition;
        let step = |share: &f64| STEP_NM / self.relative(fraction * share);
        let steps: Vec<f64> = shares.par_iter().map(step).collect();
        // The substrate's lattice is undisturbed at the left edge of the field.
        let mut reference = vec![0.0];
        let mut sum = 0.0;
        for step in steps {
            sum += step;
            reference.push(sum);
        }
        let shift = field_start - reference[*beyond];
        reference.iter_mut().for_each(|r| *r += shift);
        TabulatedStretch { start: *start, reference }
    }
}

/// Mean compositions divided by the fraction in the wells, which is fitted later.
pub struct TabulatedComposition {
    /// Left edge of the field in nm.
    field_start: f64,
    /// First x in nm.
    start: f64,
    /// Number of steps before the field.
    beyond: usize,
    /// Values at the middles of all steps.
    shares: Vec<f64>,
}

impl TabulatedComposition {
    /// Tabulates the composition of a field.
    pub fn new(composition: &Composition, field: &Region) -> Self {
        let beyond = ((BEYOND_FIELD_NM + 2.0) / STEP_NM).ceil();
        let start = field.x[0] - beyond * STEP_NM;
        let count = ((field.x[1] - field.x[0]) / STEP_NM + 2.0 * beyond).ceil() as usize;
        let share = |n: usize| composition.share_of_near(start + (n as f64 + 0.5) * STEP_NM);
        let shares = (0..count).into_par_iter().map(share).collect();
        TabulatedComposition { field_start: field.x[0], start, beyond: beyond as usize, shares }
    }
}

/// Stretch that depends on x only, tabulated.
pub struct TabulatedStretch {
    /// First x in nm.
    start: f64,
    /// Reference x at `start + n * STEP_NM`.
    reference: Vec<f64>,
}

impl Stretch for TabulatedStretch {
    type Row = ();

    fn row(&self, _y: f64) {}

    fn to_reference(&self, x: f64, _row: &()) -> f64 {
        let n = ((x - self.start) / STEP_NM).clamp(0.0, (self.reference.len() - 2) as f64);
        let [low, high] = [self.reference[n as usize], self.reference[n as usize + 1]];
        low + (n - n.floor()) * (high - low)
    }

    fn to_field(&self, reference: f64, _row: &()) -> f64 {
        let above = self.reference.partition_point(|r| *r <= reference);
        let n = above.clamp(1, self.reference.len() - 1) - 1;
        let [low, high] = [self.reference[n], self.reference[n + 1]];
        self.start + (n as f64 + (reference - low) / (high - low)) * STEP_NM
    }

    fn spread(&self) -> f64 {
        2.0 * STEP_NM
    }
}
