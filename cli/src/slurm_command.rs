//! `stemgen slurm`.

use std::ffi::OsString;
use std::path::PathBuf;

use clap::error::ErrorKind;
use clap::{Args, Parser};
use serde::Serialize;

use super::build_command::Build;
use super::invocation::PROGRAM;
use super::text::{self, quoted};
use stemgen::world::WorldPlan;

/// Time limit of a job: the longest expected time times `MARGIN`, plus `START_S` in s. A node may be slower than this machine, or busy.
const MARGIN: f64 = 2.0;
const START_S: f64 = 300.0;
/// Memory limit of a job: the expected memory times `MEMORY_MARGIN`, plus `MEMORY_BYTES`.
const MEMORY_MARGIN: f64 = 1.25;
const MEMORY_BYTES: f64 = 1e9;

const EXAMPLES: &str = "\
Examples:
  Sixteen shards on four processors each: write the script, then submit its jobs:
    stemgen slurm --shards 16 --cpus 4 build gan --difficulty hard -o gan.h5 > gan.sh
    bash gan.sh
  Charge an account, and use a partition:
    stemgen slurm --shards 64 --account nano --partition short build srtio3 --difficulty hard

The script submits two or three jobs, each after the one before: an array for the library if images
are missing, an array for the sub-tiles (parts of the field), and the build that writes the world.
Memory and time are the estimates of `stemgen build --dry-run` on this machine, with a margin. The
output and the cache ($STEMGEN_CACHE, else ~/.cache/stemgen) have to lie where all nodes see them.
If a job is killed, run the script again: finished work is kept.";

/// Print a script that builds a world on a cluster with Slurm
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Slurm {
    /// Number of shards, the tasks of the job array: 1 to 1000
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1000))]
    #[arg(help_heading = "Jobs")]
    shards: u16,
    /// Processors of each task: 1 to 1024
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u16).range(1..=1024))]
    #[arg(help_heading = "Jobs")]
    cpus: u16,
    /// Account that is charged [default: the default account of the cluster]
    #[arg(long, value_name = "NAME", help_heading = "Jobs")]
    account: Option<String>,
    /// Partition of the cluster [default: the default partition of the cluster]
    #[arg(long, value_name = "NAME", help_heading = "Jobs")]
    partition: Option<String>,
    /// Print the plan and the script as JSON
    #[arg(long, help_heading = "Running")]
    json: bool,
    /// The build command, without `stemgen`
    #[arg(value_name = "build ...", required = true, num_args = 1.., trailing_var_arg = true, allow_hyphen_values = true)]
    build: Vec<OsString>,
}

/// Parses the words after `build`.
#[derive(Debug, Parser)]
#[command(name = "build")]
struct BuildLine {
    #[command(flatten)]
    build: Build,
}

/// The jobs, with their memory and time limits.
#[derive(Serialize)]
struct ClusterJobs {
    shards: u16,
    cpus: u16,
    memory_bytes: u64,
    time_s: f64,
    /// Number of arrays before the last job.
    arrays: usize,
    output: PathBuf,
    script: String,
}

impl Slurm {
    /// Runs the subcommand.
    pub fn run(self) -> anyhow::Result<()> {
        let words = self.words()?;
        let line = match BuildLine::try_parse_from(&words) {
            Ok(line) => line,
            Err(help) if help.kind() == ErrorKind::DisplayHelp => {
                return text::print(help.render().to_string().trim_end());
            }
            Err(e) => {
                let message = e.render().to_string();
                anyhow::bail!("{}", message.trim().trim_start_matches("error: "));
            }
        };
        let plan = line.build.planned()?;
        let jobs = self.jobs(&plan, &words);
        if self.json {
            return text::print(&serde_json::to_string_pretty(&jobs)?);
        }
        text::print(jobs.script.trim_end())
    }

    /// Returns the words from `build` on as texts.
    fn words(&self) -> anyhow::Result<Vec<String>> {
        let as_text = |word: &OsString| {
            let text = word.to_str().map(str::to_owned);
            text.ok_or_else(|| {
                anyhow::anyhow!(
                    "{}: is no text in UTF-8, which a script needs; use another name",
                    word.display()
                )
            })
        };
        let words: Vec<String> = self.build.iter().map(as_text).collect::<anyhow::Result<_>>()?;
        // A user reads the script before running it, so the script must show every letter that it holds.
        if let Some(word) = words.iter().find(|word| text::one_line(word) != **word) {
            anyhow::bail!(
                "{}: holds a line end or another invisible letter, which has no place in a script; use another name",
                text::one_line(word)
            );
        }
        if words[0] != "build" {
            anyhow::bail!(
                "`{}` is no build: give the options of `slurm` first, then `build` with its options, as in `{} slurm --shards 16 build srtio3 --difficulty hard`",
                words[0],
                PROGRAM
            );
        }
        let is = |word: &str, name: &str| word == name || word.starts_with(&format!("{name}="));
        let audited = ["--accuracy", "--max-error"];
        if let Some(name) = audited.iter().find(|name| words.iter().any(|w| is(w, name))) {
            anyhow::bail!(
                "{name} lets an audit choose the engine, which does not work in parts; name the engine instead: --engine window --window 7.8"
            );
        }
        if words.iter().any(|w| is(w, "--all")) {
            anyhow::bail!(
                "--all: a script builds one world; leave it out, and print one script for each world, such as `build srtio3 --difficulty easy`"
            );
        }
        let own = ["--shard", "--dry-run", "--threads", "--overwrite", "--hspy", "--json"];
        if let Some(name) = own.iter().find(|name| words.iter().any(|w| is(w, name))) {
            anyhow::bail!("{name} has no place in the jobs of a cluster; leave it out");
        }
        Ok(words)
    }

