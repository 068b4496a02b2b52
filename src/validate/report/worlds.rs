//! The report of a comparison of two worlds.

use base64::Engine as _;
use ndarray::Array2;

use super::page::{escape, page};
use super::{ReportOrigin, number, plot};
use crate::error::Result;
use crate::io::WorldFile;
use crate::lengths;
use crate::render::{Contrast, Picture};
use crate::validate::statistics::Ratio;
use crate::validate::worlds::{Line, Measured, Sameness, WorldComparison};
use crate::validate::{Plot, Series, Style};

/// Longest side of the part of each world that is shown, in pixels.
const SHOWN_PX: usize = 256;
/// Number of classes in a histogram.
const CLASSES: usize = 80;

/// Returns the comparison as one HTML page, with a part of each image.
///
/// # Errors
/// Errors of reading the images, and of drawing.
pub fn worlds_page(
    c: &WorldComparison,
    worlds: [&WorldFile; 2],
    origin: &ReportOrigin,
) -> Result<String> {
    let mut body = format!(
        "<h1>stemgen: two worlds {}</h1>\n<blockquote>{}</blockquote>\n<p class=\"meta\">Command: <code>{}</code>; \
         stemgen {}, {}, {}. A line is called different where chance would produce such a difference between equal worlds with a \
         probability below {:.2e}, so that all lines together call equal worlds different at the rate {}. Fields are divided into \
         blocks ({} and {}), since neighbouring sites and pixels are not independent. Where both fields have the same pixels, errors \
         and the significance of distances come from slow waves over the differences of blocks at one place; \
         otherwise from parts of each field.</p>\n",
        word(c.verdict),
        escape(&sentence(c)),
        escape(&origin.command_line),
        origin.stemgen_version,
        origin.date,
        origin.machine,
        c.line_alpha,
        c.alpha,
        c.a.blocks,
        c.b.blocks,
    );
    body += &table(c);
    body += "<h2>Metadata of the files</h2>\n";
    body += &notes(&c.a, &c.b);
    body += "<h2>Images</h2>\n";
    body += &pictures(worlds)?;
    body += "<h2>Distributions</h2>\n<div class=\"row\">\n";
    for plot in plots(c) {
        body += &plot::figure(&plot)?;
    }
    body += "</div>\n";
    Ok(page("stemgen: two worlds", &body))
}

/// Summarises the comparison in a sentence.
pub fn sentence(c: &WorldComparison) -> String {
    let of = |v: Sameness| -> Vec<&str> {
        c.lines.iter().filter(|l| l.verdict == v).map(|l| l.what.as_str()).collect()
    };
    let (different, undecided) = (of(Sameness::Different), of(Sameness::Undecided));
    let mut text = match different.is_empty() {
        true => format!("{} and {} do not differ beyond chance", c.a.path, c.b.path),
        false => format!("{} and {} differ in: {}", c.a.path, c.b.path, different.join(", ")),
    };
    text +=
        &format!(" ({} properties, a false alarm in {} of comparisons)", c.lines.len(), c.alpha);
    if !undecided.is_empty() {
        text += &format!("; undecided for lack of data: {}", undecided.join(", "));
    }
    text + "."
}

fn word(v: Sameness) -> &'static str {
    match v {
        Sameness::Same => "<span class=\"v pass\">same</span>",
        Sameness::Different => "<span class=\"v fail\">different</span>",
        Sameness::Undecided => "<span class=\"v shown\">undecided</span>",
    }
}

/// Writes a value with its standard error: `0.0512 ± 0.0004`.
pub fn value(ratio: Option<Ratio>) -> String {
    match ratio {
        None => String::new(),
        Some(r) if r.error > 0.0 => format!("{} \u{b1} {}", number(r.value), number_2(r.error)),
        Some(r) => number(r.value),
    }
}

