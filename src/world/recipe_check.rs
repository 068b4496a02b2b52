//! Limits of the values in a recipe.

use std::collections::BTreeMap;

use super::coincidence;
use super::recipe::{Boundaries, Fault, Field, Lattice, Recipe, Vacancies};
use crate::structure::elements;

type Checked = std::result::Result<(), Fault>;

/// The candidate most like `key`, if any is similar.
pub(super) fn nearest<'k>(key: &str, known: impl Iterator<Item = &'k str>) -> Option<&'k str> {
    let scored = known.map(|k| (strsim::jaro_winkler(key, k), k));
    scored.filter(|(score, _)| *score > 0.7).max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, k)| k)
}

/// Checks every value against its limits.
pub(super) fn check(recipe: &Recipe) -> Checked {
    if recipe.version != 1 {
        return fault("version", recipe.version, "this program reads recipes of version 1");
    }
    check_field(&recipe.field)?;
    let elements = check_lattice(&recipe.lattice)?;
    let cells = recipe.field.thickness_nm * 10.0 / recipe.lattice.a_angstrom;
    if !(0.5..4000.0).contains(&cells) {
        let expected = "expected between one and 4000 unit cells";
        return fault("field.thickness_nm", recipe.field.thickness_nm, expected);
    }
    if let Some(boundaries) = &recipe.boundaries {
        check_boundaries(boundaries, &recipe.field, &recipe.lattice, &elements)?;
    }
    if let Some(vacancies) = &recipe.vacancies {
        check_vacancies(vacancies, &elements)?;
    }
    let phonons = &recipe.phonons;
    within("phonons.configurations", phonons.configurations as f64, 1.0, 10_000.0)?;
    check_elements("phonons.sigma_angstrom", &phonons.sigma_angstrom, &elements, 0.0, 0.5)?;
    within("optics.energy_kv", recipe.optics.energy_kv, 10.0, 1500.0)?;
    within("optics.convergence_mrad", recipe.optics.convergence_mrad, 0.1, 100.0)?;
    let detector = &recipe.detector;
    within("detector.inner_mrad", detector.inner_mrad, 0.0, 1000.0)?;
    within("detector.outer_mrad", detector.outer_mrad, detector.inner_mrad + 0.1, 1000.0)?;
    within("dose.electrons_per_angstrom2", recipe.dose.electrons_per_angstrom2, 1e-3, 1e12)
}

fn check_field(field: &Field) -> Checked {
    within("field.tile_px", field.tile_px as f64, 8.0, 4096.0)?;
    within("field.overlap_px", field.overlap_px as f64, 0.0, (field.tile_px / 2) as f64)?;
    for i in 0..2 {
        within("field.grid", field.grid[i] as f64, 1.0, 1000.0)?;
        within("field.fov_nm", field.fov_nm[i], 1.0, 5000.0)?;
    }
    let [h, w] = field.pixels(field.grid);
    let square = field.fov_nm[0] / h as f64 / field.pixel_nm() - 1.0;
    if square.abs() > 0.01 {
        let expected = format!("pixels must be square: {h}x{w} px need the same ratio of fov_nm");
        return fault("field.fov_nm", format!("{:?}", field.fov_nm), expected);
    }
    match field.crop {
        Some(c) if c[0] == 0 || c[1] == 0 || c[0] > field.grid[0] || c[1] > field.grid[1] => {
            let expected = format!("expected 1 to {:?} (field.grid)", field.grid);
            fault("field.crop", format!("{c:?}"), expected)
        }
        _ => Ok(()),
    }
}

/// Symbols of the three elements, in the usual spelling.
fn check_lattice(lattice: &Lattice) -> std::result::Result<Vec<String>, Fault> {
    within("lattice.a_angstrom", lattice.a_angstrom, 3.0, 8.0)?;
    let sites = [
        ("lattice.a_site", &lattice.a_site),
        ("lattice.b_site", &lattice.b_site),
        ("lattice.x_site", &lattice.x_site),
    ];
    for (key, text) in sites {
        let known = elements::atomic_number(text).map(elements::symbol);
        if known.ok() != Some(text.as_str()) {
            fault(key, text, "expected the symbol of an element such as \"Sr\"")?;
        }
    }
    let symbols: Vec<String> = sites.iter().map(|(_, s)| (*s).clone()).collect();
    match symbols[0] == symbols[1] || symbols[2] == symbols[0] || symbols[2] == symbols[1] {
        true => fault("lattice.x_site", &symbols[2], "the three sites need different elements")?,
        false => Ok(symbols),
    }
}

