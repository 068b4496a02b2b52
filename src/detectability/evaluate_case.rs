//! From the images of a patch to the tests of one detector.

use ndarray::{Array2, Axis};

use super::defect_signal::{DefectSignal, best_annulus};
use super::detectability_report::{
    AnnulusFound, AtDose, DetectorDetectability, DoseVerdict, NeededDose,
};
use super::detectability_request::DetectabilityRequest;
use super::linear_observer::linear_d_prime;
use super::mixture_test::MixtureTest;
use super::poisson_test::PoissonTest;
use super::roc::{TestPower, normal_quantile};
use crate::detect::Detector;
use crate::rng::{Purpose, words};

/// The dose is sought up to this many times the dose of a known image.
const MOST_TIMES: f64 = 1e4;
/// Bisections of a dose.
const BISECTIONS: usize = 40;
/// Phonon patterns, each a mean over some configurations, that a half of the configurations makes.
const PATTERNS: usize = 64;

/// The images of one detector: (configuration, pixel) in fractions of the beam.
pub struct DetectorImages {
    /// Without the defect.
    pub without: Array2<f64>,
    /// With the defect, for each of its forms.
    pub with: Vec<Array2<f64>>,
    /// Without the defect, the column moved along x and along y, in some configurations.
    pub moved: [Array2<f64>; 2],
    /// By how much it moved, in Angstrom.
    pub moved_angstrom: f64,
}

/// The tests of a detector on a defect.
pub struct Evaluation<'a> {
    request: &'a DetectabilityRequest,
    images: &'a DetectorImages,
    area: f64,
    signals: Vec<DefectSignal>,
    known: Vec<PoissonTest>,
    mixture: Option<MixtureTest>,
}

impl<'a> Evaluation<'a> {
    /// Prepares the tests; pixels have the area `area` in square Angstrom.
    pub fn new(request: &'a DetectabilityRequest, images: &'a DetectorImages, area: f64) -> Self {
        let signal =
            |with: &Array2<f64>| DefectSignal::new([images.without.view(), with.view()], area);
        let signals: Vec<DefectSignal> = images.with.iter().map(signal).collect();
        let test = |signal: &DefectSignal| PoissonTest::new(&signal.means[0], &signal.means[1]);
        let known = signals.iter().map(test).collect();
        let mut made = Evaluation { request, images, area, signals, known, mixture: None };
        made.mixture = made.mixture();
        made
    }

    /// The result of the detector.
    pub fn result(&self, detector: &Detector) -> DetectorDetectability {
        let count = self.signals.len() as f64;
        let mean =
            |of: &dyn Fn(&DefectSignal) -> f64| self.signals.iter().map(of).sum::<f64>() / count;
        let error = self.signals.iter().map(|s| s.error * s.error).sum::<f64>().sqrt() / count;
        let information = mean(&|s| s.information);
        let known = self.needed_known(information, error);
        DetectorDetectability {
            detector: detector.name.clone(),
            annulus_mrad: [detector.inner_mrad, detector.outer_mrad],
            contrast_percent: 100.0 * mean(&|s| s.contrast),
            information_angstrom2: information,
            information_error_angstrom2: error,
            linear: self.is_linear().then(|| self.needed_linear(known)),
            mixture: self.mixture.as_ref().map(|test| self.needed_mixture(test, known)),
            known,
            doses: self.request.doses.iter().map(|dose| self.at(*dose)).collect(),
        }
    }

    fn is_linear(&self) -> bool {
        self.request.averaged.is_some() && self.signals.len() == 1
    }

    /// The tests at a dose in electrons per square Angstrom.
    fn at(&self, dose: f64) -> AtDose {
        let DetectabilityRequest { false_alarms: alarms, rate, .. } = *self.request;
        let each: Vec<TestPower> =
            self.known.iter().map(|test| test.at(dose, alarms, rate)).collect();
        let linear = self.is_linear().then(|| TestPower::normal(self.linear(dose), alarms, rate));
        AtDose {
            electrons_per_angstrom2: dose,
            counted_electrons: dose * self.signals[0].means[0].iter().sum::<f64>(),
            known: mean_power(&each),
            linear,
            mixture: self.mixture.as_ref().map(|test| test.at(dose, alarms, rate)),
            position_error_angstrom: self.position_error(dose),
        }
    }

    fn linear(&self, dose: f64) -> f64 {
        let averaged = self.request.averaged.unwrap_or(1) as usize;
        let images = [self.images.without.view(), self.images.with[0].view()];
        linear_d_prime(images, self.area, averaged, dose)
    }

