//! A sample of a scan's probes, spread over the scan, with more of them where the image is bright. Counters draw the probes, so that equal
//! input gives equal probes.

use super::super::probe_patches::blocks;
use super::super::probe_scan::Scan;
use crate::rng::{self, Purpose};
use crate::structure::Site;

/// Width in Angstrom of the clusters in which probes are drawn. Neighbouring probes share the waves of a window.
const CLUSTER_ANGSTROM: f64 = 3.6;
/// Share of the sample that is drawn by brightness; the rest is drawn evenly.
const BY_BRIGHTNESS: f64 = 0.5;
/// Estimated brightness of an atom: this power of its atomic number, in a Gaussian of this standard deviation in Angstrom, about as wide as
/// the image of a column. Errors are largest in the middle of columns.
const BRIGHTNESS: (f64, f64) = (1.7, 0.35);
/// Radius of the Gaussian along x and y, in standard deviations.
const REACH: f64 = 2.5;

/// The probes of a scan, each with its chance to be drawn.
pub struct ProbeSample {
    /// Indices in the scan of the probes of each cluster, row-major.
    clusters: Vec<Vec<usize>>,
    /// The chance of each probe of the scan; the chances add to 1.
    chances: Vec<f64>,
    /// The sum of the chances in each cluster.
    cluster_chances: Vec<f64>,
}

/// The drawn probes of one cluster.
#[derive(Debug, Clone)]
pub struct DrawnCluster {
    /// Indices in the scan; an index may occur twice.
    pub indices: Vec<usize>,
    /// Weight of each probe's value in a mean over the scan: 1 / (chance x number of the scan's probes).
    pub weights: Vec<f64>,
}

impl ProbeSample {
    /// Divides a scan into clusters and computes the chances, for atoms in a cell of `cell_angstrom` (x, y).
    pub fn new<'a>(
        scan: &Scan,
        sites: impl Iterator<Item = &'a Site>,
        cell_angstrom: [f64; 2],
    ) -> Self {
        let bright = brightness(scan, sites, cell_angstrom);
        let (total, even) = (bright.iter().sum::<f64>(), 1.0 / scan.len() as f64);
        let chance = |b: f64| match total > 0.0 {
            true => (1.0 - BY_BRIGHTNESS) * even + BY_BRIGHTNESS * b / total,
            false => even,
        };
        let chances: Vec<f64> = bright.into_iter().map(chance).collect();
        let [columns, rows] =
            [0, 1].map(|k| blocks(scan.shape[1 - k], scan.step_angstrom[k], CLUSTER_ANGSTROM));
        let mut clusters = Vec::with_capacity(rows.len() * columns.len());
        for rows in &rows {
            for columns in &columns {
                let line = |y: usize| columns.clone().map(move |x| y * scan.shape[1] + x);
                clusters.push(rows.clone().flat_map(line).collect::<Vec<usize>>());
            }
        }
        let sum = |c: &Vec<usize>| c.iter().map(|&i| chances[i]).sum();
        let cluster_chances = clusters.iter().map(sum).collect();
        ProbeSample { clusters, chances, cluster_chances }
    }

    /// Number of clusters.
    pub fn clusters(&self) -> usize {
        self.clusters.len()
    }

    /// Draws `clusters` clusters with `probes` probes each, both at even distances in the sums of the chances. Another `round` draws
    /// others.
    pub fn draw(&self, clusters: usize, probes: usize, round: u32) -> Vec<DrawnCluster> {
        let uniform = |n: u64| rng::uniform(0, Purpose::AccuracySample, round, n);
        let chosen = systematic(&self.cluster_chances, clusters, uniform(0));
        let drawn = chosen.into_iter().enumerate().map(|(n, c)| {
            let members = &self.clusters[c];
            let chances: Vec<f64> = members.iter().map(|&i| self.chances[i]).collect();
            let picked = systematic(&chances, probes, uniform(1 + n as u64));
            let indices: Vec<usize> = picked.into_iter().map(|p| members[p]).collect();
            let weight = |&i: &usize| 1.0 / (self.chances[i] * self.chances.len() as f64);
            DrawnCluster { weights: indices.iter().map(weight).collect(), indices }
        });
        drawn.collect()
    }
}

/// Picks `number` items at even distances in the running sum of their sizes. `start` (0 to 1) is the place of the first, in units of the
/// distance.
fn systematic(sizes: &[f64], number: usize, start: f64) -> Vec<usize> {
    let distance = sizes.iter().sum::<f64>() / number as f64;
    let (mut at, mut sum) = (0, sizes[0]);
    let mut item = |n: usize| {
        let wanted = (n as f64 + start) * distance;
        while sum <= wanted && at + 1 < sizes.len() {
            at += 1;
            sum += sizes[at];
        }
        at
    };
    (0..number).map(&mut item).collect()
}

