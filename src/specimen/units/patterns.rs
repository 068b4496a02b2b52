//! A finite pool of patterns for units: the sites of a unit that are defects.
//!
//! A specimen of 10^5 columns would hold nearly as many patterns of vacancies or guests, and each would have to be simulated. Instead the
//! number of defects in a unit is drawn from its binomial distribution at the local rate, and their sites are drawn from a pool of patterns
//! with that number. For a given number, all patterns are equally likely, in the pool as in a random alloy. So all statistics of single
//! sites and of numbers per column equal the statistics of independent sites; only the repetition of depth patterns differs.
//!
//! The pool is ordered as the library cells of the mosaic's library: bin of rates, library cell, lattice cell in it.

use std::borrow::Cow;
use std::sync::OnceLock;

use super::binomial::{binomial, drawn_within};
use crate::rng::{self, Purpose};
use crate::structure::lattice::gcd;

/// Rates of the bins of the pool. Units take the bin whose rate is nearest in its square root.
const RATES: [f64; 14] =
    [0.0, 0.004, 0.015, 0.04, 0.08, 0.14, 0.22, 0.30, 0.40, 0.50, 0.60, 0.70, 0.85, 1.0];
/// Numbers of defects that are less likely than this at all rates of a bin are not in the pool.
const LEAST_PROBABILITY: f64 = 3e-4;
/// In pools that would have no defect, one cell in this many has one.
const FEW_CELLS: usize = 4;
/// Seed of the patterns of the first library. All worlds have the same patterns, so that they share libraries.
const SEED: u64 = 0x5354_454d_504f_4f4c;
/// Makes the patterns of other libraries different.
const LIBRARY_SEED: u64 = 0xD134_2543_DE82_EF95;

/// Returns the bin of a rate; the first bin is for units without defects only.
pub(crate) fn bin_of(rate: f64) -> usize {
    let distance = |n: &usize| (RATES[*n].sqrt() - rate.max(0.0).sqrt()).abs();
    (usize::from(rate > 0.0)..RATES.len())
        .min_by(|a, b| distance(a).total_cmp(&distance(b)))
        .unwrap_or(0)
}

/// Returns all bins, the nearest to a rate (in its square root) first.
pub(crate) fn nearest_bins(rate: f64) -> Vec<usize> {
    let distance = |n: &usize| (RATES[*n].sqrt() - rate.max(0.0).sqrt()).abs();
    let mut bins: Vec<usize> = (0..RATES.len()).collect();
    bins.sort_by(|a, b| distance(a).total_cmp(&distance(b)));
    bins
}

/// Returns the rate of a bin.
pub(crate) fn rate_of(bin: usize) -> f64 {
    RATES[bin]
}

/// Returns the range of rates for which a bin is the nearest.
fn span(bin: usize) -> [f64; 2] {
    let middle = |a: f64, b: f64| (0.5 * (a.sqrt() + b.sqrt())).powi(2);
    let low = if bin == 0 { 0.0 } else { middle(RATES[bin - 1], RATES[bin]) };
    let high = RATES.get(bin + 1).map_or(1.0, |next| middle(RATES[bin], *next));
    [low, high]
}

/// The patterns of one kind of unit in one bin, one for each lattice cell of the bin's library cells.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct PatternTable {
    /// Defective sites of the unit in each cell, ascending.
    pub cells: Vec<Vec<u16>>,
    /// Cells by their number of defects.
    by_count: Vec<Vec<u32>>,
    /// The numbers of defects that occur, ascending.
    numbers: Vec<usize>,
}

