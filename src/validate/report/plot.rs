//! Plots of series.

use plotters::prelude::*;
use plotters::series::DashedLineSeries;

use super::axis::PlotAxis;
use super::page::escape;
use super::svg;
use crate::error::Result;
use crate::validate::{Plot, Style};

/// Colours that most people with a colour deficiency can distinguish (M. Okabe, K. Ito, 2008).
pub const COLORS: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(0, 0, 0),
];

/// Draws a plot with its legend as HTML.
pub fn figure(plot: &Plot) -> Result<String> {
    let drawing = svg((560, 330), |area| {
        area.fill(&WHITE)?;
        let all = || plot.series.iter().flat_map(|s| &s.points);
        let x = PlotAxis::around(all().map(|p| p.0), plot.logarithmic[0]);
        let y = PlotAxis::around(all().map(|p| p.1), plot.logarithmic[1]);
        let mut chart = ChartBuilder::on(area)
            .margin(10)
            .x_label_area_size(46)
            .y_label_area_size(74)
            .build_cartesian_2d(x, y)?;
        chart
            .configure_mesh()
            .x_desc(plot.x.as_str())
            .y_desc(plot.y.as_str())
            .x_labels(9)
            .y_labels(7)
            .x_label_formatter(&PlotAxis::label)
            .y_label_formatter(&PlotAxis::label)
            .label_style(("sans-serif", 15))
            .axis_desc_style(("sans-serif", 16))
            .light_line_style(WHITE)
            .bold_line_style(BLACK.mix(0.10))
            .draw()?;
        for (series, color) in plot.series.iter().zip(COLORS.iter().cycle()) {
            let points =
                || series.points.iter().copied().filter(|p| p.0.is_finite() && p.1.is_finite());
            match series.style {
                Style::Dashed => {
                    let line = DashedLineSeries::new(points(), 6, 4, color.stroke_width(2));
                    chart.draw_series(line)?;
                }
                Style::Line | Style::Both => {
                    chart.draw_series(LineSeries::new(points(), color.stroke_width(2)))?;
                }
                Style::Points => {}
            }
            if matches!(series.style, Style::Points | Style::Both) {
                chart.draw_series(points().map(|p| Circle::new(p, 4, color.filled())))?;
            }
        }
        Ok(())
    })?;
    Ok(format!(
        "<figure><figcaption>{}</figcaption>{drawing}{}</figure>\n",
        escape(&plot.title),
        legend(plot)
    ))
}

fn legend(plot: &Plot) -> String {
    let entry = |(series, color): (&crate::validate::Series, &RGBColor)| {
        let RGBColor(r, g, b) = color;
        let sign = match series.style {
            Style::Line => "\u{2501}\u{2501}",
            Style::Dashed => "\u{2505}\u{2505}",
            Style::Points => "\u{25cf}",
            Style::Both => "\u{2501}\u{25cf}\u{2501}",
        };
        format!(
            "<span><b style=\"color:rgb({r},{g},{b})\">{sign}</b> {}</span>",
            escape(&series.name)
        )
    };
    let entries: String = plot.series.iter().zip(COLORS.iter().cycle()).map(entry).collect();
    format!("<div class=\"legend\">{entries}</div>")
}
