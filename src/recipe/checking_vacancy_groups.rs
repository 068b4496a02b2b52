//! Limits of the edges of layers, rows of vacancies and double vacancies, and their places.

use super::checking_extended::{
    SAME_ANGSTROM, TILTED, between_planes, check_place, crystal_of, item_key,
};
use super::fault::{Checked, fault, one_of, within};
use super::stack_table::StackTable;
use super::stacked_crystals::{
    CheckedLines, FittedCrystal, LayerEdge, StackedLayer, StackedMatter,
};
use super::tables::Field;
use super::vacancy_groups_table::{StackEdge, VacancyLines};
use crate::lengths;
use crate::structure::lattice::{Vec3, dot, norm, row_times};
use crate::structure::{direction, elements};

/// Square nm in a square micrometre.
const NM2_PER_UM2: f64 = 1e6;
/// Largest number of rows of a table.
const MOST_ROWS: usize = 10_000;
/// Greatest length of a row in nm.
const LONGEST_NM: f64 = 1000.0;
/// Largest share of the sites of an element that are parts of double vacancies.
const MOST_DOUBLE: f64 = 0.4;

/// Checks the edges, and gives them to their layers.
pub fn check_edges(table: &StackTable, layers: &mut [StackedLayer], field: &Field) -> Checked {
    for (n, given) in table.edges.iter().enumerate() {
        check_place(&item_key("edges", n, "position_nm"), given.position_nm, field)?;
        let crystal = matter_of(n, given, layers)?;
        let edge = edge(n, given, crystal, &layers[given.layer - 1])?;
        layers[given.layer - 1].edges.push(edge);
    }
    Ok(())
}

/// Returns the crystal of the layer of an edge; `None` for an amorphous layer, which ends along an angle only.
fn matter_of<'l>(
    n: usize,
    given: &StackEdge,
    layers: &'l [StackedLayer],
) -> Checked<Option<&'l FittedCrystal>> {
    let layer = given.layer.checked_sub(1).and_then(|layer| layers.get(layer));
    match layer.map(|layer| &layer.matter) {
        Some(StackedMatter::Amorphous(_)) if given.plane.is_none() => Ok(None),
        _ => crystal_of(&item_key("edges", n, "layer"), given.layer, layers).map(Some),
    }
}

fn edge(
    n: usize,
    given: &StackEdge,
    crystal: Option<&FittedCrystal>,
    layer: &StackedLayer,
) -> Checked<LayerEdge> {
    let key = |name: &str| item_key("edges", n, name);
    let [x, y] = lengths::angstrom(given.position_nm);
    let (text, crystal) = match (&given.plane, given.angle_deg, crystal) {
        (Some(text), None, Some(crystal)) => (text, crystal),
        (None, Some(angle), _) => {
            within(&key("angle_deg"), angle, -360.0, 360.0)?;
            let (sin, cos) = libm::sincos(angle.to_radians());
            return Ok(LayerEdge { normal: [cos, sin, 0.0], distance: x * cos + y * sin });
        }
        _ => {
            let expected = "expected either a plane, such as \"(010)\" (zigzag) or \"(2-10)\" (armchair) of a hexagonal layer, or angle_deg, the \
                            direction into the vacuum";
            return fault(&key("plane"), "(missing, or both)", expected);
        }
    };
    let miller = match direction::parse_plane(text) {
        Ok(miller) => miller,
        Err(expected) => return fault(&key("plane"), text, expected),
    };
    let normal = crystal.normal(miller);
    if normal[2].abs() > TILTED {
        let expected = format!(
            "the plane encloses {:.1} degrees with the beam; expected a plane that holds the zone axis, such as \"(010)\" (zigzag) or \
             \"(2-10)\" (armchair) of a hexagonal layer along [001]",
            normal[2].abs().min(1.0).asin().to_degrees()
        );
        return fault(&key("plane"), text, expected);
    }
    let own = layer.turn.undo([x, y, 0.0]);
    let across = normal[0].hypot(normal[1]);
    let flat = [normal[0] / across, normal[1] / across];
    let [x, y] = between_planes(crystal, [own[0], own[1]], flat);
    let normal = turned([flat[0], flat[1], 0.0], layer);
    Ok(LayerEdge { normal, distance: dot(layer.turn.apply([x, y, 0.0]), normal) })
}

/// Turns a direction with its layer.
fn turned(by: Vec3, layer: &StackedLayer) -> Vec3 {
    let [from, to] = [[0.0; 3], by].map(|at| layer.turn.apply(at));
    std::array::from_fn(|k| to[k] - from[k])
}

