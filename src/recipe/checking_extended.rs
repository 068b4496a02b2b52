//! Limits of the faults, dislocations and precipitates of a stack, and their places.

use super::checking_stack::{check_whole, extent};
use super::fault::{Checked, crystal_fault, fault, within};
use super::oriented_crystals::oriented_box;
use super::stack_table::{
    DEFAULT_POISSON_RATIO, FaultKind, Precipitate, StackDislocation, StackFault, StackTable,
};
use super::stacked_crystals::{FittedCrystal, PlacedPrecipitate, StackedLayer, StackedMatter};
use super::tables::Field;
use crate::models::stack::edge_dislocation::EdgeDislocation;
use crate::models::stack::fault_planes::{FaultAction, FaultPlane, placed};
use crate::structure::direction;
use crate::structure::lattice::{Vec3, dot, norm, row_times};

/// Angstrom in a nm.
const PER_NM: f64 = 10.0;
/// Largest distance of defects from the field in nm.
const FARTHEST_NM: f64 = 10.0;
/// Largest component of a unit normal or Burgers vector where it should be 0.
pub const TILTED: f64 = 2e-3;
/// Largest distance, in Angstrom, of an atom from its place after a shift that leaves the crystal as it was.
pub const SAME_ANGSTROM: f64 = 0.1;
/// Largest distance, divided by the length of the Burgers vector, of the atoms of other layers from their places after a shift by it.
const NEAR_REPEAT: f64 = 0.12;

/// Returns the key of a value of a fault, dislocation or precipitate, which count from 1.
pub fn item_key(list: &str, index: usize, name: &str) -> String {
    format!("stack.{list}[{}].{name}", index + 1)
}

/// Returns the crystal of a layer that a defect names.
pub fn crystal_of<'l>(
    key: &str,
    layer: usize,
    layers: &'l [StackedLayer],
) -> Checked<&'l FittedCrystal> {
    let found = layer.checked_sub(1).and_then(|n| layers.get(n));
    match found.map(|layer| &layer.matter) {
        Some(StackedMatter::Crystal(crystal)) => Ok(crystal),
        Some(StackedMatter::Amorphous(_)) => fault(
            key,
            layer,
            "this layer is amorphous; expected the number of a layer with a crystal",
        ),
        None => {
            fault(key, layer, format!("expected the number of a layer, from 1 to {}", layers.len()))
        }
    }
}

pub fn check_place(key: &str, at: [f64; 2], field: &Field) -> Checked {
    let region = field.full_region().grown(FARTHEST_NM);
    within(key, at[0], region.x[0], region.x[1])?;
    within(key, at[1], region.y[0], region.y[1])
}

/// Checks the faults, and gives them to their layers.
pub fn check_faults(table: &StackTable, layers: &mut [StackedLayer], field: &Field) -> Checked {
    let mut of_layer: Vec<Vec<(usize, FaultPlane)>> = vec![Vec::new(); layers.len()];
    for (n, given) in table.faults.iter().enumerate() {
        check_place(&item_key("faults", n, "position_nm"), given.position_nm, field)?;
        let crystal = crystal_of(&item_key("faults", n, "layer"), given.layer, layers)?;
        let plane = fault_plane(n, given, crystal)?;
        let others = &mut of_layer[given.layer - 1];
        if let Some((first, other)) = others.first()
            && (dot(other.normal, plane.normal) - 1.0).abs() > 1e-6
        {
            let expected = format!(
                "it is not parallel to fault {} of this layer; expected one plane for all faults of a layer, with its normal to one side",
                first + 1
            );
            return fault(&item_key("faults", n, "plane"), &given.plane, expected);
        }
        others.push((n, plane));
    }
    for (number, mut found) in of_layer.into_iter().enumerate().filter(|(_, f)| !f.is_empty()) {
        found.sort_by(|a, b| a.1.distance.total_cmp(&b.1.distance));
        let StackedMatter::Crystal(crystal) = &layers[number].matter else { continue };
        let planes: Vec<FaultPlane> = found.iter().map(|(_, plane)| *plane).collect();
        let near = middle(table, layers, number, field);
        let at_planes = placed(&crystal.structure, crystal.origin, near, &planes);
        let least = LEAST_APART_ANGSTROM;
        if let Some(k) = at_planes.windows(2).position(|w| w[1].distance - w[0].distance < least) {
            let expected = format!(
                "it lies nearer than {least} A to another fault of the layer; expected more distance"
            );
            return fault(
                &item_key("faults", found[k + 1].0, "position_nm"),
                "(too near)",
                expected,
            );
        }
        layers[number].faults = at_planes;
        layers[number].fault_kinds = found.iter().map(|(n, _)| table.faults[*n].kind).collect();
    }
    Ok(())
}

