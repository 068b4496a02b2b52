//! Limits of a recipe for particles on carbon.

use super::checking_defects::check_defects;
use super::fault::{Checked, Fault, crystal_fault, fault, needed, within};
use super::oriented_crystals::OrientedCrystals;
use super::resolved_recipe::Recipe;
use super::tables::Particles;
use crate::lengths;
use crate::models::carbon::block;
use crate::models::particles::Metal;
use crate::structure::elements;

/// Largest covered share of the field for which random placing of circles ends in reasonable time; it cannot exceed 0.547.
const MOST_COVERED: f64 = 0.4;
/// Diameter of the circle around a particle divided by the particle's diameter. Particles of few atoms are longer, and may find no place.
const CIRCLE: f64 = 1.35;

/// Checks the table of particles; returns their metal, and all elements that the specimen may hold.
pub fn check_particles(recipe: &Recipe) -> Checked<(OrientedCrystals, Vec<String>)> {
    if recipe.zone_axis != "none" || recipe.y_axis.is_some() {
        let expected = "each particle has a different orientation; expected zone_axis = \"none\" and no y_axis";
        return fault("zone_axis", &recipe.zone_axis, expected);
    }
    let particles = needed("particles", recipe.particles.as_ref())?;
    let structure = recipe.crystal.structure().map_err(|e| crystal_fault("crystal", e))?;
    let (number, metal) = Metal::of(&structure, particles.surface_energy_ratio)
        .map_err(|e| other_crystal(crystal_fault("crystal", e)))?;
    check_film(recipe.field.thickness_nm)?;
    check_sizes(particles, recipe)?;
    let mut symbols = vec![elements::symbol(number).to_owned()];
    check_defects(recipe, &mut symbols)?;
    let relaxation = recipe.vacancies.as_ref().map_or(0.0, |v| v.relaxation_angstrom);
    if relaxation != 0.0 {
        let expected = "expected 0: a vacancy moves only neighbours of another element, and the metal has one element";
        return fault("vacancies.relaxation_angstrom", relaxation, expected);
    }
    symbols.push("C".to_owned());
    symbols.sort();
    symbols.dedup();
    Ok((OrientedCrystals::Particles { number, metal }, symbols))
}

/// Adds where particles of other crystals are made.
fn other_crystal(mut fault: Fault) -> Fault {
    fault
        .expected
        .push_str("; structure = \"stack\" makes particles of any crystal ([[stack.particles]])");
    fault
}

fn check_film(thickness_nm: f64) -> Checked {
    let most = lengths::nm(block::EDGE_ANGSTROM);
    match (1.0..=most).contains(&thickness_nm) {
        true => Ok(()),
        false => {
            let expected = format!("a film of carbon can have 1 to {most} nm");
            fault("field.thickness_nm", thickness_nm, expected)
        }
    }
}

fn check_sizes(p: &Particles, recipe: &Recipe) -> Checked {
    let [low, high] = p.diameter_nm;
    if low > high {
        let expected = "expected the least diameter first, then the greatest";
        return fault("particles.diameter_nm", format!("[{low}, {high}]"), expected);
    }
    within("particles.diameter_nm", low, 0.8, 10.0)?;
    within("particles.diameter_nm", high, 0.8, 10.0)?;
    if p.morphologies.is_empty() {
        let expected = "expected some of \"wulff\", \"icosahedral\", \"decahedral\"";
        return fault("particles.morphologies", "[]", expected);
    }
    within("particles.max_tilt_deg", p.max_tilt_deg, 0.0, 180.0)?;
    within("particles.gap_nm", p.gap_nm, 0.3, 100.0)?;
    within("particles.surface_energy_ratio", p.surface_energy_ratio, 0.9, 1.7)?;
    within("particles.contact_angstrom", p.contact_angstrom, 1.5, 4.0)?;
    let circle = CIRCLE * high;
    let room = recipe.field.fov_nm.map(|v| v - circle);
    let each = std::f64::consts::FRAC_PI_4 * (circle + p.gap_nm) * (circle + p.gap_nm);
    let area = recipe.field.fov_nm[0] * recipe.field.fov_nm[1];
    let most =
        (MOST_COVERED * area / each).max(if room.iter().all(|r| *r > 0.0) { 1.0 } else { 0.0 });
    if p.count as f64 > most {
        let expected = format!(
            "{} x {} nm have room for at most {} particles of up to {high} nm (particles.diameter_nm), {} nm \
             apart (particles.gap_nm)",
            recipe.field.fov_nm[0], recipe.field.fov_nm[1], most as usize, p.gap_nm
        );
        return fault("particles.count", p.count, expected);
    }
    Ok(())
}
