//! The four tasks and their scores.

use ndarray::Array2;
use serde::{Deserialize, Serialize};

use super::benchmark_world::PhaseSamples;
use super::findings::{AgentFindings, type_name};
use super::seen_truth::SeenTruth;
use super::task_scores::{
    ColumnScore, PAPER_RADIUS_NM, ParticleScore, STRICT_RADIUS_NM, column_score, defect_census,
    particle_census, phase_iou, targeted_f1,
};
use crate::error::{Error, Result};
use crate::setting::Setting;
use crate::specimen::SiteKind;

/// Largest distance in nm of the centres of a pair of particles in the strict form: a fifth of the diameter of common particles.
pub(crate) const STRICT_PARTICLE_RADIUS_NM: f64 = 0.5;

/// The question of a task.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TaskKind {
    /// The number of defects of each type.
    DefectCensus,
    /// The place of each phase in the full field.
    PhaseMapping,
    /// The places of the defects of one type.
    Targeted,
    /// The parts that hold a particle, and the sizes and shapes of particles.
    ParticleCensus,
}

impl TaskKind {
    /// Returns the name of the task: `defect-census`.
    pub fn name(self) -> &'static str {
        match self {
            TaskKind::DefectCensus => "defect-census",
            TaskKind::PhaseMapping => "phase-mapping",
            TaskKind::Targeted => "targeted",
            TaskKind::ParticleCensus => "particle-census",
        }
    }
}

/// A task.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Task {
    /// The question.
    pub kind: TaskKind,
    /// Whether places must be right to [`STRICT_RADIUS_NM`] in place of [`PAPER_RADIUS_NM`].
    pub strict: bool,
    /// The type of defect that [`TaskKind::Targeted`] asks for; all when `None`.
    pub target: Option<String>,
}

/// Scores of one declaration.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct TaskScore {
    /// Score of the task as defined in the paper.
    pub paper: f64,
    /// Score of the task with places that are right to [`STRICT_RADIUS_NM`].
    pub strict: f64,
    /// How well columns with defects are distinguished from others; for tasks about defects if the agent lists columns.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub columns: Option<ColumnScore>,
    /// Parts of the particle census.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub particles: Option<ParticleScore>,
}

impl Task {
    /// Refuses a target that is no type of defect.
    ///
    /// # Errors
    /// [`Error::Invalid`].
    pub fn check(&self) -> Result<()> {
        let known = [SiteKind::Vacancy, SiteKind::Substitution].map(type_name);
        match &self.target {
            Some(target) if !known.contains(&Some(target.as_str())) => {
                let expected = "the target is a type of defect: vacancy or substitution";
                Err(Error::invalid(Setting::Episode, target, expected))
            }
            _ => Ok(()),
        }
    }

    /// Returns the score of the task from 0 to 1. `phases` are needed for phase mapping alone.
    ///
    /// # Errors
    /// Errors of [`phase_iou`].
    pub(crate) fn score(
        &self,
        findings: &AgentFindings,
        seen: &SeenTruth,
        phases: Option<&PhaseSamples>,
    ) -> Result<f64> {
        self.score_within(self.strict, findings, seen, phases)
    }

    fn score_within(
        &self,
        strict: bool,
        findings: &AgentFindings,
        seen: &SeenTruth,
        phases: Option<&PhaseSamples>,
    ) -> Result<f64> {
        let radius = if strict { STRICT_RADIUS_NM } else { PAPER_RADIUS_NM };
        let places = findings.defects.as_deref();
        Ok(match self.kind {
            TaskKind::DefectCensus => {
                defect_census(&findings.defect_counts(), places, seen.defects(), radius)
            }
            TaskKind::Targeted => targeted_f1(
                places.unwrap_or_default(),
                seen.defects(),
                self.target.as_deref(),
                radius,
            ),
            TaskKind::ParticleCensus => particles(strict, findings, seen).total(),
            TaskKind::PhaseMapping => match phases {
                Some(truth) => {
                    let found = findings.phases.as_ref().map(|map| spread(map, truth));
                    phase_iou(found.as_ref(), &truth.phases)?
                }
                None => 0.0,
            },
        })
    }