fn check_boundaries(b: &Boundaries, field: &Field, lattice: &Lattice, el: &[String]) -> Checked {
    within("boundaries.misorientation_deg", b.misorientation_deg, 0.1, 90.0)?;
    if b.count > 200 || (b.count + 1) as f64 * 2.0 > field.fov_nm[1] {
        let most = (field.fov_nm[1] / 2.0) as usize;
        let expected = format!("grains need 2 nm of width: at most {}", most.clamp(1, 201) - 1);
        return fault("boundaries.count", b.count, expected);
    }
    if let Some(sigma) = b.sigma
        && let Err(expected) = coincidence::half_angle(sigma, b.misorientation_deg)
    {
        return fault("boundaries.sigma", sigma, expected);
    }
    let key = "boundaries.min_distance_angstrom";
    let pairs: Vec<String> = (0..3)
        .flat_map(|i| (i..3).map(move |j| (i, j)))
        .map(|(i, j)| format!("{}-{}", el[i], el[j]))
        .collect();
    check_elements(key, &b.min_distance_angstrom, &pairs, 0.0, lattice.a_angstrom)?;
    for (i, j, perfect) in [(0, 1, 0.866), (0, 2, 0.707), (1, 2, 0.5), (2, 2, 0.707)] {
        let pair = format!("{}-{}", el[i], el[j]);
        let most = perfect * lattice.a_angstrom;
        let value = b.min_distance_angstrom.get(&pair).copied().unwrap_or_default();
        within(&format!("{key}.{pair}"), value, 0.0, most)?;
    }
    Ok(())
}

fn check_vacancies(v: &Vacancies, elements: &[String]) -> Checked {
    if !elements.contains(&v.element) {
        let expected = format!("the crystal holds {}", elements.join(", "));
        return fault("vacancies.element", &v.element, expected);
    }
    within("vacancies.max_probability", v.max_probability, 0.0, 1.0)?;
    within("vacancies.rate", v.rate, 0.0, v.max_probability)?;
    within("vacancies.cluster_fraction", v.cluster_fraction, 0.0, 1.0)?;
    within("vacancies.cluster_sigma_nm", v.cluster_sigma_nm, 0.1, 1000.0)?;
    within("vacancies.relaxation_angstrom", v.relaxation_angstrom, 0.0, 0.3)
}

/// A table that must hold exactly the keys `needed`, each within limits.
fn check_elements(
    key: &str,
    table: &BTreeMap<String, f64>,
    needed: &[String],
    low: f64,
    high: f64,
) -> Checked {
    if let Some(missing) = needed.iter().find(|n| !table.contains_key(*n)) {
        return fault(key, "(incomplete)", format!("`{missing}` is missing"));
    }
    for (name, &value) in table {
        if !needed.contains(name) {
            let near = nearest(name, needed.iter().map(String::as_str));
            let hint = near.unwrap_or("no more entries").to_owned();
            return fault(&format!("{key}.{name}"), value, format!("unknown key; expected {hint}"));
        }
        within(&format!("{key}.{name}"), value, low, high)?;
    }
    Ok(())
}

fn within(key: &str, value: f64, low: f64, high: f64) -> Checked {
    match (low..=high).contains(&value) {
        true => Ok(()),
        false => fault(key, value, format!("expected a value from {low:.6} to {high:.6}")),
    }
}

fn fault<T>(
    key: &str,
    value: impl ToString,
    expected: impl Into<String>,
) -> std::result::Result<T, Fault> {
    Err(Fault { key: key.to_owned(), value: value.to_string(), expected: expected.into() })
}
