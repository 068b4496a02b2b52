//! References computed by abTEM 1.0.11, built into the program: the files of `tests/golden`, where their origin is described.

use std::path::Path;

use ndarray::{Array2, Array3, ArrayD, Dimension};
use serde_json::Value;

use crate::detect::Detector;
use crate::engine::settings::EXACT_BAND_FRACTION;
use crate::engine::{GridChoice, Plan, Scan, Settings, Site};
use crate::error::{Error, Result};
use crate::io::arrays::unpack_npz;
use crate::optics::Aberrations;
use crate::potential::slices::Slicing;
use crate::setting::Setting;
use crate::structure::{self, Format};

struct File {
    name: &'static str,
    json: &'static str,
    npz: &'static [u8],
}

macro_rules! golden {
    ($($name:literal),*) => {
        [$(File {
            name: $name,
            json: include_str!(concat!("../../tests/golden/", $name, ".json")),
            npz: include_bytes!(concat!("../../tests/golden/", $name, ".npz")),
        }),*]
    };
}

macro_rules! atoms {
    ($($name:literal),*) => {
        [$((concat!($name, ".xyz"), include_str!(concat!("../../tests/golden/", $name, ".xyz")))),*]
    };
}

const FILES: [File; 13] = golden![
    "srtio3_001",
    "srtio3_001_aberrated",
    "srtio3_001_optics",
    "srtio3_prism_f2",
    "si_110",
    "si_110_prism_f2",
    "exit_intensity",
    "srtio3_patterns",
    "srtio3_waves",
    "potential_srtio3",
    "displaced_refined",
    "displaced_bandlimit",
    "displaced_image"
];

const ATOMS: [(&str, &str); 9] = atoms![
    "srtio3_001",
    "srtio3_001_aberrated",
    "srtio3_prism_f2",
    "si_110",
    "si_110_prism_f2",
    "exit_intensity",
    "potential_srtio3",
    "displaced_refined",
    "displaced_image"
];

/// Scattering factors as abTEM evaluates them, and published values.
pub(crate) const SCATTERING_FACTORS: &str =
    include_str!("../../tests/golden/scattering_factors.csv");

/// Detectors of the images, in the order of the images.
pub(crate) const DETECTORS: [&str; 4] = ["bf", "abf", "adf", "haadf"];

/// A reference: settings, atoms and arrays.
pub struct Golden {
    /// All settings, as the script wrote them.
    pub json: Value,
    /// The atoms of the simulation.
    pub sites: Vec<Site>,
    /// Edges of the cell in Angstrom.
    pub cell_angstrom: [f64; 3],
    arrays: Vec<(String, ArrayD<f64>)>,
}

impl Golden {
    /// Loads a reference by name.
    ///
    /// # Errors
    /// [`Error::Invalid`] for an unknown name.
    pub fn load(name: &str) -> Result<Self> {
        let damaged =
            |e: String| Error::invalid(Setting::Reference, name, format!("is damaged: {e}"));
        let unknown = || Error::invalid(Setting::Reference, name, "is not part of the program");
        let file = FILES.iter().find(|f| f.name == name).ok_or_else(unknown)?;
        let json: Value = serde_json::from_str(file.json).map_err(|e| damaged(e.to_string()))?;
        let atoms = json["atoms"].as_str().unwrap_or_default();
        let (path, text) = ATOMS.iter().find(|(n, _)| *n == atoms).ok_or_else(unknown)?;
        let atoms = structure::parse(Format::ExtXyz, text.as_bytes(), Path::new(path))?;
        Ok(Golden {
            cell_angstrom: atoms.orthogonal_box()?,
            sites: atoms.atoms.iter().enumerate().map(site).collect(),
            arrays: unpack_npz(file.npz).map_err(damaged)?,
            json,
        })
    }

    /// Returns an array of any shape: row = y, column = x.
    ///
    /// # Errors
    /// [`Error::Invalid`] if no array has this name and number of dimensions.
    pub fn array<D: Dimension>(&self, name: &str) -> Result<ndarray::Array<f64, D>> {
        let found = self.arrays.iter().find(|(n, _)| n == name).map(|(_, a)| a.clone());
        let array = found.and_then(|a| a.into_dimensionality().ok());
        array
            .ok_or_else(|| Error::invalid(Setting::Reference, name, "is no array of the reference"))
    }

    /// Returns images in fractions of the beam: [detector, row, column] = [detector, y, x].
    ///
    /// # Errors
    /// As [`Golden::array`].
    pub fn images(&self, name: &str) -> Result<Array3<f64>> {
        self.array(name)
    }