impl PatternTable {
    /// Draws the patterns of units with `sites` sites, for `library_cells` library cells of `per_library_cell` lattice cells. `seed` is the
    /// library's, and `stream` distinguishes kinds of units. A larger pool begins with the library cells of a smaller one, so that worlds with
    /// different numbers of phonon configurations share them.
    pub(crate) fn new(
        sites: usize,
        bin: usize,
        [library_cells, per_library_cell]: [usize; 2],
        (seed, stream): (u64, u64),
    ) -> Self {
        let cells = library_cells * per_library_cell;
        let mut counts: Vec<usize> = (0..library_cells)
            .flat_map(|library_cell| counts(sites, bin, per_library_cell, library_cell))
            .collect();
        // A small pool of units with one or two sites would have no pattern with a defect.
        if bin > 0 && sites > 0 && counts.iter().all(|n| *n == 0) {
            counts.iter_mut().rev().step_by(FEW_CELLS).for_each(|n| *n = 1);
        }
        // The lattice cells of each library cell are in random order, so that neighbours are independent.
        let mut order: Vec<usize> = (0..cells).collect();
        let seed = SEED ^ seed.wrapping_mul(LIBRARY_SEED);
        let word = |n: u64, draw: u32| {
            rng::words(seed ^ stream.rotate_left(32), Purpose::Pool, draw, (bin as u64) << 32 | n)
        };
        order.sort_by_key(|&n| (n / per_library_cell, word(n as u64, 0), n));
        let mut patterns = vec![Vec::new(); cells];
        let mut by_count = vec![Vec::new(); sites + 1];
        // Patterns of one defect take each site once before any site twice.
        let first = (word(u64::from(u32::MAX), 1)[0] as usize) % sites.max(1);
        let mut singles = 0;
        for (cell, count) in order.into_iter().zip(counts) {
            patterns[cell] = match count {
                1 => {
                    singles += 1;
                    // A step that visits all sites, with distant sites in a row.
                    vec![((first + singles * stride(sites)) % sites) as u16]
                }
                _ => choose(sites, count, |n| word(cell as u64, 2 + n as u32)[0]),
            };
        }
        for (cell, pattern) in patterns.iter().enumerate() {
            by_count[pattern.len()].push(cell as u32);
        }
        let numbers = (0..=sites).filter(|n| !by_count[*n].is_empty()).collect();
        PatternTable { cells: patterns, by_count, numbers }
    }

    /// Draws a cell: the number of defects of its pattern is drawn at `rate` among the `allowed` sites, and all defects lie on allowed
    /// sites; `u` are uniform numbers. `None` when the pool has no such pattern, or its numbers of defects do not reach as far as `spread`
    /// standard deviations about the mean.
    ///
    /// A number that the pool lacks is replaced by one of the nearest numbers that it has, with the same mean; where the pool ends early,
    /// the rate of the binomial distribution makes up for it.
    pub(crate) fn draw(
        &self,
        rate: f64,
        allowed: &[bool],
        spread: f64,
        u: [f64; 3],
    ) -> Option<usize> {
        let open = allowed.iter().filter(|a| **a).count();
        let all = open == allowed.len();
        let fits =
            |cell: &&u32| all || self.cells[**cell as usize].iter().all(|s| allowed[*s as usize]);
        let there = |n: &&usize| **n <= open && self.by_count[**n].iter().any(|c| fits(&c));
        let fitting = || self.numbers.iter().filter(there).copied().collect();
        let numbers: Cow<[usize]> = if all { (&self.numbers).into() } else { fitting() };
        let (first, last) = (*numbers.first()?, *numbers.last()?);
        let (mean, variance) = (open as f64 * rate, open as f64 * rate * (1.0 - rate));
        let reach = spread * variance.sqrt();
        let (least, most) = ((mean - reach).max(0.0), (mean + reach).min(open as f64));
        if (first as f64) > least.ceil() || (last as f64) < most.floor() || mean > last as f64 {
            return None;
        }
        let count = drawn_within(open, rate, [first, last], u[0]).clamp(first, last);
        let above = numbers.partition_point(|n| *n < count);
        let (low, high) =
            (numbers[above.saturating_sub(usize::from(numbers[above] != count))], numbers[above]);
        let share = (count - low) as f64 / (high - low).max(1) as f64;
        let number = if u[2] < share { high } else { low };
        let cells = &self.by_count[number];
        let fitting = || cells.iter().filter(fits).copied().collect();
        let cells: Cow<[u32]> = if all { cells.into() } else { fitting() };
        cells.get((u[1] * cells.len() as f64) as usize).map(|c| *c as usize)
    }

    /// Draws a cell with exactly these defects (ascending), if the pool has any; `u` is a uniform number.
    pub(crate) fn find(&self, defects: &[u16], u: f64) -> Option<usize> {
        let same = |c: &&u32| self.cells[**c as usize] == defects;
        let cells: Vec<u32> =
            self.by_count.get(defects.len())?.iter().filter(same).copied().collect();
        cells.get((u * cells.len() as f64) as usize).map(|c| *c as usize)
    }