/// Writes a number with two significant digits.
fn number_2(value: f64) -> String {
    match value {
        1e-3..1e4 => {
            let digits = (1 - value.log10().floor() as i32).max(0) as usize;
            format!("{value:.digits$}")
        }
        _ => format!("{value:.1e}"),
    }
}

fn table(c: &WorldComparison) -> String {
    let row = |l: &Line| {
        format!(
            "<tr><td>{}</td><td>{}</td><td class=\"n\">{}</td><td class=\"n\">{}</td><td>{}</td><td>{} = {}</td>\
             <td class=\"n\">{}</td></tr>\n",
            word(l.verdict),
            escape(&l.what),
            value(l.a),
            value(l.b),
            escape(&format!("{} {}", l.unit, l.text)),
            escape(l.test),
            number(l.statistic),
            number(l.p)
        )
    };
    let rows: String = c.lines.iter().map(row).collect();
    format!(
        "<table><tr><th></th><th>property</th><th class=\"n\">A</th><th class=\"n\">B</th><th></th><th>test</th>\
         <th class=\"n\">p</th></tr>\n{rows}</table>\n"
    )
}

fn notes(a: &Measured, b: &Measured) -> String {
    let mut keys: Vec<&String> = a.notes.keys().chain(b.notes.keys()).collect();
    keys.sort();
    keys.dedup();
    let cell = |m: &Measured, key: &str| escape(m.notes.get(key).map_or("", String::as_str));
    let mut rows = format!(
        "<tr><th></th><th>A: {}</th><th>B: {}</th></tr>\n",
        escape(&a.path),
        escape(&b.path)
    );
    let size =
        |m: &Measured| format!("{} x {} px of {} nm", m.shape[0], m.shape[1], number(m.pixel_nm));
    rows += &format!("<tr><td>field</td><td>{}</td><td>{}</td></tr>\n", size(a), size(b));
    for key in keys {
        rows += &format!(
            "<tr><td>{}</td><td>{}</td><td>{}</td></tr>\n",
            escape(key),
            cell(a, key),
            cell(b, key)
        );
    }
    format!("<table>{rows}</table>\n")
}

/// Returns the middle of each image, in fractions of the beam and with one scale of colours.
fn pictures(worlds: [&WorldFile; 2]) -> Result<String> {
    let mut parts: Vec<(Array2<f32>, f64)> = Vec::new();
    for world in worlds {
        let range = |n: usize| {
            let size = n.min(SHOWN_PX);
            (n - size) / 2..(n - size) / 2 + size
        };
        let [height, width] = world.shape();
        let [scale, offset] = world.metadata().scaling.unwrap_or([1.0, 0.0]);
        let image = world.stitched(range(height), range(width))?;
        let image = image.mapv(|v| (f64::from(v) * scale + offset) as f32);
        parts.push((image, world.metadata().pixel_size_nm));
    }
    let mut all: Vec<f32> = parts.iter().flat_map(|(image, _)| image.iter().copied()).collect();
    all.sort_unstable_by(f32::total_cmp);
    let at = |share: f64| all[(share * (all.len() - 1) as f64) as usize];
    let (min, max) = (at(0.001), at(0.999));
    let mut html = String::from("<div class=\"row\">\n");
    for (name, (image, pixel_nm)) in ["A", "B"].iter().zip(&parts) {
        let (rows, columns) = image.dim();
        let values: Vec<f32> = image.iter().copied().collect();
        let mut picture = Picture::new(&values, [rows, columns])?;
        if min < max {
            picture.contrast = Contrast::Range { min, max };
        }
        picture.max_side = 512;
        picture.pixel_angstrom = Some(lengths::angstrom(*pixel_nm));
        let rendered = picture.render()?;
        let bar = rendered
            .bar_angstrom
            .map_or(String::new(), |l| format!(", bar {} nm", number(l / 10.0)));
        let png = rendered.encode().map_err(super::undrawable)?;
        let data = base64::engine::general_purpose::STANDARD.encode(png);
        html += &format!(
            "<figure><figcaption>{name}: the middle, {columns} x {rows} px{bar}; of the beam: black {}, white {}</figcaption>\
             <img alt=\"{name}\" src=\"data:image/png;base64,{data}\"></figure>\n",
            number(f64::from(min)),
            number(f64::from(max))
        );
    }
    Ok(html + "</div>\n")
}

