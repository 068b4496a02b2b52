//! `stemgen cache`.

use super::cache_transfer::{Export, Fill, Import, VerifyCache};
use super::plan_text::Lines;
use super::text;
use clap::{Args, Subcommand};
use std::path::PathBuf;
use stemgen::imaging::mosaic::library_cache::{Cache, Holding};

const EXAMPLES: &str = "\
Examples:
  What is there, and how large it is:
    stemgen cache list
  Take the library of a material to another machine:
    stemgen cache export srtio3 -o srtio3.stemlib    # there: stemgen cache import srtio3.stemlib
  Remove what belongs to one material, or all:
    stemgen cache clear srtio3
    stemgen cache clear

The cache holds the mosaic's simulations, for all worlds of a material: another seed or a larger field takes
them from there. It lies in $STEMGEN_CACHE, else in stemgen/ of $XDG_CACHE_HOME or ~/.cache. Nothing is lost with
it but time. Before it, simulations are looked for in the library that comes along with the program, which holds
those of its own crystalline recipes ($STEMGEN_LIBRARY names another folder for it, or none).";

/// List, move, check, fill or clear the simulations that worlds share
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
    Export(Export),
    Import(Import),
    Verify(VerifyCache),
    Fill(Fill),
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
    /// What comes along with the program; none where something was removed.
    library: Option<LibraryReport>,
}

#[derive(serde::Serialize)]
struct LibraryReport {
    folder: PathBuf,
    materials: Vec<Holding>,
}

impl CacheCommand {
    /// Runs the subcommand.
    pub fn run(self) -> anyhow::Result<u8> {
        let cache = Cache::of_user();
        let (materials, json, removed) = match self.action {
            Action::Export(export) => return export.run().map(|()| 0),
            Action::Import(import) => return import.run().map(|()| 0),
            Action::Fill(fill) => return fill.run().map(|()| 0),
            Action::Verify(verify) => return verify.run(),
            Action::List { json } => (cache.holdings()?, json, false),
            Action::Clear { material, json } => {
                check_known(&cache, material.as_deref(), false)?;
                (cache.clear(material.as_deref())?, json, true)
            }
        };
        let library = cache.supplied_library().filter(|_| !removed).map(|supplied| LibraryReport {
            folder: supplied.folder().to_owned(),
            materials: supplied.holdings(),
        });
        let report = CacheReport { folder: cache.folder().map(PathBuf::from), materials, library };
        let message =
            if json { serde_json::to_string_pretty(&report)? } else { report.text(removed) };
        text::print(&message)?;
        Ok(0)
    }
}

/// Refuses a material of which the cache, and with `supplied` the library that comes along, has nothing.
pub fn check_known(cache: &Cache, material: Option<&str>, supplied: bool) -> anyhow::Result<()> {
    let mut held = cache.holdings()?;
    if let Some(library) = cache.supplied_library().filter(|_| supplied) {
        held.extend(library.holdings());
    }
    let mut known: Vec<String> = held.into_iter().map(|h| h.material).collect();
    known.sort();
    known.dedup();
    let Some(name) = material.filter(|m| !known.iter().any(|k| k == m)) else { return Ok(()) };
    let known = if known.is_empty() { "nothing".into() } else { known.join(", ") };
    anyhow::bail!("the cache has no simulations of `{name}`; it holds {known}")
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
        if let Some(library) = &self.library {
            lines.add("library", format!("{} (comes along, read only)", library.folder.display()));
            for h in &library.materials {
                let images = text::count(h.images as u64);
                lines.add(h.material.clone(), format!("{images} images, {}", text::bytes(h.bytes)));
            }
        }
        lines.text()
    }
}
