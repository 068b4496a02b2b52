//! Detectors: annuli, their sectors and centres of mass, and pixelated ones.

mod centre_of_mass;
mod detector_mtf;
mod pattern_detector;
mod pixelated;
mod radial_bins;
mod seen_from;
mod virtual_detector;

use crate::error::{Error, Result};
use crate::setting::Setting;
use num_complex::Complex32;
use serde::{Deserialize, Serialize};

pub use centre_of_mass::{CentreOfMass, ShownImage, shown_images};
pub use detector_mtf::DetectorMtf;
pub(crate) use detector_mtf::MtfFilter;
pub use pattern_detector::PatternDetector;
pub(crate) use pixelated::MOST_PIXELS;
pub use pixelated::PixelatedDetector;
pub use radial_bins::RadialBins;
pub use virtual_detector::{
    VirtualDetector, centre_of_mass_mrad, integrated_centre_of_mass, weighted_sum,
};

/// Number of thin annuli between two angles of a response.
const ANNULI: usize = 16;

/// Largest angle: a right angle.
const MOST_MRAD: f64 = 1570.0;

/// An annular detector: `inner <= theta < outer`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Detector {
    /// Name of the detector's image.
    pub name: String,
    /// Inner angle in mrad.
    pub inner_mrad: f64,
    /// Outer angle in mrad.
    pub outer_mrad: f64,
    /// Share of the electrons that is counted at some angles: (mrad, 0 to 1), by rising angle. It is linear between these angles and
    /// constant beyond. Without any, all electrons are counted.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub response: Vec<[f64; 2]>,
    /// Azimuths in degrees between which a sector of the annulus lies, from +x towards +y, which points down; without it the whole
    /// annulus.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sector_degrees: Option<[f64; 2]>,
    /// The part of a centre of mass that the detector is; without it, electrons are counted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub centre_of_mass: Option<CentreOfMass>,
}

/// Greatest number of sectors of an annulus.
pub const MOST_SECTORS: usize = 360;
/// The word for a centre of mass in the place of a number of sectors.
const CENTRE_OF_MASS: &str = "com";

impl Detector {
    /// A named annulus.
    pub fn new(name: &str, inner_mrad: f64, outer_mrad: f64) -> Self {
        let name = name.to_owned();
        Detector {
            name,
            inner_mrad,
            outer_mrad,
            response: Vec::new(),
            sector_degrees: None,
            centre_of_mass: None,
        }
    }

    /// Divides the annulus into equal sectors with the names `NAME_0`, `NAME_1`, ...; the first begins at the azimuth `first_degrees`.
    pub fn divided(&self, sectors: usize, first_degrees: f64) -> Vec<Self> {
        let width = 360.0 / sectors as f64;
        let edge = |n: usize| first_degrees + n as f64 * width;
        let sector = |n: usize| Detector {
            name: format!("{}_{n}", self.name),
            sector_degrees: Some([edge(n), edge(n + 1)]),
            ..self.clone()
        };
        (0..sectors).map(sector).collect()
    }

    /// Reads `[NAME=]INNER-OUTER` in mrad, or `[NAME=]INNER-OUTER:SECTORS[@DEGREES]`: equal sectors of the annulus, of which the first
    /// begins at the azimuth `DEGREES`. `[NAME=]INNER-OUTER:com` is a centre of mass.
    ///
    /// # Errors
    /// [`Error::Invalid`] for anything else, and for less than 2 or more than [`MOST_SECTORS`] sectors.
    pub fn parse_all(text: &str) -> Result<Vec<Self>> {
        let Some((annulus, rest)) = text.split_once(':') else {
            return Ok(vec![Self::parse(text)?]);
        };
        if rest.trim().eq_ignore_ascii_case(CENTRE_OF_MASS) {
            return Ok(vec![Self::parse(annulus)?.with_centre_of_mass()]);
        }
        let bad = || {
            let expected = format!(
                "write INNER-OUTER:SECTORS with 2 to {MOST_SECTORS} sectors, INNER-OUTER:SECTORS@DEGREES (0-21:4@45), or INNER-OUTER:{CENTRE_OF_MASS}"
            );
            Error::invalid(Setting::Detector, text, expected)
        };
        let (number, first) = rest.split_once('@').unwrap_or((rest, "0"));
        let number: usize = number.trim().parse().map_err(|_| bad())?;
        let first: f64 = first.trim().parse().map_err(|_| bad())?;
        if !(2..=MOST_SECTORS).contains(&number) || !(-360.0..=360.0).contains(&first) {
            return Err(bad());
        }
        Ok(Self::parse(annulus)?.divided(number, first))
    }

