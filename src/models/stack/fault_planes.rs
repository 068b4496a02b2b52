//! Planes at which a crystal is mirrored or shifted.

use std::collections::BTreeMap;

use super::Isometry;
use crate::structure::lattice::{Vec3, dot, norm, subtract};
use crate::structure::{PAIR_CUTOFF_ANGSTROM, Structure, shortest_distances};

/// Atoms nearer to a plane than this lie on it, in Angstrom.
pub const ON_PLANE_ANGSTROM: f64 = 0.02;
/// Largest distance by which a plane is moved to its place between the atoms, in Angstrom.
const MOVED_ANGSTROM: f64 = 6.5;
/// Radius across the plane within which places are compared, in Angstrom.
const ACROSS_ANGSTROM: f64 = 9.0;
/// Pairs nearer than the first number times the shortest distance of their elements overlap; pairs up to the second are bonds.
const BOND: [f64; 2] = [0.85, 1.15];
/// Atoms nearer to the plane than this, in Angstrom, have their bonds counted.
const ABOUT_ANGSTROM: f64 = 3.5;
/// Places with at least this share of the most bonds for an atom are equally good.
const AS_GOOD: f64 = 0.97;

/// What a plane does with the crystal on its positive side.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FaultAction {
    /// The crystal there is the mirror image of the crystal on the other side.
    Mirror,
    /// The crystal there is shifted by a vector in Angstrom.
    Shift(Vec3),
}

/// The plane of points r with r . `normal` = `distance`, and what it does.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FaultPlane {
    /// Unit vector.
    pub normal: Vec3,
    /// Distance from the origin in Angstrom.
    pub distance: f64,
    /// What it does with the crystal beyond it.
    pub action: FaultAction,
}

impl FaultPlane {
    /// Returns the map of the crystal without this plane to the crystal on its positive side.
    fn map(&self) -> Isometry {
        match self.action {
            FaultAction::Mirror => Isometry::reflection(self.normal, self.distance),
            FaultAction::Shift(by) => Isometry::translation(by),
        }
    }
}

/// Returns the maps of the undisturbed crystal to its parts between parallel planes, which are sorted by their distance; the first part lies
/// on the negative side of all planes. Each plane acts on the crystal that the part before it would have continued.
pub fn parts(planes: &[FaultPlane]) -> Vec<Isometry> {
    let mut maps = vec![Isometry::IDENTITY];
    for plane in planes {
        let before = maps[maps.len() - 1];
        maps.push(plane.map().after(&before));
    }
    maps
}

/// Returns the part in which a point lies; a point on a plane belongs to the part before it.
pub fn part_of(planes: &[FaultPlane], at: Vec3) -> usize {
    planes.iter().filter(|plane| dot(at, plane.normal) > plane.distance + ON_PLANE_ANGSTROM).count()
}

/// Places the planes, sorted by their distance, at planes of atoms or midway between two: each moves by at most 6.5 A to the nearest place
/// at which no atoms overlap and the atoms about it keep most bonds. So the mirror plane of an fcc twin is a plane of atoms, and of a twin of
/// diamond structure it cuts the bonds along its normal. The crystal lies in a box whose origin is at `origin`; `near` is a point about
/// which places are compared.
pub fn placed(
    crystal: &Structure,
    origin: Vec3,
    near: Vec3,
    planes: &[FaultPlane],
) -> Vec<FaultPlane> {
    let shortest = shortest_distances(crystal, PAIR_CUTOFF_ANGSTROM);
    let mut out: Vec<FaultPlane> = Vec::with_capacity(planes.len());
    for plane in planes {
        let maps = parts(&out);
        let before = maps[maps.len() - 1];
        out.push(best_place(crystal, origin, near, &before, &shortest, plane));
    }
    out
}

/// An atom near a plane: its position and atomic number.
type NearAtom = (Vec3, u8);