/// Least distance of neighbouring faults of a layer in Angstrom.
const LEAST_APART_ANGSTROM: f64 = 1.0;

/// Returns the middle of a layer in the field, in Angstrom.
fn middle(table: &StackTable, layers: &[StackedLayer], number: usize, field: &Field) -> Vec3 {
    let region = field.full_region();
    let axis = table.along.axis();
    let ends = [region.x, region.y, [0.0, field.thickness_nm]];
    let mut at = ends.map(|[low, high]| 0.5 * PER_NM * (low + high));
    let stop = layers.get(number + 1).map_or(extent(table, field)[1], |next| next.begin);
    at[axis] = 0.5 * (layers[number].begin + stop);
    at
}

fn fault_plane(n: usize, given: &StackFault, crystal: &FittedCrystal) -> Checked<FaultPlane> {
    let key = |name: &str| item_key("faults", n, name);
    let miller = match direction::parse_plane(&given.plane) {
        Ok(miller) => miller,
        Err(expected) => return fault(&key("plane"), &given.plane, expected),
    };
    let normal = crystal.normal(miller);
    if normal[2].abs() > TILTED {
        let expected = format!(
            "the plane encloses {:.1} degrees with the beam; expected a plane that holds the zone axis, so that it is seen edge on",
            normal[2].abs().asin().to_degrees()
        );
        return fault(&key("plane"), &given.plane, expected);
    }
    let [x, y] = given.position_nm.map(|nm| PER_NM * nm);
    let distance = dot([x, y, 0.0], normal);
    let action = match (given.kind, &given.shift) {
        (FaultKind::Twin, None) => FaultAction::Mirror,
        (FaultKind::Twin, Some(shift)) => {
            return fault(
                &key("shift"),
                shift,
                "a twin is a mirror image and has no shift; leave it out",
            );
        }
        (_, None) => {
            let expected = format!(
                "a fault of the kind {} needs its shift, such as \"1/6[11-2]\"",
                given.kind.name()
            );
            return fault(&key("shift"), "(missing)", expected);
        }
        (kind, Some(text)) => {
            FaultAction::Shift(fault_shift(&key("shift"), kind, text, normal, crystal)?)
        }
    };
    Ok(FaultPlane { normal, distance, action })
}

/// Reads the shift of a fault in Angstrom.
fn fault_shift(
    key: &str,
    kind: FaultKind,
    text: &str,
    normal: Vec3,
    crystal: &FittedCrystal,
) -> Checked<Vec3> {
    let by = match direction::parse_vector(text) {
        Ok(components) => row_times(components, &crystal.cell),
        Err(expected) => return fault(key, text, expected),
    };
    if norm(by) > 30.0 {
        return fault(
            key,
            text,
            format!("the shift is {:.1} A long; expected at most 30 A", norm(by)),
        );
    }
    let out = dot(by, normal) / norm(by);
    if kind == FaultKind::StackingFault && out.abs() > TILTED {
        let expected = format!(
            "the shift encloses {:.1} degrees with the plane; expected a vector in the plane of the fault",
            out.abs().asin().to_degrees()
        );
        return fault(key, text, expected);
    }
    if crystal.repeats(by, SAME_ANGSTROM) {
        let expected = "the shift takes every atom to an atom of its element, so that there is no fault; expected a fraction of a lattice vector";
        return fault(key, text, expected);
    }
    Ok(by)
}

