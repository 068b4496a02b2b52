//! Reads requests for simulations from Python: a request of the library from a dict, and atoms from arrays.

use crate::errors::Fault;
use ndarray::{Array2, Array3, ArrayView2};
use numpy::{PyReadonlyArray2, PyReadonlyArray3};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pythonize::Depythonizer;
use serde::de::DeserializeOwned;
use stemgen::simulation::{AtomsSource, SimulationJob, SimulationRequest};
use stemgen::structure::{Atom, DisplacementTensor, Structure, elements};
use stemgen::{Error, Setting};

/// A value of the library, read from a dict. Missing keys have the library's defaults.
pub struct Parsed<T>(pub T);

/// The request for a simulation.
pub type Request = Parsed<SimulationRequest>;

impl<'a, 'py, T: DeserializeOwned> FromPyObject<'a, 'py> for Parsed<T> {
    type Error = PyErr;
    fn extract(object: Borrowed<'a, 'py, PyAny>) -> PyResult<Self> {
        let py = object.py();
        let object = object.to_owned();
        let mut source = Depythonizer::from_object(&object);
        serde_path_to_error::deserialize(&mut source).map(Parsed).map_err(|error| {
            let place = error.path().to_string();
            let inner = PyErr::from(error.into_inner());
            let wrong_type = inner.is_instance_of::<PyTypeError>(py);
            let message = inner.value(py).to_string();
            let make = || {
                let module = py.import("stemworlds.errors")?;
                module.call_method1("_of_request", (place, message, wrong_type))
            };
            make().map_or(inner, PyErr::from_value)
        })
    }
}

/// Reads a value of the library from JSON. Missing keys have the library's defaults.
///
/// # Errors
/// The exception of `stemworlds.errors` for a wrong value, with the keyword.
pub fn of_json<T: DeserializeOwned>(py: Python<'_>, value: serde_json::Value) -> PyResult<T> {
    serde_path_to_error::deserialize(value).map_err(|error| {
        let place = error.path().to_string();
        let message = error.into_inner().to_string();
        let wrong_type = message.starts_with("invalid type");
        let make = || {
            let module = py.import("stemworlds.errors")?;
            module.call_method1("_of_request", (place, &message, wrong_type))
        };
        make().map_or(PyTypeError::new_err(message.clone()), PyErr::from_value)
    })
}

impl Request {
    /// Returns the simulation of the file that the request names, or of `atoms`.
    ///
    /// # Errors
    /// Errors of the request and of the atoms.
    pub fn job(self, atoms: Option<&AtomArrays>) -> Result<SimulationJob, Fault> {
        let mut request = self.0;
        if let Some(atoms) = atoms {
            request.structure = AtomsSource::Given(atoms.structure()?);
        }
        Ok(SimulationJob::new(request)?)
    }
}

/// Atoms as arrays.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct AtomArrays {
    numbers: Vec<u32>,
    /// Places of the atoms (atom, 3) in Angstrom.
    positions: Positions,
    /// Vectors of the cell as rows, in Angstrom.
    cell: [[f64; 3]; 3],
    /// Occupied share of the site of each atom; `None` for full occupancy.
    occupancies: Option<Vec<f64>>,
    /// Mean square displacements (atom, 3, 3) in square Angstrom; `None` for none of their own.
    displacements: Option<Tensors>,
}

/// Places as an array (atom, 3).
pub struct Positions(Array2<f64>);

impl<'a, 'py> FromPyObject<'a, 'py> for Positions {
    type Error = PyErr;
    fn extract(object: Borrowed<'a, 'py, PyAny>) -> PyResult<Self> {
        let array: PyReadonlyArray2<'py, f64> = object.extract()?;
        Ok(Positions(array.as_array().to_owned()))
    }
}

/// Tensors as an array (atom, 3, 3).
pub struct Tensors(Array3<f64>);

impl<'a, 'py> FromPyObject<'a, 'py> for Tensors {
    type Error = PyErr;
    fn extract(object: Borrowed<'a, 'py, PyAny>) -> PyResult<Self> {
        let array: PyReadonlyArray3<'py, f64> = object.extract()?;
        Ok(Tensors(array.as_array().to_owned()))
    }
}

impl Tensors {
    /// Returns the displacement of each of `count` atoms.
    fn displacements(&self, count: usize) -> Result<Vec<DisplacementTensor>, Fault> {
        let refuse = |value, expected| Err(Fault::Value(Setting::Displacements, value, expected));
        if self.0.dim() != (count, 3, 3) {
            let value = format!("shape {:?}", self.0.dim());
            return refuse(value, format!("expected ({count}, 3, 3), in square Angstrom"));
        }
        let mut found = Vec::with_capacity(count);
        for (n, u) in self.0.outer_iter().enumerate() {
            match DisplacementTensor::new(matrix(u)) {
                Ok(tensor) => found.push(tensor),
                Err(Error::Invalid { value, expected, .. }) => {
                    return refuse(format!("{value} of atoms[{n}]"), expected);
                }
                Err(error) => return Err(error.into()),
            }
        }
        Ok(found)
    }
}

fn matrix(u: ArrayView2<f64>) -> [[f64; 3]; 3] {
    std::array::from_fn(|i| std::array::from_fn(|j| u[(i, j)]))
}

impl AtomArrays {
    /// Returns the atoms as a structure of the library.
    ///
    /// # Errors
    /// Errors of the arrays.
    pub fn structure(&self) -> Result<Structure, Fault> {
        let positions = &self.positions.0;
        let refuse = |value: String, expected: &str| {
            Err(Fault::Value(Setting::StructureFile, value, expected.to_owned()))
        };
        if positions.dim() != (self.numbers.len(), 3) {
            let value = format!("{:?} positions of {} atoms", positions.dim(), self.numbers.len());
            return refuse(value, "positions have the shape (atoms, 3)");
        }
        if let Some(shares) = self.occupancies.as_ref().filter(|o| o.len() != self.numbers.len()) {
            let value = format!("{} occupancies of {} atoms", shares.len(), self.numbers.len());
            return refuse(value, "expected one for each atom");
        }
        let finite = |values: &[f64; 3]| values.iter().all(|v| v.is_finite());
        if !positions.iter().all(|v| v.is_finite()) || !self.cell.iter().all(finite) {
            return refuse("nan or inf".into(), "positions and cell are finite, in A");
        }
        let own = self.displacements.as_ref();
        let own = own.map(|all| all.displacements(self.numbers.len())).transpose()?;
        let mut atoms = Vec::with_capacity(self.numbers.len());
        for (n, number) in self.numbers.iter().enumerate() {
            let occupancy = self.occupancies.as_ref().and_then(|o| o.get(n).copied());
            // This conversion refuses numbers of unknown elements.
            let number = elements::atomic_number(&number.to_string())?;
            let position = [positions[(n, 0)], positions[(n, 1)], positions[(n, 2)]];
            let displacement = own.as_ref().and_then(|all| all.get(n).copied());
            let occupancy = occupancy.unwrap_or(1.0);
            atoms.push(Atom { occupancy, displacement, ..Atom::new(number, position) });
        }
        Ok(Structure { cell: self.cell, atoms })
    }
}
