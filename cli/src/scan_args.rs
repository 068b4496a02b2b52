//! Options of the scan. Given options go into a request, which holds the defaults.

use super::imaging_args::put_some;
use super::values;
use clap::Args;
use stemgen::simulation::ScanRequest;

/// Holds the options of the scan.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Scan")]
pub struct ScanArgs {
    /// Position of the first probe in A, from the corner of the cell [default: 0,0]
    #[arg(long, value_name = "X,Y", value_parser = values::point, allow_hyphen_values = true)]
    pub scan_start: Option<[f64; 2]>,
    /// End of the scan in A; no probe stands there [default: the far corner of the cell]
    #[arg(long, value_name = "X,Y", value_parser = values::point, allow_hyphen_values = true)]
    pub scan_end: Option<[f64; 2]>,
    /// Distance between probes in A, the pixel of the image. It is reduced a little so that it divides the scan [default: the
    /// Nyquist limit of the image, wavelength / (4 semiangle)]
    #[arg(long, value_name = "A", value_parser = values::finite, allow_negative_numbers = true)]
    #[arg(conflicts_with = "scan_points")]
    pub scan_step: Option<f64>,
    /// Number of probes along x and y, in place of --scan-step
    #[arg(long, value_name = "NX,NY", value_parser = values::counts2)]
    pub scan_points: Option<[usize; 2]>,
}

impl ScanArgs {
    /// Puts the given options into a request, in Angstrom.
    pub fn apply(&self, to: &mut ScanRequest) {
        if self.scan_start.is_some() || self.scan_end.is_some() {
            to.unit = Default::default();
        }
        put_some(&self.scan_start, &mut to.start);
        put_some(&self.scan_end, &mut to.end);
        if self.scan_step.is_some() || self.scan_points.is_some() {
            (to.step_angstrom, to.points) = (self.scan_step, self.scan_points);
        }
    }
}

impl From<&ScanArgs> for ScanRequest {
    fn from(args: &ScanArgs) -> Self {
        let mut request = ScanRequest::default();
        args.apply(&mut request);
        request
    }
}
