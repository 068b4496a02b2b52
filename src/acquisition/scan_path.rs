//! Positions of the beam while each pixel is recorded.

use std::f64::consts::TAU;

use super::acquisition_settings::Acquisition;
use crate::lengths;
use crate::plane;
use crate::rng::{Purpose, normal3, uniform};

/// The intended pixels of a scan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScanFrame {
    /// Rows and columns.
    pub shape: [usize; 2],
    /// Edge of a pixel in nm.
    pub pixel_nm: f64,
    /// Place (x, y) of the centre of the first pixel in nm.
    pub origin_nm: [f64; 2],
}

impl ScanFrame {
    /// Edge of a pixel in Angstrom.
    pub(crate) fn pixel_angstrom(&self) -> f64 {
        lengths::angstrom(self.pixel_nm)
    }
}

/// Standard deviation in Angstrom of the Gaussian that stands for the image of a column.
const COLUMN_SIGMA_ANGSTROM: f64 = 0.4;

/// The places of a scan on the specimen: the intended places, moved by
///
/// - scale and shear, about the middle of the frame;
/// - the overshoot `-a exp(-t / tau)` along x, t from the beginning of the line;
/// - hum, `a sin(2 pi f t + phase)`; the scan is not locked to the mains, so the phase is random;
/// - jitter of each line;
/// - drift of the specimen since the first pixel, with the sign turned: `v t`, and a random walk, which moves on from line to line.
///
/// The beam stands still during the dwell time; t is the time of its middle. Scans of several frames continue without a pause.
#[derive(Debug, Clone)]
pub struct ScanPath {
    settings: Acquisition,
    frame: ScanFrame,
    /// Displacement by the random walk at every line of every frame, in nm.
    walk_nm: Vec<[f64; 2]>,
    /// Displacement by the jitter of every line of every frame, in nm.
    jitter_nm: Vec<[f64; 2]>,
    /// Displacement along x by the overshoot, for each column, in nm.
    overshoot_nm: Vec<f64>,
    hum_phase: f64,
}

impl ScanPath {
    /// Draws the path of a scan; `seed` decides all random numbers.
    pub fn new(settings: &Acquisition, frame: ScanFrame, seed: u64) -> Self {
        let settings = *settings;
        let lines = settings.frames * frame.shape[0];
        let mut path = ScanPath {
            settings,
            frame,
            walk_nm: Vec::with_capacity(lines),
            jitter_nm: Vec::with_capacity(lines),
            overshoot_nm: Vec::new(),
            hum_phase: TAU * uniform(seed, Purpose::Hum, 0, 0),
        };
        let step = settings.drift_random_nm_per_sqrt_s * path.line_s().sqrt();
        let mut at = [0.0; 2];
        for line in 0..lines as u64 {
            path.walk_nm.push(at);
            let [x, y, _] = normal3(seed, Purpose::Drift, 0, line);
            at = [at[0] + step * x, at[1] + step * y];
            let [x, y, _] = normal3(seed, Purpose::LineJitter, 0, line);
            let sigma = lengths::nm(settings.line_jitter_angstrom);
            path.jitter_nm.push([sigma * x, sigma * y]);
        }
        let decay = |column: usize| {
            let t = (column as f64 + 0.5) * settings.dwell_us;
            -lengths::nm(settings.overshoot_angstrom) * libm::exp(-t / settings.overshoot_decay_us)
        };
        path.overshoot_nm = (0..frame.shape[1]).map(decay).collect();
        path
    }

    /// The intended pixels.
    pub(crate) fn frame(&self) -> &ScanFrame {
        &self.frame
    }

    /// Number of frames.
    pub(crate) fn frames(&self) -> usize {
        self.settings.frames
    }

