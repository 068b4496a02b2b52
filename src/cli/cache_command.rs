//! `stemgen cache`.

use super::plan_report::Lines;
use super::text;
use crate::imaging::mosaic::library_cache::{Cache, Holding};
use clap::{Args, Subcommand};
use std::path::PathBuf;

const EXAMPLES: &str = "\
Examples:
  What is there, and how large it is:
    stemgen cache list
  Remove what belongs to one material, or all:
    stemgen cache clear srtio3
    stemgen cache clear

The cache holds the mosaic's simulations, for all worlds of a material: another seed or a larger field takes
them from there. It lies in $STEMGEN_CACHE, else in stemgen/ of $XDG_CACHE_HOME or ~/.cache. Nothing is lost with
it but time.";

/// List or clear the simulations that worlds share
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct CacheCommand {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// Show what the cache holds, by material
    List {
        /// Print as JSON
        #[arg(long)]
        json: bool,
    },
    /// Remove the simulations of a material, or all
    Clear {
        /// Only this material
        #[arg(value_name = "MATERIAL")]
        material: Option<String>,
        /// Print what was removed as JSON
        #[arg(long)]
        json: bool,
    },
}

#[derive(serde::Serialize)]
struct CacheReport {
    folder: Option<PathBuf>,
    materials: Vec<Holding>,
}

impl CacheCommand {
    /// Runs the subcommand.
    pub fn run(self) -> anyhow::Result<()> {
        let cache = Cache::of_user();
        let (materials, json, removed) = match self.action {
            Action::List { json } => (cache.holdings()?, json, false),
            Action::Clear { material, json } => {
                let removed = cache.clear(material.as_deref())?;
                if let (Some(name), true) = (&material, removed.is_empty()) {
                    let known: Vec<String> =
                        cache.holdings()?.into_iter().map(|h| h.material).collect();
                    let known = if known.is_empty() { "nothing".into() } else { known.join(", ") };
                    anyhow::bail!("the cache has no simulations of `{name}`; it holds {known}");
                }
                (removed, json, true)
            }
        };
        let report = CacheReport { folder: cache.folder().map(PathBuf::from), materials };
        if json {
            return text::print(&serde_json::to_string_pretty(&report)?);
        }
        text::print(&report.text(removed))
    }
}

impl CacheReport {
    fn text(&self, removed: bool) -> String {
        let mut lines = Lines::default();
        let folder = self
            .folder
            .as_ref()
            .map_or("none (neither $STEMGEN_CACHE nor $HOME is set)".into(), |f| {
                f.display().to_string()
            });
        lines.add("folder", folder);
        for h in &self.materials {
            let images = text::count(h.images as u64);
            let verb = if removed { " removed" } else { "" };
            lines.add(
                h.material.clone(),
                format!("{images} images, {}{verb}", text::bytes(h.bytes)),
            );
        }
        if self.materials.is_empty() {
            lines.add("holds", "nothing");
        }
        lines.text()
    }
}
