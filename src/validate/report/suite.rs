//! The report of the suite, and of the comparison with an image of another program.

use serde::Serialize;

use super::page::{checks, escape, limit, page, verdict};
use super::{ReportOrigin, image_pair, number, plot};
use crate::error::Result;
use crate::validate::{Check, Figure, NamedSetting, Outcome, Verdict, overall};

/// All results, as `--json` prints them.
#[derive(Debug, Serialize)]
pub struct Report {
    /// `Fail` if any case failed.
    pub verdict: Verdict,
    /// Summary in one or two sentences, for citation.
    pub summary: String,
    /// Program, machine and time of the report.
    #[serde(flatten)]
    pub origin: ReportOrigin,
    /// Time taken in s.
    pub wall_time_s: f64,
    /// Results of the cases.
    pub cases: Vec<Outcome>,
}

impl Report {
    /// Collects outcomes; `subject` names the references: `its shipped references`.
    pub fn new(subject: &str, origin: ReportOrigin, cases: Vec<Outcome>) -> Self {
        let failed: Vec<&str> =
            cases.iter().filter(|c| c.verdict == Verdict::Fail).map(|c| c.name.as_str()).collect();
        let numbers: Vec<_> = cases.iter().flat_map(|c| &c.checks).collect();
        let judged = numbers.iter().filter(|c| c.verdict != Verdict::Shown).count();
        let good = numbers.iter().filter(|c| c.verdict == Verdict::Pass).count();
        let mut summary = format!(
            "stemgen {} was checked against {subject} on {} ({}): {} of {} cases passed, {good} of {judged} numbers \
             lay within their limits.",
            origin.stemgen_version,
            origin.date,
            origin.machine,
            cases.len() - failed.len(),
            cases.len(),
        );
        if !failed.is_empty() {
            summary += &format!(" Failed: {}.", failed.join(", "));
        }
        Report::with(summary, origin, cases)
    }

    /// Makes the report of an image of another program: its case, and a sentence with the measured difference.
    pub fn of_image(origin: ReportOrigin, case: Outcome) -> Self {
        let measured = |check: &Check| {
            let limit = match limit(check) {
                text if text.is_empty() => text,
                text => format!(" (allowed: {text})"),
            };
            format!("{} {} {}{limit}", check.what, number(check.value), check.unit)
        };
        let numbers: Vec<_> = case.checks.iter().take(SENTENCE).map(measured).collect();
        let verb = if case.verdict == Verdict::Fail { "differs from" } else { "agrees with" };
        let summary = format!(
            "stemgen {} {verb} {} ({}) on {} ({}): {}.",
            origin.stemgen_version,
            case.name,
            case.about.trim_end_matches('.'),
            origin.date,
            origin.machine,
            numbers.join("; ")
        );
        Report::with(summary, origin, vec![case])
    }

    fn with(summary: String, origin: ReportOrigin, cases: Vec<Outcome>) -> Self {
        Report {
            verdict: overall(cases.iter().map(|c| &c.verdict)),
            summary,
            wall_time_s: cases.iter().map(|c| c.wall_time_s).sum(),
            origin,
            cases,
        }
    }
}

/// Number of checks in the summary of an image: the largest difference and the rms difference.
const SENTENCE: usize = 2;

/// Returns the report as one HTML page.
///
/// # Errors
/// [`crate::Error::Invalid`] for a figure that cannot be drawn.
pub fn suite_page(report: &Report) -> Result<String> {
    let mut body = format!(
        "<h1>stemgen: validation {}</h1>\n<blockquote>{}</blockquote>\n\
         <p class=\"meta\">Command: <code>{}</code>, {} s. Images are fractions of the incident beam; x points right, y down. \
         &ldquo;Of the maximum&rdquo; and &ldquo;of the mean&rdquo; refer to the reference image.</p>\n",
        verdict(report.verdict),
        escape(&report.summary),
        escape(&report.origin.command_line),
        number((10.0 * report.wall_time_s).round() / 10.0),
    );
    if report.cases.len() > 1 {
        body += &contents(&report.cases);
    }
    let mut group = "";
    for case in &report.cases {
        if case.group != group {
            body += &format!("<h2>{}</h2>\n", escape(&case.group));
            group = &case.group;
        }
        body += &section(case)?;
    }
    Ok(page("stemgen: validation", &body))
}

fn contents(cases: &[Outcome]) -> String {
    let row = |c: &Outcome| {
        let near = |a: &&Check, b: &&Check| a.strain().total_cmp(&b.strain());
        let worst = c.checks.iter().max_by(near).map_or(String::new(), |k| {
            format!("{}: {} {} ({})", k.what, number(k.value), k.unit, limit(k))
        });
        format!(
            "<tr><td>{}</td><td><a href=\"#{}\">{}</a></td><td>{}</td></tr>\n",
            verdict(c.verdict),
            escape(&c.name),
            escape(&c.title),
            escape(&worst)
        )
    };
    let rows: String = cases.iter().map(row).collect();
    format!(
        "<table><tr><th></th><th>case</th><th>the number nearest to its limit</th></tr>\n{rows}</table>\n"
    )
}

fn section(case: &Outcome) -> Result<String> {
    let mut html = format!(
        "<section id=\"{}\"><h3>{} {}</h3>\n<p class=\"about\">{}</p>\n<p class=\"source\">Reference: {} \
         (case <code>{}</code>, {:.1} s)</p>\n{}{}",
        escape(&case.name),
        escape(&case.title),
        verdict(case.verdict),
        escape(&case.about),
        escape(&case.source),
        escape(&case.name),
        case.wall_time_s,
        settings(&case.settings),
        checks(&case.checks)
    );
    for note in &case.notes {
        html += &format!("<p class=\"about\"><b>Note:</b> {}</p>\n", escape(note));
    }
    let figures = case.figures.iter().enumerate().map(|(i, f)| figure(f, i == 0));
    let figures: Vec<String> = figures.collect::<Result<_>>()?;
    let (first, rest) = figures.split_at(figures.len().min(FIGURES_OPEN));
    html += &first.concat();
    if !rest.is_empty() {
        let more = rest.len();
        html += &format!(
            "<details><summary>{more} more figures</summary>{}</details>\n",
            rest.concat()
        );
    }
    Ok(html + "</section>\n")
}

/// Returns the table of the settings of our simulation.
fn settings(settings: &[NamedSetting]) -> String {
    if settings.is_empty() {
        return String::new();
    }
    let row = |s: &NamedSetting| {
        format!("<tr><td>{}</td><td>{}</td></tr>\n", escape(&s.name), escape(&s.value))
    };
    let rows: String = settings.iter().map(row).collect();
    format!("<table><tr><th>computed with</th><th></th></tr>\n{rows}</table>\n")
}

/// Number of figures of a case that are open on the page.
const FIGURES_OPEN: usize = 2;

fn figure(figure: &Figure, open: bool) -> Result<String> {
    match figure {
        Figure::Images(pair) => image_pair::figure(pair, open),
        Figure::Plot(p) => plot::figure(p),
    }
}
