//! Errors on standard error, with a hint if one helps.

use super::{signals, text};
use stemgen::simulation::Warning;
use stemgen::{Error, Setting};

/// Exit code of a failure.
const FAILURE: u8 = 1;

/// An error, with advice.
#[derive(Debug)]
pub struct Hinted {
    /// The error.
    pub source: anyhow::Error,
    /// The advice.
    pub hint: String,
}

impl std::fmt::Display for Hinted {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.source.fmt(f)
    }
}

impl std::error::Error for Hinted {}

/// Adds a hint to an error.
pub fn hinted(source: impl Into<anyhow::Error>, hint: impl Into<String>) -> anyhow::Error {
    anyhow::Error::new(Hinted { source: source.into(), hint: hint.into() })
}

/// Prints the error and its hint; returns the exit code.
pub fn report(error: &anyhow::Error, subcommand: &str) -> u8 {
    let (error, own) = match error.downcast_ref::<Hinted>() {
        Some(h) => (&h.source, Some(h.hint.clone())),
        None => (error, None),
    };
    let known = error.chain().find_map(|e| e.downcast_ref::<Error>());
    let hint = own.or_else(|| known.and_then(of));
    // Errors that name an option or the line of a file contain the advice already.
    let message = whole_text(error);
    let advises = matches!(known, Some(Error::Parse { .. })) || message.contains("--");
    let fallback =
        || (!advises).then(|| format!("`stemgen {subcommand} --help` explains every option"));
    let option = match error.downcast_ref::<Error>() {
        Some(Error::Set { assignment, message })
            if !assignment.contains('=') && !message.contains("key=value") =>
        {
            "--unset "
        }
        Some(Error::Set { .. }) => "--set ",
        _ => "",
    };
    text::complain(&format!("error: {option}{message}"));
    if let Some(hint) = hint.or_else(fallback) {
        text::complain(&format!("hint: {hint}"));
    }
    match known {
        Some(Error::Interrupted) => signals::exit_code(),
        _ => FAILURE,
    }
}

/// Returns the text of an error and of its causes. A cause that the error's text contains is not repeated.
fn whole_text(error: &anyhow::Error) -> String {
    let mut whole_text = error.to_string();
    for cause in error.chain().skip(1).map(|cause| cause.to_string()) {
        if !whole_text.contains(&cause) {
            whole_text = format!("{whole_text}: {cause}");
        }
    }
    whole_text
}

/// Returns the hint for an error of the library.
pub fn of(error: &Error) -> Option<String> {
    match error {
        Error::Io { source, action, .. } => io_hint(source, action).map(str::to_owned),
        Error::Set { .. } => {
            Some("`stemgen show-recipe` with this MATERIAL prints all keys and values".into())
        }
        Error::DiskSpace { .. } | Error::Locked { .. } => {
            Some("--output names another place".into())
        }
        Error::Memory { .. } => Some(
            "--window (or --engine window of `stemgen build`), fewer --threads and, for audits, --size or --audit 0 need less; --force continues anyway".into(),
        ),
        Error::UnknownElement(_) => Some("elements H to Lr can be simulated".into()),
        Error::Invalid { setting, .. } | Error::Choice { setting, .. } => {
            Some(format!("see {}", options(*setting)?))
        }
        Error::DetectorBeyondBandLimit { needed_angstrom, .. } => Some(format!(
            "--sampling {:.4} (or no --sampling) carries it; --allow-empty-angles continues \
             with this part of the detector empty",
            floored(*needed_angstrom)
        )),
        Error::Hdf5 { .. } => Some("is the disk full, or the file open elsewhere?".into()),
        Error::Interrupted => Some("nothing was written; run the same command again".into()),
        _ => None,
    }
}

/// Rounds a sampling down to four digits, so that the printed value is fine enough.
fn floored(sampling: f64) -> f64 {
    (sampling * 1e4).floor() * 1e-4
}

