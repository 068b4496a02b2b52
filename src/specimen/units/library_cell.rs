//! Library cells: small specimens in which the units of a family are simulated for the mosaic's library.
//!
//! A library cell shows several cells of one lattice, or of one boundary, side by side. Each of these cells holds its own entry of the
//! pool, in a random order, so that every unit has random neighbours of the same rate.

use crate::plane;
use crate::specimen::units::occupation::{DefectKind, UnitOccupation};
use crate::specimen::units::patterns;
use crate::structure::columns::ColumnCrystal;

/// A lattice site of a library cell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LibrarySite {
    /// Mean position in Angstrom.
    pub position: [f64; 3],
    /// Atomic number of the atom that belongs there; 0 if the specimen that the library cell was cut from has no atom there.
    pub number: u8,
    /// Number of the site among the unit's sites that may be defects.
    pub defect: Option<usize>,
}

/// A unit of a library cell.
#[derive(Debug, Clone, PartialEq)]
pub struct LibraryUnit {
    /// Kind of unit.
    pub kind: usize,
    /// Number of its lattice cell within the library cell.
    pub cell: usize,
    /// Centre (x, y) in Angstrom.
    pub centre: [f64; 2],
    /// Sites of each member, in the order in which the specimen lists them.
    pub members: Vec<Vec<LibrarySite>>,
    /// Defective sites of the unit in each library cell.
    pub patterns: Vec<Vec<u16>>,
}

/// The geometry of a family's library cells; they differ in their defects and phonons only.
#[derive(Debug, Clone, PartialEq)]
pub struct LibraryCell {
    /// Periodic box in Angstrom; the beam runs along its third edge.
    pub box_angstrom: [f64; 3],
    /// Width in Angstrom along x and y of the part that is scanned, which begins at `scan_origin`.
    pub scanned: [f64; 2],
    /// First scanned point in Angstrom.
    pub scan_origin: [f64; 2],
    /// Edges of the lattice cell; each holds a whole number of samples.
    pub cell: [f64; 2],
    /// Whether the scan is periodic along x and y.
    pub periodic: [bool; 2],
    /// Number of lattice cells in a library cell.
    pub cells: usize,
    /// Number of library cells.
    pub count: usize,
    /// The kind of defect.
    pub process: Option<DefectKind>,
    /// Rate of defects in the surroundings.
    pub rate: f64,
    /// Seed of the library (`phonons.library_seed`).
    pub seed: u64,
    /// Units of all kinds in all cells.
    pub units: Vec<LibraryUnit>,
    /// Columns around the units that only serve as surroundings; their site numbers of defects have no meaning.
    pub surroundings: Vec<Vec<LibrarySite>>,
}

impl LibraryCell {
    /// Builds the library cells of an unstrained or uniformly deformed lattice, periodic along x and y. `place` computes the position of a
    /// site of a column in Angstrom from its cell along the beam, the kind of column and the number of the chain.
    pub(crate) fn lattice(
        contents: &UnitOccupation,
        crystal: &ColumnCrystal,
        (cell, bin): ([f64; 2], usize),
        depth: usize,
        place: impl Fn(usize, usize, usize) -> [f64; 3],
    ) -> LibraryCell {
        let [nx, ny] = contents.lattice_cells;
        let (cells, count) = (nx * ny, contents.pool.cells() / (nx * ny));
        let mut units = Vec::new();
        for n in 0..nx * ny {
            let at = [(n % nx) as f64, (n / nx) as f64];
            for (kind, members) in contents.units.kinds.iter().enumerate() {
                let columns = members.iter().map(|member| {
                    let shift = plane::mul(plane::add(at, member.cell.map(|n| n as f64)), cell);
                    let chains = &crystal.columns[member.kind].chains;
                    let site = |d: usize, c: usize| {
                        let [x, y, z] = place(d, member.kind, c);
                        LibrarySite {
                            position: [x + shift[0], y + shift[1], z],
                            number: chains[c].number,
                            defect: contents.site(member.kind, c, d),
                        }
                    };
                    let all = (0..depth).flat_map(|d| (0..chains.len()).map(move |c| (d, c)));
                    all.map(|(d, c)| site(d, c)).collect()
                });
                let members: Vec<Vec<LibrarySite>> = columns.collect();
                let centre = centre(&members);
                let of = |library_cell: usize| {
                    contents.pool.patterns(kind, bin).cells[library_cell * cells + n].clone()
                };
                let patterns = (0..count).map(of).collect();
                units.push(LibraryUnit { kind, cell: n, centre, members, patterns });
            }
        }
        let size = [nx as f64 * cell[0], ny as f64 * cell[1]];
        LibraryCell {
            box_angstrom: [size[0], size[1], depth as f64 * crystal.cell[2]],
            scanned: size,
            scan_origin: [0.0; 2],
            cell,
            periodic: [true; 2],
            cells,
            count,
            process: contents.process,
            rate: patterns::rate_of(bin),
            seed: contents.pool.seed(),
            units,
            surroundings: Vec::new(),
        }
    }

    /// Leaves out what lies farther than `beyond` Angstrom from the scan, in library cells that are periodic along neither axis.
    #[must_use]
    pub(crate) fn cut(mut self, beyond: f64) -> Self {
        let excess = self.scan_origin.map(|first| first - beyond);
        if self.periodic != [false; 2] || excess.iter().any(|width| *width <= 0.0) {
            return self;
        }
        for k in 0..2 {
            self.box_angstrom[k] = self.scanned[k] + 2.0 * beyond;
        }
        self.scan_origin = [beyond; 2];
        let shifted = |[x, y, z]: [f64; 3]| [x - excess[0], y - excess[1], z];
        for unit in &mut self.units {
            unit.centre = plane::sub(unit.centre, excess);
            unit.members.iter_mut().flatten().for_each(|s| s.position = shifted(s.position));
        }
        let size = self.box_angstrom;
        let inside = |s: &LibrarySite| (0..2).all(|k| (0.0..=size[k]).contains(&s.position[k]));
        for column in &mut self.surroundings {
            column.iter_mut().for_each(|s| s.position = shifted(s.position));
        }
        self.surroundings.retain(|column| column.iter().any(inside));
        self
    }

    /// Rounds all lengths, so that specimens of other seeds and fields have bit-identical library cells.
    #[must_use]
    pub fn rounded(mut self) -> Self {
        let round = |v: &mut f64| *v = (*v * 1e5).round() * 1e-5;
        self.box_angstrom.iter_mut().for_each(round);
        for lengths in [&mut self.scanned, &mut self.scan_origin, &mut self.cell] {
            lengths.iter_mut().for_each(round);
        }
        let units = self.units.iter_mut().flat_map(|u| {
            u.centre.iter_mut().for_each(round);
            u.members.iter_mut()
        });
        for site in units.chain(&mut self.surroundings).flatten() {
            site.position.iter_mut().for_each(round);
        }
        self
    }
}

/// Returns the mean over the members of the mean position of their sites.
fn centre(members: &[Vec<LibrarySite>]) -> [f64; 2] {
    let mean = |k: usize| {
        let of = |m: &Vec<LibrarySite>| {
            m.iter().map(|s| s.position[k]).sum::<f64>() / m.len().max(1) as f64
        };
        members.iter().map(of).sum::<f64>() / members.len() as f64
    };
    [mean(0), mean(1)]
}
