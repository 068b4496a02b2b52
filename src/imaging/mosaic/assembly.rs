//! Assembles the image of a rectangle of pixels from the images of units.

use std::collections::{BTreeSet, HashMap};

use ndarray::Array2;
use rayon::prelude::*;

use crate::imaging::mosaic::bins::{Bins, grouped};
use crate::imaging::mosaic::cell_images::CellImages;
use crate::imaging::mosaic::image_library::ImageLibrary;
use crate::imaging::mosaic::survey::BEYOND_NM;
use crate::imaging::mosaic::unit_values::unit_values;
use crate::lengths;
use crate::plane;
use crate::recipe::region::Region;
use crate::resample::Kernel;
use crate::simd::{lesser, vectorised};
use crate::specimen::atom_columns::{AtomColumn, Sites};
use crate::specimen::sites::SiteKind;
use crate::specimen::specimen_trait::Specimen;
use crate::specimen::units::patterns::UnitSeed;
use crate::specimen::units::unit_tag::{TurnedFamily, UnitTag};

/// Width of the ramps between units. A unit's weight is exp(-d^2 / 2 s): d is the distance to the unit's nearest column in Angstrom, and
/// this constant is s in square Angstrom. Halfway between columns 2 A apart the ramp is 0.3 A wide.
pub(crate) const RAMPS: f64 = 0.15;
/// No ramps: a place shows the nearest unit only.
pub(crate) const NO_RAMPS: f64 = 0.0;
/// Weights below this are left out.
const LEAST_WEIGHT: f64 = 1e-4;
/// Distance in Angstrom that counts as much as a difference of 1 in mean atomic number, when a column stands in for another.
const STAND_IN_ANGSTROM: f64 = 4.0;
/// Edge in Angstrom of the bins in which columns are looked up. Columns that share a pixel are closer to each other than this.
const BIN_ANGSTROM: f64 = 3.0;

/// A unit of the world.
#[derive(Clone, Copy)]
struct PlacedUnit {
    tag: Option<UnitTag>,
    /// Index of the tag's family in the list of families.
    family: usize,
    /// Centre in Angstrom.
    centre: [f64; 2],
}

/// A column of a unit.
struct PlacedColumn {
    id: u64,
    unit: usize,
    /// Position in Angstrom.
    at: [f64; 2],
}

/// The share of a unit in a pixel.
struct PixelShare {
    pixel: u32,
    unit: u32,
    weight: f64,
}

/// The list of families of units, without repetition.
#[derive(Default)]
struct Families {
    list: Vec<TurnedFamily>,
    known: HashMap<TurnedFamily, usize>,
}

impl Families {
    /// The index of a unit's family. The search starts with the family of the unit before, which most units share.
    fn index(&mut self, before: usize, tag: &UnitTag) -> usize {
        let family = TurnedFamily::of(tag);
        if self.list.get(before) == Some(&family) {
            return before;
        }
        *self.known.entry(family).or_insert_with(|| {
            self.list.push(family);
            self.list.len() - 1
        })
    }
}

/// The overlap of the units' images: the pixels of a rectangle, and the units that each of them shows.
pub(crate) struct Assembly {
    /// The area in which the columns lie.
    area: Region,
    families: Vec<TurnedFamily>,
    units: Vec<PlacedUnit>,
    columns: Vec<PlacedColumn>,
    shares: Vec<PixelShare>,
    shape: [usize; 2],
    /// Places (x, y) of all pixels in Angstrom of the full field.
    places: Vec<[f64; 2]>,
}

impl Assembly {
    /// Assembles `shape` pixels from pixel `first` (row, column) of the full field. A tilted beam is displaced by `way` (Angstrom) at half
    /// thickness, so a pixel shows the columns that the beam meets there.
    pub(crate) fn new(
        specimen: &dyn Specimen,
        first: [usize; 2],
        shape: [usize; 2],
        pixel_nm: f64,
        way: [f64; 2],
    ) -> Self {
        let pixel_angstrom = lengths::angstrom(pixel_nm);
        let place = |n: usize| {
            let at = [first[1] + n % shape[1], first[0] + n / shape[1]];
            at.map(|p| p as f64 * pixel_angstrom)
        };
        let places = (0..shape[0] * shape[1]).map(place).collect();
        let region = Region::of_pixels(first, shape, pixel_nm);
        Self::of_places(specimen, &region, shape, places, (way, RAMPS))
    }

