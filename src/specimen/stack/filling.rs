//! Fills the layers of a stack with sites.

use rayon::prelude::*;

use super::interfaces::{Extent, Interfaces};
use crate::error::{Error, Result};
use crate::lengths;
use crate::models::stack::Isometry;
use crate::models::stack::fault_planes::{part_of, parts};
use crate::recipe::stack_table::{Precipitate, PrecipitateShape};
use crate::recipe::stacked_crystals::{FittedCrystal, StackedCrystals, StackedMatter};
use crate::recipe::{CheckedRecipe, StackTable};
use crate::rng::{Purpose, uniform};
use crate::setting::Setting;
use crate::specimen::sites::SiteKind;
use crate::structure::elements;
use crate::structure::lattice::{Vec3, subtract};

/// Positions are compared with the faces of the specimen to this many Angstrom.
const ROUNDING: f64 = 1e-6;

/// A site in its undisturbed place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MadeSite {
    /// Place in Angstrom.
    pub position: Vec3,
    /// Atomic number.
    pub number: u8,
    /// Whether the atom was exchanged.
    pub kind: SiteKind,
    /// Index of the phase.
    pub phase: u16,
    /// Index of the layer; [`NO_LAYER`] for sites of precipitates and particles.
    pub layer: u16,
}

/// The layer of sites that belong to none.
pub const NO_LAYER: u16 = u16::MAX;

/// A site of a crystal: its place, and numbers that identify it.
struct CrystalSite {
    position: Vec3,
    number: u8,
    key: u64,
}

/// Returns the sites of all layers and precipitates within an extent, always in the same order.
///
/// # Errors
/// [`Error::Invalid`] for amorphous layers whose atoms find no room.
pub fn filled(
    recipe: &CheckedRecipe,
    table: &StackTable,
    crystals: &StackedCrystals,
    interfaces: &Interfaces,
    extent: Extent,
) -> Result<Vec<MadeSite>> {
    let mut sites = Vec::new();
    // Where atoms overlap, the first stays: precipitates keep their atoms, and layers on them lose some.
    for (n, precipitate) in crystals.precipitates.iter().enumerate() {
        let shape = &table.precipitates[n];
        let bounds = bounds_of(shape, &extent);
        let inside = |at: Vec3| {
            holds(shape, at) && !table.precipitates[..n].iter().any(|other| holds(other, at))
        };
        let made = |site: CrystalSite| MadeSite {
            position: site.position,
            number: site.number,
            kind: SiteKind::Pristine,
            phase: precipitate.phase as u16,
            layer: NO_LAYER,
        };
        sites.extend(
            crystal_sites(&precipitate.crystal, &Isometry::IDENTITY, bounds, inside).map(made),
        );
    }
    for n in 0..crystals.layers.len() {
        fill_layer(recipe, table, crystals, interfaces, (n, extent), &mut sites)?;
    }
    Ok(sites)
}

fn fill_layer(
    recipe: &CheckedRecipe,
    table: &StackTable,
    crystals: &StackedCrystals,
    interfaces: &Interfaces,
    (n, extent): (usize, Extent),
    sites: &mut Vec<MadeSite>,
) -> Result<()> {
    let layer = &crystals.layers[n];
    let phase = layer.phase as u16;
    let bounds = interfaces.bounds(n, &extent);
    let free = |at: Vec3| {
        interfaces.holds(n, at)
            && !layer.edges.iter().any(|edge| edge.cuts(at))
            && !table.precipitates.iter().any(|shape| holds(shape, at))
    };
    match &layer.matter {
        StackedMatter::Crystal(crystal) => {
            let exchange = Exchange::new(table, n, recipe.seed);
            for (part, map) in parts(&layer.faults).iter().enumerate() {
                let inside = |at: Vec3| part_of(&layer.faults, at) == part && free(at);
                let map = layer.turn.after(map);
                let found = crystal_sites(crystal, &map, bounds, inside);
                sites.extend(found.map(|site| exchange.site(&site, part, interfaces, phase)));
            }
        }
        StackedMatter::Amorphous(packing) => {
            if bounds.iter().any(|[low, high]| high <= low) {
                return Ok(());
            }
            let atoms = packing.fill(bounds, recipe.seed, n as u32).map_err(|share| {
                let value = format!("stack.layers[{}].density_g_per_cm3", n + 1);
                let expected = format!(
                    "{:.1} % of the atoms find no room at this density; expected a lower density, or shorter least_distance_angstrom",
                    100.0 * share
                );
                Error::invalid(Setting::Recipe, value, expected)
            })?;
            let made = |(position, number)| {
                let (kind, layer) = (SiteKind::Pristine, n as u16);
                MadeSite { position, number, kind, phase, layer }
            };
            sites.extend(atoms.into_iter().filter(|(at, _)| free(*at)).map(made));
        }
    }
    Ok(())
}

