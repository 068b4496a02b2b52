//! Images of one specimen through several lenses: a defocus series.
//!
//! The specimen does not depend on the lens. Plans that differ only in aberrations share the transmission functions, and with PRISM the
//! propagated waves, which is nearly all of the work. Every image has the bytes that [`simulate()`](super::simulate()) computes for it
//! alone.

use super::detector_images::Images;
use super::plan::Plan;
use super::probe_raster::ProbeRaster;
use super::probe_scan::{ProbePlaces, Scan};
use super::scan_part::{Known, ScanPart, blank, probes_of, values_of};
use super::simulate::{LensEngine, elements};
use super::transmission::TransmissionBuilder;
use crate::error::{Error, Result};
use crate::files::Shard;
use crate::progress::{Progress, ProgressShare};
use crate::structure::Site;

/// Simulates the images of a scan by each plan, averaged over the frames (sites) of a trajectory. There is at least one frame. Probes of
/// `parts`, which other processes have made, are not simulated again; the images have the same bytes with and without them.
///
/// # Errors
/// Errors of [`simulate()`](super::simulate()); [`Error::Invalid`] for parts of another series.
pub(crate) fn simulate_series(
    plans: &[Plan],
    frames: &[&[Site]],
    scan: &Scan,
    parts: &[ScanPart],
    progress: &dyn Progress,
) -> Result<Vec<Images>> {
    series(plans, frames, scan.into(), parts, progress)
}

/// Simulates one process's part of a series that several processes share.
///
/// # Errors
/// Errors of [`simulate()`](super::simulate()); [`Error::Invalid`] for plans for PRISM, whose waves contain all probes.
pub fn simulate_part(
    plans: &[Plan],
    frames: &[&[Site]],
    scan: &Scan,
    shard: Shard,
    progress: &dyn Progress,
) -> Result<ScanPart> {
    let rasters = plans.iter().map(|plan| ProbeRaster::new(plan, scan));
    let rasters = rasters.collect::<Result<Vec<_>>>()?;
    let wanted: Vec<Vec<bool>> =
        plans.iter().zip(&rasters).map(|(p, r)| probes_of(p, r.scan(), shard)).collect();
    let probes = |mask: &Vec<bool>| mask.iter().filter(|w| **w).count();
    let each = |(plan, mask): (&Plan, &Vec<bool>)| {
        probes(mask) * plan.settings.configurations() as usize * frames.len()
    };
    let total: usize = plans.iter().zip(&wanted).map(each).sum();
    progress.start("simulating", "probes", total as u64);
    let mut part = ScanPart::new(shard);
    let mut first = 0;
    for group in plans.chunk_by(differ_in_the_lens) {
        let (raster, wanted) = (&rasters[first], &wanted[first]);
        let mut run = LensGroup::new(group, frames)?;
        let share = ProgressShare::new(progress, each((&group[0], wanted)) * group.len());
        let mut by_plan = vec![Vec::new(); group.len()];
        for sites in frames {
            let places = (raster.scan().into(), Some(wanted.as_slice()));
            let images = match probes(wanted) {
                0 => run.blank(raster.scan().into()),
                _ => run.images(sites, places, &share)?,
            };
            for (kept, images) in by_plan.iter_mut().zip(&images) {
                kept.push(values_of(images, wanted));
            }
        }
        share.complete();
        by_plan.into_iter().flatten().for_each(|values| part.push(values));
        first += group.len();
    }
    progress.finish();
    Ok(part)
}

/// Simulates single probes as [`simulate_series`] does, each at a place (x, y) in Angstrom. A probe is propagated at every place, in a
/// window of its own where the plan has windows. The values are in one row, (thickness, detector, 0, place).
///
/// # Errors
/// Errors of [`simulate()`](super::simulate()); [`Error::Invalid`] for places that are not finite, and for plans for PRISM, which has no
/// single probes.
pub(crate) fn simulate_places(
    plans: &[Plan],
    frames: &[&[Site]],
    places_angstrom: &[[f64; 2]],
    progress: &dyn Progress,
) -> Result<Vec<Images>> {
    if let Some(bad) = places_angstrom.iter().find(|p| !p.iter().all(|v| v.is_finite())) {
        let expected = "a place of a probe is two finite numbers";
        return Err(Error::invalid(crate::Setting::Region, format!("{bad:?}"), expected));
    }
    if places_angstrom.is_empty() {
        let expected = "expected one place of a probe or more";
        return Err(Error::invalid(crate::Setting::Region, "nothing", expected));
    }
    series(plans, frames, ProbePlaces::Each(places_angstrom), &[], progress)
}