    /// Assembles pixels at any `places` (x, y) in Angstrom of the full field, row by row, all of them in `region`. `ramps` is [`RAMPS`] or
    /// [`NO_RAMPS`].
    pub(crate) fn of_places(
        specimen: &dyn Specimen,
        region: &Region,
        shape: [usize; 2],
        places: Vec<[f64; 2]>,
        (way, ramps): ([f64; 2], f64),
    ) -> Self {
        let area = region.grown(BEYOND_NM);
        let (mut units, mut columns): (Vec<PlacedUnit>, Vec<PlacedColumn>) = Default::default();
        let mut known: HashMap<u64, usize> = HashMap::new();
        let (mut families, mut family) = (Families::default(), 0);
        for column in specimen.columns(&area) {
            let id = column.unit.map_or(column.id, |u| u.id);
            let at = lengths::angstrom(column.position_nm);
            let unit = *known.entry(id).or_insert_with(|| {
                let centre = column.unit.map_or(at, |u| lengths::angstrom(u.centre_nm));
                family = column.unit.map_or(family, |tag| families.index(family, &tag));
                units.push(PlacedUnit { tag: column.unit, family, centre });
                units.len() - 1
            });
            columns.push(PlacedColumn { id: column.id, unit, at });
        }
        let bins = Bins::new(columns.iter().map(|column| column.at), BIN_ANGSTROM);
        let within = specimen.facts().shown_within_angstrom.unwrap_or(f64::INFINITY);
        let row = |row: usize| {
            let (mut shares, mut near, mut last) = (Vec::new(), NearColumns::new(within), None);
            for column in 0..shape[1] {
                let at = places[row * shape[1] + column];
                let at = plane::add(at, way);
                let here = bins.bin(at);
                if last != Some(here) {
                    last = Some(here);
                    let around = (0..9).map(|n| [here[0] + n % 3 - 1, here[1] + n / 3 - 1]);
                    near.set(around.flat_map(|b| bins.of(b)).map(|n| &columns[*n]));
                }
                near.push_shares(row * shape[1] + column, at, ramps, &mut shares);
            }
            shares
        };
        let of_rows: Vec<Vec<PixelShare>> = (0..shape[0]).into_par_iter().map(row).collect();
        let mut shares = Vec::with_capacity(of_rows.iter().map(Vec::len).sum());
        of_rows.into_iter().for_each(|row| shares.extend(row));
        Assembly { area, families: families.list, units, columns, shares, shape, places }
    }

    /// Replaces units that the library lacks by the units of nearby columns with the most similar content. Suitable only for pictures whose
    /// pixels are much wider than a column.
    #[must_use]
    pub(crate) fn with_stand_ins(
        mut self,
        specimen: &dyn Specimen,
        library: &ImageLibrary,
    ) -> Self {
        let there = self.held_by(library);
        if there.iter().all(|there| *there) {
            return self;
        }
        let mean_numbers = mean_numbers(&specimen.query(&self.area));
        let number = |id: u64| mean_numbers.get(&id).copied().unwrap_or(0.0);
        let columns = self.columns.iter().map(|column| (column, number(column.id)));
        let (known, unknown): (Vec<_>, Vec<_>) = columns.partition(|(c, _)| there[c.unit]);
        let mut stand_ins = Vec::new();
        for (column, own_number) in unknown {
            let unlike = |(other, its_number): &(&PlacedColumn, f64)| {
                let away = libm::hypot(other.at[0] - column.at[0], other.at[1] - column.at[1]);
                away / STAND_IN_ANGSTROM + (its_number - own_number).abs()
            };
            let best = known.iter().min_by(|a, b| unlike(a).total_cmp(&unlike(b)));
            let Some((other, _)) = best else { continue };
            let unit = &self.units[other.unit];
            let centre = plane::sub(plane::add(column.at, unit.centre), other.at);
            stand_ins.push((column.unit, PlacedUnit { centre, ..*unit }));
        }
        for (unit, stand_in) in stand_ins {
            self.units[unit] = stand_in;
        }
        self
    }

    /// Places (x, y) of the pixels in Angstrom of the full field, row by row.
    pub(crate) fn places(&self) -> &[[f64; 2]] {
        &self.places
    }

    /// The families of the units.
    pub(crate) fn families(&self) -> BTreeSet<TurnedFamily> {
        self.families.iter().copied().collect()
    }

