//! Propagates the probes of a scan, and reads their patterns.

use super::super::coherent_tail::{CoherentTail, SharedWaves, full_k, mean_transmissions};
use super::super::multislice::{Multislice, MultisliceWorkspace, PathPart};
use super::super::padded_box::{OF_PATTERNS, PaddedBox, PaddedWorkspace, SplitWorkspace};
use super::super::plan::Plan;
use super::super::probe_patches::{Patch, ProbePatches};
use super::super::probe_scan::Scan;
use super::super::stepper::TransmissionView;
use super::super::transmission::Transmission;
use super::PatternSettings;
use super::pixel_matrices::PixelMatrices;
use super::ring_sums::RingSums;
use crate::detect::{PatternDetector, RadialBins};
use crate::matrix::multiply;
use crate::plane;
use num_complex::Complex32;

/// Number of probes whose patterns are assembled from their waves at a time.
pub(super) const PROBES_TOGETHER: usize = 16;
/// Number of the box's frequencies that are kept beyond the pixels, since intensities are interpolated between them.
const MARGIN: f64 = 12.0;

/// Everything that turns probes into patterns, for one plan.
pub(super) struct PatternReader<'a> {
    plan: &'a Plan,
    engine: Multislice<'a>,
    settings: PatternSettings,
    padded: PaddedBox,
    values: ValueReader,
    /// Whether any value is read from the padded box.
    read_from_box: bool,
    /// Whether any value is read from the window's own frequencies.
    from_window: bool,
    /// Probes in the box around a window, for each focus with its weight; `None` on the full grid.
    around: Option<CoherentTail<'a>>,
}

/// Converts amplitudes to the values of a pattern.
enum ValueReader {
    Pixels {
        fine: PixelMatrices,
        /// The pixels beyond the angles of the padded box.
        outer: Option<OuterPixels>,
    },
    /// Rings that are read from the padded box, and rings that are read from the window's own frequencies.
    Rings { fine: RingSums, own: RingSums },
}

/// Pixels that are read from the window's frequencies instead of the box's.
struct OuterPixels {
    matrices: PixelMatrices,
    /// For each pixel, whether it is read from the window's frequencies.
    taken: Vec<bool>,
}

/// One thread's arrays.
pub(super) struct ReaderWorkspace {
    multislice: MultisliceWorkspace,
    padded: PaddedWorkspace,
    split: Option<SplitWorkspace>,
    /// Kept frequencies of all waves, (wave, frequency).
    fine: Vec<Complex32>,
    /// The window's own frequencies of all waves, (wave, frequency).
    own: Vec<Complex32>,
    amplitudes: Vec<Complex32>,
    pixels: PixelWorkspace,
}

/// Work space from amplitudes to pixels.
#[derive(Default)]
struct PixelWorkspace {
    intensities: Vec<f32>,
    half: Vec<f32>,
    pattern: Vec<f32>,
    rings: Vec<f64>,
}

/// The path of a group, and the transmission functions on it.
pub(super) struct GroupPath<'p> {
    pub path: &'p [PathPart],
    pub view: TransmissionView<'p>,
    pub group: &'p Patch,
}

/// The frequencies from which patterns are read.
pub(super) struct PatternReach {
    pub padded: PaddedBox,
    /// Whether each value is read from the window's own frequencies; `None` where none is.
    pub outer: Option<Vec<bool>>,
}

impl PatternReach {
    /// Chooses the frequencies. `stride` is the row stride of waves on the plan's wave grid.
    pub fn new(plan: &Plan, detector: &PatternDetector, stride: usize) -> Self {
        let wavelength = plan.settings.optics.wavelength_angstrom();
        let window = plan.wave_grid;
        let width = window.extent_angstrom[0].min(window.extent_angstrom[1]);
        let full_k = match plan.has_windows() {
            true => full_k(plan),
            false => plan.band_limit,
        };
        let boxed = |full_k: f64, edge: f64| {
            PaddedBox::new(plan, stride, [full_k, edge + MARGIN / (2.0 * width)], OF_PATTERNS)
        };
        match detector {
            PatternDetector::Pixels(detector) => {
                let pixel = detector.pixel_k(wavelength);
                let edge = (0.5 * detector.pixels as f64 + 0.5) * pixel;
                let middle = |i: usize| detector.k(i, wavelength);
                let n = detector.pixels;
                let beyond = |i: usize| middle(i % n).hypot(middle(i / n)) + pixel > full_k;
                let outer = (full_k < plan.band_limit).then(|| (0..n * n).map(beyond).collect());
                PatternReach {
                    padded: boxed(full_k, edge),
                    outer: outer.filter(|taken: &Vec<bool>| taken.contains(&true)),
                }
            }
            // On the full grid, rings sum the frequencies that annular detectors sum. The box is not read.
            PatternDetector::Rings(bins) if !plan.has_windows() => PatternReach {
                padded: boxed(1.0 / width, 0.0),
                outer: Some(vec![true; bins.rings]),
            },
            PatternDetector::Rings(bins) => {
                let end = |ring: usize| 1e-3 * bins.edge_mrad(ring + 1) / wavelength;
                let beyond = |ring: usize| end(ring) + 0.5 / width > full_k;
                let outer: Vec<bool> = (0..bins.rings).map(beyond).collect();
                PatternReach {
                    padded: boxed(full_k, 1e-3 * bins.max_angle_mrad() / wavelength),
                    outer: Some(outer).filter(|taken| taken.contains(&true)),
                }
            }
        }
    }

