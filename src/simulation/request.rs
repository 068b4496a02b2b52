//! The request: everything that decides the images of some atoms.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::atoms::{AtomsSource, SpecimenRequest};
use super::microscope::MicroscopeRequest;
use super::numerics_request::NumericsRequest;
use super::pattern_job::PatternsRequest;
use super::scan::ScanRequest;
use crate::error::{Error, Result};
use crate::files::whole_file;

/// Largest size of a request's file in bytes.
const MOST_BYTES: usize = 1 << 20;

/// Everything that decides the images of some atoms. Each part except the atoms has a default. Unknown keys are refused.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SimulationRequest {
    /// The atoms: a structure file, or atoms in memory.
    pub structure: AtomsSource,
    /// Thicknesses in Angstrom at which images are recorded, each moved to the nearest slice boundary; empty: at the exit surface.
    #[serde(default)]
    pub thicknesses_angstrom: Vec<f64>,
    /// A plane wave and an objective lens in place of a probe: conventional imaging.
    #[serde(default)]
    pub plane_wave: bool,
    /// Dose in electrons per square Angstrom; the electrons are then counted. `None`: images without noise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub electrons_per_angstrom2: Option<f64>,
    /// The diffraction pattern of every probe, in place of images; `None`: images.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub patterns: Option<PatternsRequest>,
    /// Direction, size, vibrations and frames of the atoms.
    #[serde(default)]
    pub specimen: SpecimenRequest,
    /// The lens, the source and the detectors.
    #[serde(default)]
    pub microscope: MicroscopeRequest,
    /// Positions of the probes.
    #[serde(default)]
    pub scan: ScanRequest,
    /// Engine, grid, slices and probes.
    #[serde(default)]
    pub numerics: NumericsRequest,
}

impl SimulationRequest {
    /// The request with defaults for everything but the atoms.
    pub fn new(structure: AtomsSource) -> Self {
        SimulationRequest {
            structure,
            thicknesses_angstrom: Vec::new(),
            plane_wave: false,
            electrons_per_angstrom2: None,
            patterns: None,
            specimen: SpecimenRequest::default(),
            microscope: MicroscopeRequest::default(),
            scan: ScanRequest::default(),
            numerics: NumericsRequest::default(),
        }
    }

    /// The request with defaults for everything but the structure file.
    pub fn of_file(path: impl Into<PathBuf>) -> Self {
        Self::new(AtomsSource::File(path.into()))
    }

    /// Reads a request (TOML). The path of its structure is relative to the folder of the file.
    ///
    /// # Errors
    /// [`Error::Io`]; [`Error::Parse`] with the line, for a file that is no request.
    pub fn from_toml(path: &Path) -> Result<Self> {
        let text = whole_file::read_text(path, MOST_BYTES)?;
        let mut request: Self = toml::from_str(&text).map_err(|e| {
            let line = e.span().map_or(0, |span| text[..span.start].matches('\n').count() + 1);
            Error::parse(path, line, e.message())
        })?;
        if let (AtomsSource::File(structure), Some(folder)) =
            (&mut request.structure, path.parent())
        {
            *structure = folder.join(&*structure);
        }
        Ok(request)
    }

    /// Writes the request as TOML, with all its values. Paths inside `folder`, the folder of the file, are written relative to it.
    ///
    /// # Errors
    /// [`Error::Invalid`] for atoms in memory, which no file names, and for seeds above 2^63, which TOML cannot hold.
    pub fn to_toml(&self, folder: &Path) -> Result<String> {
        let AtomsSource::File(structure) = &self.structure else {
            let expected =
                "a request in a file names the structure file; write the atoms to one first";
            return Err(Error::invalid(crate::Setting::StructureFile, "atoms in memory", expected));
        };
        let inside = absolute(structure).strip_prefix(absolute(folder)).ok().map(Path::to_owned);
        let structure = AtomsSource::File(inside.unwrap_or_else(|| absolute(structure)));
        toml::to_string(&SimulationRequest { structure, ..self.clone() }).map_err(|e| {
            Error::invalid(
                crate::Setting::Output,
                "request",
                format!("cannot be written as TOML: {e}"),
            )
        })
    }
}

fn absolute(path: &Path) -> PathBuf {
    // The folder of a file name without a folder is the current one.
    let path = if path.as_os_str().is_empty() { Path::new(".") } else { path };
    std::path::absolute(path).unwrap_or_else(|_| path.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::Aberration;
    use crate::simulation::{Engine, LengthUnit, SigmaChoice};

    /// A request in which no value is the default.
    fn full() -> SimulationRequest {
        let mut request = SimulationRequest::of_file("/data/si.cif");
        request.thicknesses_angstrom = vec![20.0, 40.5];
        request.electrons_per_angstrom2 = Some(1e4);
        request.patterns = Some(super::PatternsRequest { pixels: 32, ..Default::default() });
        let specimen = &mut request.specimen;
        specimen.zone = Some([1, 1, 0]);
        specimen.phonons = Some(8);
        specimen.sigma_angstrom = Some(SigmaChoice::ByElement([("Si".to_owned(), 0.078)].into()));
        let microscope = &mut request.microscope;
        microscope.defocus_angstrom = vec![0.0, 50.0];
        microscope.aberrations = vec![Aberration::parse("C12=30@0.3").unwrap()];
        microscope.source_size_angstrom = Some(0.8);
        request.scan.unit = LengthUnit::Nm;
        request.scan.points = Some([32, 16]);
        let numerics = &mut request.numerics;
        numerics.engine = Some(Engine::Window);
        numerics.window_angstrom = Some(12.5);
        numerics.expansion = crate::engine::Expansion::Off;
        numerics.probe_step = crate::engine::ProbeStep::Angstrom(0.25);
        request
    }

    #[test]
    fn requests_survive_files() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("r.toml");
        for request in [full(), SimulationRequest::of_file("/data/si.cif")] {
            std::fs::write(&path, request.to_toml(folder.path()).unwrap()).unwrap();
            assert_eq!(SimulationRequest::from_toml(&path).unwrap(), request);
            let json = serde_json::to_string(&request).unwrap();
            assert_eq!(serde_json::from_str::<SimulationRequest>(&json).unwrap(), request);
        }
    }

    #[test]
    fn structures_beside_a_request_are_named_without_their_folder() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("r.toml");
        let request = SimulationRequest::of_file(folder.path().join("si.cif"));
        let text = request.to_toml(folder.path()).unwrap();
        assert!(text.starts_with("structure = \"si.cif\""), "{text}");
        std::fs::write(&path, text).unwrap();
        assert_eq!(SimulationRequest::from_toml(&path).unwrap(), request);
    }

    #[test]
    fn what_is_no_request_is_refused_with_its_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("r.toml");
        let bad = [
            ("", "missing field `structure`"),
            ("structure = \"a\"\nthickness = 3\n", "unknown field `thickness`"),
            ("structure = \"a\"\n[scan]\nstep = 3\n", "unknown field `step`"),
            ("structure = \"a\"\n[numerics]\nengine = \"fast\"\n", "unknown variant `fast`"),
            ("structure = \"a\"\n[numerics]\nprobe_step = \"far\"\n", "`far`"),
            (
                "structure = \"a\"\n[microscope]\ndetectors = [{ name = \"A\", inner = 1 }]\n",
                "inner",
            ),
        ];
        for (text, words) in bad {
            std::fs::write(&path, text).unwrap();
            let shown = SimulationRequest::from_toml(&path).unwrap_err().to_string();
            assert!(shown.contains(words) && shown.contains("r.toml"), "{text}: {shown}");
        }
    }
}
