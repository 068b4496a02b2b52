//! Explanations of the difference of two images: a factor, another orientation, a shift of the scan.
//!
//! Images are row = y, column = x. With a shift `d` (x, y, in pixels) the reference at pixel `i` equals our image at `i + d`: its scan
//! began `d` further than ours. Our image must extend beyond the reference by the largest shift that is to be found. Whole pixels come from
//! the correlation of the two images, with their brightness fitted; fractions come from interpolation. Interpolation of coarse scans is
//! inexact, so a shift that matters should be simulated, as [`super::image_comparison`] does.

use std::sync::Arc;

use ndarray::{Array2, ArrayView2, Axis, s};
use num_complex::Complex64;
use rustfft::{Fft, FftPlanner};

use super::difference::{Difference, best_gain};

/// A further change is accepted if it makes the difference smaller by this factor.
pub(crate) const MUCH_BETTER: f64 = 3.0;
/// Last step of the search for a shift, in pixels.
const FINEST: f64 = 1.0 / 256.0;
/// Shifts whose fault is at most this multiple of the best fault count as equally good: crystals repeat.
const AS_GOOD: f64 = 1.2;
/// Number of matches by whole pixels that are refined.
const LOOKED_AT: usize = 6;
/// Rms difference, as a fraction of the mean, that needs no further explanation.
const ENOUGH: f64 = 2e-3;

/// Orientation of the pixels of a reference, applied before any other change.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Turn {
    transposed: bool,
    /// Whether the image is mirrored along x and along y.
    mirrored: [bool; 2],
}

impl Turn {
    /// Returns all orientations but the original one; transpositions only for square images, whose shape they keep.
    fn others(square: bool) -> impl Iterator<Item = Turn> {
        let all = (1..8_u8).map(|bits| Turn {
            transposed: bits & 4 != 0,
            mirrored: [bits & 1 != 0, bits & 2 != 0],
        });
        all.filter(move |turn| square || !turn.transposed)
    }

    /// Returns the image in this orientation.
    pub(crate) fn apply(self, image: &Array2<f64>) -> Array2<f64> {
        let mut view = if self.transposed { image.t() } else { image.view() };
        for (axis, mirrored) in [(1, self.mirrored[0]), (0, self.mirrored[1])] {
            if mirrored {
                view.invert_axis(Axis(axis));
            }
        }
        view.as_standard_layout().to_owned()
    }

    fn name(self) -> &'static str {
        match (self.transposed, self.mirrored) {
            (false, [false, false]) => "unchanged",
            (false, [true, false]) => "mirrored along x",
            (false, [false, true]) => "mirrored along y",
            (false, [true, true]) => "turned by 180 degrees",
            (true, [false, false]) => "transposed (x and y exchanged)",
            (true, [true, true]) => "mirrored about the falling diagonal",
            (true, _) => "turned by 90 degrees",
        }
    }
}

/// A change that brings a reference nearer to our image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Explanation {
    /// Orientation of the reference.
    pub turn: Turn,
    /// Shift of the reference's scan, (x, y) in pixels, if a shift was searched.
    pub shift: Option<[f64; 2]>,
    /// Factor that multiplies the reference, if it was fitted.
    pub factor: Option<f64>,
    /// Rms difference that is left, divided by the mean of the reference.
    pub rms: f64,
}

impl Explanation {
    /// Describes the change in words, with pixels of `step` (x, y) in Angstrom.
    pub(crate) fn words(&self, step: [f64; 2]) -> String {
        let mut words = Vec::new();
        if self.turn != Turn::default() {
            words.push(format!("the reference {}", self.turn.name()));
        }
        if let Some([x, y]) = self.shift {
            let (x, y) = (x * step[0], y * step[1]);
            words.push(format!("a scan that starts {x:.3}, {y:.3} A further along x, y"));
        }
        if let Some(factor) = self.factor {
            words.push(format!("the reference times {factor:.4}"));
        }
        words.join(" and ")
    }
}

/// The changes that were tried.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Explanations {
    /// Rms difference without a change, divided by the mean of the reference.
    pub now: f64,
    /// The best change of each single kind: factor, orientation, shift. Orientation is missing if none can be tried.
    pub alone: Vec<Explanation>,
    /// The simplest change after which no other helps much; `None` if no change does.
    pub best: Option<Explanation>,
}