    /// Draws a cell with as many defects as `wanted`: with the most defects on `allowed` sites, and among these with the most defects on
    /// the sites of `wanted`. `u` is a uniform number. `None` if the pool has no pattern of that number.
    pub(crate) fn nearest(&self, wanted: &[u16], allowed: &[bool], u: f64) -> Option<usize> {
        let alike = |cell: u32| {
            let sites = || self.cells[cell as usize].iter();
            let inside = sites().filter(|site| allowed[usize::from(**site)]).count();
            (inside, sites().filter(|site| wanted.contains(site)).count())
        };
        let cells = self.by_count.get(wanted.len())?;
        let most = cells.iter().map(|cell| alike(*cell)).max()?;
        let best: Vec<u32> = cells.iter().copied().filter(|cell| alike(*cell) == most).collect();
        best.get((u * best.len() as f64) as usize).map(|c| *c as usize)
    }
}

/// The patterns of several kinds of units, made on first use.
#[derive(Debug, Default)]
pub(crate) struct DefectPatterns {
    /// Number of sites of each kind of unit that may be defects.
    sites: Vec<usize>,
    /// Number of library cells, and of lattice cells in each.
    layout: [usize; 2],
    /// Seed of the library (`phonons.library_seed`).
    seed: u64,
    stream: u64,
    tables: Vec<OnceLock<PatternTable>>,
}

impl DefectPatterns {
    /// Prepares a pool of patterns for each bin and kind of unit; `layout` is the number of library cells, and of lattice cells in each,
    /// `seed` the library's seed.
    pub(crate) fn new(sites: Vec<usize>, layout: [usize; 2], (seed, stream): (u64, u64)) -> Self {
        let tables = (0..sites.len() * RATES.len()).map(|_| OnceLock::new()).collect();
        DefectPatterns { sites, layout, seed, stream, tables }
    }

    /// Returns the patterns of a kind of unit in a bin.
    pub(crate) fn patterns(&self, kind: usize, bin: usize) -> &PatternTable {
        self.tables[kind * RATES.len() + bin].get_or_init(|| {
            let stream = self.stream << 16 | kind as u64;
            PatternTable::new(self.sites[kind], bin, self.layout, (self.seed, stream))
        })
    }

    /// Returns the seed of the library.
    pub(crate) fn seed(&self) -> u64 {
        self.seed
    }

    /// Returns the number of sites of a kind of unit that may be defects.
    pub(crate) fn sites(&self, kind: usize) -> usize {
        self.sites[kind]
    }

    /// Returns the number of patterns of each bin and kind.
    pub(crate) fn cells(&self) -> usize {
        self.layout[0] * self.layout[1]
    }

    /// Draws the contents of a unit: the cell of its pattern in the bin.
    pub(crate) fn draw(
        &self,
        kind: usize,
        bin: usize,
        rate: f64,
        allowed: &[bool],
        spread: f64,
        unit: UnitSeed,
    ) -> Option<usize> {
        let draws = [0, 1, 2].map(|draw| unit.uniform(draw));
        self.patterns(kind, bin).draw(rate, allowed, spread, draws)
    }

    /// Draws a cell of the bin with the defects (ascending) of a unit, if there is one.
    pub(crate) fn find(
        &self,
        kind: usize,
        bin: usize,
        defects: &[u16],
        unit: UnitSeed,
    ) -> Option<usize> {
        self.patterns(kind, bin).find(defects, unit.uniform(1))
    }

    /// Draws a cell with as many defects as `wanted` (see [`PatternTable::nearest`]).
    pub(crate) fn nearest(
        &self,
        kind: usize,
        bin: usize,
        (wanted, allowed): (&[u16], &[bool]),
        unit: UnitSeed,
    ) -> Option<usize> {
        self.patterns(kind, bin).nearest(wanted, allowed, unit.uniform(1))
    }
}

/// A unit of a specimen, which decides its random draws.
#[derive(Debug, Clone, Copy)]
pub(crate) struct UnitSeed {
    /// Seed of the specimen.
    pub seed: u64,
    /// Number of the unit.
    pub id: u64,
}

