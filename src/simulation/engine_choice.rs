//! Chooses the engine for the images of a scan where the request leaves it open: the fastest engine within an error.

use std::borrow::Cow;

use super::job::SimulationJob;
use super::numerics_request::NumericsRequest;
use crate::engine::{
    AccuracyFound, Algorithm, Cost, ExactEngine, Plan, ProbeBox, ProbeRaster, Settings,
    mean_heights, settings_for_accuracy,
};
use crate::error::Result;
use crate::progress::Progress;

/// Largest rms error in per cent of the mean image, if the request gives neither an engine nor an accuracy.
pub(crate) const DEFAULT_ACCURACY_PERCENT: f64 = 0.5;
/// The exact engine is used without a measurement of errors if all images and configurations take fewer operations than this (a second or
/// two), or fewer probes than `FEW_PROBES`. A round of the measurement would take more than a tenth of that.
const LITTLE_FLOPS: f64 = 3e10;
const FEW_PROBES: usize = 320;
/// A plan that is only shown measures errors if the samples take at most this many operations, a second or two.
const QUICK_FLOPS: f64 = 3e10;
/// Approximate number of probes of each image that the choice samples (`engine::accuracy`).
const SAMPLED: usize = 64;

/// Plans, and the result of the choice for each.
type Chosen = (Vec<Plan>, Vec<AccuracyFound>);

impl NumericsRequest {
    /// Whether the request leaves the engine to the program. A probe with norm 1 in the cell is for the exact engine.
    pub(crate) fn leaves_engine_open(&self) -> bool {
        let chosen = self.engine.is_some()
            || self.window_angstrom.is_some()
            || self.interpolation.is_some()
            || self.accuracy_percent.is_some();
        !chosen && self.probe_box != Some(ProbeBox::Cell)
    }
}

impl SimulationJob {
    /// The largest rms error of the images against the exact engine, in per cent of the mean image; `None` if the request names an engine.
    pub(crate) fn accuracy_asked(&self) -> Option<f64> {
        let request = self.request();
        if request.plane_wave || request.patterns.is_some() {
            return None;
        }
        let open = request.numerics.leaves_engine_open();
        request.numerics.accuracy_percent.or(open.then_some(DEFAULT_ACCURACY_PERCENT))
    }

    /// Makes the plans as accurate as requested, by simulating samples; does nothing if the request names an engine. All images of a series
    /// get one engine.
    ///
    /// # Errors
    /// Errors of [`settings_for_accuracy`].
    pub fn choose_accuracy(&mut self, progress: &dyn Progress) -> Result<()> {
        if let Some((plans, found)) = self.choice(progress)? {
            (self.plans, self.accuracies) = (plans, found);
        }
        Ok(())
    }

    /// Chooses as [`SimulationJob::choose_accuracy`] does, for a plan that is only shown. Unless the request gives an accuracy, samples
    /// that would take some seconds are left out, and the plans are made for the exact engine ([`AccuracyFound::chosen_later`]).
    ///
    /// # Errors
    /// As [`SimulationJob::choose_accuracy`].
    pub fn choose_quickly(&mut self, progress: &dyn Progress) -> Result<()> {
        let exact = self.exact_engines()?;
        let sampled = |exact: &ExactEngine| exact.flops(&self.scan, SAMPLED);
        let quick = exact.iter().map(sampled).sum::<f64>() <= QUICK_FLOPS;
        let asked = self.accuracy_asked().filter(|_| self.request().numerics.leaves_engine_open());
        match asked {
            Some(asked) if !quick && !self.takes_little(&exact)? => {
                let later = |exact: &ExactEngine| AccuracyFound {
                    chosen_later: true,
                    ..AccuracyFound::exact(asked, exact)
                };
                self.accuracies = exact.iter().map(later).collect();
                self.plans = exact.into_iter().map(|exact| exact.plan).collect();
                Ok(())
            }
            _ => self.choose_accuracy(progress),
        }
    }

