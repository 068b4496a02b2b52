//! A prepared simulation: plans, warnings, memory and time, and the run.

use ndarray::{Array2, Array3, Array5, ArrayView3, Axis};
use num_complex::Complex32;

use super::atoms::PreparedSpecimen;
use super::images::{self, CountedDose, SimulatedImage};
use super::pattern_job;
use super::plan_report::PlanReport;
use super::plane_wave::{self, PlaneWaveImages};
use super::plausibility::{self, Warning};
use super::request::SimulationRequest;
use super::time_estimate::threads;
use crate::detect::{ShownImage, shown_images};
use crate::engine::{
    AccuracyFound, Cost, Images, Plan, ProbeRaster, Scan, ScanPart, SourceBlur, check_memory,
    has_exit_waves, mean_diffraction, probe_exit_waves, simulate_part, simulate_places,
    simulate_series,
};
use crate::error::{Error, Result};
use crate::files::Shard;
use crate::imaging::check_countable;
use crate::progress::Progress;
use crate::setting::Setting;

/// A simulation that is ready to run: the atoms are read, and the work is planned.
#[derive(Debug)]
pub struct SimulationJob {
    request: SimulationRequest,
    specimen: PreparedSpecimen,
    /// One plan for each defocus.
    pub(super) plans: Vec<Plan>,
    /// Probe positions; the pixels of the grid for a plane wave.
    pub(super) scan: Scan,
    /// The result of the choice of an engine for each plan, if the request gives or implies an accuracy.
    pub(super) accuracies: Vec<AccuracyFound>,
    warnings: Vec<Warning>,
}

impl SimulationJob {
    /// Checks the request, reads the atoms, and plans. Nothing is simulated.
    ///
    /// # Errors
    /// [`Error::Invalid`] with the wrong [`Setting`]; errors of the structure file.
    pub fn new(request: SimulationRequest) -> Result<Self> {
        request.microscope.check()?;
        check_plane_wave(&request)?;
        pattern_job::check(&request)?;
        let specimen = request.specimen.prepare(&request.structure)?;
        if request.plane_wave && !specimen.more_frames.is_empty() {
            let expected = "a plane wave images one structure; leave the frames out";
            return Err(Error::invalid(Setting::Frames, specimen.frames().len(), expected));
        }
        let mut plans = Vec::new();
        for defocus in &request.microscope.defocus_angstrom {
            plans.push(plan(&request, &specimen, *defocus)?);
        }
        let (scan, mut warnings) = scan(&request, &specimen, &plans[0])?;
        let mut all: Vec<Warning> = plans[0].warnings.iter().cloned().map(Warning::from).collect();
        all.extend(specimen.notes.iter().cloned().map(Warning::from));
        all.extend(request.microscope.warnings());
        all.append(&mut warnings);
        let mut job =
            SimulationJob { request, specimen, plans, scan, accuracies: Vec::new(), warnings: all };
        if job.accuracy_asked().is_none() {
            job.warnings.extend(job.plans[0].coarse_slices().map(Warning::from));
        }
        job.check_dose()?;
        Ok(job)
    }

    /// The request.
    pub fn request(&self) -> &SimulationRequest {
        &self.request
    }

    /// The atoms in their box.
    pub fn specimen(&self) -> &PreparedSpecimen {
        &self.specimen
    }

    /// The plans: one for each defocus.
    pub fn plans(&self) -> &[Plan] {
        &self.plans
    }

    /// Probe positions; the pixels of the grid for a plane wave.
    pub fn scan(&self) -> &Scan {
        &self.scan
    }

    /// The result of the choice of an engine, for each defocus; empty without an accuracy.
    pub fn accuracies(&self) -> &[AccuracyFound] {
        &self.accuracies
    }

    /// Warnings that a user should read before the run.
    pub fn warnings(&self) -> &[Warning] {
        &self.warnings
    }

    /// The defocus that is part of an image's name; only images of a series have it.
    pub(crate) fn series_defocus(&self, plan: usize) -> Option<f64> {
        let defocus = &self.request.microscope.defocus_angstrom;
        defocus.get(plan).copied().filter(|_| defocus.len() > 1)
    }

