//! What a world's ground truth says beside the sites: columns, boundaries, phases, particles.

use std::collections::{BTreeMap, HashMap};
use std::ops::Range;

use hdf5::types::VarLenUnicode;
use hdf5::{Dataset, Group};
use ndarray::{Array2, s};

use super::At;
use super::schema::{self, CompositionText, atom_type};
use super::world_file::{GroundTruth, WorldFile, not_a_world};
use super::world_writer::ParticleBatch;
use crate::error::Result;
use crate::structure::elements;

/// Sites that are read at a time.
const SITES_AT_ONCE: usize = 1 << 20;
/// In a file without columns, sites that lie this near to each other along x and y are one, in nm.
const SAME_PLACE_NM: f64 = 0.002;

/// An atomic column of a world.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct WorldColumn {
    /// (x, y) in nm from the centre of pixel (0, 0).
    pub position_nm: [f32; 2],
    /// Lattice sites.
    pub sites: i32,
    /// Vacant ones.
    pub vacancies: i32,
    /// Those with another element.
    pub substitutions: i32,
    /// Atoms, `O25 Ti26`; empty where the file does not tell.
    pub composition: CompositionText,
}

/// A polyline between two grains or phases.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct BoundaryLine {
    /// (x, y) in nm from the centre of pixel (0, 0).
    pub points_nm: Vec<[f32; 2]>,
    /// What it separates: `grain boundary, 36.87 deg, Sigma 5`.
    pub text: String,
}

impl WorldFile {
    /// All atomic columns. In a file of another program that does not list them, sites above each
    /// other are a column.
    ///
    /// # Errors
    /// [`crate::Error::Hdf5`] or [`crate::Error::Invalid`] for a damaged file.
    pub fn columns(&self) -> Result<Vec<WorldColumn>> {
        let name = format!("{}/{}", schema::TRUTH, schema::COLUMNS);
        let Ok(group) = self.file.group(&name) else { return self.columns_of_sites() };
        type Lists = (Array2<f32>, [Vec<i32>; 3], Vec<CompositionText>);
        let read = || -> hdf5::Result<Lists> {
            let list = |name| group.dataset(name)?.read_raw::<i32>();
            let counts = [list("number_of_sites")?, list("vacancies")?, list("substitutions")?];
            let compositions = match group.link_exists("composition") {
                true => group.dataset("composition")?.read_raw()?,
                false => vec![CompositionText::default(); counts[0].len()],
            };
            Ok((group.dataset("position")?.read_2d()?, counts, compositions))
        };
        let (positions, [sites, vacancies, substitutions], compositions) = read().at(&self.path)?;
        let n = positions.nrows();
        let lengths = [sites.len(), vacancies.len(), substitutions.len(), compositions.len()];
        if positions.ncols() != 2 || lengths != [n; 4] {
            return Err(not_a_world(&self.path, "has lists of columns of unequal length"));
        }
        let column = |i: usize| WorldColumn {
            position_nm: [positions[(i, 0)], positions[(i, 1)]],
            sites: sites[i],
            vacancies: vacancies[i],
            substitutions: substitutions[i],
            composition: compositions[i],
        };
        Ok((0..n).map(column).collect())
    }

    fn columns_of_sites(&self) -> Result<Vec<WorldColumn>> {
        let mut columns: Vec<WorldColumn> = Vec::new();
        let mut contents: Vec<BTreeMap<i32, usize>> = Vec::new();
        let mut places: HashMap<[i64; 2], usize> = HashMap::new();
        self.for_each_chunk_of_sites(|_, truth| {
            for (i, position) in truth.positions.iter().enumerate() {
                let place = position.map(|v| (f64::from(v) / SAME_PLACE_NM).round() as i64);
                let index = *places.entry(place).or_insert(columns.len());
                if index == columns.len() {
                    columns.push(WorldColumn {
                        position_nm: *position,
                        sites: 0,
                        vacancies: 0,
                        substitutions: 0,
                        composition: CompositionText::default(),
                    });
                    contents.push(BTreeMap::new());
                }
                let column = &mut columns[index];
                column.sites += 1;
                column.vacancies += i32::from(truth.types[i] == atom_type::VACANCY);
                column.substitutions += i32::from(truth.types[i] == atom_type::SUBSTITUTION);
                if let (Some(z), true) =
                    (truth.numbers.get(i), truth.types[i] != atom_type::VACANCY)
                {
                    *contents[index].entry(*z).or_default() += 1;
                }
            }
        })?;
        for (column, atoms) in columns.iter_mut().zip(&contents) {
            let symbol = |z: i32| u8::try_from(z).map_or("?", elements::symbol);
            let parts: Vec<String> =
                atoms.iter().map(|(z, n)| format!("{}{n}", symbol(*z))).collect();
            column.composition = CompositionText::from_ascii(&parts.join(" ")).unwrap_or_default();
        }
        Ok(columns)
    }

    /// Calls `visit` with the index of the first and the sites of each part of the list of sites.
    ///
    /// # Errors
    /// As [`WorldFile::truth`].
    pub fn for_each_chunk_of_sites(
        &self,
        mut visit: impl FnMut(usize, &GroundTruth),
    ) -> Result<()> {
        let count = self.site_count()?;
        for first in (0..count).step_by(SITES_AT_ONCE) {
            visit(first, &self.truth(first..count.min(first + SITES_AT_ONCE))?);
        }
        Ok(())
    }

