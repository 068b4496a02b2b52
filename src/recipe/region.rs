//! Rectangles of the field, in nm.

use crate::lengths;
use crate::plane;

/// A rectangle `x[0] <= x < x[1]`, `y[0] <= y < y[1]` in nm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Region {
    /// Horizontal range in nm.
    pub x: [f64; 2],
    /// Vertical range in nm.
    pub y: [f64; 2],
}

impl Region {
    /// Whether a point (x, y) in nm lies inside.
    pub fn contains(&self, [x, y]: [f64; 2]) -> bool {
        self.x[0] <= x && x < self.x[1] && self.y[0] <= y && y < self.y[1]
    }
    /// Returns the region extended by `nm` on every side.
    pub fn grown(&self, nm: f64) -> Region {
        Region { x: [self.x[0] - nm, self.x[1] + nm], y: [self.y[0] - nm, self.y[1] + nm] }
    }
    /// Returns the region moved by (x, y) in nm.
    pub(crate) fn moved(&self, [x, y]: [f64; 2]) -> Region {
        Region { x: self.x.map(|v| v + x), y: self.y.map(|v| v + y) }
    }
    /// Returns the part that also lies in `other`; may be empty.
    pub fn intersection(&self, other: &Region) -> Region {
        let cut = |a: [f64; 2], b: [f64; 2]| [a[0].max(b[0]), a[1].min(b[1])];
        Region { x: cut(self.x, other.x), y: cut(self.y, other.y) }
    }
    /// Whether both regions share any place.
    pub(crate) fn meets(&self, other: &Region) -> bool {
        let both = self.intersection(other);
        both.x[0] < both.x[1] && both.y[0] < both.y[1]
    }
    /// Returns the region of `size` (x, y) around a centre (x, y), all in nm.
    pub(crate) fn centred(centre: [f64; 2], size: [f64; 2]) -> Region {
        let ends = |centre, size| [-0.5, 0.5].map(|half| centre + half * size);
        let [x, y] = plane::per_axis(centre, size, ends);
        Region { x, y }
    }
    /// Returns the extent (x, y) in Angstrom.
    pub(crate) fn size_angstrom(&self) -> [f64; 2] {
        lengths::angstrom([self.x, self.y].map(|[low, high]| high - low))
    }
    /// Returns the area that the pixels `rows` x `columns` from pixel (row, column) `first` cover.
    pub fn of_pixels(first: [usize; 2], shape: [usize; 2], pixel_nm: f64) -> Region {
        let edge = |p: usize| (p as f64 - 0.5) * pixel_nm;
        let range = |i: usize| [edge(first[i]), edge(first[i] + shape[i])];
        Region { x: range(1), y: range(0) }
    }
}
