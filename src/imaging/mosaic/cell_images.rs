//! The images of one family of library cells: their content, samples and names.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::OnceLock;

use ndarray::{Array2, Axis, s};
use sha2::{Digest, Sha256};

use crate::engine::{Plan, Scan, Settings, Site};
use crate::error::Result;
use crate::imaging::mosaic::dense_mean::DenseMean;
use crate::imaging::mosaic::image_note::ImageNote;
use crate::numerics::NUMERICS_VERSION;
use crate::optics::Optics;
use crate::plane;
use crate::resample::{Kernel, PeriodicResampling, TAPS, image_band_limit, nyquist_step};
use crate::rng::{self, Purpose};
use crate::specimen::sites::SiteKind;
use crate::specimen::units::library_cell::{LibraryCell, LibrarySite, LibraryUnit};
use crate::specimen::units::occupation::DefectKind;
use crate::specimen::units::patterns::UnitSeed;
use crate::specimen::units::unit_tag::PatternIndex;
use crate::specimen::units::unit_tag::UnitFamily;
use crate::structure::elements;

/// Version of the draws. The text from which the seeds of phonons are made begins with it.
const DRAWS_VERSION: u32 = 7;
/// Version of the images of recipes with several detectors. It is part of their keys.
const SEVERAL_VERSION: u32 = 2;
/// Number of the draw of [`Purpose::Library`] for the contents of surroundings.
const SURROUNDINGS_DRAW: u32 = 1 << 20;

/// Library cells of one family, and their images.
pub(crate) struct CellImages {
    /// The geometry.
    pub library_cell: LibraryCell,
    /// Settings of the engine. The optics are turned into the frame of the library cell.
    settings: Settings,
    /// Distance of the images' samples along x and y in Angstrom. A cell holds a whole number of samples.
    pub step_angstrom: [f64; 2],
    /// Number of samples (rows, columns).
    pub shape: [usize; 2],
    /// The propagated probes of an image. Along periodic axes there are only as many as the band limit needs.
    pub(super) scan: Scan,
    /// Interpolates the samples (rows, columns) between the probes along periodic axes.
    resampling: [Option<PeriodicResampling>; 2],
    /// Seed of the phonons of each library cell.
    seeds: Vec<u64>,
    /// Digest of the geometry and contents of each library cell.
    digests: Vec<String>,
    /// Index of the unit of each kind and cell.
    index: BTreeMap<(usize, usize), usize>,
    /// Entries without defects, by kind.
    pristine: BTreeMap<usize, Vec<usize>>,
    /// Images by detector, library cell and configuration; empty until they are simulated or read.
    images: Vec<Vec<Vec<Array2<f32>>>>,
    /// Means of the images over the configurations, by detector and library cell.
    means: Vec<Vec<Array2<f32>>>,
    /// The means on the first detector on a dense grid, by library cell; each is made when an overview needs it.
    dense_means: Vec<OnceLock<DenseMean>>,
}

/// One configuration of one unit: it identifies an image and the displacements of its atoms.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Realisation {
    /// Index of the library cell.
    pub library_cell: usize,
    /// Index of the unit in the library cell.
    pub unit: usize,
    /// Phonon configuration of the library cell.
    pub configuration: usize,
}

impl CellImages {
    /// The library cells of a family, still without images.
    pub(super) fn new(library_cell: LibraryCell, family: UnitFamily, settings: Settings) -> Self {
        let (scan, step_angstrom, shape) = samples(&library_cell, &settings.optics);
        let index =
            library_cell.units.iter().enumerate().map(|(n, u)| ((u.kind, u.cell), n)).collect();
        let mut pristine = BTreeMap::<usize, Vec<usize>>::new();
        for number in 0..library_cell.count {
            for unit in library_cell.units.iter().filter(|u| u.patterns[number].is_empty()) {
                pristine
                    .entry(unit.kind)
                    .or_default()
                    .push(number * library_cell.cells + unit.cell);
            }
        }
        let digests: Vec<String> = (0..library_cell.count)
            .map(|n| hex(&Sha256::digest(description(&library_cell, family, n))))
            .collect();
        let seed = |d: &String| u64::from_str_radix(&d[..16], 16).unwrap_or_default();
        let resampling = [(0, 1), (1, 0)].map(|(axis, k)| {
            let new = || PeriodicResampling::new(scan.shape[axis], shape[axis]);
            library_cell.periodic[k].then(new)
        });
        CellImages {
            resampling,
            scan,
            step_angstrom,
            shape,
            seeds: digests.iter().map(seed).collect(),
            digests,
            index,
            pristine,
            images: vec![vec![Vec::new(); library_cell.count]; settings.detectors.len()],
            means: Vec::new(),
            dense_means: (0..library_cell.count).map(|_| OnceLock::new()).collect(),
            library_cell,
            settings,
        }
    }

