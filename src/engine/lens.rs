//! Conventional (plane-wave) imaging through an objective lens.

use super::grid::Grid;
use crate::fft::Fft2;
use crate::optics::Optics;
use ndarray::Array2;
use num_complex::Complex32;

/// The image that a coherent objective lens makes of an exit wave: `|F^-1[F(psi) A exp(-i chi)]|^2`, with the aperture
/// and aberrations of `optics`.
///
/// `exit` has rows = y and columns = x over `extent_angstrom` (x, y). The image has the same shape and is in the unit of
/// `|exit|^2`: 1 is the intensity of the incident wave.
pub fn lens_image(
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
    let scale = 1.0 / (nx * ny) as f64;
    for y in 0..ny {
        for x in 0..nx {
            let t = optics.transfer(grid.k(y, x), grid.dk()) * scale;
            wave[y * fft.stride() + x] *= Complex32::new(t.re as f32, t.im as f32);
        }
    }
    fft.inverse(&mut wave, &mut scratch);
    Array2::from_shape_fn((ny, nx), |(y, x)| wave[y * fft.stride() + x].norm_sqr())
}
