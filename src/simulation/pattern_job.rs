//! Diffraction patterns of every probe of a scan (4D-STEM).

use std::ops::Range;

use ndarray::{Array2, Array5, ArrayView5, Axis};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::job::SimulationJob;
use super::microscope::MicroscopeRequest;
use super::numerics_request::NumericsRequest;
use super::request::SimulationRequest;
use super::source_patterns::SourceRaster;
use super::time_estimate::threads;
use crate::detect::{
    Detector, DetectorMtf, MtfFilter, PatternDetector, PixelatedDetector, RadialBins,
};
use crate::engine::patterns::{
    PatternCost, PatternRows, PatternSettings, pattern_rows, simulate_pattern_rows,
    simulate_patterns,
};
use crate::engine::{Plan, Scan, Settings};
use crate::error::{Error, Result};
use crate::files::Shard;
use crate::imaging::Noise;
use crate::progress::{Progress, Silent};
use crate::setting::Setting;

/// A pixelated detector and its read-out.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PatternsRequest {
    /// Pixels along each edge.
    pub pixels: usize,
    /// Half the width of the detector in mrad.
    pub max_angle_mrad: f64,
    /// Adds the part of the probe that windows cut off (see [`PatternSettings`]).
    pub coherent_tail: bool,
    /// Sums over rings of this width in mrad up to `max_angle_mrad`, in place of pixels.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub radial_mrad: Option<f64>,
    /// Modulation transfer function of the detector, which spreads the electrons of a pixel over its neighbours; `None`: no spread.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mtf: Option<DetectorMtf>,
}

impl Default for PatternsRequest {
    /// 64 x 64 pixels to 100 mrad.
    fn default() -> Self {
        PatternsRequest {
            pixels: 64,
            max_angle_mrad: 100.0,
            coherent_tail: true,
            radial_mrad: None,
            mtf: None,
        }
    }
}

/// Values of patterns.
#[derive(Debug, Clone)]
pub enum PatternValues<'a> {
    /// Fractions of the beam for each pixel.
    Fractions(ArrayView5<'a, f32>),
    /// Counted electrons.
    Counts(Array5<u32>),
}

/// Patterns of neighbouring rows of the scan, (thickness, row, column, ky, kx).
#[derive(Debug, Clone)]
pub struct PatternBand<'a> {
    /// The first row.
    pub first_row: usize,
    /// The patterns.
    pub values: PatternValues<'a>,
}

/// Patterns that were simulated before: parts of several processes.
pub trait StoredPatterns {
    /// The rows of [`SimulationJob::simulated_scan`] that are stored for a plan: sorted ranges that do not overlap.
    fn ranges(&self, plan: usize) -> Vec<Range<usize>>;

    /// The fractions of the beam, (thickness, row, column, ky, kx); `None` if they cannot be used.
    fn load(&self, plan: usize, rows: &Range<usize>) -> Option<Array5<f32>>;
}

/// Shortest and longest time in seconds of reading patterns on this number of threads.
pub(super) fn seconds(cost: &PatternCost, threads: usize) -> [f64; 2] {
    READ_FLOPS.map(|speed| cost.flops / speed / threads as f64)
}

/// Operations per second by which a thread reads patterns: on an idle machine, and on a busy one.
const READ_FLOPS: [f64; 2] = [8e9, 2e9];
/// Largest width in Angstrom of a window that the program chooses. Above it the full grid takes less time.
const MOST_WINDOW_ANGSTROM: f64 = 40.0;
/// Width in Angstrom of the window for a probe in focus at the surface of a thin specimen. Patterns of SrTiO3 (39 to 98 A) are then off by
/// less than 0.1 % of their maximum.
const LEAST_WINDOW_ANGSTROM: f64 = 13.0;

