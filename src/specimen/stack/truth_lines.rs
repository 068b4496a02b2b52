//! Lines of the ground truth of a stack: interfaces, planar faults, edges and rows of vacancies.

use super::displaced;
use super::interfaces::{Extent, Interfaces};
use crate::lengths;
use crate::models::stack::fault_planes::FaultAction;
use crate::recipe::StackTable;
use crate::recipe::stacked_crystals::StackedCrystals;
use crate::specimen::specimen_trait::{Boundary, BoundaryKind};
use crate::structure::lattice::Vec3;

/// Greatest length of a part of a line that dislocations bend, in Angstrom.
const STEP: f64 = 5.0;

/// Returns the interfaces that are seen edge on, the faults and the edges.
pub fn boundaries(
    table: &StackTable,
    crystals: &StackedCrystals,
    interfaces: &Interfaces,
    extent: Extent,
) -> Vec<Boundary> {
    let mut lines = Vec::new();
    let axis = interfaces.axis;
    if axis != 2 {
        let across = 1 - axis;
        for n in 1..crystals.layers.len() {
            let mut line: Vec<[f64; 2]> = interfaces
                .corners(n, extent[across])
                .into_iter()
                .map(|[at, height]| if axis == 0 { [height, at] } else { [at, height] })
                .collect();
            // Left of a line along +y lies the lower x; left of a line along -x lies the lower y.
            if axis == 1 {
                line.reverse();
            }
            let sides = [n - 1, n].map(|k| crystals.layers[k].phase);
            let width = table.layers[n].interdiffusion_nm.unwrap_or(0.0);
            let kind = BoundaryKind::Phase { sides, sharpness_sigma_nm: width };
            lines.push(Boundary { line_nm: in_nm(&line, crystals), kind });
        }
    }
    for (n, layer) in crystals.layers.iter().enumerate() {
        let mut bounds = [extent[0], extent[1]];
        if axis != 2 {
            let [low, high] = bounds[axis];
            bounds[axis] = [low.max(interfaces.flat(n)), high.min(interfaces.flat(n + 1))];
        }
        for (plane, kind) in layer.faults.iter().zip(&layer.fault_kinds) {
            let Some(line) = line_of((plane.normal, plane.distance), bounds) else { continue };
            let shift = match plane.action {
                FaultAction::Mirror => [0.0; 3],
                FaultAction::Shift(by) => lengths::nm(by),
            };
            let normal = [plane.normal[0], plane.normal[1]];
            let kind = BoundaryKind::Fault { kind: kind.name(), normal, shift_nm: shift };
            lines.push(Boundary { line_nm: in_nm(&line, crystals), kind });
        }
        for edge in &layer.edges {
            let Some(line) = line_of((edge.normal, edge.distance), bounds) else { continue };
            let normal = [edge.normal[0], edge.normal[1]];
            let kind = BoundaryKind::Fault { kind: "edge", normal, shift_nm: [0.0; 3] };
            lines.push(Boundary { line_nm: in_nm(&line, crystals), kind });
        }
    }
    lines
}

/// Returns the line of a row of vacancies from its first to its last column.
pub fn row(ends: &[[f64; 2]; 2], crystals: &StackedCrystals) -> Boundary {
    let [a, b] = *ends;
    let length = (b[0] - a[0]).hypot(b[1] - a[1]);
    let normal = [(a[1] - b[1]) / length, (b[0] - a[0]) / length];
    let kind = BoundaryKind::Fault { kind: "vacancy_line", normal, shift_nm: [0.0; 3] };
    Boundary { line_nm: in_nm(ends, crystals), kind }
}

/// Returns a line in nm, bent by the dislocations.
fn in_nm(line: &[[f64; 2]], crystals: &StackedCrystals) -> Vec<[f64; 2]> {
    let mut points: Vec<[f64; 2]> = Vec::new();
    for ends in line.windows(2) {
        let [a, b] = [ends[0], ends[1]];
        let length = (b[0] - a[0]).hypot(b[1] - a[1]);
        let steps = if crystals.dislocations.is_empty() {
            1
        } else {
            (length / STEP).ceil().max(1.0) as usize
        };
        points.extend((0..steps).map(|k| {
            let share = k as f64 / steps as f64;
            [a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])]
        }));
    }
    points.extend(line.last());
    points.into_iter().map(|at| lengths::nm(displaced(&crystals.dislocations, at))).collect()
}

/// Returns the line in which a plane that holds the beam cuts a rectangle.
fn line_of((normal, distance): (Vec3, f64), bounds: [[f64; 2]; 2]) -> Option<[[f64; 2]; 2]> {
    let normal = [normal[0], normal[1]];
    let square = normal[0] * normal[0] + normal[1] * normal[1];
    let foot = normal.map(|n| n * distance / square);
    let along = [-normal[1], normal[0]];
    let mut ends = [f64::NEG_INFINITY, f64::INFINITY];
    for k in 0..2 {
        let [low, high] = bounds[k];
        if along[k].abs() < 1e-9 {
            if !(low..high).contains(&foot[k]) {
                return None;
            }
            continue;
        }
        let cut = [(low - foot[k]) / along[k], (high - foot[k]) / along[k]];
        ends = [ends[0].max(cut[0].min(cut[1])), ends[1].min(cut[0].max(cut[1]))];
    }
    let point = |t: f64| [foot[0] + t * along[0], foot[1] + t * along[1]];
    (ends[0] < ends[1]).then(|| ends.map(point))
}
