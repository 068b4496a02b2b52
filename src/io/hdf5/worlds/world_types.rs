//! Checks that the datasets of a world have the types and shapes of the schema, on which readers in other languages rely.

use hdf5::types::{FloatSize, IntSize, TypeDescriptor};

use super::schema;
use super::world_file::WorldFile;
use super::world_metadata::not_a_world;
use crate::error::Result;

const SINGLE: TypeDescriptor = TypeDescriptor::Float(FloatSize::U4);
const INTEGER: TypeDescriptor = TypeDescriptor::Integer(IntSize::U4);

/// Lists below the ground truth, of which a world has some or all, and their types.
const LISTS: [(&str, TypeDescriptor); 11] = [
    ("atom_positions", SINGLE),
    ("atom_types", INTEGER),
    ("defect_mask", TypeDescriptor::Boolean),
    ("atom_z", SINGLE),
    ("atomic_numbers", INTEGER),
    ("atom_columns", INTEGER),
    ("columns/position", SINGLE),
    ("columns/number_of_sites", INTEGER),
    ("columns/vacancies", INTEGER),
    ("columns/substitutions", INTEGER),
    (schema::PHASE_MAP, INTEGER),
];

impl WorldFile {
    /// Checks the types of images and lists, and the shape of the map of valid pixels; returns the number of datasets.
    ///
    /// # Errors
    /// [`crate::Error::Invalid`] with the name of the first dataset of another type or shape.
    pub(crate) fn check_types(&self) -> Result<usize> {
        let [rows, columns] = self.metadata.grid_shape;
        let images = [schema::TILES, schema::CLEAN].map(|group| self.of_images(group));
        let mut checked = 0;
        for group in images.iter().filter(|group| self.file.link_exists(group)) {
            for tile in (0..rows * columns).map(|n| schema::tile_name(n / columns, n % columns)) {
                self.check_type(&format!("{group}/{tile}"), &SINGLE)?;
                checked += 1;
            }
        }
        self.check_type(&self.of_images(schema::OVERVIEW), &SINGLE)?;
        self.check_type(schema::VALID_REGION, &TypeDescriptor::Boolean)?;
        let (shape, expected) = (self.dataset(schema::VALID_REGION)?.shape(), self.shape());
        if shape != expected {
            let fault = format!("has the shape {shape:?}, expected {expected:?}");
            return Err(not_a_world(&self.path, format!("/{} {fault}", schema::VALID_REGION)));
        }
        checked += 2;
        for (list, kind) in &LISTS {
            let name = format!("{}/{list}", schema::TRUTH);
            if self.file.link_exists(&name) {
                self.check_type(&name, kind)?;
                checked += 1;
            }
        }
        Ok(checked)
    }

    fn check_type(&self, name: &str, expected: &TypeDescriptor) -> Result<()> {
        let stored = self.dataset(name)?.dtype().and_then(|kind| kind.to_descriptor());
        let found = match stored {
            Ok(found) if found == *expected => return Ok(()),
            Ok(found) => found.to_string(),
            Err(_) => "another type".to_owned(),
        };
        Err(not_a_world(&self.path, format!("/{name} holds {found}, expected {expected}")))
    }
}
