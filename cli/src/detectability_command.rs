//! `stemgen detectability`.

use super::common::{Common, Force};
use super::imaging_args::{MicroscopeArgs, NumericsArgs};
use super::plan_text::Lines;
use super::recipe_args::RecipeArgs;
use super::values::{self, DoseRange, NumberSeries};
use super::{hints, text};
use anyhow::bail;
use clap::Args;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Instant;
use stemgen::detectability::{
    AskedDefect, DetectabilityCase, DetectabilityJob, DetectabilityPlan, DetectabilityReport,
    DetectabilityRequest, power_svg,
};
use stemgen::files::atomic_write;
use stemgen::files::outputs::check_outputs;
use stemgen::progress::Progress;
use stemgen::simulation::{AtomsSource, SigmaChoice};

const EXAMPLES: &str = "\
Examples:
  The defect of a recipe at three thicknesses, with the recipe's microscope:
    stemgen detectability srtio3 --difficulty easy --thickness 2,5,10
  A missing oxygen atom of a Ti-O column at the exit surface, and a dopant at an unknown depth:
    stemgen detectability srtio3 --difficulty easy --column Ti-O --defect vacancy:O@bottom
    stemgen detectability srtio3 --difficulty easy --defect substitution:Ti:Nb@any
  Several detectors at once, your own structure, and files with all numbers:
    stemgen detectability si.cif --zone 1,1,0 --sigma 0.078 --thickness 10 \\
      --defect substitution:Si:P --detector HAADF=68-200 --detector MAADF=45-68 \\
      -o p.json -o p.csv -o p.svg
  A world, whose images average 4 phonon configurations:
    stemgen detectability srtio3 --difficulty easy --averaged 4 --phonons 64

A defect is vacancy:O, substitution:Ti:Nb (niobium in place of titanium) or column:O (a column
without atoms), with a depth: @top (entrance surface), @middle, @bottom, @any (unknown), or a
fraction of the thickness, @0.25. Without a depth it is the middle.

The table lists for each detector the dose at which the best test finds 90 % of the defects with
1 % false alarms. `best annulus` is the annulus of whole rings that needs the lowest dose.";

/// Find the dose at which a defect of a column is seen, by the best possible test
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Detectability {
    #[command(flatten)]
    recipe: RecipeArgs,
    #[command(flatten)]
    specimen: DefectArgs,
    #[command(flatten)]
    test: TestArgs,
    #[command(flatten)]
    microscope: MicroscopeArgs,
    #[command(flatten)]
    numerics: NumericsArgs,
    /// File to write, by its ending: all numbers (.json), a table (.csv), curves of the power over the dose (.svg) (repeatable)
    #[arg(short, long, value_name = "FILE", help_heading = "Results")]
    output: Vec<PathBuf>,
    /// Replace existing files
    #[arg(long, help_heading = "Results")]
    overwrite: bool,
    #[command(flatten)]
    common: Common,
    #[command(flatten)]
    force: Force,
}

