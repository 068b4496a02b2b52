//! `stemgen build --shard`: one of several processes that build a world.

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::plan_text::Lines;
use super::progress_bar::Reporter;
use super::text;
use stemgen::files::Shard;
use stemgen::world::{ShardSummary, WorldBuild};

/// The report of a shard at its end.
#[derive(Serialize)]
pub struct ShardReport {
    output: PathBuf,
    #[serde(flatten)]
    summary: ShardSummary,
}

impl ShardReport {
    /// Computes a part of a world.
    pub fn of(
        build: WorldBuild,
        output: &Path,
        shard: Shard,
        reporter: &Reporter,
    ) -> stemgen::Result<Self> {
        let summary = build.run_part(output, shard, reporter)?;
        Ok(ShardReport { output: output.to_owned(), summary })
    }

    /// Returns the time that the part took, in s.
    pub fn wall_time_s(&self) -> f64 {
        self.summary.wall_time_s
    }

    /// Returns names and values, line by line.
    pub fn text(&self) -> String {
        let s = &self.summary;
        let mut lines = Lines::default();
        let [index, count] = s.shard;
        lines.add("shard", format!("{index}/{count} of {}", self.output.display()));
        if s.is_done() {
            let resumed = match s.subtiles_resumed {
                0 => String::new(),
                n => format!(", {n} of them from an earlier run"),
            };
            lines.add("sub-tiles", format!("{} of {}{resumed}", s.subtiles, s.subtiles_of_field));
            lines.add(
                "next",
                "when all shards are done, run the command without --shard: it writes the world",
            );
        } else {
            let lacks = text::count(s.library_lacks as u64);
            lines.add(
                "library",
                format!("this part is done; the parts of other shards still lack {lacks} images"),
            );
            lines.add(
                "next",
                "when they are done, run this shard again for its sub-tiles, or the command without --shard, which computes all sub-tiles",
            );
        }
        lines.add("time", text::duration(s.wall_time_s));
        lines.text()
    }
}