fn io_hint(source: &std::io::Error, action: &str) -> Option<&'static str> {
    use std::io::ErrorKind::{NotADirectory, NotFound, PermissionDenied, StorageFull};
    match source.kind() {
        NotFound if action == "read" => Some("check the name and the current folder"),
        NotFound | NotADirectory => Some("check the name of the folder; --output names another"),
        PermissionDenied if action == "read" => Some("you may not read this file"),
        PermissionDenied => Some("you may not write there; --output names another place"),
        StorageFull => Some("free some space, or name another place with --output"),
        _ => None,
    }
}

/// Returns the text of a warning, with the option that changes its setting.
pub fn with_option(warning: &Warning) -> String {
    match warning.setting.and_then(options) {
        Some(option) => format!("{}; see {option}", warning.message),
        None => warning.message.clone(),
    }
}

/// Returns the options that change a setting of the library, if there are any. The match is exhaustive, so that the compiler finds a
/// setting without an entry.
pub fn options(setting: Setting) -> Option<&'static str> {
    use Setting as S;
    match setting {
        S::EnergyKev => Some("--energy"),
        S::SemiangleMrad => Some("--semiangle, or --sampling for a finer grid"),
        S::Aberration => Some("--aberration"),
        S::Defocus => Some("--defocus"),
        S::Frames => Some("--frames"),
        S::Scan => Some("--scan-start, --scan-end, --scan-step and --scan-points"),
        S::PlaneWave => Some("--plane-wave"),
        S::OutputName => Some("--output"),
        S::MistiltMrad => Some("--tilt"),
        S::FocalSpreadAngstrom => Some("--focal-spread"),
        S::SourceSizeAngstrom => Some("--source-size"),
        S::SourceLorentzShare => Some("--source-lorentz"),
        S::Detector | S::DetectorName | S::Detectors => Some("--detector"),
        S::PatternPixels => Some("--pixels, of `stemgen patterns`"),
        S::RingWidthMrad => {
            Some("--radial and --max-angle, and --rings of `stemgen detectability`")
        }
        S::DetectorMtf => Some("--mtf"),
        S::MaxAngleMrad => Some("--max-angle, and --sampling for a finer grid"),
        S::Zone => Some("--zone and --up, and --max-strain PERCENT"),
        S::MaxStrain => Some("--max-strain"),
        S::Cell => Some(
            "--zone u,v,w and --up, which build a right-angled box; --zone 0,0,1 looks along the cell's c axis; --max-strain PERCENT strains \
             nearly right angles to 90 degrees",
        ),
        S::Up => Some("--up"),
        S::Repeat | S::SupercellAtoms => Some("--repeat"),
        S::Temperature => Some("--sigma table --temperature 250"),
        S::Displacements => Some("--sigma, which gives one length for each element"),
        S::ThermalSigma => Some("--sigma, such as --sigma Sr=0.084,O=0.085"),
        S::Algorithm => Some("--engine"),
        S::Gpts => Some("--gpts"),
        S::SamplingAngstrom => Some("--sampling"),
        S::SliceThicknessAngstrom | S::SliceSpanAngstrom => Some("--slice-thickness"),
        S::ThicknessAngstrom => Some("--thicknesses, and --repeat for a thicker specimen"),
        S::AngleMargin => Some("--angle-margin"),
        S::BandFraction => Some("--band-fraction"),
        S::BandTaper => Some("--band-taper"),
        S::ExpansionPercent => Some("--expansion"),
        S::Oversampling => Some("--oversampling"),
        S::PhononConfigurations => Some("--phonons"),
        S::ProbeBox => Some("--probe-box"),
        S::Interpolation => Some("--interpolation"),
        S::WindowAngstrom => Some("--window"),
        S::AccuracyPercent => Some("--accuracy, --window and --engine"),
        S::Material => Some("MATERIAL, and --recipe for a recipe of your own"),
        S::Difficulty => Some("--difficulty"),
        S::Grid => Some("--grid"),
        S::Alloy
        | S::AlloyRate
        | S::AlloyEndMember
        | S::BoundaryCount
        | S::BoundarySigma
        | S::Domains
        | S::DomainCrystal
        | S::Particles
        | S::ParticleCount
        | S::ParticleDiameterNm
        | S::VacancyRate => Some("--set, which changes a value of the recipe"),
        S::BuildProfile => Some("--profile"),
        S::Dose => Some("--dose, and --set dose.electrons_per_angstrom2=... of worlds"),
        S::Shard => Some("--shard"),
        S::Manifest => Some("--manifest"),
        S::SubtileNm => Some("--subtile and --subtile-overlap"),
        S::LargestErrorPercent => {
            Some("--max-error, --engine multislice, --engine prism --interpolation 1, and --audit")
        }
        S::AuditedRegionNm => Some("--size"),
        S::AuditCentreNm => Some("--at"),
        S::BeamCurrentPa => Some("--current-pa"),
        S::Acquisition => Some("--set acquisition.KEY=VALUE, or --profile"),
        S::RecordedRegionNm => Some("--region or --at"),
        S::RecordedPixelNm => Some("--zoom, --pixel-nm, or --set field.KEY=VALUE"),
        S::VacuumAngstrom => Some("--vacuum"),
        S::Output => Some("--output and --overwrite"),
        S::CleanImage => Some("--keep-clean of `stemgen build`"),
        S::DataSet => Some("--dataset NAME, which chooses one"),
        S::ImageAxes => Some("--axes xy or --axes yx; leave it out if the file states the order"),
        S::ImageIndex => Some("--index"),
        S::ImageUnits => Some("--units percent and --units fitted"),
        S::ReplayPixelNm => Some("--pixel-size NM, and --calibrate NM, which measures it"),
        S::ReplaySpacingNm => Some("--calibrate NM, and --pixel-size NM for the first guess"),
        S::ReplayImage => Some("--dataset NAME and --index N, which choose another"),
        S::WorldFile => Some(
            "`stemgen build`, which writes worlds; `stemgen simulate` draws its images with --png and --html",
        ),
        S::Region => Some("--region"),
        S::Overlay => Some("--overlay, --region and --size"),
        S::LongestSidePixels => Some("--size"),
        S::Colormap => Some("--colormap"),
        S::ContrastPercentiles => Some("--contrast"),
        S::Case => Some("--case; --list prints the cases"),
        S::Alpha => Some("--alpha"),
        S::MostDose => Some("--most-dose"),
        S::Recordings => Some("--dose-series"),
        S::Defect => Some("--defect, such as --defect vacancy:O@middle"),
        S::DefectSite => Some("--site X,Y and --column"),
        S::DefectThicknessNm => Some("--thickness"),
        S::FalseAlarms => Some("--false-alarms"),
        S::Power => Some("--power"),
        S::DefectRate => Some("--rate"),
        S::PatchRadiusAngstrom => Some("--radius"),
        S::AveragedConfigurations => Some("--averaged"),
        S::Experiments => Some("--experiments"),
        S::Card => {
            Some("--title, --license, --creator, --organization, --url, --date and --data-version")
        }
        S::StructureFile
        | S::Crystal
        | S::Occupancy
        | S::SiteOccupancy
        | S::ClusterDiameterNm
        | S::CellAngstrom
        | S::CellHeightAngstrom
        | S::Pattern
        | S::SampleStepAngstrom
        | S::Recipe
        | S::CrystalSites
        | S::ColumnSites
        | S::EngineMarginAngstrom
        | S::EngineImageShape
        | S::Intensity
        | S::TilePixels
        | S::Library
        | S::SitesInFile
        | S::SiteRange
        | S::ContrastRange
        | S::PixelAngstrom
        | S::Images
        | S::ImageShape
        | S::ImageValue
        | S::MarkerPosition
        | S::Page
        | S::Figure
        | S::Reference
        | S::Snapshot
        | S::ScatteringFactor
        | S::Score
        | S::Episode
        | S::Findings
        | S::PixelSizeNm => None,
    }
}
