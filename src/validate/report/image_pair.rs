//! Two images, their difference, and profiles.

use base64::Engine as _;
use ndarray::{Array2, s};
use plotters::prelude::*;

use super::axis::PlotAxis;
use super::page::escape;
use super::{Area, plot, svg};
use crate::error::Result;
use crate::render::{Colormap, RgbImage};
use crate::validate::{ImagePair, Plot, Series, Style};

/// Longer and shorter side of an image in the page, in pixels.
const SIDES: [f64; 2] = [250.0, 80.0];
/// Orders of magnitude that a logarithmic image shows.
const DECADES: f64 = 6.0;
const TITLE: u32 = 26;
const LEFT: u32 = 52;
const BELOW: u32 = 40;
const BAR: u32 = 104;
/// Distance in pixels between the ticks of a colour scale and its name.
const BAR_LABELS: u32 = 62;
const BAR_WIDTH: i32 = 16;

type Drawn<T> = std::result::Result<T, Box<dyn std::error::Error>>;

/// A raster picture and its place in the drawing.
struct Inset {
    x: (i32, i32),
    y: (i32, i32),
    png: Vec<u8>,
}

/// Draws images, colour scales and profiles as HTML. The profiles are open on the page if `open` is set.
pub fn figure(pair: &ImagePair, open: bool) -> Result<String> {
    let drawing = panels(pair)?;
    let title = escape(&pair.title);
    let profiles: String = profiles(pair).iter().map(plot::figure).collect::<Result<_>>()?;
    let open = if open { " open" } else { "" };
    Ok(format!(
        "<figure class=\"images\"><figcaption>{title}</figcaption>{drawing}</figure>\n\
         <details{open}><summary>profiles of {title}</summary><div class=\"row\">{profiles}</div></details>\n"
    ))
}

fn panels(pair: &ImagePair) -> Result<String> {
    let (rows, columns) = pair.ours.dim();
    let extent = [columns as f64 * pair.step[0], rows as f64 * pair.step[1]];
    let longest = extent[0].max(extent[1]);
    let [width, height] = extent.map(|l| (SIDES[0] * l / longest).max(SIDES[1]).round() as u32);
    let panel = LEFT + width + 8;
    let size = (3 * panel + 2 * BAR, TITLE + height + BELOW);
    let mut insets = Vec::new();
    let drawing = svg(size, |area| {
        area.fill(&WHITE)?;
        let (ours, rest) = area.split_horizontally(panel);
        let (reference, rest) = rest.split_horizontally(panel);
        let (bar, rest) = rest.split_horizontally(BAR);
        let (difference, difference_bar) = rest.split_horizontally(panel);
        let scale = ColorScale::of(pair);
        insets.push(image(&ours, pair, "ours", scale.png(&pair.ours))?);
        insets.push(image(&reference, pair, "reference", scale.png(&pair.reference))?);
        insets.push(colour_bar(&bar, &scale, pair.unit)?);
        let scale = ColorScale::symmetric(pair.difference_scale);
        let values = &pair.ours - &pair.reference;
        insets.push(image(&difference, pair, "ours - reference", scale.png(&values))?);
        insets.push(colour_bar(&difference_bar, &scale, pair.unit)?);
        Ok(())
    })?;
    let insets: String = insets.iter().map(Inset::svg).collect();
    Ok(drawing.replace("</svg>", &format!("{insets}</svg>")))
}

/// Draws the axes of an image; returns the place of the image.
fn image(area: &Area, pair: &ImagePair, title: &str, png: Vec<u8>) -> Drawn<Inset> {
    let (rows, columns) = pair.ours.dim();
    // Pixels are centred on their positions.
    let edges =
        |origin: f64, step: f64, n: usize| [origin - 0.5 * step, origin + (n as f64 - 0.5) * step];
    let x = edges(pair.origin[0], pair.step[0], columns);
    let y = edges(pair.origin[1], pair.step[1], rows);
    let mut chart = ChartBuilder::on(area)
        .margin_top(TITLE)
        .margin_right(8)
        .x_label_area_size(BELOW)
        .y_label_area_size(LEFT)
        .build_cartesian_2d(PlotAxis::linear(x[0], x[1]), PlotAxis::linear(y[1], y[0]))?;
    chart
        .configure_mesh()
        .disable_mesh()
        .x_desc(format!("x in {}", pair.axis_unit))
        .y_desc(format!("y in {}", pair.axis_unit))
        .x_labels(5)
        .y_labels(5)
        .x_label_formatter(&PlotAxis::label)
        .y_label_formatter(&PlotAxis::label)
        .label_style(("sans-serif", 14))
        .axis_desc_style(("sans-serif", 15))
        .draw()?;
    let style = ("sans-serif", 16).into_font().color(&BLACK);
    area.draw_text(title, &style, (LEFT as i32, 6))?;
    let (x, y) = chart.plotting_area().get_pixel_range();
    Ok(Inset { x: (x.start, x.end), y: (y.start, y.end), png })
}