    fn known_power(&self, dose: f64) -> f64 {
        let alarms = self.request.false_alarms;
        let sum: f64 = self.known.iter().map(|test| test.power(dose, alarms)).sum();
        sum / self.known.len() as f64
    }

    fn needed_known(&self, information: f64, error: f64) -> NeededDose {
        let start = self.normal_dose(information.max(0.0));
        needed_known(self.request, (information, error), start, |from| {
            least_dose(|dose| self.known_power(dose), self.request.power, from)
        })
    }

    /// The dose for the power with normal distributions.
    fn normal_dose(&self, information: f64) -> f64 {
        normal_dose(self.request, information)
    }

    fn needed_linear(&self, known: NeededDose) -> NeededDose {
        let alarms = self.request.false_alarms;
        let power = |dose: f64| TestPower::normal(self.linear(dose), alarms, 0.5).power;
        let Some(from) = known.electrons_per_angstrom2 else { return known };
        if power(MOST_TIMES * from) < self.request.power {
            return NeededDose::NEVER;
        }
        let found = least_dose(power, self.request.power, from * MOST_TIMES.sqrt());
        scaled(known, found)
    }

    fn needed_mixture(&self, test: &MixtureTest, known: NeededDose) -> NeededDose {
        let Some(from) = known.electrons_per_angstrom2 else { return known };
        let DetectabilityRequest { power, false_alarms, .. } = *self.request;
        match test.needed_dose([0.5 * from, 400.0 * from], power, false_alarms) {
            None => NeededDose::NEVER,
            Some([dose, ..]) => scaled(known, dose),
        }
    }

    /// The mixture of depths, or of phonon patterns that average some configurations; `None` for one known image.
    fn mixture(&self) -> Option<MixtureTest> {
        let request = self.request;
        let (experiments, seed) = (request.experiments, request.specimen.seed);
        if request.averaged.is_none() {
            let with: Vec<_> = self.signals.iter().map(|s| s.means[1].clone()).collect();
            let all = [vec![self.signals[0].means[0].clone()], with];
            let test = MixtureTest { known: all.clone(), data: all, experiments, seed };
            return (self.signals.len() > 1).then_some(test);
        }
        // One half of the configurations makes the data, the other half the images that the test knows.
        let half = |k: usize| {
            let with = self.images.with.iter().flat_map(|with| self.patterns(with, k));
            [self.patterns(&self.images.without, k), with.collect()]
        };
        Some(MixtureTest { known: half(0), data: half(1), experiments, seed })
    }

    /// Means over randomly drawn configurations of one half, as expected electrons per dose.
    fn patterns(&self, images: &Array2<f64>, half: usize) -> Vec<Vec<f64>> {
        let averaged = self.request.averaged.unwrap_or(1) as usize;
        let rows = images.nrows() / 2;
        let seed = self.request.specimen.seed;
        let pattern = |n: usize| {
            // The first rows of a shuffled list, so that no configuration is drawn twice.
            let mut order: Vec<usize> = (0..rows).collect();
            for k in 0..averaged.min(rows) {
                let item = (n * rows + k) as u64;
                let word = words(seed, Purpose::Detectability, half as u32 + 1, item)[0] as usize;
                order.swap(k, k + word % (rows - k));
            }
            let chosen: Vec<usize> =
                order[..averaged.min(rows)].iter().map(|r| half * rows + r).collect();
            let mean = images.select(Axis(0), &chosen).sum_axis(Axis(0)) / chosen.len() as f64;
            mean.mapv(|v| self.area * v).to_vec()
        };
        (0..PATTERNS).map(pattern).collect()
    }

    /// The least standard errors of the column's place (x, y) in Angstrom: the inverse of Fisher's information
    /// sum over pixels of dose * area / m * (dm / dx) (dm / dy).
    fn position_error(&self, dose: f64) -> [f64; 2] {
        let images = self.images;
        let rows = images.moved[0].nrows();
        let mean = |image: &Array2<f64>| {
            image.slice(ndarray::s![..rows, ..]).sum_axis(Axis(0)) / rows as f64
        };
        let middle = mean(&images.without);
        let slopes =
            images.moved.each_ref().map(|moved| (&mean(moved) - &middle) / images.moved_angstrom);
        let fisher = |a: usize, b: usize| -> f64 {
            let one = |n: usize| slopes[a][n] * slopes[b][n] / middle[n].max(f64::MIN_POSITIVE);
            dose * self.area * (0..middle.len()).map(one).sum::<f64>()
        };
        let [xx, xy, yy] = [fisher(0, 0), fisher(0, 1), fisher(1, 1)];
        let determinant = xx * yy - xy * xy;
        [yy, xx].map(|f| (f / determinant).sqrt())
    }
}

