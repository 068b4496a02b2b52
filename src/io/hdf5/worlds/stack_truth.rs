//! The ground truth of stacks: layers, dislocations, planar faults, and the distance of each column from the nearest interface.

use hdf5::types::FixedAscii;
use ndarray::{Array1, ArrayView2, Ix2};

use super::schema;
use super::truth_writer::{TruthWriter, append, growing};
use super::world_file::WorldFile;
use super::world_metadata::not_a_world;
use crate::error::Result;
use crate::io::hdf5::hdf5_create::text;
use crate::io::hdf5::{At, hdf5_create};

/// Name of the list of angles by which layers are turned.
const TURN: &str = "turn";
/// Name of a phase in the list of layers.
type PhaseName = FixedAscii<32>;
const HEIGHT_ORIGIN: [&str; 3] = [
    "x from the centre of pixel (0, 0)",
    "y from the centre of pixel (0, 0)",
    "z from the entrance surface; the beam runs along +z",
];

/// A layer of a stack.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct LayerRow {
    /// Name of its phase.
    pub phase: String,
    /// Heights at which it begins and ends, without roughness, in nm; infinite where it continues beyond the field.
    pub range_nm: [f32; 2],
    /// Strain along x, y and z.
    pub strain: [f32; 3],
    /// Angle in degrees from +x to +y by which the layer is turned about the beam.
    pub turn_deg: f32,
}

impl LayerRow {
    /// Makes a row of the list of layers.
    pub fn new(phase: &str, range_nm: [f32; 2], strain: [f32; 3], turn_deg: f32) -> Self {
        LayerRow { phase: phase.to_owned(), range_nm, strain, turn_deg }
    }
}

/// A dislocation along the beam.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct DislocationRow {
    /// Place (x, y) of the line in nm from the centre of pixel (0, 0).
    pub position_nm: [f32; 2],
    /// Burgers vector (x, y, z) in nm.
    pub burgers_nm: [f32; 3],
}

impl DislocationRow {
    /// Makes a row of the list of dislocations.
    pub fn new(position_nm: [f32; 2], burgers_nm: [f32; 3]) -> Self {
        DislocationRow { position_nm, burgers_nm }
    }
}

impl TruthWriter {
    /// Writes the layers of a stack along `axis` (0 is x).
    ///
    /// # Errors
    /// [`crate::Error::Hdf5`].
    pub fn layers(&self, layers: &[LayerRow], axis: usize) -> Result<()> {
        let write = || {
            let group = hdf5_create::group(&self.group, schema::LAYERS)?;
            text(&group, "along", ["x", "y", "z"][axis])?;
            let phase = |row: &LayerRow| PhaseName::from_ascii(&row.phase).unwrap_or_default();
            let names = Array1::from_iter(layers.iter().map(phase));
            group.new_dataset_builder().with_data(&names).create("phase")?;
            let ranges: Vec<[f32; 2]> = layers.iter().map(|row| row.range_nm).collect();
            let range = group.new_dataset_builder().with_data(rows(&ranges)?).create("range")?;
            text(&range, "unit", "nm")?;
            text(&range, "origin", HEIGHT_ORIGIN[axis])?;
            let strains: Vec<[f32; 3]> = layers.iter().map(|row| row.strain).collect();
            let strain = group.new_dataset_builder().with_data(rows(&strains)?).create("strain")?;
            text(
                &strain,
                "axes",
                "(x, y, z); (length in the layer) / (length in the crystal's file) - 1",
            )?;
            if layers.iter().all(|row| row.turn_deg == 0.0) {
                return Ok(());
            }
            let turns = Array1::from_iter(layers.iter().map(|row| row.turn_deg));
            let turn = group.new_dataset_builder().with_data(&turns).create(TURN)?;
            text(&turn, "unit", "degree")?;
            text(&turn, "sense", "from +x to +y about the middle of the field")
        };
        write().at(&self.path)
    }

    /// Writes the dislocations of a stack.
    ///
    /// # Errors
    /// [`crate::Error::Hdf5`].
    pub fn dislocations(&self, list: &[DislocationRow]) -> Result<()> {
        let write = || {
            let group = hdf5_create::group(&self.group, schema::DISLOCATIONS)?;
            let places: Vec<[f32; 2]> = list.iter().map(|row| row.position_nm).collect();
            let position =
                group.new_dataset_builder().with_data(rows(&places)?).create("position")?;
            text(&position, "unit", "nm")?;
            text(
                &position,
                "origin",
                "(x, y): x with the column, y with the row, from the centre of pixel (0, 0); the line runs along the beam",
            )?;
            let vectors: Vec<[f32; 3]> = list.iter().map(|row| row.burgers_nm).collect();
            let burgers =
                group.new_dataset_builder().with_data(rows(&vectors)?).create("burgers")?;
            text(&burgers, "unit", "nm")?;
            text(
                &burgers,
                "sense",
                "the displacement gained on a circuit about the line from +x to +y",
            )
        };
        write().at(&self.path)
    }