fn series(
    plans: &[Plan],
    frames: &[&[Site]],
    places: ProbePlaces<'_>,
    parts: &[ScanPart],
    progress: &dyn Progress,
) -> Result<Vec<Images>> {
    let total: usize = plans.iter().map(|plan| probes(plan, places) * frames.len()).sum();
    progress.start("simulating", "probes", total as u64);
    let mut all = Vec::new();
    for group in plans.chunk_by(differ_in_the_lens) {
        let known = Known { parts, first: all.len() * frames.len(), frames: frames.len() };
        all.extend(group_images(group, frames, places, &known, progress)?);
    }
    progress.finish();
    Ok(all)
}

/// Number of probes in the progress of one image of one frame.
fn probes(plan: &Plan, places: ProbePlaces<'_>) -> usize {
    places.len() * plan.settings.configurations() as usize
}

fn differ_in_the_lens(one: &Plan, other: &Plan) -> bool {
    let mut alike = other.clone();
    alike.settings.optics.aberrations = one.settings.optics.aberrations.clone();
    alike.warnings.clone_from(&one.warnings);
    alike == *one
}

/// Engines for plans that differ only in aberrations, ready to run.
struct LensGroup<'a> {
    plans: &'a [Plan],
    builder: TransmissionBuilder<'a>,
    lenses: Vec<LensEngine<'a>>,
}

impl<'a> LensGroup<'a> {
    fn new(plans: &'a [Plan], frames: &[&[Site]]) -> Result<Self> {
        let all: Vec<Site> = frames.iter().flat_map(|sites| sites.iter().copied()).collect();
        let builder = TransmissionBuilder::new(&plans[0], &elements(&all))?;
        Ok(LensGroup { plans, builder, lenses: plans.iter().map(LensEngine::new).collect() })
    }

