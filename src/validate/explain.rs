//! What would explain the difference of two images: a factor, another orientation, a shift of the scan.
//!
//! Images are row = y, column = x. A shift `d` (x, y, in pixels) says that the reference at pixel `i` is our image at `i + d`:
//! its scan began so much further than ours. Whole pixels come from the correlation of the two images, fitted
//! in brightness and taken over the pixels that both have; the rest from interpolation. Interpolation of coarse scans
//! is inexact, so a shift that matters should be simulated ([`super::user`] does).

use std::sync::Arc;

use ndarray::{Array2, ArrayView2, Axis, s};
use num_complex::Complex64;
use rustfft::{Fft, FftPlanner};

use super::difference::{Difference, best_gain};

/// How many times smaller a difference must become for a further change to be believed.
pub const MUCH_BETTER: f64 = 3.0;
/// The last step of the search for a shift, in pixels.
const FINEST: f64 = 1.0 / 256.0;
/// Shifts as good as the best up to this share of its fault are the same: crystals repeat.
const AS_GOOD: f64 = 1.2;

/// How the pixels of a reference are turned, before anything else.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Turn {
    transposed: bool,
    /// Along x and y.
    mirrored: [bool; 2],
}

impl Turn {
    /// All but none; transpositions only for images that keep their shape.
    fn others(square: bool) -> impl Iterator<Item = Turn> {
        let all = (1..8_u8).map(|bits| Turn {
            transposed: bits & 4 != 0,
            mirrored: [bits & 1 != 0, bits & 2 != 0],
        });
        all.filter(move |turn| square || !turn.transposed)
    }

    /// The image turned so.
    pub fn apply(self, image: &Array2<f64>) -> Array2<f64> {
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
            (false, [false, false]) => "as it is",
            (false, [true, false]) => "mirrored along x",
            (false, [false, true]) => "mirrored along y",
            (false, [true, true]) => "turned by 180 degrees",
            (true, [false, false]) => "transposed (x and y exchanged)",
            (true, [true, true]) => "mirrored about the falling diagonal",
            (true, _) => "turned by 90 degrees",
        }
    }
}

/// A change that brings a reference nearer to ours.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Explanation {
    /// How the reference is turned.
    pub turn: Turn,
    /// How much further its scan began, (x, y) in pixels, if that was looked for.
    pub shift: Option<[f64; 2]>,
    /// What the reference is multiplied by, if that was fitted.
    pub factor: Option<f64>,
    /// The rms difference that is left, of the mean of the reference.
    pub rms: f64,
}

impl Explanation {
    /// In words, with pixels of `step` (x, y) in Angstrom.
    pub fn words(&self, step: [f64; 2]) -> String {
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

/// What was tried.
#[derive(Debug, Clone, PartialEq)]
pub struct Explanations {
    /// The rms difference as it is, of the mean of the reference.
    pub now: f64,
    /// The best of each kind alone: factor, orientation, shift. Orientation is missing where none can be tried.
    pub alone: Vec<Explanation>,
    /// The simplest change after which nothing else helps much; `None` if nothing does.
    pub best: Option<Explanation>,
}

/// Tries factors, orientations and shifts. Images are `periodic` along x and y where the scan covers the cell.
pub fn explanations(
    ours: &Array2<f64>,
    reference: &Array2<f64>,
    periodic: [bool; 2],
) -> Explanations {
    let now = Difference::between(ours.view(), reference.view()).rms;
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
    let shifted = Matcher::new(ours, periodic);
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
        let bar = best.map_or(now, |b| b.rms) / MUCH_BETTER;
        if next.rms < bar {
            best = Some(next);
        }
    }
    Explanations { now, alone, best }
}

fn rms(ours: &Array2<f64>, reference: &Array2<f64>) -> f64 {
    Difference::between(ours.view(), reference.view()).rms
}

/// The reference with the best factor.
fn fitted(ours: &Array2<f64>, reference: &Array2<f64>, turn: Turn) -> Explanation {
    let factor = best_gain(reference.view(), ours.view());
    Explanation { turn, shift: None, factor: Some(factor), rms: rms(ours, &(reference * factor)) }
}

/// The best shift of less than a pixel, (x, y) in pixels.
pub fn nearby_shift(ours: &Array2<f64>, reference: &Array2<f64>) -> [f64; 2] {
    Matcher::new(ours, [false; 2]).refined(reference, [0, 0])
}

/// Finds references in our image.
struct Matcher<'a> {
    ours: &'a Array2<f64>,
    periodic: [bool; 2],
    fourier: Fourier,
    spectrum: Array2<Complex64>,
}