    /// Whether any value is read from the padded box.
    pub fn read_from_box(&self) -> bool {
        self.outer.as_ref().is_none_or(|taken| taken.contains(&false))
    }

    /// Sums over the rings that are read from the padded box, and over the rings from the window's own frequencies.
    pub fn ring_sums(&self, plan: &Plan, bins: &RadialBins) -> [RingSums; 2] {
        let per_k = 1e3 * plan.settings.optics.wavelength_angstrom();
        let taken = |ring: usize| self.outer.as_ref().is_some_and(|outer| outer[ring]);
        let angles = self.padded.frequencies().map(|[kx, ky]| per_k * kx.hypot(ky));
        let ramp = plan.detector_ramp_mrad() / self.padded.times as f64;
        let fine = RingSums::new(bins, ramp, angles, |ring| !taken(ring));
        let grid = plan.wave_grid;
        let [nx, ny] = grid.points;
        let angle = |i: usize| {
            let [kx, ky] = grid.k(i / nx, i % nx);
            kx.hypot(ky) * plan.settings.optics.wavelength_angstrom() * 1e3
        };
        let own = RingSums::new(bins, plan.detector_ramp_mrad(), (0..nx * ny).map(angle), taken);
        [fine, own]
    }
}

/// Divides a scan into patches, row by row. On the full grid each row is a patch.
pub(super) fn patches(plan: &Plan, scan: &Scan) -> ProbePatches {
    if plan.has_windows() {
        return ProbePatches::new(plan, scan);
    }
    let [rows, columns] = scan.shape;
    let row = |y: usize| {
        let at = |x: usize| (y * columns + x, scan.position(y * columns + x));
        Patch { origin: (0, 0), probes: (0..columns).map(at).collect() }
    };
    ProbePatches { patches: (0..rows).map(row).collect(), error: None }
}

impl<'a> PatternReader<'a> {
    pub fn new(plan: &'a Plan, settings: PatternSettings) -> Self {
        let engine = Multislice::lending(plan);
        let wavelength = plan.settings.optics.wavelength_angstrom();
        let reach = PatternReach::new(plan, &settings.detector, engine.stride());
        let (read_from_box, from_window) = (reach.read_from_box(), reach.outer.is_some());
        let window = (plan.wave_grid.points, plan.wave_grid.extent_angstrom);
        let values = match &settings.detector {
            PatternDetector::Pixels(detector) => ValueReader::Pixels {
                fine: PixelMatrices::of_box(detector, wavelength, &reach.padded),
                outer: reach.outer.map(|taken| OuterPixels {
                    matrices: PixelMatrices::by_area(detector, wavelength, window),
                    taken,
                }),
            },
            PatternDetector::Rings(bins) => {
                let [fine, own] = reach.ring_sums(plan, bins);
                ValueReader::Rings { fine, own }
            }
        };
        let padded = reach.padded;
        let around = plan.has_windows().then(|| CoherentTail::new(plan, &padded, engine.bins()));
        PatternReader { plan, engine, settings, padded, values, read_from_box, from_window, around }
    }

    pub fn workspace(&self) -> ReaderWorkspace {
        ReaderWorkspace {
            multislice: self.engine.workspace(),
            padded: self.padded.workspace(),
            split: self.around.as_ref().map(CoherentTail::workspace),
            fine: Vec::new(),
            own: Vec::new(),
            amplitudes: Vec::new(),
            pixels: PixelWorkspace::default(),
        }
    }

    /// Number of values of a pattern.
    fn pattern_len(&self) -> usize {
        self.settings.detector.values()
    }