/// Holds the options of the defect and of its column.
#[derive(Debug, Args)]
#[command(next_help_heading = "Defect")]
struct DefectArgs {
    /// Defect to look for: vacancy:O, substitution:Ti:Nb or column:O, with @top, @middle, @bottom, @any or @0.25 (repeatable)
    /// [default: the vacancy or substitution of the recipe]
    #[arg(long, value_name = "KIND:ELEMENT[@DEPTH]", value_parser = values::defect)]
    defect: Vec<AskedDefect>,
    /// Thicknesses in nm, moved to whole cells: numbers, or START:END:STEP [default: of the recipe; of the atoms in the file]
    #[arg(long, value_name = "NM,NM,...", value_delimiter = ',', value_parser = values::series)]
    thickness: Vec<NumberSeries>,
    /// Elements of the column that holds the defect, such as Ti-O [default: the fewest other elements]
    #[arg(long, value_name = "ELEMENTS")]
    column: Option<String>,
    /// Place in A in the box; the nearest column that holds the element is taken [default: near the centre of the box]
    #[arg(long, value_name = "X,Y", value_parser = values::point, allow_hyphen_values = true)]
    site: Option<[f64; 2]>,
    /// For a file of atoms: lattice direction along the beam
    #[arg(long, value_name = "U,V,W", value_parser = values::direction, allow_hyphen_values = true)]
    zone: Option<[i32; 3]>,
    /// For a file of atoms: lattice direction along +y, perpendicular to --zone
    #[arg(long, value_name = "U,V,W", value_parser = values::direction, allow_hyphen_values = true)]
    up: Option<[i32; 3]>,
    /// For a file of atoms: repeat the cell along x, y and the beam [default: a box that is wide enough, and --thickness]
    #[arg(long, value_name = "NX,NY,NZ", value_parser = values::counts3)]
    repeat: Option<[usize; 3]>,
    /// Standard deviation of the thermal displacement along each axis, in A: one number, one for each element
    /// (Sr=0.084,O=0.085), `from-file` or `table` [default: of the recipe]. A dopant without a value takes the value of the
    /// atom that it replaces
    #[arg(long, value_name = "A", value_parser = values::sigma_choice)]
    sigma: Option<SigmaChoice>,
    /// Temperature for --sigma table, 200 to 400 K [default: 293]
    #[arg(long, value_name = "K", value_parser = values::finite, requires = "sigma")]
    temperature: Option<f64>,
}

/// Holds the options of the test.
#[derive(Debug, Args)]
#[command(next_help_heading = "Test")]
struct TestArgs {
    /// Doses in electrons per square Angstrom at which the test is listed: numbers, or LOW:HIGH for one in each decade
    /// [default: 1e2:1e6, and the dose of the recipe]
    #[arg(long, value_name = "E/A^2,...", value_delimiter = ',', value_parser = values::doses)]
    dose: Vec<DoseRange>,
    /// Share of the defects that has to be found, from 0 to 1 [default: 0.9]
    #[arg(long, value_name = "SHARE", value_parser = values::finite)]
    power: Option<f64>,
    /// Share of columns without the defect that the test reports, from 0 to 1 [default: 0.01]
    #[arg(long, value_name = "SHARE", value_parser = values::finite)]
    false_alarms: Option<f64>,
    /// Share of columns with the defect, from 0 to 1, for the average precision [default: the recipe's rate; 0.05]
    #[arg(long, value_name = "SHARE", value_parser = values::finite)]
    rate: Option<f64>,
    /// Number of simulated phonon configurations, 4 to 4096. More of them give a more exact dose [default: 16]
    #[arg(long, value_name = "N")]
    phonons: Option<u32>,
    /// Images average N phonon configurations, as in worlds, so that their scatter hides defects [default: an experiment, in
    /// which every electron meets a configuration of its own]
    #[arg(long, value_name = "N")]
    averaged: Option<u32>,
    /// Radius of the patch around the column that the test reads, in A, 0.2 to 10 [default: 1.2]
    #[arg(long, value_name = "A", value_parser = values::finite)]
    radius: Option<f64>,
    /// Distance of probes in the patch in A [default: half the Nyquist limit with windows; the Nyquist limit otherwise]
    #[arg(long, value_name = "A", value_parser = values::positive)]
    step: Option<f64>,
    /// Width in mrad of the rings of which the best annulus is made; 0 for no search [default: 10]
    #[arg(long, value_name = "MRAD", value_parser = values::finite)]
    rings: Option<f64>,
    /// Number of simulated experiments that judge a test without a closed form (unknown depth, --averaged) [default: 4000]
    #[arg(long, value_name = "N")]
    experiments: Option<usize>,
}

#[derive(Serialize)]
struct DetectabilityFound {
    #[serde(flatten)]
    report: DetectabilityReport,
    sentences: Vec<String>,
    output: Vec<PathBuf>,
    wall_time_s: f64,
}