/// Lists the sites of a mapped crystal within bounds that also pass a test, cell by cell.
fn crystal_sites(
    crystal: &FittedCrystal,
    map: &Isometry,
    bounds: Extent,
    inside: impl Fn(Vec3) -> bool + Sync,
) -> impl Iterator<Item = CrystalSite> {
    let edges = crystal.edges();
    let empty = bounds.iter().any(|[low, high]| high <= low);
    let corners = (0..8).map(|n| map.undo(std::array::from_fn(|k| bounds[k][n >> k & 1])));
    let corners: Vec<Vec3> = corners.collect();
    let cells = |k: usize| {
        let cell = |v: f64| (v - crystal.origin[k]) / edges[k];
        let along = || corners.iter().map(|c| cell(c[k]));
        let [low, high] =
            [along().fold(f64::INFINITY, f64::min), along().fold(f64::NEG_INFINITY, f64::max)];
        // Atoms may lie a rounding error outside their cell.
        (low - 1e-6).floor() as i64 - 1..(high + 1e-6).floor() as i64 + 1
    };
    let [across, down, along] = [cells(0), cells(1), cells(2)];
    let across = if empty { 0..0 } else { across };
    let slab = |i: i64| {
        let mut found = Vec::new();
        for (j, k) in down.clone().flat_map(|j| along.clone().map(move |k| (j, k))) {
            let corner = [i, j, k];
            for (a, atom) in crystal.structure.atoms.iter().enumerate() {
                let place = std::array::from_fn(|x| {
                    crystal.origin[x] + corner[x] as f64 * edges[x] + atom.position[x]
                });
                let position = map.apply(place);
                let within = (0..3).all(|x| {
                    let rounding = if x == 2 { ROUNDING } else { 0.0 };
                    bounds[x][0] - rounding <= position[x] && position[x] < bounds[x][1] - rounding
                });
                if within && inside(position) {
                    found.push(CrystalSite { position, number: atom.number, key: key(corner, a) });
                }
            }
        }
        found
    };
    let slabs: Vec<Vec<CrystalSite>> = across.into_par_iter().map(slab).collect();
    slabs.into_iter().flatten()
}

/// Packs cell and atom into a number; the limits of recipes keep cells across below 2^15 and atoms below 2^20.
fn key(cell: [i64; 3], atom: usize) -> u64 {
    let [i, j, k] = cell;
    let across = |n: i64| (n + (1 << 15)) as u64 & 0xFFFF;
    across(i) | across(j) << 16 | (k as u64 & 0xFFF) << 32 | (atom as u64 & 0xF_FFFF) << 44
}

/// The elements that a layer exchanges with the layers before and after it.
struct Exchange {
    layer: usize,
    seed: u64,
    /// For the interface before the layer and the one after it: width in Angstrom, and pairs (own element, element of the other layer).
    sides: [Option<(f64, Vec<[u8; 2]>)>; 2],
}

impl Exchange {
    fn new(table: &StackTable, layer: usize, seed: u64) -> Self {
        // Pairs are listed in the layer above their interface, the element of the layer below first.
        let pairs = |n: usize, own: usize| {
            let above = table.layers.get(n)?;
            let width = above.interdiffusion_nm.filter(|width| *width > 0.0)?;
            let number = |symbol: &String| elements::atomic_number(symbol).unwrap_or(0);
            let pair = |(below, above): (&String, &String)| {
                let pair = [number(below), number(above)];
                [pair[own], pair[1 - own]]
            };
            Some((lengths::angstrom_by_division(width), above.exchange.iter().map(pair).collect()))
        };
        Exchange { layer, seed, sides: [pairs(layer, 1), pairs(layer + 1, 0)] }
    }

    /// Returns the site with the atom that it holds: at the distance d from an interface, within its own layer, the atom belongs to the
    /// other layer with the probability erfc(d / (sqrt(2) width)) / 2.
    fn site(
        &self,
        site: &CrystalSite,
        part: usize,
        interfaces: &Interfaces,
        phase: u16,
    ) -> MadeSite {
        let position = site.position;
        let (number, kind, layer) = (site.number, SiteKind::Pristine, self.layer as u16);
        let mut made = MadeSite { position, number, kind, phase, layer };
        for (side, exchanged) in self.sides.iter().enumerate() {
            let Some((width, pairs)) = exchanged else { continue };
            let Some([_, other]) = pairs.iter().find(|[own, _]| *own == site.number) else {
                continue;
            };
            let height = interfaces.height(self.layer + side, position);
            let depth = (position[interfaces.axis] - height).abs();
            let probability = 0.5 * libm::erfc(depth / (std::f64::consts::SQRT_2 * width));
            let stream = (self.layer * 2 + side) as u32 * 256 + part as u32 % 256;
            if uniform(self.seed, Purpose::Interdiffusion, stream, site.key) < probability {
                made.number = *other;
                made.kind = SiteKind::Substitution;
                break;
            }
        }
        made
    }
}

/// Returns the box of a precipitate within an extent, in Angstrom.
fn bounds_of(shape: &Precipitate, extent: &Extent) -> Extent {
    let [a, b, c] = shape.size_nm;
    let across = 0.5 * a.hypot(b);
    let reach = [across, across, 0.5 * c];
    std::array::from_fn(|k| {
        let [low, high] = lengths::angstrom_by_division(
            [-1.0, 1.0].map(|side| shape.centre_nm[k] + side * reach[k]),
        );
        [extent[k][0].max(low), extent[k][1].min(high)]
    })
}

/// Whether a point in Angstrom lies in a precipitate.
fn holds(shape: &Precipitate, at: Vec3) -> bool {
    let from = subtract(lengths::nm(at), shape.centre_nm);
    let (sin, cos) = libm::sincos(shape.turn_deg.to_radians());
    let turned = [from[0] * cos + from[1] * sin, from[1] * cos - from[0] * sin, from[2]];
    let [x, y, z]: Vec3 = std::array::from_fn(|k| 2.0 * turned[k] / shape.size_nm[k]);
    match shape.shape {
        PrecipitateShape::Ellipsoid => x * x + y * y + z * z <= 1.0,
        PrecipitateShape::Cylinder => x * x + y * y <= 1.0 && z.abs() <= 1.0,
        PrecipitateShape::Box => [x, y, z].iter().all(|v| v.abs() <= 1.0),
    }
}
