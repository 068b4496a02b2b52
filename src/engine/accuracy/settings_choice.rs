//! Settings for a requested error, measured on the specimen.
//!
//! A sample of the scan's probes is simulated by the exact engine ([`ExactEngine`]), and again in windows, exactly as the whole scan would
//! be. The narrowest window with a small enough error is chosen. Where the error stops falling with the width, it is that of the windows'
//! coarser grid (0.54 % for a particle of gold): they are tried again on a grid that carries the angles of the exact engine. If no window
//! has a small enough error, the exact engine is chosen.

use super::super::cost::Cost;
use super::super::elements;
use super::super::plan::Plan;
use super::super::probe_raster::ProbeRaster;
use super::super::probe_scan::Scan;
use super::super::probe_width::{geometric_radius, relative_size};
use super::super::settings::{Algorithm, GridChoice, ProbeBox, ProbeStep, Settings};
use super::super::simulate::Simulation;
use super::accuracy_found::{AccuracyFound, TriedWindow};
use super::error_estimate::{AccuracyVerdict, ErrorEstimate};
use super::exact_probes::{ExactEngine, by_cluster, interpolated_step};
use super::probe_sample::{DrawnCluster, ProbeSample};
use crate::error::{Error, Result};
use crate::progress::{InterruptOnly, Progress};
use crate::structure::Site;
use std::collections::{BTreeSet, VecDeque};

/// Windows that are tried, in Angstrom at 200 kV and 21 mrad, each with a least error in per cent: of images of one configuration, and of
/// means over several, in which most of the error averages out. The search begins at the first window whose least error is not above the
/// requested one.
const WINDOWS: [(f64, [f64; 2]); 6] = [
    (5.9, [3.0, 1.7]),
    (7.8, [0.8, 0.6]),
    (9.8, [0.6, 0.3]),
    (11.7, [0.3, 0.3]),
    (15.6, [0.0, 0.0]),
    (23.4, [f64::INFINITY; 2]),
];
/// Windows are used if they need less than this share of the exact engine's operations.
const WORTH: f64 = 0.7;
/// Smallest and largest number of clusters in a round of the sample.
const CLUSTERS: (usize, usize) = (8, 24);
/// Probes of each cluster in a small and in a large sample.
const PROBES: (usize, usize) = (3, 4);
/// Largest number of rounds; each has its own phonon configurations, one or two. Small samples have fewer rounds.
const ROUNDS: u32 = 4;
const ROUNDS_OF_SMALL: u32 = 2;
/// From this number of phonon configurations on a round samples in two of them. For fewer, potentials would be computed as often for the
/// sample as for the image.
const IN_TWO_FROM: u32 = 4;
/// Frames of a trajectory that a round samples.
const FRAMES: usize = 4;
/// Largest share of the whole scan's operations that a round should need.
const SHARE: f64 = 0.02;

/// The error has stopped falling if that of a window is above this share of the next narrower one's.
const STOPPED: f64 = 0.8;
/// A grid is finer if it carries angles larger by this factor, up to a largest margin.
const FINER: f64 = 1.02;
const MOST_MARGIN: f64 = 1.4;

/// Error in per cent of the mean of slices at the heights of the atoms in each window ([`LOCAL_ANGSTROM`]), rms, which the sample may not
/// see, since the exact engine of wide cells has such slices too. Against slices of 0.02 to 0.05 A: 0.10 % for a tilted Pt particle, 0.19 %
/// for a Au particle on carbon.
///
/// [`LOCAL_ANGSTROM`]: crate::potential::slices::LOCAL_ANGSTROM
const LOCAL_SLICES_PERCENT: f64 = 0.2;

