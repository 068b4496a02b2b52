//! The atoms of a request, in their box.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::engine::{Phonons, Site, mean_heights};
use crate::error::{Error, Result};
use crate::setting::Setting;
use crate::structure::{
    self, Atom, FileSigmas, FrameRange, Preparation, ROOM_TEMPERATURE_K, ReadStructure, Sigmas,
    Structure, elements, read_frames, tabulated_sigma_angstrom,
};

/// Where atoms come from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum AtomsSource {
    /// A structure file: CIF, extended XYZ, POSCAR.
    File(PathBuf),
    /// Atoms at hand; a request with them cannot be written.
    #[serde(skip)]
    Given(Structure),
}

/// Standard deviations of thermal displacements.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum SigmaChoice {
    /// One for all elements, in Angstrom.
    All(f64),
    /// One for each element, by symbol, in Angstrom.
    ByElement(BTreeMap<String, f64>),
    /// The displacements that come with the atoms: U or B of the structure file, anisotropic where the file gives them, or
    /// [`Atom::displacement`] of given atoms.
    FromFile(FromFile),
    /// That of each element in a crystal of its own, at [`SpecimenRequest::temperature_k`].
    FromTable(FromTable),
}

/// `"table"`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum FromTable {
    /// Of the tables of [`crate::structure`].
    #[serde(rename = "table")]
    FromTable,
}

/// `"from-file"`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum FromFile {
    /// [`SigmaChoice::FromFile`].
    #[serde(rename = "from-file")]
    FromFile,
}

/// The specimen of a request: direction, size, vibrations and frames of the atoms.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SpecimenRequest {
    /// Lattice direction along the beam; builds an orthogonal box.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub zone: Option<[i32; 3]>,
    /// Lattice direction along +y, perpendicular to the zone.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub up: Option<[i32; 3]>,
    /// Strain a cell whose angles are nearly right into an orthogonal box, by at most this strain in per cent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_strain_percent: Option<f64>,
    /// Numbers of repetitions of the cell along x, y and the beam, after the zone.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub repeat: Option<[usize; 3]>,
    /// Number of frozen-phonon configurations; `None`: atoms stay at the given positions.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub phonons: Option<u32>,
    /// Standard deviation of each Cartesian component of the thermal displacement.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sigma_angstrom: Option<SigmaChoice>,
    /// Temperature in K at which displacements are taken from a table; room temperature when absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub temperature_k: Option<f64>,
    /// Frames of a trajectory, over which images are averaged.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frames: Option<FrameRange>,
    /// Seed of thermal displacements, mixed sites and counted electrons.
    pub seed: u64,
}

impl Default for SpecimenRequest {
    fn default() -> Self {
        SpecimenRequest {
            zone: None,
            up: None,
            max_strain_percent: None,
            repeat: None,
            phonons: None,
            sigma_angstrom: None,
            temperature_k: None,
            frames: None,
            seed: 1,
        }
    }
}

/// Atoms in an orthogonal box, ready for the engine.
#[derive(Debug, Clone, PartialEq)]
pub struct PreparedSpecimen {
    /// Edges of the box in Angstrom.
    pub size_angstrom: [f64; 3],
    /// The atoms; for a trajectory, the atoms of the first frame.
    pub sites: Vec<Site>,
    /// Mean heights of the atoms in Angstrom.
    pub heights_angstrom: Vec<f64>,
    /// The atoms of further frames of a trajectory.
    pub more_frames: Vec<Vec<Site>>,
    /// Notes on the atoms for the user, in sentences.
    pub notes: Vec<String>,
    /// The largest principal strain in per cent that was needed for an orthogonal box.
    pub strain_percent: Option<f64>,
}

impl PreparedSpecimen {
    /// The atoms of each frame. Without a trajectory there is one frame.
    pub fn frames(&self) -> Vec<&[Site]> {
        std::iter::once(&self.sites).chain(&self.more_frames).map(Vec::as_slice).collect()
    }

    /// Number of atoms of each element, by symbol.
    pub fn composition(&self) -> BTreeMap<&'static str, usize> {
        let mut counts = BTreeMap::new();
        for site in &self.sites {
            *counts.entry(elements::symbol(site.number)).or_insert(0) += 1;
        }
        counts
    }
}

impl AtomsSource {
    /// The structure file, where there is one.
    pub fn file(&self) -> Option<&Path> {
        match self {
            AtomsSource::File(path) => Some(path),
            AtomsSource::Given(_) => None,
        }
    }