    /// The angles in words: `68-200 mrad`, `0-21 mrad, 45 to 135 degrees`, `0-50 mrad, centre of mass`.
    pub fn angles(&self) -> String {
        let annulus = format!("{}-{} mrad", self.inner_mrad, self.outer_mrad);
        match (self.sector_degrees, self.centre_of_mass) {
            (Some([from, to]), _) => format!("{annulus}, {from} to {to} degrees"),
            (None, Some(_)) => format!("{annulus}, centre of mass"),
            (None, None) => annulus,
        }
    }

    /// The share of all azimuths that the detector covers.
    pub fn azimuth_share(&self) -> f64 {
        self.sector_degrees.map_or(1.0, |[from, to]| (to - from) / 360.0)
    }

    /// Reads `NAME=INNER-OUTER` or `INNER-OUTER` (mrad).
    ///
    /// # Errors
    /// [`Error::Invalid`] for a malformed name or angles.
    pub fn parse(text: &str) -> Result<Self> {
        let bad = |expected: &str| Error::invalid(Setting::Detector, text, expected);
        let (name, range) = match text.split_once('=') {
            Some((n, r)) => (n.trim().to_owned(), r),
            None => (format!("annular_{}", text.trim().replace('-', "_")), text),
        };
        let (inner, outer) = range
            .split_once('-')
            .ok_or_else(|| bad("write NAME=INNER-OUTER in mrad, HAADF=68-200"))?;
        let number = |s: &str| s.trim().parse().ok().filter(|v: &f64| v.is_finite());
        let (Some(inner_mrad), Some(outer_mrad)) = (number(inner), number(outer)) else {
            return Err(bad("write NAME=INNER-OUTER in mrad, HAADF=68-200"));
        };
        let detector = Detector::new(&name, inner_mrad, outer_mrad);
        detector.fault().map_or(Ok(detector), |fault| Err(bad(fault)))
    }

    /// Checks name and angles.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a name that no file can have, and for angles that form no annulus.
    pub(crate) fn validate(&self) -> Result<()> {
        let value = || format!("{}={}-{}", self.name, self.inner_mrad, self.outer_mrad);
        self.fault().map_or(Ok(()), |fault| Err(Error::invalid(Setting::Detector, value(), fault)))
    }