impl PatternsRequest {
    /// The detector.
    ///
    /// # Errors
    /// [`Error::Invalid`] for values that no detector has, and for a transfer function of rings.
    pub(crate) fn detector(&self) -> Result<PatternDetector> {
        if let Some(mtf) = &self.mtf {
            mtf.check()?;
        }
        let Some(width) = self.radial_mrad else {
            let pixels =
                PixelatedDetector { pixels: self.pixels, max_angle_mrad: self.max_angle_mrad };
            pixels.check()?;
            return Ok(pixels.into());
        };
        if self.mtf.is_some() {
            let expected = "spreads electrons over pixels, and rings have no pixels; leave it out";
            return Err(Error::invalid(Setting::DetectorMtf, "given", expected));
        }
        Ok(PatternDetector::Rings(RadialBins::new(width, self.max_angle_mrad)?))
    }

    fn settings(&self) -> Result<PatternSettings> {
        Ok(PatternSettings { detector: self.detector()?, coherent_tail: self.coherent_tail })
    }
}

/// The numerics for patterns. Where the request names no engine, they use windows that contain the probe throughout the specimen, if these
/// are narrower than the cell.
pub(super) fn numerics(
    request: &SimulationRequest,
    size_angstrom: [f64; 3],
) -> Result<NumericsRequest> {
    let mut numerics = request.numerics.clone();
    if let Some(percent) = numerics.accuracy_percent {
        let expected =
            "chooses windows for annular detectors only; give the width of the window of patterns";
        return Err(Error::invalid(Setting::AccuracyPercent, percent, expected));
    }
    let free = numerics.engine.is_none()
        && numerics.window_angstrom.is_none()
        && numerics.interpolation.is_none();
    let width = pattern_window_angstrom(&request.microscope, size_angstrom[2]);
    let cell = size_angstrom[0].min(size_angstrom[1]);
    if free && width <= MOST_WINDOW_ANGSTROM && width < 0.9 * cell {
        numerics.window_angstrom = Some(width);
    }
    Ok(numerics)
}

/// Width in Angstrom of a window that contains the probe throughout a specimen of this thickness, for patterns within 0.1 % of their maximum.
pub(crate) fn pattern_window_angstrom(
    microscope: &MicroscopeRequest,
    thickness_angstrom: f64,
) -> f64 {
    let semiangle = 1e-3 * microscope.semiangle_mrad;
    let defocus = microscope.defocus_angstrom.iter().map(|d| d.abs()).fold(0.0, f64::max);
    let reach = semiangle * (defocus + thickness_angstrom);
    (10.0 * (2.0 * reach + LEAST_WINDOW_ANGSTROM)).ceil() / 10.0
}

/// The settings for patterns: the grid carries the detector, and every probe is propagated.
pub(super) fn settings(request: &PatternsRequest, scan: Settings) -> Result<Settings> {
    let whole = Detector::new("pattern", 0.0, request.detector()?.max_angle_mrad());
    Ok(Settings { detectors: vec![whole], probe_step: crate::engine::ProbeStep::Scan, ..scan })
}

/// Refuses settings that patterns cannot have.
pub(super) fn check(request: &SimulationRequest) -> Result<()> {
    if request.patterns.is_none() {
        return Ok(());
    }
    if request.plane_wave {
        let expected = "has no probes, and so no patterns; leave one of the two out";
        return Err(Error::invalid(Setting::PlaneWave, "true", expected));
    }
    let share = request.microscope.source_lorentz_share;
    if share != 0.0 {
        let expected =
            "the source of patterns is a Gaussian without long tails; leave the share out";
        return Err(Error::invalid(Setting::SourceLorentzShare, share, expected));
    }
    Ok(())
}

impl SimulationJob {
    /// The settings of the pixelated detector; `None` for a request for images.
    pub fn pattern_settings(&self) -> Option<PatternSettings> {
        self.request().patterns.as_ref().and_then(|patterns| patterns.settings().ok())
    }

