//! Scores of the four tasks, each from 0 to 1, and their strict forms.

use std::collections::{BTreeMap, BTreeSet};

use ndarray::Array2;
use serde::Serialize;

use super::findings::{FoundColumn, FoundParticle, PlacedDefect};
use super::matching::{most_pairs, nearest_pairs};
use crate::error::{Error, Result};
use crate::setting::Setting;

/// Largest distance in nm of a pair of a found and a true place in the paper's tasks.
pub const PAPER_RADIUS_NM: f64 = 5.0;
/// Largest distance in nm of a pair in the strict forms: half the distance of two columns.
pub const STRICT_RADIUS_NM: f64 = 0.1;
/// Value of pixels without a predicted phase.
pub const NO_PHASE: i32 = -1;
/// Shares of detection, sizing and morphology in the particle census.
const PARTICLE_SHARES: [f64; 3] = [0.5, 0.3, 0.2];

/// F1 of counts: twice the hits divided by the sum of claimed and true items.
fn f1(hits: f64, found: f64, truth: f64) -> f64 {
    if found + truth > 0.0 { 2.0 * hits / (found + truth) } else { 1.0 }
}

/// The mean; 1 for an empty list, where nothing was there and nothing was claimed.
fn mean(values: &[f64]) -> f64 {
    if values.is_empty() { 1.0 } else { values.iter().sum::<f64>() / values.len() as f64 }
}

/// Defect census by counts: the mean of F1 over the types that either list has with a count above 0. The hits of a type are the lesser of
/// its found and its true count.
pub fn count_f1(found: &BTreeMap<String, u64>, truth: &BTreeMap<String, u64>) -> f64 {
    let of = |list: &BTreeMap<String, u64>, kind: &str| list.get(kind).copied().unwrap_or(0);
    let kinds: BTreeSet<&String> = found.keys().chain(truth.keys()).collect();
    let scores = kinds.into_iter().filter_map(|kind| {
        let (a, b) = (of(found, kind), of(truth, kind));
        (a + b > 0).then(|| f1(a.min(b) as f64, a as f64, b as f64))
    });
    mean(&scores.collect::<Vec<_>>())
}

/// F1 of the defects of one type, or of all with `None`, paired one to one within `radius_nm`: the task `targeted`.
pub fn targeted_f1(
    found: &[PlacedDefect],
    truth: &[PlacedDefect],
    kind: Option<&str>,
    radius_nm: f64,
) -> f64 {
    let places = |list: &[PlacedDefect]| -> Vec<[f64; 2]> {
        let of = list.iter().filter(|d| kind.is_none_or(|k| d.kind == k));
        of.map(|d| d.position_nm).collect()
    };
    let (found, truth) = (places(found), places(truth));
    let hits = most_pairs(&found, &truth, radius_nm) as f64;
    f1(hits, found.len() as f64, truth.len() as f64)
}

/// The mean of [`targeted_f1`] over the types that occur in either list.
pub fn spatial_f1(found: &[PlacedDefect], truth: &[PlacedDefect], radius_nm: f64) -> f64 {
    let kinds: BTreeSet<&str> = found.iter().chain(truth).map(|d| d.kind.as_str()).collect();
    let of = |kind: &str| targeted_f1(found, truth, Some(kind), radius_nm);
    mean(&kinds.into_iter().map(of).collect::<Vec<_>>())
}

/// Defect census: the greater of [`count_f1`] and, where places are given, [`spatial_f1`].
pub fn defect_census(
    counts: &BTreeMap<String, u64>,
    places: Option<&[PlacedDefect]>,
    truth: &[PlacedDefect],
    radius_nm: f64,
) -> f64 {
    let mut true_counts: BTreeMap<String, u64> = BTreeMap::new();
    for defect in truth {
        *true_counts.entry(defect.kind.clone()).or_default() += 1;
    }
    let by_counts = count_f1(counts, &true_counts);
    places.map_or(by_counts, |found| by_counts.max(spatial_f1(found, truth, radius_nm)))
}

/// Phase mapping: the mean, over the phases that occur or were predicted, of the number of pixels that both maps give to a phase, divided
/// by the number that either map gives to it. Pixels without a prediction ([`NO_PHASE`]) are wrong, and pixels whose true phase is not
/// known do not count. `None` is right in a field of one phase, and scores 0 elsewhere.
///
/// # Errors
/// [`Error::Invalid`] for maps, [row, column], of different shapes.
pub fn phase_iou(found: Option<&Array2<i32>>, truth: &Array2<i32>) -> Result<f64> {
    let present: BTreeSet<i32> = truth.iter().copied().filter(|p| *p != NO_PHASE).collect();
    let Some(found) = found else { return Ok(f64::from(u8::from(present.len() <= 1))) };
    if found.dim() != truth.dim() {
        let expected = format!("the map of the field has the shape {:?}", truth.dim());
        return Err(Error::invalid(Setting::Score, format!("{:?}", found.dim()), expected));
    }
    let mut both: BTreeMap<i32, u64> = BTreeMap::new();
    let mut either: BTreeMap<i32, u64> = BTreeMap::new();
    for (a, b) in found.iter().zip(truth).filter(|(_, b)| **b != NO_PHASE) {
        if a == b {
            *both.entry(*a).or_default() += 1;
        } else if *a != NO_PHASE {
            *either.entry(*a).or_default() += 1;
        }
        *either.entry(*b).or_default() += 1;
    }
    let iou =
        |(phase, all): (&i32, &u64)| both.get(phase).copied().unwrap_or(0) as f64 / *all as f64;
    Ok(mean(&either.iter().map(iou).collect::<Vec<_>>()))
}