    /// Returns a table, or a single image [row, column] = [y, x] in fractions of the beam.
    ///
    /// # Errors
    /// As [`Golden::array`].
    pub fn matrix(&self, name: &str) -> Result<Array2<f64>> {
        self.array(name)
    }

    /// Reads a pair of numbers from the settings.
    pub(crate) fn pair(value: &Value) -> [f64; 2] {
        [0, 1].map(|i| value[i].as_f64().unwrap_or(f64::NAN))
    }

    /// Returns the thickness of abTEM's slices in Angstrom.
    pub fn slice_angstrom(&self) -> f64 {
        self.json["slice_thickness_A"].as_f64().unwrap_or(f64::NAN)
    }

    /// Returns the four detectors.
    pub fn detectors(&self) -> Vec<Detector> {
        let detector = |name: &str| {
            let [inner, outer] = Golden::pair(&self.json["detectors_mrad"][name]);
            Detector::new(&name.to_uppercase(), inner, outer)
        };
        DETECTORS.map(detector).to_vec()
    }

    /// Returns settings with abTEM's numerics on its grid, except for its placement of atoms (see [`like_abtem`]).
    pub fn settings(&self) -> Settings {
        let points = Golden::pair(&self.json["gpts_xy"]).map(|n| n as usize);
        let base = Settings { detectors: self.detectors(), ..Settings::default() };
        let like = like_abtem(&base, GridChoice::Points(points), self.slice_angstrom());
        Settings { abtem_placement: false, ..like }
    }

    /// Returns our default settings with abTEM's slices and focus.
    pub fn converged_settings(&self) -> Settings {
        let slice = self.slice_angstrom();
        let mut settings = Settings {
            detectors: self.detectors(),
            slicing: Slicing::Thickness(slice),
            ..Settings::default()
        };
        settings.optics.aberrations = Aberrations::defocus(slice / 2.0);
        settings
    }

    /// Returns the raster of the images.
    pub fn scan(&self) -> Scan {
        let scan = &self.json["scan"];
        let [nx, ny] = Golden::pair(&scan["points_xy"]).map(|n| n as usize);
        // Specimens are periodic in whole cells, so the scan may begin at the origin.
        Scan {
            origin_angstrom: Golden::pair(&scan["start_A"]),
            step_angstrom: Golden::pair(&scan["step_xy_A"]),
            shape: [ny, nx],
        }
    }

    /// Returns the positions (x, y) of single probes in Angstrom.
    pub fn positions(&self) -> Vec<[f64; 2]> {
        let list = self.json["positions_A"].as_array();
        list.into_iter().flatten().map(Golden::pair).collect()
    }

    /// Plans the simulation with every slice acting at its entrance and the probe in focus there, as in abTEM. Waves then leave the
    /// specimen one slice behind the last plane, where PRISM with interpolation cuts probes from them. A distance shorter by half a slice
    /// (0.96 A) changes HAADF of Si \[110\] with f = 2 by up to 0.9 % of the maximum.
    ///
    /// # Errors
    /// As [`Plan::new`].
    pub(crate) fn plan_from_plane(&self, settings: &Settings) -> Result<Plan> {
        let half = self.slice_angstrom() / 2.0;
        let mut settings = settings.clone();
        settings.optics.aberrations.add_defocus(-half);
        let mut plan = self.plan(&settings)?;
        plan.slices.planes.iter_mut().for_each(|z| *z -= half);
        Ok(plan)
    }

    /// Plans the simulation of the atoms.
    ///
    /// # Errors
    /// As [`Plan::new`].
    pub fn plan(&self, settings: &Settings) -> Result<Plan> {
        let z: Vec<f64> = self.sites.iter().map(|s| s.position[2]).collect();
        Plan::new(settings, self.cell_angstrom, &z)
    }
}

/// Returns settings with the numerics of abTEM 1.0.11: `exp(i sigma V)` on the grid of the wave, slices of equal thickness, the
/// anti-aliasing disk with its taper, its placement of atoms, and the focus on the plane of the first slice. Our focus is on the entrance
/// surface, half a slice before it.
pub fn like_abtem(base: &Settings, grid: GridChoice, slice_angstrom: f64) -> Settings {
    let mut settings = Settings {
        grid,
        slicing: Slicing::ThicknessFromFace(slice_angstrom),
        abtem_placement: true,
        oversampling: Some(1),
        band_taper: 0.02,
        band_fraction: EXACT_BAND_FRACTION,
        ..base.clone()
    };
    settings.optics.aberrations.add_defocus(slice_angstrom / 2.0);
    settings
}

fn site((key, atom): (usize, &structure::Atom)) -> Site {
    Site {
        position: atom.position,
        number: atom.number,
        sigma_angstrom: 0.0,
        anisotropy: None,
        key: key as u64,
    }
}