/// Chooses settings for the images of a scan whose rms error against the exact engine is at most `accuracy_percent` of the mean image, for
/// every detector and thickness. The exact engine is `ExactEngine` with otherwise equal settings. Probes have norm 1 in a large box in
/// both (see [`ProbeBox`](super::super::settings::ProbeBox)), unless the settings give another box.
///
/// `frames` holds the atoms of each frame; the images of a trajectory are averaged over its frames. The sample is spread over them.
///
/// # Errors
/// [`Error::Invalid`] for an accuracy that is not above 0, errors of [`Plan::new`], and [`Error::Interrupted`].
pub fn settings_for_accuracy(
    accuracy_percent: f64,
    settings: &Settings,
    cell_angstrom: [f64; 3],
    frames: &[&[Site]],
    scan: &Scan,
    progress: &dyn Progress,
) -> Result<(Settings, AccuracyFound)> {
    if !(accuracy_percent > 0.0 && accuracy_percent.is_finite()) {
        let expected = "must be above 0";
        return Err(Error::invalid(crate::Setting::AccuracyPercent, accuracy_percent, expected));
    }
    let heights = mean_heights(frames);
    let exact = ExactEngine::new(settings, cell_angstrom, &heights)?;
    let mut found = AccuracyFound::exact(accuracy_percent, &exact);
    let base = Settings { probe_box: exact.plan.settings.probe_box, ..settings.clone() };
    let search = Search {
        base: &base,
        exact,
        frames,
        heights,
        asked: scan,
        accuracy_percent,
        cell_angstrom,
    };
    let in_cell = base.probe_box == Some(ProbeBox::Cell);
    found.needs_large_box = in_cell && base.reads_tail_in_windows();
    let window = match found.needs_large_box {
        true => None,
        false => search.window(&mut found.tried, progress)?,
    };
    found.holds = window.is_some();
    let chosen = window.unwrap_or_else(|| search.exact.plan.settings.clone());
    found.algorithm = chosen.algorithm;
    Ok((chosen, found))
}

/// Heights of the atoms of a trajectory for which its slices are made: the means over the frames if all have equally many atoms, else the
/// heights in the first frame.
pub(crate) fn mean_heights(frames: &[&[Site]]) -> Vec<f64> {
    let first = frames.first().copied().unwrap_or_default();
    let alike = frames.iter().all(|f| f.len() == first.len());
    let used = if alike { frames } else { &frames[..1] };
    let mean = |n: usize| used.iter().map(|f| f[n].position[2]).sum::<f64>() / used.len() as f64;
    (0..first.len()).map(mean).collect()
}

/// Numbers of the frames that a round of the sample uses, of `count` frames. All rounds together use frames at even distances.
fn frames_of_round(round: u32, count: usize) -> Vec<usize> {
    match count <= FRAMES {
        true => (0..count).collect(),
        false => (0..FRAMES)
            .map(|k| (ROUNDS as usize * k + round as usize) * count / (ROUNDS as usize * FRAMES))
            .collect(),
    }
}

/// The search for a window.
struct Search<'a> {
    base: &'a Settings,
    exact: ExactEngine,
    frames: &'a [&'a [Site]],
    heights: Vec<f64>,
    asked: &'a Scan,
    accuracy_percent: f64,
    cell_angstrom: [f64; 3],
}

/// A round of the sample, in one or two phonon configurations.
struct Round {
    configurations: Vec<u32>,
    parts: Vec<FrameSample>,
}

/// Clusters of probes on one frame, with the exact engine's values in each configuration.
struct FrameSample {
    frame: usize,
    clusters: Vec<DrawnCluster>,
    exact: Vec<Vec<Vec<f64>>>,
}

/// The sample of a search, made when the first window is tried.
#[derive(Default)]
struct SearchSample {
    /// The sample, the numbers of clusters and of probes in each, and the largest number of rounds.
    drawn: Option<(ProbeSample, [usize; 2], u32)>,
    rounds: Vec<Round>,
}