    /// Names of the detectors, or of the lens for a plane wave.
    pub fn detector_names(&self) -> Vec<String> {
        match self.request.plane_wave {
            true => vec!["lens".to_owned()],
            false => {
                let shown = shown_images(&self.plans[0].settings.detectors);
                shown.into_iter().map(|shown| shown.detector.name).collect()
            }
        }
    }

    /// Names of the images, in their order, without the noisy images.
    pub fn image_names(&self) -> Vec<String> {
        let mut names = Vec::new();
        for (n, plan) in self.plans.iter().enumerate() {
            let defocus = self.series_defocus(n);
            match self.request.plane_wave {
                true => names.push(images::name_of("lens", defocus)),
                false => {
                    let shown = shown_images(&plan.settings.detectors);
                    let name = |s: &ShownImage| images::name_of(&s.detector.name, defocus);
                    names.extend(shown.iter().map(name));
                }
            }
        }
        names
    }

    /// Mean number of electrons on one pixel, if the request gives a dose.
    pub fn electrons_per_pixel(&self) -> Option<f64> {
        let [x, y] = self.scan.step_angstrom;
        self.request.electrons_per_angstrom2.map(|dose| dose * x * y)
    }

    /// Refuses a dose that is not positive, a dose whose electrons cannot be counted, and detector names that noisy images would repeat.
    fn check_dose(&self) -> Result<()> {
        let Some(dose) = self.request.electrons_per_angstrom2 else { return Ok(()) };
        if !(dose > 0.0 && dose.is_finite()) {
            let expected = "expected electrons per square Angstrom, above 0";
            return Err(Error::invalid(Setting::Dose, dose, expected));
        }
        let [x, y] = self.scan.step_angstrom;
        check_countable(dose, x * y)?;
        let names = self.image_names();
        match names.iter().find(|name| names.contains(&images::noisy_name(name))) {
            None => Ok(()),
            Some(name) => {
                let expected = "is also the name of the noisy image of another detector; rename one of the two";
                Err(Error::invalid(Setting::DetectorName, images::noisy_name(name), expected))
            }
        }
    }

    /// The scan with the margin that the source needs, and the blur; `None` for a point source.
    fn source_blur(&self) -> Result<Option<SourceBlur>> {
        let [x, y, _] = self.specimen.size_angstrom;
        let source = self.request.microscope.source();
        source.map(|source| SourceBlur::new(source, &self.scan, [x, y])).transpose()
    }

    /// The simulated scan, with the margin that the source needs.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a scan whose margin is larger than the cell.
    pub fn simulated_scan(&self) -> Result<Scan> {
        match self.pattern_scan() {
            Some(scan) => Ok(scan),
            None => Ok(self.source_blur()?.map_or(self.scan, |blur| *blur.scan())),
        }
    }

