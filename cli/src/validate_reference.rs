//! Comparison with an image of another program.

use super::hdf5_check;
use super::hints::hinted;
use super::imaging_args::{self, MicroscopeArgs, NumericsArgs};
use super::plan_text::{self, Lines};
use super::progress_bar::Reporter;
use super::reference_scan::{asked_pixels, reference_scan};
use super::scan_args::ScanArgs;
use super::structure_args::{SpecimenArgs, file_name, with_frames};
use super::values;
use anyhow::{anyhow, bail};
use clap::{Args, ValueEnum};
use std::path::PathBuf;
use stemgen::engine::{Cost, GridChoice, Plan, Scan, Settings, settings_for_accuracy};
use stemgen::io::arrays::{self, ForeignArray};
use stemgen::potential::Slicing;
use stemgen::progress::Progress as _;
use stemgen::simulation::{
    AtomsSource, NumericsRequest, PlanReport, PreparedSpecimen, SpecimenRequest,
};
use stemgen::validate::golden::like_abtem;
use stemgen::validate::image_comparison::{ImageComparison, compare};
use stemgen::validate::user::{self, Order, Reference, ValueUnits};
use stemgen::validate::{NamedSetting, Outcome};

/// Default slice thickness of abTEM, in Angstrom.
const ABTEM_SLICE_ANGSTROM: f64 = 1.0;
const REMEDY: &str = "our image is converged in the grid, but abTEM's images contain the error of abTEM's grid; --like-abtem with the --gpts and \
                      --slice-thickness of the reference computes with abTEM's numerics, and shows whether they explain the difference";