    /// Whether the images were made for this library cell with these settings.
    pub(super) fn shows(&self, library_cell: &LibraryCell, settings: &Settings) -> bool {
        self.library_cell == *library_cell && self.settings == *settings
    }

    /// Number of probes of one image.
    pub(crate) fn probes(&self) -> usize {
        self.scan.len()
    }

    /// Rows and columns of the probes' values in one configuration: the images of all detectors, one below the other.
    pub(super) fn probe_shape(&self) -> [usize; 2] {
        [self.images.len() * self.scan.shape[0], self.scan.shape[1]]
    }

    /// Adds the next configuration of a library cell from the values of its probes, in the shape [`CellImages::probe_shape`].
    pub(super) fn add(&mut self, library_cell: usize, probes: &Array2<f32>) {
        let rows = self.scan.shape[0];
        for detector in 0..self.images.len() {
            let part = probes.slice(s![detector * rows..(detector + 1) * rows, ..]);
            let image = self.resampled(part.to_owned());
            self.images[detector][library_cell].push(image);
        }
    }

    /// Interpolates an image's samples from the values of its probes.
    fn resampled(&self, probes: Array2<f32>) -> Array2<f32> {
        let axes = [Axis(0), Axis(1)].into_iter().zip(&self.resampling);
        axes.fold(probes, |image, (axis, resampling)| match resampling {
            Some(resampling) => resampling.of(image.view(), axis),
            None => image,
        })
    }

    /// The image of one configuration of a library cell on a detector, [row, column] = [y, x], fractions of the beam.
    pub(crate) fn image(
        &self,
        detector: usize,
        library_cell: usize,
        configuration: usize,
    ) -> &Array2<f32> {
        &self.images[detector][library_cell][configuration]
    }

    /// The mean over all configurations of a library cell on a detector.
    pub(crate) fn mean(&self, detector: usize, library_cell: usize) -> &Array2<f32> {
        &self.means[detector][library_cell]
    }

    /// The mean over all configurations of a library cell on the first detector, on a dense grid.
    pub(super) fn dense_mean(&self, library_cell: usize, kernel: &Kernel) -> &DenseMean {
        let [along_x, along_y] = self.library_cell.periodic;
        let made = || DenseMean::new(self.mean(0, library_cell), [along_y, along_x], kernel);
        self.dense_means[library_cell].get_or_init(made)
    }

    /// Number of configurations of a library cell.
    pub(crate) fn configurations(&self, library_cell: usize) -> usize {
        self.images[0][library_cell].len()
    }

    /// The library cell of an entry, and the entry's unit in it.
    pub(super) fn locate(&self, PatternIndex { kind, cell, .. }: PatternIndex) -> (usize, usize) {
        let at = (kind, cell % self.library_cell.cells);
        (cell / self.library_cell.cells, self.index.get(&at).copied().unwrap_or_default())
    }

    /// Position of a unit in samples (x, y).
    pub(crate) fn position(&self, unit: usize) -> [f64; 2] {
        let centre = self.library_cell.units[unit].centre;
        plane::div(plane::sub(centre, self.library_cell.scan_origin), self.step_angstrom)
    }

    /// The configurations whose mean a unit of a world shows. For a unit without defects they are drawn from all
    /// library units of its kind without defects. Any other unit shows the configurations of its entry.
    pub(crate) fn realisations(
        &self,
        entry: PatternIndex,
        shown: UnitSeed,
        configurations: usize,
    ) -> Vec<Realisation> {
        let own = |cell: usize| self.locate(PatternIndex { cell, ..entry });
        let (library_cell, unit) = own(entry.cell);
        let pristine = self.library_cell.units[unit].patterns[library_cell].is_empty();
        let Some(alike) = self.pristine.get(&entry.kind).filter(|_| pristine) else {
            return self.own_realisations(entry, configurations);
        };
        let all = alike.len() * configurations;
        let mut taken: Vec<usize> = Vec::with_capacity(configurations);
        let mut draw = 0;
        while taken.len() < configurations {
            for word in rng::words(shown.seed, Purpose::Library, draw, shown.id) {
                let pick = ((u64::from(word) * all as u64) >> 32) as usize;
                if taken.len() < configurations && !taken.contains(&pick) {
                    taken.push(pick);
                }
            }
            draw += 1;
        }
        let realisation = |pick: usize| {
            let (library_cell, unit) = own(alike[pick / configurations]);
            Realisation { library_cell, unit, configuration: pick % configurations }
        };
        taken.into_iter().map(realisation).collect()
    }