/// The annulus of whole rings with the lowest needed dose, and all rings weighed alone. `images` holds, for each ring, the images without
/// and with the defect.
pub fn annuli(
    request: &DetectabilityRequest,
    rings: &[Detector],
    images: &[[Array2<f64>; 2]],
    area: f64,
) -> Option<[AnnulusFound; 2]> {
    let (first, end, signal) = best_annulus(images, area)?;
    let each: Vec<DefectSignal> =
        images.iter().map(|[a, b]| DefectSignal::new([a.view(), b.view()], area)).collect();
    let found = |annulus_mrad: [f64; 2], information: f64, error: f64, means: [Vec<f64>; 2]| {
        let test = PoissonTest::new(&means[0], &means[1]);
        let needed = needed_known(request, (information, error), 0.0, |_| {
            test.needed_dose(request.power, request.false_alarms).unwrap_or(f64::INFINITY)
        });
        AnnulusFound {
            annulus_mrad,
            information_angstrom2: information,
            information_error_angstrom2: error,
            needed,
        }
    };
    let joined = |k: usize| each.iter().flat_map(|s| s.means[k].iter().copied()).collect();
    let all = DefectSignal::new(
        [0, 1]
            .map(|k| {
                let views: Vec<_> = images.iter().map(|ring| ring[k].view()).collect();
                ndarray::concatenate(Axis(1), &views).unwrap_or_default()
            })
            .each_ref()
            .map(|image| image.view()),
        area,
    );
    let best = [rings[first].inner_mrad, rings[end - 1].outer_mrad];
    let whole = [rings[0].inner_mrad, rings[rings.len() - 1].outer_mrad];
    Some([
        found(best, signal.information, signal.error, signal.means.clone()),
        found(whole, all.information, all.error, [joined(0), joined(1)]),
    ])
}

/// The dose for the power of the request with normal distributions.
fn normal_dose(request: &DetectabilityRequest, information: f64) -> f64 {
    let distance = normal_quantile(request.power) - normal_quantile(request.false_alarms);
    distance * distance / information.max(f64::MIN_POSITIVE)
}

/// The verdict on known images with an information and its error; `dose` finds the dose.
fn needed_known(
    request: &DetectabilityRequest,
    (information, error): (f64, f64),
    start: f64,
    dose: impl Fn(f64) -> f64,
) -> NeededDose {
    if information == 0.0 && error == 0.0 {
        return NeededDose::NEVER;
    }
    if information <= 2.0 * error {
        let most = information.max(0.0) + 2.0 * error;
        let least = normal_dose(request, most);
        return NeededDose {
            verdict: DoseVerdict::Unresolved,
            electrons_per_angstrom2: None,
            range: [Some(least), None],
        };
    }
    let dose = dose(start);
    let at = |information: f64, of: f64| Some(dose * information / of);
    NeededDose {
        verdict: DoseVerdict::Found,
        electrons_per_angstrom2: Some(dose),
        range: [at(information, information + error), at(information, information - error)],
    }
}

/// The dose `found` with the relative range of a known image.
fn scaled(known: NeededDose, found: f64) -> NeededDose {
    let factor = known.electrons_per_angstrom2.map_or(1.0, |dose| found / dose);
    NeededDose {
        verdict: DoseVerdict::Found,
        electrons_per_angstrom2: Some(found),
        range: known.range.map(|end| end.map(|dose| factor * dose)),
    }
}

/// The least dose at which a rising power is reached, near `start`, by bisection of its logarithm.
fn least_dose(power_at: impl Fn(f64) -> f64, power: f64, start: f64) -> f64 {
    let (mut low, mut high) = (libm::log(start / MOST_TIMES), libm::log(start * MOST_TIMES));
    for _ in 0..BISECTIONS {
        let middle = 0.5 * (low + high);
        match power_at(libm::exp(middle)) < power {
            true => low = middle,
            false => high = middle,
        }
    }
    libm::exp(0.5 * (low + high))
}

/// The mean of tests at depths that are known.
fn mean_power(tests: &[TestPower]) -> TestPower {
    if let [one] = tests {
        return one.clone();
    }
    let mean =
        |of: &dyn Fn(&TestPower) -> f64| tests.iter().map(of).sum::<f64>() / tests.len() as f64;
    let point = |n: usize| [tests[0].roc[n][0], mean(&|t| t.roc[n][1])];
    TestPower {
        d_prime: mean(&|t| t.d_prime * t.d_prime).sqrt(),
        auc: mean(&|t| t.auc),
        power: mean(&|t| t.power),
        average_precision: mean(&|t| t.average_precision),
        roc: (0..tests[0].roc.len()).map(point).collect(),
    }
}
