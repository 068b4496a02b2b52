//! Reports of validation: one self-contained HTML page without scripts, further files or network access.

mod axis;
mod image_pair;
mod page;
mod plot;
mod suite;
mod worlds;

pub use suite::{Report, suite_page};
pub use worlds::{sentence, value, worlds_page};

use crate::error::{Error, Result};
use crate::setting::Setting;

/// Program, machine and time of a report.
#[derive(Debug, Clone, serde::Serialize)]
pub struct ReportOrigin {
    /// Version of stemgen.
    pub stemgen_version: &'static str,
    /// The command as typed.
    pub command_line: String,
    /// Machine: `x86_64 linux, 8 threads`.
    pub machine: String,
    /// Date and time: `2026-11-21 17:40 UTC`.
    pub date: String,
}

impl ReportOrigin {
    /// Describes this machine at the present time.
    pub fn now(command_line: String) -> Self {
        let (arch, os) = (std::env::consts::ARCH, std::env::consts::OS);
        let threads = rayon::current_num_threads();
        let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
        ReportOrigin {
            stemgen_version: env!("CARGO_PKG_VERSION"),
            command_line,
            machine: format!("{arch} {os}, {threads} threads"),
            date: date(since.map_or(0, |d| d.as_secs())),
        }
    }
}

/// Returns date and time of a number of seconds after 1970 (H. Hinnant's `civil_from_days`).
fn date(seconds: u64) -> String {
    let (days, rest) = (seconds / 86_400, seconds % 86_400);
    let shifted = days + 719_468;
    let (era, day_of_era) = (shifted / 146_097, shifted % 146_097);
    let year = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year + year / 4 - year / 100);
    let march = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * march + 2) / 5 + 1;
    let month = if march < 10 { march + 3 } else { march - 9 };
    let year = year + era * 400 + u64::from(month <= 2);
    format!("{year}-{month:02}-{day:02} {:02}:{:02} UTC", rest / 3600, rest % 3600 / 60)
}

/// Writes a number with four significant digits, and with an exponent in place of many zeros.
fn number(value: f64) -> String {
    let size = value.abs();
    if value == 0.0 || !value.is_finite() {
        return format!("{value}");
    }
    if value.fract() == 0.0 && size < 1e6 {
        return format!("{value}");
    }
    match size {
        1e-3..1e5 => {
            let digits = (3 - size.log10().floor() as i32).max(0) as usize;
            let text = format!("{value:.digits$}");
            match text.contains('.') {
                true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
                false => text,
            }
        }
        _ => format!("{value:.2e}"),
    }
}

fn undrawable(reason: impl std::fmt::Display) -> Error {
    Error::invalid(Setting::Figure, reason, "could not be drawn")
}

/// Returns the SVG that `draw` draws.
fn svg(
    size: (u32, u32),
    draw: impl FnOnce(&Area) -> std::result::Result<(), Box<dyn std::error::Error>>,
) -> Result<String> {
    use plotters::prelude::{IntoDrawingArea, SVGBackend};
    let mut text = String::new();
    {
        let root = SVGBackend::with_string(&mut text, size).into_drawing_area();
        draw(&root).map_err(undrawable)?;
        root.present().map_err(undrawable)?;
    }
    Ok(text)
}

type Area<'a> =
    plotters::drawing::DrawingArea<plotters::prelude::SVGBackend<'a>, plotters::coord::Shift>;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_are_right() {
        assert_eq!(date(0), "1970-01-01 00:00 UTC");
        assert_eq!(date(951_782_400), "2000-02-29 00:00 UTC");
        assert_eq!(date(1_795_282_865), "2026-11-21 17:41 UTC");
    }

    #[test]
    fn numbers_are_short() {
        assert_eq!(number(0.02), "0.02");
        assert_eq!(number(0.723_94), "0.7239");
        assert_eq!(number(1e-5), "1.00e-5");
        assert_eq!(number(540.0), "540");
        assert_eq!(number(f64::NAN), "NaN");
    }
}