    /// Time in s of each line of each frame, and drift (x, y) of the specimen in nm.
    pub(crate) fn drift_curve(&self) -> Vec<[f64; 3]> {
        let lines = (0..self.frames()).flat_map(|f| (0..self.frame.shape[0]).map(move |r| (f, r)));
        let line = |(frame, row): (usize, usize)| {
            let [x, y] = self.drift_nm(frame, row);
            [self.line_start_s(frame, row), x, y]
        };
        lines.map(line).collect()
    }

    /// Time from one line to the next in s.
    pub(crate) fn line_s(&self) -> f64 {
        self.settings.line_s(self.frame.shape[1])
    }

    /// Time that all frames take in s.
    pub(crate) fn duration_s(&self) -> f64 {
        self.line_s() * self.walk_nm.len() as f64
    }

    /// Time from the start of the first line to the start of this line, in s.
    pub(crate) fn line_start_s(&self, frame: usize, row: usize) -> f64 {
        self.line_s() * (frame * self.frame.shape[0] + row) as f64
    }

    /// Drift (x, y) of the specimen in nm at the start of a line.
    pub(crate) fn drift_nm(&self, frame: usize, row: usize) -> [f64; 2] {
        let t = self.line_start_s(frame, row);
        let walk = self.walk_nm[frame * self.frame.shape[0] + row];
        plane::add(self.settings.drift_nm_per_s.map(|v| v * t), walk)
    }

    /// Place (x, y) in nm of the beam on the specimen while a pixel is recorded.
    pub fn place_nm(&self, frame: usize, row: usize, column: usize) -> [f64; 2] {
        let overshoot = self.overshoot_nm[column];
        let (row, column) = (row as f64, column as f64);
        let slow = self.slow_nm(frame, row, column);
        let fast = self.fast_nm(frame, row, column);
        let meant = [column, row].map(|p| p * self.frame.pixel_nm);
        let own = [overshoot, 0.0];
        [meant, slow, fast, own].into_iter().fold(self.frame.origin_nm, plane::add)
    }

    /// Displacement by scale, shear and drift. Rows beyond the frame have the random walk of its edge.
    fn slow_nm(&self, frame: usize, row: f64, column: f64) -> [f64; 2] {
        let ScanFrame { shape, pixel_nm, .. } = self.frame;
        let from_middle = [(column, shape[1]), (row, shape[0])]
            .map(|(at, n)| (at - 0.5 * (n as f64 - 1.0)) * pixel_nm);
        let Acquisition { scale_percent, shear_percent, drift_nm_per_s, .. } = self.settings;
        let t = self.time_s(frame, row, column);
        let walk = self.walk_nm[self.line(frame, row)];
        let shear = [0.01 * shear_percent * from_middle[1], 0.0];
        [0, 1].map(|k| {
            let scale = 0.01 * scale_percent[k] * from_middle[k];
            scale + shear[k] - drift_nm_per_s[k] * t - walk[k]
        })
    }

    /// Displacement by jitter and hum.
    fn fast_nm(&self, frame: usize, row: f64, column: f64) -> [f64; 2] {
        let jitter = self.jitter_nm[self.line(frame, row)];
        let Acquisition { hum_angstrom, hum_hz, .. } = self.settings;
        if hum_angstrom == [0.0; 2] {
            return jitter;
        }
        let wave = libm::sin(TAU * hum_hz * self.time_s(frame, row, column) + self.hum_phase);
        plane::add(jitter, lengths::nm(hum_angstrom).map(|hum| hum * wave))
    }

    fn line(&self, frame: usize, row: f64) -> usize {
        let rows = self.frame.shape[0];
        frame * rows + (row.round().max(0.0) as usize).min(rows - 1)
    }

    /// Time of the middle of a pixel's dwell since the first line began, in s.
    fn time_s(&self, frame: usize, row: f64, column: f64) -> f64 {
        let line = (frame * self.frame.shape[0]) as f64 + row;
        self.line_s() * line + 1e-6 * (column + 0.5) * self.settings.dwell_us
    }

