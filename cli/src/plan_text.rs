//! Plans as text, for `--dry-run`.

use super::text;
use stemgen::engine::Scan;
use stemgen::simulation::{GridReport, PlanReport};

fn grid(grid: &GridReport) -> String {
    let [nx, ny] = grid.points;
    let [lx, ly] = grid.extent_angstrom;
    let [sx, sy] = grid.sampling_angstrom;
    format!("{nx} x {ny} points over {lx:.2} x {ly:.2} A ({sx:.4} x {sy:.4} A)")
}

/// Adds names and values of a plan, without memory and time.
pub fn all(plan: &PlanReport, out: &mut Lines) {
    numerics(plan, out);
    let recorded = plan.thicknesses_angstrom.iter().map(|t| format!("{t:.2}"));
    out.add("recorded at", format!("{} A", recorded.collect::<Vec<_>>().join(", ")));
}

/// Adds names and values of the numerics of a plan.
pub fn numerics(plan: &PlanReport, out: &mut Lines) {
    out.add("engine", plan.algorithm.to_string());
    out.add("wave grid", grid(&plan.wave_grid));
    if plan.transmission_grid.points != plan.wave_grid.points {
        out.add("transmission grid", grid(&plan.transmission_grid));
    }
    out.add("potential grid", grid(&plan.potential_grid));
    out.add("band limit", format!("{:.1} mrad", plan.band_limit_mrad));
    let s = &plan.slices;
    let range = match s.thickest_angstrom - s.thinnest_angstrom < 1e-3 {
        true => format!("{:.3} A", s.thickest_angstrom),
        false => format!("{:.3} to {:.3} A", s.thinnest_angstrom, s.thickest_angstrom),
    };
    let passed = match s.passed < s.count as f64 {
        true => format!("; a window passes {:.1}", s.passed),
        false => String::new(),
    };
    out.add("slices", format!("{} of {range}{passed}", s.count));
    if plan.beams > 0 {
        out.add("beams", text::count(plan.beams as u64));
    }
    out.add(
        "phonons",
        match plan.configurations {
            1 => "1 configuration".into(),
            n => format!("{n} configurations"),
        },
    );
}

/// Adds memory, time and warnings.
pub fn costs(plan: &PlanReport, out: &mut Lines) {
    out.add("memory", format!("about {}", text::bytes(plan.memory_bytes)));
    let plural = if plan.threads == 1 { "thread" } else { "threads" };
    let time = text::duration_range(plan.estimated_range_s);
    out.add("time", format!("{time} on {} {plural} (from a short measurement)", plan.threads));
    for warning in &plan.warnings {
        out.add("warning", warning.clone());
    }
}

/// Describes a scan in one line.
pub fn scan(scan: &Scan) -> String {
    let [rows, columns] = scan.shape;
    let [x, y] = scan.step_angstrom;
    let [x0, y0] = scan.origin_angstrom;
    let n = text::count(scan.len() as u64);
    format!("{n}: {columns} x {rows}, {x:.4} x {y:.4} A apart, from {x0:.3}, {y0:.3} A")
}

/// Describes the beam and the lens in one line.
pub fn beam(optics: &stemgen::optics::Optics) -> String {
    let mut text = format!("{} keV, {} mrad", optics.energy_kev, optics.semiangle_mrad);
    // The sum of all defocus terms is printed, since abTEM's numerics add a second one of half a slice.
    let defocus = optics.aberrations.defocus_angstrom();
    if defocus != 0.0 {
        text += &format!(", defocus {defocus} A");
    }
    for a in optics.aberrations.0.iter().filter(|a| (a.order, a.symmetry) != (1, 0)) {
        text += &match (a.order, a.symmetry) {
            (n, 0) => format!(", C{n}0 {} A", a.magnitude_angstrom),
            (n, m) => {
                let degrees = a.azimuth_rad.to_degrees();
                format!(", C{n}{m} {} A at {degrees:.1} degrees", a.magnitude_angstrom)
            }
        };
    }
    text
}

/// A table of names and values.
#[derive(Debug, Default)]
pub struct Lines(Vec<(String, String)>);

impl Lines {
    /// Adds a line. Names and values may come from a file, so line ends in them are escaped.
    pub fn add(&mut self, name: impl AsRef<str>, value: impl AsRef<str>) {
        self.0.push((text::one_line(name.as_ref()), text::one_line(value.as_ref())));
    }

    /// Returns names and values.
    pub fn into_rows(self) -> Vec<(String, String)> {
        self.0
    }

    /// Returns the table, with names and values in columns.
    pub fn text(&self) -> String {
        let width = self.0.iter().map(|(name, _)| name.len()).max().unwrap_or(0);
        let lines = self.0.iter().map(|(name, value)| format!("{name:width$}  {value}"));
        lines.collect::<Vec<_>>().join("\n")
    }
}