    /// Polylines between grains, (x, y) in nm.
    ///
    /// # Errors
    /// [`crate::Error::Hdf5`] for a damaged file.
    pub fn boundaries(&self) -> Result<Vec<Vec<[f32; 2]>>> {
        Ok(self.lines(schema::GRAIN_BOUNDARIES)?.into_iter().map(|l| l.points_nm).collect())
    }

    /// Polylines between phases, (x, y) in nm.
    ///
    /// # Errors
    /// [`crate::Error::Hdf5`] for a damaged file.
    pub fn phase_boundaries(&self) -> Result<Vec<Vec<[f32; 2]>>> {
        Ok(self.lines(schema::PHASE_BOUNDARIES)?.into_iter().map(|l| l.points_nm).collect())
    }

    /// All polylines, with what they separate.
    ///
    /// # Errors
    /// [`crate::Error::Hdf5`] for a damaged file.
    pub fn boundary_lines(&self) -> Result<Vec<BoundaryLine>> {
        let mut lines = self.lines(schema::GRAIN_BOUNDARIES)?;
        lines.extend(self.lines(schema::PHASE_BOUNDARIES)?);
        Ok(lines)
    }

    /// Code of the phase of each pixel of some rows (y) and columns (x), with the shape (rows, columns)
    /// asked for; `None` in a world of one phase.
    ///
    /// # Errors
    /// [`crate::Error::Hdf5`] outside the image, or for a damaged file.
    pub fn phase_map(
        &self,
        rows: Range<usize>,
        columns: Range<usize>,
    ) -> Result<Option<Array2<i32>>> {
        if !self.has_phases() {
            return Ok(None);
        }
        let map = self.truth_dataset(schema::PHASE_MAP)?;
        let [height, width] = self.shape();
        if map.shape() != [height, width] {
            let found = format!(
                "has a phase map of shape {:?}, and an image of {height} x {width} pixels",
                map.shape()
            );
            return Err(not_a_world(&self.path, found));
        }
        map.read_slice_2d(s![rows, columns]).map(Some).at(&self.path)
    }

    /// Names of the phases by their codes; empty where the file gives none.
    ///
    /// # Errors
    /// [`crate::Error::Invalid`] for a damaged file.
    pub fn phase_names(&self) -> Result<Vec<String>> {
        if !self.has_phases() {
            return Ok(Vec::new());
        }
        let map = self.truth_dataset(schema::PHASE_MAP)?;
        let text = attribute(&map, "codes").unwrap_or_default();
        let name = |part: &str| part.split_once(' ').map_or("", |(_, name)| name).to_owned();
        Ok(text.split(", ").filter(|part| !part.is_empty()).map(name).collect())
    }

    fn has_phases(&self) -> bool {
        self.file.link_exists(&format!("{}/{}", schema::TRUTH, schema::PHASE_MAP))
    }

    /// Particles that reach into the image; none in a world without.
    ///
    /// # Errors
    /// [`crate::Error::Hdf5`] for a damaged file.
    pub fn particles(&self) -> Result<ParticleBatch> {
        let Some(group) = self.truth_group(schema::PARTICLES) else {
            return Ok(ParticleBatch::default());
        };
        let read = || -> hdf5::Result<ParticleBatch> {
            let centres: Array2<f32> = group.dataset("centre")?.read_2d()?;
            let turns: Array2<f32> = group.dataset("orientation")?.read_2d()?;
            let at =
                |a: &Array2<f32>, i: usize, k: usize| a.get((i, k)).copied().unwrap_or(f32::NAN);
            Ok(ParticleBatch {
                centres: (0..centres.nrows())
                    .map(|i| [0, 1, 2].map(|k| at(&centres, i, k)))
                    .collect(),
                diameters: group.dataset("diameter")?.read_raw()?,
                morphologies: group.dataset("morphology")?.read_raw()?,
                orientations: (0..turns.nrows())
                    .map(|i| [0, 1, 2, 3].map(|k| at(&turns, i, k)))
                    .collect(),
            })
        };
        read().at(&self.path)
    }

    fn truth_group(&self, name: &str) -> Option<Group> {
        self.file.group(&format!("{}/{name}", schema::TRUTH)).ok()
    }

    fn lines(&self, group: &str) -> Result<Vec<BoundaryLine>> {
        let Some(group) = self.truth_group(group) else { return Ok(Vec::new()) };
        let read = |n: u64| -> hdf5::Result<BoundaryLine> {
            let dataset = group.dataset(&n.to_string())?;
            let points: Array2<f32> = dataset.read_2d()?;
            let points_nm = points.rows().into_iter().map(|p| [p[0], p[1]]).collect();
            Ok(BoundaryLine { points_nm, text: describe(&dataset) })
        };
        (0..group.len()).map(read).collect::<hdf5::Result<_>>().at(&self.path)
    }
}

fn describe(line: &Dataset) -> String {
    let number = |name: &str| line.attr(name).and_then(|a| a.read_scalar::<f64>()).ok();
    if let (Some(left), Some(right)) = (attribute(line, "left"), attribute(line, "right")) {
        return format!("phase boundary, {left} | {right}");
    }
    let turn = number("misorientation_deg").map_or(String::new(), |t| format!(", {t:.2}\u{b0}"));
    let sigma = number("sigma").map_or(String::new(), |s| format!(", \u{3a3}{s}"));
    format!("grain boundary{turn}{sigma}")
}

fn attribute(at: &hdf5::Location, name: &str) -> Option<String> {
    let text: VarLenUnicode = at.attr(name).and_then(|a| a.read_scalar()).ok()?;
    Some(text.as_str().to_owned())
}
