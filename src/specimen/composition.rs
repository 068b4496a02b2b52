//! The composition of an alloy: a linear gradient, or quantum wells with rough interfaces.

use crate::recipe::limits::BEYOND_FIELD_NM;
use crate::recipe::region::Region;
use crate::recipe::tables::{Alloy, CompositionProfile, Wells};
use crate::simd::vectorised;
use crate::specimen::roughness::Roughness;
use crate::specimen::wave::{normal_cdf, normal_cdf_or_zero};

/// Fraction of guests on host sites as a function of the position. All lengths are in nm.
#[derive(Debug)]
pub enum Composition {
    /// A gradient from 0 at `x[0]` to `highest` at `x[1]`.
    Linear {
        /// Left and right edge of the field.
        x: [f64; 2],
        /// Fraction at the right edge.
        highest: f64,
    },
    /// Wells that all have one composition.
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
    /// Deviation from a plane; `None` for a plane interface.
    deviation: Option<Roughness>,
}

impl Interface {
    fn at(&self, y: f64, z: f64) -> f64 {
        self.x + self.deviation.as_ref().map_or(0.0, |d| d.at(y, z))
    }
    /// Positions of the interface along x at y and some heights.
    fn along_beam(&self, y: f64, heights: &[f64]) -> Vec<f64> {
        match &self.deviation {
            None => vec![self.x; heights.len()],
            Some(rough) => rough.along_beam(y, heights).map(|d| self.x + d).collect(),
        }
    }
    /// Mean position along the beam.
    fn projected(&self, y: f64) -> f64 {
        self.x + self.deviation.as_ref().map_or(0.0, |d| d.mean_along_beam(y))
    }
    /// Largest deviation.
    fn reach(&self) -> f64 {
        self.deviation.as_ref().map_or(0.0, Roughness::greatest)
    }

    /// Whether all points at `x` lie beyond the interface (`true`) or before it (`false`); `None` where it is near.
    fn passed_anywhere(&self, x: f64) -> Option<bool> {
        // Rounding moves no point across the interface.
        let reach = self.reach() + ROUNDING_NM;
        ((x - self.x).abs() > reach).then_some(x > self.x)
    }

    /// Whether all points at x and y lie beyond the interface (`true`) or before it (`false`); `None` where it is near.
    fn passed_along_beam(&self, [x, y]: [f64; 2]) -> Option<bool> {
        self.passed_anywhere(x).or_else(|| {
            let [low, high] = self.deviation.as_ref()?.range(y).map(|d| self.x + d);
            let (before, beyond) = (x < low - ROUNDING_NM, x > high + ROUNDING_NM);
            (before || beyond).then_some(beyond)
        })
    }

    fn passed(&self, [x, y, z]: [f64; 3]) -> bool {
        self.passed_anywhere(x).unwrap_or_else(|| x >= self.at(y, z))
    }
}

/// Whether a point lies in a well, from whether it has passed the well's left and right side.
fn between([left, right]: [Option<bool>; 2]) -> Option<bool> {
    match [left, right] {
        [Some(true), Some(false)] => Some(true),
        [Some(false), _] | [_, Some(true)] => Some(false),
        _ => None,
    }
}

/// Whether a point lies in any of several wells.
fn in_any(wells: impl Iterator<Item = Option<bool>>) -> Option<bool> {
    let mut inside = false;
    for well in wells {
        inside |= well?;
    }
    Some(inside)
}

/// Distances from interfaces are exact to better than this.
const ROUNDING_NM: f64 = 1e-6;

impl Composition {
    /// Builds the composition of a recipe, with a first guess of the fraction in the wells (see [`Composition::set_fraction`]).
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

    /// Returns the fraction in the wells; 1 for a gradient.
    pub fn fraction(&self) -> f64 {
        match self {
            Composition::Linear { .. } => 1.0,
            Composition::Wells { fraction, .. } => *fraction,
        }
    }

    /// Returns the mean fraction over y and the beam.
    pub fn mean(&self, x: f64) -> f64 {
        self.fraction() * self.share(x, normal_cdf)
    }

