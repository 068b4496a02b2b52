//! Scores of the four tasks, each from 0 to 1, and their strict forms.

use std::collections::{BTreeMap, BTreeSet};

use ndarray::Array2;
use serde::Serialize;

use super::findings::{FoundColumn, FoundParticle, PlacedDefect};
use super::matching::{most_pairs, nearest_pairs};
use crate::error::{Error, Result};
use crate::setting::Setting;

/// Found and true places of the paper's tasks are a pair within this distance in nm.
pub const PAPER_RADIUS_NM: f64 = 5.0;
/// The same of the strict forms: half the distance of two columns.
pub const STRICT_RADIUS_NM: f64 = 0.1;
/// No phase was predicted for a pixel.
pub const NO_PHASE: i32 = -1;
/// Shares of detection, sizing and morphology in the particle census.
const PARTICLE_SHARES: [f64; 3] = [0.5, 0.3, 0.2];

/// F1 of counts: twice the hits over all that was claimed and all that is there.
fn f1(hits: f64, found: f64, truth: f64) -> f64 {
    if found + truth > 0.0 { 2.0 * hits / (found + truth) } else { 1.0 }
}

/// The mean; 1 of nothing: nothing was there, and nothing claimed.
fn mean(values: &[f64]) -> f64 {
    if values.is_empty() { 1.0 } else { values.iter().sum::<f64>() / values.len() as f64 }
}

/// Defect census by counts: F1 of each type with as many hits as the lesser of what was found and what is there, and their mean over the types that
/// either lists with a count above 0.
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

/// The mean of [`targeted_f1`] over the types that either lists.
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

/// Phase mapping: the mean over the phases that are there or were predicted of the pixels that both maps give to a phase over those that either does.
/// Pixels without a prediction ([`NO_PHASE`]) are wrong, and pixels whose true phase is not known do not count. `None` is right in a field of one phase, and worth nothing elsewhere.
///
/// # Errors
/// [`Error::Invalid`] for maps, [row, column], of two shapes.
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
    /// Macro mean of F1 of the tiles that hold a particle and of those that hold none.
    pub detection: f64,
    /// Mean over paired particles of one less the relative error of the diameter.
    pub sizing: f64,
    /// Macro F1 of the shapes of paired particles.
    pub morphology: f64,
}

impl ParticleScore {
    /// The score of the task.
    pub fn total(&self) -> f64 {
        let parts = [self.detection, self.sizing, self.morphology];
        parts.iter().zip(PARTICLE_SHARES).map(|(part, share)| part * share).sum()
    }
}

/// Particle census. `tiles` says of each tile that was seen whether it is claimed to hold a particle, and whether it does; the
/// particles are those of these tiles. With none there, sizing and morphology are 1 if none is claimed, else 0; with some there and none paired they
/// are 0.
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

/// The mean of F1 over the classes of (found, true) pairs.
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

/// How well columns with defects are told from others.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ColumnScore {
    /// Of the claimed columns, the share that holds a defect; 1 if none is claimed.
    pub precision: f64,
    /// Of the columns with a defect, the share that is claimed; 1 if there is none.
    pub recall: f64,
    /// Average precision: the sum over claimed columns, the surest first, of the precision so far times the recall that the column adds
    /// (`sklearn.metrics.average_precision_score`). Columns of one score count at once.
    pub average_precision: f64,
}

/// Scores claimed columns against those that hold a defect, (x, y) in nm; a claim is that of the nearest true column within
/// `radius_nm`, each once.
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
