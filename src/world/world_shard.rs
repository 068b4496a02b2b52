//! A part of a build, for several processes that share it: on the machines of a cluster, or one after the other.
//!
//! Each process makes its part of the simulations of the library and of the sub-tiles, under the names and keys that a whole build uses.
//! The build finds them and finishes. The part of a process depends on its number alone, and nothing is ever removed.

use std::path::Path;
use std::time::Instant;

use serde::Serialize;

use super::subtile_store::SubtileStore;
use super::work_folder::WorkFolder;
use super::world_build::{WorldBuild, checked};
use super::world_job::Job;
use crate::error::{Error, Result};
use crate::files::{OutputLock, Shard};
use crate::imaging::RegionImager;
use crate::progress::Progress;
use crate::setting::Setting;

/// The result of one of several processes.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct ShardSummary {
    /// Number of the process, from 0, and the number of processes.
    pub shard: [usize; 2],
    /// Number of simulations of the library that other processes have still to make. Sub-tiles are made when it is 0.
    pub library_lacks: usize,
    /// Number of sub-tiles of this part that are stored now.
    pub subtiles: usize,
    /// Number of sub-tiles of this part that were stored before.
    pub subtiles_resumed: usize,
    /// Number of sub-tiles of the whole field.
    pub subtiles_of_field: usize,
    /// Time in s.
    pub wall_time_s: f64,
}

impl ShardSummary {
    /// Whether the part is done.
    pub fn is_done(&self) -> bool {
        self.library_lacks == 0
    }
}

impl WorldBuild {
    /// Makes one of several parts of the world `output`: its simulations of the library, and, once the simulations of all other parts are
    /// stored, its sub-tiles. [`WorldBuild::run`] then finds the parts, makes what is missing, and writes the file; its bytes do not depend
    /// on the number of parts. The first part also makes the audit.
    ///
    /// # Errors
    /// As [`WorldBuild::run`]. [`Error::Invalid`] where an audit decides how images are made, and for parts of another world, which are
    /// never removed.
    pub fn run_part(
        self,
        output: &Path,
        shard: Shard,
        progress: &dyn Progress,
    ) -> Result<ShardSummary> {
        let (started, work) = (Instant::now(), WorkFolder::of(output));
        if self.policy.check.limited() {
            let expected = "shards need an engine that is fixed in advance: leave the largest error out, and give a window";
            return Err(Error::invalid(Setting::Shard, shard, expected));
        }
        self.check_output(output, false)?;
        let _lock = OutputLock::share(output)?;
        self.check_output(output, false)?;
        SubtileStore::check_recipe(output, &self.layout.recipe.to_toml())?;
        work.create()?;
        let made = self.make_part(output, &work, shard, progress);
        let summary = made.inspect_err(|_| work.remove_if_empty())?;
        Ok(ShardSummary { wall_time_s: started.elapsed().as_secs_f64(), ..summary })
    }

    fn make_part(
        self,
        output: &Path,
        work: &WorkFolder,
        shard: Shard,
        progress: &dyn Progress,
    ) -> Result<ShardSummary> {
        self.check_disk(output, &[])?;
        let WorldBuild { layout, policy, own, chosen } = self;
        let mut summary = ShardSummary {
            shard: [shard.index(), shard.count()],
            library_lacks: 0,
            subtiles: 0,
            subtiles_resumed: 0,
            subtiles_of_field: layout.partition.len(),
            wall_time_s: 0.0,
        };
        let (imager, audit): (Box<dyn RegionImager>, _) = match own {
            Some(mut imager) => {
                imager.prepare(progress)?;
                (imager, None)
            }
            None => {
                let again = || policy.imaging.chosen(&layout.imaged, &layout.specimen);
                let mut first = chosen.into_inner().map_or_else(again, Ok)?;
                if let Some(library) = first.imager.library_mut() {
                    library.keep_in(&work.library());
                    summary.library_lacks = library.prepare_part(shard, progress)?;
                }
                if summary.library_lacks > 0 {
                    return Ok(summary);
                }
                if shard.index() == 0 {
                    checked(&layout, &policy, first, work, progress)?
                } else {
                    first.imager.prepare(progress)?;
                    (first.imager, None)
                }
            }
        };
        let job = Job { layout: &layout, imager: &*imager, audit, progress };
        let store = SubtileStore::join(output, &job.key(), progress)?;
        [summary.subtiles, summary.subtiles_resumed] = job.simulate_part(&store, shard)?;
        Ok(summary)
    }
}
