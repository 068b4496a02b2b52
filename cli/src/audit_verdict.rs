//! Images that an audit finds far off are said to be so, and have an exit code.

use super::text;
use stemgen::imaging::Audit;

/// Exit code where an audit finds more than is allowed: something was compared, and differs.
pub const FAR_OFF: u8 = super::validate_command::DIFFERENT;
/// What is allowed where nobody says it, in per cent: no engine of this program is usually as far off.
const USUAL_PERCENT: f64 = 5.0;

/// Warns, whatever is printed otherwise, of each detector whose error is larger than `limit` (per cent); returns the exit code.
pub fn exit_code(subject: &str, audit: &Audit, limit: Option<f64>) -> u8 {
    let limit = limit.unwrap_or(USUAL_PERCENT);
    // What is no number is within no limit.
    let over = |found: &&Audit| found.error_percent().is_nan() || found.error_percent() > limit;
    let far: Vec<&Audit> = audit.all().filter(over).collect();
    for found in &far {
        let of = found.detector.as_ref().map_or(String::new(), |name| format!(", {name}"));
        text::complain(&format!(
            "warning: {subject}{of}: far off the exact engine: {:.2} % at bright columns and {:.2} % over all pixels, at most \
             {limit} % are allowed; wider windows (--window) or --engine multislice come nearer",
            found.bright_rms_percent, found.all_rms_percent
        ));
    }
    if far.is_empty() { 0 } else { FAR_OFF }
}
