//! `stemgen simulate --shard`: the probes of a scan are divided among processes; their parts are stored, found and checked.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, bail};
use serde::Serialize;

use super::plan_text::Lines;
use super::progress_bar::Reporter;
use super::text;
use stemgen::engine::{Plan, Scan, ScanPart, series_digest, simulate_part};
use stemgen::files::array_store::{ArrayStore, Stored};
use stemgen::files::outputs::work_folder;
use stemgen::files::{OutputLock, Shard};
use stemgen::progress::Progress;
use stemgen::structure::Site;

const EXTENSION: &str = "part";

/// A scan, with the place where its parts are stored.
pub struct ScanParts<'a> {
    pub plans: &'a [Plan],
    pub frames: Vec<&'a [Site]>,
    pub scan: Scan,
    pub output: &'a Path,
}

/// The report of a shard at its end.
#[derive(Serialize)]
struct ScanShardReport {
    output: PathBuf,
    /// Its number, from 0, and the number of shards.
    shard: [usize; 2],
    /// Number of its values.
    values: usize,
    /// Whether it was stored already.
    resumed: bool,
    wall_time_s: f64,
}

impl ScanParts<'_> {
    fn store(&self) -> ArrayStore {
        ArrayStore::new(work_folder(self.output), EXTENSION)
    }

    /// Returns a digest of all settings and atoms that decide the values, without the number of the part.
    fn key(&self) -> String {
        series_digest(self.plans, &self.frames, &self.scan)
    }

    /// Simulates a part and stores it. Refuses a folder with parts of other images, and never removes them.
    pub fn make(
        &self,
        shard: Shard,
        reporter: &Reporter,
    ) -> anyhow::Result<(String, impl Serialize)> {
        let begun = Instant::now();
        let _lock = OutputLock::share(self.output)?;
        let (store, key) = (self.store(), self.key());
        self.found(&key)?;
        let (name, key) = (name(shard), of_shard(&key, shard));
        let shape = ScanPart::shape(shard, self.plans, self.frames.len(), &self.scan)?;
        let resumed = matches!(store.load(&name, &key, shape), Stored::Whole(_));
        if !resumed {
            let part = simulate_part(self.plans, &self.frames, &self.scan, shard, reporter)?;
            store.save(&name, &key, "", &part.to_array())?;
        }
        let report = ScanShardReport {
            output: self.output.to_owned(),
            shard: [shard.index(), shard.count()],
            values: shape[0] * shape[1],
            resumed,
            wall_time_s: begun.elapsed().as_secs_f64(),
        };
        Ok((report.text(), report))
    }

    /// Reads the stored parts. Refuses a folder with parts of other images.
    pub fn read(&self, reporter: &Reporter) -> anyhow::Result<Vec<ScanPart>> {
        let (store, key) = (self.store(), self.key());
        let mut parts = Vec::new();
        let series = (self.plans, self.frames.len(), &self.scan);
        for (shard, path) in self.found(&key)? {
            let shape = ScanPart::shape(shard, self.plans, self.frames.len(), &self.scan)?;
            match store.load(&name(shard), &of_shard(&key, shard), shape) {
                Stored::Whole(array) => parts.push(ScanPart::from_array(&array, shard, series)?),
                Stored::Missing => {}
                Stored::Unusable(why) => {
                    reporter.warn(&format!("{}: {why}; simulated again", path.display()));
                }
            }
        }
        if !parts.is_empty() {
            let folder = store.folder().display();
            reporter.note(&format!("{} of the parts of this scan are in {folder}", parts.len()));
        }
        Ok(parts)
    }

    /// Removes the parts, and their folder if it is empty then.
    pub fn remove(&self) -> anyhow::Result<()> {
        Ok(self.store().clear()?)
    }

    /// Returns the files of parts, with their shards.
    ///
    /// A damaged file passes, since it may be a part of this scan; it is simulated again. A file with the key of other images is refused.
    fn found(&self, key: &str) -> anyhow::Result<Vec<(Shard, PathBuf)>> {
        let mut found = Vec::new();
        for path in self.store().files()?.arrays {
            let shard = path.file_stem().and_then(|stem| stem.to_str()).and_then(shard_of);
            let Some(shard) = shard else { continue };
            let bytes = std::fs::read(&path).with_context(|| path.display().to_string())?;
            let other = stemgen::files::array_store::checked(&bytes, &of_shard(key, shard))
                .is_err_and(|why| why == "holds another image");
            if other {
                bail!(
                    "{}: is a part of other images, or of another version of the program; remove {} if you do not need it, or name another --output",
                    path.display(),
                    self.store().folder().display()
                );
            }
            found.push((shard, path));
        }
        Ok(found)
    }
}

fn name(shard: Shard) -> String {
    format!("part_{}_of_{}", shard.index(), shard.count())
}

fn shard_of(name: &str) -> Option<Shard> {
    let (index, count) = name.strip_prefix("part_")?.split_once("_of_")?;
    Shard::new(index.parse().ok()?, count.parse().ok()?).ok()
}

fn of_shard(key: &str, shard: Shard) -> String {
    format!("{key} {shard}")
}

impl ScanShardReport {
    fn text(&self) -> String {
        let mut lines = Lines::default();
        let [index, count] = self.shard;
        lines.add("shard", format!("{index}/{count} of {}", self.output.display()));
        let was = if self.resumed { ", which were stored already" } else { "" };
        lines.add("values", format!("{}{was}", text::count(self.values as u64)));
        let next =
            "when all shards are done, run the command without --shard: it writes the images";
        lines.add("next", next);
        lines.add("time", text::duration(self.wall_time_s));
        lines.text()
    }
}
