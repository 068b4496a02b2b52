//! Numbers of defects in a unit: the binomial distribution, and draws from it among the numbers that a pool has.

/// Returns the probability of each number of defects among `sites` independent sites.
pub(crate) fn binomial(sites: usize, rate: f64) -> Vec<f64> {
    binomial_until(sites, rate, 0.0)
}

/// Returns the probabilities up to a number after which all others together are less likely than `rest`.
fn binomial_until(sites: usize, rate: f64, rest: f64) -> Vec<f64> {
    if rate >= 1.0 {
        return (0..=sites).map(|n| f64::from(u8::from(n == sites))).collect();
    }
    let mut p = Vec::with_capacity(sites + 1);
    p.push(libm::pow(1.0 - rate, sites as f64));
    for n in 1..=sites {
        let last = p[n - 1];
        let next = last * rate / (1.0 - rate) * (sites - n + 1) as f64 / n as f64;
        p.push(next);
        // From here on each probability is less than half the one before.
        if next < 0.5 * rest && 2.0 * next < last {
            break;
        }
    }
    p
}

/// Returns the number at which a binomial distribution passes `u`. Its rate is chosen so that its mean is `sites` x `rate` when numbers
/// outside `limits` become the nearest limit; where that mean lies outside the limits, the rate is `rate`.
pub(crate) fn drawn_within(sites: usize, rate: f64, limits: [usize; 2], u: f64) -> usize {
    let plain = Binomial::new(sites, rate);
    let goal = sites as f64 * rate;
    if goal <= limits[0] as f64 || goal >= limits[1] as f64 {
        return plain.drawn(u);
    }
    if plain.mean_makes_negative(limits, goal, |mean| (mean - goal).abs() - 1e-4 * goal) {
        return plain.drawn(u);
    }
    // The number drawn grows with the rate: where both ends of a bracket give the same number, all rates between them do. The rate itself
    // is one end, and nearly always the other end is near.
    let (mut low, mut high) = ((0.0, 0), (1.0, sites));
    let (mut tried, mut step) = (plain, FIRST_STEP * rate);
    for _ in 0..=40 {
        let end = (tried.rate, tried.drawn(u));
        let below = tried.mean_makes_negative(limits, goal, |mean| mean - goal);
        if below {
            low = end
        } else {
            high = end
        }
        if low.1 == high.1 {
            return low.1;
        }
        // Once both ends are found, longer steps lead outside the bracket.
        let stepped = if low.0 >= rate { rate + step } else { rate - step };
        let inside = stepped > low.0 && stepped < high.0;
        step *= 4.0;
        tried = Binomial::new(sites, if inside { stepped } else { 0.5 * (low.0 + high.0) });
    }
    Binomial::new(sites, 0.5 * (low.0 + high.0)).drawn(u)
}

/// First step from the rate, in units of the rate, in the search for the rate that makes up for numbers that the pool lacks.
const FIRST_STEP: f64 = 0.02;

/// A binomial distribution that computes only as many probabilities as it needs.
struct Binomial {
    sites: usize,
    rate: f64,
    /// Probability of each number, without the unlikely ones.
    likely: Vec<f64>,
}

impl Binomial {
    fn new(sites: usize, rate: f64) -> Self {
        Binomial { sites, rate, likely: binomial_until(sites, rate, UNLIKELY) }
    }

    /// Returns the number at which the distribution passes `u`.
    fn drawn(&self, u: f64) -> usize {
        let whole = self.likely.len() > self.sites;
        let passed = passes(&self.likely, u)
            .or_else(|| (!whole).then(|| passes(&binomial(self.sites, self.rate), u)).flatten());
        passed.unwrap_or(self.sites)
    }

    /// Whether `of(mean)` is negative; the mean lies near `goal`, and numbers outside `limits` count as the nearest limit.
    fn mean_makes_negative(&self, limits: [usize; 2], goal: f64, of: impl Fn(f64) -> f64) -> bool {
        let value = |p: &[f64]| {
            let term = |(n, p): (usize, &f64)| n.clamp(limits[0], limits[1]) as f64 * p;
            of(p.iter().enumerate().map(term).sum::<f64>())
        };
        let likely = value(&self.likely);
        // The omitted probabilities change the mean by less than this.
        let doubt = 2.0 * UNLIKELY * limits[1] as f64 + 1e-12 * goal;
        match likely.abs() > doubt || self.likely.len() > self.sites {
            true => likely < 0.0,
            false => value(&binomial(self.sites, self.rate)) < 0.0,
        }
    }
}

/// Largest total probability of the numbers that are omitted at first.
const UNLIKELY: f64 = 1e-9;

/// Returns the number at which a distribution passes `u`, if it does.
fn passes(distribution: &[f64], u: f64) -> Option<usize> {
    let mut left = u;
    distribution.iter().position(|p| {
        left -= p;
        left < 0.0
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::{self, Purpose};

    #[test]
    fn probabilities_add_to_one() {
        for (sites, rate) in [(0, 0.3), (26, 0.0), (26, 0.25), (52, 1.0)] {
            assert!((binomial(sites, rate).iter().sum::<f64>() - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn what_is_left_out_decides_nothing() {
        let plainly = |sites: usize, rate: f64, limits: [usize; 2], u: f64| {
            let number = |p: &[f64]| passes(p, u).unwrap_or(sites);
            let mean = |p: &[f64]| {
                let term = |(n, p): (usize, &f64)| n.clamp(limits[0], limits[1]) as f64 * p;
                p.iter().enumerate().map(term).sum::<f64>()
            };
            let (goal, plain) = (sites as f64 * rate, binomial(sites, rate));
            let outside = goal <= limits[0] as f64 || goal >= limits[1] as f64;
            if outside || (mean(&plain) - goal).abs() < 1e-4 * goal {
                return number(&plain);
            }
            let [mut low, mut high] = [0.0, 1.0];
            for _ in 0..40 {
                let middle = 0.5 * (low + high);
                let below = mean(&binomial(sites, middle)) < goal;
                if below { low = middle } else { high = middle }
            }
            number(&binomial(sites, 0.5 * (low + high)))
        };
        for n in 0..20_000u64 {
            let [a, b, c, d] = [0, 1, 2, 3].map(|k| rng::uniform(5, Purpose::Defect, k, n));
            let sites = 1 + (a * 60.0) as usize;
            let first = (c * 3.0) as usize;
            let limits = [first, (first + 1 + (d * 8.0) as usize).min(sites)];
            let u = match n % 4 {
                0 => 1.0 - 1e-10 * d,
                _ => rng::uniform(5, Purpose::Defect, 4, n),
            };
            if limits[0] < limits[1] {
                let rate = b * b * b;
                let expected = plainly(sites, rate, limits, u);
                assert_eq!(drawn_within(sites, rate, limits, u), expected, "{sites} {rate}");
            }
        }
    }
}
