//! Particles on a thin film of light atoms: each kind of atom in the way that it needs.
//!
//! The film scatters hardly: its atoms make their images independently of each other ([`crate::engine::single_scattering`]).
//! Particles are simulated in windows, together with the film behind them, where the window holds any of their atoms; towards
//! the edge of where it does, one image fades into the other. What the tail of a probe scatters outside the window is
//! added as from independent atoms. So nearly all the time goes to particles, and the film elsewhere costs the same for any
//! number of configurations.
//!
//! Without the film behind them, bright columns of a Pt particle of 2.8 nm on 5 nm of carbon would be off by 0.95 % rms (mean -0.15 %) in
//! one configuration, and by 0.6 % in 4 or 16: the waves that film and particle scatter interfere.

use std::collections::{BTreeMap, BTreeSet};

use ndarray::{Array2, Zip, s};
use rayon::prelude::*;

use super::build::SubTileEngine;
use super::field_image::FieldImage;
use super::mosaic::{DisplacedAtoms, MosaicEngine, atoms_by_seed};
use super::pixel_box::PixelBox;
use super::recipe::Recipe;
use super::simulator::Simulator;
use super::specimen::{ParticleTruth, Region, Specimen, SpecimenSite, particles_in};
use crate::engine::phonons::displaced;
use crate::engine::single_scattering::{ScatteringMap, SingleScattering};
use crate::engine::{Algorithm, Plan, PlannedScan, ProbeBox, ProbeStep, Scan, Settings, Site};
use crate::error::{Error, Result};
use crate::potential::slices::{GROUP_ANGSTROM, Slicing};
use crate::progress::Progress;
use crate::resample::{Edge, Kernel, MARGIN, image_band_limit};

/// Atoms further than this from a probe do not count, in Angstrom: a particle of 4 nm at this distance from its edge is seen with
/// 2 % of the film's intensity.
const REACH_ANGSTROM: f64 = 30.0;
/// Windows hold no atoms of a particle further than half their width and this from the probe, in Angstrom.
const BEYOND_WINDOW_ANGSTROM: f64 = 1.0;
/// Specimen around the window for the potentials of its atoms, in Angstrom.
const POTENTIAL_ANGSTROM: f64 = 1.5;
/// Atoms of particles within so many Angstrom along the beam share a slice: tilted particles have no planes. Of a particle of
/// 2.8 nm, one configuration, windows of 5.9 A, bright pixels are off by 0.68 / 0.60 / 0.43 / 0.27 % rms with 0.5 / 0.35 / 0.25 /
/// 0.15 A against 0.05 A, and take 0.83 / 1 / 1.06 / 1.20 times as long: windows pass most of thin slices in one step.
const SPAN_ANGSTROM: f64 = 0.15;
/// Film behind particles is in slices of this thickness in Angstrom. An audit (7.8 A windows, 4 configurations, film there in slices of
/// 0.5 A): bright columns 0.33 % off with 2 A, 0.34 % with 1 A, which takes a quarter more time.
const FILM_SLICE_ANGSTROM: f64 = 2.0;
/// Of the film behind them a nm takes probes as long as so many nm of particle.
const FILM_SHARE: f64 = 0.4;
/// Pixels of the film that take as long as a probe takes for a nm of particle.
const PIXELS_PER_PROBE_NM: f64 = 120.0;
/// Edge in samples of the blocks in which particles are simulated: wider ones spare potentials and take memory.
const BLOCK: i64 = 64;
/// Probes of such a block.
pub const BLOCK_PROBES: usize = (BLOCK * BLOCK) as usize;

/// A thin film of weakly scattering atoms behind everything else; no other atoms are of its element.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ThinFilm {
    /// Atomic number.
    pub number: u8,
    /// Where it begins and ends along the beam, in nm.
    pub depth_nm: [f64; 2],
}

/// See the module.
pub struct FilmImage<'a> {
    specimen: &'a dyn Specimen,
    recipe: &'a Recipe,
    film: ThinFilm,
    /// For the particles.
    simulator: Simulator,
    window_angstrom: f64,
    kernel: Kernel,
    /// Distance of samples in Angstrom; sample 0 is at pixel 0 of the full field.
    step: f64,
}

/// Samples of the full field: the first (row, column), and how many.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Samples {
    first: [i64; 2],
    shape: [usize; 2],
}