impl Detectability {
    /// Runs the subcommand.
    pub fn run(self) -> anyhow::Result<()> {
        let begun = Instant::now();
        let reporter = self.common.start()?;
        let (request, name, inputs) = self.request()?;
        self.output.iter().try_for_each(|path| ending(path).map(drop))?;
        if !self.common.dry_run {
            check_outputs(&self.output, &inputs, self.overwrite)?;
        }
        let job = DetectabilityJob::new(request, &name)?;
        job.warnings().iter().for_each(|w| reporter.warn(&hints::with_option(w)));
        let plan = job.plan()?;
        if self.common.dry_run {
            return self.common.print(&plan, &plan_text(&plan));
        }
        let remedy = "use fewer --phonons, a smaller --radius, or a narrower --window";
        self.force.check_memory(plan.memory_bytes, remedy, &reporter)?;
        let report = job.run(&reporter)?;
        for path in &self.output {
            let bytes = match ending(path)? {
                ResultForm::Json => serde_json::to_string_pretty(&report)? + "\n",
                ResultForm::Csv => report.to_csv(),
                ResultForm::Svg => power_svg(&report),
            };
            atomic_write::write(path, bytes.as_bytes())?;
        }
        let text = report_text(&report, &self.output);
        let found = DetectabilityFound {
            sentences: report.sentences(),
            report,
            output: self.output,
            wall_time_s: begun.elapsed().as_secs_f64(),
        };
        self.common.print(&found, &text)
    }

    /// Returns the request, the name of the material, and the files that are read.
    fn request(&self) -> anyhow::Result<(DetectabilityRequest, String, Vec<PathBuf>)> {
        let (mut request, name, inputs) = match self.recipe.atoms_file() {
            Some(path) => {
                if self.recipe.changes_recipe() {
                    bail!(
                        "{}: is a file of atoms; --difficulty, --set, --unset and --grid change recipes",
                        path.display()
                    );
                }
                let source = AtomsSource::File(path.clone());
                let name = path.file_stem().unwrap_or_default().display().to_string();
                (DetectabilityRequest::new(source, Vec::new()), name, vec![path])
            }
            None => {
                let own = &self.specimen;
                if own.zone.is_some() || own.up.is_some() || own.repeat.is_some() {
                    bail!(
                        "a recipe has its own direction and size; --zone, --up and --repeat are for files of atoms"
                    );
                }
                let recipe = self.recipe.resolve()?;
                let request = DetectabilityRequest::of_recipe(&recipe)?;
                (request, recipe.id.clone(), self.recipe.files(&recipe))
            }
        };
        self.specimen.apply(&mut request);
        self.test.apply(&mut request);
        request.specimen.seed = self.recipe.seed().unwrap_or(request.specimen.seed);
        self.microscope.apply(&mut request.microscope);
        self.numerics.apply(&mut request.numerics)?;
        Ok((request, name, inputs))
    }
}

impl DefectArgs {
    fn apply(&self, to: &mut DetectabilityRequest) {
        if !self.defect.is_empty() {
            to.defects.clone_from(&self.defect);
        }
        if !self.thickness.is_empty() {
            to.thicknesses_nm = self.thickness.iter().flat_map(|t| t.0.iter().copied()).collect();
        }
        to.column = self.column.clone().or(to.column.take());
        to.site_angstrom = self.site.or(to.site_angstrom);
        let specimen = &mut to.specimen;
        specimen.zone = self.zone.or(specimen.zone);
        specimen.up = self.up.or(specimen.up);
        specimen.repeat = self.repeat.or(specimen.repeat);
        specimen.sigma_angstrom = self.sigma.clone().or(specimen.sigma_angstrom.take());
        specimen.temperature_k = self.temperature.or(specimen.temperature_k);
    }
}

impl TestArgs {
    fn apply(&self, to: &mut DetectabilityRequest) {
        if !self.dose.is_empty() {
            to.doses = self.dose.iter().flat_map(|range| range.0.iter().copied()).collect();
        }
        to.power = self.power.unwrap_or(to.power);
        to.false_alarms = self.false_alarms.unwrap_or(to.false_alarms);
        to.rate = self.rate.unwrap_or(to.rate);
        to.configurations = self.phonons.unwrap_or(to.configurations);
        to.averaged = self.averaged.or(to.averaged);
        to.radius_angstrom = self.radius.unwrap_or(to.radius_angstrom);
        to.step_angstrom = self.step.or(to.step_angstrom);
        to.ring_mrad = self.rings.unwrap_or(to.ring_mrad);
        to.experiments = self.experiments.unwrap_or(to.experiments);
    }
}