    /// The fault in the name or the angles, in words.
    fn fault(&self) -> Option<&'static str> {
        let plain = |c: char| c.is_ascii_alphanumeric() || "_-.".contains(c);
        if self.name.is_empty() || !self.name.chars().all(plain) {
            return Some("the name may hold letters, digits, _ - and . only");
        }
        if !self.name.contains(|c: char| c.is_ascii_alphanumeric()) {
            return Some("the name needs a letter or digit");
        }
        // The comparison is not `inner < 0`, so that NaN is refused too.
        if !(self.inner_mrad >= 0.0 && self.outer_mrad > self.inner_mrad) {
            return Some("the outer angle must exceed the inner, which must not be negative");
        }
        if self.outer_mrad > MOST_MRAD {
            return Some("the outer angle is at most 1570 mrad, a right angle");
        }
        let sector = self.sector_degrees.unwrap_or([0.0, 360.0]);
        if self.sector_degrees.is_some() && self.centre_of_mass.is_some() {
            return Some("a centre of mass is of a whole annulus, not of a sector");
        }
        let fits = sector.iter().all(|v| v.abs() <= 1080.0)
            && (1e-3..=360.0).contains(&(sector[1] - sector[0]));
        (!fits).then_some("the azimuths of a sector must rise, by at most 360 degrees")
    }

    /// Whether engines can measure the detector itself.
    pub(crate) fn is_measured(&self) -> bool {
        self.centre_of_mass.is_none_or(CentreOfMass::is_measured)
    }

    /// Whether `theta_mrad` falls on the detector.
    pub(crate) fn contains(&self, theta_mrad: f64) -> bool {
        self.inner_mrad <= theta_mrad && theta_mrad < self.outer_mrad
    }

    /// Replaces the response.
    #[must_use]
    pub fn with_response(self, response: Vec<[f64; 2]>) -> Self {
        Detector { response, ..self }
    }

    /// The share of the electrons that is counted at an angle on the detector.
    pub fn response_at(&self, theta_mrad: f64) -> f64 {
        let after = self.response.partition_point(|[angle, _]| *angle <= theta_mrad);
        let at = |n: usize| self.response.get(n);
        match (after.checked_sub(1).and_then(at), at(after)) {
            (Some([a, from]), Some([b, to])) => from + (to - from) * (theta_mrad - a) / (b - a),
            (Some([_, share]), None) | (None, Some([_, share])) => *share,
            (None, None) => 1.0,
        }
    }

    /// Divides the detector within `limit_mrad` into annuli (inner and outer angle in mrad, share that is counted): one without a response,
    /// else thin ones. Shares are means over all azimuths.
    pub(crate) fn annuli(&self, limit_mrad: f64) -> Vec<([f64; 2], f64)> {
        let outer = self.outer_mrad.min(limit_mrad);
        let mean = |theta_mrad| {
            self.centre_of_mass.map_or(1.0, |part| part.mean_weight(theta_mrad, self.outer_mrad))
        };
        if self.response.is_empty() && !self.centre_of_mass.is_some_and(CentreOfMass::varies) {
            return vec![([self.inner_mrad, outer], mean(outer))];
        }
        let knots = self.response.iter().map(|[angle, _]| *angle);
        let within = knots.filter(|angle| self.inner_mrad < *angle && *angle < outer);
        let ends: Vec<f64> =
            std::iter::once(self.inner_mrad).chain(within).chain([outer]).collect();
        let thin = |pair: &[f64]| {
            let (from, width) = (pair[0], (pair[1] - pair[0]) / ANNULI as f64);
            (0..ANNULI).map(move |n| {
                let inner = from + n as f64 * width;
                ([inner, inner + width], inner + 0.5 * width)
            })
        };
        let all = ends.windows(2).flat_map(thin);
        all.map(|(range, middle)| (range, self.response_at(middle) * mean(middle))).collect()
    }

    /// The counted share of a pixel in a direction (x, y) in mrad, with edges `ramp_mrad` wide.
    fn weight(&self, at: [f64; 2], pattern: &Pattern) -> f64 {
        let theta_mrad = at[0].hypot(at[1]);
        let ring = self.share_on(theta_mrad, pattern.ramp_mrad) * self.response_at(theta_mrad);
        match (self.sector_degrees, self.centre_of_mass) {
            (Some(sector), _) if ring > 0.0 => {
                ring * share_of_sector(at, pattern.pixel_mrad, sector)
            }
            (None, Some(part)) => ring * part.weight(at, self.outer_mrad),
            _ => ring,
        }
    }

    /// The share of a pixel at `theta_mrad` that lies on the detector, with edges `ramp_mrad` wide.
    fn share_on(&self, theta_mrad: f64, ramp_mrad: f64) -> f64 {
        if ramp_mrad <= 0.0 {
            return f64::from(u8::from(self.contains(theta_mrad)));
        }
        let inside = |room: f64| (room / ramp_mrad + 0.5).clamp(0.0, 1.0);
        let inner = if self.inner_mrad > 0.0 { inside(theta_mrad - self.inner_mrad) } else { 1.0 };
        inner * inside(self.outer_mrad - theta_mrad)
    }
}

