//! Findings that agents declare, and the truth in the same form.

use std::collections::BTreeMap;

use ndarray::Array2;
use serde::{Deserialize, Serialize};

use super::task_scores::NO_PHASE;
use crate::error::{Error, Result};
use crate::setting::Setting;
use crate::specimen::SiteKind;

/// A defect at a place.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PlacedDefect {
    /// Type of the defect: `vacancy`, `substitution`.
    pub kind: String,
    /// Position (x, y) in nm from the centre of pixel (0, 0) of the field.
    pub position_nm: [f64; 2],
}

/// Returns the name of a type of defect; `None` for the atom that belongs there.
pub(crate) fn type_name(kind: SiteKind) -> Option<&'static str> {
    match kind {
        SiteKind::Pristine => None,
        SiteKind::Vacancy => Some("vacancy"),
        SiteKind::Substitution => Some("substitution"),
    }
}

/// A particle.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FoundParticle {
    /// Centre (x, y) in nm from the centre of pixel (0, 0) of the field.
    pub position_nm: [f64; 2],
    /// Diameter in nm.
    pub diameter_nm: f64,
    /// Shape: `icosahedron`.
    pub morphology: String,
}

/// An atomic column, and the agent's confidence that it holds a defect.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FoundColumn {
    /// Position (x, y) in nm from the centre of pixel (0, 0) of the field.
    pub position_nm: [f64; 2],
    /// Confidence: any number, greater where a defect is more likely.
    pub score: f64,
}

/// All findings of an agent in a field so far. An empty list says that nothing is there; a task ignores the lists that it does not ask for.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct AgentFindings {
    /// Number of defects by type; `None` counts the entries of `defects`.
    pub counts: Option<BTreeMap<String, u64>>,
    /// Defects with their places; with `None` only counts are scored.
    pub defects: Option<Vec<PlacedDefect>>,
    /// Phases of the whole field in equal parts, [row, column]; [`NO_PHASE`] where there is no prediction. `None` says that there is one
    /// phase.
    pub phases: Option<Array2<i32>>,
    /// Particles.
    pub particles: Vec<FoundParticle>,
    /// Columns, for the scores by column.
    pub columns: Vec<FoundColumn>,
}

/// The text of a report, as programs write it.
#[derive(Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct FindingsText {
    #[serde(skip_serializing_if = "Option::is_none")]
    counts: Option<BTreeMap<String, u64>>,
    /// Places (x, y) in nm by type.
    #[serde(skip_serializing_if = "Option::is_none")]
    defects: Option<BTreeMap<String, Vec<[f64; 2]>>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    phases: Option<Vec<Vec<i32>>>,
    /// x, y and diameter in nm.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    particles: Vec<[f64; 3]>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    morphologies: Vec<String>,
    /// x, y and score.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    columns: Vec<[f64; 3]>,
}

fn refuse(value: impl Into<String>, expected: impl Into<String>) -> Error {
    Error::invalid(Setting::Findings, value.into(), expected.into())
}

impl AgentFindings {
    /// Reads a report: a JSON object with any of `counts` (numbers by type), `defects` (lists of [x, y] in nm by type), `phases` (lists of
    /// rows), `particles` ([x, y, diameter] in nm), `morphologies` (one for each particle) and `columns` ([x, y, score]).
    ///
    /// # Errors
    /// [`Error::Invalid`] for text that is no JSON object of findings.
    pub fn read(report: &str) -> Result<Self> {
        if !report.trim_start().starts_with('{') {
            // Serde would read a list as the values of the object in order.
            return Err(refuse("the report", "is no JSON object of findings"));
        }
        let report: FindingsText = serde_json::from_str(report)
            .map_err(|e| refuse("the report", format!("is no JSON object of findings: {e}")))?;
        let rows = report.phases.as_ref().map(Vec::len);
        let phases = report.phases.map(|lines| {
            let width = lines.first().map_or(0, Vec::len);
            let values: Vec<i32> = lines.into_iter().flatten().collect();
            Array2::from_shape_vec((rows.unwrap_or_default(), width), values)
                .map_err(|_| refuse("phases", "has rows of several lengths"))
        });
        let particle = |(n, [x, y, diameter_nm]): (usize, [f64; 3])| FoundParticle {
            position_nm: [x, y],
            diameter_nm,
            morphology: report.morphologies.get(n).cloned().unwrap_or_default(),
        };
        if report.morphologies.len() > report.particles.len() {
            return Err(refuse("morphologies", "has more entries than there are particles"));
        }
        let placed = |(kind, places): (String, Vec<[f64; 2]>)| {
            let of = move |position_nm| PlacedDefect { kind: kind.clone(), position_nm };
            places.into_iter().map(of)
        };
        let findings = AgentFindings {
            counts: report.counts,
            defects: report.defects.map(|list| list.into_iter().flat_map(placed).collect()),
            phases: phases.transpose()?,
            particles: report.particles.iter().copied().enumerate().map(particle).collect(),
            columns: report
                .columns
                .iter()
                .map(|[x, y, score]| FoundColumn { position_nm: [*x, *y], score: *score })
                .collect(),
        };
        findings.check()?;
        Ok(findings)
    }

