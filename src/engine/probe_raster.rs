//! Propagates fewer probes than the scan has points. The aperture limits how fine the detail of an image can be, so a dense
//! scan is simulated on a raster near the Nyquist distance and interpolated ([`crate::resample`]).

use super::detector_images::Images;
use super::plan::Plan;
use super::probe_patches::expanded_waves;
use super::probe_scan::Scan;
use super::settings::{Algorithm, ProbeStep, Settings};
use crate::error::Result;
use crate::resample::{Edge, Kernel, MARGIN, TAPS, image_band_limit};
use ndarray::Array4;

/// Up to this number of expanded probes for each wave, probes cost little, and the scan is not interpolated.
const PROBES_PER_WAVE: usize = 16;

/// The probes that are propagated for a scan, and the interpolation of the scan's values from theirs.
#[derive(Debug, Clone)]
pub struct ProbeRaster {
    scan: Scan,
    asked: Scan,
    /// `None` if a probe is propagated at every scan position.
    kernel: Option<Kernel>,
    /// Position of the first scan point, and distance of scan points: (row, column), in units of the probes' distance.
    first: [f64; 2],
    step: [f64; 2],
    edges: [Edge; 2],
}

/// The probes along one axis: their number and distance, and how many of them lie before the first scan point.
struct ProbeAxis {
    points: usize,
    step: f64,
    before: usize,
    interpolated: bool,
    edge: Edge,
}

impl ProbeRaster {
    /// Chooses the raster for a scan of the plan's cell. It is coarser than the scan along an axis where this needs fewer probes.
    ///
    /// # Errors
    /// [`crate::Error::Invalid`] for a step that is too coarse for the image.
    pub fn new(plan: &Plan, asked: &Scan) -> Result<Self> {
        let cell = plan.transmission_grid.extent_angstrom;
        let band_limit = image_band_limit(&plan.settings.optics);
        if plan.settings.probe_step == ProbeStep::Auto
            && expanded_waves(plan, asked).is_some_and(|w| asked.len() <= PROBES_PER_WAVE * w)
        {
            return Ok(Self::every(asked));
        }
        let Some(most) = step_angstrom(&plan.settings) else { return Ok(Self::every(asked)) };
        Kernel::check(most, band_limit)?;
        let counts = [asked.shape[1], asked.shape[0]];
        let axes = [0, 1].map(|i| ProbeAxis::new(counts[i], asked.step_angstrom[i], cell[i], most));
        if !axes.iter().any(|a| a.interpolated) {
            return Ok(Self::every(asked));
        }
        let along = |i: usize| axes[i].step;
        let widest = axes.iter().filter(|a| a.interpolated).map(|a| a.step).fold(0.0, f64::max);
        let origin = |i: usize| asked.origin_angstrom[i] - axes[i].before as f64 * along(i);
        Ok(ProbeRaster {
            scan: Scan {
                origin_angstrom: [origin(0), origin(1)],
                step_angstrom: [along(0), along(1)],
                shape: [axes[1].points, axes[0].points],
            },
            asked: *asked,
            kernel: Some(Kernel::new(widest, band_limit)?),
            first: [axes[1].before as f64, axes[0].before as f64],
            step: [asked.step_angstrom[1] / along(1), asked.step_angstrom[0] / along(0)],
            edges: [axes[1].edge, axes[0].edge],
        })
    }

    fn every(asked: &Scan) -> Self {
        let (first, step, edges) = ([0.0; 2], [1.0; 2], [Edge::Open; 2]);
        ProbeRaster { scan: *asked, asked: *asked, kernel: None, first, step, edges }
    }

    /// The probes that are propagated.
    pub fn scan(&self) -> &Scan {
        &self.scan
    }

    /// Whether the scan's values are interpolated.
    pub fn interpolates(&self) -> bool {
        self.kernel.is_some()
    }

    /// Interpolates the images of the scan from the images of the probes.
    pub(super) fn images(&self, images: Images) -> Images {
        let Some(kernel) = &self.kernel else { return images };
        let (thicknesses, detectors, _, _) = images.data.dim();
        let mut data =
            Array4::zeros((thicknesses, detectors, self.asked.shape[0], self.asked.shape[1]));
        for t in 0..thicknesses {
            for d in 0..detectors {
                let image = images.image(t, d);
                let fine =
                    kernel.raster(image, self.first, self.step, self.asked.shape, self.edges);
                let mut to = data.slice_mut(ndarray::s![t, d, .., ..]);
                to.zip_mut_with(&fine, |to, from| *to = from.max(0.0) as f32);
            }
        }
        Images { data, ..images }
    }
}

impl ProbeAxis {
    /// Places probes at most `most` apart for `n` scan points with distance `step` in a periodic cell.
    fn new(n: usize, step: f64, cell: f64, most: f64) -> Self {
        let span = n as f64 * step;
        let spans_cell = (span - cell).abs() < 1e-6 * cell;
        let coarse = if spans_cell {
            let points = ((cell / most - 1e-9).ceil() as usize).max(TAPS);
            let step = cell / points as f64;
            ProbeAxis { points, step, before: 0, interpolated: true, edge: Edge::Periodic }
        } else {
            let length = (n.saturating_sub(1)) as f64 * step;
            let intervals = ((length / most - 1e-9).ceil() as usize).max(TAPS - 1 - 2 * MARGIN);
            let (points, step) = (intervals + 1 + 2 * MARGIN, length / intervals as f64);
            ProbeAxis { points, step, before: MARGIN, interpolated: true, edge: Edge::Open }
        };
        match coarse.points < n {
            true => coarse,
            false => {
                ProbeAxis { points: n, before: 0, step, interpolated: false, edge: Edge::Open }
            }
        }
    }
}

/// The largest distance of probes in Angstrom; `None` if there is a probe at every scan position.
fn step_angstrom(settings: &Settings) -> Option<f64> {
    let windows = matches!(settings.algorithm, Algorithm::Window { .. });
    match settings.probe_step {
        ProbeStep::Angstrom(step) => Some(step),
        ProbeStep::Auto if windows => {
            Some(Kernel::default_step(image_band_limit(&settings.optics)))
        }
        _ => None,
    }
}

/// The largest distance in Angstrom from the scanned area to a probe outside it.
pub(crate) fn probe_margin_angstrom(settings: &Settings) -> f64 {
    MARGIN as f64 * step_angstrom(settings).unwrap_or(0.0)
}