    /// Returns [`Composition::mean`] divided by [`Composition::fraction`] to within 1e-23: 0 where only interfaces more than ten standard
    /// deviations away would contribute.
    pub fn share_of_near(&self, x: f64) -> f64 {
        self.share(x, normal_cdf_or_zero)
    }

    /// Returns the mean divided by the fraction; `normal` is the cumulative normal distribution.
    fn share(&self, x: f64, normal: impl Fn(f64) -> f64) -> f64 {
        match self {
            Composition::Linear { x: [left, right], highest } => {
                (highest * (x - left) / (right - left)).clamp(0.0, 1.0)
            }
            Composition::Wells { sides, roughness, .. } => {
                let beyond = |side: &Interface| match *roughness > 0.0 {
                    true => normal((x - side.x) / roughness),
                    false => f64::from(u8::from(x >= side.x)),
                };
                sides.iter().map(|[l, r]| beyond(l) - beyond(r)).sum::<f64>()
            }
        }
    }

    /// Returns the fraction at a point.
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

    /// Returns the fraction if it is the same at all points at x and y; `None` where an interface is near.
    pub fn along_beam(&self, at: [f64; 2]) -> Option<f64> {
        match self {
            Composition::Linear { .. } => Some(self.mean(at[0])),
            Composition::Wells { fraction, .. } => {
                let inside = self.well_along_beam(at)?;
                Some(if inside { *fraction } else { 0.0 })
            }
        }
    }

    /// Whether all points at x and y lie in a well (`true`) or none (`false`); `None` where an interface is near.
    fn well_along_beam(&self, at: [f64; 2]) -> Option<bool> {
        let Composition::Wells { sides, .. } = self else { return Some(false) };
        in_any(sides.iter().map(|sides| between(sides.each_ref().map(|s| s.passed_along_beam(at)))))
    }

    /// Returns the positions of the interfaces at y and some heights.
    pub fn interfaces_at(&self, y: f64, heights: &[f64]) -> InterfacesAlongBeam {
        let Composition::Wells { sides, .. } = self else { return InterfacesAlongBeam::default() };
        let one = |side: &Interface| OneInterface::new(side.along_beam(y, heights));
        let sides = sides.iter().map(|sides| sides.each_ref().map(one));
        InterfacesAlongBeam { wells: sides.collect(), heights: heights.len() }
    }

    /// Returns whether all points at `x` certainly lie in a well, and the wells in which some points may lie.
    pub fn wells_near(&self, x: f64) -> (bool, Vec<usize>) {
        let Composition::Wells { sides, .. } = self else { return (false, Vec::new()) };
        let (mut surely, mut near) = (false, Vec::new());
        for (n, sides) in sides.iter().enumerate() {
            match between(sides.each_ref().map(|s| s.passed_anywhere(x))) {
                Some(within) => surely |= within,
                None => near.push(n),
            }
        }
        (surely, near)
    }

    /// Whether a point lies in a well.
    pub fn holds_well(&self, at: [f64; 3]) -> bool {
        let Composition::Wells { sides, .. } = self else { return false };
        sides.iter().any(|[left, right]| left.passed(at) && !right.passed(at))
    }

    /// Returns the names of the phases, if there are two.
    pub fn phases(&self) -> Vec<String> {
        match self {
            Composition::Linear { .. } => Vec::new(),
            Composition::Wells { .. } => vec!["barrier".into(), "well".into()],
        }
    }

    /// Whether more than half of the path along the beam lies in a well.
    pub fn is_well(&self, [x, y]: [f64; 2]) -> bool {
        let Composition::Wells { sides, .. } = self else { return false };
        let near = |[l, r]: &[Interface; 2]| x >= l.x - l.reach() && x < r.x + r.reach();
        let inside = |[l, r]: &[Interface; 2]| x >= l.projected(y) && x < r.projected(y);
        sides.iter().any(|sides| near(sides) && inside(sides))
    }