/// Checks the dislocations; returns them in their places.
pub fn check_dislocations(
    table: &StackTable,
    layers: &[StackedLayer],
    field: &Field,
) -> Checked<Vec<EdgeDislocation>> {
    let one = |(n, given): (usize, &StackDislocation)| dislocation(table, layers, field, n, given);
    table.dislocations.iter().enumerate().map(one).collect()
}

fn dislocation(
    table: &StackTable,
    layers: &[StackedLayer],
    field: &Field,
    n: usize,
    given: &StackDislocation,
) -> Checked<EdgeDislocation> {
    let key = |name: &str| item_key("dislocations", n, name);
    check_place(&key("position_nm"), given.position_nm, field)?;
    let crystal = crystal_of(&key("layer"), given.layer, layers)?;
    let faulted = &layers[given.layer - 1].faults;
    if !faulted.is_empty() {
        let expected = "this layer has planar faults, beyond which its lattice is another; expected a layer without faults";
        return fault(&key("layer"), given.layer, expected);
    }
    let poisson_ratio = given.poisson_ratio.unwrap_or(DEFAULT_POISSON_RATIO);
    within(&key("poisson_ratio"), poisson_ratio, 0.0, 0.499)?;
    let text = &given.burgers;
    let burgers = match direction::parse_vector(text) {
        Ok(components) => row_times(components, &crystal.cell),
        Err(expected) => return fault(&key("burgers"), text, expected),
    };
    let length = norm(burgers);
    if burgers[2].abs() > TILTED * length {
        let expected = format!(
            "it encloses {:.1} degrees with the plane of the image; expected a Burgers vector perpendicular to the beam: the line is a pure \
             edge dislocation along the beam",
            (burgers[2].abs() / length).min(1.0).asin().to_degrees()
        );
        return fault(&key("burgers"), text, expected);
    }
    if !crystal.repeats(burgers, SAME_ANGSTROM) {
        let expected = "it is no lattice vector of the crystal, and a partial dislocation would bound a fault; expected a lattice vector";
        return fault(&key("burgers"), text, expected);
    }
    let burgers = [burgers[0], burgers[1]];
    let normal = [-burgers[1], burgers[0]].map(|v| v / burgers[0].hypot(burgers[1]));
    let position = between_planes(crystal, given.position_nm.map(|nm| PER_NM * nm), normal);
    let cut_ahead = cut_side(table, layers, &key("burgers"), given, position, burgers)?;
    Ok(EdgeDislocation { position, burgers, poisson_ratio, cut_ahead })
}

/// Moves a point along the normal of a plane that holds the beam to the middle of a wide gap between two atomic planes: at least 0.8 times
/// the widest.
pub fn between_planes(crystal: &FittedCrystal, at: [f64; 2], normal: [f64; 2]) -> [f64; 2] {
    let edges = crystal.edges();
    let reach = edges[0].hypot(edges[1]);
    let cells = |k: usize| {
        let corner =
            |side: f64| ((at[k] + side * reach - crystal.origin[k]) / edges[k]).floor() as i64;
        corner(-1.0)..=corner(1.0)
    };
    let mut heights: Vec<f64> = Vec::new();
    for (i, j) in cells(0).flat_map(|i| cells(1).map(move |j| (i, j))) {
        heights.extend(crystal.structure.atoms.iter().map(|atom| {
            let x = crystal.origin[0] + i as f64 * edges[0] + atom.position[0] - at[0];
            let y = crystal.origin[1] + j as f64 * edges[1] + atom.position[1] - at[1];
            x * normal[0] + y * normal[1]
        }));
    }
    heights.sort_by(f64::total_cmp);
    let gaps: Vec<[f64; 2]> = heights
        .windows(2)
        .filter(|w| w[0].abs() < 0.7 * reach)
        .map(|w| [w[1] - w[0], 0.5 * (w[0] + w[1])])
        .collect();
    let widest = gaps.iter().map(|[gap, _]| *gap).fold(0.0, f64::max);
    let wide = gaps.iter().filter(|[gap, _]| *gap >= 0.8 * widest);
    let nearest = wide.min_by(|a, b| a[1].abs().total_cmp(&b[1].abs()).then(a[1].total_cmp(&b[1])));
    let by = nearest.map_or(0.0, |[_, middle]| *middle);
    [at[0] + by * normal[0], at[1] + by * normal[1]]
}