/// Our image, which extends beyond the reference on each side.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct WideImage {
    /// The values.
    pub data: Array2<f64>,
    /// Number of pixels (x, y) beyond the reference on each side.
    pub margin: [usize; 2],
}

impl WideImage {
    /// Returns the part at the place of the reference.
    pub(crate) fn inner(&self) -> Array2<f64> {
        let [x, y] = self.margin;
        let (rows, columns) = self.data.dim();
        self.data.slice(s![y..rows - y, x..columns - x]).to_owned()
    }
}

/// Tries factors, orientations, and shifts up to the margin of our image.
pub(crate) fn explanations(wide: &WideImage, reference: &Array2<f64>) -> Explanations {
    let ours = &wide.inner();
    let now = rms(ours, reference);
    let plain = Turn::default();
    let mut turned: Vec<_> =
        Turn::others(reference.is_square()).map(|turn| (turn, turn.apply(reference))).collect();
    turned.sort_by(|a, b| rms(ours, &a.1).total_cmp(&rms(ours, &b.1)));
    let at_place = |turn, reference: &Array2<f64>| Explanation {
        turn,
        shift: None,
        factor: None,
        rms: rms(ours, reference),
    };
    let shifted = Matcher::new(wide);
    let mut tried = vec![fitted(ours, reference, plain)];
    tried.extend(turned.first().map(|(turn, image)| at_place(*turn, image)));
    tried.push(shifted.explanation(plain, reference, false));
    let alone = tried.clone();
    tried.push(shifted.explanation(plain, reference, true));
    tried.extend(turned.first().map(|(turn, image)| fitted(ours, image, *turn)));
    tried.extend(turned.iter().map(|(turn, image)| shifted.explanation(*turn, image, false)));
    tried.extend(turned.iter().map(|(turn, image)| shifted.explanation(*turn, image, true)));
    let mut best: Option<Explanation> = None;
    for next in tried {
        let left = best.map_or(now, |b| b.rms);
        if left > ENOUGH && next.rms < left / MUCH_BETTER {
            best = Some(next);
        }
    }
    Explanations { now, alone, best }
}

/// Returns shifts (x, y) in pixels at which the reference may lie, the best first: crystals nearly repeat, so there are several.
pub(crate) fn likely_shifts(wide: &WideImage, reference: &Array2<f64>) -> Vec<[f64; 2]> {
    Matcher::new(wide).likely(reference)
}

fn rms(ours: &Array2<f64>, reference: &Array2<f64>) -> f64 {
    Difference::between(ours.view(), reference.view()).rms
}

/// Fits a factor to the reference.
fn fitted(ours: &Array2<f64>, reference: &Array2<f64>, turn: Turn) -> Explanation {
    let factor = best_gain(reference.view(), ours.view());
    Explanation { turn, shift: None, factor: Some(factor), rms: rms(ours, &(reference * factor)) }
}

/// Finds references in our image.
struct Matcher<'a> {
    wide: &'a WideImage,
    fourier: Fourier,
    spectrum: Array2<Complex64>,
}

/// Sums over the pixels of the reference: squares of our image, products, squares of the reference.
#[derive(Default)]
struct Shared {
    ours: f64,
    both: f64,
    reference: f64,
}

impl Shared {
    /// Returns the share of power that remains different after the best factor.
    fn fault(&self) -> f64 {
        let fault = 1.0 - self.both * self.both / (self.ours * self.reference);
        if fault.is_finite() { fault.max(0.0) } else { f64::INFINITY }
    }
}

impl<'a> Matcher<'a> {
    fn new(wide: &'a WideImage) -> Self {
        let (rows, columns) = wide.data.dim();
        let fourier = Fourier::new([rows, columns]);
        let spectrum = fourier.forward(wide.data.view());
        Matcher { wide, fourier, spectrum }
    }

    /// Finds the best shift, with or without a factor.
    fn explanation(&self, turn: Turn, reference: &Array2<f64>, fit: bool) -> Explanation {
        let shift = self.likely(reference).first().copied().unwrap_or_default();
        let sums = self.sums(reference, shift);
        let factor = if fit { sums.both / sums.reference } else { 1.0 };
        let square = sums.ours - 2.0 * factor * sums.both + factor * factor * sums.reference;
        let mean = reference.mean().unwrap_or(f64::NAN).abs() * factor.abs();
        Explanation {
            turn,
            shift: Some(shift),
            factor: fit.then_some(factor),
            rms: (square.max(0.0) / reference.len() as f64).sqrt() / mean,
        }
    }

