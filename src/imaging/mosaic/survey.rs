//! The survey of a field: which families of units it needs.

use std::collections::BTreeSet;

use rayon::prelude::*;

use crate::recipe::region::Region;
use crate::recipe::tables::Field;
use crate::specimen::specimen_trait::Specimen;
use crate::specimen::units::unit_tag::TurnedFamily;

/// Units that reach into the field lie at most this far outside it, in nm.
pub(crate) const BEYOND_NM: f64 = 0.6;
/// Width of the stripes that are surveyed one after the other, in nm.
const STRIPE_NM: f64 = 2.5;

/// The columns of a field, as the library sees them.
#[derive(Debug, Default)]
pub struct FieldSurvey {
    /// The families of units, with the turn of their library cells.
    pub families: BTreeSet<TurnedFamily>,
    /// Number of columns with a place in the library.
    pub tagged: u64,
    /// Number of columns without a place in the library.
    pub untagged: u64,
}

/// Surveys all columns of the built part of a field.
pub(crate) fn survey(specimen: &dyn Specimen, field: &Field) -> FieldSurvey {
    let area = field.built_region().grown(BEYOND_NM);
    let count = ((area.y[1] - area.y[0]) / STRIPE_NM).ceil().max(1.0) as usize;
    let edge = |n: usize| area.y[0] + (area.y[1] - area.y[0]) * n as f64 / count as f64;
    let stripe = |n: usize| {
        let mut found = FieldSurvey::default();
        let region = Region { x: area.x, y: [edge(n), edge(n + 1)] };
        for column in specimen.columns(&region) {
            match column.unit {
                Some(unit) => {
                    found.tagged += 1;
                    found.families.insert(TurnedFamily::of(&unit));
                }
                None => found.untagged += 1,
            }
        }
        found
    };
    let mut found =
        (0..count).into_par_iter().map(stripe).reduce(FieldSurvey::default, |mut a, b| {
            a.families.extend(b.families);
            FieldSurvey {
                tagged: a.tagged + b.tagged,
                untagged: a.untagged + b.untagged,
                families: a.families,
            }
        });
    let reached = |turned: &TurnedFamily| {
        let turned = *turned;
        specimen.reached_families(turned.family).into_iter().map(move |f| turned.with_family(f))
    };
    found.families = found.families.iter().flat_map(reached).collect();
    found
}