    /// The first configurations of an entry's own unit.
    fn own_realisations(&self, entry: PatternIndex, configurations: usize) -> Vec<Realisation> {
        let (library_cell, unit) = self.locate(entry);
        let realisation = |configuration| Realisation { library_cell, unit, configuration };
        (0..configurations).map(realisation).collect()
    }

    /// Displacement of site `site` of column `member` of a unit, in standard deviations along the axes of the library cell.
    pub(crate) fn displacement(
        &self,
        realisation: Realisation,
        member: usize,
        site: usize,
    ) -> [f64; 3] {
        let key = unit_key(realisation.unit, member, site);
        rng::normal3(
            self.seeds[realisation.library_cell],
            Purpose::Library,
            realisation.configuration as u32,
            key,
        )
    }

    /// The displaced atoms of one configuration of a library cell; `sigma` gives the standard deviation of each element's displacements in
    /// Angstrom.
    pub(super) fn atoms(
        &self,
        library_cell: usize,
        configuration: usize,
        sigma: &dyn Fn(u8) -> f64,
    ) -> Vec<Site> {
        let mut atoms = Vec::new();
        let seed = self.seeds[library_cell];
        let mut add = |site: &LibrarySite, key: u64, defect: bool| {
            let process = self.library_cell.process.filter(|_| defect);
            let (kind, number) = process.map_or((SiteKind::Pristine, site.number), |p| p.defect());
            if kind == SiteKind::Vacancy || number == 0 {
                return;
            }
            let n = rng::normal3(seed, Purpose::Library, configuration as u32, key);
            let position = std::array::from_fn(|k| site.position[k] + sigma(number) * n[k]);
            atoms.push(Site { position, number, sigma_angstrom: 0.0, anisotropy: None, key });
        };
        for (n, unit) in self.library_cell.units.iter().enumerate() {
            let pattern = &unit.patterns[library_cell];
            for (member, sites) in unit.members.iter().enumerate() {
                for (i, site) in sites.iter().enumerate() {
                    let defect = site.defect.is_some_and(|d| pattern.contains(&(d as u16)));
                    add(site, unit_key(n, member, i), defect);
                }
            }
        }
        for (n, column) in self.library_cell.surroundings.iter().enumerate() {
            for (i, site) in column.iter().enumerate() {
                let key = 1 << 48 | unit_key(n, 0, i);
                let drawn = || rng::uniform(seed, Purpose::Library, SURROUNDINGS_DRAW, key);
                add(site, key, site.defect.is_some() && drawn() < self.library_cell.rate);
            }
        }
        atoms
    }

    pub(super) fn plan(&self) -> Result<Plan> {
        // Slices are cut between the atoms of all columns.
        let units = self.library_cell.units.iter().flat_map(|u| u.members.iter().flatten());
        let all = units.chain(self.library_cell.surroundings.iter().flatten());
        let heights: Vec<f64> = all.filter(|s| s.number > 0).map(|s| s.position[2]).collect();
        Plan::new(&self.settings, self.library_cell.box_angstrom, &heights)
    }

    /// Describes an image (library cell, configuration) for the notes in the cache.
    pub(super) fn note(&self, sigma: &dyn Fn(u8) -> f64, image: [usize; 2]) -> ImageNote {
        ImageNote::new(&self.library_cell, &self.elements(), (&self.settings, sigma), image)
    }

    /// The name of an image (library cell, configuration): a digest of everything that decides it.
    pub(super) fn key(
        &self,
        sigma: &dyn Fn(u8) -> f64,
        [library_cell, configuration]: [usize; 2],
    ) -> String {
        let sigmas: Vec<_> =
            self.elements().into_iter().map(|n| (elements::symbol(n), sigma(n))).collect();
        let text = serde_json::json!({
            "numerics": NUMERICS_VERSION,
            "settings": self.settings,
            "sigma_angstrom": sigmas,
            "sheet": self.digests[library_cell],
            "step_angstrom": self.scan.step_angstrom,
            "shape": self.scan.shape,
            "configuration": configuration,
        });
        // Images of several detectors have a version of their own.
        let text = match self.settings.detectors.len() {
            1 => text.to_string(),
            _ => format!("{text} {SEVERAL_VERSION}"),
        };
        hex(&Sha256::digest(text))
    }

    /// The name of the images of this number of configurations: a digest of everything that decides them.
    pub(super) fn name(&self, sigma: &dyn Fn(u8) -> f64, configurations: usize) -> String {
        let first = self.key(sigma, [0, 0]);
        hex(&Sha256::digest(format!("{first} {configurations} {}", self.digests.join(" "))))
    }

