//! The truth of all parts of a field that an agent has seen.

use ndarray::Array2;

use super::benchmark_world::{PhaseSamples, RegionTruth, TrueColumn};
use super::findings::{FoundParticle, PlacedDefect};
use super::task_scores::NO_PHASE;
use crate::recipe::Region;

/// The parts of a field that were acquired, and their truth at that time. Where two parts overlap, the later one counts.
#[derive(Debug, Clone, Default)]
pub struct SeenTruth {
    views: Vec<Region>,
    defects: Vec<PlacedDefect>,
    columns: Vec<TrueColumn>,
    particles: Vec<FoundParticle>,
}

impl SeenTruth {
    /// Adds a part.
    pub(crate) fn add(&mut self, view: Region, truth: RegionTruth) {
        // In places that were seen before, the truth of this part replaces the earlier one.
        self.defects.retain(|d| !view.contains(d.position_nm));
        self.columns.retain(|c| !view.contains(c.position_nm));
        self.defects.extend(truth.defects);
        self.columns.extend(truth.columns);
        for particle in truth.particles {
            if !self.particles.contains(&particle) {
                self.particles.push(particle);
            }
        }
        if !self.views.contains(&view) {
            self.views.push(view);
        }
    }

    /// Returns the vacant and substituted sites.
    pub fn defects(&self) -> &[PlacedDefect] {
        &self.defects
    }

    /// Returns the columns.
    pub(crate) fn columns(&self) -> &[TrueColumn] {
        &self.columns
    }

    /// Returns the particles that reach into any part.
    pub(crate) fn particles(&self) -> &[FoundParticle] {
        &self.particles
    }

    /// Returns the samples of phases in the parts, with no prediction elsewhere; `None` if the whole field has one phase.
    pub(crate) fn phases(&self, samples: &PhaseSamples, pixel_nm: f64) -> Option<Array2<i32>> {
        let first = *samples.phases.first()?;
        if samples.phases.iter().all(|phase| *phase == first) {
            return None;
        }
        let stride = samples.stride_px;
        let at = |n: usize| (n * stride + stride / 2) as f64 * pixel_nm;
        Some(Array2::from_shape_fn(samples.phases.dim(), |(row, column)| {
            let place = [at(column), at(row)];
            let seen = self.views.iter().any(|view| view.contains(place));
            if seen { samples.phases[[row, column]] } else { NO_PHASE }
        }))
    }

    /// Returns for each part whether the agent claims a particle in it, and whether it holds one.
    pub(crate) fn occupied(&self, claimed: &[FoundParticle]) -> Vec<[bool; 2]> {
        let holds = |view: &Region, list: &[FoundParticle]| {
            list.iter().any(|p| view.grown(0.5 * p.diameter_nm).contains(p.position_nm))
        };
        self.views.iter().map(|v| [holds(v, claimed), holds(v, &self.particles)]).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn defects(places: &[[f64; 2]]) -> RegionTruth {
        let defect = |p: &[f64; 2]| PlacedDefect { kind: "vacancy".into(), position_nm: *p };
        RegionTruth { defects: places.iter().map(defect).collect(), ..RegionTruth::default() }
    }

    #[test]
    fn what_is_seen_twice_counts_once_and_as_it_is_later() {
        let mut seen = SeenTruth::default();
        let view = |x: f64| Region { x: [x, x + 2.0], y: [0.0, 1.0] };
        seen.add(view(0.0), defects(&[[0.5, 0.5], [1.5, 0.5]]));
        seen.add(view(1.0), defects(&[[1.5, 0.5], [1.75, 0.25], [2.5, 0.5]]));
        let mut places: Vec<f64> = seen.defects().iter().map(|d| d.position_nm[0]).collect();
        places.sort_by(f64::total_cmp);
        assert_eq!(places, [0.5, 1.5, 1.75, 2.5]);
        seen.add(view(1.0), defects(&[]));
        assert_eq!((seen.views.len(), seen.defects().len()), (2, 1));
    }

    #[test]
    fn particles_hold_every_part_that_they_reach() {
        let mut seen = SeenTruth::default();
        let particle =
            FoundParticle { position_nm: [2.2, 0.5], diameter_nm: 1.0, morphology: "wulff".into() };
        let truth = || RegionTruth { particles: vec![particle.clone()], ..RegionTruth::default() };
        seen.add(Region { x: [0.0, 2.0], y: [0.0, 1.0] }, truth());
        seen.add(Region { x: [2.0, 4.0], y: [0.0, 1.0] }, truth());
        seen.add(Region { x: [6.0, 8.0], y: [0.0, 1.0] }, RegionTruth::default());
        assert_eq!(seen.particles().len(), 1);
        let small = FoundParticle { diameter_nm: 0.1, ..particle };
        let expected = [[false, true], [true, true], [false, false]];
        assert_eq!(seen.occupied(&[small]), expected);
    }
}