/// Sums over the pixels that two images share.
#[derive(Default)]
struct Shared {
    ours: f64,
    both: f64,
    reference: f64,
}

impl Shared {
    /// The share of the reference's power that no factor brings to ours.
    fn fault(&self) -> f64 {
        1.0 - self.both * self.both / (self.ours * self.reference)
    }
}

impl<'a> Matcher<'a> {
    fn new(ours: &'a Array2<f64>, periodic: [bool; 2]) -> Self {
        let (rows, columns) = ours.dim();
        // Room for what is shifted out, where it does not come in again.
        let room = |n: usize, periodic: bool| if periodic { n } else { 2 * n };
        let fourier = Fourier::new([room(rows, periodic[1]), room(columns, periodic[0])]);
        let spectrum = fourier.forward(ours.view());
        Matcher { ours, periodic, fourier, spectrum }
    }

    /// The best shift, with or without a factor.
    fn explanation(&self, turn: Turn, reference: &Array2<f64>, fit: bool) -> Explanation {
        let shift = self.refined(reference, self.whole_pixels(reference));
        let (mut sums, mut count) = (Shared::default(), 0);
        self.share(reference, shift, |ours, reference| {
            sums.ours += ours * ours;
            sums.both += ours * reference;
            sums.reference += reference * reference;
            count += 1;
        });
        let factor = if fit { sums.both / sums.reference } else { 1.0 };
        let square = sums.ours - 2.0 * factor * sums.both + factor * factor * sums.reference;
        let mean = reference.mean().unwrap_or(f64::NAN).abs() * factor.abs();
        Explanation {
            turn,
            shift: Some(shift),
            factor: fit.then_some(factor),
            rms: (square.max(0.0) / f64::from(count)).sqrt() / mean,
        }
    }

    /// The smallest shift by whole pixels (x, y) that is about as good as any.
    fn whole_pixels(&self, reference: &Array2<f64>) -> [i64; 2] {
        let both = self.fourier.correlation(&self.spectrum, reference.view());
        let ours = Squares::new(self.ours);
        let theirs = Squares::new(reference);
        let (rows, columns) = reference.dim();
        let mut found = Vec::new();
        for y in reach(rows) {
            for x in reach(columns) {
                let (ny, nx) = both.dim();
                let at = [y.rem_euclid(ny as i64) as usize, x.rem_euclid(nx as i64) as usize];
                let sums = Shared {
                    ours: ours.sum(self.window(rows, y, 1), self.window(columns, x, 0)),
                    reference: theirs.sum(self.window(rows, -y, 1), self.window(columns, -x, 0)),
                    both: both[at],
                };
                let fault = sums.fault();
                if fault.is_finite() {
                    found.push((fault.max(0.0), [x, y]));
                }
            }
        }
        let least = found.iter().fold(f64::INFINITY, |least, f| least.min(f.0));
        let good = found.into_iter().filter(|f| f.0 <= AS_GOOD * least + 1e-9);
        good.min_by_key(|(_, [x, y])| x * x + y * y).map_or([0, 0], |(_, shift)| shift)
    }

    /// The pixels of our image, of `n`, that a shift brings onto the other.
    fn window(&self, n: usize, shift: i64, axis: usize) -> [usize; 2] {
        match self.periodic[axis] {
            true => [0, n],
            false => [shift.max(0) as usize, (n as i64 + shift.min(0)) as usize],
        }
    }

