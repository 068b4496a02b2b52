//! `stemgen validate`.

use super::common::Common;
use super::progress_bar::Reporter;
use super::text;
use super::validate_reference::ReferenceArgs;
use clap::Args;
use serde::Serialize;
use std::path::{Path, PathBuf};
use stemgen::files::outputs::check_outputs;
use stemgen::progress::Progress;
use stemgen::validate::report::{Report, ReportOrigin, suite_page};
use stemgen::validate::suite::{Case, selected};
use stemgen::validate::{Outcome, Verdict};

/// Exit code if a comparison found a difference.
pub const DIFFERENT: u8 = 3;

const EXAMPLES: &str = "\
Examples:
  Run the whole suite, in some minutes; writes validation.html:
    stemgen validate
  Run a part of the suite, or list its cases:
    stemgen validate --quick
    stemgen validate --case refined-image --case kirkland-5-12 -o two.html
    stemgen validate --list
  Compare with an image of atoms.xyz from abTEM, saved by measurement.to_zarr(\"haadf.zarr\"):
    stemgen validate --reference haadf.zarr --structure atoms.xyz --detector HAADF=68-200
  Compare with np.save(\"haadf.npy\", measurement.array), which stores neither axes nor pixels, and
  compute with abTEM's numerics (its grid, slices and potentials):
    stemgen validate --reference haadf.npy --axes xy --structure atoms.xyz \\
      --scan-start 0,0 --scan-end 3.905,3.905 --like-abtem \\
      --gpts 300,300 --slice-thickness 1.9525

The scan comes from the reference file, or from options: --scan-start and --scan-end have no
defaults here. An .npy or .npz file states no scan: give --scan-start with --scan-end or
--scan-step. abTEM 1.0.11 writes 0,0 as the start of every scan; if yours starts elsewhere, give
--scan-start.

Exit code: 0 if all numbers lie within their limits, 3 if not, 1 on errors.";

/// Check the program against abTEM, published numbers and conservation laws, or against your own image
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Validate {
    /// Run this case of the suite (repeatable) [default: all cases]
    #[arg(
        long = "case",
        value_name = "NAME",
        help_heading = "Suite",
        conflicts_with = "reference"
    )]
    cases: Vec<String>,
    /// Run only the quick cases
    #[arg(long, help_heading = "Suite", conflicts_with_all = ["reference", "cases"])]
    quick: bool,
    /// Print the cases of the suite and the expected time, and stop
    #[arg(long, help_heading = "Suite")]
    list: bool,
    #[command(flatten)]
    reference: ReferenceArgs,
    /// Report to write (HTML)
    #[arg(short, long, value_name = "FILE.html", default_value = "validation.html")]
    #[arg(help_heading = "Results")]
    output: PathBuf,
    /// Replace an existing report
    #[arg(long, help_heading = "Results")]
    overwrite: bool,
    #[command(flatten)]
    common: Common,
}

/// A case of the suite, for `--list`.
#[derive(Serialize)]
struct Listed {
    name: &'static str,
    title: &'static str,
    group: &'static str,
    quick: bool,
    seconds_on_two_cores: f64,
}

impl Validate {
    /// Runs the subcommand; the exit code is [`DIFFERENT`] if a number lies beyond its limit.
    pub fn run(self) -> anyhow::Result<u8> {
        let reporter = self.common.start()?;
        let cases = selected(&self.cases, self.quick)?;
        if self.list || (self.common.dry_run && !self.reference.given()) {
            return self.list(&cases).map(|()| 0);
        }
        let read = self.reference.files();
        let prepared = self.reference.prepare(&reporter)?;
        if !self.common.dry_run {
            check_outputs([&self.output], &read, self.overwrite)?;
        }
        let report = match prepared {
            Some(prepared) if self.common.dry_run => {
                let (json, text) = prepared.planned();
                self.common.print(&json, &text)?;
                return Ok(0);
            }
            Some(prepared) => {
                let outcome = prepared.run(&reporter)?;
                Report::of_image(ReportOrigin::now(text::command_line()), outcome)
            }
            None => {
                let outcomes = suite(&cases, &reporter)?;
                let origin = ReportOrigin::now(text::command_line());
                Report::new(subject(&self.cases, self.quick), origin, outcomes)
            }
        };
        let page = suite_page(&report)?;
        stemgen::files::atomic_write::write(&self.output, page.as_bytes())?;
        self.common.print(&report, &summary(&report, &self.output))?;
        Ok(match report.verdict {
            Verdict::Fail => DIFFERENT,
            _ => 0,
        })
    }

    fn list(&self, cases: &[Case]) -> anyhow::Result<()> {
        let listed = |c: &Case| Listed {
            name: c.name,
            title: c.title,
            group: c.group.title(),
            quick: c.quick,
            seconds_on_two_cores: c.seconds,
        };
        let listed: Vec<Listed> = cases.iter().map(listed).collect();
        let mut out = String::new();
        for case in &listed {
            let quick = if case.quick { "quick" } else { "" };
            out += &format!("{:<22} {:<6} {}\n", case.name, quick, case.title);
        }
        let seconds: f64 = cases.iter().map(|c| c.seconds).sum();
        out += &format!("{} cases, about {} on two cores", cases.len(), text::duration(seconds));
        self.common.print(&listed, &out)
    }
}

fn summary(report: &Report, output: &Path) -> String {
    let mut out = String::new();
    for case in &report.cases {
        let word = word(case.verdict);
        out += &format!("{word}  {:<22} {}\n", case.name, case.title);
        let wanted = |v: Verdict| v == Verdict::Fail || report.cases.len() == 1;
        for check in case.checks.iter().filter(|c| wanted(c.verdict)) {
            let value = text::significant(check.value, 3);
            out += &format!("      {}: {value} {}\n", check.what, check.unit);
        }
        case.notes.iter().for_each(|note| out += &format!("      note: {note}\n"));
    }
    let (word, time) = (word(report.verdict), text::duration(report.wall_time_s));
    format!("{out}{}\n{word} in {time}; report: {}", report.summary, output.display())
}

fn word(verdict: Verdict) -> &'static str {
    if verdict == Verdict::Fail { "FAIL" } else { "pass" }
}

fn subject(names: &[String], quick: bool) -> &'static str {
    match (names.is_empty(), quick) {
        (true, false) => "its shipped references",
        (true, true) => "the quick part of its shipped references",
        (false, _) => "some of its shipped references",
    }
}

fn suite(cases: &[Case], reporter: &Reporter) -> anyhow::Result<Vec<Outcome>> {
    reporter.start("validating", "steps", cases.iter().map(Case::units).sum());
    let outcomes = cases.iter().map(|case| Ok(case.run(reporter)?)).collect();
    reporter.finish();
    outcomes
}
