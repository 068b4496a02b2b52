//! The ground truth of a part of a field: its sites, columns, phases, boundaries and particles, as world files list them.

use std::collections::BTreeMap;

use ndarray::Array2;
use rayon::prelude::*;

use crate::imaging::pixels::PixelRect;
use crate::recipe::Region;
use crate::specimen::{AtomColumn, Boundary, SiteKind, Sites, Specimen, SpecimenSite};
use crate::structure::elements;

/// A lattice site. Positions count from the centre of a pixel; each list states which pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct SiteTruth {
    /// (x, y, z) in nm; z from the entrance surface.
    pub position_nm: [f32; 3],
    /// Contents of the site.
    pub kind: SiteKind,
    /// Atomic number; of a vacancy, the atomic number of the missing atom.
    pub number: u8,
    /// Index of its column in the list.
    pub column: usize,
}

impl SiteTruth {
    /// Returns `vacancy_O`, `substitution_Ge`; empty for the atom that belongs there.
    pub fn defect_name(&self) -> String {
        defect_name(self.kind, self.number)
    }
}

/// Returns the name of a defect: `vacancy_O`, `substitution_Ge`; empty for none.
pub(crate) fn defect_name(kind: SiteKind, number: u8) -> String {
    let symbol = elements::symbol(number);
    match kind {
        SiteKind::Pristine => String::new(),
        SiteKind::Vacancy => format!("vacancy_{symbol}"),
        SiteKind::Substitution => format!("substitution_{symbol}"),
    }
}

/// A projected atomic column.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct ColumnTruth {
    /// (x, y) in nm: the mean of its sites, before relaxation.
    pub position_nm: [f32; 2],
    /// Number of its sites, vacant ones included.
    pub sites: u32,
    /// Vacant sites.
    pub vacancies: u32,
    /// Sites that hold another element.
    pub substitutions: u32,
    /// Atoms of each element, by atomic number.
    pub atoms: Vec<(u8, u32)>,
}

impl ColumnTruth {
    fn new(column: &AtomColumn, members: &[SpecimenSite], position_nm: [f32; 2]) -> Self {
        let of = |kind| members.iter().filter(|s| s.kind == kind).count() as u32;
        let mut atoms: BTreeMap<u8, u32> = BTreeMap::new();
        for site in members.iter().filter(|s| s.kind != SiteKind::Vacancy) {
            *atoms.entry(site.number).or_default() += 1;
        }
        ColumnTruth {
            position_nm,
            sites: column.sites.len() as u32,
            vacancies: of(SiteKind::Vacancy),
            substitutions: of(SiteKind::Substitution),
            atoms: atoms.into_iter().collect(),
        }
    }

    /// Returns elements and numbers of atoms, by atomic number: `O25 Ti26`.
    pub fn composition(&self) -> String {
        let part = |(z, n): &(u8, u32)| format!("{}{n}", elements::symbol(*z));
        self.atoms.iter().map(part).collect::<Vec<_>>().join(" ")
    }
}

/// Lists sites and columns in the order of the specimen; `origin_nm` (x, y) becomes (0, 0), and columns are counted from `first_column` on.
pub(crate) fn list(
    sites: &Sites,
    origin_nm: [f64; 2],
    first_column: usize,
) -> (Vec<SiteTruth>, Vec<ColumnTruth>) {
    let shifted = |[x, y]: [f64; 2]| [(x - origin_nm[0]) as f32, (y - origin_nm[1]) as f32];
    let mut listed = Vec::with_capacity(sites.sites.len());
    let mut columns = Vec::with_capacity(sites.columns.len());
    for (n, column) in sites.columns.iter().enumerate() {
        let members = &sites.sites[column.sites.clone()];
        let site = |s: &SpecimenSite| {
            let [x, y] = shifted([s.position_nm[0], s.position_nm[1]]);
            let position_nm = [x, y, s.position_nm[2] as f32];
            SiteTruth { position_nm, kind: s.kind, number: s.number, column: first_column + n }
        };
        listed.extend(members.iter().map(site));
        columns.push(ColumnTruth::new(column, members, shifted(column.position_nm)));
    }
    (listed, columns)
}

/// Returns the phases at the centres of pixels, [row, column] = [y, x], as indices into the phases of the specimen.
pub(crate) fn phase_map(specimen: &dyn Specimen, pixels: &PixelRect, pixel_nm: f64) -> Array2<i32> {
    let PixelRect { first, stride, .. } = *pixels;
    phases_of_points(specimen, pixels.sampled_shape(), |row, column| {
        let at = [first[1] + column * stride, first[0] + row * stride];
        at.map(|p| p as f64 * pixel_nm)
    })
}

/// Returns the phases at points (x, y) in nm of the full field, [row, column] = [y, x]; `point_nm` returns the point of a row and a column.
pub(crate) fn phases_of_points(
    specimen: &dyn Specimen,
    shape: [usize; 2],
    point_nm: impl Fn(usize, usize) -> [f64; 2] + Sync,
) -> Array2<i32> {
    let mut map = Array2::zeros(shape);
    let lines: Vec<_> = map.outer_iter_mut().collect();
    lines.into_par_iter().enumerate().for_each(|(row, mut line)| {
        for (column, phase) in line.iter_mut().enumerate() {
            *phase = specimen.phase_at(point_nm(row, column)) as i32;
        }
    });
    map
}

/// Returns the parts of a boundary that lie in a region: lines of corners (x, y) in nm of the full field.
pub(crate) fn boundary_parts(boundary: &Boundary, region: &Region) -> Vec<Vec<[f64; 2]>> {
    let mut lines: Vec<Vec<[f64; 2]>> = Vec::new();
    for ends in boundary.line_nm.windows(2) {
        let Some([from, to]) = clip([ends[0], ends[1]], region) else { continue };
        match lines.last_mut() {
            Some(line) if line.last() == Some(&from) => line.push(to),
            _ => lines.push(vec![from, to]),
        }
    }
    lines
}

/// Clips a segment to a region (Liang and Barsky).
fn clip([a, b]: [[f64; 2]; 2], region: &Region) -> Option<[[f64; 2]; 2]> {
    let (mut from, mut to) = (0.0f64, 1.0f64);
    for (k, limits) in [region.x, region.y].into_iter().enumerate() {
        let d = b[k] - a[k];
        if d == 0.0 {
            if !(limits[0]..limits[1]).contains(&a[k]) {
                return None;
            }
            continue;
        }
        let cut = limits.map(|l| (l - a[k]) / d);
        from = from.max(cut[0].min(cut[1]));
        to = to.min(cut[0].max(cut[1]));
    }
    let at = |t: f64| match t {
        0.0 => a,
        1.0 => b,
        _ => [a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])],
    };
    (from < to).then(|| [at(from), at(to)])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn segments_are_clipped_to_the_region() {
        let region = Region { x: [0.0, 4.0], y: [0.0, 2.0] };
        assert_eq!(clip([[1.0, -5.0], [1.0, 5.0]], &region), Some([[1.0, 0.0], [1.0, 2.0]]));
        assert_eq!(clip([[5.0, -5.0], [5.0, 5.0]], &region), None);
        assert_eq!(clip([[-2.0, 1.0], [2.0, 1.0]], &region), Some([[0.0, 1.0], [2.0, 1.0]]));
        assert_eq!(clip([[1.0, 1.0], [2.0, 1.5]], &region), Some([[1.0, 1.0], [2.0, 1.5]]));
    }
}