    /// Appends the distances of columns from the nearest interface in nm, in the order of the columns.
    ///
    /// # Errors
    /// [`crate::Error::Hdf5`].
    pub fn append_interface_distances(&self, distances_nm: &[f32]) -> Result<()> {
        let write = || {
            let columns = self.group.group(schema::COLUMNS)?;
            let list = match columns.link_exists(schema::INTERFACE_DISTANCE) {
                true => columns.dataset(schema::INTERFACE_DISTANCE)?,
                false => {
                    let list = growing::<f32>(&columns, schema::INTERFACE_DISTANCE, &(0..).into())?;
                    text(&list, "unit", "nm")?;
                    list
                }
            };
            append(&list, distances_nm)
        };
        write().at(&self.path)
    }
}

fn rows<const N: usize>(values: &[[f32; N]]) -> hdf5::Result<ArrayView2<'_, f32>> {
    ArrayView2::from_shape((values.len(), N), values.as_flattened())
        .map_err(|e| hdf5::Error::Internal(e.to_string()))
}

impl WorldFile {
    /// Reads the lines of planar faults, (x, y) in nm.
    ///
    /// # Errors
    /// [`crate::Error::Hdf5`] for a damaged file.
    pub fn fault_lines(&self) -> Result<Vec<Vec<[f32; 2]>>> {
        Ok(self.lines(schema::FAULT_LINES)?.into_iter().map(|l| l.points_nm).collect())
    }

    /// Reads the dislocations; empty in a world without any.
    ///
    /// # Errors
    /// [`crate::Error::Hdf5`] or [`crate::Error::Invalid`] for a damaged file.
    pub fn dislocations(&self) -> Result<Vec<DislocationRow>> {
        if self.truth_group(schema::DISLOCATIONS).is_none() {
            return Ok(Vec::new());
        }
        let read = |list: &str| {
            let name = format!("{}/{list}", schema::DISLOCATIONS);
            self.all::<f32, Ix2>(&self.truth_dataset(&name)?, &name)
        };
        let (places, vectors) = (read("position")?, read("burgers")?);
        let n = places.nrows();
        if places.dim() != (n, 2) || vectors.dim() != (n, 3) {
            return Err(not_a_world(&self.path, "has lists of dislocations of unequal length"));
        }
        self.check_places(places.iter().chain(&vectors), "dislocations")?;
        let row = |i: usize| DislocationRow {
            position_nm: [places[(i, 0)], places[(i, 1)]],
            burgers_nm: [0, 1, 2].map(|k| vectors[(i, k)]),
        };
        Ok((0..n).map(row).collect())
    }

    /// Reads the layers of a stack; empty in other worlds.
    ///
    /// # Errors
    /// [`crate::Error::Hdf5`] or [`crate::Error::Invalid`] for a damaged file.
    pub fn layers(&self) -> Result<Vec<LayerRow>> {
        if self.truth_group(schema::LAYERS).is_none() {
            return Ok(Vec::new());
        }
        let read = |list: &str| {
            let name = format!("{}/{list}", schema::LAYERS);
            self.all::<f32, Ix2>(&self.truth_dataset(&name)?, &name)
        };
        let names = format!("{}/{}/phase", schema::TRUTH, schema::LAYERS);
        let phases: Vec<PhaseName> = self.list(&self.dataset_of::<PhaseName>(&names)?, "phase")?;
        let (ranges, strains) = (read("range")?, read("strain")?);
        let n = phases.len();
        // Only files with turned layers have the list.
        let turns = format!("{}/{TURN}", schema::LAYERS);
        let turns: Vec<f32> = match self.truth_dataset(&turns) {
            Ok(dataset) => self.list(&dataset, TURN)?,
            Err(_) => vec![0.0; n],
        };
        if ranges.dim() != (n, 2) || strains.dim() != (n, 3) || turns.len() != n {
            return Err(not_a_world(&self.path, "has lists of layers of unequal length"));
        }
        if phases.iter().any(|name| !name.as_bytes().is_ascii()) {
            return Err(not_a_world(&self.path, "has names of layers that are no ASCII text"));
        }
        let row = |i: usize| LayerRow {
            phase: phases[i].as_str().to_owned(),
            range_nm: [ranges[(i, 0)], ranges[(i, 1)]],
            strain: [0, 1, 2].map(|k| strains[(i, k)]),
            turn_deg: turns[i],
        };
        Ok((0..n).map(row).collect())
    }
}