    /// Memory in bytes that each plan needs on the threads of this process, and advice for too little memory.
    pub fn memory(&self) -> impl Iterator<Item = (u64, &'static str)> + '_ {
        let probes = if self.request.plane_wave { 1 } else { self.scan.len() };
        self.plans.iter().map(move |plan| {
            let cost = Cost::new(plan, &self.scan).for_probes(probes);
            let bytes = cost.memory_bytes(threads()) + self.pattern_bytes(plan);
            (bytes, cost.memory_remedy(threads()))
        })
    }

    /// Refuses plans that need more memory than is free.
    ///
    /// # Errors
    /// [`Error::Memory`] with advice.
    pub fn check_memory(&self) -> Result<()> {
        self.memory().try_for_each(|(bytes, remedy)| check_memory(bytes, remedy))
    }

    /// Reports the work of the run, and its memory and time. Measures the speed of the machine for 0.2 s.
    ///
    /// # Errors
    /// Errors of [`SimulationJob::simulated_scan`].
    pub fn report(&self) -> Result<PlanReport> {
        let plan = &self.plans[0];
        let scan = self.simulated_scan()?;
        let raster = ProbeRaster::new(plan, &scan)?;
        let waves = if self.request.plane_wave { 1 } else { raster.scan().len() };
        let cost = Cost::with_atoms(plan, &scan, &self.specimen.sites).for_probes(waves);
        let frames = self.specimen.frames().len();
        let runs = if self.request.plane_wave { 1 } else { self.plans.len() * frames };
        let mut report = PlanReport::new(plan, &cost, runs);
        if let Some(cost) = self.pattern_cost(plan) {
            report.memory_bytes += self.pattern_bytes(plan);
            report.add_time(pattern_job::seconds(&cost, threads()).map(|s| s * runs as f64));
        }
        report.warnings = self.warnings.iter().map(|warning| warning.message.clone()).collect();
        report.warnings.extend(self.check_memory().err().map(|e| e.to_string()));
        Ok(report)
    }

    /// Simulates the images of the scan: for each defocus, the images of all detectors. Counts electrons if the request gives a dose.
    ///
    /// # Errors
    /// Errors of the engine, and [`Error::Interrupted`].
    pub fn run(&self, progress: &dyn Progress) -> Result<Vec<SimulatedImage>> {
        self.run_from(&[], progress)
    }

    /// Computes the bytes of [`SimulationJob::run`] from parts that other processes have made.
    ///
    /// # Errors
    /// Errors of [`SimulationJob::run`]; [`Error::Invalid`] for parts of other images.
    pub fn run_from(
        &self,
        parts: &[ScanPart],
        progress: &dyn Progress,
    ) -> Result<Vec<SimulatedImage>> {
        self.needs_images()?;
        let (plans, blur) = (self.chosen_plans(progress)?, self.source_blur()?);
        let wide = blur.as_ref().map_or(&self.scan, |blur| blur.scan());
        let series = simulate_series(&plans, &self.specimen.frames(), wide, parts, progress)?;
        let dose = self.counted_dose();
        let mut made = Vec::new();
        for (p, (plan, found)) in plans.iter().zip(&series).enumerate() {
            let blurred = |sharp: ArrayView3<f32>| match &blur {
                None => Ok(sharp.to_owned()),
                Some(blur) => images::blurred(blur, sharp),
            };
            let measured =
                found.data.axis_iter(Axis(1)).map(blurred).collect::<Result<Vec<_>>>()?;
            for shown in shown_images(&plan.settings.detectors) {
                // Both images of a centre of mass show the same electrons.
                let n = made.len() - shown.axis.unwrap_or(0);
                let mut image = self.image(p, &shown, images::shown_image(&shown, &measured));
                match (&dose, shown.axis) {
                    (Some(dose), None) => image.count(n, dose),
                    (Some(dose), Some(_)) => image.count_deflected(n, &shown, &measured, dose),
                    (None, _) => {}
                }
                made.push(image);
            }
        }
        Ok(made)
    }

    /// An image without noise at a defocus, by its number.
    fn image(&self, plan: usize, shown: &ShownImage, data: Array3<f32>) -> SimulatedImage {
        let detector = &shown.detector;
        SimulatedImage {
            name: images::name_of(&detector.name, self.series_defocus(plan)),
            data,
            units: detector.units(),
            defocus_angstrom: self.request.microscope.defocus_angstrom[plan],
            annulus_mrad: Some([detector.inner_mrad, detector.outer_mrad]),
            sector_degrees: detector.sector_degrees,
            counts: None,
            counted_mrad: None,
            noisy: false,
        }
    }

    /// Simulates one process's part of the probes of the scan, which several processes share.
    ///
    /// # Errors
    /// Errors of [`SimulationJob::run`]; [`Error::Invalid`] for PRISM, whose waves contain all probes.
    pub fn run_part(&self, shard: Shard, progress: &dyn Progress) -> Result<ScanPart> {
        self.needs_images()?;
        let scan = self.simulated_scan()?;
        simulate_part(
            &self.chosen_plans(progress)?,
            &self.specimen.frames(),
            &scan,
            shard,
            progress,
        )
    }

    /// The exit waves of a plane wave, and the images of the lens for each defocus.
    ///
    /// # Errors
    /// Errors of the engine; [`Error::Invalid`] for a request for probes.
    pub fn plane_wave(
        &self,
        progress: &dyn Progress,
    ) -> Result<(Vec<SimulatedImage>, PlaneWaveImages)> {
        if !self.request.plane_wave {
            let expected = "set `plane_wave` of the request";
            return Err(Error::invalid(Setting::PlaneWave, "a request for probes", expected));
        }
        let lenses: Vec<_> = self.plans.iter().map(|plan| &plan.settings.optics).collect();
        let found = plane_wave::run(&self.plans[0], &lenses, &self.specimen.sites, progress)?;
        let each = |(p, data): (usize, &ndarray::Array3<f32>)| SimulatedImage {
            name: images::name_of("lens", self.series_defocus(p)),
            data: data.clone(),
            units: images::OF_INCIDENT_WAVE,
            defocus_angstrom: self.request.microscope.defocus_angstrom[p],
            annulus_mrad: None,
            sector_degrees: None,
            counts: None,
            counted_mrad: None,
            noisy: false,
        };
        let mut made: Vec<_> = found.images.iter().enumerate().map(each).collect();
        if let Some(dose) = self.counted_dose() {
            made.iter_mut().enumerate().for_each(|(n, image)| image.count(n, &dose));
        }
        Ok((made, found))
    }

    /// Simulates single probes, each at a place (x, y) in Angstrom. Returns (thickness, detector, 0, place) for each defocus.
    ///
    /// # Errors
    /// [`Error::Invalid`] for places far outside the cell, and for settings that need a raster of probes; [`Error::Memory`] unless `force`.
    pub fn probes(
        &self,
        places_angstrom: &[[f64; 2]],
        force: bool,
        progress: &dyn Progress,
    ) -> Result<Vec<Images>> {
        self.needs_images()?;
        let [x, y, _] = self.specimen.size_angstrom;
        plausibility::check_places(places_angstrom, [x, y])?;
        // Equally many probes that share no waves, for an estimate of memory.
        let apart =
            Scan { step_angstrom: [1e3, 0.0], shape: [1, places_angstrom.len()], ..self.scan };
        let plans = self.plans_of_single_probes()?;
        for plan in plans.iter().filter(|_| !force) {
            let cost = Cost::new(plan, &apart);
            check_memory(cost.memory_bytes(threads()), cost.memory_remedy(threads()))?;
        }
        let found = simulate_places(&plans, &self.specimen.frames(), places_angstrom, progress)?;
        Ok(found.into_iter().zip(plans.iter()).map(|(i, p)| images::shown_of(i, p)).collect())
    }

    /// The diffraction pattern of a probe at a place (x, y) in Angstrom, in FFT order, and the step (x, y) of its pixels in mrad.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a place far outside the cell; errors of the engine.
    pub fn diffraction(
        &self,
        place_angstrom: [f64; 2],
        progress: &dyn Progress,
    ) -> Result<(Array2<f32>, [f64; 2])> {
        self.needs_probes()?;
        let [x, y, _] = self.specimen.size_angstrom;
        plausibility::check_places(&[place_angstrom], [x, y])?;
        let plan = &self.plans[0];
        let pattern = mean_diffraction(plan, &self.specimen.sites, place_angstrom, progress)?;
        let wavelength = plan.settings.optics.wavelength_angstrom();
        Ok((pattern, plan.wave_grid.extent_angstrom.map(|extent| 1e3 * wavelength / extent)))
    }

    /// The exit waves of probes, each at a place (x, y) in Angstrom, in every phonon configuration and at every recorded thickness, as
    /// (configuration, place, thickness, y, x), for each defocus. The squared moduli of a wave add to the fraction of the beam.
    ///
    /// # Errors
    /// [`Error::Invalid`] for places far outside the cell, several frames, an engine other than multislice, a focal spread or a size of the
    /// source; [`Error::Memory`] unless `force`.
    pub fn exit_waves(
        &self,
        places_angstrom: &[[f64; 2]],
        force: bool,
        progress: &dyn Progress,
    ) -> Result<Vec<Array5<Complex32>>> {
        self.check_exit_waves()?;
        let [x, y, _] = self.specimen.size_angstrom;
        plausibility::check_places(places_angstrom, [x, y])?;
        let plans = self.plans_of_single_probes()?;
        let values = |plan: &Plan| {
            let [nx, ny] = plan.wave_grid.points;
            plan.settings.configurations() as usize * plan.record_after.len() * nx * ny
        };
        let all = plans.iter().map(values).sum::<usize>() * places_angstrom.len();
        if !force {
            // One configuration is in memory twice.
            let bytes = 2 * all as u64 * size_of::<Complex32>() as u64;
            check_memory(
                bytes,
                "use fewer probes, configurations or thicknesses, or a smaller cell",
            )?;
        }
        let configurations = plans.iter().map(|plan| plan.settings.configurations()).sum::<u32>();
        let probes = places_angstrom.len() as u64 * u64::from(configurations);
        progress.start("simulating", "exit waves", probes);
        let of_plan = |plan: &Plan| {
            let of = |n| probe_exit_waves(plan, &self.specimen.sites, places_angstrom, n, progress);
            let waves: Vec<_> =
                (0..plan.settings.configurations()).map(of).collect::<Result<_>>()?;
            let views: Vec<_> = waves.iter().map(|w| w.view()).collect();
            ndarray::stack(Axis(0), &views)
                .map_err(|e| Error::invalid(Setting::Pattern, e, "has the shape of the wave grid"))
        };
        let waves = plans.iter().map(of_plan).collect();
        progress.finish();
        waves
    }

    /// Refuses requests without exit waves of probes, as [`SimulationJob::exit_waves`] does, before anything is simulated.
    ///
    /// # Errors
    /// [`Error::Invalid`].
    pub fn check_exit_waves(&self) -> Result<()> {
        self.needs_images()?;
        if let Some(source) = self.request.microscope.source_size_angstrom {
            let expected = "a wave comes from a point source; leave the size of the source out";
            return Err(Error::invalid(Setting::SourceSizeAngstrom, source, expected));
        }
        if !self.specimen.more_frames.is_empty() {
            let expected = "exit waves are of one structure; leave the frames out";
            return Err(Error::invalid(Setting::Frames, self.specimen.frames().len(), expected));
        }
        self.plans_of_single_probes()?.iter().try_for_each(has_exit_waves)
    }

    fn needs_images(&self) -> Result<()> {
        match self.request.patterns {
            None => self.needs_probes(),
            Some(_) => {
                let expected = "is a request for patterns; leave `patterns` out for images";
                Err(Error::invalid(Setting::PatternPixels, "patterns", expected))
            }
        }
    }

    fn needs_probes(&self) -> Result<()> {
        match self.request.plane_wave {
            false => Ok(()),
            true => {
                let expected = "a plane wave has no probes; leave `plane_wave` of the request out";
                Err(Error::invalid(Setting::PlaneWave, "true", expected))
            }
        }
    }

    fn counted_dose(&self) -> Option<CountedDose> {
        let seed = self.request.specimen.seed;
        self.electrons_per_pixel()
            .map(|electrons_per_pixel| CountedDose { seed, electrons_per_pixel })
    }
}

/// Refuses settings that a plane wave cannot have.
fn check_plane_wave(request: &SimulationRequest) -> Result<()> {
    if !request.plane_wave {
        return Ok(());
    }
    if let Some(source) = request.microscope.source_size_angstrom {
        let expected = "is the size of a probe's source; a plane wave has none";
        return Err(Error::invalid(Setting::SourceSizeAngstrom, source, expected));
    }
    if let Some(percent) = request.numerics.accuracy_percent {
        let expected = "chooses a window for probes; a plane wave has none";
        return Err(Error::invalid(Setting::AccuracyPercent, percent, expected));
    }
    if request.scan != super::ScanRequest::default() {
        let expected = "a plane wave has no probe positions; leave the scan out";
        return Err(Error::invalid(Setting::Scan, "given", expected));
    }
    Ok(())
}

fn plan(request: &SimulationRequest, specimen: &PreparedSpecimen, defocus: f64) -> Result<Plan> {
    let thicknesses = request.thicknesses_angstrom.clone();
    let phonons = request.specimen.phonons();
    let numerics = match request.patterns {
        None => request.numerics.clone(),
        Some(_) => pattern_job::numerics(request, specimen.size_angstrom)?,
    };
    let mut settings = numerics.settings(&request.microscope, defocus, phonons, thicknesses)?;
    if let Some(asked) = &request.patterns {
        settings = pattern_job::settings(asked, settings)?;
    }
    if request.plane_wave {
        settings = plane_wave::settings(settings)?;
    }
    Plan::new(&settings, specimen.size_angstrom, &specimen.heights_angstrom)
}

/// The positions of the probes, with warnings about them and the cell.
fn scan(
    request: &SimulationRequest,
    specimen: &PreparedSpecimen,
    plan: &Plan,
) -> Result<(Scan, Vec<Warning>)> {
    let [x, y, _] = specimen.size_angstrom;
    if request.plane_wave {
        let [nx, ny] = plan.wave_grid.points;
        let step_angstrom = plan.wave_grid.sampling_angstrom();
        return Ok((
            Scan { origin_angstrom: [0.0; 2], step_angstrom, shape: [ny, nx] },
            Vec::new(),
        ));
    }
    let scan = request.scan.scan([x, y], &plan.settings.optics)?;
    let mut warnings: Vec<Warning> = plan.narrow_cell().into_iter().map(Warning::from).collect();
    warnings.extend(plausibility::check_scan(&scan, [x, y])?);
    warnings.extend(plausibility::check_cell([x, y], request.specimen.repeat.unwrap_or([1; 3])));
    Ok((scan, warnings))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::Algorithm;
    use crate::progress::Silent;
    use crate::simulation::AtomsSource;
    use crate::structure::{Atom, Structure};

    /// A thin film of one gold atom in a cell of 12 A.
    fn gold() -> SimulationRequest {
        let cell = [[12.0, 0.0, 0.0], [0.0, 12.0, 0.0], [0.0, 0.0, 4.0]];
        let atoms = vec![Atom::new(79, [6.0, 6.0, 2.0])];
        let mut request = SimulationRequest::new(AtomsSource::Given(Structure { cell, atoms }));
        request.scan.points = Some([4, 3]);
        request
    }

    fn setting(request: SimulationRequest) -> Setting {
        match SimulationJob::new(request).unwrap_err() {
            Error::Invalid { setting, .. } => setting,
            other => panic!("{other}"),
        }
    }

    #[test]
    fn images_are_those_of_the_engine() {
        let job = SimulationJob::new(gold()).unwrap();
        let made = job.run(&Silent).unwrap();
        let sites = job.specimen().frames();
        let alone =
            crate::engine::simulate(&job.plans()[0], sites[0], job.scan(), &Silent).unwrap();
        assert_eq!(made[0].data.view(), alone.data.index_axis(Axis(1), 0));
        assert_eq!((made.len(), made[0].name.as_str()), (1, "HAADF"));
        let parts = [0, 1].map(|n| job.run_part(Shard::new(n, 2).unwrap(), &Silent).unwrap());
        assert_eq!(job.run_from(&parts, &Silent).unwrap(), made);
    }

    #[test]
    fn series_have_names_and_counts_of_their_own() {
        let mut request = gold();
        request.microscope.defocus_angstrom = vec![0.0, 40.0];
        request.electrons_per_angstrom2 = Some(1e5);
        let job = SimulationJob::new(request).unwrap();
        let made = job.run(&Silent).unwrap();
        assert_eq!(job.image_names(), ["HAADF_defocus_0A", "HAADF_defocus_40A"]);
        let counts = |n: usize| made[n].counts.clone().unwrap();
        assert_ne!(counts(0), counts(1));
        let per_pixel = job.electrons_per_pixel().unwrap();
        let noisy = made[0].noisy(per_pixel).unwrap();
        assert_eq!(noisy.name, "HAADF_defocus_0A_noisy");
        let mean = |a: &ndarray::Array3<f32>| {
            a.iter().map(|v| f64::from(*v)).sum::<f64>() / a.len() as f64
        };
        let sigma = (mean(&made[0].data) / per_pixel / made[0].data.len() as f64).sqrt();
        assert!((mean(&noisy.data) - mean(&made[0].data)).abs() < 5.0 * sigma);
    }

    #[test]
    fn plane_waves_keep_their_electrons() {
        let request = SimulationRequest { plane_wave: true, scan: Default::default(), ..gold() };
        let job = SimulationJob::new(request.clone()).unwrap();
        let (made, waves) = job.plane_wave(&Silent).unwrap();
        assert_eq!(made[0].name, "lens");
        let wave = &waves.exit_waves;
        let mean = wave.iter().map(|v| f64::from(v.norm_sqr())).sum::<f64>() / wave.len() as f64;
        assert!((mean - 1.0).abs() < 0.01, "{mean}");
        assert!(job.run(&Silent).is_err());
        let with = |change: &dyn Fn(&mut SimulationRequest)| {
            let mut request = request.clone();
            change(&mut request);
            setting(request)
        };
        assert_eq!(with(&|r| r.thicknesses_angstrom = vec![2.0]), Setting::ThicknessAngstrom);
        assert_eq!(with(&|r| r.numerics.interpolation = Some([2, 2])), Setting::Algorithm);
        assert_eq!(with(&|r| r.scan.points = Some([2, 2])), Setting::Scan);
        assert_eq!(
            with(&|r| r.microscope.source_size_angstrom = Some(1.0)),
            Setting::SourceSizeAngstrom
        );
        assert_eq!(with(&|r| r.numerics.accuracy_percent = Some(1.0)), Setting::AccuracyPercent);
        assert!(SimulationJob::new(gold()).unwrap().plane_wave(&Silent).is_err());
    }

    #[test]
    fn doses_beyond_what_can_be_counted_are_refused() {
        for dose in [1e12, 1e15, 0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert_eq!(
                setting(SimulationRequest { electrons_per_angstrom2: Some(dose), ..gold() }),
                Setting::Dose
            );
        }
        let mut names = gold();
        names.electrons_per_angstrom2 = Some(1.0);
        names.microscope.detectors =
            ["A", "A_noisy"].map(|name| crate::detect::Detector::new(name, 60.0, 200.0)).to_vec();
        assert_eq!(setting(names), Setting::DetectorName);
    }

    #[test]
    fn warnings_carry_their_setting() {
        let mut request = gold();
        let AtomsSource::Given(structure) = &mut request.structure else { unreachable!() };
        structure.cell[0][0] = 8.0;
        request.scan.start = Some([-1.0, 0.0]);
        let warnings = SimulationJob::new(request).unwrap().warnings().to_vec();
        let about = |setting| warnings.iter().any(|w| w.setting == Some(setting));
        assert!(about(Setting::Repeat) && about(Setting::Scan), "{warnings:?}");
    }

    #[test]
    fn an_accuracy_chooses_once() {
        let mut request = gold();
        request.numerics.accuracy_percent = Some(5.0);
        let mut job = SimulationJob::new(request).unwrap();
        job.choose_accuracy(&Silent).unwrap();
        let chosen: Vec<Algorithm> =
            job.plans().iter().map(|plan| plan.settings.algorithm).collect();
        assert_eq!(job.accuracies().len(), 1);
        assert_eq!(job.accuracies()[0].algorithm, chosen[0]);
        job.choose_accuracy(&Silent).unwrap();
        assert_eq!(job.accuracies().len(), 1);
    }
}
