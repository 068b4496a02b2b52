//! Limits of the values in a recipe.

use std::collections::BTreeMap;

use super::checking_atoms::check_atoms;
use super::checking_defects::check_defects;
use super::checking_particles::check_particles;
use super::checking_stack::check_stack;
use super::detector_tables::check_detectors;
use super::fault::{Checked, check_guest, crystal_fault, fault, needed, one_of, within};
use super::limits::{BEYOND_FIELD_NM, MOST_CELLS_ACROSS, MOST_CELLS_ALONG_BEAM};
use super::optics_table::check_optics;
use super::oriented_crystals::{OrientedCrystals, oriented};
use super::resolved_recipe::Recipe;
use super::tables::{
    Alloy, Boundaries, CompositionProfile, DomainTable, Field, StructureKind, Wells,
};
use crate::structure::coincidence;
use crate::structure::columns::ColumnCrystal;
use crate::structure::{PAIR_CUTOFF_ANGSTROM, Structure, elements, shortest_distances};

/// Checks every value against its limits; returns the crystals, which are read for it.
pub fn check(recipe: &Recipe) -> Checked<OrientedCrystals> {
    if recipe.version != 1 {
        return fault("version", recipe.version, "this program reads recipes of version 1");
    }
    check_seed("seed", recipe.seed)?;
    check_seed("phonons.library_seed", recipe.phonons.library_seed)?;
    check_names(recipe)?;
    check_field(&recipe.field)?;
    check_tables(recipe)?;
    let (crystals, elements) = check_specimen(recipe)?;
    let phonons = &recipe.phonons;
    within("phonons.configurations", phonons.configurations as f64, 1.0, 10_000.0)?;
    check_elements("phonons.sigma_angstrom", &phonons.sigma_angstrom, &elements, 0.0, 0.5)?;
    check_optics(&recipe.optics)?;
    check_detectors(&recipe.detector)?;
    within("dose.electrons_per_angstrom2", recipe.dose.electrons_per_angstrom2, 1e-3, 1e12)?;
    if let Some(table) = recipe.acquisition {
        table.resolved().check().map_err(|fault| fault.in_table("acquisition"))?;
    }
    if let Some(table) = recipe.surface {
        table.check().map_err(|fault| fault.in_table("surface"))?;
    }
    check_damage(recipe, &elements)?;
    Ok(crystals)
}

/// Checks a seed, which must fit into a number of TOML.
pub fn check_seed(key: &str, seed: u64) -> Checked {
    let expected = || format!("expected at most {}, the largest integer of TOML", i64::MAX);
    if i64::try_from(seed).is_err() { fault(key, seed, expected()) } else { Ok(()) }
}

/// Checks that the elements that the beam displaces are in the specimen.
fn check_damage(recipe: &Recipe, elements: &[String]) -> Checked {
    let Some(damage) = &recipe.damage else { return Ok(()) };
    for (name, symbol) in damage.elements() {
        one_of(&format!("damage.{name}"), symbol, elements)?;
    }
    damage.check().map_err(|fault| fault.in_table("damage"))
}

/// Greatest length of an id and of a source.
const LONGEST_NAME: usize = 64;