fn plots(c: &WorldComparison) -> Vec<Plot> {
    let pair = |of: fn(&Measured) -> &Vec<(u32, f32)>| [of(&c.a), of(&c.b)];
    let mut plots = Vec::new();
    plots.extend(histogram(
        "Nearest neighbours of columns",
        "distance in nm",
        pair(|m| &m.neighbours_nm),
    ));
    plots.extend(histogram(
        "Intensity of columns",
        "fraction of the beam",
        pair(|m| &m.intensities),
    ));
    let spectrum = |name: &str, m: &Measured| Series {
        name: name.into(),
        points: m.spectrum.frequencies().zip(m.spectrum.power.iter().copied()).collect(),
        style: Style::Line,
    };
    plots.push(Plot {
        title: "Power spectrum of the image, radial average".into(),
        x: "spatial frequency in 1/nm".into(),
        y: "power in nm2 (of the beam squared)".into(),
        logarithmic: [false, true],
        series: vec![spectrum("A", &c.a), spectrum("B", &c.b)],
    });
    let ratio = c.a.spectrum.ratio(&c.b.spectrum);
    let series = |name: &str, style, of: &dyn Fn(&Ratio) -> f64| Series {
        name: name.into(),
        points: c.a.spectrum.frequencies().zip(ratio.iter().map(of)).collect(),
        style,
    };
    plots.push(Plot {
        title: "Ratio of the power spectra, A to B".into(),
        x: "spatial frequency in 1/nm".into(),
        y: "ratio".into(),
        logarithmic: [false, true],
        series: vec![
            series("ratio", Style::Both, &|r| r.value),
            series("one, and three standard errors of it", Style::Dashed, &|r| {
                (3.0 * r.error).exp()
            }),
            series("and below", Style::Dashed, &|r| (-3.0 * r.error).exp()),
        ],
    });
    plots
}

/// Plots the densities of two samples in common classes, from the 0.1th to the 99.9th percentile.
fn histogram(title: &str, x: &str, samples: [&Vec<(u32, f32)>; 2]) -> Option<Plot> {
    let mut all: Vec<f32> = samples.iter().flat_map(|s| s.iter().map(|(_, v)| *v)).collect();
    all.sort_unstable_by(f32::total_cmp);
    let at = |share: f64| all.get((share * (all.len().max(1) - 1) as f64) as usize).copied();
    let (low, high) = (f64::from(at(0.001)?), f64::from(at(0.999)?));
    let width = if high > low {
        (high - low) / CLASSES as f64
    } else {
        low.abs().max(1e-6) / CLASSES as f64
    };
    let series = |name: &str, sample: &Vec<(u32, f32)>| {
        let mut counts = vec![0.0; CLASSES + 2];
        for (_, v) in sample {
            let class = ((f64::from(*v) - low) / width).floor() + 1.0;
            if (0.0..counts.len() as f64).contains(&class) {
                counts[class as usize] += 1.0;
            }
        }
        let total = sample.len().max(1) as f64 * width;
        let place = |i: usize| low + (i as f64 - 1.0) * width;
        // The density is drawn in steps.
        let step = |(i, n): (usize, &f64)| [(place(i), n / total), (place(i + 1), n / total)];
        let points = counts.iter().enumerate().flat_map(step).collect();
        Series { name: format!("{name} ({} columns)", sample.len()), points, style: Style::Line }
    };
    Some(Plot {
        title: title.into(),
        x: x.into(),
        y: format!("density in 1/({})", x.rsplit(" in ").next().unwrap_or(x)),
        logarithmic: [false, false],
        series: vec![series("A", samples[0]), series("B", samples[1])],
    })
}
