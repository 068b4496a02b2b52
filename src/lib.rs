//! stemgen simulates images of scanning transmission electron microscopy (STEM), and builds *worlds*: large images of
//! specimens with defects, with a list of every atom beside them.
//!
//! Electrons are propagated through the atoms by multislice or PRISM with frozen phonons; detectors are annuli, or pixelated. Lengths of
//! atoms and probes are in Angstrom, lengths of fields and worlds in nm, and names include the unit. Images are arrays `[row, column] = [y,
//! x]`, in fractions of the incident beam.
//!
//! # An image of a crystal
//!
//! ```
//! use stemgen::engine::{Plan, Scan, Settings, simulate};
//! use stemgen::progress::Silent;
//! use stemgen::structure::{Sigmas, crystals};
//!
//! # fn main() -> stemgen::Result<()> {
//! // structures/si.cif along [110], 11.5 x 10.9 A wide and 19 A thick; `structure::read` takes a file of your own.
//! let crystal = crystals::crystal("si")?.oriented([1, 1, 0], None)?;
//! let specimen = crystal.repeat([3, 2, 5])?;
//! let sites = specimen.sites(&Sigmas::None)?;
//!
//! // 200 kV, 21 mrad, HAADF 68-200 mrad, unless settings say otherwise.
//! let heights: Vec<f64> = sites.iter().map(|site| site.position[2]).collect();
//! let plan = Plan::new(&Settings::default(), specimen.orthogonal_box()?, &heights)?;
//! assert!(plan.band_limit_mrad > 200.0);
//!
//! let scan = Scan { origin_angstrom: [0.0, 0.0], step_angstrom: [0.48, 0.68], shape: [8, 8] };
//! let images = simulate(&plan, &sites, &scan, &Silent)?;
//! let haadf = images.image(0, 0); // the first thickness, the first detector
//! assert_eq!(haadf.shape(), [8, 8]);
//! let brightest = haadf.iter().copied().fold(0.0, f32::max);
//! assert!(brightest > 0.0 && brightest < 1.0);
//! # Ok(())
//! # }
//! ```
//!
//! # A small world
//!
//! A recipe describes a world (`generate/`). This example builds one tile of the recipe for tests, as `stemgen build` does:
//!
//! ```
//! # #[cfg(feature = "hdf5")]
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use stemgen::imaging::Cache;
//! use stemgen::progress::Silent;
//! use stemgen::recipe::Recipe;
//! use stemgen::world::{BuildOptions, build};
//!
//! let recipe = Recipe::load("test", None)?.with_grid(1, 1)?;
//! let recipe = recipe.with_overrides(&["field.thickness_nm=0.4".parse()?])?.checked()?;
//! let options = BuildOptions { cache: Cache::none(), ..BuildOptions::default() };
//! let folder = tempfile::tempdir()?;
//! let summary = build(&recipe, &folder.path().join("world.h5"), &options, &Silent)?;
//! assert_eq!(summary.grid, [1, 1]);
//! assert!(summary.counts.vacancies > 0);
//! # Ok(())
//! # }
//! # #[cfg(not(feature = "hdf5"))]
//! # fn main() {}
//! ```
//!
//! # Reading a world
//!
//! ```
//! # #[cfg(feature = "hdf5")]
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! # use stemgen::imaging::Cache;
//! # use stemgen::recipe::Recipe;
//! # use stemgen::world::{BuildOptions, build};
//! # let recipe = Recipe::load("test", None)?.with_grid(1, 1)?;
//! # let recipe = recipe.with_overrides(&["field.thickness_nm=0.4".parse()?])?.checked()?;
//! # let options = BuildOptions { cache: Cache::none(), audit_regions: 0, ..BuildOptions::default() };
//! # let folder = tempfile::tempdir()?;
//! # let path = folder.path().join("world.h5");
//! # build(&recipe, &path, &options, &stemgen::progress::Silent)?;
//! use stemgen::io::WorldFile;
//!
//! let world = WorldFile::open(&path)?;
//! let tile = world.tile(0, 0)?; // [row, column], from 0 to 1
//! let size = world.metadata().tile_size_px;
//! assert_eq!(tile.shape(), [size, size]);
//!
//! for column in world.columns()?.iter().filter(|column| column.vacancies > 0) {
//!     let [x, y] = column.position_nm.map(f64::from).map(|nm| nm / world.metadata().pixel_size_nm);
//!     println!("{} at row {y:.1}, column {x:.1}", column.composition);
//! }
//! # Ok(())
//! # }
//! # #[cfg(not(feature = "hdf5"))]
//! # fn main() {}
//! ```
//!
//! # Rooms
//!
//! Data flows one way: recipe -> specimen -> slices -> engine -> detector image -> tiles -> file. A room uses only rooms above it in this
//! list (`tests/house.rs` checks this):
//!
//! - `constants`: physical constants
//! - `setting`: names of settings, for errors
//! - `error`: errors with the fault and the remedy
//! - [`rng`]: random numbers that depend on names, not on the order of drawing
//! - `made_once`: values that are made at their first request and kept
//! - `lengths`: conversion of nm and Angstrom
//! - `plane`: arithmetic of pairs along two axes
//! - `simd`: vector instructions of the machine
//! - `matrix`: products of complex matrices
//! - [`progress`]: reports of long computations, and their interruption
//! - [`numerics`]: the version of pixel values
//! - [`files`]: files that are written as a whole or not at all, locks, disk space
//! - `fft`: Fourier transforms in two dimensions
//! - [`structure`]: atoms in a cell; CIF, XYZ and POSCAR; zone axes, supercells, columns
//! - [`models`]: atoms from models of the program: carbon films, particles
//! - [`potential`]: scattering factors, slices, projected potentials
//! - [`optics`]: the lens: aperture and aberrations; mistilt and focal spread
//! - `resample`: interpolation of images between probes
//! - [`acquisition`]: from the noise-free image to the recording: scan errors, doses, detectors
//! - [`damage`]: the probability that an electron displaces an atom
//! - [`detect`]: annular, pixelated and virtual detectors
//! - [`engine`]: from atoms and a scan to images: plan, then simulate
//! - [`recipe`]: descriptions of worlds, read from TOML and checked
//! - [`specimen`]: every site of a large field, queried region by region
//! - [`imaging`]: the image of any rectangle of a field, and its error
//! - [`simulation`]: images of a user's atoms: the request, and the job that fulfils it
//! - [`detectability`]: the dose at which a defect is found
//! - [`io`]: files of images, worlds and atoms
//! - [`render`]: PNG pictures, drawings of specimens, HTML pages
//! - [`world`]: tiles with their truth, and whole worlds
//! - [`replay`]: worlds of recorded images
//! - [`publish`]: folders of worlds for data hubs
//! - [`live`]: worlds in memory that change under the beam
//! - [`benchmark`]: scores of agents' reports on a world, and of the dose they spent
//! - [`validate`]: checks against published numbers and other programs, and their reports
//!
//! # Features
//!
//! | feature | adds | needs |
//! |---|---|---|
//! | none | everything up to [`imaging`], tiles with noise and truth on the fly, files of atoms | |
//! | `hdf5` (default) | files of images and worlds, [`world::build`] | libhdf5 |
//! | `render` (default) | PNG pictures and drawings | |
//! | `report` (default) | [`validate`], HTML pages, readers of other programs' arrays; implies `hdf5` and `render` | libhdf5 |
//! | `static-hdf5` | an HDF5 library of its own in place of the system's | cmake |
//!
//! The program `stemgen` is the crate `stemgen-cli` beside this one.

// Only `report` has a user for everything: without it, functions of the rooms below stay unused.
#![cfg_attr(not(feature = "report"), allow(dead_code, unused_imports))]

pub mod acquisition;
pub mod benchmark;
mod constants;
pub mod damage;
pub mod detect;
pub mod detectability;
pub mod engine;
mod error;
mod fft;
pub mod files;
pub mod imaging;
pub mod io;
mod lengths;
pub mod live;
mod made_once;
mod matrix;
pub mod models;
pub mod numerics;
pub mod optics;
mod plane;
pub mod potential;
pub mod progress;
#[cfg(feature = "report")]
pub mod publish;
pub mod recipe;
#[cfg(feature = "render")]
pub mod render;
#[cfg(feature = "report")]
pub mod replay;
mod resample;
pub mod rng;
mod setting;
mod simd;
pub mod simulation;
pub mod specimen;
pub mod structure;
#[cfg(feature = "report")]
pub mod validate;
pub mod world;

pub use error::{Error, Result};
pub use setting::Setting;

/// The Rust of CONTRIBUTING.md is compiled and run.
#[cfg(doctest)]
#[doc = include_str!("../CONTRIBUTING.md")]
struct Contributing;