/// Holds the options of a comparison with an image of another program.
#[derive(Debug, Args)]
pub struct ReferenceArgs {
    /// Compare with this image, in place of the suite: .npy, .npz, .tif, .h5 or a zarr folder
    #[arg(long, value_name = "FILE", requires = "structure", help_heading = "Your reference")]
    reference: Option<PathBuf>,
    /// Atoms that the reference shows: CIF, extended XYZ or POSCAR
    #[arg(long, value_name = "FILE", requires = "reference", help_heading = "Your reference")]
    structure: Option<PathBuf>,
    /// Array to compare with, if the file holds several
    #[arg(long, value_name = "NAME", requires = "reference", help_heading = "Your reference")]
    dataset: Option<String>,
    /// Image of a stack, from 0: one number for each dimension other than x and y
    #[arg(long, value_name = "I,J,...", value_delimiter = ',', requires = "reference")]
    #[arg(help_heading = "Your reference")]
    index: Vec<usize>,
    /// Order of the dimensions, if the file does not state it. Arrays of abTEM are xy
    #[arg(long, value_name = "ORDER", requires = "reference", help_heading = "Your reference")]
    axes: Option<AxesName>,
    /// Units of the values
    #[arg(long, value_name = "NAME", default_value = "fraction", help_heading = "Your reference")]
    units: UnitsName,
    /// Largest difference allowed, in per cent of the maximum of the reference, up to 100
    #[arg(long, value_name = "PERCENT", default_value = "1", value_parser = values::percent)]
    #[arg(allow_negative_numbers = true, help_heading = "Your reference")]
    tolerance: f64,
    /// Compute with abTEM's numerics: potentials on the grid of the wave with its pixel correction, slices of --slice-thickness
    /// (1 A if it is not given), its anti-aliasing and focus. Needs --gpts or --sampling
    #[arg(long, requires = "reference", help_heading = "Your reference")]
    like_abtem: bool,
    #[command(flatten)]
    specimen: Option<SpecimenArgs>,
    #[command(flatten)]
    microscope: Option<MicroscopeArgs>,
    #[command(flatten)]
    scan: Option<ScanArgs>,
    #[command(flatten)]
    numerics: Option<NumericsArgs>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum AxesName {
    /// First index along x
    Xy,
    /// First index along y
    Yx,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum UnitsName {
    /// Fractions of the beam
    Fraction,
    /// Per cent of the beam
    Percent,
    /// Any units proportional to fractions; the program fits the factor
    Fitted,
}

/// A comparison that is ready to run.
pub struct PreparedReference {
    name: String,
    structure: String,
    reference: Reference,
    specimen: PreparedSpecimen,
    plan: Plan,
    /// The plan of a converged image, as in [`ImageComparison::converged`].
    converged: Option<Plan>,
    scan: Scan,
    units: ValueUnits,
    tolerance: f64,
    source: String,
    remedy: Option<String>,
}

/// Returns options of which none is given.
fn defaults<T: Args>() -> anyhow::Result<T> {
    let command = T::augment_args(clap::Command::new("defaults").no_binary_name(true));
    let matches = command.try_get_matches_from(std::iter::empty::<String>())?;
    Ok(T::from_arg_matches(&matches)?)
}

impl ReferenceArgs {
    /// Whether a reference was given.
    pub fn given(&self) -> bool {
        self.reference.is_some()
    }

    /// Returns the files that are read.
    pub fn files(&self) -> Vec<PathBuf> {
        [&self.reference, &self.structure].into_iter().flatten().cloned().collect()
    }

    /// Reads and plans; `None` without a reference.
    pub fn prepare(self, reporter: &Reporter) -> anyhow::Result<Option<PreparedReference>> {
        let (Some(path), Some(structure)) = (&self.reference, &self.structure) else {
            return self.refuse_options().map(|()| None);
        };
        if !(self.tolerance > 0.0 && self.tolerance <= 100.0) {
            bail!("--tolerance {}: write per cent above 0 and up to 100", self.tolerance);
        }
        if arrays::is_hdf5(path) {
            hdf5_check::check(path)?;
        }
        let array = arrays::read(path, self.dataset.as_deref())?;
        let options = |given: Option<SpecimenArgs>| given.map_or_else(defaults, Ok);
        let specimen_args = options(self.specimen)?;
        let microscope: MicroscopeArgs = self.microscope.map_or_else(defaults, Ok)?;
        let numerics_args: NumericsArgs = self.numerics.map_or_else(defaults, Ok)?;
        let mut specimen = SpecimenRequest::default();
        specimen_args.apply(&mut specimen);
        let phonons = specimen.phonons();
        let atoms = AtomsSource::File(structure.clone());
        let specimen = specimen.prepare(&atoms).map_err(with_frames)?;
        specimen.notes.iter().for_each(|w| reporter.warn(w));
        let mut numerics = NumericsRequest::default();
        numerics_args.apply(&mut numerics)?;
        let mut settings = imaging_args::settings(&microscope, &numerics, phonons)?;
        if settings.detectors.len() > 1 {
            let fault = anyhow!("{} detectors for one reference", settings.detectors.len());
            return Err(hinted(fault, "give only the --detector of the reference"));
        }
        agree(&array, &settings)?;
        let converged = self.like_abtem.then(|| converged_settings(&settings));
        if self.like_abtem {
            settings = abtem_settings(&settings, &numerics, specimen.size_angstrom)?;
        }
        let scan_args = self.scan.as_ref();
        let pixels = scan_args.map(|args| asked_pixels(args, &settings.optics)).transpose()?;
        let order = self.axes.map(|a| if a == AxesName::Xy { Order::Xy } else { Order::Yx });
        let mut reference = user::reference(&array, order, &self.index, pixels.flatten())?;
        let units = match self.units {
            UnitsName::Fraction => ValueUnits::Fraction,
            UnitsName::Percent => ValueUnits::Percent,
            UnitsName::Fitted => ValueUnits::Fitted,
        };
        user::in_fractions(&array, &mut reference.data, units)?;
        let scan = reference_scan(scan_args, &settings.optics, &array, &reference)?;
        let mut found = None;
        if let Some(asked) = numerics.accuracy_percent {
            let (size, frames) = (specimen.size_angstrom, specimen.frames());
            let chosen = settings_for_accuracy(asked, &settings, size, &frames, &scan, reporter)?;
            settings = chosen.0;
            found = Some(chosen.1);
        }
        let plan = Plan::new(&settings, specimen.size_angstrom, &specimen.heights_angstrom)?;
        plan.warnings.iter().for_each(|w| reporter.warn(w));
        let planned =
            |s: Settings| Plan::new(&s, specimen.size_angstrom, &specimen.heights_angstrom);
        let converged = converged.map(planned).transpose()?;
        let accuracy = found.map_or_else(String::new, |a| format!("; ours: {}", a.text()));
        Ok(Some(PreparedReference {
            name: file_name(path),
            structure: file_name(structure),
            source: format!("{} (x and y: {}){accuracy}", path.display(), reference.orientation),
            reference,
            specimen,
            plan,
            converged,
            scan,
            units,
            tolerance: self.tolerance / 100.0,
            remedy: (!self.like_abtem).then(|| REMEDY.to_owned()),
        }))
    }

    /// Refuses options of a simulation without a reference: each case of the suite has fixed settings.
    fn refuse_options(&self) -> anyhow::Result<()> {
        let given = [
            (self.specimen.is_some(), "options of the specimen"),
            (self.microscope.is_some(), "options of the microscope"),
            (self.scan.is_some(), "options of the scan"),
            (self.numerics.is_some(), "options of the numerics"),
        ];
        match given.iter().find(|(given, _)| *given) {
            None => Ok(()),
            Some((_, which)) => {
                let hint = "the suite has fixed settings; leave the options out, or give --reference FILE --structure FILE";
                Err(hinted(anyhow!("{which} without a reference"), hint))
            }
        }
    }
}

/// Refuses settings that the file contradicts.
fn agree(array: &ForeignArray, settings: &Settings) -> anyhow::Result<()> {
    let optics = &settings.optics;
    let stated = [
        (array.energy_kev, optics.energy_kev, "keV", "--energy"),
        (array.semiangle_mrad, optics.semiangle_mrad, "mrad", "--semiangle"),
    ];
    for (stated, ours, unit, option) in stated {
        if let Some(stated) = stated.filter(|t| (t / ours - 1.0).abs() > 1e-6) {
            let fault = anyhow!(
                "{} was computed with {stated} {unit}, not with {ours} {unit}",
                array.path.display()
            );
            return Err(hinted(fault, format!("{option} {stated}")));
        }
    }
    Ok(())
}

/// Replaces the given grid and slices by the program's default ones.
fn converged_settings(settings: &Settings) -> Settings {
    Settings { grid: GridChoice::Auto, slicing: Slicing::Planes, ..settings.clone() }
}

fn abtem_settings(
    settings: &Settings,
    numerics: &NumericsRequest,
    size: [f64; 3],
) -> anyhow::Result<Settings> {
    let points = match (numerics.gpts, numerics.sampling_angstrom) {
        (Some(points), _) => points,
        (None, Some(sampling)) => [0, 1].map(|i| (size[i] / sampling - 1e-9).ceil() as usize),
        (None, None) => {
            let fault = anyhow!("--like-abtem needs the grid of the abTEM calculation");
            return Err(hinted(fault, "give its --gpts or its --sampling"));
        }
    };
    let thickness = numerics.slice_thickness_angstrom.unwrap_or(ABTEM_SLICE_ANGSTROM);
    // abTEM divides the cell into slices of equal thickness, and its focus moves by half a slice.
    let slice = size[2] / (size[2] / thickness - 1e-9).ceil().max(1.0);
    Ok(like_abtem(settings, GridChoice::Points(points), slice))
}

impl PreparedReference {
    /// Returns the plan, also as text.
    pub fn planned(&self) -> (PlanReport, String) {
        let report = self.report();
        let mut lines = Lines::default();
        lines.add("reference", self.source.clone());
        lines.add("atoms", self.specimen.sites.len().to_string());
        plan_text::all(&report, &mut lines);
        lines.add("probes", plan_text::scan(&self.scan));
        plan_text::costs(&report, &mut lines);
        (report, lines.text())
    }

    fn report(&self) -> PlanReport {
        PlanReport::new(&self.plan, &Cost::new(&self.plan, &self.scan), 1)
    }

    /// Returns the settings of our image, for the report.
    fn settings(&self) -> Vec<NamedSetting> {
        let settings = &self.plan.settings;
        let [x, y, z] = self.specimen.size_angstrom;
        let mut lines = Lines::default();
        lines.add("atoms", format!("{} in {x:.3} x {y:.3} x {z:.3} A", self.specimen.sites.len()));
        lines.add("beam", plan_text::beam(&settings.optics));
        let d = &settings.detectors[0];
        lines.add("detector", format!("{}, {} to {} mrad", d.name, d.inner_mrad, d.outer_mrad));
        lines.add("probes", plan_text::scan(&self.scan));
        plan_text::numerics(&self.report(), &mut lines);
        if self.converged.is_some() {
            lines.add("numerics", "abTEM's: potentials on the grid of the wave, even slices");
        }
        let named = |(name, value)| NamedSetting { name, value };
        lines.into_rows().into_iter().map(named).collect()
    }

    /// Simulates and compares.
    pub fn run(self, reporter: &Reporter) -> anyhow::Result<Outcome> {
        let detector = &self.plan.settings.detectors[0];
        let about = format!(
            "{}, {:.0} to {:.0} mrad, of {}, computed by stemgen and compared with the image in {}.",
            detector.name, detector.inner_mrad, detector.outer_mrad, self.structure, self.name,
        );
        let settings = self.settings();
        let comparison = ImageComparison {
            plan: &self.plan,
            sites: &self.specimen.sites,
            box_angstrom: self.specimen.size_angstrom,
            heights_angstrom: &self.specimen.heights_angstrom,
            scan: &self.scan,
            reference: &self.reference,
            units: self.units,
            converged: self.converged.as_ref(),
            tolerance: self.tolerance,
            name: self.name,
            about,
            settings,
            source: self.source,
            remedy: self.remedy,
        };
        Ok(compare(reporter, &comparison)?)
    }
}