    /// Patches of probes that are propagated together, row by row, and the waves that all patches share, if there are any.
    pub fn groups(&self, scan: &Scan) -> (Vec<Patch>, Option<SharedWaves>) {
        let patches = patches(self.plan, scan);
        match (patches.error, &self.around) {
            (Some(error), Some(around)) => {
                let waves = around.shared(&self.padded, patches.half(self.plan), error);
                (patches.patches, Some(waves))
            }
            _ => {
                let most = self.engine.waves_together();
                (patches.patches.into_iter().flat_map(|patch| patch.split(most)).collect(), None)
            }
        }
    }

    /// The paths of groups in one configuration, from [`Multislice::paths`].
    pub fn paths(
        &mut self,
        transmission: &Transmission,
        groups: &[Patch],
    ) -> (Vec<Vec<PathPart>>, Vec<usize>) {
        self.engine.paths(transmission, groups)
    }

    /// Adds the patterns of a group in one configuration to `out`, (probe, recorded thickness, ky, kx) row-major.
    pub fn add(
        &self,
        w: &mut ReaderWorkspace,
        at: &GroupPath<'_>,
        shared: Option<&SharedWaves>,
        out: &mut [f32],
    ) {
        let means = mean_transmissions(self.plan, at.view);
        match (shared, &self.around) {
            (Some(waves), Some(around)) => self.add_expanded(w, at, (waves, around), &means, out),
            _ => self.add_each(w, at, &means, out),
        }
    }

