//! A prepared question of detectability: the plans, and the run.

use ndarray::Array2;
use serde::Serialize;

use super::asked_defect::AskedDefect;
use super::defect_site::{DefectSite, pristine};
use super::detectability_report::{DetectabilityCase, DetectabilityReport};
use super::detectability_request::DetectabilityRequest;
use super::evaluate_case::{DetectorImages, Evaluation, annuli};
use super::patch_images::ColumnPatch;
use crate::detect::Detector;
use crate::engine::{
    Algorithm, Cost, Plan, ProbeBox, Settings, Simulation, Site, WindowChoice, check_memory,
    elements, window_for,
};
use crate::error::{Error, Result};
use crate::lengths;
use crate::progress::Progress;
use crate::setting::Setting;
use crate::simulation::{PreparedSpecimen, Warning, seconds, threads};

/// Error of the windows in per cent of the mean image, if no engine is named.
const ACCURACY_PERCENT: f64 = 0.8;
/// Specimen beyond the patch, in Angstrom, that an engine without windows gets on each side.
const BEYOND_ANGSTROM: f64 = 7.0;
/// Reach of potentials beyond a window, in Angstrom.
const REACH_ANGSTROM: f64 = 1.5;
/// The column is moved by this to find the error of its place, in Angstrom.
const MOVED_ANGSTROM: f64 = 0.05;
/// Configurations in which it is moved.
const MOVED_CONFIGURATIONS: u32 = 4;
/// Detectors that begin below this many semiangles need the exact engine.
const LEAST_SEMIANGLES: f64 = 2.0;
/// Most rings: each costs time with every probe.
const MOST_SEARCH_RINGS: usize = 64;

/// The work of a question, and its cost.
#[derive(Debug, Clone, Serialize)]
pub struct DetectabilityPlan {
    /// The defects.
    pub defects: Vec<AskedDefect>,
    /// Thicknesses in nm.
    pub thicknesses_nm: Vec<f64>,
    /// Columns of the defects at the first thickness.
    pub columns: Vec<String>,
    /// Number of atoms at each thickness.
    pub atoms: Vec<usize>,
    /// The algorithm.
    pub engine: String,
    /// Pixels of the patch.
    pub pixels: usize,
    /// Distance of probes in Angstrom.
    pub step_angstrom: f64,
    /// Simulations of the patch in one phonon configuration.
    pub simulations: usize,
    /// Memory of the largest arrays in bytes.
    pub memory_bytes: u64,
    /// Shortest and longest time in seconds.
    pub estimated_range_s: [f64; 2],
}

/// A question that is ready to run.
#[derive(Debug)]
pub struct DetectabilityJob {
    request: DetectabilityRequest,
    name: String,
    /// The detectors that were asked for; the rings follow them in the settings of the engine.
    detectors: Vec<Detector>,
    rings: Vec<Detector>,
    stages: Vec<Stage>,
    step_angstrom: f64,
    warnings: Vec<Warning>,
}

/// One thickness.
#[derive(Debug)]
struct Stage {
    atoms: PreparedSpecimen,
    plan: Plan,
    sites: Vec<DefectSite>,
}

impl Stage {
    fn thickness_nm(&self) -> f64 {
        lengths::nm(self.atoms.size_angstrom[2])
    }
}

impl DetectabilityJob {
    /// Checks the request, reads the atoms, finds the columns, and plans. Nothing is simulated. `name` names the material in the report.
    ///
    /// # Errors
    /// [`Error::Invalid`] with the wrong [`Setting`]; errors of the structure file.
    pub fn new(request: DetectabilityRequest, name: &str) -> Result<Self> {
        request.check()?;
        let first = settings(&request, &[])?;
        let rings = rings(&request, &first)?;
        let detectors = request.microscope.detectors.clone();
        let mut thicknesses: Vec<Option<f64>> =
            request.thicknesses_nm.iter().copied().map(Some).collect();
        if thicknesses.is_empty() {
            thicknesses.push(None);
        }
        let step_angstrom = step(&request, &first);
        let (mut stages, mut warnings) = (Vec::new(), request.microscope.warnings());
        for thickness in thicknesses {
            let stage = stage(&request, (&first, &rings), thickness)?;
            let notes = stage.atoms.notes.iter().chain(&stage.plan.warnings);
            for warning in notes.cloned().map(Warning::from) {
                if !warnings.contains(&warning) {
                    warnings.push(warning);
                }
            }
            stages.push(stage);
        }
        let name = name.to_owned();
        Ok(DetectabilityJob { request, name, detectors, rings, stages, step_angstrom, warnings })
    }

