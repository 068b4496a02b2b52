//! Estimates the error of an image from a sample of its probes.

use super::probe_sample::DrawnCluster;

/// Number of standard errors that are added to a mean square error before it is compared with the allowed one.
const STANDARD_ERRORS: f64 = 2.0;

/// The error of images, (thickness, detector), estimated from clusters of their probes.
#[derive(Debug, Clone, Default)]
pub struct ErrorEstimate {
    /// For each cluster and image: its estimates of the image's mean square error and of the image's mean.
    clusters: Vec<Vec<[f64; 2]>>,
}

/// Compares an estimate with the requested error.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AccuracyVerdict {
    /// The error is smaller than requested.
    Holds,
    /// The error is larger than requested.
    Fails,
    /// More probes are needed.
    Unclear,
}

impl ErrorEstimate {
    /// Adds a cluster: the values of `images` images at each of its probes, from windows (`ours`) and from the exact engine.
    pub fn add(&mut self, cluster: &DrawnCluster, images: usize, ours: &[f64], exact: &[f64]) {
        let mut sums = vec![[0.0; 2]; images];
        let each = 1.0 / cluster.indices.len() as f64;
        let probes = ours.chunks_exact(images).zip(exact.chunks_exact(images));
        for ((ours, exact), weight) in probes.zip(&cluster.weights) {
            for (sum, (o, e)) in sums.iter_mut().zip(ours.iter().zip(exact)) {
                sum[0] += weight * each * (o - e).powi(2);
                sum[1] += weight * each * e;
            }
        }
        self.clusters.push(sums);
    }

    /// Number of clusters.
    pub fn clusters(&self) -> usize {
        self.clusters.len()
    }

    /// The rms error of the worst image, and its largest likely error, in per cent of the image's mean.
    pub fn percent(&self) -> [f64; 2] {
        let n = self.clusters.len() as f64;
        let images = self.clusters.first().map_or(0, Vec::len);
        let of = |image: usize| {
            let mean = |k: usize| self.clusters.iter().map(|c| c[image][k]).sum::<f64>() / n;
            let (square, mean) = (mean(0), mean(1));
            let spread = self.clusters.iter().map(|c| (c[image][0] - square).powi(2)).sum::<f64>();
            let standard_error = (spread / (n - 1.0).max(1.0) / n).sqrt();
            match mean > 0.0 {
                true => [square, square + STANDARD_ERRORS * standard_error]
                    .map(|s| 100.0 * s.sqrt() / mean),
                false => [0.0; 2],
            }
        };
        let larger = |a: [f64; 2], b: [f64; 2]| [a[0].max(b[0]), a[1].max(b[1])];
        (0..images).map(of).fold([0.0; 2], larger)
    }

    /// Compares the error with a requested one in per cent.
    pub fn verdict(&self, asked_percent: f64) -> AccuracyVerdict {
        let [found, likely] = self.percent();
        match () {
            () if likely <= asked_percent => AccuracyVerdict::Holds,
            () if found > asked_percent => AccuracyVerdict::Fails,
            () => AccuracyVerdict::Unclear,
        }
    }
}
