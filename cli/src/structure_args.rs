//! Options of the specimen. Given options go into a request, which holds the defaults.

use super::hints::hinted;
use super::imaging_args::put_some;
use super::values;
use clap::Args;
use std::path::{Path, PathBuf};
use stemgen::Error;
use stemgen::simulation::{SigmaChoice, SimulationRequest, SpecimenRequest};
use stemgen::structure::FrameRange;

/// Holds the structure file and the options of the specimen.
#[derive(Debug, Args)]
#[command(next_help_heading = "Specimen")]
pub struct StructureArgs {
    /// File of atoms: CIF, extended XYZ (.xyz, .extxyz) or POSCAR (.vasp, .poscar, POSCAR*). Or a request, the settings file
    /// (.toml) of --write-request; given options replace its settings
    #[arg(value_name = "STRUCTURE", help_heading = None)]
    pub structure: PathBuf,
    #[command(flatten)]
    pub options: SpecimenArgs,
}

/// Holds the options that turn a structure into a specimen.
#[derive(Debug, Args)]
#[command(next_help_heading = "Specimen")]
pub struct SpecimenArgs {
    /// Lattice direction along the beam; the program builds a right-angled box
    #[arg(long, value_name = "U,V,W", value_parser = values::direction, allow_hyphen_values = true)]
    pub zone: Option<[i32; 3]>,
    /// Lattice direction along +y, perpendicular to --zone
    #[arg(long, value_name = "U,V,W", value_parser = values::direction, allow_hyphen_values = true)]
    pub up: Option<[i32; 3]>,
    /// Strain a cell with nearly right angles into a right-angled box, by at most this much, in per cent. The strain is printed,
    /// and stored in the file [default: with --zone or --up, angles within 1 mrad of 90 degrees are made right]
    #[arg(long, value_name = "PERCENT", value_parser = values::percent, allow_negative_numbers = true)]
    #[arg(conflicts_with = "frames")]
    pub max_strain: Option<f64>,
    /// Repeat the cell along x, y and the beam, after --zone
    #[arg(long, value_name = "NX,NY,NZ", value_parser = values::counts3)]
    pub repeat: Option<[usize; 3]>,
    /// Average over N frozen-phonon configurations: sets of thermal displacements. Needs --sigma [default: none; atoms stand
    /// exactly as in the file]
    #[arg(long, value_name = "N", requires = "sigma")]
    pub phonons: Option<u32>,
    /// Standard deviation of the thermal displacement along each axis, in A: one number, or one for each element
    /// (Sr=0.084,O=0.085). `from-file` takes the displacements of a CIF: anisotropic U, B or beta (3 x 3) for each atom that has
    /// one, and the mean isotropic U or B of the element for other atoms. `table` takes the value of each element in its
    /// elemental crystal, at --temperature
    #[arg(long, value_name = "A", value_parser = values::sigma_choice, requires = "phonons")]
    pub sigma: Option<SigmaChoice>,
    /// Temperature for --sigma table, 200 to 400 K [default: 293]
    #[arg(long, value_name = "K", value_parser = values::finite, requires = "sigma")]
    pub temperature: Option<f64>,
    /// Average over these frames of a trajectory (extended XYZ or XDATCAR), in place of --phonons. Frames count from 0, and END
    /// is included
    #[arg(long, value_name = "START:END[:STEP]|all", value_parser = values::frames)]
    #[arg(conflicts_with_all = ["phonons", "zone", "up"])]
    pub frames: Option<FrameRange>,
    /// Seed of thermal displacements, of the atoms on partly occupied sites, and of the noise [default: 1]
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
}

impl StructureArgs {
    /// Returns the request of a file (.toml), or the defaults for a structure file, with the given options applied.
    pub fn request(&self) -> anyhow::Result<SimulationRequest> {
        let is_request = self.structure.extension().is_some_and(|e| e.eq_ignore_ascii_case("toml"));
        let mut request = match is_request {
            true => SimulationRequest::from_toml(&self.structure)?,
            false => SimulationRequest::of_file(&self.structure),
        };
        self.options.apply(&mut request.specimen);
        Ok(request)
    }
}

impl SpecimenArgs {
    /// Puts the given options into a request.
    pub fn apply(&self, to: &mut SpecimenRequest) {
        put_some(&self.zone, &mut to.zone);
        put_some(&self.up, &mut to.up);
        put_some(&self.max_strain, &mut to.max_strain_percent);
        put_some(&self.repeat, &mut to.repeat);
        put_some(&self.phonons, &mut to.phonons);
        put_some(&self.sigma, &mut to.sigma_angstrom);
        put_some(&self.temperature, &mut to.temperature_k);
        put_some(&self.frames, &mut to.frames);
        to.seed = self.seed.unwrap_or(to.seed);
    }
}

/// Returns the name of a file without its folder and its ending.
pub fn stem(file: &Path) -> PathBuf {
    PathBuf::from(file.file_stem().unwrap_or("structure".as_ref()))
}

/// Returns the name of a file without its folder.
pub fn file_name(file: &Path) -> String {
    file.file_name().map(Path::new).unwrap_or(file).display().to_string()
}

/// Adds the option that reads a trajectory to an error about frames.
pub fn with_frames(error: Error) -> anyhow::Error {
    match &error {
        Error::Parse { message, .. } if message.contains("frame") => {
            hinted(error, "--frames all, or --frames START:END, averages over frames")
        }
        _ => error.into(),
    }
}