fn colour_bar(area: &Area, scale: &ColorScale, unit: &str) -> Drawn<Inset> {
    let (width, _) = area.dim_in_pixel();
    let mut chart = ChartBuilder::on(area)
        .margin_top(TITLE)
        .margin_bottom(BELOW)
        .margin_right(width as i32 - BAR_WIDTH - BAR_LABELS as i32)
        .set_label_area_size(LabelAreaPosition::Right, BAR_LABELS)
        .build_cartesian_2d(PlotAxis::linear(0.0, 1.0), scale.axis)?;
    chart
        .configure_mesh()
        .disable_mesh()
        .disable_x_axis()
        .y_labels(5)
        .y_desc(unit)
        .y_label_formatter(&PlotAxis::label)
        .label_style(("sans-serif", 14))
        .axis_desc_style(("sans-serif", 14))
        .draw()?;
    let ramp = Array2::from_shape_fn((128, 1), |(i, _)| scale.value(1.0 - i as f64 / 127.0));
    let (x, y) = chart.plotting_area().get_pixel_range();
    Ok(Inset { x: (x.start, x.end), y: (y.start, y.end), png: scale.png(&ramp) })
}

impl Inset {
    fn svg(&self) -> String {
        let data = base64::engine::general_purpose::STANDARD.encode(&self.png);
        let (x, y) = (self.x.0, self.y.0);
        let (width, height) = (self.x.1 - self.x.0, self.y.1 - self.y.0);
        format!(
            "<image x=\"{x}\" y=\"{y}\" width=\"{width}\" height=\"{height}\" preserveAspectRatio=\"none\" \
             style=\"image-rendering:pixelated\" href=\"data:image/png;base64,{data}\"/>"
        )
    }
}

/// A range of values with its colours.
struct ColorScale {
    axis: PlotAxis,
    colors: Vec<[u8; 3]>,
}

impl ColorScale {
    /// Makes one scale for both images.
    fn of(pair: &ImagePair) -> Self {
        let values = || pair.ours.iter().chain(&pair.reference).copied();
        let high = values().fold(f64::NEG_INFINITY, f64::max);
        let low = match pair.logarithmic {
            true => high * 10_f64.powf(-DECADES),
            false => values().fold(f64::INFINITY, f64::min),
        };
        let high = if high > low { high } else { low + low.abs().max(1e-12) };
        ColorScale {
            axis: PlotAxis { first: low, last: high, logarithmic: pair.logarithmic },
            colors: Colormap::Viridis.table().to_vec(),
        }
    }

    /// Makes a scale that is blue below zero and red above.
    fn symmetric(top: f64) -> Self {
        let color = |i: usize| {
            let c = colorous::RED_BLUE.eval_rational(255 - i, 256);
            [c.r, c.g, c.b]
        };
        let top = if top > 0.0 { top } else { 1e-12 };
        ColorScale { axis: PlotAxis::linear(-top, top), colors: (0..256).map(color).collect() }
    }

    fn value(&self, fraction: f64) -> f64 {
        let PlotAxis { first, last, logarithmic } = self.axis;
        match logarithmic {
            true => first * (last / first).powf(fraction),
            false => first + fraction * (last - first),
        }
    }

    fn png(&self, values: &Array2<f64>) -> Vec<u8> {
        use plotters::coord::ranged1d::Ranged;
        let color = |v: &f64| self.colors[self.axis.map(v, (0, 255)).clamp(0, 255) as usize];
        let (height, width) = values.dim();
        let pixels = values.iter().flat_map(color).collect();
        let image = RgbImage { width, height, pixels, bar_angstrom: None };
        // Encoding to memory fails only for images without pixels.
        image.encode().unwrap_or_default()
    }
}

/// Plots profiles along x and y through the brightest pixel of the reference.
fn profiles(pair: &ImagePair) -> Vec<Plot> {
    let top = pair.reference.indexed_iter().max_by(|a, b| a.1.total_cmp(b.1));
    let (row, column) = top.map_or((0, 0), |(at, _)| at);
    let place = |axis: usize, i: usize| pair.origin[axis] + i as f64 * pair.step[axis];
    let plot = |axis: usize, name: &str, across: String| {
        let line = |image: &Array2<f64>| match axis {
            0 => image.slice(s![row, ..]).to_vec(),
            _ => image.slice(s![.., column]).to_vec(),
        };
        let series = |name: &str, image: &Array2<f64>, style| Series {
            name: name.into(),
            points: line(image).into_iter().enumerate().map(|(i, v)| (place(axis, i), v)).collect(),
            style,
        };
        Plot {
            title: format!("along {name} at {across} {}", pair.axis_unit),
            x: format!("{name} in {}", pair.axis_unit),
            y: pair.unit.to_owned(),
            logarithmic: [false, pair.logarithmic],
            series: vec![
                series("reference", &pair.reference, Style::Line),
                series("ours", &pair.ours, Style::Points),
            ],
        }
    };
    let shown = |axis, i, name| format!("{name} = {:.2}", place(axis, i));
    let mut plots = Vec::new();
    if pair.reference.ncols() > 1 {
        plots.push(plot(0, "x", shown(1, row, "y")));
    }
    if pair.reference.nrows() > 1 {
        plots.push(plot(1, "y", shown(0, column, "x")));
    }
    plots
}
