//! Writes the ground truth of an image: a group of the file, piece by piece.

use std::path::{Path, PathBuf};

use hdf5::{Dataset, Extents, File, Group, H5Type};
use ndarray::{Array3, ArrayView1, ArrayView2};

use super::schema::{self, CompositionText, DefectName, MorphologyName};
use super::world_writer::compressed;
use crate::error::Result;
use crate::io::atom_type;
use crate::io::hdf5::At;
use crate::io::hdf5::hdf5_create::{self, number, text};

/// Dataset of the places at which columns appear in a recording.
const APPEARANCES: &str = "position_in_image";
const APPEARANCE_ORIGIN: &str = "(x, y): x with the column, y with the row, from the centre of pixel (0, 0); the centre of mass of \
                                 a Gaussian of 0.4 A (at least one pixel) about the column, as the recording shows it";
/// Number of entries in a chunk.
const TRUTH_CHUNK: usize = 16_384;

/// The parts that a polyline of the ground truth separates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum LineKind<'a> {
    /// Two grains: rotation in degrees and coincidence index.
    Grains(f64, Option<u32>),
    /// Two phases: names left and right of it, and the width of the transition in nm.
    Phases([&'a str; 2], f64),
    /// A crystal before and beyond a planar fault.
    Fault {
        /// `twin`, `stacking_fault` or `antiphase`.
        kind: &'a str,
        /// Unit normal (x, y); the crystal on this side is mirrored or shifted.
        normal: [f64; 2],
        /// Shift (x, y, z) in nm.
        shift_nm: [f64; 3],
    },
}

/// Particles, entry by entry.
#[derive(Debug, Clone, Default)]
pub struct ParticleBatch {
    /// Centres (x, y, z) in nm.
    pub centres: Vec<[f32; 3]>,
    /// Diameters in nm.
    pub diameters: Vec<f32>,
    /// Shapes.
    pub morphologies: Vec<MorphologyName>,
    /// Unit quaternions (w, x, y, z).
    pub orientations: Vec<[f32; 4]>,
}

/// Sites of some columns, in the order of the file.
#[derive(Debug, Clone, Default)]
pub(crate) struct TruthBatch {
    /// Positions (x, y) in nm.
    pub positions: Vec<[f32; 2]>,
    /// Depth below the entrance surface in nm.
    pub z: Vec<f32>,
    /// Codes of [`atom_type`].
    pub types: Vec<i32>,
    /// Whether each site is a defect.
    pub defects: Vec<bool>,
    /// Atomic numbers.
    pub numbers: Vec<i32>,
    /// Names of the defects.
    pub defect_names: Vec<DefectName>,
    /// Index of the column of each site.
    pub columns: Vec<i32>,
    /// Position (x, y) of each column in nm.
    pub column_positions: Vec<[f32; 2]>,
    /// Sites, vacancies and substitutions of each column.
    pub column_counts: [Vec<i32>; 3],
    /// Composition of each column.
    pub column_compositions: Vec<CompositionText>,
}

/// The ground truth of a file that is being written.
pub(crate) struct TruthWriter {
    pub(super) path: PathBuf,
    /// Shape [rows, columns] of the image, and of the chunks of datasets with that shape.
    shape: [[usize; 2]; 2],
    pub(super) group: Group,
    site_pairs: Dataset,
    z: Dataset,
    types: Dataset,
    defects: Dataset,
    numbers: Dataset,
    defect_names: Dataset,
    columns: Dataset,
    column_pairs: Dataset,
    column_counts: [Dataset; 3],
    column_compositions: Dataset,
    grain_boundaries: Group,
    phase_boundaries: Group,
}

impl TruthWriter {
    /// Creates the group in a file; its image has `shape[0]` rows and columns, in chunks of `shape[1]`.
    pub(super) fn create(file: &File, path: &Path, shape: [[usize; 2]; 2]) -> hdf5::Result<Self> {
        let group = hdf5_create::group(file, schema::TRUTH)?;
        let columns = hdf5_create::group(&group, schema::COLUMNS)?;
        let list = (0..).into();
        let truth = TruthWriter {
            path: path.to_owned(),
            shape,
            site_pairs: position_list(&group, "atom_positions")?,
            z: growing::<f32>(&group, "atom_z", &list)?,
            types: growing::<i32>(&group, "atom_types", &list)?,
            defects: growing::<bool>(&group, "defect_mask", &list)?,
            numbers: growing::<i32>(&group, "atomic_numbers", &list)?,
            defect_names: growing::<DefectName>(&group, "defect_types", &list)?,
            columns: growing::<i32>(&group, "atom_columns", &list)?,
            column_pairs: position_list(&columns, "position")?,
            column_counts: [
                growing::<i32>(&columns, "number_of_sites", &list)?,
                growing::<i32>(&columns, "vacancies", &list)?,
                growing::<i32>(&columns, "substitutions", &list)?,
            ],
            column_compositions: growing::<CompositionText>(&columns, "composition", &list)?,
            grain_boundaries: hdf5_create::group(&group, schema::GRAIN_BOUNDARIES)?,
            phase_boundaries: hdf5_create::group(&group, schema::PHASE_BOUNDARIES)?,
            group,
        };
        text(&truth.z, "unit", "nm")?;
        text(&truth.z, "origin", "entrance surface; the beam runs along +z")?;
        text(&truth.types, "codes", "0 pristine, 1 vacancy, 2 substitution")?;
        text(&truth.numbers, "vacancies", "the element that is missing")?;
        text(&truth.columns, "refers_to", "rows of columns/*")?;
        text(&truth.group, "listing", "all lattice sites of the columns that lie in the field")?;
        Ok(truth)
    }

    fn append_lists(&self, b: &TruthBatch) -> hdf5::Result<()> {
        append_pairs(&self.site_pairs, &b.positions)?;
        append(&self.z, &b.z)?;
        append(&self.types, &b.types)?;
        append(&self.defects, &b.defects)?;
        append(&self.numbers, &b.numbers)?;
        append(&self.defect_names, &b.defect_names)?;
        append(&self.columns, &b.columns)?;
        append_pairs(&self.column_pairs, &b.column_positions)?;
        for (dataset, counts) in self.column_counts.iter().zip(&b.column_counts) {
            append(dataset, counts)?;
        }
        append(&self.column_compositions, &b.column_compositions)
    }

    /// Appends sites and columns.
    ///
    /// # Errors
    /// [`crate::Error::Hdf5`].
    pub(crate) fn append(&self, batch: &TruthBatch) -> Result<()> {
        self.append_lists(batch).at(&self.path)
    }

    /// Writes sites of which only the position (x, y) in nm is known: all pristine. Lists of unknown properties are removed.
    ///
    /// # Errors
    /// [`crate::Error::Hdf5`].
    pub(crate) fn places_alone(&self, positions_nm: &[[f32; 2]]) -> Result<()> {
        let count = positions_nm.len();
        let write = || {
            append_pairs(&self.site_pairs, positions_nm)?;
            append(&self.types, &vec![atom_type::PRISTINE; count])?;
            append(&self.defects, &vec![false; count])?;
            append(&self.defect_names, &vec![DefectName::default(); count])?;
            ["atom_z", "atomic_numbers", "atom_columns", schema::COLUMNS]
                .iter()
                .try_for_each(|name| self.group.unlink(name))?;
            self.group.delete_attr("listing")?;
            text(&self.group, "listing", "places that the recorded file lists")
        };
        write().at(&self.path)
    }

    /// Writes the properties of each site in a recorded file: a vector, in its units, and intensities with their names.
    ///
    /// # Errors
    /// [`crate::Error::Hdf5`].
    pub(crate) fn unit_cells(
        &self,
        polarisations: &[[f32; 2]],
        intensities: &[(String, Vec<f32>)],
    ) -> Result<()> {
        let write = || {
            let group = hdf5_create::group(&self.group, schema::UNIT_CELLS)?;
            text(&group, "refers_to", "rows of atom_positions")?;
            if !polarisations.is_empty() {
                let builder = group.new_dataset_builder().with_data(rows(polarisations)?);
                let dataset = builder.create("polarisation")?;
                text(
                    &dataset,
                    "axes",
                    "(x, y): x with the column, y with the row; unit of the recorded file",
                )?;
            }
            for (name, values) in intensities {
                group.new_dataset_builder().with_data(values).create(name.as_str())?;
            }
            Ok(())
        };
        write().at(&self.path)
    }

    /// Appends the places at which columns appear in a recording: (x, y) in pixels from the centre of the first.
    ///
    /// # Errors
    /// [`crate::Error::Hdf5`].
    pub(crate) fn append_appearances(&self, places_px: &[[f32; 2]]) -> Result<()> {
        let write = || {
            let columns = self.group.group(schema::COLUMNS)?;
            let places = match columns.dataset(APPEARANCES) {
                Ok(places) => places,
                Err(_) => {
                    let chunk = [TRUTH_CHUNK, 2];
                    let places = compressed::<f32>(&columns, APPEARANCES, (0.., 2).into(), &chunk)?;
                    text(&places, "unit", "px")?;
                    text(&places, "origin", APPEARANCE_ORIGIN)?;
                    places
                }
            };
            append_pairs(&places, places_px)
        };
        write().at(&self.path)
    }

    /// Writes the places at which columns appear in each frame of a recording: (frame, column, 2).
    ///
    /// # Errors
    /// [`crate::Error::Hdf5`].
    pub(crate) fn appearances_of_frames(&self, places_px: &Array3<f64>) -> Result<()> {
        let write = || {
            let columns = self.group.group(schema::COLUMNS)?;
            let data = places_px.mapv(|v| v as f32);
            let places = columns.new_dataset_builder().with_data(&data).create(APPEARANCES)?;
            text(&places, "unit", "px")?;
            text(&places, "origin", APPEARANCE_ORIGIN)
        };
        write().at(&self.path)
    }

    /// Writes the drift of the specimen: time in s, and (x, y) in nm, of each line.
    ///
    /// # Errors
    /// [`crate::Error::Hdf5`].
    pub(crate) fn drift(&self, lines: &[[f64; 3]]) -> Result<()> {
        let write = || {
            let data = ArrayView2::from_shape((lines.len(), 3), lines.as_flattened())
                .map_err(|e| hdf5::Error::Internal(e.to_string()))?;
            let drift = self.group.new_dataset_builder().with_data(data).create("drift")?;
            let columns =
                "time in s, drift of the specimen along x and y in nm, when each line begins";
            text(&drift, "columns", columns)
        };
        write().at(&self.path)
    }

    /// Adds a polyline between two grains or phases.
    ///
    /// # Errors
    /// [`crate::Error::Hdf5`].
    pub(crate) fn boundary(&self, line: &[[f32; 2]], kind: LineKind) -> Result<()> {
        let write = || {
            let group = match kind {
                LineKind::Grains(..) => self.grain_boundaries.clone(),
                LineKind::Phases(..) => self.phase_boundaries.clone(),
                LineKind::Fault { .. } => match self.group.link_exists(schema::FAULT_LINES) {
                    true => self.group.group(schema::FAULT_LINES)?,
                    false => hdf5_create::group(&self.group, schema::FAULT_LINES)?,
                },
            };
            let view = rows(line)?;
            let builder = group.new_dataset_builder().with_data(view);
            let dataset = builder.create(group.len().to_string().as_str())?;
            text(&dataset, "unit", "nm")?;
            match kind {
                LineKind::Grains(degrees, sigma) => {
                    number(&dataset, "misorientation_deg", degrees)?;
                    sigma.map_or(Ok(()), |s| number(&dataset, "sigma", s))
                }
                LineKind::Phases([left, right], sigma_nm) => {
                    text(&dataset, "left", left)?;
                    text(&dataset, "right", right)?;
                    number(&dataset, "sharpness_sigma_nm", sigma_nm)
                }
                LineKind::Fault { kind, normal, shift_nm } => {
                    text(&dataset, "kind", kind)?;
                    dataset.new_attr_builder().with_data(&normal).create("normal")?;
                    dataset.new_attr_builder().with_data(&shift_nm).create("shift_nm").map(drop)
                }
            }
        };
        write().at(&self.path)
    }

    /// Adds the phase map, to be filled row by row; `phases` are the names of its codes.
    ///
    /// # Errors
    /// [`crate::Error::Hdf5`].
    pub(crate) fn create_phase_map(&self, phases: &[String]) -> Result<()> {
        let write = || {
            let ([shape, chunk], name) = (self.shape, schema::PHASE_MAP);
            let map = compressed::<i32>(&self.group, name, shape.into(), &chunk)?;
            let codes: Vec<String> =
                phases.iter().enumerate().map(|(code, name)| format!("{code} {name}")).collect();
            text(&map, "codes", &codes.join(", "))
        };
        write().at(&self.path)
    }

    /// Writes rows of the phase map, from row `first`.
    ///
    /// # Errors
    /// [`crate::Error::Hdf5`].
    pub(crate) fn phase_rows(&self, first: usize, rows: ArrayView2<i32>) -> Result<()> {
        let write = || {
            let map = self.group.dataset(schema::PHASE_MAP)?;
            map.write_slice(rows, ndarray::s![first..first + rows.nrows(), ..])
        };
        write().at(&self.path)
    }

    /// Writes the centres (x, y) of clusters of vacancies in nm, from the centre of pixel (0, 0), shape (clusters, 2).
    ///
    /// # Errors
    /// [`crate::Error::Hdf5`].
    pub(crate) fn clusters(&self, centres_nm: &[[f32; 2]]) -> Result<()> {
        let write = || {
            let list = position_list(&self.group, schema::CLUSTER_POSITIONS)?;
            list.resize((centres_nm.len(), 2))?;
            list.write(&rows(centres_nm)?)
        };
        write().at(&self.path)
    }

    /// Writes all particles.
    ///
    /// # Errors
    /// [`crate::Error::Hdf5`].
    pub(crate) fn particles(&self, particles: &ParticleBatch) -> Result<()> {
        let write = || {
            let group = hdf5_create::group(&self.group, schema::PARTICLES)?;
            let new = || group.new_dataset_builder();
            let centres = new().with_data(rows(&particles.centres)?).create("centre")?;
            text(&centres, "unit", "nm")?;
            text(
                &centres,
                "axes",
                "(x, y, z): x with the column, y with the row, z with the beam",
            )?;
            let diameters = new().with_data(&particles.diameters).create("diameter")?;
            text(&diameters, "unit", "nm")?;
            new().with_data(&particles.morphologies).create("morphology")?;
            let turns = new().with_data(rows(&particles.orientations)?).create("orientation")?;
            text(
                &turns,
                "components",
                "unit quaternion (w, x, y, z) from the particle to the field",
            )
        };
        write().at(&self.path)
    }
}

fn position_list(group: &Group, name: &str) -> hdf5::Result<Dataset> {
    let dataset = compressed::<f32>(group, name, (0.., 2).into(), &[TRUTH_CHUNK, 2])?;
    text(&dataset, "unit", "nm")?;
    text(
        &dataset,
        "origin",
        "(x, y): x with the column, y with the row, from the centre of pixel (0, 0)",
    )?;
    Ok(dataset)
}

pub(super) fn growing<T: H5Type>(
    group: &Group,
    name: &str,
    shape: &Extents,
) -> hdf5::Result<Dataset> {
    compressed::<T>(group, name, shape.clone(), &[TRUTH_CHUNK])
}

pub(super) fn append<T: H5Type>(dataset: &Dataset, values: &[T]) -> hdf5::Result<()> {
    let start = dataset.shape().first().copied().unwrap_or(0);
    if values.is_empty() {
        return Ok(());
    }
    dataset.resize(start + values.len())?;
    dataset.write_slice(ArrayView1::from(values), start..start + values.len())
}

fn append_pairs(dataset: &Dataset, values: &[[f32; 2]]) -> hdf5::Result<()> {
    let start = dataset.shape().first().copied().unwrap_or(0);
    if values.is_empty() {
        return Ok(());
    }
    dataset.resize((start + values.len(), 2))?;
    dataset.write_slice(rows(values)?, ndarray::s![start..start + values.len(), ..])
}

fn rows<const N: usize>(values: &[[f32; N]]) -> hdf5::Result<ArrayView2<'_, f32>> {
    ArrayView2::from_shape((values.len(), N), values.as_flattened())
        .map_err(|e| hdf5::Error::Internal(e.to_string()))
}
