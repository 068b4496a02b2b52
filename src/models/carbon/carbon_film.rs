//! A film of amorphous carbon of any extent, made area by area.
//!
//! The plane is divided into square cells. Each is cut from the periodic block ([`super::block`]) with a different offset, rotation by any
//! angle and reflection, so no two cells are shifted copies of each other. Along the edges, where two cuts meet, atoms are relaxed in
//! Tersoff's potential: first the seams between two cells, independently of each other, then the nodes between four. A piece depends on its
//! few neighbours only, so the film does not depend on the order of requests.
//!
//! Atoms avoid the plane of a cut: about 1 A at the plane holds fewer atoms, and more lie on both sides. Cuts are therefore folded along
//! the beam ([`unfolded`]); otherwise images would show their lines (5 % too bright beside them, 7 % too dark on them).

use std::collections::HashMap;
use std::sync::{Arc, Mutex, OnceLock};

use rayon::prelude::*;

use super::Vec3;
use super::block::{self, EDGE_ANGSTROM};
use super::dynamics::{Roles, relax};
use super::network::{Neighbours, Network};
use super::tersoff::CUTOFF;
use crate::rng::{Purpose, words};

/// Edge of a cell in Angstrom: its diagonal hardly exceeds the edge of the block.
pub const CELL: f64 = 65.0;
/// Atoms nearer than this to an edge of a cell are relaxed, in Angstrom.
const SEAM: f64 = 2.5;
/// Seams end this far from a corner, in Angstrom, so that no two of them touch.
const NODE: f64 = 4.5;
/// Atoms that move farther than this during relaxation have left the network and are removed, in Angstrom.
const FARTHEST: f64 = 3.0;
/// Least distance of two atoms, in Angstrom.
pub const LEAST_DISTANCE: f64 = 1.3;
/// Cells extend this far beyond their edges, in Angstrom. This adds as many atoms as seams and faces lose, so that the density equals the
/// density of the block.
const OVERLAP: f64 = 0.1;
/// Number of steps of relaxation; three times as many change no statistic of the seams by more than 2 %.
const STEPS: usize = 60;
/// Deviation of the folded cuts to either side, in Angstrom.
const FOLD: f64 = 5.0;
/// Period of the folds along the beam, in Angstrom.
const FOLD_PERIOD: f64 = 50.0;
/// Largest factor by which [`unfolded`] coordinates increase distances between atoms, sqrt(1 + 2 slope^2).
const STRETCH: f64 = 1.15;
/// Number of pieces kept in memory; about 100 MB.
const KEPT: usize = 1024;

/// A part of the film that is made at once.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
enum Zone {
    /// The cell (i, j), as cut from the block.
    Cell,
    /// The seam between the cells (i - 1, j) and (i, j).
    SeamX,
    /// The seam between the cells (i, j - 1) and (i, j).
    SeamY,
    /// The node between the cells (i - 1, j - 1) and (i, j).
    Node,
}

type Piece = (Zone, i64, i64);
/// The atoms of a piece, once they are made.
type PieceAtoms = Arc<OnceLock<Vec<Vec3>>>;

/// An atom of the film.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FilmAtom {
    /// Number that is unique in the film; below 2^56.
    pub key: u64,
    /// Position in Angstrom; z from 0 at one face to the thickness at the other.
    pub position: Vec3,
}

/// A film of amorphous carbon of any extent.
pub struct Film {
    seed: u64,
    thickness: f64,
    pieces: Mutex<Kept>,
}

#[derive(Default)]
struct Kept {
    pieces: HashMap<Piece, (PieceAtoms, u64)>,
    clock: u64,
}

/// A rectangle `[[x0, x1], [y0, y1]]` in Angstrom.
pub(crate) type Rectangle = [[f64; 2]; 2];

/// Converts x and y to coordinates in which the folded cuts run along the beam: shifted to and fro with the height.
pub fn unfolded(p: &Vec3) -> [f64; 2] {
    [0, 1].map(|k| {
        // The folds along y are a quarter of a period ahead of the folds along x.
        let turn = p[2] / FOLD_PERIOD + [0.0, 0.25][k];
        p[k] + FOLD * (4.0 * (turn - turn.floor() - 0.5).abs() - 1.0)
    })
}

/// Returns the distance of an atom from a rectangle of [`unfolded`] coordinates.
fn distance(rectangle: &Rectangle, p: &Vec3) -> f64 {
    let at = unfolded(p);
    let [dx, dy] = [0, 1].map(|k| {
        let [low, high] = rectangle[k];
        f64::max(low - at[k], at[k] - high).max(0.0)
    });
    (dx * dx + dy * dy).sqrt()
}