    /// A search with ever smaller steps about a whole number of pixels.
    fn refined(&self, reference: &Array2<f64>, start: [i64; 2]) -> [f64; 2] {
        let fault = |shift: [f64; 2]| {
            let mut sums = Shared::default();
            self.share(reference, shift, |ours, reference| {
                sums.ours += ours * ours;
                sums.both += ours * reference;
                sums.reference += reference * reference;
            });
            let fault = sums.fault();
            if fault.is_finite() { fault } else { f64::INFINITY }
        };
        let mut at = start.map(|v| v as f64);
        let mut least = fault(at);
        let free = [reference.ncols() > 1, reference.nrows() > 1];
        let mut step = 0.5;
        while step >= FINEST {
            let mut better = None;
            for [x, y] in [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]] {
                if (x != 0.0 && !free[0]) || (y != 0.0 && !free[1]) {
                    continue;
                }
                let next = [at[0] + step * x, at[1] + step * y];
                let found = fault(next);
                // Rounding is no improvement.
                if found < least - 1e-13 {
                    (least, better) = (found, Some(next));
                }
            }
            match better {
                Some(next) if (0..2).all(|i| (next[i] - start[i] as f64).abs() <= 1.0) => at = next,
                _ => step *= 0.5,
            }
        }
        at
    }

    /// Calls with each pair of pixels that are at the same place after a shift (x, y).
    fn share(&self, reference: &Array2<f64>, shift: [f64; 2], mut pair: impl FnMut(f64, f64)) {
        let (rows, columns) = reference.dim();
        let across: Vec<_> = (0..columns).map(|i| self.taps(i, shift[0], columns, 0)).collect();
        for (row, values) in reference.outer_iter().enumerate() {
            let Some(down) = self.taps(row, shift[1], rows, 1) else { continue };
            for (taps, reference) in across.iter().zip(values) {
                let Some(taps) = taps else { continue };
                let mut ours = 0.0;
                for (y, v) in &down {
                    for (x, u) in taps {
                        ours += v * u * self.ours[[*y, *x]];
                    }
                }
                pair(ours, *reference);
            }
        }
    }

    /// The pixels, with their weights, from which the value at `pixel + shift` is interpolated; `None` outside the image.
    fn taps(&self, pixel: usize, shift: f64, n: usize, axis: usize) -> Option<[(usize, f64); 4]> {
        let position = pixel as f64 + shift;
        let periodic = self.periodic[axis];
        if !periodic && (position < -1e-9 || position > (n - 1) as f64 + 1e-9) {
            return None;
        }
        let first = position.floor();
        let t = position - first;
        // R. G. Keys's cubic convolution, a = -1/2.
        let weights = [
            -0.5 * t + t * t - 0.5 * t * t * t,
            1.0 - 2.5 * t * t + 1.5 * t * t * t,
            0.5 * t + 2.0 * t * t - 1.5 * t * t * t,
            -0.5 * t * t + 0.5 * t * t * t,
        ];
        let place = |k: usize| {
            let i = first as i64 - 1 + k as i64;
            match periodic {
                true => i.rem_euclid(n as i64) as usize,
                false => i.clamp(0, n as i64 - 1) as usize,
            }
        };
        Some([0, 1, 2, 3].map(|k| (place(k), weights[k])))
    }
}