    fn read(&self) -> Result<ReadStructure> {
        match self {
            AtomsSource::File(path) => structure::read_noted(path),
            AtomsSource::Given(structure) => {
                let notes = structure.crowded_sites().into_iter().collect();
                Ok(ReadStructure { structure: structure.clone().checked()?, notes })
            }
        }
    }
}

impl SpecimenRequest {
    /// The settings of the phonons.
    pub fn phonons(&self) -> Option<Phonons> {
        self.phonons.map(|configurations| Phonons { configurations, seed: self.seed })
    }

    /// Reads, turns and repeats the atoms, and draws the occupation of mixed sites.
    ///
    /// # Errors
    /// [`Error::Invalid`] for parts of the request that exclude each other; errors of the structure file.
    pub fn prepare(&self, source: &AtomsSource) -> Result<PreparedSpecimen> {
        self.check()?;
        if let Some(range) = self.frames {
            return self.prepare_frames(source, range);
        }
        let preparation = Preparation {
            zone: self.zone,
            up: self.up,
            max_strain_percent: self.max_strain_percent,
            repeat: self.repeat,
            seed: self.seed,
        };
        let made = preparation.prepare(source.read()?)?;
        let mut notes = made.notes;
        let sigmas = match self.tabulated(&made.structure)? {
            Some((sigmas, note)) => {
                notes.push(note);
                sigmas
            }
            None => {
                let found = self.sigmas(source)?;
                notes.extend(found.notes);
                found.sigmas
            }
        };
        notes.extend(anisotropic_note(&sigmas, &made.structure));
        let sites = made.structure.sites(&sigmas)?;
        Ok(PreparedSpecimen {
            size_angstrom: made.size_angstrom,
            heights_angstrom: sites.iter().map(|s| s.position[2]).collect(),
            sites,
            notes,
            more_frames: Vec::new(),
            strain_percent: made.strain_percent,
        })
    }

    fn check(&self) -> Result<()> {
        let refuse =
            |setting, value: &str, expected: &str| Err(Error::invalid(setting, value, expected));
        match (self.phonons, &self.sigma_angstrom, self.frames) {
            (Some(_), None, None) => refuse(
                Setting::ThermalSigma,
                "none",
                "phonons need the standard deviation of each displacement in A, such as 0.08, or one for each element",
            ),
            _ if self.temperature_k.is_some()
                && !matches!(self.sigma_angstrom, Some(SigmaChoice::FromTable(_))) =>
            {
                let expected = "a temperature needs displacements from the table; choose the table, or leave the temperature out";
                refuse(Setting::Temperature, "given", expected)
            }
            (None, Some(_), _) => refuse(
                Setting::PhononConfigurations,
                "none",
                "sigma is for frozen phonons; give the number of phonon configurations",
            ),
            (Some(n), _, Some(_)) => refuse(
                Setting::PhononConfigurations,
                &n.to_string(),
                "the frames of a trajectory replace phonon configurations; leave one of the two out",
            ),
            (_, _, Some(range))
                if range.step == 0 || range.end.is_some_and(|end| end < range.start) =>
            {
                refuse(
                    Setting::Frames,
                    "none",
                    "expected a step of 1 or more, and an end that is not before the start",
                )
            }
            (_, _, Some(_))
                if self.zone.is_some()
                    || self.up.is_some()
                    || self.max_strain_percent.is_some() =>
            {
                let expected =
                    "frames cannot be oriented or strained; leave zone, up and the strain out";
                refuse(Setting::Frames, "given", expected)
            }
            _ => Ok(()),
        }
    }

    /// Displacements from a table for the elements of a structure, with a note on them.
    fn tabulated(&self, structure: &Structure) -> Result<Option<(Sigmas, String)>> {
        if !matches!(self.sigma_angstrom, Some(SigmaChoice::FromTable(_))) {
            return Ok(None);
        }
        let kelvin = self.temperature_k.unwrap_or(ROOM_TEMPERATURE_K);
        let mut by_number = BTreeMap::new();
        for number in structure.atoms.iter().map(|atom| atom.number) {
            if let Entry::Vacant(place) = by_number.entry(number) {
                place.insert(tabulated_sigma_angstrom(number, kelvin)?);
            }
        }
        let all = by_number.iter().map(|(n, sigma)| format!("{} {sigma:.4}", elements::symbol(*n)));
        let note = format!(
            "displacements of crystals of one element at {kelvin} K (Peng et al. 1996): {} A",
            all.collect::<Vec<_>>().join(", ")
        );
        Ok(Some((Sigmas::ByElement(by_number), note)))
    }

