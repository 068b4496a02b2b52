//! Options that prepare the specimen.

use super::hints::hinted;
use super::values::{self, SigmaSource};
use clap::Args;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use stemgen::Error;
use stemgen::engine::{Phonons, Site, mean_heights};
use stemgen::structure::{self, FrameRange, Preparation, Sigmas, elements};

/// The specimen.
#[derive(Debug, Args)]
#[command(next_help_heading = "Specimen")]
pub struct StructureArgs {
    /// Crystal or specimen: CIF, extended XYZ (.xyz, .extxyz) or POSCAR (.vasp, .poscar, POSCAR*)
    #[arg(value_name = "STRUCTURE", help_heading = None)]
    pub structure: PathBuf,
    #[command(flatten)]
    pub options: SpecimenArgs,
}

/// What is made of the structure.
#[derive(Debug, Args)]
#[command(next_help_heading = "Specimen")]
pub struct SpecimenArgs {
    /// Lattice direction along the beam; builds an orthogonal box
    #[arg(long, value_name = "U,V,W", value_parser = values::direction, allow_hyphen_values = true)]
    pub zone: Option<[i32; 3]>,
    /// Lattice direction along +y, perpendicular to the zone
    #[arg(long, value_name = "U,V,W", value_parser = values::direction, allow_hyphen_values = true)]
    pub up: Option<[i32; 3]>,
    /// Make a box of a cell whose angles are nearly right: at most so much strain, in per cent. The strain is printed, and stored
    /// in the file [default: with --zone or --up, angles within 1 mrad of right ones are made right]
    #[arg(long, value_name = "PERCENT", value_parser = values::percent, allow_negative_numbers = true)]
    #[arg(conflicts_with = "frames")]
    pub max_strain: Option<f64>,
    /// Repeat the cell (after --zone) along x, y and the beam
    #[arg(long, value_name = "NX,NY,NZ", value_parser = values::counts3)]
    pub repeat: Option<[usize; 3]>,
    /// Average over N frozen-phonon configurations; needs --sigma. Default: atoms exactly as given
    #[arg(long, value_name = "N", requires = "sigma")]
    pub phonons: Option<u32>,
    /// Standard deviation of each Cartesian component of the thermal displacement in A: one
    /// number, or one for each element (Sr=0.084,O=0.085), or from-file: the mean U or B of each element
    /// in a CIF
    #[arg(long, value_name = "A", value_parser = values::sigma_source, requires = "phonons")]
    pub sigma: Option<SigmaSource>,
    /// Frozen phonons from a trajectory, extended XYZ or XDATCAR: the mean over these frames, counted from 0, the last
    /// excluded
    #[arg(long, value_name = "START:END[:STEP]|all", value_parser = values::frames)]
    #[arg(conflicts_with_all = ["phonons", "zone", "up"])]
    pub frames: Option<FrameRange>,
    /// Seed of the thermal displacements and of mixed sites
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
}

/// A specimen ready for the engine.
#[derive(Debug)]
pub struct Prepared {
    /// Edges of the box in Angstrom.
    pub size: [f64; 3],
    /// The atoms.
    pub sites: Vec<Site>,
    /// Mean heights of the atoms in Angstrom.
    pub heights: Vec<f64>,
    /// The atoms of further frames of a trajectory.
    pub more_frames: Vec<Vec<Site>>,
    /// What is to be said of the atoms.
    pub warnings: Vec<String>,
    /// The largest principal strain in per cent that made the box orthogonal.
    pub strain_percent: Option<f64>,
}

impl Prepared {
    /// The atoms of each frame: one, unless there is a trajectory.
    pub fn frames(&self) -> Vec<&[Site]> {
        std::iter::once(&self.sites).chain(&self.more_frames).map(Vec::as_slice).collect()
    }
}

impl StructureArgs {
    /// Reads and prepares the structure.
    pub fn prepare(&self) -> anyhow::Result<Prepared> {
        self.options.prepare(&self.structure)
    }

    /// Name of the structure without folder and ending.
    pub fn stem(&self) -> PathBuf {
        PathBuf::from(self.structure.file_stem().unwrap_or("structure".as_ref()))
    }

    /// Name of the file.
    pub fn file_name(&self) -> String {
        let name = self.structure.file_name().map(Path::new).unwrap_or(&self.structure);
        name.display().to_string()
    }
}

impl SpecimenArgs {
    /// Reads, turns and repeats the structure, and draws the atoms of mixed sites.
    pub fn prepare(&self, file: &Path) -> anyhow::Result<Prepared> {
        if let Some(range) = self.frames {
            return self.prepare_frames(file, range);
        }
        let preparation = Preparation {
            zone: self.zone,
            up: self.up,
            max_strain_percent: self.max_strain,
            repeat: self.repeat,
            seed: self.seed,
        };
        let made = preparation.prepare(structure::read_noted(file).map_err(with_frames)?)?;
        let sites = made.structure.sites(&self.sigmas(file)?)?;
        Ok(Prepared {
            size: made.size_angstrom,
            heights: sites.iter().map(|s| s.position[2]).collect(),
            sites,
            warnings: made.notes,
            more_frames: Vec::new(),
            strain_percent: made.strain_percent,
        })
    }

    fn sigmas(&self, file: &Path) -> anyhow::Result<Sigmas> {
        Ok(match &self.sigma {
            None => Sigmas::None,
            Some(SigmaSource::Given(sigmas)) => sigmas.clone(),
            Some(SigmaSource::FromFile) => structure::sigmas_of_file(file)?,
        })
    }

    /// Reads frames. Slices are those of the mean heights, where all frames have as many atoms.
    fn prepare_frames(&self, file: &Path, range: FrameRange) -> anyhow::Result<Prepared> {
        let (mut frames, mut size) = (Vec::new(), [0.0; 3]);
        for frame in structure::read_frames(file, range)? {
            let frame = frame.repeat(self.repeat.unwrap_or([1; 3]))?;
            let frame = frame.resolve_occupancy(self.seed)?;
            size = frame.orthogonal_box()?;
            frames.push(frame.sites(&Sigmas::None)?);
        }
        let more_frames = frames.split_off(1);
        let sites = frames.remove(0);
        let mut prepared = Prepared {
            size,
            heights: Vec::new(),
            sites,
            warnings: Vec::new(),
            more_frames,
            strain_percent: None,
        };
        prepared.heights = mean_heights(&prepared.frames());
        Ok(prepared)
    }

    /// The settings of the phonons.
    pub fn phonons(&self) -> Option<Phonons> {
        self.phonons.map(|configurations| Phonons { configurations, seed: self.seed })
    }
}

/// The error, with the option that reads a trajectory where the file is one.
fn with_frames(error: Error) -> anyhow::Error {
    match &error {
        Error::Parse { message, .. } if message.contains("frame") => {
            hinted(error, "--frames all, or --frames START:END, averages over frames")
        }
        _ => error.into(),
    }
}

impl Prepared {
    /// Number of atoms of each element: `Ti 3, O 9`.
    pub fn composition(&self) -> BTreeMap<&'static str, usize> {
        let mut counts = BTreeMap::new();
        for site in &self.sites {
            *counts.entry(elements::symbol(site.number)).or_insert(0) += 1;
        }
        counts
    }
}