    /// The images of a frame, from [`LensEngine::images`].
    fn images(
        &mut self,
        sites: &[Site],
        places: (ProbePlaces<'_>, Option<&[bool]>),
        progress: &dyn Progress,
    ) -> Result<Vec<Images>> {
        LensEngine::images(&mut self.lenses, &self.builder, sites, places, progress)
    }

    /// Images without values.
    fn blank(&self, places: ProbePlaces<'_>) -> Vec<Images> {
        self.plans.iter().map(|plan| blank(plan, places)).collect()
    }
}

/// The images of plans that differ only in aberrations.
fn group_images(
    plans: &[Plan],
    frames: &[&[Site]],
    places: ProbePlaces<'_>,
    known: &Known<'_>,
    progress: &dyn Progress,
) -> Result<Vec<Images>> {
    let raster = match places {
        ProbePlaces::Raster(scan) => Some(ProbeRaster::new(&plans[0], scan)?),
        ProbePlaces::Each(_) => None,
    };
    let simulated = raster.as_ref().map_or(places, |raster| raster.scan().into());
    let missing = known.missing(&plans[0], raster.as_ref().map(ProbeRaster::scan));
    let mut run = LensGroup::new(plans, frames)?;
    let mut sums = Vec::new();
    for (number, sites) in frames.iter().enumerate() {
        let share =
            ProgressShare::new(progress, plans.iter().map(|plan| probes(plan, places)).sum());
        let wanted = missing.as_deref();
        let mut images = match wanted.is_some_and(|w| !w.contains(&true)) {
            true => run.blank(simulated),
            false => run.images(sites, (simulated, wanted), &share)?,
        };
        share.complete();
        for (lens, images) in images.iter_mut().enumerate() {
            known.put(
                images,
                (&plans[0], raster.as_ref().map(ProbeRaster::scan)),
                [lens, number],
            )?;
        }
        let of_scan = |images| match &raster {
            Some(raster) => raster.images(images),
            None => images,
        };
        let images = images.into_iter().map(of_scan);
        if frames.len() == 1 {
            return Ok(images.collect());
        }
        for (lens, images) in images.enumerate() {
            match number {
                0 => sums.push((images.data.mapv(f64::from), images)),
                _ => sums[lens].0.zip_mut_with(&images.data, |s, v| *s += f64::from(*v)),
            }
        }
    }
    let count = frames.len() as f64;
    let mean = |(sum, images): (ndarray::Array4<f64>, Images)| Images {
        data: sum.mapv(|s| (s / count) as f32),
        ..images
    };
    Ok(sums.into_iter().map(mean).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::Detector;
    use crate::engine::{Algorithm, Phonons, Settings, simulate};
    use crate::optics::Aberrations;
    use crate::progress::Silent;

    fn sites() -> Vec<Site> {
        let atoms = [([1.0, 1.2, 1.0], 38), ([3.1, 3.0, 3.0], 22), ([2.9, 0.9, 3.1], 8)];
        let site = |(key, (position, number))| Site {
            position,
            number,
            sigma_angstrom: 0.08,
            anisotropy: None,
            key,
        };
        (0..).zip(atoms).map(site).collect()
    }

    fn plans(algorithm: Algorithm) -> Vec<Plan> {
        let plan = |defocus: f64| {
            let mut settings = Settings { algorithm, ..Settings::default() };
            // The small outer angle keeps the grids of the waves small.
            settings.detectors = vec![Detector::new("ADF", 40.0, 80.0)];
            settings.optics.aberrations = Aberrations::defocus(defocus);
            settings.phonons = Some(Phonons { configurations: 2, seed: 3 });
            Plan::new(&settings, [11.0, 11.0, 4.0], &[1.0, 3.0, 3.1]).unwrap()
        };
        [0.0, 40.0, -25.0].map(plan).to_vec()
    }

    /// Records the totals and steps that a progress bar would show.
    #[derive(Default)]
    struct Bars(std::sync::Mutex<(Vec<u64>, u64)>);

    impl Progress for Bars {
        fn start(&self, _: &str, _: &str, total: u64) {
            self.0.lock().unwrap().0.push(total);
        }
        fn advance(&self, n: u64) {
            self.0.lock().unwrap().1 += n;
        }
        fn finish(&self) {}
        fn warn(&self, _: &str) {}
        fn interrupted(&self) -> bool {
            false
        }
    }

    #[test]
    fn a_series_has_the_bytes_of_single_runs_under_one_bar() {
        let scan = Scan { origin_angstrom: [0.5, 0.2], step_angstrom: [0.4; 2], shape: [5, 6] };
        let sites = sites();
        for algorithm in [
            Algorithm::Multislice,
            Algorithm::Prism { interpolation: [1, 1] },
            Algorithm::Prism { interpolation: [2, 2] },
            Algorithm::Window { width_angstrom: 7.8 },
        ] {
            let plans = plans(algorithm);
            assert!(plans.windows(2).all(|p| differ_in_the_lens(&p[0], &p[1])));
            let bars = Bars::default();
            let series = simulate_series(&plans, &[&sites], &scan, &[], &bars).unwrap();
            for (plan, images) in plans.iter().zip(&series) {
                assert_eq!(
                    *images,
                    simulate(plan, &sites, &scan, &Silent).unwrap(),
                    "{algorithm:?}"
                );
            }
            assert_ne!(series[0].data, series[1].data);
            let (totals, done) = bars.0.into_inner().unwrap();
            assert_eq!((totals, done), (vec![3 * 2 * 30], 3 * 2 * 30));
        }
    }

    #[test]
    fn parts_of_several_processes_make_the_same_bytes() {
        // The scan is dense enough for windows to be expanded, and for interpolation.
        let dense = Scan { origin_angstrom: [0.5, 0.2], step_angstrom: [0.3; 2], shape: [17, 19] };
        let coarse = Scan { origin_angstrom: [0.5, 0.2], step_angstrom: [1.7; 2], shape: [5, 4] };
        let (first, mut second) = (sites(), sites());
        second.iter_mut().for_each(|s| s.position[0] += 0.2);
        let frames: [&[Site]; 2] = [&first, &second];
        for (algorithm, scan) in [
            (Algorithm::Multislice, coarse),
            (Algorithm::Window { width_angstrom: 7.8 }, dense),
            (Algorithm::Window { width_angstrom: 7.8 }, coarse),
        ] {
            let mut plans = plans(algorithm);
            let finer = Settings { band_fraction: 0.7, ..plans[0].settings.clone() };
            plans.insert(1, Plan::new(&finer, [11.0, 11.0, 4.0], &[1.0, 3.0, 3.1]).unwrap());
            let whole = simulate_series(&plans, &frames, &scan, &[], &Silent).unwrap();
            let of = (plans.as_slice(), frames.len(), &scan);
            let count = 3;
            let part = |k| {
                let shard = Shard::new(k, count).unwrap();
                let part = simulate_part(&plans, &frames, &scan, shard, &Silent).unwrap();
                let array = part.to_array();
                let shape = ScanPart::shape(shard, &plans, frames.len(), &scan).unwrap();
                assert_eq!(array.shape(), shape);
                assert_eq!(ScanPart::from_array(&array, shard, of).unwrap(), part);
                let cut = array.slice(ndarray::s![..array.nrows().saturating_sub(1), ..]);
                assert!(
                    array.nrows() == 0 || ScanPart::from_array(&cut.to_owned(), shard, of).is_err()
                );
                part
            };
            let mut parts: Vec<ScanPart> = (0..count).rev().map(part).collect();
            let from = |parts: &[ScanPart]| {
                simulate_series(&plans, &frames, &scan, parts, &Silent).unwrap()
            };
            assert!(from(&parts) == whole, "{algorithm:?} in {count}");
            parts.remove(0);
            assert!(from(&parts) == whole, "{algorithm:?} in {count}, one missing");
            // A part of other atoms is noticed by its values.
            let other = [simulate_part(&plans, &[&second], &scan, Shard::WHOLE, &Silent).unwrap()];
            assert!(simulate_series(&plans, &frames, &scan, &other, &Silent).is_err());
        }
        let prism = plans(Algorithm::Prism { interpolation: [1, 1] });
        let refused = simulate_part(&prism, &frames, &dense, Shard::WHOLE, &Silent).unwrap_err();
        assert!(refused.to_string().contains("single probes"), "{refused}");
    }

    #[test]
    fn single_probes_are_those_of_a_scan() {
        let scan = Scan { origin_angstrom: [0.5, -0.2], step_angstrom: [2.9, 3.1], shape: [2, 3] };
        let places: Vec<[f64; 2]> = (0..scan.len()).rev().map(|i| scan.position(i)).collect();
        let sites = sites();
        for algorithm in [Algorithm::Multislice, Algorithm::Window { width_angstrom: 7.8 }] {
            let plans = plans(algorithm);
            let of_scan = simulate_series(&plans, &[&sites], &scan, &[], &Silent).unwrap();
            let of_places = simulate_places(&plans, &[&sites], &places, &Silent).unwrap();
            for (scanned, single) in of_scan.iter().zip(&of_places) {
                assert_eq!(single.data.shape(), &[1, 1, 1, 6]);
                let mut backwards: Vec<f32> = scanned.data.iter().copied().collect();
                backwards.reverse();
                assert_eq!(single.data.iter().copied().collect::<Vec<f32>>(), backwards);
            }
        }
        let refused = |plans: &[Plan], places: &[[f64; 2]]| {
            simulate_places(plans, &[&sites], places, &Silent).unwrap_err().to_string()
        };
        let exact = plans(Algorithm::Multislice);
        assert!(refused(&exact, &[[f64::NAN, 0.0]]).contains("finite"));
        assert!(refused(&exact, &[]).contains("one place"));
        let prism = plans(Algorithm::Prism { interpolation: [1, 1] });
        assert!(refused(&prism, &places).contains("single probes"));
    }

    #[test]
    fn frames_are_averaged_and_other_plans_stand_alone() {
        let scan = Scan { origin_angstrom: [0.5, 0.2], step_angstrom: [0.4; 2], shape: [2, 3] };
        let (first, mut second) = (sites(), sites());
        second.iter_mut().for_each(|s| s.position[0] += 0.2);
        let mut plans = plans(Algorithm::Multislice);
        let finer = Settings { band_fraction: 0.7, ..plans[0].settings.clone() };
        plans.insert(1, Plan::new(&finer, [11.0, 11.0, 4.0], &[1.0, 3.0, 3.1]).unwrap());
        assert!(!differ_in_the_lens(&plans[0], &plans[1]));
        let series = simulate_series(&plans, &[&first, &second], &scan, &[], &Silent).unwrap();
        for (plan, images) in plans.iter().zip(&series) {
            let one = simulate(plan, &first, &scan, &Silent).unwrap().data;
            let two = simulate(plan, &second, &scan, &Silent).unwrap().data;
            for ((mean, a), b) in images.data.iter().zip(&one).zip(&two) {
                assert_eq!(*mean, ((f64::from(*a) + f64::from(*b)) / 2.0) as f32);
            }
        }
    }
}