    /// The smallest and the largest x and y, in nm, of the beam while it records some rows of all frames.
    pub(crate) fn reach_nm(&self, rows: std::ops::Range<usize>) -> [[f64; 2]; 2] {
        let Acquisition { hum_angstrom, overshoot_angstrom, .. } = self.settings;
        let mut reach = [[f64::INFINITY, f64::NEG_INFINITY]; 2];
        let ends = [0.0, self.frame.shape[1] as f64 - 1.0];
        for frame in 0..self.settings.frames {
            for row in rows.clone() {
                let jitter = self.jitter_nm[self.line(frame, row as f64)];
                for column in ends {
                    let slow = self.slow_nm(frame, row as f64, column);
                    for (k, meant) in [column, row as f64].into_iter().enumerate() {
                        let at = self.frame.origin_nm[k] + meant * self.frame.pixel_nm;
                        let at = at + slow[k] + jitter[k];
                        reach[k] = [reach[k][0].min(at), reach[k][1].max(at)];
                    }
                }
            }
        }
        let own = [lengths::nm(overshoot_angstrom.abs()), 0.0];
        let more = plane::add(lengths::nm(hum_angstrom), own);
        plane::per_axis(reach, more, |[low, high], more| [low - more, high + more])
    }

    /// The place where a column of atoms at (x, y) in nm appears in a frame: (x, y) in pixels from the centre of the first pixel. It is the
    /// centre of mass of a Gaussian of 0.4 A (at least one pixel) about the column. Columns beyond the edges have a place too.
    pub(crate) fn appearance_px(&self, frame: usize, position_nm: [f64; 2]) -> [f64; 2] {
        let ScanFrame { shape, pixel_nm, origin_nm } = self.frame;
        let meant = plane::sub(position_nm, origin_nm).map(|d| d / pixel_nm);
        let mut at = meant;
        for _ in 0..8 {
            let slow = self.slow_nm(frame, at[1], at[0]);
            at = plane::sub(meant, slow.map(|nm| nm / pixel_nm));
        }
        let sigma = (lengths::nm(COLUMN_SIGMA_ANGSTROM) / pixel_nm).max(1.0);
        let Acquisition { line_jitter_angstrom, hum_angstrom, .. } = self.settings;
        let fast = lengths::nm(5.0 * line_jitter_angstrom + hum_angstrom[1]) / pixel_nm;
        let reach = (4.0 * sigma + fast).ceil();
        let mut sums = [0.0; 3];
        for step in -(reach as i64)..=reach as i64 {
            let row = at[1].round() + step as f64;
            let mut column = at[0];
            let mut moved = [0.0; 2];
            for _ in 0..4 {
                let nearest = (column.round().max(0.0) as usize).min(shape[1] - 1);
                let slow = self.slow_nm(frame, row, column);
                let fast = self.fast_nm(frame, row, column);
                moved = [slow[0] + fast[0] + self.overshoot_nm[nearest], slow[1] + fast[1]];
                column = meant[0] - moved[0] / pixel_nm;
            }
            let off = (row + moved[1] / pixel_nm - meant[1]) / sigma;
            let weight = libm::exp(-0.5 * off * off);
            sums = [sums[0] + weight * column, sums[1] + weight * row, sums[2] + weight];
        }
        [sums[0] / sums[2], sums[1] / sums[2]]
    }
}

#[cfg(test)]
mod tests {
    use super::super::profiles::Profile;
    use super::*;

    const FRAME: ScanFrame = ScanFrame { shape: [64, 48], pixel_nm: 0.02, origin_nm: [3.0, 5.0] };

    fn path(change: impl Fn(&mut Acquisition)) -> ScanPath {
        let mut settings = Profile::Ideal.acquisition();
        change(&mut settings);
        ScanPath::new(&settings, FRAME, 7)
    }