    /// The plans by which images are made, after the choice.
    pub(super) fn chosen_plans(&self, progress: &dyn Progress) -> Result<Cow<'_, [Plan]>> {
        let chosen = self.choice(progress)?;
        Ok(chosen.map_or(Cow::Borrowed(self.plans()), |(plans, _)| Cow::Owned(plans)))
    }

    /// The plans for single probes, without a choice: the exact engine if the request leaves the engine open.
    pub(super) fn plans_of_single_probes(&self) -> Result<Cow<'_, [Plan]>> {
        match self.request().numerics.leaves_engine_open() {
            false => Ok(Cow::Borrowed(self.plans())),
            true => {
                let exact = self.exact_engines()?;
                Ok(Cow::Owned(exact.into_iter().map(|exact| exact.each).collect()))
            }
        }
    }

    /// Makes the choice; `None` if there is none to make, or it was already made.
    fn choice(&self, progress: &dyn Progress) -> Result<Option<Chosen>> {
        let Some(asked) = self.accuracy_asked().filter(|_| self.accuracies.is_empty()) else {
            return Ok(None);
        };
        let exact = self.exact_engines()?;
        let at_once = |found: Vec<AccuracyFound>| {
            let plans = exact.iter().map(|exact| exact.plan.clone()).collect();
            Ok(Some((plans, found)))
        };
        if self.request().numerics.accuracy_percent.is_none() && self.takes_little(&exact)? {
            return at_once(exact.iter().map(|e| AccuracyFound::exact(asked, e)).collect());
        }
        let (frames, size) = (self.specimen().frames(), self.specimen().size_angstrom);
        let (mut all, mut found) = (Vec::new(), Vec::new());
        for plan in self.plans() {
            let scan = self.scan();
            let (settings, one) =
                settings_for_accuracy(asked, &plan.settings, size, &frames, scan, progress)?;
            all.push(settings);
            found.push(one);
        }
        if found.iter().any(|one| !one.holds) {
            for (one, exact) in found.iter_mut().zip(&exact) {
                (one.holds, one.algorithm) = (false, exact.plan.settings.algorithm);
            }
            return at_once(found);
        }
        // The widest window of the series is wide enough for all its images.
        let windows = || found.iter().filter_map(AccuracyFound::window);
        let width_angstrom = windows().map(|window| window.width_angstrom).fold(0.0, f64::max);
        let angle_margin = windows().map(|window| window.angle_margin).fold(0.0, f64::max);
        let algorithm = Algorithm::Window { width_angstrom };
        found.iter_mut().for_each(|one| one.algorithm = algorithm);
        let plan = |settings: Settings| {
            let settings = Settings { algorithm, angle_margin, ..settings };
            Plan::new(&settings, size, &self.specimen().heights_angstrom)
        };
        Ok(Some((all.into_iter().map(plan).collect::<Result<_>>()?, found)))
    }

    /// The exact engine for each plan.
    fn exact_engines(&self) -> Result<Vec<ExactEngine>> {
        let heights = mean_heights(&self.specimen().frames());
        let size = self.specimen().size_angstrom;
        let of = |plan: &Plan| ExactEngine::new(&plan.settings, size, &heights);
        self.plans().iter().map(of).collect()
    }

    /// Whether the exact engine is so cheap that no errors are measured.
    fn takes_little(&self, exact: &[ExactEngine]) -> Result<bool> {
        let (mut flops, mut probes) = (0.0, 0);
        for ExactEngine { plan, .. } in exact {
            let raster = *ProbeRaster::new(plan, self.scan())?.scan();
            flops += Cost::new(plan, &raster).nominal_flops();
            probes += raster.len() * plan.settings.configurations() as usize;
        }
        let frames = self.specimen().frames().len();
        Ok(flops * (frames as f64) < LITTLE_FLOPS || probes * frames < FEW_PROBES)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::ProbeStep;
    use crate::progress::Silent;
    use crate::simulation::{Engine, SimulationRequest};

    fn request(change: &dyn Fn(&mut SimulationRequest)) -> SimulationRequest {
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/structures/si.cif");
        let mut request = SimulationRequest::of_file(file);
        request.specimen.repeat = Some([3, 3, 1]);
        request.scan.end = Some([5.431, 5.431]);
        request.scan.points = Some([3, 3]);
        change(&mut request);
        request
    }

    #[test]
    fn what_is_left_open_is_the_exact_engine_where_that_takes_little() {
        let mut job = SimulationJob::new(request(&|_| ())).unwrap();
        assert_eq!(job.accuracy_asked(), Some(DEFAULT_ACCURACY_PERCENT));
        let at_once = job.run(&Silent).unwrap();
        job.choose_accuracy(&Silent).unwrap();
        let settings = &job.plans()[0].settings;
        assert_eq!(settings.algorithm, Algorithm::Multislice);
        assert_eq!(settings.probe_box, Some(ProbeBox::Large));
        assert!(matches!(settings.probe_step, ProbeStep::Angstrom(_)), "{settings:?}");
        let [found] = job.accuracies() else { panic!("{:?}", job.accuracies()) };
        assert!(!found.holds && found.tried.is_empty());
        // A run without an earlier choice gives equal images.
        assert_eq!(job.run(&Silent).unwrap()[0].data, at_once[0].data);
        // Single probes are equal too, except for interpolation.
        let probe = job.probes(&[[0.0, 0.0]], true, &Silent).unwrap();
        let (one, of_scan) = (probe[0].image(0, 0)[[0, 0]], at_once[0].data[[0, 0, 0]]);
        assert!((one / of_scan - 1.0).abs() < 1e-3, "{one} {of_scan}");
    }

    #[test]
    fn a_named_engine_is_taken_as_it_is() {
        let named: [&dyn Fn(&mut SimulationRequest); 4] = [
            &|r| r.numerics.engine = Some(Engine::Multislice),
            &|r| r.numerics.window_angstrom = Some(9.0),
            &|r| r.numerics.interpolation = Some([1, 1]),
            &|r| r.numerics.probe_box = Some(ProbeBox::Cell),
        ];
        for change in named {
            let mut job = SimulationJob::new(request(change)).unwrap();
            let before = job.plans().to_vec();
            job.choose_accuracy(&Silent).unwrap();
            assert!(job.accuracy_asked().is_none() && job.accuracies().is_empty());
            assert_eq!(job.plans(), before);
        }
        let plane_wave = request(&|r| {
            r.plane_wave = true;
            r.scan = super::super::ScanRequest::default();
        });
        assert_eq!(SimulationJob::new(plane_wave).unwrap().accuracy_asked(), None);
    }

    #[test]
    fn a_series_has_one_engine() {
        let mut job = SimulationJob::new(request(&|r| {
            r.specimen.repeat = Some([6, 6, 1]);
            r.scan = super::super::ScanRequest::default();
            (r.scan.start, r.scan.end) = (Some([8.0; 2]), Some([14.4; 2]));
            r.scan.step_angstrom = Some(0.4);
            r.numerics.accuracy_percent = Some(3.0);
            r.microscope.defocus_angstrom = vec![0.0, 100.0];
        }))
        .unwrap();
        job.choose_accuracy(&Silent).unwrap();
        let algorithms: Vec<_> = job.plans().iter().map(|p| p.settings.algorithm).collect();
        assert!(matches!(algorithms[0], Algorithm::Window { .. }), "{algorithms:?}");
        assert_eq!(algorithms[0], algorithms[1]);
    }
}
