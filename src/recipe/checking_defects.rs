//! Limits of vacancies and substitutions.

use super::fault::{Checked, check_guest, fault, one_of, within};
use super::resolved_recipe::Recipe;
use super::tables::{StructureKind, Substitutions, Vacancies};

/// Defects of a crystal that holds the elements `symbols`; adds those that come in by substitution.
pub fn check_defects(recipe: &Recipe, symbols: &mut Vec<String>) -> Checked {
    if let Some(vacancies) = &recipe.vacancies {
        check_vacancies(vacancies, symbols)?;
        let uniform = matches!(recipe.structure, StructureKind::Epitaxy | StructureKind::Particles);
        if uniform && vacancies.cluster_fraction > 0.0 {
            let kind = recipe.structure.name();
            let expected =
                format!("expected 0: structure = \"{kind}\" has nothing that they gather about");
            return fault("vacancies.cluster_fraction", vacancies.cluster_fraction, expected);
        }
    }
    if let Some(substitutions) = &recipe.substitutions {
        check_substitutions(substitutions, symbols)?;
        symbols.push(substitutions.by.clone());
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