/// Checks the rows of vacancies; returns their steps, columns and numbers.
pub fn check_lines(
    table: &StackTable,
    layers: &[StackedLayer],
    field: &Field,
) -> Checked<Vec<CheckedLines>> {
    let one = |(n, given): (usize, &VacancyLines)| lines(n, given, layers, field);
    table.vacancy_lines.iter().enumerate().map(one).collect()
}

fn lines(
    n: usize,
    given: &VacancyLines,
    layers: &[StackedLayer],
    field: &Field,
) -> Checked<CheckedLines> {
    let key = |name: &str| item_key("vacancy_lines", n, name);
    let crystal = crystal_of(&key("layer"), given.layer, layers)?;
    let layer = &layers[given.layer - 1];
    one_of(&key("element"), &given.element, &symbols(crystal))?;
    within(&key("length_nm"), given.length_nm, 0.1, LONGEST_NM)?;
    if !layer.faults.is_empty() {
        let expected = "this layer has planar faults, beyond which its lattice is another; expected a layer without faults";
        return fault(&key("layer"), given.layer, expected);
    }
    let step = step(&key("direction"), &given.direction, crystal)?;
    let columns = (lengths::angstrom(given.length_nm) / norm(step)).round().max(2.0) as usize;
    let [x, y, _] = turned(step, layer);
    let element = elements::atomic_number(&given.element).unwrap_or(0);
    let count = rows(n, given, field)?;
    Ok(CheckedLines { layer: given.layer - 1, element, step: [x, y], columns, count })
}

fn symbols(crystal: &FittedCrystal) -> Vec<String> {
    let mut found: Vec<String> = crystal
        .structure
        .atoms
        .iter()
        .map(|atom| elements::symbol(atom.number).to_owned())
        .collect();
    found.sort();
    found.dedup();
    found
}

/// Returns the shortest vector along a direction after which the crystal repeats, in Angstrom.
fn step(key: &str, text: &str, crystal: &FittedCrystal) -> Checked<Vec3> {
    let whole: Vec3 = match direction::parse(text) {
        Ok(indices) => row_times(indices.map(f64::from), &crystal.cell),
        Err(expected) => return fault(key, text, expected),
    };
    if whole[2].abs() > TILTED * norm(whole) {
        let expected = format!(
            "it encloses {:.1} degrees with the plane of the image; expected a direction perpendicular to the beam, such as \"[100]\" (zigzag) or \
             \"[120]\" (armchair) of a hexagonal layer along [001]",
            (whole[2].abs() / norm(whole)).min(1.0).asin().to_degrees()
        );
        return fault(key, text, expected);
    }
    let part = |parts: i32| whole.map(|v| v / f64::from(parts));
    let shortest = [6, 4, 3, 2].into_iter().map(part).find(|v| crystal.repeats(*v, SAME_ANGSTROM));
    Ok(shortest.unwrap_or(whole))
}

/// Returns the number of rows.
fn rows(n: usize, given: &VacancyLines, field: &Field) -> Checked<usize> {
    let key = |name: &str| item_key("vacancy_lines", n, name);
    given.positions_nm.iter().try_for_each(|at| check_place(&key("positions_nm"), *at, field))?;
    let density = match given.per_um2 {
        Some(density) if given.positions_nm.is_empty() => density,
        None if !given.positions_nm.is_empty() => return Ok(given.positions_nm.len()),
        _ => {
            let expected = "expected either per_um2, their number per square micrometre, or positions_nm, their places";
            return fault(&key("per_um2"), "(missing, or both)", expected);
        }
    };
    within(&key("per_um2"), density, 0.0, 1e7)?;
    let region = field.full_region();
    let area_nm2 = (region.x[1] - region.x[0]) * (region.y[1] - region.y[0]);
    let count = (density * area_nm2 / NM2_PER_UM2).round();
    if !(1.0..=MOST_ROWS as f64).contains(&count) {
        let expected = format!(
            "it makes {count} lines in the field of {area_nm2:.0} nm2; expected 1 to {MOST_ROWS} lines, or their places as positions_nm"
        );
        return fault(&key("per_um2"), density, expected);
    }
    Ok(count as usize)
}

/// Checks elements and rates of double vacancies.
pub fn check_double_vacancies(table: &StackTable, layers: &[StackedLayer]) -> Checked {
    for (n, given) in table.double_vacancies.iter().enumerate() {
        let key = |name: &str| item_key("double_vacancies", n, name);
        let crystal = crystal_of(&key("layer"), given.layer, layers)?;
        one_of(&key("element"), &given.element, &symbols(crystal))?;
        within(&key("rate"), given.rate, 0.0, MOST_DOUBLE)?;
    }
    Ok(())
}
