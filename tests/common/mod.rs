//! A cheap engine for tests of worlds.

use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

use ndarray::Array2;
use stemgen::engine::{Scan, Site};
use stemgen::progress::Progress;
use stemgen::world::SubTileEngine;
use stemgen::{Error, Result};

/// Draws a Gaussian spot on every atom; the position along the beam plays no part.
pub struct Spots {
    /// Sub-tiles after which it reports an interruption.
    pub until: usize,
    /// Sub-tiles simulated so far.
    pub done: AtomicUsize,
    /// Width of a spot in Angstrom; a parameter of the engine.
    pub sigma: f64,
}

impl Spots {
    pub fn new() -> Self {
        Spots::until(usize::MAX)
    }
    pub fn until(until: usize) -> Self {
        Spots { until, done: AtomicUsize::new(0), sigma: 0.4 }
    }
}

impl SubTileEngine for Spots {
    fn name(&self) -> String {
        "spots".into()
    }
    fn parameters(&self) -> serde_json::Value {
        serde_json::json!({ "sigma_angstrom": self.sigma })
    }
    fn margin_angstrom(&self) -> f64 {
        2.0
    }
    fn image(
        &self,
        sites: &[Site],
        box_angstrom: [f64; 3],
        scan: &Scan,
        _: &dyn Progress,
    ) -> Result<Array2<f32>> {
        if self.done.fetch_add(1, Relaxed) >= self.until {
            return Err(Error::Interrupted);
        }
        let mut image = Array2::<f64>::zeros(scan.shape);
        for site in sites {
            assert!((0..3).all(|k| (0.0..=box_angstrom[k]).contains(&site.position[k])));
            let strength = 1e-5 * f64::from(site.number).powf(1.7);
            let pixel =
                |k: usize| (site.position[k] - scan.origin_angstrom[k]) / scan.step_angstrom[k];
            let reach = (3.0 * self.sigma / scan.step_angstrom[0]).ceil();
            let range = |centre: f64, n: usize| {
                let clamp = |v: f64| v.clamp(0.0, n as f64) as usize;
                clamp((centre - reach).ceil())..clamp((centre + reach).floor() + 1.0)
            };
            let (cx, cy) = (pixel(0), pixel(1));
            for row in range(cy, scan.shape[0]) {
                for column in range(cx, scan.shape[1]) {
                    let (dx, dy) = (column as f64 - cx, row as f64 - cy);
                    let r = (dx * dx + dy * dy).sqrt() * scan.step_angstrom[0] / self.sigma;
                    image[(row, column)] += strength * (-0.5 * r * r).exp();
                }
            }
        }
        Ok(image.mapv(|v| v as f32))
    }
}