/// Checks the names: the id becomes part of paths, the source an attribute of files.
fn check_names(recipe: &Recipe) -> Checked {
    let plain = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    let id = &recipe.id;
    if id.is_empty() || id.len() > LONGEST_NAME || !id.chars().all(plain) {
        let expected = format!("expected 1 to {LONGEST_NAME} letters, digits, `-` and `_`");
        return fault("id", format!("{id:?}"), expected);
    }
    match &recipe.source {
        Some(s) if s.is_empty() || s.len() > LONGEST_NAME || s.chars().any(char::is_control) => {
            let expected = format!("expected 1 to {LONGEST_NAME} characters without line breaks");
            fault("source", format!("{s:?}"), expected)
        }
        _ => Ok(()),
    }
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

/// Refuses tables that the specimen builder does not read: they would have no effect, without notice.
fn check_tables(recipe: &Recipe) -> Checked {
    use StructureKind::{Atoms, Domains, Epitaxy, Grains, Particles, Stack};
    let tables = [
        ("boundaries", recipe.boundaries.is_some(), &[Grains][..]),
        ("domains", recipe.domains.is_some(), &[Domains]),
        ("alloy", recipe.alloy.is_some(), &[Epitaxy]),
        ("wells", recipe.wells.is_some(), &[Epitaxy]),
        ("particles", recipe.particles.is_some(), &[Particles]),
        ("atoms", recipe.atoms.is_some(), &[Atoms]),
        ("stack", recipe.stack.is_some(), &[Stack]),
        ("vacancies", recipe.vacancies.is_some(), &[Grains, Domains, Epitaxy, Particles, Stack]),
        (
            "substitutions",
            recipe.substitutions.is_some(),
            &[Grains, Domains, Epitaxy, Particles, Stack],
        ),
        ("defects", !recipe.defects.is_empty(), &[Grains, Stack]),
    ];
    for (name, given, kinds) in tables {
        if given && !kinds.contains(&recipe.structure) {
            let kinds: Vec<String> = kinds.iter().map(|k| format!("\"{}\"", k.name())).collect();
            let expected = format!(
                "expected structure = {} for this table, not \"{}\"",
                kinds.join(" or "),
                recipe.structure.name()
            );
            return fault(name, "[table]", expected);
        }
    }
    Ok(())
}

/// Checks the tables of the kind of specimen; returns its crystals, and all elements that it may hold.
fn check_specimen(recipe: &Recipe) -> Checked<(OrientedCrystals, Vec<String>)> {
    if recipe.structure == StructureKind::Particles {
        return check_particles(recipe);
    }
    if recipe.structure == StructureKind::Atoms {
        return check_atoms(recipe);
    }
    if recipe.structure == StructureKind::Stack {
        return check_stack(recipe);
    }
    let (structure, columns) = check_crystal(recipe)?;
    let mut elements: Vec<u8> = columns.chains().map(|c| c.number).collect();
    elements.sort_unstable();
    elements.dedup();
    let mut symbols: Vec<String> = elements.iter().map(|&n| elements::symbol(n).into()).collect();
    let second = match recipe.structure {
        StructureKind::Domains => Some(second_phase(recipe)?),
        StructureKind::Epitaxy => Some(end_member(recipe, &symbols)?),
        StructureKind::Grains
        | StructureKind::Particles
        | StructureKind::Atoms
        | StructureKind::Stack => None,
    };
    if let Some(boundaries) = &recipe.boundaries {
        check_boundaries(boundaries, &recipe.field, &structure, &columns)?;
    }
    check_defects(recipe, &mut symbols)?;
    symbols.extend(recipe.alloy.iter().map(|alloy| alloy.guest.clone()));
    symbols.sort();
    symbols.dedup();
    Ok((OrientedCrystals::Columns { structure, columns, second }, symbols))
}

/// Reads and checks the crystal of the second phase of domains.
fn second_phase(recipe: &Recipe) -> Checked<Structure> {
    let domains = needed("domains", recipe.domains.as_ref())?;
    check_domains(domains, &recipe.field)?;
    oriented(&domains.crystal, &domains.zone_axis, domains.y_axis.as_deref())
        .map_err(|e| crystal_fault("domains.crystal", e))
}

/// Reads and checks the end member of an alloy.
fn end_member(recipe: &Recipe, symbols: &[String]) -> Checked<Structure> {
    let alloy = needed("alloy", recipe.alloy.as_ref())?;
    check_alloy(alloy, symbols)?;
    let end = oriented(&alloy.end_member, &recipe.zone_axis, recipe.y_axis.as_deref())
        .map_err(|e| crystal_fault("alloy.end_member", e))?;
    check_wells(alloy, recipe.wells.as_ref(), &recipe.field)?;
    Ok(end)
}

/// Reads the crystal along its zone axis, and checks that it fits into the field.
fn check_crystal(recipe: &Recipe) -> Checked<(Structure, ColumnCrystal)> {
    let structure = oriented(&recipe.crystal, &recipe.zone_axis, recipe.y_axis.as_deref())
        .map_err(|e| crystal_fault("crystal", e))?;
    let crystal = ColumnCrystal::new(&structure).map_err(|e| crystal_fault("crystal", e))?;
    let cells = recipe.field.thickness_angstrom() / crystal.cell[2];
    if !(0.5..MOST_CELLS_ALONG_BEAM as f64).contains(&cells) {
        let expected = format!(
            "expected between one and {MOST_CELLS_ALONG_BEAM} unit cells, {:.4} to {:.0} nm",
            0.05 * crystal.cell[2],
            0.1 * MOST_CELLS_ALONG_BEAM as f64 * crystal.cell[2]
        );
        return fault("field.thickness_nm", recipe.field.thickness_nm, expected);
    }
    // Cells are counted from a point of the field, and a rotated grain needs more of them.
    let diagonal = 10.0 * 1.5 * (recipe.field.fov_nm[0].max(recipe.field.fov_nm[1]) + 50.0);
    if diagonal / crystal.cell[0].min(crystal.cell[1]) > MOST_CELLS_ACROSS as f64 {
        let most =
            MOST_CELLS_ACROSS as f64 * 0.1 * crystal.cell[0].min(crystal.cell[1]) / 1.5 - 50.0;
        let expected = format!(
            "expected a field of at most {most:.0} nm: it may be {MOST_CELLS_ACROSS} cells of this crystal wide"
        );
        return fault("field.fov_nm", format!("{:?}", recipe.field.fov_nm), expected);
    }
    Ok((structure, crystal))
}

fn check_boundaries(
    b: &Boundaries,
    field: &Field,
    structure: &Structure,
    crystal: &ColumnCrystal,
) -> Checked {
    within("boundaries.misorientation_deg", b.misorientation_deg, 0.1, 90.0)?;
    check_count("boundaries.count", b.count, field, 2.0)?;
    if let Some(sigma) = b.sigma {
        let found = coincidence::half_angle_in(crystal.cell, sigma, b.misorientation_deg);
        if let Err(expected) = found {
            return fault("boundaries.sigma", sigma, expected);
        }
    }
    if b.count > 0 && !crystal.has_mirror_x() {
        let expected = "symmetric tilt boundaries need a crystal with a mirror plane perpendicular \
                        to x; choose another y_axis, or count = 0";
        return fault("boundaries.count", b.count, expected);
    }
    let shortest = shortest_distances(structure, PAIR_CUTOFF_ANGSTROM);
    let name = |&(a, b): &(u8, u8)| [elements::symbol(a), elements::symbol(b)];
    for (pair, &value) in &b.min_distance_angstrom {
        let key = format!("boundaries.min_distance_angstrom.{pair}");
        let fits = |names: &[&str; 2]| {
            pair.split_once('-').is_some_and(|(a, b)| [a, b] == *names || [b, a] == *names)
        };
        let Some((_, &most)) = shortest.iter().find(|(p, _)| fits(&name(p))) else {
            let known: Vec<String> = shortest.keys().map(|p| name(p).join("-")).collect();
            return fault(&key, value, format!("pairs of the crystal: {}", known.join(", ")));
        };
        within(&key, value, 0.0, most)?;
    }
    Ok(())
}

/// Checks that boundaries leave parts of the field that are at least `room_nm` wide.
fn check_count(key: &str, count: usize, field: &Field, room_nm: f64) -> Checked {
    if count > 200 || (count + 1) as f64 * room_nm > field.fov_nm[1] {
        let most = ((field.fov_nm[1] / room_nm) as usize).clamp(1, 201) - 1;
        let expected = format!(
            "expected at most {most}: the parts between boundaries need {room_nm} nm of the width each"
        );
        return fault(key, count, expected);
    }
    Ok(())
}

fn check_domains(d: &DomainTable, field: &Field) -> Checked {
    check_count("domains.boundaries", d.boundaries, field, 2.0)?;
    let part_px = field.pixels(field.grid)[1] as f64 / (d.boundaries + 1) as f64;
    within("domains.sharpness_sigma_px", d.sharpness_sigma_px, 0.1, part_px / 4.0)?;
    let most = 0.5 / (d.boundaries + 1) as f64;
    if !(0.0..most).contains(&d.waviness) {
        let expected =
            format!("expected 0 to {most:.4}, so that neighbouring boundaries never cross");
        return fault("domains.waviness", d.waviness, expected);
    }
    match d.phases.iter().find(|p| p.is_empty() || !p.is_ascii()) {
        Some(name) => fault("domains.phases", name, "expected two names in ASCII"),
        None => Ok(()),
    }
}

fn check_alloy(alloy: &Alloy, crystal: &[String]) -> Checked {
    one_of("alloy.host", &alloy.host, crystal)?;
    check_guest("alloy.guest", &alloy.guest, &alloy.host)?;
    // A linear gradient ends at twice the mean.
    let most = if alloy.profile == CompositionProfile::Linear { 0.5 } else { 1.0 };
    within("alloy.rate", alloy.rate, 0.0, most)?;
    if alloy.c13_gpa.is_some() != alloy.c33_gpa.is_some() {
        return fault(
            "alloy.c13_gpa",
            "(alone)",
            "expected c13_gpa and c33_gpa together, or neither",
        );
    }
    for (c13, c33) in alloy.c13_gpa.into_iter().flatten().zip(alloy.c33_gpa.into_iter().flatten()) {
        within("alloy.c33_gpa", c33, 1.0, 2000.0)?;
        within("alloy.c13_gpa", c13, 0.0, c33)?;
    }
    Ok(())
}

/// Largest number of points of all rough interfaces together.
const MOST_INTERFACE_POINTS: f64 = 2e7;

fn check_wells(alloy: &Alloy, wells: Option<&Wells>, field: &Field) -> Checked {
    if alloy.profile != CompositionProfile::Wells {
        return match wells {
            Some(_) => fault("wells", "[table]", "this table needs alloy.profile = \"wells\""),
            None => Ok(()),
        };
    }
    let wells = needed("wells", wells)?;
    within("wells.count", wells.count as f64, 1.0, 1000.0)?;
    let part = field.fov_nm[1] / wells.count as f64;
    if !(0.25..part).contains(&wells.width_nm) {
        let expected = format!(
            "expected 0.25 to below {part:.4}: {} wells share the field's {} nm",
            wells.count, field.fov_nm[1]
        );
        return fault("wells.width_nm", wells.width_nm, expected);
    }
    // Both sides of a well or barrier may meet only at 2.8 standard deviations of their distance.
    let most = wells.width_nm.min(part - wells.width_nm) / 4.0;
    within("wells.roughness_nm", wells.roughness_nm, 0.0, most)?;
    // Interfaces are tabulated six times per correlation length.
    let area = (field.fov_nm[0] + 2.0 * BEYOND_FIELD_NM) * field.thickness_nm;
    let points = 2.0 * wells.count as f64 * 36.0 * area;
    let least = (points / MOST_INTERFACE_POINTS).sqrt().max(0.5);
    let key = "wells.roughness_correlation_nm";
    within(key, wells.roughness_correlation_nm, least, least.max(1000.0))
}

/// Checks that a table holds exactly the keys `needed`, each within limits.
fn check_elements(
    key: &str,
    table: &BTreeMap<String, f64>,
    needed: &[String],
    low: f64,
    high: f64,
) -> Checked {
    if let Some(missing) = needed.iter().find(|n| !table.contains_key(*n)) {
        return fault(
            key,
            "(incomplete)",
            format!(
                "expected a value for each element of the specimen ({}); `{missing}` is missing",
                needed.join(", ")
            ),
        );
    }
    for (name, &value) in table {
        if !needed.contains(name) {
            let expected = format!("expected only elements of the specimen: {}", needed.join(", "));
            return fault(&format!("{key}.{name}"), value, expected);
        }
        within(&format!("{key}.{name}"), value, low, high)?;
    }
    Ok(())
}