/// Points along an edge of a pixel that measure the share of its area in a sector.
const POINTS: usize = 16;

/// The share of a pixel's area whose azimuth lies between two angles in degrees. The shares of sectors that divide a ring add to 1.
fn share_of_sector(at: [f64; 2], pixel: [f64; 2], [from, to]: [f64; 2]) -> f64 {
    let within = |[x, y]: [f64; 2]| {
        let azimuth = libm::atan2(y, x).to_degrees();
        (azimuth - from).rem_euclid(360.0) < to - from
    };
    let reach = 0.5 * pixel[0].hypot(pixel[1]);
    // Distance from a ray that bounds the sector; pixels behind its origin are not near it.
    let near = |degrees: f64| {
        let (sin, cos) = libm::sincos(degrees.to_radians());
        let (along, across) = (at[0] * cos + at[1] * sin, at[1] * cos - at[0] * sin);
        along > -reach && across.abs() < reach
    };
    if !near(from) && !near(to) {
        return f64::from(u8::from(within(at)));
    }
    let offset = |n: usize, k: usize| ((n as f64 + 0.5) / POINTS as f64 - 0.5) * pixel[k];
    let point = |n: usize| [at[0] + offset(n % POINTS, 0), at[1] + offset(n / POINTS, 1)];
    let inside = (0..POINTS * POINTS).filter(|n| within(point(*n))).count();
    inside as f64 / (POINTS * POINTS) as f64
}

/// For each detector, the pixels of a diffraction pattern that it collects.
#[derive(Debug, Clone, Default)]
pub(crate) struct DetectorMap {
    per_detector: Vec<Pixels>,
}

#[derive(Debug, Clone, Default)]
struct Pixels {
    /// Whole pixels as runs along rows: (first element, length).
    runs: Vec<(usize, usize)>,
    /// Pixels on the edges: (element, weight).
    edges: Vec<(usize, f32)>,
}

/// The layout of a diffraction pattern in FFT order (rows = ky, columns = kx), with the limits of its collection by detectors.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Pattern {
    /// (rows, columns)
    pub shape: (usize, usize),
    /// Elements from row to row.
    pub stride: usize,
    /// Only pixels below this angle are counted.
    pub limit_mrad: f64,
    /// Width of the linear ramp by which pixels on a detector's edge are counted in part. With 0 each pixel is counted wholly or not at
    /// all, as in abTEM.
    pub ramp_mrad: f64,
    /// Edges (x, y) of a pixel in mrad; pixels on the edge of a sector are counted in part.
    pub pixel_mrad: [f64; 2],
}

impl DetectorMap {
    /// Maps detectors onto a pattern; `angles_mrad(iy, ix)` are the angles (x, y) in mrad of the pixel in row iy, column ix, and
    /// `share(detector, theta_mrad)` is the share of its electrons that is counted.
    pub(crate) fn new(
        detectors: &[Detector],
        pattern: Pattern,
        angles_mrad: impl Fn(usize, usize) -> [f64; 2],
        share: impl Fn(&Detector, f64) -> f64,
    ) -> Self {
        let mut per_detector = vec![Pixels::default(); detectors.len()];
        for iy in 0..pattern.shape.0 {
            for ix in 0..pattern.shape.1 {
                let at = angles_mrad(iy, ix);
                let theta_mrad = at[0].hypot(at[1]);
                if theta_mrad >= pattern.limit_mrad {
                    continue;
                }
                for (d, pixels) in detectors.iter().zip(&mut per_detector) {
                    let weight = d.weight(at, &pattern) * share(d, theta_mrad);
                    pixels.add(iy * pattern.stride + ix, weight);
                }
            }
        }
        DetectorMap { per_detector }
    }

