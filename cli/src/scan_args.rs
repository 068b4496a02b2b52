//! Options of the scan.

use super::values;
use anyhow::bail;
use clap::Args;
use stemgen::engine::Scan;
use stemgen::optics::Optics;

/// Most probe positions accepted.
const MOST_PROBES: f64 = 1e9;

/// The scan.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Scan")]
pub struct ScanArgs {
    /// First probe position in A [default: 0,0]
    #[arg(long, value_name = "X,Y", value_parser = values::point, allow_hyphen_values = true)]
    pub scan_start: Option<[f64; 2]>,
    /// End of the scan in A, itself not scanned [default: the edges of the cell]
    #[arg(long, value_name = "X,Y", value_parser = values::point, allow_hyphen_values = true)]
    pub scan_end: Option<[f64; 2]>,
    /// Distance of probes in A, the pixel of the image, made a little smaller so that it divides the window [default: the
    /// Nyquist limit of the image, wavelength / (4 semiangle)]
    #[arg(long, value_name = "A", value_parser = values::finite, allow_negative_numbers = true)]
    #[arg(conflicts_with = "scan_points")]
    pub scan_step: Option<f64>,
    /// Number of probes along x and y
    #[arg(long, value_name = "NX,NY", value_parser = values::counts2)]
    pub scan_points: Option<[usize; 2]>,
}

impl ScanArgs {
    /// The raster over a cell of `size` (x, y) in Angstrom.
    pub fn scan(&self, size: [f64; 2], optics: &Optics) -> anyhow::Result<Scan> {
        let start = self.scan_start.unwrap_or([0.0; 2]);
        let end = self.scan_end.unwrap_or(size);
        let window = [0, 1].map(|i| end[i] - start[i]);
        if window.iter().any(|w| *w <= 0.0) {
            bail!(
                "the scan from {},{} to {},{} A is empty: --scan-end must lie right of and below \
                 --scan-start",
                start[0],
                start[1],
                end[0],
                end[1]
            );
        }
        let points = match self.scan_points {
            Some(points) => points.map(|n| n as f64),
            None => {
                let step = self.scan_step.unwrap_or_else(|| nyquist(optics));
                if step.is_nan() || step <= 0.0 {
                    bail!("--scan-step {step}: the distance of probes must be positive");
                }
                window.map(|w| (w / step - 1e-6).ceil().max(1.0))
            }
        };
        if points.contains(&0.0) || points[0] * points[1] > MOST_PROBES {
            bail!("{} x {} probes: between 1 and 1e9 are possible", points[0], points[1]);
        }
        let step_angstrom = [0, 1].map(|i| window[i] / points[i]);
        let shape = [points[1] as usize, points[0] as usize];
        Ok(Scan { origin_angstrom: start, step_angstrom, shape })
    }
}

/// The coarsest step that samples an incoherent image: its band ends at twice the semiangle.
fn nyquist(optics: &Optics) -> f64 {
    optics.wavelength_angstrom() / (4e-3 * optics.semiangle_mrad)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn none() -> ScanArgs {
        ScanArgs { scan_start: None, scan_end: None, scan_step: None, scan_points: None }
    }

    #[test]
    fn steps_divide_the_window() {
        let optics = Optics::default();
        let whole = none().scan([3.905, 7.81], &optics).unwrap();
        assert_eq!(whole.shape, [27, 14]);
        assert!((whole.step_angstrom[0] - 3.905 / 14.0).abs() < 1e-12);
        let step = ScanArgs { scan_step: Some(0.1), ..none() }.scan([1.0, 0.95], &optics).unwrap();
        assert_eq!(step.shape, [10, 10]);
        let part = ScanArgs {
            scan_start: Some([-1.0, 2.0]),
            scan_end: Some([1.0, 3.0]),
            scan_points: Some([4, 5]),
            ..none()
        };
        let part = part.scan([9.0, 9.0], &optics).unwrap();
        assert_eq!((part.shape, part.step_angstrom), ([5, 4], [0.5, 0.2]));
        assert_eq!(part.origin_angstrom, [-1.0, 2.0]);
    }

    #[test]
    fn impossible_scans_are_refused() {
        let bad = [
            ScanArgs { scan_end: Some([0.0, 1.0]), ..none() },
            ScanArgs { scan_step: Some(-0.1), ..none() },
            ScanArgs { scan_step: Some(1e-9), ..none() },
            ScanArgs { scan_points: Some([0, 3]), ..none() },
        ];
        for args in bad {
            assert!(args.scan([5.0, 5.0], &Optics::default()).is_err(), "{args:?}");
        }
    }
}