/// Returns whether the slip plane is cut ahead of the line: on the side on which it crosses fewer other layers. The lattices of the layers
/// that it crosses must have the Burgers vector too.
fn cut_side(
    table: &StackTable,
    layers: &[StackedLayer],
    key: &str,
    given: &StackDislocation,
    position: [f64; 2],
    burgers: [f64; 2],
) -> Checked<bool> {
    let axis = table.along.axis();
    let length = burgers[0].hypot(burgers[1]);
    let own = if axis == 2 {
        None
    } else {
        let at = position[axis];
        Some(layers.iter().rposition(|layer| layer.begin <= at).unwrap_or(0))
    };
    let crossed = |ahead: bool| -> Vec<usize> {
        let Some(own) = own else { return (0..layers.len()).collect() };
        let along = if ahead { burgers[axis] } else { -burgers[axis] };
        match along / length {
            s if s > TILTED => (own..layers.len()).collect(),
            s if s < -TILTED => (0..=own).collect(),
            _ => vec![own],
        }
    };
    let cut_ahead = crossed(true).len() < crossed(false).len();
    let vector = [burgers[0], burgers[1], 0.0];
    for n in crossed(cut_ahead) {
        let StackedMatter::Crystal(crystal) = &layers[n].matter else { continue };
        let repeats = layers[n].faults.is_empty() && crystal.repeats(vector, NEAR_REPEAT * length);
        if !repeats {
            let expected = format!(
                "its slip plane crosses layer {}, whose lattice does not repeat after it to within {:.0} %; expected a dislocation whose slip \
                 plane ends in layers with this lattice vector",
                n + 1,
                100.0 * NEAR_REPEAT
            );
            return fault(key, &given.burgers, expected);
        }
    }
    Ok(cut_ahead)
}

/// Checks the precipitates; returns their crystals, in their places.
pub fn check_precipitates(table: &StackTable, field: &Field) -> Checked<Vec<PlacedPrecipitate>> {
    let phases = table.phases();
    let one = |(n, given): (usize, &Precipitate)| {
        let key = |name: &str| item_key("precipitates", n, name);
        let [x, y, z] = given.centre_nm;
        check_place(&key("centre_nm"), [x, y], field)?;
        within(&key("centre_nm"), z, 0.0, field.thickness_nm)?;
        given.size_nm.iter().try_for_each(|nm| within(&key("size_nm"), *nm, 0.3, 1000.0))?;
        within(&key("turn_deg"), given.turn_deg, -360.0, 360.0)?;
        let oriented = oriented_box(&given.crystal, &given.zone_axis, given.y_axis.as_deref())
            .map_err(|e| crystal_fault(&key("crystal"), e))?;
        check_whole(&key("crystal"), &oriented.structure)?;
        let mut crystal = FittedCrystal::new(&oriented);
        crystal.origin = given.centre_nm.map(|nm| PER_NM * nm);
        let phase = phases.iter().position(|name| *name == given.phase()).unwrap_or(0);
        Ok(PlacedPrecipitate { phase, crystal })
    };
    table.precipitates.iter().enumerate().map(one).collect()
}
