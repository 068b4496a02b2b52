//! The diffraction patterns of a job in parts, which several processes simulate: stored, found and checked.

use std::ops::Range;
use std::path::{Path, PathBuf};

use ndarray::{Array2, Array5};

use crate::engine::{PatternRows, series_digest};
use crate::error::{Error, Result};
use crate::files::array_store::{ArrayStore, Stored, checked};
use crate::files::outputs::work_folder;
use crate::files::{OutputLock, Shard};
use crate::progress::Progress;
use crate::setting::Setting;
use crate::simulation::{SimulationJob, StoredPatterns};

const EXTENSION: &str = "part";

/// The parts of the patterns of a job, in the work folder beside the output.
///
/// A part is some neighbouring rows of the scan, in files of about 256 MB. Its patterns are fractions of the beam before source, transfer
/// function and noise, and do not depend on the division.
pub struct PatternParts<'a> {
    job: &'a SimulationJob,
    output: &'a Path,
    key: String,
    /// Rows (first, end) of each plan.
    found: Vec<Vec<Range<usize>>>,
    progress: &'a dyn Progress,
}

/// A part that a process has made.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MadePart {
    /// Rows of the simulated scan, of all defoci.
    pub rows: usize,
    /// How many of them were stored already.
    pub stored: usize,
}

impl<'a> PatternParts<'a> {
    /// Looks for stored parts of the patterns that are written to `output`.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a request without patterns, and for a folder with parts of other patterns; [`Error::Io`].
    pub fn new(
        job: &'a SimulationJob,
        output: &'a Path,
        progress: &'a dyn Progress,
    ) -> Result<Self> {
        let settings = job.asked()?;
        let scan = job.simulated_scan()?;
        let series = series_digest(job.plans(), &job.specimen().frames(), &scan);
        let key = format!("{series} {settings:?}");
        let mut parts = PatternParts { job, output, key, found: Vec::new(), progress };
        parts.look()?;
        Ok(parts)
    }

    fn store(&self) -> ArrayStore {
        ArrayStore::new(work_folder(self.output), EXTENSION)
    }

    /// The folder of the parts.
    pub fn folder(&self) -> PathBuf {
        work_folder(self.output)
    }

    /// Number of rows that are stored, of all defoci.
    pub fn stored_rows(&self) -> usize {
        self.found.iter().flatten().map(ExactSizeIterator::len).sum()
    }

    fn look(&mut self) -> Result<()> {
        let mut found = vec![Vec::new(); self.job.plans().len()];
        for path in self.store().files()?.arrays {
            let name = path.file_stem().and_then(|stem| stem.to_str()).unwrap_or_default();
            let Some((plan, rows)) = rows_of(name) else { continue };
            let bytes = std::fs::read(&path).map_err(|e| Error::io(&path, "read", e))?;
            match checked(&bytes, &self.key_of(plan, &rows)) {
                Ok(_) if plan < found.len() => found[plan].push(rows),
                Err("holds another image") | Ok(_) => {
                    let expected = format!(
                        "no parts of other patterns, or of another version of the program; remove {} if you do not need it, or name \
                         another output",
                        self.folder().display()
                    );
                    return Err(Error::invalid(Setting::Output, path.display(), expected));
                }
                Err(why) => {
                    let what = format!("{}: {why}; simulated again", path.display());
                    self.progress.warn(&what);
                }
            }
        }
        // Where parts of different divisions overlap, the one that begins first is taken.
        for ranges in &mut found {
            ranges.sort_by_key(|rows: &Range<usize>| (rows.start, rows.end));
            let mut end = 0;
            ranges.retain(|rows| {
                let kept = rows.start >= end;
                end = if kept { rows.end } else { end };
                kept
            });
        }
        self.found = found;
        Ok(())
    }

    fn key_of(&self, plan: usize, rows: &Range<usize>) -> String {
        format!("{} {}", self.key, name(plan, rows))
    }