    fn jobs(&self, plan: &WorldPlan, words: &[String]) -> ClusterJobs {
        let needs = plan.needs(usize::from(self.cpus));
        let tasks = f64::from(self.shards) * f64::from(self.cpus);
        let share = needs.longest_s * needs.threads as f64 / tasks;
        let mut jobs = ClusterJobs {
            shards: self.shards,
            cpus: self.cpus,
            memory_bytes: (MEMORY_MARGIN * needs.memory_bytes as f64 + MEMORY_BYTES) as u64,
            time_s: MARGIN * share + START_S,
            arrays: if plan.has_library() { 2 } else { 1 },
            output: plan.output.clone(),
            script: String::new(),
        };
        jobs.script = self.script(&jobs, words);
        jobs
    }

    fn script(&self, jobs: &ClusterJobs, words: &[String]) -> String {
        let program = PROGRAM;
        let build = words.iter().map(|w| quoted(w)).collect::<Vec<_>>().join(" ");
        let line = format!("{build} --threads {}", self.cpus);
        let name = jobs.output.file_stem().unwrap_or_default().to_string_lossy();
        let mut options = vec![
            "--parsable".to_owned(),
            format!("--job-name={}", quoted(&name)),
            format!("--cpus-per-task={}", self.cpus),
            format!("--mem={}M", jobs.memory_bytes.div_ceil(1_000_000)),
            format!("--time={}", (jobs.time_s / 60.0).ceil()),
        ];
        options.extend(self.account.iter().map(|a| format!("--account={}", quoted(a))));
        options.extend(self.partition.iter().map(|p| format!("--partition={}", quoted(p))));
        let array = format!("--array=0-{}", self.shards - 1);
        let mut script = format!(
            "#!/bin/bash\n\
             # Builds {} in {} shards of {} processors. Submit it from the folder that holds what it names: bash FILE\n\
             # The output and the cache ($STEMGEN_CACHE, else ~/.cache/stemgen) have to lie where all nodes see them.\n\
             set -euo pipefail\n\
             program=${{STEMGEN:-$(command -v {program} || true)}}\n\
             [ -n \"$program\" ] || {{ echo \"{program} is not in PATH: set STEMGEN to its path\" >&2; exit 1; }}\n\
             job() {{ sbatch {} \"$@\"; }}\n",
            text::one_line(&jobs.output.display().to_string()),
            jobs.shards,
            jobs.cpus,
            options.join(" "),
        );
        let stages: &[&str] = match jobs.arrays {
            2 => &["The library, shard by shard.", "The sub-tiles, when the library is there."],
            _ => &["The sub-tiles, shard by shard."],
        };
        let mut after = String::new();
        for (n, stage) in stages.iter().enumerate() {
            script += &format!(
                "# {stage}\nstage{n}=$(job {array} {after}--wrap \"'$program' {} --shard slurm\")\n",
                escaped(&line)
            );
            after = format!("--dependency=afterok:$stage{n} ");
        }
        script += &format!(
            "# The world from all parts.\nlast=$(job {after}--wrap \"'$program' {}\")\necho \"job $last writes {}\"\n",
            escaped(&line),
            escaped(&text::one_line(&jobs.output.display().to_string()))
        );
        script
    }
}

/// Escapes a text for a place between double quotes in a shell.
fn escaped(text: &str) -> String {
    let mut out = String::new();
    for c in text.chars() {
        if "\\\"$`".contains(c) {
            out.push('\\');
        }
        out.push(c);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_reach_the_program_as_they_were_typed() {
        let odd = "a b'c\"d$e`f\\g";
        let script = format!("bash -c \"printf %s {}\"", escaped(&quoted(odd)));
        let run = std::process::Command::new("bash").args(["-c", &script]).output().unwrap();
        assert_eq!(String::from_utf8(run.stdout).unwrap(), odd);
        assert_eq!(quoted("vacancies.rate=0.02"), "vacancies.rate=0.02");
    }
}