    /// Returns the sides of the wells from left to right, averaged along the beam, as polylines.
    pub fn interfaces(&self, y: [f64; 2]) -> Vec<Vec<[f64; 2]>> {
        let Composition::Wells { sides, .. } = self else { return Vec::new() };
        let line = |side: &Interface| match &side.deviation {
            None => y.map(|y| [side.x, y]).to_vec(),
            Some(rough) => rough.corners(y).into_iter().map(|y| [side.projected(y), y]).collect(),
        };
        sides.iter().flatten().map(line).collect()
    }
}

/// Positions of the interfaces of all wells at one y and some heights.
#[derive(Debug, Default)]
pub struct InterfacesAlongBeam {
    wells: Vec<[OneInterface; 2]>,
    heights: usize,
}

/// Positions of one interface at some heights.
#[derive(Debug)]
struct OneInterface {
    at: Vec<f64>,
    least: f64,
    greatest: f64,
}

impl OneInterface {
    fn new(at: Vec<f64>) -> Self {
        let least = at.iter().copied().fold(f64::INFINITY, f64::min);
        let greatest = at.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        OneInterface { at, least, greatest }
    }

    /// Whether a point at `x` is beyond the interface at all heights (`true`) or at none (`false`); `None` otherwise.
    fn passed(&self, x: f64) -> Option<bool> {
        (x < self.least || x >= self.greatest).then_some(x >= self.greatest)
    }
}

impl InterfacesAlongBeam {
    /// Counts the heights that lie in one of these wells at `x`.
    pub fn count_in(&self, wells: &[usize], x: f64) -> usize {
        let mut unsure = None;
        for well in wells.iter().map(|n| &self.wells[*n]) {
            match between(well.each_ref().map(|side| side.passed(x))) {
                Some(true) => return self.heights,
                Some(false) => {}
                None if unsure.is_none() => unsure = Some(well),
                None => return self.count_each(wells, x),
            }
        }
        let Some([left, right]) = unsure else { return 0 };
        let sides = left.at.iter().zip(&right.at);
        vectorised(
            #[inline(always)]
            || sides.map(|(left, right)| usize::from(*left <= x && x < *right)).sum(),
        )
    }

    /// Counts height by height, since a height may lie in two wells that overlap.
    fn count_each(&self, wells: &[usize], x: f64) -> usize {
        let inside = |height: &usize| {
            let well = |n: &usize| self.wells[*n].each_ref().map(|side| side.at[*height]);
            wells.iter().map(well).any(|[left, right]| left <= x && x < right)
        };
        (0..self.heights).filter(inside).count()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recipe::{CheckedRecipe, Difficulty};

    #[test]
    fn sites_in_wells_are_counted_as_asked_one_by_one() {
        let field = Region { x: [0.0, 40.0], y: [0.0, 30.0] };
        let heights: Vec<f64> = (0..25).map(|n| 0.1 + 0.32 * f64::from(n)).collect();
        let recipe = CheckedRecipe::load("gan", Difficulty::Hard).unwrap();
        let alloy = recipe.alloy.as_ref().unwrap();
        // The last wells overlap.
        for (count, width_nm, roughness_nm) in [(4, 3.0, 0.5), (4, 3.0, 0.0), (10, 5.0, 0.5)] {
            let wells = Wells { count, width_nm, roughness_nm, roughness_correlation_nm: 2.0 };
            let composition = Composition::new(alloy, Some(&wells), &field, 8.0, 3);
            let mut partly = 0;
            for y in [3.1, 17.7] {
                let interfaces = composition.interfaces_at(y, &heights);
                for x in (0..400).map(|n| 0.1 * f64::from(n) + 0.013) {
                    let one_by_one =
                        heights.iter().filter(|z| composition.holds_well([x, y, **z])).count();
                    let (surely, near) = composition.wells_near(x);
                    let counted =
                        if surely { heights.len() } else { interfaces.count_in(&near, x) };
                    assert_eq!(counted, one_by_one, "{wells:?} at {x}, {y}");
                    partly += usize::from(counted > 0 && counted < heights.len());
                    let near = composition.fraction() * composition.share_of_near(x);
                    assert_eq!(1.0 + composition.mean(x), 1.0 + near);
                }
            }
            assert_eq!(partly > 20, roughness_nm > 0.0, "{partly}");
        }
    }
}
