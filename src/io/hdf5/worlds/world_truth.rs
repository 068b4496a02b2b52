//! Reads a world's ground truth other than the sites: columns, boundaries, phases, particles.

use std::collections::{BTreeMap, HashMap};
use std::ops::Range;

use hdf5::{Dataset, Group};
use ndarray::{Array2, Ix2, IxDyn};

use super::schema::{self, CompositionText, MorphologyName};
use super::truth_writer::ParticleBatch;
use super::world_file::{GroundTruth, WorldFile};
use super::world_metadata::not_a_world;
use crate::error::Result;
use crate::io::atom_type;
use crate::io::hdf5::hdf5_guard::{number, text};
use crate::io::hdf5::hdf5_values::Plain;
use crate::structure::elements;

/// Number of sites that are read at a time.
const SITES_AT_ONCE: usize = 1 << 20;
/// In a file without columns, sites within this distance along x and y form one column, in nm.
const SAME_PLACE_NM: f64 = 0.002;
/// Largest distance of sites, columns and boundaries from the first pixel: 1 cm.
const FARTHEST_NM: f32 = 1e7;

/// An atomic column of a world.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct WorldColumn {
    /// Position (x, y) in nm from the centre of pixel (0, 0).
    pub position_nm: [f32; 2],
    /// Number of lattice sites.
    pub sites: i32,
    /// Number of vacant sites.
    pub vacancies: i32,
    /// Number of sites with another element.
    pub substitutions: i32,
    /// Atoms, `O25 Ti26`; empty if the file does not give them.
    pub composition: CompositionText,
}

/// A polyline between two grains or phases.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct BoundaryLine {
    /// Corners (x, y) in nm from the centre of pixel (0, 0).
    pub points_nm: Vec<[f32; 2]>,
    /// The parts that it separates: `grain boundary, 36.87 deg, Sigma 5`.
    pub text: String,
}

impl WorldFile {
    /// Reads all atomic columns. In a file of another program that does not list them, sites above each other form a column.
    ///
    /// # Errors
    /// [`crate::Error::Hdf5`] or [`crate::Error::Invalid`] for a damaged file.
    pub fn columns(&self) -> Result<Vec<WorldColumn>> {
        let name = format!("{}/{}", schema::TRUTH, schema::COLUMNS);
        if self.file.group(&name).is_err() {
            return self.columns_of_sites();
        }
        let dataset = |list: &str| self.dataset(&format!("{name}/{list}"));
        let counts = |list: &str| self.list::<i32>(&dataset(list)?, list);
        let positions: Array2<f32> = self.all(&dataset("position")?, "position")?;
        let (sites, vacancies) = (counts("number_of_sites")?, counts("vacancies")?);
        let substitutions = counts("substitutions")?;
        let n = positions.nrows();
        // Checked before compositions are made, which take the most memory.
        let alike = [sites.len(), vacancies.len(), substitutions.len()] == [n; 3];
        let compositions: Vec<CompositionText> =
            match self.file.link_exists(&format!("{name}/composition")) {
                true if alike => {
                    let texts =
                        self.dataset_of::<CompositionText>(&format!("{name}/composition"))?;
                    self.list(&texts, "composition")?
                }
                _ => vec![CompositionText::default(); if alike { n } else { 0 }],
            };
        if positions.ncols() != 2 || !alike || compositions.len() != n {
            return Err(not_a_world(&self.path, "has lists of columns of unequal length"));
        }
        self.check_places(positions.iter(), "columns")?;
        if let Some(odd) = compositions.iter().find(|c| !c.as_bytes().is_ascii()) {
            let found = String::from_utf8_lossy(odd.as_bytes()).into_owned();
            return Err(not_a_world(&self.path, format!("has the composition `{found}`")));
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

    /// Calls `visit` for each part of the list of sites, with the index of its first site and its sites.
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

    /// Reads the polylines between grains, (x, y) in nm.
    ///
    /// # Errors
    /// [`crate::Error::Hdf5`] for a damaged file.
    pub fn boundaries(&self) -> Result<Vec<Vec<[f32; 2]>>> {
        Ok(self.lines(schema::GRAIN_BOUNDARIES)?.into_iter().map(|l| l.points_nm).collect())
    }

    /// Reads the polylines between phases, (x, y) in nm.
    ///
    /// # Errors
    /// [`crate::Error::Hdf5`] for a damaged file.
    pub fn phase_boundaries(&self) -> Result<Vec<Vec<[f32; 2]>>> {
        Ok(self.lines(schema::PHASE_BOUNDARIES)?.into_iter().map(|l| l.points_nm).collect())
    }

    /// Reads all polylines, with the parts that they separate.
    ///
    /// # Errors
    /// [`crate::Error::Hdf5`] for a damaged file.
    pub fn boundary_lines(&self) -> Result<Vec<BoundaryLine>> {
        let mut lines = self.lines(schema::GRAIN_BOUNDARIES)?;
        lines.extend(self.lines(schema::PHASE_BOUNDARIES)?);
        lines.extend(self.lines(schema::FAULT_LINES)?);
        Ok(lines)
    }

    /// Reads the phase codes of some rows (y) and columns (x) of pixels, with the requested shape [rows, columns]; `None` in a world of one
    /// phase.
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
        self.part(&map, schema::PHASE_MAP, &[rows, columns]).map(Some)
    }

    /// Reads the names of the phases, in the order of their codes; empty if the file gives none.
    ///
    /// # Errors
    /// [`crate::Error::Invalid`] for a damaged file.
    pub fn phase_names(&self) -> Result<Vec<String>> {
        if !self.has_phases() {
            return Ok(Vec::new());
        }
        let map = self.truth_dataset(schema::PHASE_MAP)?;
        let codes = text(&map, "codes").unwrap_or_default();
        let name = |part: &str| part.split_once(' ').map_or("", |(_, name)| name).to_owned();
        Ok(codes.split(", ").filter(|part| !part.is_empty()).map(name).collect())
    }

    fn has_phases(&self) -> bool {
        self.file.link_exists(&format!("{}/{}", schema::TRUTH, schema::PHASE_MAP))
    }

    /// Reads the particles that reach into the image; empty in a world without particles.
    ///
    /// # Errors
    /// [`crate::Error::Hdf5`] for a damaged file.
    pub fn particles(&self) -> Result<ParticleBatch> {
        if self.truth_group(schema::PARTICLES).is_none() {
            return Ok(ParticleBatch::default());
        }
        let dataset = |list: &str| self.truth_dataset(&format!("{}/{list}", schema::PARTICLES));
        let rows = |list: &str| self.all::<f32, Ix2>(&dataset(list)?, list);
        let (centres, turns) = (rows("centre")?, rows("orientation")?);
        let diameters: Vec<f32> = self.list(&dataset("diameter")?, "diameter")?;
        let shapes = format!("{}/{}/morphology", schema::TRUTH, schema::PARTICLES);
        let morphologies: Vec<MorphologyName> =
            self.list(&self.dataset_of::<MorphologyName>(&shapes)?, "morphology")?;
        let n = diameters.len();
        if centres.dim() != (n, 3) || turns.dim() != (n, 4) || morphologies.len() != n {
            return Err(not_a_world(&self.path, "has lists of particles of unequal length"));
        }
        self.check_places(centres.iter().chain(&diameters), "particles")?;
        if morphologies.iter().any(|m| !m.as_bytes().is_ascii()) {
            return Err(not_a_world(&self.path, "has shapes of particles that are no ASCII text"));
        }
        Ok(ParticleBatch {
            centres: (0..n).map(|i| [0, 1, 2].map(|k| centres[(i, k)])).collect(),
            diameters,
            morphologies,
            orientations: (0..n).map(|i| [0, 1, 2, 3].map(|k| turns[(i, k)])).collect(),
        })
    }

    /// Refuses positions (nm) that are not finite, or impossibly far away.
    pub(super) fn check_places<'a>(
        &self,
        mut places: impl Iterator<Item = &'a f32>,
        of: &str,
    ) -> Result<()> {
        match places.find(|nm| nm.is_nan() || nm.abs() > FARTHEST_NM) {
            None => Ok(()),
            Some(nm) => {
                let found = format!("has {of} at {nm} nm, expected up to {FARTHEST_NM} nm");
                Err(not_a_world(&self.path, found))
            }
        }
    }

