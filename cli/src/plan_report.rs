//! Plans as text and as JSON, for `--dry-run`.

use super::{estimate, text};
use serde::Serialize;
use stemgen::engine::{Cost, Grid, Plan, Scan};

/// What a simulation will do.
#[derive(Debug, Serialize)]
pub struct PlanReport {
    /// Algorithm and its parameters.
    pub algorithm: stemgen::engine::Algorithm,
    /// Grid of the waves.
    pub wave_grid: GridReport,
    /// Grid of the transmission functions.
    pub transmission_grid: GridReport,
    /// Grid of the potentials.
    pub potential_grid: GridReport,
    /// Largest angle carried, in mrad.
    pub band_limit_mrad: f64,
    /// Electron wavelength in Angstrom.
    pub wavelength_angstrom: f64,
    /// Slices.
    pub slices: SliceReport,
    /// Thicknesses recorded, in Angstrom.
    pub thicknesses_angstrom: Vec<f64>,
    /// Plane waves of PRISM, or 0.
    pub beams: usize,
    /// Phonon configurations.
    pub configurations: u32,
    /// Probes per simulation.
    pub probes: usize,
    /// The largest arrays, in bytes.
    pub memory_bytes: u64,
    /// Threads.
    pub threads: usize,
    /// Estimated time in seconds, from the speed of transforms measured now: the middle of the range.
    pub estimated_time_s: f64,
    /// The least, on a machine that does nothing else, and the most, with what else runs now.
    pub estimated_range_s: [f64; 2],
    /// Things to know.
    pub warnings: Vec<String>,
}

/// A grid.
#[derive(Debug, Serialize)]
pub struct GridReport {
    points: [usize; 2],
    extent_angstrom: [f64; 2],
    sampling_angstrom: [f64; 2],
}

/// Slices.
#[derive(Debug, Serialize)]
pub struct SliceReport {
    count: usize,
    /// By a wave, in the mean.
    passed: f64,
    thinnest_angstrom: f64,
    thickest_angstrom: f64,
}

impl From<&Grid> for GridReport {
    fn from(grid: &Grid) -> Self {
        GridReport {
            points: grid.points,
            extent_angstrom: grid.extent_angstrom,
            sampling_angstrom: grid.sampling_angstrom(),
        }
    }
}

impl GridReport {
    fn text(&self) -> String {
        let [nx, ny] = self.points;
        let [lx, ly] = self.extent_angstrom;
        let [sx, sy] = self.sampling_angstrom;
        format!("{nx} x {ny} points over {lx:.2} x {ly:.2} A ({sx:.4} x {sy:.4} A)")
    }
}

impl PlanReport {
    /// Of a plan that runs `runs` times and costs so much each time.
    pub fn new(plan: &Plan, cost: &Cost, runs: usize) -> Self {
        let thickness = plan.slices.boundaries.windows(2).map(|w| w[1] - w[0]);
        let slices = SliceReport {
            count: plan.slices.len(),
            passed: cost.steps_per_wave,
            thinnest_angstrom: thickness.clone().fold(f64::INFINITY, f64::min),
            thickest_angstrom: thickness.fold(0.0, f64::max),
        };
        let threads = estimate::threads();
        let estimated_range_s = estimate::seconds(plan, cost, runs);
        PlanReport {
            algorithm: plan.settings.algorithm,
            wave_grid: (&plan.wave_grid).into(),
            transmission_grid: (&plan.transmission_grid).into(),
            potential_grid: (&plan.potential_grid).into(),
            band_limit_mrad: plan.band_limit_mrad,
            wavelength_angstrom: plan.settings.optics.wavelength_angstrom(),
            slices,
            thicknesses_angstrom: plan.thicknesses_angstrom(),
            beams: plan.beams,
            configurations: plan.settings.configurations(),
            probes: cost.probes,
            memory_bytes: cost.memory_bytes(threads),
            threads,
            estimated_time_s: middle(estimated_range_s),
            estimated_range_s,
            warnings: plan.warnings.clone(),
        }
    }

