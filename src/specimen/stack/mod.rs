//! Specimens made of several crystals: their sites, interfaces, faults and dislocations.
//!
//! The layers are filled in undisturbed places, rows and pairs of vacancies are drawn there, then the dislocations displace all atoms, particles are laid on them, atoms that overlap are
//! left out, and at last sites become vacant or hold other elements. The sites are held in memory like the atoms of a file.

mod filling;
mod interfaces;
mod particles_on_layers;
mod point_defects;
mod truth_lines;
mod vacancy_groups;

use filling::{MadeSite, filled};
use interfaces::Interfaces;
use particles_on_layers::{LaidParticle, laid_particles};
use point_defects::PointDefects;
use vacancy_groups::{mark_double_vacancies, mark_lines};

use super::held_columns::PlacedSite;
use super::own_atoms::OwnAtoms;
use super::sites::{DISPLACED_NM, SpecimenSite};
use super::specimen_trait::{DislocationTruth, LayerTruth, SpecimenFacts, StackTruth};
use crate::error::{Error, Result};
use crate::lengths;
use crate::models::stack::edge_dislocation::EdgeDislocation;
use crate::recipe::limits::BEYOND_FIELD_NM;
use crate::recipe::stacked_crystals::{StackedCrystals, StackedMatter};
use crate::recipe::{CheckedRecipe, StackTable};
use crate::setting::Setting;
use crate::structure::lattice::Vec3;

/// Lays out the stack of a recipe.
///
/// # Errors
/// [`Error::Invalid`] for recipes without a stack, and for amorphous layers whose atoms find no room.
pub fn stack(recipe: &CheckedRecipe) -> Result<OwnAtoms> {
    let crystals = recipe.stack()?;
    let Some(table) = &recipe.stack else {
        return Err(Error::invalid(
            Setting::Recipe,
            "stack",
            "(missing): this structure needs the table",
        ));
    };
    let around = recipe.field.full_region().grown(BEYOND_FIELD_NM + 2.0 * DISPLACED_NM);
    let extent =
        lengths::angstrom_by_division([around.x, around.y, [0.0, recipe.field.thickness_nm]]);
    let interfaces = Interfaces::new(recipe, table, crystals);
    let reach: f64 = crystals.dislocations.iter().map(|d| d.burgers[0].hypot(d.burgers[1])).sum();
    let mut wide = extent;
    wide[..2].iter_mut().for_each(|ends| *ends = [ends[0] - reach, ends[1] + reach]);
    let mut sites = filled(recipe, table, crystals, &interfaces, wide)?;
    let rows = mark_lines(recipe, table, crystals, &mut sites)?;
    mark_double_vacancies(recipe, table, &mut sites)?;
    displace(&mut sites, &crystals.dislocations);
    sites.retain(|site| {
        (0..2).all(|k| extent[k][0] <= site.position[k] && site.position[k] < extent[k][1])
    });
    let particles = laid_particles(recipe, table, crystals, &sites)?;
    sites.extend(particles.iter().flat_map(LaidParticle::sites));
    let atoms: Vec<(Vec3, u8)> = sites.iter().map(|s| (s.position, s.number)).collect();
    let kept = crystals.least.kept(&atoms);
    let placed: Vec<PlacedSite> = sites
        .into_iter()
        .zip(kept)
        .filter(|(_, kept)| *kept)
        .map(|(site, _)| {
            let position_nm = lengths::nm(site.position);
            (SpecimenSite { key: 0, position_nm, number: site.number, kind: site.kind }, site.phase)
        })
        .collect();
    let mut boundaries = truth_lines::boundaries(table, crystals, &interfaces, extent);
    boundaries.extend(rows.iter().map(|row| truth_lines::row(row, crystals)));
    let held = particles.iter().map(LaidParticle::held).collect();
    let defects = PointDefects::fit(recipe, crystals, &interfaces, &placed)?;
    let facts = facts(recipe, table, crystals);
    let own = OwnAtoms::of_sites(placed, recipe, facts, boundaries, |site| defects.of(site))?;
    Ok(own.with_particles(held))
}

fn displace(sites: &mut [MadeSite], dislocations: &[EdgeDislocation]) {
    use rayon::prelude::*;
    if dislocations.is_empty() {
        return;
    }
    sites.par_iter_mut().for_each(|site| {
        let [x, y, z] = site.position;
        let [x, y] = displaced(dislocations, [x, y]);
        site.position = [x, y, z];
    });
}

/// Returns where the dislocations move an undisturbed place, in Angstrom.
fn displaced(dislocations: &[EdgeDislocation], at: [f64; 2]) -> [f64; 2] {
    dislocations.iter().fold(at, |moved, dislocation| {
        let [u, v] = dislocation.displacement(at);
        [moved[0] + u, moved[1] + v]
    })
}

fn facts(recipe: &CheckedRecipe, table: &StackTable, crystals: &StackedCrystals) -> SpecimenFacts {
    let names = crystals.phases.clone();
    let layer = |(n, layer): (usize, &crate::recipe::stacked_crystals::StackedLayer)| LayerTruth {
        turn_deg: table.layers[n].turn_deg.unwrap_or(0.0),
        phase: layer.phase,
        begin_nm: lengths::nm(layer.begin),
        end_nm: lengths::nm(crystals.layers.get(n + 1).map_or(crystals.end, |next| next.begin)),
        strain: match &layer.matter {
            StackedMatter::Crystal(crystal) => crystal.strain,
            StackedMatter::Amorphous(_) => [0.0; 3],
        },
    };
    let dislocation = |d: &EdgeDislocation| DislocationTruth {
        position_nm: lengths::nm(d.position),
        burgers_nm: lengths::nm([d.burgers[0], d.burgers[1], 0.0]),
    };
    let truth = StackTruth {
        axis: table.along.axis(),
        phases: names.clone(),
        layers: crystals.layers.iter().enumerate().map(layer).collect(),
        dislocations: crystals.dislocations.iter().map(dislocation).collect(),
    };
    SpecimenFacts {
        thickness_nm: recipe.field.thickness_nm,
        phases: if names.len() > 1 { names } else { Vec::new() },
        stack: Some(truth),
        ..SpecimenFacts::default()
    }
}
