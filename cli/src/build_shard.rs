//! `stemgen build --shard`: one of several processes that build a world.

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::plan_text::Lines;
use super::progress_bar::Reporter;
use super::text;
use stemgen::files::Shard;
use stemgen::world::{ShardSummary, WorldBuild};

/// What a shard tells at its end.
#[derive(Serialize)]
pub struct ShardReport {
    output: PathBuf,
    #[serde(flatten)]
    summary: ShardSummary,
}

impl ShardReport {
    /// Makes a part of a world.
    pub fn of(
        build: WorldBuild,
        output: &Path,
        shard: Shard,
        reporter: &Reporter,
    ) -> stemgen::Result<Self> {
        let summary = build.run_part(output, shard, reporter)?;
        Ok(ShardReport { output: output.to_owned(), summary })
    }

    /// Time that it took in s.
    pub fn wall_time_s(&self) -> f64 {
        self.summary.wall_time_s
    }

    /// Name and value, line by line.
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
                "when all shards are done, the same command without --shard writes the world",
            );
        } else {
            let lacks = text::count(s.library_lacks as u64);
            lines.add(
                "library",
                format!("its part is done; those of other shards lack {lacks} images"),
            );
            lines.add(
                "next",
                "when they are done: this shard again for its sub-tiles, or the same command without --shard, which makes them itself",
            );
        }
        lines.add("time", text::duration(s.wall_time_s));
        lines.text()
    }
}