    /// Reads the values of a list of any shape.
    pub(super) fn list<T: Plain>(&self, dataset: &Dataset, name: &str) -> Result<Vec<T>> {
        Ok(self.all::<T, IxDyn>(dataset, name)?.into_iter().collect())
    }

    pub(super) fn truth_group(&self, name: &str) -> Option<Group> {
        self.file.group(&format!("{}/{name}", schema::TRUTH)).ok()
    }

    pub(super) fn lines(&self, group: &str) -> Result<Vec<BoundaryLine>> {
        let Some(lines) = self.truth_group(group) else { return Ok(Vec::new()) };
        let read = |n: u64| {
            let name = format!("{group}/{n}");
            let dataset = self.truth_dataset(&name)?;
            let shape = dataset.shape();
            if !matches!(shape[..], [_, 2]) {
                let found =
                    format!("has the polyline {name} of shape {shape:?}, expected (points, 2)");
                return Err(not_a_world(&self.path, found));
            }
            let points: Array2<f32> = self.all(&dataset, &name)?;
            self.check_places(points.iter(), "boundaries")?;
            let points_nm = points.rows().into_iter().map(|p| [p[0], p[1]]).collect();
            Ok(BoundaryLine { points_nm, text: describe(&dataset) })
        };
        (0..lines.len()).map(read).collect()
    }
}

fn describe(line: &Dataset) -> String {
    let number = |name: &str| number::<f64>(line, name);
    if let (Some(left), Some(right)) = (text(line, "left"), text(line, "right")) {
        return format!("phase boundary, {left} | {right}");
    }
    if let Some(kind) = text(line, "kind") {
        return kind.replace('_', " ");
    }
    let turn = number("misorientation_deg").map_or(String::new(), |t| format!(", {t:.2}\u{b0}"));
    let sigma = number("sigma").map_or(String::new(), |s| format!(", \u{3a3}{s}"));
    format!("grain boundary{turn}{sigma}")
}