    /// Returns shifts with the least fault in their surroundings, the best first; equally good ones by their size, the smallest first.
    fn likely(&self, reference: &Array2<f64>) -> Vec<[f64; 2]> {
        let near = self.whole_pixels(reference);
        let mut found: Vec<_> = near.into_iter().map(|at| self.refined(reference, at)).collect();
        let least = found.iter().fold(f64::INFINITY, |least, f| least.min(f.0));
        let size = |d: [f64; 2]| d[0].hypot(d[1]);
        let rank = |fault: f64| if fault <= AS_GOOD * least + 1e-9 { 0.0 } else { fault };
        found.sort_by(|a, b| rank(a.0).total_cmp(&rank(b.0)).then(size(a.1).total_cmp(&size(b.1))));
        found.into_iter().map(|f| f.1).collect()
    }

    /// Returns shifts by whole pixels (x, y) that are better than their neighbours, the best first.
    fn whole_pixels(&self, reference: &Array2<f64>) -> Vec<[i64; 2]> {
        let both = self.fourier.correlation(&self.spectrum, reference.view());
        let squares = Squares::new(&self.wide.data);
        let power: f64 = reference.iter().map(|v| v * v).sum();
        let [mx, my] = self.wide.margin;
        let (rows, columns) = reference.dim();
        let fault = Array2::from_shape_fn((2 * my + 1, 2 * mx + 1), |(y, x)| {
            let ours = squares.sum([y, y + rows], [x, x + columns]);
            Shared { ours, reference: power, both: both[[y, x]] }.fault()
        });
        let lowest = |y: usize, x: usize| {
            let rows = y.saturating_sub(1)..(y + 2).min(2 * my + 1);
            let columns = x.saturating_sub(1)..(x + 2).min(2 * mx + 1);
            fault.slice(s![rows, columns]).iter().all(|v| *v >= fault[[y, x]])
        };
        let mut found: Vec<_> = fault.indexed_iter().filter(|((y, x), _)| lowest(*y, *x)).collect();
        let size = |(y, x): (usize, usize)| y.abs_diff(my).pow(2) + x.abs_diff(mx).pow(2);
        found.sort_by(|a, b| a.1.total_cmp(b.1).then(size(a.0).cmp(&size(b.0))));
        let shift =
            |((y, x), _): ((usize, usize), &f64)| [x as i64 - mx as i64, y as i64 - my as i64];
        found.into_iter().take(LOOKED_AT).map(shift).collect()
    }

    /// Searches about a whole number of pixels with ever smaller steps; returns the least fault and its shift.
    fn refined(&self, reference: &Array2<f64>, start: [i64; 2]) -> (f64, [f64; 2]) {
        let start = start.map(|v| v as f64);
        let within = |at: [f64; 2]| {
            (0..2).all(|i| {
                (at[i] - start[i]).abs() <= 1.0 && at[i].abs() <= self.wide.margin[i] as f64
            })
        };
        let mut at = start;
        let mut least = self.sums(reference, at).fault();
        let mut step = 0.5;
        while step >= FINEST {
            let mut better = None;
            for [x, y] in [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]] {
                let next = [at[0] + step * x, at[1] + step * y];
                if !within(next) {
                    continue;
                }
                let found = self.sums(reference, next).fault();
                // A difference within rounding is no improvement.
                if found < least - 1e-13 {
                    (least, better) = (found, Some(next));
                }
            }
            match better {
                Some(next) => at = next,
                None => step *= 0.5,
            }
        }
        (least, at)
    }

    /// Computes the sums with our image interpolated at a shift (x, y) within the margin.
    fn sums(&self, reference: &Array2<f64>, shift: [f64; 2]) -> Shared {
        let (rows, columns) = reference.dim();
        let [mx, my] = self.wide.margin;
        let across: Vec<_> =
            (0..columns).map(|i| taps((i + mx) as f64 + shift[0], columns + 2 * mx)).collect();
        let mut sums = Shared::default();
        for (row, values) in reference.outer_iter().enumerate() {
            let down = taps((row + my) as f64 + shift[1], rows + 2 * my);
            for (taps, reference) in across.iter().zip(values) {
                let mut ours = 0.0;
                for (y, v) in &down {
                    for (x, u) in taps {
                        ours += v * u * self.wide.data[[*y, *x]];
                    }
                }
                sums.ours += ours * ours;
                sums.both += ours * reference;
                sums.reference += reference * reference;
            }
        }
        sums
    }
}