    /// The library cells of each family.
    fn cells<'a>(&self, library: &'a ImageLibrary) -> Vec<Option<&'a CellImages>> {
        self.families.iter().map(|family| library.cell_images(*family)).collect()
    }

    /// Whether the library has the library cells of each unit.
    fn held_by(&self, library: &ImageLibrary) -> Vec<bool> {
        let cells = self.cells(library);
        let held = |unit: &PlacedUnit| unit.tag.is_some() && cells[unit.family].is_some();
        self.units.iter().map(held).collect()
    }

    /// The pixels that show units missing in the library, or no unit: their index, and the weight of what is missing.
    pub(crate) fn missing(&self, library: &ImageLibrary) -> HashMap<usize, f64> {
        let there = self.held_by(library);
        let mut missing = HashMap::new();
        let mut seen = vec![false; self.places.len()];
        for share in &self.shares {
            seen[share.pixel as usize] = true;
            if !there[share.unit as usize] {
                *missing.entry(share.pixel as usize).or_insert(0.0) += share.weight;
            }
        }
        // Far from all columns a pixel shows no unit.
        missing.extend((0..seen.len()).filter(|pixel| !seen[*pixel]).map(|pixel| (pixel, 1.0)));
        missing
    }

    /// The image on a detector, mean over the first `configurations`. The units that [`Assembly::missing`] reports add nothing.
    pub(crate) fn image(
        &self,
        (library, detector): (&ImageLibrary, usize),
        kernel: &Kernel,
        seed: u64,
        configurations: usize,
    ) -> Array2<f64> {
        let realisations = |cell: &CellImages, tag: &UnitTag| {
            let unit = UnitSeed { seed, id: tag.id };
            let mut own = cell.realisations(tag.entry, unit, library.configurations());
            own.truncate(configurations);
            own
        };
        let of_share = self.shares.iter().map(|share| share.unit as usize);
        let (starts, by_unit) = grouped(self.units.len(), of_share);
        let of_unit = |n: usize| by_unit[starts[n]..starts[n + 1]].iter().map(|s| &self.shares[*s]);
        let cells = self.cells(library);
        let patch = |n: usize| -> Vec<f64> {
            let unit = &self.units[n];
            let found = unit.tag.and_then(|tag| Some((tag, cells[unit.family]?)));
            let Some((tag, cell)) = found.filter(|_| starts[n] < starts[n + 1]) else {
                return vec![0.0; starts[n + 1] - starts[n]];
            };
            let offset = |share: &PixelShare| self.offset(share.pixel as usize, unit, &tag, cell);
            let offsets: Vec<[f64; 2]> = of_unit(n).map(offset).collect();
            unit_values((cell, detector), &realisations(cell, &tag), &offsets, kernel)
        };
        let units = 0..self.units.len();
        let values: Vec<Vec<f64>> = units.clone().into_par_iter().map(patch).collect();
        // The sum goes unit by unit, so that the bytes do not depend on the number of threads.
        let mut image = Array2::zeros(self.shape);
        let pixels = image.as_slice_mut().unwrap_or_default();
        for (n, values) in units.zip(&values) {
            for (share, value) in of_unit(n).zip(values) {
                pixels[share.pixel as usize] += share.weight * value;
            }
        }
        image
    }

    /// As [`Assembly::image`] on the first detector, but each unit shows the mean over all configurations of its own entry in the library,
    /// linear between dense samples ([`DenseMean`](super::dense_mean::DenseMean)). [`Assembly::image`] draws different configurations for
    /// each unit. Not suitable where the phonons of single columns matter.
    pub(crate) fn overview(&self, library: &ImageLibrary, kernel: &Kernel) -> Array2<f64> {
        let cells = self.cells(library);
        let shown = |unit: &PlacedUnit| {
            let (tag, cell) = (unit.tag?, cells[unit.family]?);
            let (library_cell, of_cell) = cell.locate(tag.entry);
            Some((tag, cell, cell.dense_mean(library_cell, kernel), cell.position(of_cell)))
        };
        let shown: Vec<_> = self.units.iter().map(shown).collect();
        let mut image = Array2::zeros(self.shape);
        let pixels = image.as_slice_mut().unwrap_or_default();
        for share in &self.shares {
            let unit = share.unit as usize;
            if let Some((tag, cell, mean, centre)) = &shown[unit] {
                let offset = self.offset(share.pixel as usize, &self.units[unit], tag, cell);
                pixels[share.pixel as usize] += share.weight * mean.at(plane::add(*centre, offset));
            }
        }
        image
    }

    /// The place of a pixel in the library cell, counted from the unit's centre, in samples (x, y).
    fn offset(
        &self,
        pixel: usize,
        unit: &PlacedUnit,
        tag: &UnitTag,
        cell: &CellImages,
    ) -> [f64; 2] {
        let d = plane::sub(self.places[pixel], unit.centre);
        // The inverse of an orthogonal matrix is its transpose.
        let [u, v] = tag.frame;
        plane::div(plane::add(u.map(|u| u * d[0]), v.map(|v| v * d[1])), cell.step_angstrom)
    }
}

