//! Warning and exit code for images whose audit found an error above the limit.

use super::text;
use stemgen::imaging::Audit;

/// Exit code if an audit finds an error above the limit.
pub const FAR_OFF: u8 = super::validate_command::DIFFERENT;
/// Default limit in per cent. The usual errors of all engines of the program are smaller.
const USUAL_PERCENT: f64 = 5.0;

/// Warns of each detector whose error is larger than `limit` (per cent), also with `--quiet`; returns the exit code.
pub fn exit_code(subject: &str, audit: &Audit, limit: Option<f64>) -> u8 {
    let limit = limit.unwrap_or(USUAL_PERCENT);
    // An error that is not a number must not pass as small.
    let over = |found: &&Audit| found.error_percent().is_nan() || found.error_percent() > limit;
    let far: Vec<&Audit> = audit.all().filter(over).collect();
    for found in &far {
        let of = found.detector.as_ref().map_or(String::new(), |name| format!(", {name}"));
        text::complain(&format!(
            "warning: {subject}{of}: far off the exact engine: the error is {:.2} % at bright columns and {:.2} % over all pixels, and at \
             most {limit} % are allowed; wider windows (--window) or --engine multislice are more accurate",
            found.bright_rms_percent, found.all_rms_percent
        ));
    }
    if far.is_empty() { 0 } else { FAR_OFF }
}
