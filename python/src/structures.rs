//! Atoms as they come from Python, ready for the engine.

use crate::errors::Fault;
use ndarray::Array2;
use numpy::PyReadonlyArray2;
use pyo3::prelude::*;
use std::collections::BTreeMap;
use std::path::PathBuf;
use stemgen::Setting;
use stemgen::engine::{Phonons, Site, mean_heights};
use stemgen::structure::{
    Atom, FrameRange, Preparation, ReadStructure, Sigmas, Structure, elements, read_frames,
    read_noted, sigmas_of_file,
};
use stemgen_cli::shared::Prepared;

/// Where the atoms are.
#[derive(FromPyObject)]
pub enum AtomsSource {
    /// A file.
    #[pyo3(transparent)]
    File(PathBuf),
    /// Arrays.
    #[pyo3(transparent)]
    Arrays(AtomArrays),
}

/// Atoms as arrays.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct AtomArrays {
    numbers: Vec<u32>,
    /// (atom, 3) in Angstrom.
    positions: Positions,
    /// Rows are the vectors, in Angstrom.
    cell: [[f64; 3]; 3],
    /// Share of each site that is occupied; all of it when `None`.
    occupancies: Option<Vec<f64>>,
}

/// (atom, 3).
pub struct Positions(Array2<f64>);

impl<'a, 'py> FromPyObject<'a, 'py> for Positions {
    type Error = PyErr;
    fn extract(object: Borrowed<'a, 'py, PyAny>) -> PyResult<Self> {
        let array: PyReadonlyArray2<'py, f64> = object.extract()?;
        Ok(Positions(array.as_array().to_owned()))
    }
}

/// Standard deviations of thermal displacements.
#[derive(FromPyObject)]
pub enum SigmaSource {
    /// `"from-file"`.
    #[pyo3(transparent)]
    Word(String),
    /// One for all elements, in Angstrom.
    #[pyo3(transparent)]
    All(f64),
    /// By symbol.
    #[pyo3(transparent)]
    Each(BTreeMap<String, f64>),
}

/// What is made of the atoms.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct SpecimenOptions {
    zone: Option<[i32; 3]>,
    up: Option<[i32; 3]>,
    max_strain_percent: Option<f64>,
    repeat: Option<[usize; 3]>,
    phonons: Option<u32>,
    sigma: Option<SigmaSource>,
    /// First frame, the first that is left out, step.
    frames: Option<(usize, Option<usize>, usize)>,
    seed: u64,
}

impl AtomsSource {
    fn read(&self) -> Result<ReadStructure, Fault> {
        match self {
            AtomsSource::File(path) => Ok(read_noted(path)?),
            AtomsSource::Arrays(arrays) => {
                let structure = arrays.structure()?;
                let notes = structure.crowded_sites().into_iter().collect();
                Ok(ReadStructure { structure, notes })
            }
        }
    }

    fn sigmas(&self, options: &SpecimenOptions) -> Result<Sigmas, Fault> {
        Ok(match (&options.sigma, self) {
            (None, _) => Sigmas::None,
            (Some(SigmaSource::All(sigma)), _) => Sigmas::All(*sigma),
            (Some(SigmaSource::Each(by_symbol)), _) => {
                let number = |(symbol, sigma): (&String, &f64)| {
                    elements::atomic_number(symbol).map(|number| (number, *sigma))
                };
                Sigmas::ByElement(by_symbol.iter().map(number).collect::<Result<_, _>>()?)
            }
            (Some(SigmaSource::Word(word)), AtomsSource::File(path)) if word == "from-file" => {
                sigmas_of_file(path)?
            }
            (Some(SigmaSource::Word(word)), _) => {
                let expected =
                    "give a length in A, one for each element, or \"from-file\" with a CIF";
                return Err(Fault::Value(Setting::ThermalSigma, word.clone(), expected.into()));
            }
        })
    }
}

impl AtomArrays {
    fn structure(&self) -> Result<Structure, Fault> {
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
        let mut atoms = Vec::with_capacity(self.numbers.len());
        for (n, number) in self.numbers.iter().enumerate() {
            let occupancy = self.occupancies.as_ref().and_then(|o| o.get(n).copied());
            let occupancy = occupancy.unwrap_or(1.0);
            // Known elements only.
            let number = elements::atomic_number(&number.to_string())?;
            let position = [0, 1, 2].map(|k| positions[(n, k)]);
            atoms.push(Atom { occupancy, ..Atom::new(number, position) });
        }
        Ok(Structure { cell: self.cell, atoms }.checked()?)
    }
}