    #[test]
    fn an_ideal_scan_goes_where_it_should() {
        let place = path(|_| {}).place_nm(0, 10, 20);
        assert!((place[0] - 3.4).abs() < 1e-12 && (place[1] - 5.2).abs() < 1e-12, "{place:?}");
    }

    /// A line takes 48 x 10 + 20 us, so line 100 begins after 0.05 s, and pixel 3 of it is at its middle 35 us later.
    #[test]
    fn drift_moves_the_specimen_against_the_beam() {
        let path = path(|a| {
            (a.flyback_us, a.frames, a.drift_nm_per_s) = (20.0, 2, [2.0, -4.0]);
        });
        let place = path.place_nm(1, 36, 3);
        let t = 0.05 + 35e-6;
        assert!((place[0] - (3.06 - 2.0 * t)).abs() < 1e-12, "{place:?}");
        assert!((place[1] - (5.72 + 4.0 * t)).abs() < 1e-12, "{place:?}");
        let drift = path.drift_nm(1, 36);
        assert!((drift[0] - 0.1).abs() < 1e-12 && (drift[1] + 0.2).abs() < 1e-12, "{drift:?}");
        assert!((path.duration_s() - 0.064).abs() < 1e-12);
    }

    #[test]
    fn random_displacements_have_the_size_that_was_set() {
        let path = path(|a| {
            (a.frames, a.line_jitter_angstrom, a.drift_random_nm_per_sqrt_s) = (200, 0.3, 0.5);
        });
        let rms = |values: Vec<f64>| {
            (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
        };
        let jitter = rms(path.jitter_nm.iter().map(|j| j[1]).collect());
        let steps = rms(path.walk_nm.windows(2).map(|w| w[1][0] - w[0][0]).collect());
        // 12 800 lines: the standard error is 0.6 %.
        assert!((jitter / 0.03 - 1.0).abs() < 0.03, "{jitter}");
        assert!((steps / (0.5 * path.line_s().sqrt()) - 1.0).abs() < 0.03, "{steps}");
    }

    #[test]
    fn the_reach_holds_every_place() {
        let mut settings = Profile::Poor.acquisition();
        (settings.frames, settings.drift_nm_per_s) = (3, [3.0, -5.0]);
        let path = ScanPath::new(&settings, FRAME, 3);
        let reach = path.reach_nm(10..30);
        for frame in 0..3 {
            for row in 10..30 {
                for column in 0..48 {
                    let place = path.place_nm(frame, row, column);
                    for k in 0..2 {
                        assert!(place[k] >= reach[k][0] && place[k] <= reach[k][1], "{place:?}");
                    }
                }
            }
        }
    }

    /// The centre of mass of a Gaussian column in the frame, against the closed form.
    #[test]
    fn columns_appear_where_their_image_is() {
        let mut settings = Profile::Poor.acquisition();
        (settings.frames, settings.drift_nm_per_s) = (2, [0.8, -0.5]);
        (settings.hum_angstrom, settings.hum_hz) = ([0.4, 0.2], 180.0);
        let path = ScanPath::new(&settings, FRAME, 11);
        let column = [3.45, 5.7];
        for frame in 0..2 {
            let mut sums = [0.0; 3];
            for row in 0..FRAME.shape[0] {
                for pixel in 0..FRAME.shape[1] {
                    let place = path.place_nm(frame, row, pixel);
                    let r2 = (place[0] - column[0]).powi(2) + (place[1] - column[1]).powi(2);
                    let value = (-r2 / (2.0 * 0.04 * 0.04)).exp();
                    sums = [
                        sums[0] + value * pixel as f64,
                        sums[1] + value * row as f64,
                        sums[2] + value,
                    ];
                }
            }
            let seen = path.appearance_px(frame, column);
            for k in 0..2 {
                assert!((seen[k] - sums[k] / sums[2]).abs() < 0.03, "{seen:?} {sums:?}");
            }
        }
    }
}