/// Parts of the particle census.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ParticleScore {
    /// Macro mean of F1 of the tiles with a particle and of the tiles without one.
    pub detection: f64,
    /// Mean over paired particles of one less the relative error of the diameter.
    pub sizing: f64,
    /// Macro F1 of the shapes of paired particles.
    pub morphology: f64,
}

impl ParticleScore {
    /// Returns the score of the task.
    pub fn total(&self) -> f64 {
        let parts = [self.detection, self.sizing, self.morphology];
        parts.iter().zip(PARTICLE_SHARES).map(|(part, share)| part * share).sum()
    }
}

/// Particle census. `tiles` holds, for each tile that was seen, whether a particle is claimed and whether there is one; the particles are
/// the ones in these tiles. If there are none, sizing and morphology are 1 if none is claimed, else 0; if there are some and none is
/// paired, both are 0.
pub fn particle_census(
    tiles: &[[bool; 2]],
    found: &[FoundParticle],
    truth: &[FoundParticle],
    radius_nm: f64,
) -> ParticleScore {
    if truth.is_empty() && !tiles.iter().any(|[_, there]| *there) {
        let claimed = !found.is_empty() || tiles.iter().any(|[claimed, _]| *claimed);
        let all = f64::from(u8::from(!claimed));
        return ParticleScore { detection: all, sizing: all, morphology: all };
    }
    let places = |list: &[FoundParticle]| list.iter().map(|p| p.position_nm).collect::<Vec<_>>();
    let pairs = nearest_pairs(&places(found), &places(truth), radius_nm);
    let size = |[f, t]: &[usize; 2]| {
        let (found, there) = (found[*f].diameter_nm, truth[*t].diameter_nm);
        (1.0 - (found - there).abs() / there).max(0.0)
    };
    let shapes =
        |[f, t]: &[usize; 2]| [found[*f].morphology.as_str(), truth[*t].morphology.as_str()];
    let of_pairs = |score: f64| if pairs.is_empty() { 0.0 } else { score };
    ParticleScore {
        detection: macro_f1(tiles),
        sizing: of_pairs(mean(&pairs.iter().map(size).collect::<Vec<_>>())),
        morphology: of_pairs(macro_f1(&pairs.iter().map(shapes).collect::<Vec<_>>())),
    }
}

/// Returns the mean of F1 over the classes of (found, true) pairs.
pub fn macro_f1<T: Ord + Copy>(pairs: &[[T; 2]]) -> f64 {
    let classes: BTreeSet<T> = pairs.iter().flatten().copied().collect();
    let of = |class: T| {
        let count =
            |which: &dyn Fn(&[T; 2]) -> bool| pairs.iter().filter(|p| which(p)).count() as f64;
        let hits = count(&|[a, b]| *a == class && *b == class);
        f1(hits, count(&|[a, _]| *a == class), count(&|[_, b]| *b == class))
    };
    mean(&classes.into_iter().map(of).collect::<Vec<_>>())
}

/// How well columns with defects are distinguished from others.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ColumnScore {
    /// Of the claimed columns, the share that holds a defect; 1 if none is claimed.
    pub precision: f64,
    /// Of the columns with a defect, the share that is claimed; 1 if there is none.
    pub recall: f64,
    /// Average precision: the sum over claimed columns, the surest first, of the precision so far times the recall that the column adds
    /// (`sklearn.metrics.average_precision_score`). Columns of equal score count at once.
    pub average_precision: f64,
}

/// Scores claimed columns against the columns with a defect, (x, y) in nm. Each claim belongs to the nearest true column within
/// `radius_nm`, and each column counts once.
pub fn column_score(found: &[FoundColumn], truth: &[[f64; 2]], radius_nm: f64) -> ColumnScore {
    let mut sorted: Vec<&FoundColumn> = found.iter().collect();
    sorted.sort_by(|a, b| b.score.total_cmp(&a.score));
    let places: Vec<[f64; 2]> = sorted.iter().map(|c| c.position_nm).collect();
    let mut right = vec![false; sorted.len()];
    nearest_pairs(&places, truth, radius_nm).iter().for_each(|[f, _]| right[*f] = true);
    let hits = right.iter().filter(|r| **r).count() as f64;
    let share = |part: f64, whole: usize| if whole == 0 { 1.0 } else { part / whole as f64 };
    let (mut average, mut so_far, mut before) = (0.0, 0, 0.0);
    for (n, column) in sorted.iter().enumerate() {
        so_far += usize::from(right[n]);
        if sorted.get(n + 1).is_none_or(|next| next.score < column.score) {
            let recall = share(so_far as f64, truth.len());
            average += (recall - before) * so_far as f64 / (n + 1) as f64;
            before = recall;
        }
    }
    let average_precision = if truth.is_empty() { share(0.0, sorted.len()) } else { average };
    ColumnScore {
        precision: share(hits, sorted.len()),
        recall: share(hits, truth.len()),
        average_precision,
    }
}