impl SpecimenOptions {
    /// The settings of the phonons.
    pub fn phonons(&self) -> Option<Phonons> {
        self.phonons.map(|configurations| Phonons { configurations, seed: self.seed })
    }

    /// Seed of displacements, mixed sites and noise.
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// How often the cell is repeated.
    pub fn repeated(&self) -> [usize; 3] {
        self.repeat.unwrap_or([1; 3])
    }

    /// Reads, turns and repeats the structure, and draws the atoms of mixed sites.
    ///
    /// # Errors
    /// Those of the structure.
    pub fn prepare(&self, source: &AtomsSource) -> Result<Prepared, Fault> {
        self.check()?;
        if let Some((start, end, step)) = self.frames {
            return self.prepare_frames(source, FrameRange { start, end, step });
        }
        let preparation = Preparation {
            zone: self.zone,
            up: self.up,
            max_strain_percent: self.max_strain_percent,
            repeat: self.repeat,
            seed: self.seed,
        };
        let made = preparation.prepare(source.read()?)?;
        let sites = made.structure.sites(&source.sigmas(self)?)?;
        Ok(Prepared {
            size: made.size_angstrom,
            heights: sites.iter().map(|s| s.position[2]).collect(),
            sites,
            warnings: made.notes,
            more_frames: Vec::new(),
            strain_percent: made.strain_percent,
        })
    }

    fn check(&self) -> Result<(), Fault> {
        let refuse = |setting: Setting, value: &str, expected: &str| {
            Err(Fault::Value(setting, value.to_owned(), expected.to_owned()))
        };
        match (self.phonons, &self.sigma, self.frames) {
            (Some(_), None, _) => refuse(
                Setting::ThermalSigma,
                "None",
                "phonons need the standard deviation of each displacement in A, such as 0.08 or {\"Sr\": 0.084, \"O\": 0.085}",
            ),
            (None, Some(_), _) => refuse(
                Setting::PhononConfigurations,
                "None",
                "sigma is for frozen phonons: say how many",
            ),
            (Some(_), _, Some(_)) => refuse(
                Setting::PhononConfigurations,
                "given",
                "frames of a trajectory are phonons; leave one of them out",
            ),
            (_, _, Some((start, end, step)))
                if step == 0 || end.is_some_and(|end| end <= start) =>
            {
                refuse(
                    Setting::StructureFile,
                    "frames",
                    "expected range(start, end, step) with frames in it",
                )
            }
            (_, _, Some(_))
                if self.zone.is_some()
                    || self.up.is_some()
                    || self.max_strain_percent.is_some() =>
            {
                refuse(
                    Setting::Zone,
                    "given",
                    "frames are taken as they are; leave zone, up and max_strain_percent out",
                )
            }
            _ => Ok(()),
        }
    }

    /// Slices are those of the mean heights, where all frames have as many atoms.
    fn prepare_frames(&self, source: &AtomsSource, range: FrameRange) -> Result<Prepared, Fault> {
        let AtomsSource::File(path) = source else {
            let expected = "frames are read from a file, extended XYZ or XDATCAR";
            return Err(Fault::Value(Setting::StructureFile, "atoms".into(), expected.into()));
        };
        let (mut frames, mut size): (Vec<Vec<Site>>, [f64; 3]) = (Vec::new(), [0.0; 3]);
        for frame in read_frames(path, range)? {
            let frame = frame.repeat(self.repeated())?.resolve_occupancy(self.seed)?;
            size = frame.orthogonal_box()?;
            frames.push(frame.sites(&Sigmas::None)?);
        }
        let more_frames = frames.split_off(1);
        let sites = frames.remove(0);
        let warnings = Vec::new();
        let mut prepared = Prepared {
            size,
            heights: Vec::new(),
            sites,
            warnings,
            more_frames,
            strain_percent: None,
        };
        prepared.heights = mean_heights(&prepared.frames());
        Ok(prepared)
    }
}
