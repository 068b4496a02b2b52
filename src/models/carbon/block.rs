//! The periodic block of amorphous carbon that is installed with the program.
//!
//! It was made by `structures/amorphous_carbon.rs` (`melt`). Positions are stored as sixteen-bit fractions of the edge,
//! little-endian, three for each atom: steps of 0.001 A.

use std::sync::LazyLock;

use super::melt::ATOMS_PER_CUBIC_ANGSTROM;
use super::network::{Neighbours, Network};

/// Edge of the cube in Angstrom.
pub const EDGE_ANGSTROM: f64 = 70.0;
/// Density in g/cm3.
pub const DENSITY: f64 = 2.0;

/// Atoms nearer than this are bonded, in Angstrom: a distance in the gap between the first and the second peak of g(r).
pub const BOND: f64 = 1.85;

/// Returns the number of atoms per square nm of a film of this thickness.
pub(crate) fn atoms_per_nm2(thickness_nm: f64) -> f64 {
    1e3 * DENSITY * ATOMS_PER_CUBIC_ANGSTROM * thickness_nm
}

const STEPS: f64 = 65_536.0;
/// Number of passes in which atoms with fewer than two bonds are removed from a cut.
const TRIMS: usize = 4;

static BLOCK: LazyLock<(Network, Neighbours)> = LazyLock::new(|| {
    let network = decode(include_bytes!("../../../structures/amorphous-carbon.bin"));
    let bonds = Neighbours::new(&network, BOND);
    (network, bonds)
});

/// Returns the block.
pub fn network() -> &'static Network {
    &BLOCK.0
}

/// Encodes a network in a cube of [`EDGE_ANGSTROM`] as bytes.
pub fn encode(network: &Network) -> Vec<u8> {
    let step = |v: f64| ((v / EDGE_ANGSTROM * STEPS).round() as u32 % 65_536) as u16;
    network.positions.iter().flatten().flat_map(|&v| step(v).to_le_bytes()).collect()
}

/// Decodes the bytes that [`encode`] made.
pub(crate) fn decode(bytes: &[u8]) -> Network {
    let value = |b: &[u8]| f64::from(u16::from_le_bytes([b[0], b[1]])) * (EDGE_ANGSTROM / STEPS);
    let atom = |b: &[u8]| [value(&b[0..2]), value(&b[2..4]), value(&b[4..6])];
    let positions = bytes.chunks_exact(6).map(atom).collect();
    Network { positions, period: [EDGE_ANGSTROM; 3] }
}

/// Cuts a slab from the block.
///
/// Its atoms lie between `bottom` and `bottom + thickness`, with z counted from `bottom`. Atoms that the cut leaves with fewer than two
/// bonds are left out.
pub(crate) fn slab(bottom: f64, thickness: f64) -> Vec<[f64; 3]> {
    let (network, bonds) = &*BLOCK;
    let wrap = |v: f64| v - EDGE_ANGSTROM * (v / EDGE_ANGSTROM).floor();
    let z: Vec<f64> = network.positions.iter().map(|p| wrap(p[2] - bottom)).collect();
    let mut kept: Vec<bool> = z.iter().map(|&z| z < thickness).collect();
    for _ in 0..TRIMS {
        let bonded = |i: usize, j: usize| kept[j] && (z[i] - z[j]).abs() < 0.5 * EDGE_ANGSTROM;
        let strong = |i: usize| bonds.of(i).iter().filter(|&&j| bonded(i, j as usize)).count() >= 2;
        kept = (0..kept.len()).map(|i| kept[i] && strong(i)).collect();
    }
    let atoms = network.positions.iter().zip(z).zip(kept);
    atoms.filter(|(_, kept)| *kept).map(|((p, z), _)| [p[0], p[1], z]).collect()
}