/// Atoms around some samples, in Angstrom from the first of them.
struct Atoms {
    film: Vec<Site>,
    particles: Vec<Site>,
}

impl<'a> FilmImage<'a> {
    /// `None` for specimens without a film, and engines without windows.
    ///
    /// # Errors
    /// Those of the settings.
    pub fn prepare(
        engine: &MosaicEngine,
        specimen: &'a dyn Specimen,
        recipe: &'a Recipe,
    ) -> Result<Option<Self>> {
        let settings = engine.simulator.settings();
        let (Some(film), Algorithm::Window { width_angstrom }) =
            (specimen.film(), settings.algorithm)
        else {
            return Ok(None);
        };
        let band_limit = image_band_limit(&settings.optics);
        let step = Kernel::default_step(band_limit);
        let simulator = Simulator::of(Settings {
            probe_box: Some(ProbeBox::Large),
            probe_step: ProbeStep::Scan,
            tail_correction: false,
            slicing: Slicing::Grouped(SPAN_ANGSTROM),
            ..settings.clone()
        });
        let kernel = Kernel::new(step, band_limit)?;
        let window_angstrom = width_angstrom;
        Ok(Some(FilmImage { specimen, recipe, film, simulator, window_angstrom, kernel, step }))
    }

    /// Distance from an atom of a particle, along x and y, up to which probes are propagated, in Angstrom.
    fn near(&self) -> f64 {
        0.5 * self.window_angstrom + BEYOND_WINDOW_ANGSTROM
    }

    /// Distance from the centre of a particle up to which probes are propagated, about.
    fn reach_nm(&self, particle: &ParticleTruth) -> f64 {
        0.5 * particle.diameter_nm + 0.1 * self.near()
    }

    /// Specimen around the probes of a block, in Angstrom.
    fn margin(&self) -> f64 {
        self.near() + POTENTIAL_ANGSTROM
    }

    /// The plan for a block of samples in the middle of a particle, which is as tall as particles are in the mean over their probes;
    /// `None` where there are none.
    ///
    /// # Errors
    /// Those of the settings.
    pub fn block_plan(&self) -> Result<Option<PlannedScan>> {
        let mut particles = self.specimen.particles();
        let moment = |n: i32| particles.iter().map(|p| p.diameter_nm.powi(n)).sum::<f64>();
        let mean = moment(3) / moment(2);
        let off = |p: &ParticleTruth| (p.diameter_nm - mean).abs();
        particles.sort_by(|a, b| off(a).total_cmp(&off(b)));
        let Some(particle) = particles.first() else { return Ok(None) };
        let half = 0.05 * BLOCK as f64 * self.step + 0.1 * self.margin();
        let [x, y] = [0, 1].map(|k| [particle.centre_nm[k] - half, particle.centre_nm[k] + half]);
        let phonons = &self.recipe.phonons;
        let sites = self.specimen.sites(&Region { x, y });
        let atoms: Vec<Site> = sites.iter().filter_map(|s| s.atom([x[0], y[0]], phonons)).collect();
        let heights: Vec<f64> = atoms
            .iter()
            .map(|a| self.height(a.number, a.position[2], FILM_SLICE_ANGSTROM))
            .collect();
        let size = [20.0 * half, 20.0 * half, 10.0 * self.specimen.thickness_nm()];
        let plan = Plan::new(self.simulator.settings(), size, &heights)?;
        let scan = Scan {
            origin_angstrom: [self.margin(); 2],
            step_angstrom: [self.step; 2],
            shape: [BLOCK as usize; 2],
        };
        Ok(Some(PlannedScan::new(plan, scan, Some(&atoms))))
    }

    /// Distance of probes in Angstrom.
    pub fn step_angstrom(&self) -> f64 {
        self.step
    }

    /// Probes that the particles of the built field take, for each configuration.
    pub fn particle_probes(&self) -> usize {
        let area = |p: &ParticleTruth| std::f64::consts::PI * self.reach_nm(p).powi(2);
        let particles = particles_in(self.specimen, &self.recipe.field.built_region());
        let step_nm = 0.1 * self.step;
        (particles.iter().map(area).sum::<f64>() / (step_nm * step_nm)) as usize
    }

    /// The mean height of an atom of element `number`, in Angstrom, those of the film in slices of the given thickness.
    fn height(&self, number: u8, height: f64, film_slice: f64) -> f64 {
        match number == self.film.number {
            true => (height / film_slice).round() * film_slice,
            false => height,
        }
    }