    /// Writes the intensity on each detector to `out`: the sum of `scale |psi|^2` over its pixels. `psi` is a pattern of this map's layout.
    pub(crate) fn collect(&self, psi: &[Complex32], scale: f64, out: &mut [f64]) {
        for (pixels, value) in self.per_detector.iter().zip(out) {
            let whole = |&(at, n): &(usize, usize)| f64::from(power(&psi[at..at + n]));
            let part = |&(at, w): &(usize, f32)| f64::from(w * psi[at].norm_sqr());
            let sum = pixels.runs.iter().map(whole).sum::<f64>()
                + pixels.edges.iter().map(part).sum::<f64>();
            *value = sum * scale;
        }
    }

    /// Calls `put(detector, amplitudes)` with parts of a vector for each detector; the squared moduli of all its parts add
    /// to the intensity on the detector.
    pub(crate) fn gather(&self, psi: &[Complex32], mut put: impl FnMut(usize, &[Complex32])) {
        for (d, pixels) in self.per_detector.iter().enumerate() {
            pixels.runs.iter().for_each(|&(at, n)| put(d, &psi[at..at + n]));
            pixels.edges.iter().for_each(|&(at, w)| put(d, &[psi[at] * w.sqrt()]));
        }
    }
}

impl Pixels {
    fn add(&mut self, at: usize, weight: f64) {
        if weight >= 1.0 {
            match self.runs.last_mut() {
                Some((first, len)) if *first + *len == at => *len += 1,
                _ => self.runs.push((at, 1)),
            }
        } else if weight > 0.0 {
            self.edges.push((at, weight as f32));
        }
    }
}

