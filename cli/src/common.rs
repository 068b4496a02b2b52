//! Options that all subcommands share.

use super::progress_bar::Reporter;
use anyhow::Context;
use clap::Args;
use stemgen::engine::check_memory;
use stemgen::imaging::Cache;
use stemgen::progress::Progress;

/// Running and reporting.
#[derive(Debug, Args)]
#[command(next_help_heading = "Running")]
pub struct Common {
    /// Number of threads; all processors by default. The result is the same for any number
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=4096))]
    pub threads: Option<u16>,
    /// Show what would be done, and what it would take, and stop
    #[arg(long)]
    pub dry_run: bool,
    /// Print the summary, or the plan of --dry-run, as JSON on standard output
    #[arg(long)]
    pub json: bool,
    /// Print nothing but errors (and what --json asks for)
    #[arg(short, long)]
    pub quiet: bool,
}

/// What is refused otherwise.
#[derive(Debug, Args)]
#[command(next_help_heading = "Running")]
pub struct Force {
    /// Go on though more memory is needed than is free
    #[arg(long)]
    force: bool,
}

/// What is not simulated again.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Running")]
pub struct CacheArgs {
    /// Neither read nor keep the mosaic's simulations in the cache (see `stemgen cache`)
    #[arg(long)]
    no_cache: bool,
    /// Take no simulations from the library that comes along with the program; with --no-cache too, all are made
    #[arg(long)]
    no_library: bool,
}

impl CacheArgs {
    /// Where simulations are found and kept.
    pub fn cache(&self) -> Cache {
        let cache = if self.no_cache { Cache::supplied() } else { Cache::of_user() };
        if self.no_library { cache.without_supplied() } else { cache }
    }
}

impl Force {
    /// Refuses, or with `--force` warns of, what needs more memory than is free. `remedy` takes less.
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
    /// Sets the number of threads.
    pub fn start(&self) -> anyhow::Result<Reporter> {
        let threads = self.threads.map_or(0, usize::from);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
        pool.build_global().context("cannot start the threads")?;
        Ok(Reporter::new(self.quiet))
    }

    /// Prints the summary as asked for.
    pub fn print(&self, json: &impl serde::Serialize, text: &str) -> anyhow::Result<()> {
        match (self.json, self.quiet) {
            (true, _) => super::text::print(&serde_json::to_string_pretty(json)?),
            (false, true) => Ok(()),
            (false, false) => super::text::print(text),
        }
    }
}