impl Search<'_> {
    /// Finds the settings with the narrowest window that holds, if there is one that saves time.
    fn window(
        &self,
        tried: &mut Vec<TriedWindow>,
        progress: &dyn Progress,
    ) -> Result<Option<Settings>> {
        let exact_raster = *ProbeRaster::new(&self.exact.plan, self.asked)?.scan();
        let most_flops = WORTH * self.flops(&self.exact.plan, &exact_raster);
        let (mut sample, candidates) = (SearchSample::default(), self.candidates()?);
        let (mut next, mut finer) = (VecDeque::from(candidates.clone()), false);
        while let Some(settings) = next.pop_front() {
            let Some(window) = self.attempt(&settings, most_flops, &mut sample, progress)? else {
                break;
            };
            tried.push(window);
            if window.likely_percent <= self.accuracy_percent {
                return Ok(Some(settings));
            }
            let again = self.on_finer_grid(tried, &candidates);
            if !finer && !again.is_empty() {
                (next, finer) = (again.into(), true);
            }
        }
        Ok(None)
    }

    /// Operations of a scan with a plan, for the atoms of the first frame.
    fn flops(&self, plan: &Plan, raster: &Scan) -> f64 {
        Cost::with_atoms(plan, raster, self.frames[0]).nominal_flops()
    }

    /// Measures the error of a window; `None` if it needs more than `most_flops` operations, and so would not save time.
    fn attempt(
        &self,
        settings: &Settings,
        most_flops: f64,
        SearchSample { drawn, rounds }: &mut SearchSample,
        progress: &dyn Progress,
    ) -> Result<Option<TriedWindow>> {
        let plan = self.plan(settings)?;
        let raster = *ProbeRaster::new(&plan, self.asked)?.scan();
        let flops = self.flops(&plan, &raster);
        if !plan.has_windows() || flops > most_flops {
            return Ok(None);
        }
        let (sample, shape, most_rounds) = drawn.get_or_insert_with(|| {
            let [x, y, _] = self.cell_angstrom;
            let sample = ProbeSample::new(&raster, self.sampled_atoms(), [x, y]);
            let (shape, most_rounds) = self.sample_shape(&sample, flops);
            (sample, shape, most_rounds)
        });
        let per_round = shape[0] * shape[1];
        // A sample of a large share of the scan would take as long as the scan.
        if 2 * per_round > self.asked.len() {
            return Ok(None);
        }
        let estimate =
            self.estimate(&plan, &raster, (sample, *shape, *most_rounds), rounds, progress)?;
        let [found_percent, likely_percent] =
            estimate.percent().map(|percent| percent.hypot(slices_percent(&plan)));
        Ok(Some(TriedWindow {
            width_angstrom: width(settings),
            angle_margin: settings.angle_margin,
            found_percent,
            likely_percent,
            probes: estimate.clusters() * shape[1],
        }))
    }

    /// Settings with windows, narrow ones first. All have equal probes.
    fn candidates(&self) -> Result<Vec<Settings>> {
        let size = relative_size(self.base).max(1.0);
        let blur = 2.0 * geometric_radius(self.base);
        let several = usize::from(self.sampled_configurations() > 1);
        let first = WINDOWS.iter().position(|(_, least)| self.accuracy_percent >= least[several]);
        let windows = &WINDOWS[first.unwrap_or(0)..];
        let of = |(width, _): &(f64, _)| Settings {
            algorithm: Algorithm::Window { width_angstrom: width * size + blur },
            ..self.base.clone()
        };
        let mut candidates: Vec<Settings> = windows.iter().map(of).collect();
        if self.base.probe_step == ProbeStep::Auto {
            let raster = ProbeRaster::new(&self.plan(&candidates[0])?, self.asked)?;
            let probe_step = match raster.interpolates() {
                true => interpolated_step(self.base),
                false => ProbeStep::Scan,
            };
            candidates.iter_mut().for_each(|c| c.probe_step = probe_step);
        }
        Ok(candidates)
    }

    /// The windows again on a grid that carries the angles of the exact engine, where the errors of those that were tried have stopped
    /// falling with the width: from the first on whose error without the others' least one is not above the requested one.
    fn on_finer_grid(&self, tried: &[TriedWindow], candidates: &[Settings]) -> Vec<Settings> {
        let outermost = self.base.detectors.iter().map(|d| d.outer_mrad).fold(0.0, f64::max);
        let angle_margin = (self.exact.plan.band_limit_mrad / outermost.max(1e-9)).min(MOST_MARGIN);
        let [.., before, last] = tried else { return Vec::new() };
        let stopped = last.found_percent > STOPPED * before.found_percent;
        let coarse = angle_margin > FINER * self.base.angle_margin;
        if self.base.grid != GridChoice::Auto || !stopped || !coarse {
            return Vec::new();
        }
        let least = tried.iter().map(|t| t.found_percent).fold(f64::INFINITY, f64::min);
        let alone = |t: &TriedWindow| (t.found_percent.powi(2) - least.powi(2)).max(0.0).sqrt();
        let first = tried.iter().position(|t| alone(t) <= self.accuracy_percent);
        let again = &candidates[first.unwrap_or(tried.len())..];
        again.iter().map(|c| Settings { angle_margin, ..c.clone() }).collect()
    }

    fn plan(&self, settings: &Settings) -> Result<Plan> {
        Plan::new(settings, self.cell_angstrom, &self.heights)
    }

    /// The atoms of all frames that any round uses.
    fn sampled_atoms(&self) -> impl Iterator<Item = &Site> {
        let rounds = (0..ROUNDS).flat_map(|round| frames_of_round(round, self.frames.len()));
        let frames: BTreeSet<usize> = rounds.collect();
        frames.into_iter().flat_map(|frame| self.frames[frame])
    }

    /// Number of phonon configurations in which a round samples.
    fn sampled_configurations(&self) -> u32 {
        if self.base.configurations() < IN_TWO_FROM { 1 } else { 2 }
    }

    /// Number of clusters of a round, and of probes in each, for a scan of `flops` operations; and the largest number of rounds.
    fn sample_shape(&self, sample: &ProbeSample, flops: f64) -> ([usize; 2], u32) {
        let probe_flops = self.exact.flops(self.asked, 1) - self.exact.flops(self.asked, 0);
        let probes =
            (SHARE * flops / probe_flops) as usize / self.sampled_configurations() as usize;
        let (each, most_rounds) = match probes < CLUSTERS.0 * PROBES.1 {
            true => (PROBES.0, ROUNDS_OF_SMALL),
            false => (PROBES.1, ROUNDS),
        };
        let clusters = (probes / each).clamp(CLUSTERS.0, CLUSTERS.1);
        // Small scans have few clusters.
        let clusters = clusters.min(sample.clusters());
        ([clusters, (CLUSTERS.0 * each / clusters).max(each)], most_rounds)
    }

    /// Measures the error of a plan with windows. Rounds are added to the sample until it is clear whether the error is small enough.
    fn estimate(
        &self,
        plan: &Plan,
        raster: &Scan,
        (sample, shape, most_rounds): (&ProbeSample, [usize; 2], u32),
        rounds: &mut Vec<Round>,
        progress: &dyn Progress,
    ) -> Result<ErrorEstimate> {
        let images = plan.record_after.len() * plan.settings.detectors.len();
        let all: BTreeSet<u8> = self.frames.iter().flat_map(|sites| elements(sites)).collect();
        let mut simulation = Simulation::new(plan, &all.into_iter().collect::<Vec<u8>>())?;
        let mut estimate = ErrorEstimate::new(self.base.configurations());
        let left_percent =
            (self.accuracy_percent.powi(2) - slices_percent(plan).powi(2)).max(0.0).sqrt();
        for number in 0..most_rounds {
            if rounds.len() <= number as usize {
                rounds.push(self.round(
                    raster,
                    sample.draw(shape[0], shape[1], number),
                    number,
                    progress,
                )?);
            }
            let Round { configurations, parts } = &rounds[number as usize];
            for FrameSample { frame, clusters, exact } in parts {
                let indices: Vec<usize> = clusters.iter().flat_map(|c| c.indices.clone()).collect();
                let (sites, quiet) = (self.frames[*frame], InterruptOnly(progress));
                let in_one = |configuration: &u32| {
                    let values =
                        simulation.some_probes(sites, raster, &indices, *configuration, &quiet)?;
                    Ok(by_cluster(&values, clusters))
                };
                let ours = configurations.iter().map(in_one).collect::<Result<Vec<_>>>()?;
                for (n, cluster) in clusters.iter().enumerate() {
                    let mut both = ours.iter().zip(exact).map(|(o, e)| (&o[n][..], &e[n][..]));
                    if let Some(first) = both.next() {
                        estimate.add(cluster, images, first, both.next());
                    }
                }
            }
            if estimate.verdict(left_percent) != AccuracyVerdict::Unclear {
                break;
            }
        }
        Ok(estimate)
    }

    fn round(
        &self,
        raster: &Scan,
        clusters: Vec<DrawnCluster>,
        number: u32,
        progress: &dyn Progress,
    ) -> Result<Round> {
        let (each, all) = (self.sampled_configurations(), self.base.configurations());
        let configurations: Vec<u32> = (0..each).map(|n| (each * number + n) % all).collect();
        let probes: usize = clusters.iter().map(|c| c.indices.len()).sum();
        let simulated = probes * configurations.len();
        progress.start("measuring the error of windows", "probes", simulated as u64);
        let frames = frames_of_round(number, self.frames.len());
        let part = |(n, frame): (usize, usize)| {
            let clusters: Vec<DrawnCluster> =
                clusters.iter().skip(n).step_by(frames.len()).cloned().collect();
            let (exact, sites) = (&self.exact, self.frames[frame]);
            let exact = exact.intensities(sites, raster, &clusters, &configurations, progress)?;
            Ok(FrameSample { frame, clusters, exact })
        };
        let parts = frames.iter().copied().enumerate().map(part).collect::<Result<_>>()?;
        progress.finish();
        Ok(Round { configurations, parts })
    }
}