    /// Returns all scores of a declaration.
    ///
    /// # Errors
    /// As [`Task::score`].
    pub(crate) fn all_scores(
        &self,
        findings: &AgentFindings,
        seen: &SeenTruth,
        phases: Option<&PhaseSamples>,
    ) -> Result<TaskScore> {
        let defects = matches!(self.kind, TaskKind::DefectCensus | TaskKind::Targeted);
        let columns = (defects && !findings.columns.is_empty()).then(|| {
            let of = seen.columns().iter().filter(|c| c.defective).map(|c| c.position_nm);
            column_score(&findings.columns, &of.collect::<Vec<_>>(), STRICT_RADIUS_NM)
        });
        let census = self.kind == TaskKind::ParticleCensus;
        Ok(TaskScore {
            paper: self.score_within(false, findings, seen, phases)?,
            strict: self.score_within(true, findings, seen, phases)?,
            columns,
            particles: census.then(|| particles(self.strict, findings, seen)),
        })
    }
}

fn particles(strict: bool, findings: &AgentFindings, seen: &SeenTruth) -> ParticleScore {
    let radius = if strict { STRICT_PARTICLE_RADIUS_NM } else { PAPER_RADIUS_NM };
    let tiles = seen.occupied(&findings.particles);
    particle_census(&tiles, &findings.particles, seen.particles(), radius)
}

/// Samples a map of the field in equal parts at the pixels of the true samples.
fn spread(map: &Array2<i32>, truth: &PhaseSamples) -> Array2<i32> {
    let ((rows, columns), (height, width)) = (map.dim(), truth.phases.dim());
    let part = |n: usize, of: usize, parts: usize| ((2 * n + 1) * parts / (2 * of)).min(parts - 1);
    Array2::from_shape_fn((height, width), |(i, j)| {
        map[[part(i, height, rows), part(j, width, columns)]]
    })
}

#[cfg(test)]
mod tests {
    use super::super::benchmark_world::RegionTruth;
    use super::super::findings::PlacedDefect;
    use super::*;
    use crate::recipe::Region;

    #[test]
    fn maps_of_any_resolution_are_spread_over_the_field() {
        let truth = PhaseSamples { phases: Array2::zeros((4, 6)), stride_px: 8 };
        let map = ndarray::arr2(&[[0, 1, 2], [3, 4, 5]]);
        let expected = ndarray::arr2(&[
            [0, 0, 1, 1, 2, 2],
            [0, 0, 1, 1, 2, 2],
            [3, 3, 4, 4, 5, 5],
            [3, 3, 4, 4, 5, 5],
        ]);
        assert_eq!(spread(&map, &truth), expected);
        assert_eq!(spread(&expected, &truth), expected);
    }

    /// Places that are 1 nm off count in the paper's form, but not in the strict form.
    #[test]
    fn strict_forms_ask_for_places() {
        let placed = |x: f64| PlacedDefect { kind: "vacancy".into(), position_nm: [x, 0.5] };
        let mut seen = SeenTruth::default();
        let truth = RegionTruth { defects: vec![placed(1.0)], ..RegionTruth::default() };
        seen.add(Region { x: [0.0, 3.0], y: [0.0, 1.0] }, truth);
        let findings =
            AgentFindings { defects: Some(vec![placed(2.0)]), ..AgentFindings::default() };
        let task = Task { kind: TaskKind::Targeted, strict: false, target: Some("vacancy".into()) };
        let scores = task.all_scores(&findings, &seen, None).unwrap();
        assert_eq!((scores.paper, scores.strict), (1.0, 0.0));
        // A census by counts alone does not compare places; of the other type there is no defect.
        let census = Task { kind: TaskKind::DefectCensus, strict: true, target: None };
        assert_eq!(census.score(&findings, &seen, None).unwrap(), 1.0);
        let other = Task { target: Some("substitution".into()), ..task };
        assert_eq!(other.score(&findings, &seen, None).unwrap(), 1.0);
    }
}
