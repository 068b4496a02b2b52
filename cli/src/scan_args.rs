//! Options of the scan: what is given goes into a request, which has the defaults.

use super::imaging_args::put_some;
use super::values;
use clap::Args;
use stemgen::simulation::ScanRequest;

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
    /// Puts what is given, in Angstrom, into a request.
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