/// Shifts that are tried along an axis of `n` pixels: up to half of them.
fn reach(n: usize) -> std::ops::RangeInclusive<i64> {
    let half = (n / 2) as i64;
    -half..=half
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

/// Transforms of arrays of one shape, in double precision.
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

    /// Of an image with zeros after it.
    fn forward(&self, image: ArrayView2<f64>) -> Array2<Complex64> {
        let mut out = Array2::zeros(self.shape);
        let (rows, columns) = image.dim();
        out.slice_mut(s![..rows, ..columns]).assign(&image.mapv(Complex64::from));
        transform(out, &self.forward)
    }

    /// `sum over i of ours[i + shift] reference[i]` at each shift.
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

    /// Some waves without symmetry, at pixels from `start`.
    fn image((rows, columns): (usize, usize), start: [f64; 2]) -> Array2<f64> {
        Array2::from_shape_fn((rows, columns), |(y, x)| {
            let (x, y) = (x as f64 + start[0], y as f64 + start[1]);
            let wave = |h: f64, k: f64, phase: f64| {
                (std::f64::consts::TAU * (h * x / 24.0 + k * y / 20.0) + phase).cos()
            };
            2.0 + wave(1.0, 0.0, 0.3) + 0.7 * wave(1.0, 2.0, 1.0) + 0.4 * wave(-2.0, 1.0, 2.0)
        })
    }

    #[test]
    fn a_shift_of_no_whole_pixel_is_found_with_and_without_edges() {
        for (shape, periodic, most) in [((20, 24), true, 0.01), ((12, 15), false, 0.02)] {
            let ours = image(shape, [0.0; 2]);
            for shift in [[3.3, -2.6], [0.4, 0.2], [-0.25, 5.0]] {
                let reference = image(shape, shift) * 1.3;
                let found = explanations(&ours, &reference, [periodic; 2]);
                let best = found.best.unwrap();
                let at = best.shift.unwrap();
                assert!((0..2).all(|i| (at[i] - shift[i]).abs() < 0.05), "{shift:?} {best:?}");
                assert!((best.factor.unwrap() * 1.3 - 1.0).abs() < 0.01, "{best:?}");
                assert!(best.rms < most && found.now > 0.2, "{shift:?} {best:?}");
            }
        }
    }

    #[test]
    fn the_simplest_explanation_is_taken() {
        let ours = image((18, 18), [0.0; 2]);
        let of = |reference: &Array2<f64>| {
            let found = explanations(&ours, reference, [false; 2]);
            assert_eq!(found.alone.len(), 3);
            found.best.map(|b| b.words([1.0; 2]))
        };
        assert_eq!(of(&ours), None);
        assert_eq!(of(&(&ours * 0.5)).unwrap(), "the reference times 2.0000");
        let transposed = "the reference transposed (x and y exchanged)";
        assert_eq!(of(&ours.t().to_owned()).unwrap(), transposed);
        let mirrored = ours.slice(s![..;-1, ..]).to_owned();
        assert_eq!(of(&mirrored).unwrap(), "the reference mirrored along y");
        let moved = of(&image((18, 18), [2.0, 0.0])).unwrap();
        assert_eq!(moved, "a scan that starts 2.000, 0.000 A further along x, y");
        // something else altogether
        assert_eq!(
            of(&Array2::from_shape_fn((18, 18), |(y, x)| ((7 * x * x + 3 * y) % 11) as f64)),
            None
        );
    }

    #[test]
    fn a_crystal_is_moved_by_no_more_than_its_period() {
        let crystal = |start: f64| {
            Array2::from_shape_fn((30, 30), |(y, x)| {
                let wave = |v: f64| (std::f64::consts::TAU * v / 6.0).cos();
                1.0 + wave(x as f64 + start) * wave(y as f64)
            })
        };
        let found = explanations(&crystal(0.0), &crystal(1.0), [true; 2]);
        let shift = found.best.unwrap().shift.unwrap();
        assert!((shift[0] - 1.0).abs() < 0.02 && shift[1].abs() < 0.02, "{shift:?}");
    }

    #[test]
    fn lines_points_and_flat_images_have_an_answer() {
        let line = image((1, 24), [0.0; 2]);
        let moved = image((1, 24), [1.5, 0.0]);
        let shift = explanations(&line, &moved, [false; 2]).best.unwrap().shift.unwrap();
        assert!((shift[0] - 1.5).abs() < 0.05 && shift[1] == 0.0, "{shift:?}");
        for shape in [(1, 1), (4, 4)] {
            let found = explanations(&Array2::ones(shape), &Array2::ones(shape), [true; 2]);
            assert_eq!(found.best, None);
            explanations(&Array2::zeros(shape), &Array2::ones(shape), [false; 2]);
        }
    }
}