/// Returns the pixels, of `n`, and the weights from which the value at a position is interpolated.
fn taps(position: f64, n: usize) -> [(usize, f64); 4] {
    let first = position.floor();
    let t = position - first;
    // Cubic convolution of R. G. Keys, a = -1/2.
    let weights = [
        -0.5 * t + t * t - 0.5 * t * t * t,
        1.0 - 2.5 * t * t + 1.5 * t * t * t,
        0.5 * t + 2.0 * t * t - 1.5 * t * t * t,
        -0.5 * t * t + 0.5 * t * t * t,
    ];
    let place = |k: usize| (first as i64 - 1 + k as i64).clamp(0, n as i64 - 1) as usize;
    [0, 1, 2, 3].map(|k| (place(k), weights[k]))
}

/// Sums of squares over rectangles.
struct Squares(Array2<f64>);

impl Squares {
    fn new(image: &Array2<f64>) -> Self {
        let (rows, columns) = image.dim();
        let mut sums = Array2::zeros((rows + 1, columns + 1));
        for y in 0..rows {
            for x in 0..columns {
                let value = image[[y, x]].powi(2);
                sums[[y + 1, x + 1]] = value + sums[[y, x + 1]] + sums[[y + 1, x]] - sums[[y, x]];
            }
        }
        Squares(sums)
    }

    fn sum(&self, y: [usize; 2], x: [usize; 2]) -> f64 {
        let s = &self.0;
        s[[y[1], x[1]]] - s[[y[0], x[1]]] - s[[y[1], x[0]]] + s[[y[0], x[0]]]
    }
}

/// Fourier transforms of arrays of one shape, in double precision.
struct Fourier {
    shape: [usize; 2],
    forward: [Arc<dyn Fft<f64>>; 2],
    inverse: [Arc<dyn Fft<f64>>; 2],
}

impl Fourier {
    fn new(shape: [usize; 2]) -> Self {
        let mut planner = FftPlanner::new();
        let forward = shape.map(|n| planner.plan_fft_forward(n));
        let inverse = shape.map(|n| planner.plan_fft_inverse(n));
        Fourier { shape, forward, inverse }
    }

    /// Transforms an image that is padded with zeros.
    fn forward(&self, image: ArrayView2<f64>) -> Array2<Complex64> {
        let mut out = Array2::zeros(self.shape);
        let (rows, columns) = image.dim();
        out.slice_mut(s![..rows, ..columns]).assign(&image.mapv(Complex64::from));
        transform(out, &self.forward)
    }

    /// Computes `sum over i of ours[i + shift] reference[i]` at each shift.
    fn correlation(&self, ours: &Array2<Complex64>, reference: ArrayView2<f64>) -> Array2<f64> {
        let mut product = self.forward(reference);
        product.zip_mut_with(ours, |r, o| *r = r.conj() * o);
        let scale = 1.0 / product.len() as f64;
        transform(product, &self.inverse).mapv(|v| v.re * scale)
    }
}