/// Error of a plan's slices in per cent of the mean that the sample may not see.
fn slices_percent(plan: &Plan) -> f64 {
    if plan.has_local_slices() { LOCAL_SLICES_PERCENT } else { 0.0 }
}

fn width(settings: &Settings) -> f64 {
    match settings.algorithm {
        Algorithm::Window { width_angstrom } => width_angstrom,
        _ => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_rounds_together_look_at_frames_at_even_distances() {
        assert_eq!(frames_of_round(3, 1), [0]);
        assert_eq!(frames_of_round(1, 3), [0, 1, 2]);
        let mut all: Vec<usize> =
            (0..ROUNDS).flat_map(|round| frames_of_round(round, 160)).collect();
        all.sort();
        assert_eq!(all, (0..16).map(|n| 10 * n).collect::<Vec<_>>());
        for count in 5..40 {
            let frames = frames_of_round(2, count);
            assert!(frames.windows(2).all(|w| w[0] < w[1]) && frames[3] < count, "{frames:?}");
        }
    }

    #[test]
    fn heights_are_means_over_frames_with_as_many_atoms() {
        let at = |z: f64| Site {
            position: [0.0, 0.0, z],
            number: 6,
            sigma_angstrom: 0.0,
            anisotropy: None,
            key: 0,
        };
        let (a, b) = ([at(1.0), at(2.0)], [at(3.0), at(2.0)]);
        assert_eq!(mean_heights(&[&a, &b]), [2.0, 2.0]);
        assert_eq!(mean_heights(&[&a, &b[..1]]), [1.0, 2.0]);
    }
}