    /// Warnings that a user should read before the run.
    pub fn warnings(&self) -> &[Warning] {
        &self.warnings
    }

    /// The work and its cost. Measures the speed of the machine for 0.2 s.
    ///
    /// # Errors
    /// Errors of the source.
    pub fn plan(&self) -> Result<DetectabilityPlan> {
        let (mut range, mut simulations, mut memory, mut pixels) = ([0.0; 2], 0, 0, 0);
        for stage in &self.stages {
            let patch = self.patch(stage, &stage.sites[0])?;
            pixels = patch.len();
            let cost = Cost::with_atoms(&stage.plan, patch.raster(), &stage.atoms.sites)
                .for_probes(patch.probes().len());
            memory = memory.max(cost.memory_bytes(threads()));
            let count = self.simulations(stage);
            simulations += count;
            let all = seconds(&stage.plan, &cost, 1);
            let one = count as f64 / f64::from(self.request.configurations);
            (0..2).for_each(|k| range[k] += all[k] * one);
        }
        let first = &self.stages[0];
        Ok(DetectabilityPlan {
            defects: self.request.defects.clone(),
            thicknesses_nm: self.stages.iter().map(Stage::thickness_nm).collect(),
            columns: first.sites.iter().map(|site| site.composition.clone()).collect(),
            atoms: self.stages.iter().map(|s| s.atoms.sites.len()).collect(),
            engine: first.plan.settings.algorithm.to_string(),
            pixels,
            step_angstrom: self.step_angstrom,
            simulations,
            memory_bytes: memory,
            estimated_range_s: range,
        })
    }

    /// Refuses a run that needs more memory than is free.
    ///
    /// # Errors
    /// [`Error::Memory`] with advice.
    pub fn check_memory(&self) -> Result<()> {
        for stage in &self.stages {
            let patch = self.patch(stage, &stage.sites[0])?;
            let cost = Cost::new(&stage.plan, patch.raster());
            check_memory(cost.memory_bytes(threads()), cost.memory_remedy(threads()))?;
        }
        Ok(())
    }

    /// Simulates the patches, and tests the hypotheses.
    ///
    /// # Errors
    /// Errors of the engine, and [`Error::Interrupted`].
    pub fn run(&self, progress: &dyn Progress) -> Result<DetectabilityReport> {
        let mut total = 0;
        for stage in &self.stages {
            let patch = self.patch(stage, &stage.sites[0])?;
            total += self.simulations(stage) * patch.probes().len();
        }
        progress.start("simulating", "probes", total as u64);
        let mut cases = Vec::new();
        for stage in &self.stages {
            cases.extend(self.stage_cases(stage, progress)?);
        }
        progress.finish();
        let request = &self.request;
        Ok(DetectabilityReport {
            name: self.name.clone(),
            configurations: request.configurations,
            averaged: request.averaged,
            power: request.power,
            false_alarms: request.false_alarms,
            rate: request.rate,
            recipe_dose: request.recipe_dose,
            energy_kev: request.microscope.energy_kev,
            semiangle_mrad: request.microscope.semiangle_mrad,
            radius_angstrom: request.radius_angstrom,
            step_angstrom: self.step_angstrom,
            engine: self.stages[0].plan.settings.algorithm.to_string(),
            cases,
        })
    }

    fn patch(&self, stage: &Stage, site: &DefectSite) -> Result<ColumnPatch> {
        let [x, y, _] = stage.atoms.size_angstrom;
        let patch = ColumnPatch::new(site.centre, self.request.radius_angstrom, self.step_angstrom);
        patch.blurred(self.request.microscope.source(), [x, y])
    }

    /// Number of simulations of the patch in one configuration.
    fn simulations(&self, stage: &Stage) -> usize {
        let moved = self.request.configurations.min(MOVED_CONFIGURATIONS) as usize;
        let each = self.request.configurations as usize;
        let mut known: Vec<[f64; 2]> = Vec::new();
        let mut count = 0;
        for site in &stage.sites {
            count += each * site.variants.len();
            if !known.contains(&site.centre) {
                known.push(site.centre);
                count += each + 2 * moved;
            }
        }
        count
    }

