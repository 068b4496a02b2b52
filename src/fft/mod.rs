//! Two-dimensional Fourier transforms: plan (`Fft2::new`), then execute.
//!
//! Arrays are row-major: rows = y, columns = x, x fastest. Rows are padded to `Fft2::stride` elements.
//! Transforms are unnormalised and in natural order: `forward` multiplies by `exp(-2 pi i ...)`, and
//! `inverse(forward(a)) = nx ny a`. SIMD blocks of rows (`row_transform`) and of columns (`column_transform`) are
//! transformed together; lengths with a prime factor above 5 go one by one through `rustfft`.

mod band_limit;
mod buffer;
mod butterfly;
mod column_transform;
mod convolution;
mod fft2;
mod length;
mod passes;
mod radix_plan;
mod real;
mod row_transform;
mod tile;

pub(crate) use band_limit::{BandLimit, BandLimitedMultiplier};
pub(crate) use buffer::Buffer;
pub(crate) use fft2::{Fft2, Scratch};
pub(crate) use length::{frequency, good_size};
pub(crate) use radix_plan::lanes;