    /// Name and value, line by line.
    pub fn lines(&self, out: &mut Lines) {
        self.numerics(out);
        let recorded = self.thicknesses_angstrom.iter().map(|t| format!("{t:.2}"));
        out.add("recorded at", format!("{} A", recorded.collect::<Vec<_>>().join(", ")));
    }

    /// The same but for the thicknesses.
    pub fn numerics(&self, out: &mut Lines) {
        out.add("algorithm", self.algorithm.to_string());
        out.add("wave grid", self.wave_grid.text());
        if self.transmission_grid.points != self.wave_grid.points {
            out.add("transmission grid", self.transmission_grid.text());
        }
        out.add("potential grid", self.potential_grid.text());
        out.add("band limit", format!("{:.1} mrad", self.band_limit_mrad));
        let s = &self.slices;
        let range = match s.thickest_angstrom - s.thinnest_angstrom < 1e-3 {
            true => format!("{:.3} A", s.thickest_angstrom),
            false => format!("{:.3} to {:.3} A", s.thinnest_angstrom, s.thickest_angstrom),
        };
        let passed = match s.passed < s.count as f64 {
            true => format!("; a window passes {:.1}", s.passed),
            false => String::new(),
        };
        out.add("slices", format!("{} of {range}{passed}", s.count));
        if self.beams > 0 {
            out.add("beams", text::count(self.beams as u64));
        }
        out.add(
            "phonons",
            match self.configurations {
                1 => "1 configuration".into(),
                n => format!("{n} configurations"),
            },
        );
    }

    /// Adds the time of other simulations.
    pub fn add_time(&mut self, [least, most]: [f64; 2]) {
        self.estimated_range_s[0] += least;
        self.estimated_range_s[1] += most;
        self.estimated_time_s = middle(self.estimated_range_s);
    }

    /// Memory, time and warnings.
    pub fn costs(&self, out: &mut Lines) {
        out.add("memory", format!("about {}", text::bytes(self.memory_bytes)));
        let plural = if self.threads == 1 { "thread" } else { "threads" };
        let time = text::duration_range(self.estimated_range_s);
        let measured = format!("{time} on {} {plural} (from a short measurement)", self.threads);
        out.add("time", measured);
        for warning in &self.warnings {
            out.add("warning", warning.clone());
        }
    }
}

/// The middle of a range that is known up to a factor.
fn middle([least, most]: [f64; 2]) -> f64 {
    (least * most).sqrt()
}

/// One line about a scan.
pub fn scan(scan: &Scan) -> String {
    let [rows, columns] = scan.shape;
    let [x, y] = scan.step_angstrom;
    let [x0, y0] = scan.origin_angstrom;
    let n = text::count(scan.len() as u64);
    format!("{n}: {columns} x {rows}, {x:.4} x {y:.4} A apart, from {x0:.3}, {y0:.3} A")
}

/// One line about the beam and the lens.
pub fn beam(optics: &stemgen::optics::Optics) -> String {
    let mut text = format!("{} keV, {} mrad", optics.energy_ev / 1e3, optics.semiangle_mrad);
    for a in &optics.aberrations.0 {
        text += &match (a.order, a.symmetry) {
            (1, 0) => format!(", defocus {} A", -a.magnitude_angstrom),
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
    /// Adds a line. Names and values may be those of a file: each stays one line.
    pub fn add(&mut self, name: impl AsRef<str>, value: impl AsRef<str>) {
        self.0.push((text::one_line(name.as_ref()), text::one_line(value.as_ref())));
    }

    /// Names and values.
    pub fn into_rows(self) -> Vec<(String, String)> {
        self.0
    }

    /// The table, names and values in columns.
    pub fn text(&self) -> String {
        let width = self.0.iter().map(|(name, _)| name.len()).max().unwrap_or(0);
        let lines = self.0.iter().map(|(name, value)| format!("{name:width$}  {value}"));
        lines.collect::<Vec<_>>().join("\n")
    }
}