fn transform(array: Array2<Complex64>, plans: &[Arc<dyn Fft<f64>>; 2]) -> Array2<Complex64> {
    let mut rows = array;
    rows.outer_iter_mut().for_each(|mut row| plans[1].process(row.as_slice_mut().expect("rows")));
    let mut columns = rows.t().as_standard_layout().to_owned();
    columns
        .outer_iter_mut()
        .for_each(|mut column| plans[0].process(column.as_slice_mut().expect("columns")));
    columns.t().as_standard_layout().to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An image of some waves without symmetry, at pixels from `start`.
    fn image((rows, columns): (usize, usize), start: [f64; 2]) -> Array2<f64> {
        Array2::from_shape_fn((rows, columns), |(y, x)| {
            let (x, y) = (x as f64 + start[0], y as f64 + start[1]);
            let wave = |h: f64, k: f64, phase: f64| {
                (std::f64::consts::TAU * (h * x / 24.0 + k * y / 20.0) + phase).cos()
            };
            2.0 + wave(1.0, 0.0, 0.3) + 0.7 * wave(1.0, 2.0, 1.0) + 0.4 * wave(-2.0, 1.0, 2.0)
        })
    }

    /// Our image with a margin of five pixels.
    fn wide((rows, columns): (usize, usize)) -> WideImage {
        WideImage { data: image((rows + 10, columns + 10), [-5.0; 2]), margin: [5; 2] }
    }

    #[test]
    fn a_shift_of_no_whole_pixel_is_found() {
        for shape in [(20, 24), (12, 15)] {
            for shift in [[3.3, -2.6], [0.4, 0.2], [-0.25, 4.5]] {
                let reference = image(shape, shift) * 1.3;
                let found = explanations(&wide(shape), &reference);
                let best = found.best.unwrap();
                let at = best.shift.unwrap();
                assert!((0..2).all(|i| (at[i] - shift[i]).abs() < 0.05), "{shift:?} {best:?}");
                assert!((best.factor.unwrap() * 1.3 - 1.0).abs() < 0.01, "{best:?}");
                assert!(best.rms < 0.01 && found.now > 0.2, "{shift:?} {best:?}");
            }
        }
    }

    #[test]
    fn the_simplest_explanation_is_taken() {
        let ours = image((18, 18), [0.0; 2]);
        let of = |reference: &Array2<f64>| {
            let found = explanations(&wide((18, 18)), reference);
            assert_eq!(found.alone.len(), 3);
            found.best.map(|b| b.words([1.0; 2]))
        };
        assert_eq!(of(&ours), None);
        assert_eq!(of(&(&ours * 0.5)).unwrap(), "the reference times 2.0000");
        let transposed = "the reference transposed (x and y exchanged)";
        // A small remaining difference is not explained further.
        let noise = |(y, x): (usize, usize)| 1.0 + 1e-3 * ((7 * x + 5 * y) % 3) as f64;
        let noisy = Array2::from_shape_fn((18, 18), noise) * ours.t();
        assert_eq!(of(&noisy).unwrap(), transposed);
        let mirrored = ours.slice(s![..;-1, ..]).to_owned();
        assert_eq!(of(&mirrored).unwrap(), "the reference mirrored along y");
        let moved = of(&image((18, 18), [2.0, 0.0])).unwrap();
        assert_eq!(moved, "a scan that starts 2.000, 0.000 A further along x, y");
        // A completely different image.
        let other = Array2::from_shape_fn((18, 18), |(y, x)| ((7 * x * x + 3 * y) % 11) as f64);
        assert_eq!(of(&other), None);
    }

    #[test]
    fn a_crystal_is_moved_by_no_more_than_its_period() {
        let crystal = |n: usize, start: f64| {
            Array2::from_shape_fn((n, n), |(y, x)| {
                let wave = |v: f64| (std::f64::consts::TAU * v / 6.0).cos();
                1.0 + wave(x as f64 + start) * wave(y as f64 + 6.0)
            })
        };
        let ours = WideImage { data: crystal(42, 0.0), margin: [6; 2] };
        // A crystal that equals its mirror image may also be found mirrored, so only the shift is checked.
        let shift = explanations(&ours, &crystal(30, 1.0)).alone[2].shift.unwrap();
        assert!((shift[0] - 1.0).abs() < 0.02 && shift[1].abs() < 0.02, "{shift:?}");
        let likely = likely_shifts(&ours, &crystal(30, 1.0));
        assert!(likely.iter().any(|s| (s[0] + 5.0).abs() < 0.02), "{likely:?}");
    }

    #[test]
    fn lines_points_and_flat_images_have_an_answer() {
        let line = WideImage { data: image((1, 30), [-3.0, 0.0]), margin: [3, 0] };
        let shift = explanations(&line, &image((1, 24), [1.5, 0.0])).best.unwrap().shift.unwrap();
        assert!((shift[0] - 1.5).abs() < 0.05 && shift[1] == 0.0, "{shift:?}");
        for shape in [(1, 1), (4, 4)] {
            let ours =
                |value: f64| WideImage { data: Array2::from_elem(shape, value), margin: [0; 2] };
            assert_eq!(explanations(&ours(1.0), &Array2::ones(shape)).best, None);
            explanations(&ours(0.0), &Array2::ones(shape));
        }
    }
}
