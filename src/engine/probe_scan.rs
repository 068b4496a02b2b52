//! Positions of the probes of a scan.

/// A rectangular raster of probe positions: `origin + (column, row) * step`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scan {
    /// Position (x, y) of the first probe in Angstrom.
    pub origin_angstrom: [f64; 2],
    /// Distance (x, y) between neighbouring probes in Angstrom.
    pub step_angstrom: [f64; 2],
    /// Number of probes (rows along y, columns along x).
    pub shape: [usize; 2],
}

impl Scan {
    /// Number of probe positions.
    pub fn len(&self) -> usize {
        self.shape[0] * self.shape[1]
    }

    /// Whether there is no probe position.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Position (x, y) of probe `index` (row-major) in Angstrom.
    pub fn position(&self, index: usize) -> [f64; 2] {
        let (row, column) = (index / self.shape[1], index % self.shape[1]);
        [
            self.origin_angstrom[0] + column as f64 * self.step_angstrom[0],
            self.origin_angstrom[1] + row as f64 * self.step_angstrom[1],
        ]
    }
}

/// Positions of probes: on the raster of a scan, or listed.
#[derive(Debug, Clone, Copy)]
pub(super) enum ProbePlaces<'a> {
    Raster(&'a Scan),
    /// Positions (x, y) in Angstrom.
    Each(&'a [[f64; 2]]),
}

impl ProbePlaces<'_> {
    pub fn len(&self) -> usize {
        match self {
            ProbePlaces::Raster(scan) => scan.len(),
            ProbePlaces::Each(positions) => positions.len(),
        }
    }

    /// Rows and columns of the image; listed probes are in one row.
    pub fn shape(&self) -> [usize; 2] {
        match self {
            ProbePlaces::Raster(scan) => scan.shape,
            ProbePlaces::Each(positions) => [1, positions.len()],
        }
    }

    /// Position (x, y) of a probe in Angstrom.
    pub fn position(&self, index: usize) -> [f64; 2] {
        match self {
            ProbePlaces::Raster(scan) => scan.position(index),
            ProbePlaces::Each(positions) => positions[index],
        }
    }
}

impl<'a> From<&'a Scan> for ProbePlaces<'a> {
    fn from(scan: &'a Scan) -> Self {
        ProbePlaces::Raster(scan)
    }
}
