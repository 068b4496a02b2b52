//! Options that all subcommands share.

use super::progress_bar::Reporter;
use anyhow::Context;
use clap::Args;
use stemgen::engine::check_memory;
use stemgen::imaging::Cache;
use stemgen::progress::Progress;

/// Holds the options for running and reporting.
#[derive(Debug, Args)]
#[command(next_help_heading = "Running")]
pub struct Common {
    /// Number of threads [default: all processors]. The result does not depend on it
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=4096))]
    pub threads: Option<u16>,
    /// Print the plan (inputs, sizes, time, memory) and stop; write nothing
    #[arg(long)]
    pub dry_run: bool,
    /// Print the summary, or the plan of --dry-run, as JSON on standard output
    #[arg(long)]
    pub json: bool,
    /// Print errors only, and the JSON of --json
    #[arg(short, long)]
    pub quiet: bool,
}

/// Allows a run that needs more memory than is free.
#[derive(Debug, Args)]
#[command(next_help_heading = "Running")]
pub struct Force {
    /// Continue with a warning if the run needs more memory than is free
    #[arg(long)]
    pub force: bool,
}

/// Chooses where cached simulations are read and stored.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Running")]
pub struct CacheArgs {
    /// Do not use the cache, which keeps simulations of columns for later worlds (see `stemgen cache`)
    #[arg(long)]
    no_cache: bool,
    /// Do not use the library, the simulations of columns that are installed with the program. With --no-cache, everything is
    /// simulated
    #[arg(long)]
    no_library: bool,
}

impl CacheArgs {
    /// Returns the cache and library that the options choose.
    pub fn cache(&self) -> Cache {
        let cache = if self.no_cache { Cache::supplied() } else { Cache::of_user() };
        if self.no_library { cache.without_supplied() } else { cache }
    }
}

impl Force {
    /// Refuses a run that needs more memory than is free, or warns of it with `--force`. `remedy` says how to need less.
    pub fn check_memory(
        &self,
        needed_bytes: u64,
        remedy: &str,
        reporter: &Reporter,
    ) -> stemgen::Result<()> {
        match check_memory(needed_bytes, remedy) {
            Err(e) if self.force => {
                reporter.warn(&e.to_string());
                Ok(())
            }
            checked => checked,
        }
    }
}

impl Common {
    /// Starts the threads, and returns the reporter of progress.
    pub fn start(&self) -> anyhow::Result<Reporter> {
        let threads = self.threads.map_or(0, usize::from);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
        pool.build_global().context("cannot start the threads")?;
        Ok(Reporter::new(self.quiet))
    }

    /// Prints the summary as text or as JSON, or nothing with `--quiet`.
    pub fn print(&self, json: &impl serde::Serialize, text: &str) -> anyhow::Result<()> {
        match (self.json, self.quiet) {
            (true, _) => super::text::print(&serde_json::to_string_pretty(json)?),
            (false, true) => Ok(()),
            (false, false) => super::text::print(text),
        }
    }
}