    /// The cases of one thickness. Defects of one column share the images without a defect.
    fn stage_cases(
        &self,
        stage: &Stage,
        progress: &dyn Progress,
    ) -> Result<Vec<DetectabilityCase>> {
        let request = &self.request;
        let mut held: Vec<u8> = elements(&stage.atoms.sites);
        let guests = request.defects.iter().filter_map(|defect| match defect.form {
            super::asked_defect::DefectForm::Substitution(_, by) => Some(by),
            _ => None,
        });
        held.extend(guests);
        held.sort_unstable();
        held.dedup();
        let mut simulation = Simulation::new(&stage.plan, &held)?;
        let mut known: Vec<([f64; 2], Pristine)> = Vec::new();
        let mut cases = Vec::new();
        for (defect, site) in request.defects.iter().zip(&stage.sites) {
            let patch = self.patch(stage, site)?;
            let engine = (&mut simulation, &stage.plan);
            let place = match known.iter().position(|(centre, _)| *centre == site.centre) {
                Some(place) => place,
                None => {
                    let made = self.pristine(engine, stage, (site, &patch), progress)?;
                    known.push((site.centre, made));
                    known.len() - 1
                }
            };
            let mut with = Vec::new();
            for variant in 0..site.variants.len() {
                let sites = site.with_defect(request, defect, &stage.atoms.sites, variant)?;
                let engine = (&mut simulation, &stage.plan);
                with.push(patch.images(engine, &sites, request.configurations, progress)?);
            }
            let area = patch.area_angstrom2();
            cases.push(self.case((stage, site), defect, &known[place].1, with, area));
        }
        Ok(cases)
    }

