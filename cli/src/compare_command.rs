//! `stemgen compare`.

use super::common::Common;
use super::validate_command::DIFFERENT;
use super::{hdf5_check, text, values};
use clap::Args;
use serde::Serialize;
use std::path::PathBuf;
use stemgen::files::outputs::check_outputs;
use stemgen::io::WorldFile;
use stemgen::validate::report::{ReportOrigin, sentence, value, worlds_page};
use stemgen::validate::worlds::{DEFAULT_ALPHA, Sameness, WorldComparison, compare};

const EXAMPLES: &str = "\
Examples:
  Compare a world that you built again, with another seed, with a released one (compare.html):
    stemgen compare worlds/srtio3_easy_2x2.h5 released.h5
  In a script: print JSON, and the exit code:
    stemgen compare a.h5 b.h5 --json --quiet -o a_b.html; echo $?

The report has one line for each property. A test decides each line: t for a difference of rates,
the two-sample Kolmogorov-Smirnov distance for distributions, the largest difference for power
spectra. Fields with equal pixels are compared block by block, other fields by all their blocks. A
line is `different` if chance explains its difference so rarely that, for all lines together, two
worlds of one kind are called different at the rate --alpha.

Exit code: 0 if no line differs, 3 if one does, 1 on errors.";

/// Decide by statistics whether two worlds show one kind of specimen
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Compare {
    /// First world file
    #[arg(value_name = "A.h5")]
    a: PathBuf,
    /// Second world file
    #[arg(value_name = "B.h5")]
    b: PathBuf,
    /// Rate at which two worlds of one kind may be called different, for all lines together
    #[arg(long, value_name = "P", default_value_t = DEFAULT_ALPHA, value_parser = values::finite)]
    #[arg(allow_negative_numbers = true)]
    alpha: f64,
    /// Report to write (HTML)
    #[arg(short, long, value_name = "FILE.html", default_value = "compare.html")]
    #[arg(help_heading = "Results")]
    output: PathBuf,
    /// Replace an existing report
    #[arg(long, help_heading = "Results")]
    overwrite: bool,
    #[command(flatten)]
    common: Common,
}

/// The summary that `--json` prints.
#[derive(Serialize)]
struct CompareSummary<'a> {
    summary: String,
    #[serde(flatten)]
    origin: &'a ReportOrigin,
    #[serde(flatten)]
    comparison: &'a WorldComparison,
    output: &'a PathBuf,
}

impl Compare {
    /// Runs the subcommand; the exit code is [`DIFFERENT`] if a line differs.
    pub fn run(self) -> anyhow::Result<u8> {
        let reporter = self.common.start()?;
        hdf5_check::check(&self.a)?;
        hdf5_check::check(&self.b)?;
        let worlds = [WorldFile::open(&self.a)?, WorldFile::open(&self.b)?];
        if self.common.dry_run {
            let sites = worlds.iter().map(WorldFile::site_count).collect::<Result<Vec<_>, _>>()?;
            let pixels = worlds.each_ref().map(WorldFile::shape);
            let text = format!(
                "{} x {} and {} x {} pixels, {} and {} sites (nothing was compared)",
                pixels[0][0], pixels[0][1], pixels[1][0], pixels[1][1], sites[0], sites[1]
            );
            self.common.print(&serde_json::json!({ "pixels": pixels, "sites": sites }), &text)?;
            return Ok(0);
        }
        check_outputs([&self.output], [&self.a, &self.b], self.overwrite)?;
        let comparison = compare(&self.a, &self.b, self.alpha, &reporter)?;
        let origin = ReportOrigin::now(text::command_line());
        let page = worlds_page(&comparison, [&worlds[0], &worlds[1]], &origin)?;
        stemgen::files::atomic_write::write(&self.output, page.as_bytes())?;
        let summary = CompareSummary {
            summary: sentence(&comparison),
            origin: &origin,
            comparison: &comparison,
            output: &self.output,
        };
        self.common.print(&summary, &self.lines(&comparison))?;
        Ok(match comparison.verdict {
            Sameness::Different => DIFFERENT,
            _ => 0,
        })
    }

    fn lines(&self, comparison: &WorldComparison) -> String {
        let mut out = String::new();
        for line in &comparison.lines {
            let word = match line.verdict {
                Sameness::Same => "same",
                Sameness::Different => "DIFFERENT",
                Sameness::Undecided => "undecided",
            };
            let values = match (line.a, line.b) {
                (None, None) => line.text.clone(),
                (a, b) => format!("{} | {} {}", value(a), value(b), line.unit),
            };
            let p = text::significant(line.p, 2);
            out += &format!("{word:<9}  {}: {} (p {p})\n", line.what, values.trim_end());
        }
        format!("{out}{}\nreport: {}", sentence(comparison), self.output.display())
    }
}
