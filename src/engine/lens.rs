//! Conventional (plane-wave) imaging through an objective lens.

use super::grid::Grid;
use crate::fft::Fft2;
use crate::optics::{Focus, Optics, foci};
use ndarray::Array2;
use num_complex::Complex32;

/// The image of an exit wave through an objective lens: `|F^-1[F(psi) A exp(-i chi)]|^2`, with the aperture and aberrations of `optics`, in
/// the mean over its focal spread.
///
/// `exit` has rows = y and columns = x over `extent_angstrom` (x, y). The image has the same shape and is in the unit of
/// `|exit|^2`: 1 is the intensity of the incident wave.
pub(crate) fn lens_image(
    exit: &Array2<Complex32>,
    extent_angstrom: [f64; 2],
    optics: &Optics,
) -> Array2<f32> {
    let (ny, nx) = exit.dim();
    let grid = Grid { points: [nx, ny], extent_angstrom };
    let fft = Fft2::new(ny, nx);
    let (mut wave, mut scratch) = (fft.buffer(), fft.scratch());
    for ((y, x), v) in exit.indexed_iter() {
        wave[y * fft.stride() + x] = *v;
    }
    fft.forward(&mut wave, &mut scratch);
    let mut image = Array2::zeros((ny, nx));
    for Focus { offset_angstrom, weight } in foci(optics).unwrap_or_default() {
        let mut lens = optics.clone();
        lens.aberrations.add_defocus(offset_angstrom);
        let mut seen = wave.clone();
        through(&lens, &grid, &fft, &mut seen);
        fft.inverse(&mut seen, &mut scratch);
        for ((y, x), v) in image.indexed_iter_mut() {
            *v += seen[y * fft.stride() + x].norm_sqr() * weight as f32;
        }
    }
    image
}

/// Multiplies Fourier coefficients by the transfer function of a lens, and divides by the number of pixels.
fn through(optics: &Optics, grid: &Grid, fft: &Fft2, wave: &mut [Complex32]) {
    let (ny, nx) = grid.shape();
    let scale = 1.0 / (nx * ny) as f64;
    for y in 0..ny {
        for x in 0..nx {
            let t = optics.transfer(grid.k(y, x), grid.dk()) * scale;
            wave[y * fft.stride() + x] *= Complex32::new(t.re as f32, t.im as f32);
        }
    }
}
