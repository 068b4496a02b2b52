//! `stemgen verify`.

use super::common::Common;
use super::hdf5_check;
use super::validate_command::DIFFERENT;
use clap::Args;
use serde::Serialize;
use std::path::PathBuf;
use stemgen::validate::{CheckOutcome, WorldCheck, check_world};

const EXAMPLES: &str = "\
Examples:
  Check a world that was copied, or written by another program:
    stemgen verify worlds/srtio3_easy_2x2.h5
  In a script: check all worlds of a folder:
    for world in worlds/*.h5; do stemgen verify \"$world\" --quiet || echo \"$world\"; done

The command compares tiles with their neighbours and with the overview, the lists of the ground
truth with each other and with the field, and the counted electrons with the dose and with the
noise-free image, if the file has one (build --keep-clean). It does not measure the accuracy of the
image: `stemgen audit` does.

Exit code: 0 if the world is sound, 3 if not, 1 on errors.";

/// Check that a world file is complete and consistent
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Verify {
    /// World file
    #[arg(value_name = "WORLD.h5")]
    world: PathBuf,
    #[command(flatten)]
    common: Common,
}

/// The summary that `--json` prints.
#[derive(Serialize)]
struct VerifySummary<'a> {
    world: &'a PathBuf,
    sound: bool,
    checks: &'a [WorldCheck],
}

impl Verify {
    /// Runs the subcommand; the exit code is [`DIFFERENT`] if the world is not sound.
    pub fn run(self) -> anyhow::Result<u8> {
        let reporter = self.common.start()?;
        hdf5_check::check(&self.world)?;
        if self.common.dry_run {
            let text = format!("{} would be checked", self.world.display());
            self.common.print(&serde_json::json!({ "world": self.world }), &text)?;
            return Ok(0);
        }
        let checks = check_world(&self.world, &reporter)?;
        let sound = checks.iter().all(|c| c.outcome != CheckOutcome::Fault);
        let summary = VerifySummary { world: &self.world, sound, checks: &checks };
        self.common.print(&summary, &self.lines(&checks, sound))?;
        Ok(if sound { 0 } else { DIFFERENT })
    }

    fn lines(&self, checks: &[WorldCheck], sound: bool) -> String {
        let mut out = String::new();
        for WorldCheck { what, outcome, found } in checks {
            let word = match outcome {
                CheckOutcome::Sound => "sound",
                CheckOutcome::Fault => "FAULT",
                CheckOutcome::Skipped => "skipped",
            };
            out += &format!("{word:<8} {what:<9} {found}\n");
        }
        let verdict = match sound {
            true => "is sound",
            false => "is not sound: copy it again, or build it again",
        };
        format!("{out}{} {verdict}", self.world.display())
    }
}