/// Mean atomic number of the atoms of each column.
fn mean_numbers(found: &Sites) -> HashMap<u64, f64> {
    let mean = |column: &AtomColumn| {
        let atoms = found.sites[column.sites.clone()].iter();
        let atoms = atoms.filter(|site| site.kind != SiteKind::Vacancy);
        let (count, sum) =
            atoms.fold((0.0f64, 0.0), |(n, z), a| (n + 1.0, z + f64::from(a.number)));
        (column.id, sum / count.max(1.0))
    };
    found.columns.iter().map(mean).collect()
}

/// The columns around some pixels.
struct NearColumns {
    /// Square of the largest distance from a pixel to a column that it shows.
    within: f64,
    units: Vec<u32>,
    /// Positions of the columns, x and y.
    at: [Vec<f64>; 2],
    /// Squares of the columns' distances from a pixel.
    squares: Vec<f64>,
}

impl NearColumns {
    fn new(within: f64) -> Self {
        NearColumns {
            within: within * within,
            units: Vec::new(),
            at: Default::default(),
            squares: Vec::new(),
        }
    }

    fn set<'a>(&mut self, columns: impl Iterator<Item = &'a PlacedColumn>) {
        self.units.clear();
        self.at.iter_mut().for_each(Vec::clear);
        for PlacedColumn { unit, at, .. } in columns {
            self.units.push(*unit as u32);
            self.at.iter_mut().zip(at).for_each(|(list, v)| list.push(*v));
        }
        self.squares.resize(self.units.len(), 0.0);
    }

    /// Adds the columns' shares in a pixel at `at`, with ramps of this width (see [`RAMPS`]).
    fn push_shares(
        &mut self,
        pixel: usize,
        at: [f64; 2],
        ramps: f64,
        shares: &mut Vec<PixelShare>,
    ) {
        let (squares, [x, y]) = (&mut self.squares, &self.at);
        let least = vectorised(
            #[inline(always)]
            || {
                for ((square, x), y) in squares.iter_mut().zip(x).zip(y) {
                    let (dx, dy) = (at[0] - x, at[1] - y);
                    *square = dx * dx + dy * dy;
                }
                least(squares)
            },
        );
        if least > self.within {
            return;
        }
        let reach = least - 2.0 * ramps * LEAST_WEIGHT.ln();
        let start = shares.len();
        for (unit, &d2) in self.units.iter().zip(&*squares) {
            if d2 > reach {
                continue;
            }
            // Most pixels have one column only, whose weight is 1.
            let weight = if d2 == least { 1.0 } else { libm::exp(-(d2 - least) / (2.0 * ramps)) };
            // A unit's weight is the weight of its nearest column.
            match shares[start..].iter_mut().find(|s| s.unit == *unit) {
                Some(share) => share.weight = share.weight.max(weight),
                None => shares.push(PixelShare { pixel: pixel as u32, unit: *unit, weight }),
            }
        }
        let total: f64 = shares[start..].iter().map(|s| s.weight).sum();
        shares[start..].iter_mut().for_each(|s| s.weight /= total);
    }
}

/// The least of some numbers, found in several lanes at once.
#[inline(always)]
fn least(numbers: &[f64]) -> f64 {
    const LANES: usize = 8;
    let mut lanes = [f64::INFINITY; LANES];
    let mut chunks = numbers.chunks_exact(LANES);
    for chunk in &mut chunks {
        for (lane, number) in lanes.iter_mut().zip(chunk) {
            *lane = lesser(*lane, *number);
        }
    }
    chunks.remainder().iter().chain(&lanes).copied().fold(f64::INFINITY, lesser)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::specimen::repeating_units::SHARED_ANGSTROM2;

    #[test]
    fn units_that_are_cut_from_a_specimen_are_scanned_as_far_as_they_are_seen() {
        let weight = (-SHARED_ANGSTROM2 / (2.0 * RAMPS)).exp();
        assert!((LEAST_WEIGHT..2e-3).contains(&weight), "{weight}");
    }
}