/// Estimates the brightness of the image at each probe, as if the nearby atoms scattered independently.
fn brightness<'a>(
    scan: &Scan,
    sites: impl Iterator<Item = &'a Site>,
    cell_angstrom: [f64; 2],
) -> Vec<f64> {
    let [rows, columns] = scan.shape;
    let counts = [columns, rows];
    let mut out = vec![0.0; rows * columns];
    // Lines of probes (columns or rows) that an atom, or its image in another cell, is near to, with its brightness there.
    let lines = |x: f64, k: usize| {
        let (step, cell) = (scan.step_angstrom[k], cell_angstrom[k]);
        let sigma = BRIGHTNESS.1.max(step / REACH);
        let reach = REACH * sigma;
        let last = scan.origin_angstrom[k] + (counts[k] - 1) as f64 * step;
        let first_image = ((scan.origin_angstrom[k] - reach - x) / cell).ceil() as i64;
        let last_image = ((last + reach - x) / cell).floor() as i64;
        let near = (first_image..=last_image).flat_map(move |image| {
            let at = x + image as f64 * cell - scan.origin_angstrom[k];
            let low = ((at - reach) / step).ceil().max(0.0) as usize;
            let high = ((at + reach) / step).floor().min((counts[k] - 1) as f64);
            (low..(high + 1.0).max(0.0) as usize).map(move |line| {
                let away = (line as f64 * step - at) / sigma;
                (line, (-0.5 * away * away).exp())
            })
        });
        near.collect::<Vec<(usize, f64)>>()
    };
    for site in sites {
        let [across, down] = [0, 1].map(|k| lines(site.position[k], k));
        let strength = f64::from(site.number).powf(BRIGHTNESS.0);
        for (y, of_y) in &down {
            across.iter().for_each(|(x, of_x)| out[y * columns + x] += strength * of_y * of_x);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample() -> (ProbeSample, Vec<f64>) {
        let scan =
            Scan { origin_angstrom: [1.0, 2.0], step_angstrom: [0.25, 0.3], shape: [37, 50] };
        let site = |position, number| Site {
            position,
            number,
            sigma_angstrom: 0.0,
            anisotropy: None,
            key: 0,
        };
        let sites = [site([4.0, 5.0, 0.0], 79), site([38.0, 9.0, 0.0], 8)];
        let bright = brightness(&scan, sites.iter(), [30.0, 30.0]);
        (ProbeSample::new(&scan, sites.iter(), [30.0, 30.0]), bright)
    }

    #[test]
    fn atoms_and_their_periodic_images_are_bright() {
        let (_, bright) = sample();
        let at = |x: f64, y: f64| {
            bright[((y - 2.0) / 0.3).round() as usize * 50 + ((x - 1.0) / 0.25).round() as usize]
        };
        assert!(at(4.0, 5.0) > 20.0 * at(8.0, 9.0) && at(8.0, 9.0) > 0.0 && at(6.0, 7.0) == 0.0);
    }

    #[test]
    fn weighted_samples_have_the_means_of_the_scan() {
        let (sample, bright) = sample();
        assert!((sample.chances.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        let value = |i: usize| 1.0 + bright[i] + (i % 50) as f64;
        let exact = (0..37 * 50).map(value).sum::<f64>() / (37.0 * 50.0);
        let mean = |round: u32| {
            let drawn = sample.draw(12, 4, round);
            let of = |c: &DrawnCluster| {
                c.indices.iter().zip(&c.weights).map(|(i, w)| w * value(*i)).sum::<f64>() / 4.0
            };
            drawn.iter().map(of).sum::<f64>() / 12.0
        };
        let over_rounds = (0..400).map(mean).sum::<f64>() / 400.0;
        assert!((over_rounds / exact - 1.0).abs() < 0.02, "{over_rounds} {exact}");
        let (a, b) = (sample.draw(12, 4, 3), sample.draw(12, 4, 3));
        assert!(a.iter().zip(&b).all(|(a, b)| a.indices == b.indices));
        let all =
            |round| sample.draw(12, 4, round).iter().flat_map(|c| c.indices.clone()).collect();
        let (some, others): (Vec<usize>, Vec<usize>) = (all(0), all(1));
        assert_ne!(some, others);
    }
}
