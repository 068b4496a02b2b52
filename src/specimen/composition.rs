//! The composition of an alloy: a linear gradient, or quantum wells with rough interfaces.

use crate::recipe::limits::BEYOND_FIELD_NM;
use crate::recipe::region::Region;
use crate::recipe::tables::{Alloy, CompositionProfile, Wells};
use crate::specimen::roughness::Roughness;
use crate::specimen::wave::normal_cdf;

/// Fraction of guests on host sites as a function of the position, all lengths in nm.
#[derive(Debug)]
pub enum Composition {
    /// From 0 at `x[0]` to `highest` at `x[1]`.
    Linear {
        /// Left and right edge of the field.
        x: [f64; 2],
        /// Fraction at the right edge.
        highest: f64,
    },
    /// Wells of one composition.
    Wells {
        /// Fraction in the wells.
        fraction: f64,
        /// Mean position, and deviation from it, of the left and right side of each well.
        sides: Vec<[Interface; 2]>,
        /// Standard deviation of the interfaces.
        roughness: f64,
    },
}

/// One side of a well.
#[derive(Debug)]
pub struct Interface {
    x: f64,
    /// `None` when it is plane.
    deviation: Option<Roughness>,
}

impl Interface {
    fn at(&self, y: f64, z: f64) -> f64 {
        self.x + self.deviation.as_ref().map_or(0.0, |d| d.at(y, z))
    }
    /// Mean along the beam.
    fn projected(&self, y: f64) -> f64 {
        self.x + self.deviation.as_ref().map_or(0.0, |d| d.mean_along_beam(y))
    }
    /// Farthest deviation.
    fn reach(&self) -> f64 {
        self.deviation.as_ref().map_or(0.0, Roughness::greatest)
    }
}

impl Composition {
    /// That of a recipe, with a first guess of the fraction in the wells (see
    /// [`Composition::set_fraction`]).
    pub fn new(
        alloy: &Alloy,
        wells: Option<&Wells>,
        field: &Region,
        thickness: f64,
        seed: u64,
    ) -> Self {
        let (CompositionProfile::Wells, Some(wells)) = (alloy.profile, wells) else {
            return Composition::Linear { x: field.x, highest: 2.0 * alloy.rate };
        };
        let width = field.x[1] - field.x[0];
        let rough = |number: usize| {
            let (rms, length) = (wells.roughness_nm, wells.roughness_correlation_nm);
            let y = [field.y[0] - BEYOND_FIELD_NM, field.y[1] + BEYOND_FIELD_NM];
            let new = || Roughness::new(y, field.y, thickness, rms, length, seed, number as u32);
            (rms > 0.0).then(new)
        };
        let side = |well: usize, side: usize| {
            let centre = field.x[0] + width * (well as f64 + 0.5) / wells.count as f64;
            let x = centre + (side as f64 - 0.5) * wells.width_nm;
            Interface { x, deviation: rough(2 * well + side) }
        };
        let sides = (0..wells.count).map(|w| [side(w, 0), side(w, 1)]).collect();
        let fraction = (alloy.rate * width / (wells.count as f64 * wells.width_nm)).min(1.0);
        Composition::Wells { fraction, sides, roughness: wells.roughness_nm }
    }

    /// Sets the fraction of guests in the wells.
    pub fn set_fraction(&mut self, new: f64) {
        if let Composition::Wells { fraction, .. } = self {
            *fraction = new;
        }
    }

    /// The mean over y and the beam.
    pub fn mean(&self, x: f64) -> f64 {
        match self {
            Composition::Linear { x: [left, right], highest } => {
                (highest * (x - left) / (right - left)).clamp(0.0, 1.0)
            }
            Composition::Wells { fraction, sides, roughness } => {
                let beyond = |side: &Interface| match *roughness > 0.0 {
                    true => normal_cdf((x - side.x) / roughness),
                    false => f64::from(u8::from(x >= side.x)),
                };
                fraction * sides.iter().map(|[l, r]| beyond(l) - beyond(r)).sum::<f64>()
            }
        }
    }

    /// The fraction at a point.
    pub fn at(&self, [x, y, z]: [f64; 3]) -> f64 {
        match self {
            Composition::Linear { .. } => self.mean(x),
            Composition::Wells { fraction, .. } => {
                if self.holds_well([x, y, z]) {
                    *fraction
                } else {
                    0.0
                }
            }
        }
    }

    /// Whether a point lies in a well.
    pub fn holds_well(&self, [x, y, z]: [f64; 3]) -> bool {
        let Composition::Wells { sides, .. } = self else { return false };
        let near = |[l, r]: &[Interface; 2]| x >= l.x - l.reach() && x < r.x + r.reach();
        let inside = |[l, r]: &[Interface; 2]| x >= l.at(y, z) && x < r.at(y, z);
        sides.iter().any(|sides| near(sides) && inside(sides))
    }

    /// Names of the phases, if there are two.
    pub fn phases(&self) -> Vec<String> {
        match self {
            Composition::Linear { .. } => Vec::new(),
            Composition::Wells { .. } => vec!["barrier".into(), "well".into()],
        }
    }

    /// Whether more than half of the way along the beam lies in a well.
    pub fn is_well(&self, [x, y]: [f64; 2]) -> bool {
        let Composition::Wells { sides, .. } = self else { return false };
        let near = |[l, r]: &[Interface; 2]| x >= l.x - l.reach() && x < r.x + r.reach();
        let inside = |[l, r]: &[Interface; 2]| x >= l.projected(y) && x < r.projected(y);
        sides.iter().any(|sides| near(sides) && inside(sides))
    }

    /// The sides of the wells from left to right, in the mean along the beam, as polylines.
    pub fn interfaces(&self, y: [f64; 2]) -> Vec<Vec<[f64; 2]>> {
        let Composition::Wells { sides, .. } = self else { return Vec::new() };
        let line = |side: &Interface| match &side.deviation {
            None => y.map(|y| [side.x, y]).to_vec(),
            Some(rough) => rough.corners(y).into_iter().map(|y| [side.projected(y), y]).collect(),
        };
        sides.iter().flatten().map(line).collect()
    }
}