    /// The images without a defect.
    fn pristine(
        &self,
        (simulation, plan): (&mut Simulation<'_>, &Plan),
        stage: &Stage,
        (site, patch): (&DefectSite, &ColumnPatch),
        progress: &dyn Progress,
    ) -> Result<Pristine> {
        let sites: &[Site] = &stage.atoms.sites;
        let configurations = self.request.configurations;
        let few = configurations.min(MOVED_CONFIGURATIONS);
        let mut moved = |by: [f64; 2]| {
            let sites = site.with_column_moved(sites, by);
            patch.images((&mut *simulation, plan), &sites, few, progress)
        };
        let moved = [moved([MOVED_ANGSTROM, 0.0])?, moved([0.0, MOVED_ANGSTROM])?];
        let images = patch.images((simulation, plan), sites, configurations, progress)?;
        Ok(Pristine { images, moved })
    }

    /// The case of a defect from the images with it: for each of its forms, the images of each detector.
    fn case(
        &self,
        (stage, site): (&Stage, &DefectSite),
        defect: &AskedDefect,
        pristine: &Pristine,
        with: Vec<Vec<Array2<f64>>>,
        area: f64,
    ) -> DetectabilityCase {
        let one = |(n, detector): (usize, &Detector)| {
            let images = DetectorImages {
                without: pristine.images[n].clone(),
                with: with.iter().map(|images| images[n].clone()).collect(),
                moved: pristine.moved.each_ref().map(|moved| moved[n].clone()),
                moved_angstrom: MOVED_ANGSTROM,
            };
            Evaluation::new(&self.request, &images, area).result(detector)
        };
        let detectors = self.detectors.iter().enumerate().map(one).collect();
        let own = self.detectors.len();
        let ring = |n: usize| [pristine.images[n].clone(), with[0][n].clone()];
        let ring_images: Vec<_> = (own..own + self.rings.len()).map(ring).collect();
        let found = match with.len() {
            1 => annuli(&self.request, &self.rings, &ring_images, area),
            _ => None,
        };
        let [best_annulus, all_rings] = match found {
            Some(both) => both.map(Some),
            None => [None, None],
        };
        let heights = site.variants.iter().flatten();
        DetectabilityCase {
            defect: *defect,
            thickness_nm: stage.thickness_nm(),
            column: site.composition.clone(),
            site_angstrom: site.centre,
            depths_nm: heights.map(|i| lengths::nm(stage.atoms.sites[*i].position[2])).collect(),
            detectors,
            best_annulus,
            all_rings,
        }
    }
}

/// The images of a column without a defect, for each detector.
struct Pristine {
    images: Vec<Array2<f64>>,
    /// With the column moved along x, and along y.
    moved: [Vec<Array2<f64>>; 2],
}

/// Settings of the engine with these rings after the detectors. The width of windows is still the width for a thin specimen.
fn settings(request: &DetectabilityRequest, rings: &[Detector]) -> Result<Settings> {
    let numerics = &request.numerics;
    if let Some(percent) = numerics.accuracy_percent {
        let expected =
            "the accuracy is for images of scans; name an engine or a window, or leave both out";
        return Err(Error::invalid(Setting::AccuracyPercent, percent, expected));
    }
    let mut specimen = request.specimen.clone();
    specimen.phonons = Some(request.configurations);
    let defocus = request.microscope.defocus_angstrom[0];
    let mut settings =
        numerics.settings(&request.microscope, defocus, specimen.phonons(), Vec::new())?;
    settings.detectors.extend(rings.iter().cloned());
    if numerics.leaves_engine_open() {
        let semiangle = request.microscope.semiangle_mrad;
        let low = |d: &Detector| d.inner_mrad < LEAST_SEMIANGLES * semiangle;
        match request.microscope.detectors.iter().any(low) {
            true => settings.probe_box = Some(ProbeBox::Large),
            false => settings.algorithm = Algorithm::Window { width_angstrom: 0.0 },
        }
    }
    Ok(settings)
}

/// The rings of which annuli are made: within the angles of the detectors, and with windows from two semiangles on.
fn rings(request: &DetectabilityRequest, settings: &Settings) -> Result<Vec<Detector>> {
    let width = request.ring_mrad;
    if width == 0.0 {
        return Ok(Vec::new());
    }
    let outer = request.microscope.detectors.iter().map(|d| d.outer_mrad).fold(0.0, f64::max);
    let inner = match settings.algorithm {
        Algorithm::Window { .. } => LEAST_SEMIANGLES * request.microscope.semiangle_mrad,
        _ => 0.0,
    };
    let (first, end) = ((inner / width - 1e-9).ceil() as usize, (outer / width + 1e-9) as usize);
    if end.saturating_sub(first) > MOST_SEARCH_RINGS {
        let expected = format!(
            "makes more than {MOST_SEARCH_RINGS} rings up to {outer} mrad; use wider rings"
        );
        return Err(Error::invalid(Setting::RingWidthMrad, width, expected));
    }
    let ring = |n: usize| {
        let [from, to] = [n, n + 1].map(|k| k as f64 * width);
        Detector::new(&format!("ring {n}"), from, to)
    };
    Ok((first..end).map(ring).collect())
}

/// The distance of probes in Angstrom.
fn step(request: &DetectabilityRequest, settings: &Settings) -> f64 {
    let optics = &settings.optics;
    let nyquist = optics.wavelength_angstrom() / (4e-3 * optics.semiangle_mrad);
    // Probes that share a window share its waves, so a finer raster costs little.
    let usual = match settings.algorithm {
        Algorithm::Window { .. } => 0.5 * nyquist,
        _ => nyquist,
    };
    request.step_angstrom.unwrap_or(usual)
}

fn stage(
    request: &DetectabilityRequest,
    (first, rings): (&Settings, &[Detector]),
    thickness_nm: Option<f64>,
) -> Result<Stage> {
    let mut settings = settings(request, rings)?;
    let open = request.numerics.leaves_engine_open();
    let mut width = 2.0 * (request.radius_angstrom + BEYOND_ANGSTROM);
    if let Algorithm::Window { width_angstrom } = first.algorithm {
        let thickness = match thickness_nm {
            Some(nm) => lengths::angstrom(nm),
            None => pristine(request, None, 0.0)?.size_angstrom[2],
        };
        let own = Settings { detectors: request.microscope.detectors.clone(), ..settings.clone() };
        let choice: Option<WindowChoice> =
            open.then(|| window_for(ACCURACY_PERCENT, &own, thickness)).transpose()?;
        let window = choice.map_or(width_angstrom, |choice| choice.width_angstrom);
        settings.algorithm = Algorithm::Window { width_angstrom: window };
        width = window + 2.0 * (request.radius_angstrom + REACH_ANGSTROM);
    }
    let atoms = pristine(request, thickness_nm, width)?;
    let plan = Plan::new(&settings, atoms.size_angstrom, &atoms.heights_angstrom)?;
    let find = |defect| DefectSite::find(request, defect, &atoms);
    let sites = request.defects.iter().map(find).collect::<Result<Vec<_>>>()?;
    Ok(Stage { plan, sites, atoms })
}
