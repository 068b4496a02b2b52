//! Curves of the power over the dose, as SVG.

use std::fmt::Write;

use super::detectability_report::{DetectabilityReport, DetectorDetectability};
use super::roc::normal_quantile;
use crate::specimen::wave::normal_cdf;

/// Size of the picture, and of the area of the curves: left, top, width, height.
const SIZE: [f64; 2] = [860.0, 420.0];
const AREA: [f64; 4] = [70.0, 20.0, 420.0, 340.0];
/// Points of a curve.
const POINTS: usize = 200;
/// Colours that most people with a colour deficiency can distinguish (M. Okabe, K. Ito, 2008).
const COLORS: [&str; 7] =
    ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000"];

/// Draws the power of each case and detector over the dose. Lines are the normal approximation for known images; dots are the tests of
/// the report.
pub fn power_svg(report: &DetectabilityReport) -> String {
    let [left, top, width, height] = AREA;
    let series: Vec<(String, &DetectorDetectability)> = report
        .cases
        .iter()
        .flat_map(|case| {
            let label = |d: &DetectorDetectability| {
                format!("{}, {:.1} nm, {}", case.defect, case.thickness_nm, d.detector)
            };
            case.detectors.iter().map(move |d| (label(d), d))
        })
        .collect();
    let range = decades(&series);
    let x = |dose: f64| left + width * (dose.log10() - range[0]) / (range[1] - range[0]);
    let y = |power: f64| top + height * (1.0 - power);
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {} {}\" font-family=\"sans-serif\" font-size=\"13\">\n\
         <rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n",
        SIZE[0], SIZE[1]
    );
    axes(&mut svg, range, &x, &y);
    for (n, (label, found)) in series.iter().enumerate() {
        let color = COLORS[n % COLORS.len()];
        curve(&mut svg, report, found, (range, color), &x, &y);
        let at = top + 14.0 + 18.0 * n as f64;
        let text = escaped(label);
        let _ = writeln!(
            svg,
            "<text x=\"{:.1}\" y=\"{at:.1}\" fill=\"{color}\">{text}</text>",
            left + width + 20.0
        );
    }
    svg + "</svg>\n"
}

/// The decades that hold all doses of the report and all needed doses.
fn decades(series: &[(String, &DetectorDetectability)]) -> [f64; 2] {
    let of = |(_, d): &(String, &DetectorDetectability)| {
        let asked = d.doses.iter().map(|at| at.electrons_per_angstrom2);
        asked.chain(d.needed().electrons_per_angstrom2).collect::<Vec<_>>()
    };
    let all: Vec<f64> = series.iter().flat_map(of).map(f64::log10).collect();
    let low = all.iter().copied().fold(f64::INFINITY, f64::min).floor();
    let high = all.iter().copied().fold(f64::NEG_INFINITY, f64::max).ceil();
    if low < high { [low, high] } else { [2.0, 6.0] }
}

fn axes(svg: &mut String, range: [f64; 2], x: &dyn Fn(f64) -> f64, y: &dyn Fn(f64) -> f64) {
    let [left, top, width, height] = AREA;
    for exponent in range[0] as i32..=range[1] as i32 {
        let at = x(10f64.powi(exponent));
        let _ = writeln!(
            svg,
            "<path d=\"M{at:.1} {top}v{height}\" stroke=\"#ddd\"/><text x=\"{at:.1}\" y=\"{:.1}\" text-anchor=\"middle\">1e{exponent}</text>",
            top + height + 18.0
        );
    }
    for tenth in 0..=5 {
        let power = 0.2 * f64::from(tenth);
        let at = y(power);
        let _ = writeln!(
            svg,
            "<path d=\"M{left} {at:.1}h{width}\" stroke=\"#ddd\"/><text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{power:.1}</text>",
            left - 8.0,
            at + 4.0
        );
    }
    let _ = writeln!(
        svg,
        "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">dose (electrons per square Angstrom)</text>\
         <text transform=\"translate(22 {:.1}) rotate(-90)\" text-anchor=\"middle\">share of defects found</text>",
        left + 0.5 * width,
        top + height + 42.0,
        top + 0.5 * height
    );
}

fn curve(
    svg: &mut String,
    report: &DetectabilityReport,
    found: &DetectorDetectability,
    (range, color): ([f64; 2], &str),
    x: &dyn Fn(f64) -> f64,
    y: &dyn Fn(f64) -> f64,
) {
    let alarms = normal_quantile(report.false_alarms);
    let information = found.information_angstrom2.max(0.0);
    let point = |n: usize| {
        let dose = 10f64.powf(range[0] + (range[1] - range[0]) * n as f64 / POINTS as f64);
        let power = normal_cdf((information * dose).sqrt() + alarms);
        format!("{:.1},{:.1}", x(dose), y(power))
    };
    let line: Vec<String> = (0..=POINTS).map(point).collect();
    let _ = writeln!(
        svg,
        "<polyline points=\"{}\" fill=\"none\" stroke=\"{color}\" stroke-width=\"2\"/>",
        line.join(" ")
    );
    for at in &found.doses {
        let test = at.linear.as_ref().or(at.mixture.as_ref()).unwrap_or(&at.known);
        let place = [x(at.electrons_per_angstrom2), y(test.power)];
        let _ = writeln!(
            svg,
            "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"3.5\" fill=\"{color}\"/>",
            place[0], place[1]
        );
    }
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}