    fn sigmas(&self, source: &AtomsSource) -> Result<FileSigmas> {
        let sigmas = match (&self.sigma_angstrom, source) {
            // The table is read later, when the elements are known.
            (None | Some(SigmaChoice::FromTable(_)), _) => Sigmas::None,
            (Some(SigmaChoice::All(sigma)), _) => Sigmas::All(*sigma),
            (Some(SigmaChoice::ByElement(by_symbol)), _) => {
                let mut by_number = BTreeMap::new();
                for (symbol, sigma) in by_symbol {
                    if by_number.insert(elements::atomic_number(symbol)?, *sigma).is_some() {
                        return Err(Error::invalid(
                            Setting::ThermalSigma,
                            symbol,
                            "is given twice",
                        ));
                    }
                }
                Sigmas::ByElement(by_number)
            }
            (Some(SigmaChoice::FromFile(_)), AtomsSource::File(path)) => {
                return structure::sigmas_of_file(path);
            }
            (Some(SigmaChoice::FromFile(_)), AtomsSource::Given(structure))
                if structure.atoms.iter().all(|atom| atom.displacement.is_some()) =>
            {
                Sigmas::OfAtoms(BTreeMap::new())
            }
            (Some(SigmaChoice::FromFile(_)), AtomsSource::Given(_)) => {
                let expected =
                    "atoms in memory have no file; expected a length in A, or one for each element";
                return Err(Error::invalid(Setting::ThermalSigma, "from-file", expected));
            }
        };
        Ok(FileSigmas { sigmas, notes: Vec::new() })
    }

    /// Reads frames. Slices are made for the mean heights if all frames have equally many atoms.
    fn prepare_frames(&self, source: &AtomsSource, range: FrameRange) -> Result<PreparedSpecimen> {
        let AtomsSource::File(path) = source else {
            let expected = "frames are read from a file, extended XYZ or XDATCAR";
            return Err(Error::invalid(Setting::Frames, "atoms in memory", expected));
        };
        let (mut frames, mut size_angstrom): (Vec<Vec<Site>>, _) = (Vec::new(), [0.0; 3]);
        let preparation =
            Preparation { repeat: self.repeat, seed: self.seed, ..Preparation::default() };
        let mut notes = FrameNotes::default();
        for (chosen, frame) in read_frames(path, range)?.into_iter().enumerate() {
            let made = preparation.prepare(frame)?;
            notes.add(range.number(chosen), made.notes);
            size_angstrom = made.size_angstrom;
            frames.push(made.structure.sites(&Sigmas::None)?);
        }
        let more_frames = frames.split_off(1);
        let mut prepared = PreparedSpecimen {
            size_angstrom,
            heights_angstrom: Vec::new(),
            sites: frames.remove(0),
            notes: notes.sentences(),
            more_frames,
            strain_percent: None,
        };
        prepared.heights_angstrom = mean_heights(&prepared.frames());
        Ok(prepared)
    }
}

/// Returns the warning that lists how many atoms have anisotropic displacements.
fn anisotropic_note(sigmas: &Sigmas, structure: &Structure) -> Option<String> {
    let own = |atom: &&Atom| atom.displacement.is_some();
    let (count, all) = (structure.atoms.iter().filter(own).count(), structure.atoms.len());
    (matches!(sigmas, Sigmas::OfAtoms(_)) && count > 0).then(|| match count == all {
        true => format!("anisotropic displacements that come with the atoms are used for all {all} atoms"),
        false => format!(
            "anisotropic displacements of the file are used for {count} of {all} atoms, the mean U or B of the element for the others"
        ),
    })
}

/// Notes on the frames of a trajectory. Sentences that differ only in their numbers are kept once.
#[derive(Default)]
struct FrameNotes(Vec<FrameNote>);

struct FrameNote {
    sentence: String,
    /// The first frame with this sentence.
    first: usize,
    /// Number of frames with this sentence.
    count: usize,
}

impl FrameNotes {
    fn add(&mut self, frame: usize, sentences: Vec<String>) {
        let words = |s: &str| s.chars().filter(|c| !c.is_ascii_digit()).collect::<String>();
        for sentence in sentences {
            match self.0.iter_mut().find(|note| words(&note.sentence) == words(&sentence)) {
                Some(known) => known.count += 1,
                None => self.0.push(FrameNote { sentence, first: frame, count: 1 }),
            }
        }
    }

