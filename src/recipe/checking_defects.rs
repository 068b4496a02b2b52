//! Limits of vacancies and substitutions.

use super::fault::{Checked, check_guest, fault, one_of, within};
use super::resolved_recipe::Recipe;
use super::tables::{
    MOST_CLUSTERS, MOST_POINT_DEFECTS, PointDefect, StructureKind, Substitutions, Vacancies,
};

/// Checks the defects of a crystal of the elements `symbols`, and adds the elements of substitutions to `symbols`.
pub fn check_defects(recipe: &Recipe, symbols: &mut Vec<String>) -> Checked {
    if let Some(vacancies) = &recipe.vacancies {
        check_vacancies(vacancies, symbols)?;
        let uniform = matches!(recipe.structure, StructureKind::Epitaxy | StructureKind::Particles);
        if uniform && vacancies.cluster_fraction > 0.0 {
            let kind = recipe.structure.name();
            let expected = format!(
                "expected 0: structure = \"{kind}\" has no boundaries about which vacancies gather"
            );
            return fault("vacancies.cluster_fraction", vacancies.cluster_fraction, expected);
        }
        check_clusters(vacancies)?;
    }
    if let Some(substitutions) = &recipe.substitutions {
        check_substitutions(substitutions, symbols)?;
        symbols.push(substitutions.by.clone());
    }
    check_point_defects(&recipe.defects, symbols)
}

fn check_clusters(vacancies: &Vacancies) -> Checked {
    let Vacancies { clusters, cluster_fraction, .. } = *vacancies;
    if clusters > MOST_CLUSTERS {
        let expected = format!("expected at most {MOST_CLUSTERS}");
        return fault("vacancies.clusters", clusters, expected);
    }
    if clusters > 0 && cluster_fraction == 0.0 {
        let expected = "expected 0, since vacancies.cluster_fraction = 0 gathers no vacancies in clusters; raise it, or leave clusters out";
        return fault("vacancies.clusters", clusters, expected);
    }
    Ok(())
}

fn check_point_defects(defects: &[PointDefect], symbols: &mut Vec<String>) -> Checked {
    if defects.len() > MOST_POINT_DEFECTS {
        let expected = format!("expected at most {MOST_POINT_DEFECTS} tables [[defects]]");
        return fault("defects", format!("{} tables", defects.len()), expected);
    }
    let hosts = symbols.clone();
    for (n, defect) in defects.iter().enumerate() {
        one_of("defects.element", &defect.element, &hosts)?;
        within("defects.rate", defect.rate, 0.0, 1.0)?;
        if let Some(by) = &defect.by {
            check_guest("defects.by", by, &defect.element)?;
            symbols.push(by.clone());
        }
        let same = |d: &&PointDefect| (&d.element, &d.by) == (&defect.element, &defect.by);
        if defects[..n].iter().any(|d| same(&d)) {
            let kind = defect.by.as_ref().map_or("vacancies".to_owned(), |by| format!("by {by}"));
            let expected =
                "each [[defects]] needs a different kind of defect; add the rates in one table";
            return fault("defects", format!("{} {kind} twice", defect.element), expected);
        }
    }
    Ok(())
}

fn check_vacancies(v: &Vacancies, elements: &[String]) -> Checked {
    one_of("vacancies.element", &v.element, elements)?;
    within("vacancies.max_probability", v.max_probability, 0.0, 1.0)?;
    within("vacancies.rate", v.rate, 0.0, v.max_probability)?;
    within("vacancies.cluster_fraction", v.cluster_fraction, 0.0, 1.0)?;
    within("vacancies.cluster_sigma_nm", v.cluster_sigma_nm, 0.1, 1000.0)?;
    within("vacancies.relaxation_angstrom", v.relaxation_angstrom, 0.0, 0.3)
}

fn check_substitutions(s: &Substitutions, elements: &[String]) -> Checked {
    one_of("substitutions.element", &s.element, elements)?;
    check_guest("substitutions.by", &s.by, &s.element)?;
    within("substitutions.rate", s.rate, 0.0, 1.0)
}
