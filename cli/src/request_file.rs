//! `--write-request`: all settings that decide a simulation, in a file.

use super::common::Common;
use super::plan_text::Lines;
use super::structure_args::with_frames;
use anyhow::bail;
use serde::Serialize;
use std::path::{Path, PathBuf};
use stemgen::files::atomic_write;
use stemgen::files::outputs::check_outputs;
use stemgen::simulation::{SimulationJob, SimulationRequest};

/// A file for a request.
pub struct RequestFile<'a> {
    /// Its path.
    pub path: &'a Path,
    /// The subcommand that reads it.
    pub command: &'a str,
    /// Whether an existing file is replaced.
    pub overwrite: bool,
}

#[derive(Serialize)]
struct WrittenRequest {
    request: PathBuf,
}

impl RequestFile<'_> {
    /// Checks the request, and writes it; nothing is simulated. `inputs` are files that must not be replaced.
    pub fn write(
        &self,
        request: SimulationRequest,
        inputs: &[PathBuf],
        common: &Common,
    ) -> anyhow::Result<()> {
        let path = self.path;
        if !path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("toml")) {
            bail!(
                "--write-request {}: the name of a request ends in .toml; did you mean {}?",
                path.display(),
                path.with_extension("toml").display()
            );
        }
        check_outputs([path], inputs, self.overwrite)?;
        let folder = path.parent().unwrap_or(Path::new("."));
        let job = SimulationJob::new(request).map_err(with_frames)?;
        let words = format!(
            "# What `stemgen {} {}` simulates. Lengths in Angstrom, angles in mrad.\n",
            self.command,
            path.file_name().unwrap_or_default().display()
        );
        atomic_write::write(path, (words + &job.request().to_toml(folder)?).as_bytes())?;
        let mut lines = Lines::default();
        lines.add("request", path.display().to_string());
        common.print(&WrittenRequest { request: path.to_owned() }, &lines.text())
    }
}