/// Sum of squared moduli in a fixed order that vectorises.
fn power(psi: &[Complex32]) -> f32 {
    const LANES: usize = 16;
    let mut sums = [0.0_f32; LANES];
    let chunks = psi.chunks_exact(LANES);
    let rest: f32 = chunks.remainder().iter().map(|v| v.norm_sqr()).sum();
    for chunk in chunks {
        for (s, v) in sums.iter_mut().zip(chunk) {
            *s += v.norm_sqr();
        }
    }
    sums.iter().sum::<f32>() + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn annuli_partition_the_pattern() {
        let names = ["a=0-10", "b=10-30", "c=30-60", "all=0-60"];
        let detectors: Vec<Detector> = names.iter().map(|t| Detector::parse(t).unwrap()).collect();
        let (ny, nx, stride) = (40, 50, 64);
        let angles = |iy, ix| {
            [crate::fft::frequency(ix, nx), crate::fft::frequency(iy, ny)].map(|n| 2.0 * n as f64)
        };
        for ramp_mrad in [0.0, 2.0] {
            let pixel_mrad = [2.0; 2];
            let pattern =
                Pattern { shape: (ny, nx), stride, limit_mrad: 1e9, ramp_mrad, pixel_mrad };
            let map = DetectorMap::new(&detectors, pattern, angles, |_, _| 1.0);
            let psi: Vec<Complex32> =
                (0..ny * stride).map(|i| Complex32::new((i % 13) as f32, 1.0)).collect();
            let mut sums = [0.0; 4];
            map.collect(&psi, 2.0, &mut sums);
            assert!((sums[0] + sums[1] + sums[2] - sums[3]).abs() < 1e-6 * sums[3]);
            assert!(sums[..3].iter().all(|s| *s > 0.0));
            let even = vec![Complex32::ONE; ny * stride];
            let mut p = [0.0; 4];
            map.collect(&even, 1.0, &mut p);
            // Sectors divide each annulus, and have the share of their azimuths of the area.
            for (sectors, first) in [(4, 0.0), (4, 45.0), (3, -20.0), (7, 33.3)] {
                let divided = detectors[1].divided(sectors, first);
                let map = DetectorMap::new(&divided, pattern, angles, |_, _| 1.0);
                let mut parts = vec![0.0; sectors];
                map.collect(&psi, 2.0, &mut parts);
                assert!((parts.iter().sum::<f64>() - sums[1]).abs() < 1e-6 * sums[1]);
                let mut shares = vec![0.0; sectors];
                map.collect(&even, 1.0, &mut shares);
                for share in shares {
                    assert!((share * sectors as f64 / p[1] - 1.0).abs() < 0.06, "{share} {}", p[1]);
                }
                // A quadrant is a quarter.
                let share = divided[0].azimuth_share();
                assert!((share * sectors as f64 - 1.0).abs() < 1e-12);
            }
        }
        // Azimuths run from +x towards +y.
        let [right, down, left, up] = &detectors[1].divided(4, -45.0)[..] else { panic!() };
        for (detector, at) in
            [(right, [20.0, 0.0]), (down, [0.0, 20.0]), (left, [-20.0, 0.0]), (up, [0.0, -20.0])]
        {
            let pattern = Pattern {
                shape: (1, 1),
                stride: 1,
                limit_mrad: 1e9,
                ramp_mrad: 0.0,
                pixel_mrad: [1.0; 2],
            };
            assert_eq!(detector.weight(at, &pattern), 1.0, "{}", detector.name);
            assert_eq!(detector.weight(at.map(|v| -v), &pattern), 0.0);
        }
        // exactly on the inner edge belongs to the outer annulus
        assert!(!detectors[0].contains(10.0) && detectors[1].contains(10.0));
    }

    #[test]
    fn a_response_counts_a_share_of_each_angle() {
        let plain = Detector::new("d", 10.0, 50.0);
        assert!([0.0, 30.0, 99.0].iter().all(|a| plain.response_at(*a) == 1.0));
        assert_eq!(plain.annuli(40.0), [([10.0, 40.0], 1.0)]);
        let d = plain.with_response(vec![[20.0, 1.0], [30.0, 0.5], [40.0, 0.7]]);
        let shares = [5.0, 20.0, 25.0, 30.0, 35.0, 40.0, 60.0].map(|a| d.response_at(a));
        let expected = [1.0, 1.0, 0.75, 0.5, 0.6, 0.7, 0.7];
        assert!(shares.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{shares:?}");
        let annuli = d.annuli(45.0);
        assert_eq!((annuli[0].0[0], annuli[annuli.len() - 1].0[1]), (10.0, 45.0));
        assert!(annuli.windows(2).all(|w| (w[0].0[1] - w[1].0[0]).abs() < 1e-9));
        // 10 whole, 10 at three quarters, 10 at 0.6, 5 at 0.7
        let sum: f64 = annuli.iter().map(|([a, b], share)| (b - a) * share).sum();
        assert!((sum - 27.0).abs() < 1e-9, "{sum}");
    }

    #[test]
    fn malformed_detectors_are_refused() {
        for bad in ["", "HAADF", "x=10", "x=20-10", "x=-5-10", "a b=1-2", "x=nan-3"] {
            assert!(Detector::parse(bad).is_err(), "{bad}");
            assert!(Detector::parse_all(bad).is_err(), "{bad}");
        }
        for bad in ["x=0-21:1", "x=0-21:", "x=0-21:4@", "x=0-21:4@nan", "x=0-21:361", "0-21:4:4"] {
            assert!(Detector::parse_all(bad).is_err(), "{bad}");
        }
        let quadrants = Detector::parse_all("DPC=0-21:4@45").unwrap();
        assert_eq!(quadrants[3].name, "DPC_3");
        assert_eq!(quadrants[3].angles(), "0-21 mrad, 315 to 405 degrees");
        let turned = Detector { sector_degrees: Some([20.0, 10.0]), ..quadrants[0].clone() };
        assert!(turned.validate().is_err());
    }
}