    /// Writes the text that [`AgentFindings::read`] reads.
    pub fn report(&self) -> String {
        let defects = self.defects.as_ref().map(|list| {
            let mut of: BTreeMap<String, Vec<[f64; 2]>> = BTreeMap::new();
            list.iter().for_each(|d| of.entry(d.kind.clone()).or_default().push(d.position_nm));
            of
        });
        let flat = |at: [f64; 2], value: f64| [at[0], at[1], value];
        let report = FindingsText {
            counts: self.counts.clone(),
            defects,
            phases: self.phases.as_ref().map(|map| map.outer_iter().map(|r| r.to_vec()).collect()),
            particles: self.particles.iter().map(|p| flat(p.position_nm, p.diameter_nm)).collect(),
            morphologies: self.particles.iter().map(|p| p.morphology.clone()).collect(),
            columns: self.columns.iter().map(|c| flat(c.position_nm, c.score)).collect(),
        };
        serde_json::to_string(&report).unwrap_or_default()
    }

    /// Checks that all numbers are finite, and that maps are not empty.
    ///
    /// # Errors
    /// [`Error::Invalid`] otherwise.
    pub(crate) fn check(&self) -> Result<()> {
        let defects = self.defects.iter().flatten().flat_map(|d| d.position_nm);
        let particles =
            self.particles.iter().flat_map(|p| [p.position_nm[0], p.position_nm[1], p.diameter_nm]);
        let columns =
            self.columns.iter().flat_map(|c| [c.position_nm[0], c.position_nm[1], c.score]);
        if let Some(odd) = defects.chain(particles).chain(columns).find(|v| !v.is_finite()) {
            return Err(refuse(odd.to_string(), "expected finite numbers"));
        }
        if let Some(odd) = self.particles.iter().find(|p| p.diameter_nm < 0.0) {
            return Err(refuse(odd.diameter_nm.to_string(), "diameters are not negative"));
        }
        match &self.phases {
            Some(map) if map.is_empty() => {
                Err(refuse("phases", "a map has one row and column at least"))
            }
            Some(map) if map.iter().any(|p| *p < NO_PHASE) => {
                Err(refuse("phases", "phases are numbers from 0 on, and -1 is no prediction"))
            }
            _ => Ok(()),
        }
    }

    /// Returns the number of defects of each type.
    pub(crate) fn defect_counts(&self) -> BTreeMap<String, u64> {
        self.counts.clone().unwrap_or_else(|| counted(self.defects.iter().flatten()))
    }
}

/// Counts the defects of each type.
pub(crate) fn counted<'a>(
    defects: impl Iterator<Item = &'a PlacedDefect>,
) -> BTreeMap<String, u64> {
    let mut counts: BTreeMap<String, u64> = BTreeMap::new();
    for defect in defects {
        match counts.get_mut(&defect.kind) {
            Some(count) => *count += 1,
            None => drop(counts.insert(defect.kind.clone(), 1)),
        }
    }
    counts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reports_come_back() {
        let placed = |kind: &str, x| PlacedDefect { kind: kind.into(), position_nm: [x, 2.0] };
        let findings = AgentFindings {
            counts: Some(BTreeMap::from([("vacancy".into(), 3)])),
            defects: Some(vec![placed("substitution", 0.5), placed("vacancy", 1.5)]),
            phases: Some(ndarray::arr2(&[[0, 1, NO_PHASE], [1, 1, 0]])),
            particles: vec![FoundParticle {
                position_nm: [1.0, 2.0],
                diameter_nm: 3.0,
                morphology: "wulff".into(),
            }],
            columns: vec![FoundColumn { position_nm: [0.1, 0.2], score: -4.0 }],
        };
        assert_eq!(AgentFindings::read(&findings.report()).unwrap(), findings);
        assert_eq!(AgentFindings::read("{}").unwrap(), AgentFindings::default());
        assert_eq!(AgentFindings { counts: None, ..findings }.defect_counts().len(), 2);
    }

    #[test]
    fn odd_reports_are_refused() {
        for report in [
            "",
            "[]",
            "{\"defect\": {}}",
            "{\"phases\": [[0, 1], [0]]}",
            "{\"phases\": []}",
            "{\"phases\": [[-2]]}",
            "{\"counts\": {\"vacancy\": -1}}",
            "{\"particles\": [[0, 0, -1]]}",
            "{\"particles\": [[0, 0, 1e999]]}",
            "{\"morphologies\": [\"wulff\"]}",
        ] {
            assert!(AgentFindings::read(report).is_err(), "{report}");
        }
    }
}