    /// Simulates the patterns of all probes at one defocus, number `plan`, and passes them to `take` by rows. Counts electrons if the
    /// request gives a dose. Rows that are `stored` are not simulated.
    ///
    /// # Errors
    /// Errors of [`simulate_patterns`]; [`Error::Invalid`] for a request without patterns; errors of `take`.
    pub fn patterns(
        &self,
        plan: usize,
        stored: Option<&dyn StoredPatterns>,
        take: &mut dyn FnMut(PatternBand<'_>) -> Result<()>,
        progress: &dyn Progress,
    ) -> Result<()> {
        let settings = self.asked()?;
        let filter = self.mtf_filter(&settings);
        let records = self.plans()[plan].record_after.len();
        let mut hand_on = |rows: PatternRows<'_>| {
            let first_row = rows.first_row;
            let spread = filter.as_ref().map(|filter| {
                let mut data = rows.data.to_owned();
                spread(filter, &mut data);
                data
            });
            let data = spread.as_ref().map_or(rows.data, |data| data.view());
            let rows = PatternRows { first_row, data };
            let values = match self.electrons_per_pixel() {
                None => PatternValues::Fractions(rows.data),
                Some(electrons) => {
                    let first = (plan * records * self.scan().len(), electrons);
                    PatternValues::Counts(self.counted(&rows, first))
                }
            };
            take(PatternBand { first_row, values })
        };
        let raster = self.source_raster();
        let scan = raster.as_ref().map_or(self.scan(), SourceRaster::scan);
        let mut of_source = raster.as_ref().map(SourceRaster::rows);
        let mut take_rows = |rows: PatternRows<'_>| match &mut of_source {
            None => hand_on(rows),
            Some(source) => source.push(&rows, &mut hand_on),
        };
        let mut next = 0;
        for rows in stored.map_or(Vec::new(), |stored| stored.ranges(plan)) {
            let Some(data) = stored.and_then(|stored| stored.load(plan, &rows)) else { continue };
            self.simulated_rows(plan, next..rows.start, &mut take_rows, progress)?;
            take_rows(PatternRows { first_row: rows.start, data: data.view() })?;
            next = rows.end;
        }
        self.simulated_rows(plan, next..scan.shape[0], &mut take_rows, progress)
    }

    /// The rows of [`SimulationJob::simulated_scan`] that one of several processes simulates at one defocus.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a request without patterns.
    pub fn pattern_part(&self, plan: usize, shard: Shard) -> Result<Range<usize>> {
        self.asked()?;
        Ok(pattern_rows(&self.plans()[plan], &self.simulated_scan()?, shard))
    }

    /// Simulates rows of [`SimulationJob::simulated_scan`]: fractions of the beam, before source, transfer function and noise.
    pub(crate) fn simulated_rows(
        &self,
        plan: usize,
        rows: Range<usize>,
        take: &mut dyn FnMut(PatternRows<'_>) -> Result<()>,
        progress: &dyn Progress,
    ) -> Result<()> {
        if rows.is_empty() {
            return Ok(());
        }
        let (settings, scan) = (self.asked()?, self.simulated_scan()?);
        let (plan, frames) = (&self.plans()[plan], self.specimen().frames());
        simulate_pattern_rows(plan, &frames, (&scan, rows), settings, take, progress)
    }

    /// The raster of probes that the source needs; `None` for a point source, and for images.
    fn source_raster(&self) -> Option<SourceRaster> {
        self.request().patterns.as_ref()?;
        let optics = &self.plans()[0].settings.optics;
        let highest_k = 2e-3 * optics.semiangle_mrad / optics.wavelength_angstrom();
        Some(SourceRaster::new(self.request().microscope.source()?, self.scan(), highest_k))
    }

    /// The scan that is simulated for patterns; `None` for images.
    pub(super) fn pattern_scan(&self) -> Option<Scan> {
        self.request().patterns.as_ref()?;
        Some(self.source_raster().map_or(*self.scan(), |raster| *raster.scan()))
    }

    /// The filter that spreads electrons over pixels, if the request gives a transfer function.
    fn mtf_filter(&self, settings: &PatternSettings) -> Option<MtfFilter> {
        let mtf = self.request().patterns.as_ref()?.mtf.as_ref()?;
        Some(MtfFilter::new(mtf, settings.detector.pixels()?.pixels))
    }

    /// The pattern of the beam without a specimen, at the first defocus.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a request without patterns.
    pub fn vacuum_pattern(&self) -> Result<Array2<f32>> {
        let settings = self.asked()?;
        let [ny, nx] = settings.detector.shape();
        let mut found = Array2::zeros((ny, nx));
        let mut take = |rows: PatternRows<'_>| {
            found.assign(
                &rows.data.index_axis(Axis(0), 0).index_axis(Axis(0), 0).index_axis(Axis(0), 0),
            );
            Ok(())
        };
        let plan = &self.plans()[0];
        let single =
            Settings { phonons: None, thicknesses_angstrom: Vec::new(), ..plan.settings.clone() };
        let plan =
            Plan::new(&single, self.specimen().size_angstrom, &self.specimen().heights_angstrom)?;
        let [x, y, _] = self.specimen().size_angstrom;
        let middle =
            Scan { origin_angstrom: [0.5 * x, 0.5 * y], step_angstrom: [1.0; 2], shape: [1, 1] };
        simulate_patterns(&plan, &[&[]], &middle, settings, &mut take, &Silent)?;
        if let Some(filter) = self.mtf_filter(&settings) {
            filter.apply(found.view_mut(), &mut filter.workspace());
        }
        Ok(found)
    }

    /// The cost of the patterns of a plan, in addition to its waves; `None` for images.
    pub(super) fn pattern_cost(&self, plan: &Plan) -> Option<PatternCost> {
        Some(PatternCost::new(plan, &self.pattern_scan()?, &self.pattern_settings()?))
    }

    /// Memory in bytes of the patterns of a plan, in addition to its waves; 0 for images.
    pub(super) fn pattern_bytes(&self, plan: &Plan) -> u64 {
        let (Some(cost), Some(settings)) = (self.pattern_cost(plan), self.pattern_settings())
        else {
            return 0;
        };
        let values = plan.record_after.len() * settings.detector.values();
        let held = self.source_raster().map_or(0, |raster| raster.held_bytes(values));
        cost.memory_bytes(threads()) + held
    }

    /// The settings of the pixelated detector.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a request without patterns.
    pub(crate) fn asked(&self) -> Result<PatternSettings> {
        self.pattern_settings().ok_or_else(|| {
            let expected = "set `patterns` of the request";
            Error::invalid(Setting::PatternPixels, "a request for images", expected)
        })
    }

    /// Counts electrons on every pixel of some rows. `first` is the number of the request's first pattern, `electrons` the electrons of a
    /// probe.
    fn counted(&self, rows: &PatternRows<'_>, (first, electrons): (usize, f64)) -> Array5<u32> {
        let mut counts = Array5::zeros(rows.data.dim());
        let (probes, columns) = (self.scan().len(), self.scan().shape[1]);
        for (t, by_row) in rows.data.outer_iter().enumerate() {
            for (r, by_column) in by_row.outer_iter().enumerate() {
                for (c, pattern) in by_column.outer_iter().enumerate() {
                    let number = first + t * probes + (rows.first_row + r) * columns + c;
                    let noise = Noise {
                        seed: self.request().specimen.seed,
                        electrons_per_pixel: electrons,
                        origin_px: [number * pattern.nrows(), 0],
                        full_width_px: pattern.ncols(),
                        detector: 0,
                    };
                    let counted = noise.counted(&pattern.to_owned());
                    counts.slice_mut(ndarray::s![t, r, c, .., ..]).assign(&counted);
                }
            }
        }
        counts
    }
}

/// Spreads the electrons of all patterns.
fn spread(filter: &MtfFilter, data: &mut Array5<f32>) {
    let mut patterns: Vec<_> = data
        .outer_iter_mut()
        .flat_map(|rows| rows.into_outer_iter_mut())
        .flat_map(|row| row.into_outer_iter_mut())
        .collect();
    patterns.par_iter_mut().for_each_init(
        || filter.workspace(),
        |workspace, pattern| filter.apply(pattern.view_mut(), workspace),
    );
}