impl UnitSeed {
    fn uniform(self, draw: u32) -> f64 {
        rng::uniform(self.seed, Purpose::Pool, draw, self.id)
    }
}

/// Returns a step that visits all sites.
fn stride(sites: usize) -> usize {
    (sites * 3 / 8 + 1..).find(|s| gcd(*s, sites) == 1).unwrap_or(1)
}

/// Returns the numbers of defects for the lattice cells of a library cell. Their shares grow with the root of the probability within the
/// bin, so that rare numbers have several patterns too.
fn counts(sites: usize, bin: usize, cells: usize, library_cell: usize) -> Vec<usize> {
    let [low, high] = span(bin);
    let tables = [low, RATES[bin], high].map(|rate| binomial(sites, rate));
    let likely = |n: usize| tables.iter().map(|t| t[n]).fold(0.0, f64::max);
    let weight = |n: usize| match likely(n) {
        p if p < LEAST_PROBABILITY => 0.0,
        p => p.sqrt(),
    };
    let weights: Vec<f64> = (0..=sites).map(weight).collect();
    let total: f64 = weights.iter().sum();
    // Cell c takes the number at the quantile (c + offset) / cells; the offsets of all library cells are spread evenly over the steps.
    let offset = halved(library_cell);
    let mut out = Vec::with_capacity(cells);
    let (mut number, mut below) = (0, weights[0]);
    for cell in 0..cells {
        let at = (cell as f64 + offset) / cells as f64 * total;
        while at > below && number < sites {
            number += 1;
            below += weights[number];
        }
        out.push(number);
    }
    out
}

/// Returns item `n` of the sequence 1/2, 1/4, 3/4, 1/8, 5/8, ..., whose first items always fill the unit interval evenly.
fn halved(n: usize) -> f64 {
    let digits = (0..usize::BITS).filter(|bit| (n + 1) >> bit & 1 == 1);
    digits.map(|bit| libm::exp2(-f64::from(bit + 1))).sum()
}