fn best_place(
    crystal: &Structure,
    origin: Vec3,
    near: Vec3,
    before: &Isometry,
    shortest: &BTreeMap<(u8, u8), f64>,
    plane: &FaultPlane,
) -> FaultPlane {
    let off = dot(near, plane.normal) - plane.distance;
    let centre: Vec3 = std::array::from_fn(|k| near[k] - off * plane.normal[k]);
    let shift = if let FaultAction::Shift(by) = plane.action { norm(by) } else { 0.0 };
    let radius = MOVED_ANGSTROM + ACROSS_ANGSTROM + 3.0 * PAIR_CUTOFF_ANGSTROM + shift;
    let atoms = cluster(crystal, origin, before, centre, radius);
    let mut offsets: Vec<f64> = atoms.iter().map(|(at, _)| dot(*at, plane.normal)).collect();
    offsets.sort_by(f64::total_cmp);
    offsets.dedup_by(|a, b| (*a - *b).abs() < ON_PLANE_ANGSTROM);
    let middles: Vec<f64> = offsets.windows(2).map(|w| 0.5 * (w[0] + w[1])).collect();
    let mut places: Vec<f64> = offsets.into_iter().chain(middles).collect();
    places.retain(|d| (d - plane.distance).abs() <= MOVED_ANGSTROM);
    places.sort_by(|a, b| {
        (a - plane.distance).abs().total_cmp(&(b - plane.distance).abs()).then(a.total_cmp(b))
    });
    let scored: Vec<(FaultPlane, (usize, f64))> = places
        .into_iter()
        .map(|distance| {
            let moved = FaultPlane { distance, ..*plane };
            (moved, bonds_about(&atoms, centre, &moved, shortest))
        })
        .collect();
    let fewest = scored.iter().map(|(_, (overlaps, _))| *overlaps).min().unwrap_or(0);
    let free = || scored.iter().filter(|(_, (overlaps, _))| *overlaps == fewest);
    let most = free().map(|(_, (_, bonds))| *bonds).fold(0.0, f64::max);
    free().find(|(_, (_, bonds))| *bonds >= AS_GOOD * most).map_or(*plane, |(place, _)| *place)
}

/// Returns the atoms of a mapped crystal within a radius of a place.
fn cluster(
    crystal: &Structure,
    origin: Vec3,
    map: &Isometry,
    centre: Vec3,
    radius: f64,
) -> Vec<NearAtom> {
    let middle = map.undo(centre);
    let lengths = [0, 1, 2].map(|k| crystal.cell[k][k]);
    let cells = |k: usize| {
        let at = |side: f64| (middle[k] + side * radius - origin[k]) / lengths[k];
        at(-1.0).floor() as i64 - 1..=at(1.0).ceil() as i64
    };
    let mut atoms = Vec::new();
    for (i, j, k) in
        cells(0).flat_map(|i| cells(1).flat_map(move |j| cells(2).map(move |k| (i, j, k))))
    {
        let corner = [i, j, k];
        for atom in &crystal.atoms {
            let at: Vec3 = std::array::from_fn(|a| {
                origin[a] + corner[a] as f64 * lengths[a] + atom.position[a]
            });
            if norm(subtract(at, middle)) <= radius {
                atoms.push((map.apply(at), atom.number));
            }
        }
    }
    atoms
}