/// The form of a file of results.
enum ResultForm {
    Json,
    Csv,
    Svg,
}

/// Returns the form that the ending of a name asks for.
fn ending(path: &Path) -> anyhow::Result<ResultForm> {
    let ending = path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    match ending.as_str() {
        "json" => Ok(ResultForm::Json),
        "csv" => Ok(ResultForm::Csv),
        "svg" => Ok(ResultForm::Svg),
        _ => bail!(
            "--output {}: the name ends in .json (all numbers), .csv (a table) or .svg (curves)",
            path.display()
        ),
    }
}

fn plan_text(plan: &DetectabilityPlan) -> String {
    let mut lines = Lines::default();
    for (defect, column) in plan.defects.iter().zip(&plan.columns) {
        lines.add("defect", format!("{defect}, in the column {column} at the first thickness"));
    }
    let thick: Vec<String> = plan.thicknesses_nm.iter().map(|nm| format!("{nm:.2}")).collect();
    lines.add("thickness", format!("{} nm", thick.join(", ")));
    let atoms: Vec<String> = plan.atoms.iter().map(|n| text::count(*n as u64)).collect();
    lines.add("atoms", atoms.join(", "));
    lines.add("engine", plan.engine.clone());
    lines.add("patch", format!("{} probes, {:.3} A apart", plan.pixels, plan.step_angstrom));
    lines.add("simulations", format!("{} of the patch, in one configuration", plan.simulations));
    lines.add("memory", format!("about {}", text::bytes(plan.memory_bytes)));
    let time = text::duration_range(plan.estimated_range_s);
    lines.add("time", format!("{time} (from a short measurement)"));
    lines.text()
}

/// Returns the table and the sentences.
fn report_text(report: &DetectabilityReport, files: &[PathBuf]) -> String {
    let words =
        ["defect", "thickness", "column", "detector", "change", "needed dose (e/A^2)", "place"];
    let mut rows = vec![words.map(str::to_owned)];
    for case in &report.cases {
        rows.extend(case_rows(report, case));
    }
    let mut out = text::table(&rows);
    out += "\n\nThe dose is for ";
    out += &format!(
        "{} % power at {} % false alarms, with one standard error. ",
        percent(report.power),
        percent(report.false_alarms)
    );
    out += "`place` is the least error of the column's place at that dose.\n\n";
    out += &report.sentences().join("\n");
    for file in files {
        out += &format!("\nfile  {}", file.display());
    }
    out
}

/// Returns a share in per cent, without needless digits.
fn percent(share: f64) -> f64 {
    (share * 1e6).round() / 1e4
}

fn case_rows(report: &DetectabilityReport, case: &DetectabilityCase) -> Vec<[String; 7]> {
    let annulus = |[inner, outer]: [f64; 2]| format!("{inner}-{outer} mrad");
    let mut rows = Vec::new();
    for found in &case.detectors {
        let needed = found.needed();
        let place = needed.electrons_per_angstrom2.map(|dose| found.place_error_pm(dose));
        rows.push([
            case.defect.to_string(),
            format!("{:.2} nm", case.thickness_nm),
            case.column.clone(),
            format!("{} {}", found.detector, annulus(found.annulus_mrad)),
            format!("{:+.2} %", found.contrast_percent),
            needed.words(),
            place.map(|pm| format!("{pm:.2} pm")).unwrap_or_default(),
        ]);
    }
    let others = [("best annulus", &case.best_annulus), ("all rings", &case.all_rings)];
    for (name, other) in others {
        let Some(other) = other.as_ref().filter(|_| report.averaged.is_none()) else { continue };
        let mut row = [const { String::new() }; 7];
        row[3] = format!("{name} {}", annulus(other.annulus_mrad));
        row[5] = other.needed.words();
        rows.push(row);
    }
    rows
}