    /// Adds patterns of probes that are expanded in waves.
    fn add_expanded(
        &self,
        w: &mut ReaderWorkspace,
        at: &GroupPath<'_>,
        (shared, around): (&SharedWaves, &CoherentTail<'_>),
        means: &[Complex32],
        out: &mut [f32],
    ) {
        let (n, probes) = (shared.len(), at.group.probes.len());
        let coefficients = around.coefficients(shared, &at.group.probes);
        let (kept, own) = (self.padded.len(), self.own_len());
        w.fine.resize(n * kept, Complex32::ZERO);
        w.own.resize(n * own, Complex32::ZERO);
        let inside = shared.inside.iter().map(Vec::as_slice);
        self.engine.begin_all(&mut w.multislice, inside);
        for (r, part) in at.path.iter().enumerate() {
            self.engine.step_all(&mut w.multislice, n, &part.steps, at.view);
            let phases = self.padded.tail_phases(self.plan, part);
            for j in 0..n {
                let psi = self.engine.spectrum(&mut w.multislice, j);
                self.own_frequencies(psi, &mut w.own[j * own..][..own]);
                if !self.read_from_box {
                    continue;
                }
                let fine = &mut w.fine[j * kept..][..kept];
                self.padded.sample(psi, None, &mut w.padded, fine);
                if self.settings.coherent_tail {
                    self.padded.add_tail(fine, &shared.outside[j], means[r], &phases);
                }
            }
            for (weight, c) in &coefficients {
                let weight = *weight as f32;
                for first in (0..probes).step_by(PROBES_TOGETHER) {
                    let some = PROBES_TOGETHER.min(probes - first);
                    let c = (&c[first..], [1, probes]);
                    let to = |i: usize| ((first + i) * at.path.len() + r) * self.pattern_len();
                    w.amplitudes.resize(some * kept.max(own), Complex32::ZERO);
                    let amplitudes = &mut w.amplitudes;
                    if self.read_from_box {
                        multiply((some, kept, n), (amplitudes, kept), c, (&w.fine, kept));
                        for (i, fine) in amplitudes.chunks_exact(kept).take(some).enumerate() {
                            let out = &mut out[to(i)..][..self.pattern_len()];
                            self.read_fine(fine, weight, &mut w.pixels, out);
                        }
                    }
                    if own == 0 {
                        continue;
                    }
                    multiply((some, own, n), (amplitudes, own), c, (&w.own, own));
                    for (i, own) in amplitudes.chunks_exact(own).take(some).enumerate() {
                        let out = &mut out[to(i)..][..self.pattern_len()];
                        self.read_own(own, weight, &mut w.pixels, out);
                    }
                }
            }
        }
    }

    /// Adds patterns of probes that are each propagated.
    fn add_each(
        &self,
        w: &mut ReaderWorkspace,
        at: &GroupPath<'_>,
        means: &[Complex32],
        out: &mut [f32],
    ) {
        let probes = &at.group.probes;
        let (kept, own) = (self.padded.len(), self.own_len());
        w.fine.resize(kept, Complex32::ZERO);
        w.own.resize(own, Complex32::ZERO);
        for focus in 0..self.engine.foci() {
            let weight = self.engine.weight(focus) as f32;
            let (mut inside, mut outside) = (Vec::new(), Vec::new());
            for (_, position) in probes {
                match (&self.around, &mut w.split) {
                    (Some(around), Some(split)) => {
                        let (held, rest) = around.probe(&self.padded, (*position, focus), split);
                        inside.push(held);
                        outside.push(rest);
                    }
                    _ => inside.push(self.engine.probe(focus, *position)),
                }
            }
            self.engine.begin_all(&mut w.multislice, inside.iter().map(Vec::as_slice));
            for (r, part) in at.path.iter().enumerate() {
                self.engine.step_all(&mut w.multislice, probes.len(), &part.steps, at.view);
                let phases = self.padded.tail_phases(self.plan, part);
                for (j, (_, position)) in probes.iter().enumerate() {
                    let to = (j * at.path.len() + r) * self.pattern_len();
                    let psi = self.engine.spectrum(&mut w.multislice, j);
                    // On the full grid, the point where the tilted beam leaves is moved to the middle of the box.
                    let centre = self.around.is_none().then(|| {
                        let way = self.plan.beam_shift(part.height_angstrom);
                        plane::add(*position, way)
                    });
                    let out = &mut out[to..][..self.pattern_len()];
                    self.own_frequencies(psi, &mut w.own[..own]);
                    self.read_own(&w.own[..own], weight, &mut w.pixels, out);
                    if !self.read_from_box {
                        continue;
                    }
                    self.padded.sample(psi, centre, &mut w.padded, &mut w.fine[..kept]);
                    if let Some(rest) = outside.get(j).filter(|_| self.settings.coherent_tail) {
                        self.padded.add_tail(&mut w.fine[..kept], rest, means[r], &phases);
                    }
                    self.read_fine(&w.fine[..kept], weight, &mut w.pixels, out);
                }
            }
        }
    }

    /// Adds to a pattern the values that are read from the kept frequencies of the box.
    fn read_fine(
        &self,
        amplitudes: &[Complex32],
        weight: f32,
        w: &mut PixelWorkspace,
        out: &mut [f32],
    ) {
        match &self.values {
            ValueReader::Pixels { fine, outer } => {
                let taken = outer.as_ref().map(|outer| outer.taken.as_slice());
                let wanted = |i: usize| taken.is_none_or(|taken| !taken[i]);
                w.read(fine, (amplitudes, weight), wanted, out);
            }
            ValueReader::Rings { fine, .. } => fine.add(amplitudes, weight, &mut w.rings, out),
        }
    }

    /// Adds to a pattern the values that are read from the window's own frequencies, if there are any.
    fn read_own(
        &self,
        amplitudes: &[Complex32],
        weight: f32,
        w: &mut PixelWorkspace,
        out: &mut [f32],
    ) {
        match &self.values {
            ValueReader::Pixels { outer: Some(outer), .. } => {
                w.read(&outer.matrices, (amplitudes, weight), |i| outer.taken[i], out);
            }
            ValueReader::Pixels { outer: None, .. } => {}
            ValueReader::Rings { own, .. } => {
                if self.from_window {
                    own.add(amplitudes, weight, &mut w.rings, out);
                }
            }
        }
    }

    /// Number of the window's own frequencies that are read; 0 where all values are read from the box.
    fn own_len(&self) -> usize {
        let [x, y] = self.plan.wave_grid.points;
        if self.from_window { x * y } else { 0 }
    }

    /// Copies the window's own frequencies within the band limit, as fractions of the beam's amplitude.
    fn own_frequencies(&self, psi: &[Complex32], out: &mut [Complex32]) {
        if out.is_empty() {
            return;
        }
        let grid = &self.plan.wave_grid;
        let ([nx, ny], stride) = (grid.points, self.engine.stride());
        let scale = 1.0 / (nx * ny) as f32;
        for iy in 0..ny {
            for ix in 0..nx {
                let [kx, ky] = grid.k(iy, ix);
                let held = kx.hypot(ky) < self.plan.band_limit;
                let value = psi[iy * stride + ix];
                out[iy * nx + ix] = if held { value * scale } else { Complex32::ZERO };
            }
        }
    }
}

impl PixelWorkspace {
    /// Adds the intensities of amplitudes, multiplied by a weight, to the wanted pixels.
    fn read(
        &mut self,
        matrices: &PixelMatrices,
        (amplitudes, weight): (&[Complex32], f32),
        wanted: impl Fn(usize) -> bool,
        out: &mut [f32],
    ) {
        self.intensities.clear();
        self.intensities.extend(amplitudes.iter().map(|v| v.norm_sqr() * weight));
        self.pattern.resize(out.len(), 0.0);
        matrices.pattern(&self.intensities, &mut self.half, &mut self.pattern);
        for (i, (to, v)) in out.iter_mut().zip(&self.pattern).enumerate() {
            if wanted(i) {
                *to += v;
            }
        }
    }
}