/// Returns the piece that an atom at a place of the cut belongs to.
fn owner(p: &Vec3) -> Piece {
    let p = unfolded(p);
    let nearest = p.map(|v| (v / CELL).round());
    let depth = [0, 1].map(|k| (p[k] - nearest[k] * CELL).abs());
    let cell = p.map(|v| (v / CELL).floor() as i64);
    let line = nearest.map(|n| n as i64);
    if depth[0] < NODE && depth[1] < NODE {
        (Zone::Node, line[0], line[1])
    } else if depth[0] < SEAM {
        (Zone::SeamX, line[0], cell[1])
    } else if depth[1] < SEAM {
        (Zone::SeamY, cell[0], line[1])
    } else {
        (Zone::Cell, cell[0], cell[1])
    }
}

/// Returns the area of a piece in [`unfolded`] coordinates.
fn rectangle((zone, i, j): Piece) -> Rectangle {
    let (x, y) = (i as f64 * CELL, j as f64 * CELL);
    let along = |v: f64| [v + NODE, v + CELL - NODE];
    let across = |v: f64, half: f64| [v - half, v + half];
    match zone {
        Zone::Cell => [[x, x + CELL], [y, y + CELL]],
        Zone::SeamX => [across(x, SEAM), along(y)],
        Zone::SeamY => [along(x), across(y, SEAM)],
        Zone::Node => [across(x, NODE), across(y, NODE)],
    }
}

impl Film {
    /// Makes a film of `thickness` Angstrom, at most [`EDGE_ANGSTROM`].
    pub fn new(seed: u64, thickness: f64) -> Self {
        let thickness = thickness.min(EDGE_ANGSTROM);
        Film { seed, thickness, pieces: Mutex::default() }
    }

    /// Returns the atoms in a rectangle (lower edges included, upper edges excluded).
    pub fn atoms(&self, area: &Rectangle) -> Vec<FilmAtom> {
        let pieces = pieces_near(area);
        let inside = |p: &Vec3| (0..2).all(|k| area[k][0] <= p[k] && p[k] < area[k][1]);
        let of_piece = |&piece: &Piece| -> Vec<FilmAtom> {
            let atoms = self.piece(piece);
            let atoms = atoms.get().map_or(&[][..], Vec::as_slice).iter().enumerate();
            let own = |p: &Vec3| piece.0 != Zone::Cell || owner(p).0 == Zone::Cell;
            let kept = atoms.filter(|(_, p)| inside(p) && own(p));
            kept.map(|(n, &position)| FilmAtom { key: key(piece, n), position }).collect()
        };
        pieces.par_iter().map(of_piece).collect::<Vec<_>>().concat()
    }

    /// Returns a piece, and makes it if it does not exist.
    fn piece(&self, piece: Piece) -> PieceAtoms {
        let cell = {
            // A panic of another thread leaves the table complete: entries are inserted and removed in one step.
            let mut kept = self.pieces.lock().unwrap_or_else(|e| e.into_inner());
            kept.take(piece)
        };
        cell.get_or_init(|| match piece.0 {
            Zone::Cell => self.cut(piece),
            _ => self.join(piece),
        });
        cell
    }

    /// Cuts a cell from the block.
    fn cut(&self, piece: Piece) -> Vec<Vec3> {
        let (_, i, j) = piece;
        let index = key(piece, 0);
        let unit = |w: u32| (f64::from(w) + 0.5) / 4_294_967_296.0;
        let [turn, x, y, z] = words(self.seed, Purpose::Carbon, 3, index).map(unit);
        let [mirror, flip, ..] = words(self.seed, Purpose::Carbon, 4, index);
        let offset = [x, y, z].map(|v| v * EDGE_ANGSTROM);
        let angle = 2.0 * std::f64::consts::PI * turn;
        let (cosine, sine) = (libm::cos(angle), libm::sin(angle));
        let mirror = if mirror & 1 == 0 { 1.0 } else { -1.0 };
        let corner = [i as f64 * CELL, j as f64 * CELL];
        let wrap = |v: f64| v - EDGE_ANGSTROM * (v / EDGE_ANGSTROM).floor();
        let slab = block::slab(offset[2], self.thickness);
        let mut atoms = Vec::new();
        for b in slab {
            let z = if flip & 1 == 0 { b[2] } else { self.thickness - b[2] };
            let from = [0, 1].map(|k| wrap(b[k] - offset[k]) - EDGE_ANGSTROM);
            for image in 0..4 {
                let u = from[0] + f64::from(image % 2) * EDGE_ANGSTROM;
                let v = mirror * (from[1] + f64::from(image / 2) * EDGE_ANGSTROM);
                let local =
                    [cosine * u - sine * v + 0.5 * CELL, sine * u + cosine * v + 0.5 * CELL];
                let place = unfolded(&[local[0], local[1], z]);
                if place.iter().all(|l| (-OVERLAP..CELL + OVERLAP).contains(l)) {
                    atoms.push([corner[0] + local[0], corner[1] + local[1], z]);
                }
            }
        }
        atoms
    }