    /// Simulates the rows of one of several processes that are not stored, and stores them.
    ///
    /// # Errors
    /// Errors of the simulation; [`Error::Io`].
    pub fn make(&self, shard: Shard) -> Result<MadePart> {
        let _lock = OutputLock::share(self.output)?;
        let store = self.store();
        let mut made = MadePart { rows: 0, stored: 0 };
        for plan in 0..self.job.plans().len() {
            let rows = self.job.pattern_part(plan, shard)?;
            let missing = missing(&rows, &self.found[plan]);
            made.rows += rows.len();
            made.stored += rows.len() - missing.iter().map(ExactSizeIterator::len).sum::<usize>();
            let mut save = |band: PatternRows<'_>| {
                let [records, count, columns, ny, nx] = *band.data.shape() else { return Ok(()) };
                let rows = band.first_row..band.first_row + count;
                let values = band.data.iter().copied().collect();
                let shape = (records * count * columns, ny * nx);
                let array = Array2::from_shape_vec(shape, values).unwrap_or_default();
                store.save(&name(plan, &rows), &self.key_of(plan, &rows), "", &array)
            };
            for rows in missing {
                self.job.simulated_rows(plan, rows, &mut save, self.progress)?;
            }
        }
        Ok(made)
    }

    /// Removes the parts, and their folder if it is empty then.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn remove(&self) -> Result<()> {
        self.store().clear()
    }
}

impl StoredPatterns for PatternParts<'_> {
    fn ranges(&self, plan: usize) -> Vec<Range<usize>> {
        self.found.get(plan).cloned().unwrap_or_default()
    }

    fn load(&self, plan: usize, rows: &Range<usize>) -> Option<Array5<f32>> {
        let scan = self.job.simulated_scan().ok()?;
        let [ny, nx] = self.job.pattern_settings()?.detector.shape();
        let records = self.job.plans()[plan].record_after.len();
        let shape = (records, rows.len(), scan.shape[1], ny, nx);
        let key = self.key_of(plan, rows);
        let lines = [records * rows.len() * scan.shape[1], ny * nx];
        match self.store().load(&name(plan, rows), &key, lines) {
            Stored::Whole(array) => array.into_shape_with_order(shape).ok(),
            _ => None,
        }
    }
}

fn name(plan: usize, rows: &Range<usize>) -> String {
    format!("patterns_{plan}_rows_{}_{}", rows.start, rows.end)
}

fn rows_of(name: &str) -> Option<(usize, Range<usize>)> {
    let (plan, rows) = name.strip_prefix("patterns_")?.split_once("_rows_")?;
    let (start, end) = rows.split_once('_')?;
    Some((plan.parse().ok()?, start.parse().ok()?..end.parse().ok()?))
}

/// The ranges of `rows` that no range of `found`, which are sorted, covers.
fn missing(rows: &Range<usize>, found: &[Range<usize>]) -> Vec<Range<usize>> {
    let mut gaps = Vec::new();
    let mut next = rows.start;
    for there in found {
        let gap = next..there.start.min(rows.end);
        if !gap.is_empty() {
            gaps.push(gap);
        }
        next = next.max(there.end);
    }
    if next < rows.end {
        gaps.push(next..rows.end);
    }
    gaps
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_are_what_is_not_there() {
        let gaps = |rows: Range<usize>| {
            let gaps = missing(&rows, &[2..4, 4..5, 8..20]);
            gaps.iter().map(|gap| (gap.start, gap.end)).collect::<Vec<_>>()
        };
        assert_eq!(gaps(0..10), [(0, 2), (5, 8)]);
        assert_eq!(gaps(3..8), [(5, 8)]);
        assert_eq!(gaps(9..12), []);
        assert_eq!(gaps(15..30), [(20, 30)]);
        assert_eq!(rows_of(&name(3, &(4..9))), Some((3, 4..9)));
    }
}