    /// Computes the means over the configurations of each library cell, once all images are simulated or read.
    pub(super) fn average(&mut self) {
        let means = |library_cells: &Vec<Vec<Array2<f32>>>| {
            library_cells.iter().map(|images| mean(images, self.shape)).collect()
        };
        self.means = self.images.iter().map(means).collect();
    }

    /// All elements that the library cells may hold, ascending.
    pub(super) fn elements(&self) -> Vec<u8> {
        let units = self.library_cell.units.iter().flat_map(|u| u.members.iter().flatten());
        let sites = units.chain(self.library_cell.surroundings.iter().flatten());
        let mut numbers: BTreeSet<u8> = sites.map(|s| s.number).filter(|n| *n > 0).collect();
        numbers.extend(self.library_cell.process.map(|p| p.defect().1));
        numbers.into_iter().collect()
    }
}

/// Chooses the probes for an image of a library cell, and the distance (x, y) in Angstrom and the number (rows, columns) of its samples.
fn samples(library_cell: &LibraryCell, optics: &Optics) -> (Scan, [f64; 2], [usize; 2]) {
    let band_limit = image_band_limit(optics);
    let kept = Kernel::default_step(band_limit);
    // Values are interpolated from this many samples at least.
    let most = |k: usize| library_cell.scanned[k] / (TAPS - 1) as f64;
    let step = |k: usize, edge: f64| match library_cell.periodic[k] {
        true => edge / (edge / kept - 1e-9).ceil(),
        false => edge / (edge / kept.min(most(k)) - 1e-9).ceil(),
    };
    let step_angstrom = [0, 1].map(|k| step(k, library_cell.cell[k]));
    let count = |k: usize, step: f64| {
        let n = (library_cell.scanned[k] / step).round() as usize;
        if library_cell.periodic[k] { n } else { n + 1 }
    };
    let probes = [0, 1].map(|k| match library_cell.periodic[k] {
        true => (library_cell.scanned[k] / nyquist_step(band_limit)).ceil() as usize,
        false => count(k, step_angstrom[k]),
    });
    let step = |k: usize| match library_cell.periodic[k] {
        true => library_cell.scanned[k] / probes[k] as f64,
        false => step_angstrom[k],
    };
    let scan = Scan {
        origin_angstrom: library_cell.scan_origin,
        step_angstrom: [step(0), step(1)],
        shape: [probes[1], probes[0]],
    };
    (scan, step_angstrom, [count(1, step_angstrom[1]), count(0, step_angstrom[0])])
}

fn mean(images: &[Array2<f32>], shape: [usize; 2]) -> Array2<f32> {
    let mut sum = Array2::<f64>::zeros(shape);
    for image in images {
        sum.zip_mut_with(image, |s, v| *s += f64::from(*v));
    }
    sum.mapv(|s| (s / images.len().max(1) as f64) as f32)
}

fn unit_key(unit: usize, member: usize, site: usize) -> u64 {
    (unit as u64) << 24 | (member as u64) << 16 | site as u64
}

/// Describes the kind of defect in a fixed form. Seeds of phonons depend on this text: another text would be another library.
fn process_text(process: Option<DefectKind>) -> String {
    let text =
        |p: DefectKind| format!("Some(Process {{ element: {}, by: {:?} }})", p.element, p.by);
    process.map_or_else(|| "None".to_owned(), text)
}

/// Describes everything that decides the atoms of a library cell, except their displacements.
fn description(library_cell: &LibraryCell, family: UnitFamily, number: usize) -> String {
    use std::fmt::Write;
    let process = process_text(library_cell.process);
    let mut text = format!(
        "{DRAWS_VERSION} {:?} {process} {:?} ",
        library_cell.box_angstrom, library_cell.rate
    );
    let _ = write!(text, "{} {number} {:?} ", family.motif > 0, library_cell.scan_origin);
    let column = |text: &mut String, sites: &Vec<LibrarySite>| {
        for s in sites {
            let [x, y, z] = s.position;
            let _ = write!(text, "{x:.5} {y:.5} {z:.5} {} {:?};", s.number, s.defect);
        }
    };
    for LibraryUnit { members, patterns, .. } in &library_cell.units {
        members.iter().for_each(|m| column(&mut text, m));
        let _ = write!(text, "{:?}|", patterns[number]);
    }
    library_cell.surroundings.iter().for_each(|c| column(&mut text, c));
    if library_cell.seed != 0 {
        let _ = write!(text, " seed {}", library_cell.seed);
    }
    text
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}