    /// Relaxes the atoms of a seam or a node among the atoms around it.
    fn join(&self, piece: Piece) -> Vec<Vec3> {
        const DRIFT: f64 = 0.6;
        let area = rectangle(piece);
        let mut mobile: Vec<Vec3> = Vec::new();
        let (mut active, mut rest) = (Vec::new(), Vec::new());
        for other in around(piece) {
            let atoms = self.piece(other);
            for p in atoms.get().into_iter().flatten() {
                let from = if other.0 == Zone::Cell { owner(p) } else { other };
                let far = distance(&area, p);
                // A node is joined to its seams after their relaxation, not as they were cut.
                let replaced =
                    piece.0 == Zone::Node && other.0 == Zone::Cell && from.0 != Zone::Cell;
                if from == piece {
                    mobile.push(*p);
                } else if !replaced && far < STRETCH * CUTOFF + DRIFT {
                    active.push(*p);
                } else if !replaced && far < STRETCH * 2.0 * CUTOFF + DRIFT {
                    rest.push(*p);
                }
            }
        }
        let roles = Roles { mobile: mobile.len(), active: mobile.len() + active.len() };
        let positions = [mobile.clone(), active, rest].concat();
        let mut network = Network { positions, period: [f64::INFINITY; 3] };
        relax(&mut network, roles, STEPS, 0.05);
        self.cleared(&mobile, roles, network)
    }

    /// Returns the mobile atoms without atoms that left the network or are too near to others.
    fn cleared(&self, before: &[Vec3], roles: Roles, network: Network) -> Vec<Vec3> {
        let near = Neighbours::new(&network, LEAST_DISTANCE);
        let mut kept = vec![true; network.positions.len()];
        for i in 0..roles.mobile {
            let moved = |k: usize| network.positions[i][k] - before[i][k];
            let square: f64 = (0..3).map(|k| moved(k) * moved(k)).sum();
            let z = network.positions[i][2];
            let thrown = square > FARTHEST * FARTHEST || z < 0.0 || z > self.thickness;
            let crowded = |&j: &u32| kept[j as usize] && (j as usize) != i;
            kept[i] = !thrown && !near.of(i).iter().any(crowded);
        }
        (0..roles.mobile).filter(|&i| kept[i]).map(|i| network.positions[i]).collect()
    }
}

/// Returns the pieces from which a seam or node is made: cells for the atoms cut, then seams.
fn around((zone, i, j): Piece) -> Vec<Piece> {
    use Zone::{Cell, Node, SeamX, SeamY};
    match zone {
        Cell => vec![],
        SeamX => vec![(Cell, i - 1, j), (Cell, i, j)],
        SeamY => vec![(Cell, i, j - 1), (Cell, i, j)],
        Node => vec![
            (Cell, i - 1, j - 1),
            (Cell, i, j - 1),
            (Cell, i - 1, j),
            (Cell, i, j),
            (SeamX, i, j - 1),
            (SeamX, i, j),
            (SeamY, i - 1, j),
            (SeamY, i, j),
        ],
    }
}

/// Returns all pieces that can have atoms in an area.
fn pieces_near(area: &Rectangle) -> Vec<Piece> {
    let range = |k: usize| {
        let [low, high] = area[k];
        ((low - NODE - FARTHEST - FOLD) / CELL).floor() as i64
            ..=((high + NODE + FARTHEST + FOLD) / CELL).floor() as i64 + 1
    };
    let mut pieces = Vec::new();
    for zone in [Zone::Cell, Zone::SeamX, Zone::SeamY, Zone::Node] {
        let reach = FOLD + if zone == Zone::Cell { 0.0 } else { FARTHEST };
        for j in range(1) {
            for i in range(0) {
                let own = rectangle((zone, i, j));
                if (0..2).all(|k| own[k][0] - reach < area[k][1] && area[k][0] <= own[k][1] + reach)
                {
                    pieces.push((zone, i, j));
                }
            }
        }
    }
    pieces
}

fn key((zone, i, j): Piece, n: usize) -> u64 {
    let cell = |v: i64| (v + (1 << 14)) as u64 & 0x7FFF;
    (zone as u64) << 54 | cell(i) << 39 | cell(j) << 24 | n as u64
}

impl Kept {
    /// Returns the entry of a piece, and marks it as the most recently used.
    fn take(&mut self, piece: Piece) -> PieceAtoms {
        self.clock += 1;
        let clock = self.clock;
        let entry = self.pieces.entry(piece).or_default();
        entry.1 = clock;
        let cell = entry.0.clone();
        if self.pieces.len() > KEPT {
            let mut uses: Vec<u64> = self.pieces.values().map(|(_, used)| *used).collect();
            let (_, &mut oldest, _) = uses.select_nth_unstable(KEPT / 4);
            self.pieces.retain(|_, (_, used)| *used > oldest);
        }
        cell
    }
}
