//! `stemgen audit`.

use super::audit_verdict;
use super::common::{CacheArgs, Common, Force};
use super::plan_text::Lines;
use super::recipe_args::RecipeArgs;
use super::values;
use anyhow::bail;
use clap::Args;
use stemgen::imaging::{Audit, AuditOptions};
use stemgen::simulation;
use stemgen::world::AuditJob;

const EXAMPLES: &str = "\
Examples:
  Three regions of a world, drawn at random:
    stemgen audit worlds/srtio3_hard.h5
  A region at a place of interest, such as a boundary, 5 nm from the left and 2.5 nm from the upper edge:
    stemgen audit worlds/srtio3_hard.h5 --at 5,2.5
  Whether the errors are below 1 %, for a script:
    stemgen audit worlds/srtio3_hard.h5 --max-error 1 --quiet || echo far off
  What the error of a world would be, before it is built:
    stemgen audit srtio3 --difficulty easy --configurations 1

Each region is simulated again by plain multislice on the full grid, with the very same atoms in each phonon
configuration. Errors are those of the method: noise is left out.

Exit code: 0 if the errors are at most --max-error, 3 if not, 1 on errors.";

/// Check a world against the exact engine, with the same atoms
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct AuditCommand {
    #[command(flatten)]
    recipe: RecipeArgs,
    /// Number of regions, drawn at random; every other one on a particle where there are any
    #[arg(long, value_name = "N", default_value_t = 3)]
    #[arg(value_parser = clap::value_parser!(u16).range(1..=1000))]
    regions: u16,
    /// Centre of a region in nm from the upper left corner, in place of random ones (repeatable)
    #[arg(long, value_name = "X,Y", value_parser = values::point)]
    at: Vec<[f64; 2]>,
    /// Edge of a region in nm
    #[arg(long, value_name = "NM", default_value_t = 1.0, value_parser = values::finite)]
    size: f64,
    /// Compare every how many-th pixel along each axis [default: one about every 0.5 A]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=100))]
    stride: Option<u16>,
    /// Phonon configurations to average [default: as many as the world]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    configurations: Option<u16>,
    /// Largest error in per cent, at bright columns and over all pixels of the brightest column: above it the audit warns,
    /// also with --quiet, and the exit code is 3
    #[arg(long, value_name = "PERCENT", default_value = "5", value_parser = values::percent)]
    #[arg(allow_negative_numbers = true)]
    max_error: f64,
    /// Seed of the places
    #[arg(long, value_name = "N", default_value_t = 1)]
    audit_seed: u64,
    /// Width of the window that follows each probe, in A, of a recipe that has no world yet [default: as `build` chooses]
    #[arg(long, value_name = "A", value_parser = values::finite, allow_negative_numbers = true)]
    window: Option<f64>,
    #[command(flatten)]
    kept: CacheArgs,
    #[command(flatten)]
    force: Force,
    #[command(flatten)]
    common: Common,
}

impl AuditCommand {
    /// Runs the subcommand; the exit code tells whether the errors are small enough.
    pub fn run(self) -> anyhow::Result<u8> {
        let reporter = self.common.start()?;
        let (recipe, made) = self.recipe.resolve_or_world()?;
        if self.common.dry_run {
            bail!(
                "--dry-run: an audit has no plan to show; --configurations 1 --regions 1 is a quick one"
            );
        }
        let options = AuditOptions {
            regions: self.regions.into(),
            size_nm: self.size,
            stride: self.stride.map(usize::from),
            seed: self.audit_seed,
            at_nm: self.at.clone(),
            configurations: self.configurations.map(usize::from),
        };
        let job = AuditJob::new(recipe, made.as_ref(), options, self.kept.cache(), self.window)?;
        let (bytes, remedy) = job.memory(simulation::threads())?;
        self.force.check_memory(bytes, remedy, &reporter)?;
        let found = job.run(&reporter)?;
        self.common.print(&found, &text(&found))?;
        Ok(audit_verdict::exit_code("the audit", &found, Some(self.max_error)))
    }
}

/// All detectors, one after the other.
fn text(audit: &Audit) -> String {
    audit.all().map(text_of_detector).collect::<Vec<_>>().join("\n")
}

fn text_of_detector(audit: &Audit) -> String {
    let mut lines = Lines::default();
    if let Some(name) = &audit.detector {
        lines.add("detector", name.clone());
    }
    let [n, all] = audit.configurations;
    let windows = audit.window_angstrom.map(|w| format!(" (windows of {w:.1} A)"));
    lines.add(
        "compared",
        format!(
            "{}{} with {}, mean of {n} of {all} configurations",
            audit.engine,
            windows.unwrap_or_default(),
            audit.reference
        ),
    );
    lines
        .add("bright columns", format!("{:.2} % rms of their intensity", audit.bright_rms_percent));
    let all = format!(
        "{:.2} % rms, worst {:.2} %, of the brightest column",
        audit.all_rms_percent, audit.worst_percent
    );
    lines.add("all pixels", all);
    for region in &audit.regions {
        let [x, y] = region.centre_nm;
        lines.add(
            "region",
            format!(
                "at {x:.2}, {y:.2} nm: {} bright columns {:.2} % (mean {:+.2} %), off them {:.2} %, all {:.2} %, worst {:.2} %, mean of all {:+.2} %",
                region.bright_columns,
                region.bright_rms_percent,
                region.bright_mean_percent,
                region.off_columns_rms_percent,
                region.all_rms_percent,
                region.worst_percent,
                region.mean_percent
            ),
        );
    }
    for kind in &audit.kinds {
        let [ours, exact] = kind.neighbours;
        lines.add(
            format!("{} columns", kind.kind),
            format!(
                "{}: on average {}; their spread is {}; brighter and darker ones agree by {:.4} (1 is best); neighbours \
                 are alike by {ours:.2}, in the exact image by {exact:.2}",
                kind.columns,
                off(kind.mean_ratio, 2, "too bright", "too dark"),
                off(kind.variance_ratio.sqrt(), 1, "too large", "too small"),
                kind.correlation
            ),
        );
    }
    for band in &audit.power {
        let [low, high] = band.band;
        lines.add(
            "detail",
            format!(
                "{:.2} to {:.2} A fine: contrast {}",
                1.0 / high,
                1.0 / low,
                off(band.ratio.sqrt(), 2, "too strong", "too weak")
            ),
        );
    }
    lines.text()
}

/// `0.25 % too bright`.
fn off(ratio: f64, digits: usize, above: &str, below: &str) -> String {
    if !ratio.is_finite() {
        return "not known".into();
    }
    let percent = 100.0 * (ratio - 1.0);
    let direction = if percent >= 0.0 { above } else { below };
    format!("{:.digits$} % {direction}", percent.abs())
}

#[cfg(test)]
mod tests {
    use super::off;

    #[test]
    fn ratios_are_put_into_words() {
        assert_eq!(off(1.0025, 2, "too bright", "too dark"), "0.25 % too bright");
        assert_eq!(off(0.99, 1, "too large", "too small"), "1.0 % too small");
        assert_eq!(off(f64::NAN, 1, "a", "b"), "not known");
    }
}