    fn atoms_around(&self, samples: &Samples, origin: [f64; 2]) -> Atoms {
        let range = |k: usize| {
            let first = samples.first[1 - k] as f64 * self.step - REACH_ANGSTROM;
            let last = first + samples.shape[1 - k] as f64 * self.step + 2.0 * REACH_ANGSTROM;
            [0.1 * first, 0.1 * last]
        };
        let sites = self.specimen.sites(&Region { x: range(0), y: range(1) });
        let phonons = &self.recipe.phonons;
        let atom = |s: SpecimenSite| {
            let site = s.atom([0.0; 2], phonons)?;
            let [x, y, z] = site.position;
            Some(Site { position: [x - origin[0], y - origin[1], z], ..site })
        };
        let (film, particles) =
            sites.into_par_iter().filter_map(atom).partition(|s| s.number == self.film.number);
        Atoms { film, particles }
    }

    /// Those of some atoms that are of element `number`, in all their configurations, on a raster.
    fn deposit<'r>(
        &self,
        raster: &'r SingleScattering<'r>,
        atoms: &[Site],
        (number, depth_angstrom): (u8, [f64; 2]),
        configurations: usize,
    ) -> Result<ScatteringMap<'r>> {
        let mut deposit = raster.map(number, depth_angstrom)?;
        for configuration in 0..configurations as u32 {
            let of = atoms.par_iter().filter(|s| s.number == number);
            let moved: Vec<[f64; 3]> =
                of.map(|s| displaced(s, self.recipe.seed, configuration)).collect();
            deposit.add(&moved, 1.0 / configurations as f64);
        }
        Ok(deposit)
    }

    /// Images of atoms each by itself on rasters of at least `least` samples, less `margin` on all sides: of all the film's,
    /// and of those outside the windows of probes; each with that of the particles' atoms outside.
    fn independent(
        &self,
        atoms: &Atoms,
        (least, margin): ([usize; 2], usize),
        configurations: usize,
    ) -> Result<[Array2<f64>; 2]> {
        let outside = 0.5 * self.window_angstrom;
        let raster = SingleScattering::new(self.simulator.settings(), self.step, least)?;
        let [rows, columns] = least.map(|n| margin..n - margin);
        let image = |deposit: &ScatteringMap<'_>, beyond| {
            deposit.image(beyond).slice_move(s![rows.clone(), columns.clone()])
        };
        let kind = (self.film.number, self.film.depth_nm.map(|z| 10.0 * z));
        let film = self.deposit(&raster, &atoms.film, kind, configurations)?;
        let mut images = [image(&film, 0.0), image(&film, outside)];
        let numbers: BTreeSet<u8> = atoms.particles.iter().map(|s| s.number).collect();
        let heights = || atoms.particles.iter().map(|s| s.position[2]);
        let depth =
            [heights().fold(f64::INFINITY, f64::min), heights().fold(f64::NEG_INFINITY, f64::max)];
        for number in numbers {
            let kind = (number, depth);
            let particles = self.deposit(&raster, &atoms.particles, kind, configurations)?;
            let far = image(&particles, outside);
            images.iter_mut().for_each(|sum| *sum += &far);
        }
        Ok(images)
    }

    /// Rectangles of samples with atoms of particles in their windows.
    fn blocks(&self, atoms: &Atoms, samples: &Samples, origin: [f64; 2]) -> Vec<Samples> {
        let mut found: BTreeMap<[i64; 2], [[i64; 2]; 2]> = BTreeMap::new();
        for site in &atoms.particles {
            let range = |k: usize| {
                let at = site.position[1 - k] + origin[1 - k];
                let low = ((at - self.near()) / self.step).ceil() as i64;
                let high = ((at + self.near()) / self.step).floor() as i64;
                let end = samples.first[k] + samples.shape[k] as i64 - 1;
                [low.max(samples.first[k]), high.min(end)]
            };
            let (rows, columns) = (range(0), range(1));
            for i in rows[0].div_euclid(BLOCK)..=rows[1].div_euclid(BLOCK) {
                for j in columns[0].div_euclid(BLOCK)..=columns[1].div_euclid(BLOCK) {
                    let part = |[low, high]: [i64; 2], n: i64| {
                        [low.max(n * BLOCK), high.min(n * BLOCK + BLOCK - 1)]
                    };
                    let (rows, columns) = (part(rows, i), part(columns, j));
                    if rows[0] > rows[1] || columns[0] > columns[1] {
                        continue;
                    }
                    let join = |a: [i64; 2], b: [i64; 2]| [a[0].min(b[0]), a[1].max(b[1])];
                    let block = found.entry([i, j]).or_insert([rows, columns]);
                    *block = [join(block[0], rows), join(block[1], columns)];
                }
            }
        }
        let samples = |[rows, columns]: [[i64; 2]; 2]| Samples {
            first: [rows[0], columns[0]],
            shape: [rows, columns].map(|[low, high]| (high - low + 1) as usize),
        };
        found.into_values().map(samples).collect()
    }

    /// For each sample of a block, the share of the image that is simulated: all where the window holds atoms of particles,
    /// and none so far from them that no block is made.
    fn simulated_share(&self, atoms: &Atoms, block: &Samples, origin: [f64; 2]) -> Array2<f64> {
        let mut distance = Array2::from_elem(block.shape, f64::INFINITY);
        for site in &atoms.particles {
            let at = |k: usize| {
                let place =
                    (site.position[1 - k] + origin[1 - k]) / self.step - block.first[k] as f64;
                let reach = self.near() / self.step;
                let low = (place - reach).ceil().max(0.0) as usize;
                let high = (place + reach).floor().min(block.shape[k] as f64 - 1.0);
                (place, low..(high + 1.0).max(0.0) as usize)
            };
            let ((row, rows), (column, columns)) = (at(0), at(1));
            for i in rows {
                for j in columns.clone() {
                    // as windows are square
                    let d = (i as f64 - row).abs().max((j as f64 - column).abs()) * self.step;
                    distance[[i, j]] = distance[[i, j]].min(d);
                }
            }
        }
        distance.mapv(|d| ((self.near() - d) / BEYOND_WINDOW_ANGSTROM).clamp(0.0, 1.0))
    }

    /// The image of particles with the film behind them at a block of samples.
    fn simulated(
        &self,
        atoms: &Atoms,
        block: &Samples,
        origin: [f64; 2],
        configurations: usize,
        progress: &dyn Progress,
    ) -> Result<Array2<f64>> {
        let margin = self.margin();
        let range = |k: usize| {
            let first = block.first[1 - k] as f64 * self.step;
            let last = first + (block.shape[1 - k] - 1) as f64 * self.step;
            [first - margin, last + margin]
        };
        let (x, y) = (range(0), range(1));
        let corner = [x[0] - origin[0], y[0] - origin[1]];
        let size = [x[1] - x[0], y[1] - y[0]];
        let inside =
            |s: &&Site| (0..2).all(|k| (0.0..size[k]).contains(&(s.position[k] - corner[k])));
        let all = atoms.particles.iter().chain(&atoms.film);
        let sites: Vec<Site> = all.filter(inside).copied().collect();
        let moved = |configuration: usize| {
            let site = |s: &Site| {
                let p = displaced(s, self.recipe.seed, configuration as u32);
                let position = [p[0] - corner[0], p[1] - corner[1], p[2]];
                Site { position, sigma_angstrom: 0.0, ..*s }
            };
            let height = |s: &Site| self.height(s.number, s.position[2], FILM_SLICE_ANGSTROM);
            let heights = sites.iter().map(height).collect();
            DisplacedAtoms { sites: sites.iter().map(site).collect(), heights }
        };
        let scan = Scan {
            origin_angstrom: [margin; 2],
            step_angstrom: [self.step; 2],
            shape: block.shape,
        };
        let area = Region { x: x.map(|v| 0.1 * v), y: y.map(|v| 0.1 * v) };
        let pixels = PixelBox::of_area(area, scan, 10.0 * self.specimen.thickness_nm());
        self.simulator.mean(&pixels, configurations, moved, progress)
    }
}