/// Draws `count` of `sites` sites, all choices equally likely, ascending.
fn choose(sites: usize, count: usize, word: impl Fn(usize) -> u32) -> Vec<u16> {
    let mut all: Vec<u16> = (0..sites as u16).collect();
    for n in 0..count {
        let left = sites - n;
        let pick = n + ((u64::from(word(n)) * left as u64) >> 32) as usize;
        all.swap(n, pick);
    }
    all.truncate(count);
    all.sort_unstable();
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bins_cover_all_rates() {
        assert_eq!([0.0, 0.0005, 0.01, 0.1, 1.0].map(bin_of), [0, 1, 2, 4, 13]);
        for bin in 0..RATES.len() {
            assert_eq!(bin_of(RATES[bin]), bin);
            let [low, high] = span(bin);
            assert!(low <= RATES[bin] && RATES[bin] <= high);
        }
    }

    #[test]
    fn draws_have_the_binomial_mean_and_variance_and_use_all_sites() {
        let (sites, n) = (26, 40_000);
        for rate in [0.0, 0.01, 0.05, 0.12, 0.25] {
            let patterns = PatternTable::new(sites, bin_of(rate), [4, 36], (0, 3));
            let u = |k: u32, i: u64| rng::uniform(9, Purpose::Defect, k, i);
            let mut hits = vec![0.0; sites];
            let (mut sum, mut square) = (0.0, 0.0);
            for i in 0..n {
                let cell =
                    patterns.draw(rate, &[true; 26], 2.0, [u(0, i), u(1, i), u(2, i)]).unwrap();
                let pattern = &patterns.cells[cell];
                pattern.iter().for_each(|s| hits[*s as usize] += 1.0 / n as f64);
                sum += pattern.len() as f64 / n as f64;
                square += (pattern.len() * pattern.len()) as f64 / n as f64;
            }
            let variance = sites as f64 * rate * (1.0 - rate);
            assert!(
                (sum - sites as f64 * rate).abs()
                    <= 4.0 * (variance / n as f64).sqrt() + 1e-4 * sum
            );
            assert!((square - sum * sum - variance).abs() < 0.05 * variance + 1e-9, "{rate}");
            if rate >= 0.01 {
                assert!(hits.iter().all(|h| *h > 0.2 * rate && *h < 2.5 * rate), "{hits:?}");
            }
        }
    }

    #[test]
    fn small_pools_have_the_right_mean_too() {
        for (rate, cells) in [(0.022, [1, 4]), (0.09, [2, 2]), (0.25, [1, 6])] {
            let patterns = PatternTable::new(26, bin_of(rate), cells, (0, 5));
            let n = 60_000;
            let number = |i: u64| {
                let u = |k| rng::uniform(8, Purpose::Defect, k, i);
                patterns.cells[patterns.draw(rate, &[true; 26], 0.0, [u(0), u(1), u(2)]).unwrap()]
                    .len()
            };
            let mean = (0..n).map(|i| number(i) as f64).sum::<f64>() / n as f64;
            let error = 4.0 * (26.0 * rate / n as f64).sqrt();
            assert!((mean - 26.0 * rate).abs() < error, "{rate}: {mean} of {}", 26.0 * rate);
        }
    }

    #[test]
    fn more_library_cells_begin_with_those_of_fewer() {
        for rate in [0.01, 0.12] {
            let few = PatternTable::new(26, bin_of(rate), [2, 25], (0, 3));
            let more = PatternTable::new(26, bin_of(rate), [5, 25], (0, 3));
            assert_eq!(few.cells, more.cells[..50]);
            assert_ne!(more.cells[..25], more.cells[25..50]);
        }
        assert_eq!([0, 1, 2, 3, 4].map(halved), [0.5, 0.25, 0.75, 0.125, 0.625]);
    }

    #[test]
    fn the_nearest_pattern_has_the_number_and_few_sites_beside_the_allowed() {
        let patterns = PatternTable::new(20, bin_of(0.15), [8, 25], (0, 1));
        let allowed: Vec<bool> = (0..20).map(|s| s < 6).collect();
        let inside = |cell: usize| patterns.cells[cell].iter().filter(|s| **s < 6).count();
        let wanted = [1, 2, 4];
        let of_three: Vec<usize> =
            (0..200).filter(|n| patterns.cells[*n].len() == wanted.len()).collect();
        let most = of_three.iter().map(|n| inside(*n)).max().unwrap();
        assert!(most < 3, "the pool has none that fits");
        for u in [0.0, 0.3, 0.7, 0.999] {
            let found = patterns.nearest(&wanted, &allowed, u).unwrap();
            assert!(of_three.contains(&found) && inside(found) == most);
        }
        // The pattern itself, if it is there.
        let there = patterns.cells[of_three[0]].clone();
        let all = [true; 20];
        assert_eq!(patterns.cells[patterns.nearest(&there, &all, 0.5).unwrap()], there);
        assert_eq!(patterns.nearest(&[0; 20], &all, 0.5), None);
    }

    #[test]
    fn another_library_has_the_same_numbers_of_defects_at_other_depths() {
        for bin in [2, 5] {
            let [one, two] = [0, 1].map(|seed| PatternTable::new(26, bin, [8, 25], (seed, 3)));
            let numbers = |table: &PatternTable| -> Vec<usize> {
                table.by_count.iter().map(Vec::len).collect()
            };
            assert_eq!(numbers(&one), numbers(&two));
            let same = one.cells.iter().zip(&two.cells).filter(|(a, b)| a == b).count();
            // Cells without defects are alike in both.
            assert!(same < 100 + one.by_count[0].len(), "{same}");
            assert_ne!(one.cells, two.cells);
        }
    }

    #[test]
    fn only_allowed_sites_are_taken() {
        let patterns = PatternTable::new(20, bin_of(0.15), [8, 25], (0, 1));
        let allowed: Vec<bool> = (0..20).map(|s| s < 9).collect();
        let mut found = 0;
        for i in 0..500 {
            let u = |k| rng::uniform(4, Purpose::Defect, k, i);
            if let Some(cell) = patterns.draw(0.15, &allowed, 1.0, [u(0), u(1), u(2)]) {
                assert!(patterns.cells[cell].iter().all(|s| *s < 9));
                found += 1;
            }
        }
        assert!(found > 400, "{found}");
    }
}
