//! `stemgen cache`.

use super::cache_transfer::{Export, Fill, Import, VerifyCache};
use super::plan_text::Lines;
use super::text;
use clap::{Args, Subcommand};
use std::path::PathBuf;
use stemgen::imaging::{Cache, Holding};

const EXAMPLES: &str = "\
Examples:
  Print the contents of the cache, and the size of each part:
    stemgen cache list
  Move the simulations of one material to another machine:
    stemgen cache export srtio3 -o srtio3.stemlib    # there: stemgen cache import srtio3.stemlib
  Remove the simulations of one material, or all:
    stemgen cache clear srtio3
    stemgen cache clear

A mosaic is an image of a large field that is put together from simulations of its columns. The
cache keeps these simulations, so that a world with another seed or a larger field reuses them. Its
folder is $STEMGEN_CACHE, else stemgen/ in $XDG_CACHE_HOME or ~/.cache. You may remove this folder:
simulations are then made again, which takes time.

The library is installed with the program, and holds the simulations for its own crystals and
layers. The program reads it first, and never writes to it. $STEMGEN_LIBRARY names another folder;
if it is empty, no library is used.";

/// List, move, check, fill or clear the cached simulations that worlds share
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct CacheCommand {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// Print the contents of the cache and of the installed library, by material
    List {
        /// Print as JSON
        #[arg(long)]
        json: bool,
    },
    Export(Export),
    Import(Import),
    Verify(VerifyCache),
    Fill(Fill),
    /// Remove the cached simulations of one material, or of all
    Clear {
        /// Material whose simulations are removed [default: all]
        #[arg(value_name = "MATERIAL")]
        material: Option<String>,
        /// Print the removed simulations as JSON
        #[arg(long)]
        json: bool,
    },
}

#[derive(serde::Serialize)]
struct CacheReport {
    folder: Option<PathBuf>,
    materials: Vec<Holding>,
    /// The installed library; `None` after a removal.
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

/// Refuses a material without simulations in the cache (with `supplied`, also in the installed library).
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
            lines.add(
                "library",
                format!("{} (installed with the program, read only)", library.folder.display()),
            );
            for h in &library.materials {
                let images = text::count(h.images as u64);
                lines.add(h.material.clone(), format!("{images} images, {}", text::bytes(h.bytes)));
            }
        }
        lines.text()
    }
}