    fn sentences(&self) -> Vec<String> {
        let sentence = |note: &FrameNote| match note.count {
            1 => format!("frame {}: {}", note.first, note.sentence),
            n => format!("frame {} ({n} frames in all): {}", note.first, note.sentence),
        };
        self.0.iter().map(sentence).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn silicon() -> AtomsSource {
        let cell = [[5.431, 0.0, 0.0], [0.0, 5.431, 0.0], [0.0, 0.0, 5.431]];
        let at = |x: f64, y, z| Atom::new(14, [x, y, z].map(|v: f64| 5.431 * v));
        AtomsSource::Given(Structure { cell, atoms: vec![at(0.0, 0.0, 0.0), at(0.25, 0.25, 0.25)] })
    }

    #[test]
    fn atoms_at_hand_are_prepared_as_those_of_files_are() {
        let request = SpecimenRequest {
            repeat: Some([2, 1, 1]),
            phonons: Some(3),
            sigma_angstrom: Some(SigmaChoice::ByElement([("Si".to_owned(), 0.08)].into())),
            ..SpecimenRequest::default()
        };
        let given = request.prepare(&silicon()).unwrap();
        assert_eq!(given.size_angstrom, [2.0 * 5.431, 5.431, 5.431]);
        assert_eq!(given.composition(), BTreeMap::from([("Si", 4)]));
        assert!(given.sites.iter().all(|site| site.sigma_angstrom == 0.08));
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("si.xyz");
        let AtomsSource::Given(structure) = silicon() else { unreachable!() };
        let mut text = "2\nLattice=\"5.431 0 0 0 5.431 0 0 0 5.431\" pbc=\"T T T\"\n".to_owned();
        for [x, y, z] in structure.atoms.iter().map(|atom| atom.position) {
            text += &format!("Si {x} {y} {z}\n");
        }
        std::fs::write(&path, text).unwrap();
        assert_eq!(request.prepare(&AtomsSource::File(path)).unwrap(), given);
    }

    #[test]
    fn what_is_said_of_frames_reaches_the_user_once_for_each_kind() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("md.xyz");
        let head = "Lattice=\"4 0 0 0 4 0 0 0 4\" Properties=species:S:1:pos:R:3:occupancy:R:1";
        // An atom outside the cell in the second frame and the last; two sites too full for their distance in the last.
        let rows = ["1 1 1 1\nSi 3", "-1 1 1 1\nSi 1", "-3 1 1 0.9\nSi -2.5"];
        let frames = rows.map(|row| format!("2\n{head}\nSi {row} 1 1 0.9\n"));
        std::fs::write(&path, frames.concat()).unwrap();
        let range = FrameRange { start: 1, end: None, step: 1 };
        let request = SpecimenRequest { frames: Some(range), ..SpecimenRequest::default() };
        let notes = request.prepare(&AtomsSource::File(path)).unwrap().notes;
        assert_eq!(notes.len(), 2, "{notes:#?}");
        let outside = "frame 1 (2 frames in all): 1 of 2 atoms lie outside";
        assert!(notes[0].starts_with(outside), "{notes:#?}");
        assert!(notes[1].starts_with("frame 2: 1 pairs of sites are closer"), "{notes:#?}");
    }

    #[test]
    fn parts_that_exclude_each_other_are_refused() {
        let none = SpecimenRequest::default;
        let all = Some(SigmaChoice::All(0.1));
        let frames = Some(FrameRange { start: 0, end: Some(3), step: 1 });
        let refused = [
            (SpecimenRequest { phonons: Some(2), ..none() }, Setting::ThermalSigma),
            (
                SpecimenRequest { sigma_angstrom: all.clone(), ..none() },
                Setting::PhononConfigurations,
            ),
            (SpecimenRequest { frames, phonons: Some(2), ..none() }, Setting::PhononConfigurations),
            (SpecimenRequest { frames, zone: Some([1, 1, 0]), ..none() }, Setting::Frames),
            (SpecimenRequest { frames, ..none() }, Setting::Frames),
            (
                SpecimenRequest {
                    phonons: Some(2),
                    sigma_angstrom: Some(SigmaChoice::FromFile(FromFile::FromFile)),
                    ..none()
                },
                Setting::ThermalSigma,
            ),
        ];
        for (request, expected) in refused {
            match request.prepare(&silicon()).unwrap_err() {
                Error::Invalid { setting, .. } => assert_eq!(setting, expected, "{request:?}"),
                other => panic!("{other}"),
            }
        }
    }
}