/// Returns the number of pairs of atoms across a plane that overlap, and the mean number of bonds of the atoms about the plane.
fn bonds_about(
    atoms: &[NearAtom],
    centre: Vec3,
    plane: &FaultPlane,
    shortest: &BTreeMap<(u8, u8), f64>,
) -> (usize, f64) {
    let height = |at: Vec3| dot(at, plane.normal) - plane.distance;
    let across = |at: Vec3| {
        let from = subtract(at, centre);
        (dot(from, from) - dot(from, plane.normal).powi(2)).max(0.0).sqrt()
    };
    let near = |at: Vec3| {
        height(at).abs() < 2.0 * PAIR_CUTOFF_ANGSTROM
            && across(at) < ACROSS_ANGSTROM + PAIR_CUTOFF_ANGSTROM
    };
    let map = plane.map();
    let before = atoms.iter().copied().filter(|(at, _)| height(*at) <= ON_PLANE_ANGSTROM);
    let moved = atoms.iter().map(|(at, z)| (map.apply(*at), *z));
    let beyond = moved.filter(|(at, _)| height(*at) > ON_PLANE_ANGSTROM);
    let local: Vec<NearAtom> = before.chain(beyond).filter(|(at, _)| near(*at)).collect();
    let (mut overlaps, mut bonds, mut count) = (0, 0, 0);
    for (n, (at, a)) in local.iter().enumerate() {
        if height(*at).abs() > ABOUT_ANGSTROM || across(*at) > ACROSS_ANGSTROM {
            continue;
        }
        count += 1;
        for (other, b) in local.iter().enumerate().filter(|(m, _)| *m != n).map(|(_, atom)| atom) {
            let Some(known) = shortest.get(&((*a).min(*b), (*a).max(*b))) else { continue };
            let ratio = norm(subtract(*at, *other)) / known;
            overlaps += usize::from(ratio < BOND[0]);
            bonds += usize::from((BOND[0]..=BOND[1]).contains(&ratio));
        }
    }
    (overlaps, f64::from(bonds as u32) / f64::from(count.max(1)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::structure::crystals;

    /// The crystal along [110] with a {111} plane perpendicular to y, and the atoms of its parts about a fault at y = 0.
    fn faulted(name: &str, distance: f64, action: FaultAction) -> (FaultPlane, Vec<NearAtom>) {
        let crystal =
            crystals::crystal(name).unwrap().oriented([1, 1, 0], Some([1, -1, 1])).unwrap();
        let plane = FaultPlane { normal: [0.0, 1.0, 0.0], distance, action };
        let planes = placed(&crystal, [0.0; 3], [0.0; 3], &[plane]);
        let mut atoms = Vec::new();
        for (part, map) in parts(&planes).iter().enumerate() {
            let found = cluster(&crystal, [0.0; 3], map, [0.0, planes[0].distance, 0.0], 16.0);
            atoms.extend(found.into_iter().filter(|(at, _)| part_of(&planes, *at) == part));
        }
        (planes[0], atoms)
    }

    fn neighbours(atoms: &[NearAtom], at: Vec3, radius: f64) -> usize {
        atoms.iter().filter(|(other, _)| norm(subtract(*other, at)) < radius).count() - 1
    }

    #[test]
    fn twins_of_silicon_and_platinum_keep_their_bonds() {
        for (name, bond, count) in [("si", 2.352, 4), ("pt", 2.774, 12)] {
            for distance in [-1.3, 0.0, 0.4, 1.0, 2.2] {
                let (plane, atoms) = faulted(name, distance, FaultAction::Mirror);
                assert!((plane.distance - distance).abs() < 2.5, "{name} {distance}: {plane:?}");
                for (at, _) in atoms
                    .iter()
                    .filter(|(at, _)| norm([at[0], at[1] - plane.distance, at[2]]) < 9.0)
                {
                    assert_eq!(neighbours(&atoms, *at, 1.05 * bond), count, "{name} {at:?}");
                    let mirrored = Isometry::reflection(plane.normal, plane.distance).apply(*at);
                    assert!(atoms.iter().any(|(other, _)| norm(subtract(*other, mirrored)) < 1e-6));
                }
            }
        }
    }

    #[test]
    fn a_stacking_fault_shifts_the_part_beyond_it() {
        let crystal = crystals::crystal("si").unwrap();
        let oriented = crystal.oriented_within([1, 1, 0], Some([1, -1, 1]), None).unwrap();
        // 1/6 [1 -1 -2] lies in (1 -1 1).
        let length = 5.431 / 6.0 * 6f64.sqrt();
        for sign in [1.0, -1.0] {
            let by = [sign * length, 0.0, 0.0];
            let (plane, atoms) = faulted("si", 0.1, FaultAction::Shift(by));
            let mut bonded = 0;
            for (at, _) in
                atoms.iter().filter(|(at, _)| norm([at[0], at[1] - plane.distance, at[2]]) < 8.0)
            {
                bonded += usize::from(neighbours(&atoms, *at, 1.05 * 2.352) == 4);
            }
            // One of the two senses is the fault of low energy, in which all atoms keep four bonds.
            println!("{sign}: {bonded}, box {:?}", oriented.axes);
            let beyond = cluster(
                &oriented.structure,
                [0.0; 3],
                &Isometry::translation(by),
                [0.0, plane.distance, 0.0],
                12.0,
            );
            for (at, _) in beyond.iter().filter(|(at, _)| at[1] > plane.distance + 0.1) {
                assert!(atoms.iter().any(|(other, _)| norm(subtract(*other, *at)) < 1e-9));
            }
        }
    }
}
