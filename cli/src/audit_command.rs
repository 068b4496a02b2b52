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
  Three regions of a world, at random places:
    stemgen audit worlds/srtio3_hard.h5
  One region at a place of interest, 5 nm from the left and 2.5 nm from the upper edge:
    stemgen audit worlds/srtio3_hard.h5 --at 5,2.5
  In a script: print a message if an error exceeds 1 %:
    stemgen audit worlds/srtio3_hard.h5 --max-error 1 --quiet || echo far off
  The error to expect of a world that is not built yet:
    stemgen audit srtio3 --difficulty easy --configurations 1

Each region is simulated again by multislice on the full grid, with the displaced atoms of the world
in each phonon configuration. The errors do not include noise. Bright columns have more than 40 % of
the intensity of the brightest column.

Exit code: 0 if the errors are at most --max-error, 3 if not, 1 on errors.";

/// Measure the error of a world: compare random regions with multislice of the same atoms
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct AuditCommand {
    #[command(flatten)]
    recipe: RecipeArgs,
    /// Number of regions at random places. If the world has particles, every other region lies on one
    #[arg(long, value_name = "N", default_value_t = 3, help_heading = "Audit")]
    #[arg(value_parser = clap::value_parser!(u16).range(1..=1000))]
    regions: u16,
    /// Centre of a region in nm from the upper left corner, in place of random regions (repeatable)
    #[arg(long, value_name = "X,Y", value_parser = values::point, help_heading = "Audit")]
    at: Vec<[f64; 2]>,
    /// Edge of a region in nm
    #[arg(long, value_name = "NM", default_value_t = 1.0, value_parser = values::finite)]
    #[arg(help_heading = "Audit")]
    size: f64,
    /// Compare every N-th pixel along each axis [default: one pixel about every 0.5 A]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=100))]
    #[arg(help_heading = "Audit")]
    stride: Option<u16>,
    /// Number of phonon configurations to average [default: all of the world]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    #[arg(help_heading = "Audit")]
    configurations: Option<u16>,
    /// Largest error, in per cent: rms at bright columns, and rms over all pixels relative to the brightest column. If one of them
    /// is larger, the audit warns, also with --quiet, and the exit code is 3
    #[arg(long, value_name = "PERCENT", default_value = "5", value_parser = values::percent)]
    #[arg(allow_negative_numbers = true, help_heading = "Audit")]
    max_error: f64,
    /// Seed of the random places
    #[arg(long, value_name = "N", default_value_t = 1, help_heading = "Audit")]
    audit_seed: u64,
    /// Width in A of the window, the small box around each probe in which the probe is propagated. Only for a recipe, not for a
    /// world file [default: the width that `build` chooses]
    #[arg(long, value_name = "A", value_parser = values::finite, allow_negative_numbers = true)]
    #[arg(help_heading = "Audit")]
    window: Option<f64>,
    #[command(flatten)]
    kept: CacheArgs,
    #[command(flatten)]
    force: Force,
    #[command(flatten)]
    common: Common,
}

impl AuditCommand {
    /// Runs the subcommand; the exit code is not 0 if an error is above the limit.
    pub fn run(self) -> anyhow::Result<u8> {
        let reporter = self.common.start()?;
        let (recipe, made) = self.recipe.resolve_or_world()?;
        if self.common.dry_run {
            bail!(
                "--dry-run: an audit has no plan; leave it out, and give --configurations 1 --regions 1 for a quick audit"
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

/// Returns the errors of all detectors, one after the other.
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

/// Describes a ratio, such as `0.25 % too bright`.
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