impl FieldImage for FilmImage<'_> {
    fn name(&self) -> &'static str {
        "film"
    }

    fn parameters(&self) -> serde_json::Value {
        let mut settings = self.simulator.parameters();
        settings["film"] = serde_json::json!({
            "number": self.film.number,
            "depth_nm": self.film.depth_nm,
            "reach_angstrom": REACH_ANGSTROM,
        });
        settings
    }

    fn mean_of(
        &self,
        first: [usize; 2],
        shape: [usize; 2],
        configurations: usize,
        progress: &dyn Progress,
    ) -> Result<Array2<f64>> {
        if progress.interrupted() {
            return Err(Error::Interrupted);
        }
        let pixel = 10.0 * self.recipe.field.pixel_nm() / self.step;
        let samples = Samples::under(first, shape, pixel);
        let margin = (REACH_ANGSTROM / self.step).ceil() as usize;
        let least = samples.shape.map(|n| n + 2 * margin);
        let origin = [1, 0].map(|k| (samples.first[k] - margin as i64) as f64 * self.step);
        let atoms = self.atoms_around(&samples, origin);
        let [mut image, outside] = self.independent(&atoms, (least, margin), configurations)?;
        let blocks = self.blocks(&atoms, &samples, origin);
        let probes: usize = blocks.iter().map(|b| b.shape[0] * b.shape[1]).sum();
        progress.start("particles", "probe", (probes * configurations) as u64);
        for block in &blocks {
            let part = self.simulated(&atoms, block, origin, configurations, progress)?;
            let share = self.simulated_share(&atoms, block, origin);
            let [row, column] = [0, 1].map(|k| (block.first[k] - samples.first[k]) as usize);
            let [rows, columns] = block.shape;
            let place = s![row..row + rows, column..column + columns];
            let whole = part + outside.slice(place);
            let mut to = image.slice_mut(place);
            Zip::from(&mut to)
                .and(&whole)
                .and(&share)
                .for_each(|to, whole, share| *to += share * (whole - *to));
        }
        let at = [0, 1].map(|k| first[k] as f64 * pixel - samples.first[k] as f64);
        let pixels = self.kernel.raster(image.view(), at, [pixel; 2], shape, [Edge::Open; 2]);
        Ok(pixels.mapv(|v| v.max(0.0)))
    }

    fn unit(&self) -> &'static str {
        "step"
    }

    fn work(&self, first: [usize; 2], [rows, columns]: [usize; 2]) -> usize {
        // The way of probes through particles, from one pixel in 64.
        let pixel = self.recipe.field.pixel_nm();
        let particles = self.specimen.particles();
        let spheres: Vec<([f64; 3], f64)> =
            particles.iter().map(|p| (p.centre_nm, self.reach_nm(p))).collect();
        let chord = |x: f64, y: f64| {
            let through = |(c, r): &([f64; 3], f64)| {
                2.0 * (r * r - (c[0] - x).powi(2) - (c[1] - y).powi(2)).max(0.0).sqrt()
            };
            let way = spheres.iter().map(through).sum::<f64>();
            let film = self.film.depth_nm[1] - self.film.depth_nm[0];
            way + if way > 0.0 { FILM_SHARE * film } else { 0.0 }
        };
        let at = |n: usize, first: usize| (first + n) as f64 * pixel;
        let places =
            (0..rows).step_by(8).flat_map(|i| (0..columns).step_by(8).map(move |j| (i, j)));
        let way = places.map(|(i, j)| chord(at(j, first[1]), at(i, first[0]))).sum::<f64>();
        let per_pixel = (10.0 * pixel / self.step).powi(2);
        let configurations = self.recipe.phonons.configurations.max(1) as f64;
        let probes_nm = 64.0 * way * per_pixel * configurations;
        rows * columns + (PIXELS_PER_PROBE_NM * probes_nm) as usize
    }

    /// Mean heights of the film's atoms are those of slices as thick as in any specimen without planes: particles need thinner ones.
    fn atoms(&self, area: &Region, configuration: usize) -> DisplacedAtoms {
        let seed = (self.recipe.seed, configuration);
        let mut atoms = atoms_by_seed(self.specimen, area, seed, self.recipe);
        for (site, height) in atoms.sites.iter().zip(&mut atoms.heights) {
            *height = self.height(site.number, *height, GROUP_ANGSTROM);
        }
        atoms
    }
}

impl Samples {
    /// Those that pixels `pixel` samples apart are interpolated from.
    fn under(first: [usize; 2], shape: [usize; 2], pixel: f64) -> Self {
        let margin = MARGIN as i64;
        let low = first.map(|p| (p as f64 * pixel).floor() as i64 - margin);
        let high =
            [0, 1].map(|k| ((first[k] + shape[k] - 1) as f64 * pixel).floor() as i64 + 1 + margin);
        Samples { first: low, shape: [0, 1].map(|k| (high[k] - low[k] + 1) as usize) }
    }
}
