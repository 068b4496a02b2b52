//! Measures how fast this machine propagates waves.

use super::plan::Plan;
use super::stepper::{StepWorkspace, Stepper};
use crate::fft::Buffer;
use num_complex::Complex32;
use rayon::prelude::*;
use std::time::{Duration, Instant};

/// Speed of the propagation loop, and of its Fourier transforms alone.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Speed {
    /// Multislice steps per second, all threads together.
    pub steps_per_s: f64,
    /// Multislice steps in nominal operations, `2 * 5 N log2 N` a step, in GFLOP/s.
    pub step_gflops: f64,
    /// Forward and inverse transforms of the same arrays without other work, in nominal GFLOP/s.
    pub fft_gflops: f64,
}

/// Measures the plan's multislice step for about `duration` on the current rayon threads.
pub fn measure_speed(plan: &Plan, duration: Duration) -> Speed {
    let stepper = Stepper::new(plan);
    let fft = stepper.fft();
    let shape = plan.wave_grid.shape();
    let mut ones = Buffer::zeros(fft.row_blocks() * fft.arranged_len());
    ones.fill(Complex32::ONE);
    let propagator = stepper.propagator(1.0, [0; 2]);
    let threads = rayon::current_num_threads();
    let rate = |body: &(dyn Fn(&mut [Buffer], &mut StepWorkspace) + Sync)| {
        let per_thread = (0..threads).into_par_iter().map(|_| {
            let (mut waves, mut w) =
                (vec![fft.buffer(); stepper.waves_together()], stepper.workspace());
            waves.iter_mut().for_each(|wave| wave[0] = Complex32::ONE);
            body(&mut waves, &mut w);
            let (start, mut count) = (Instant::now(), 0);
            while start.elapsed() < duration / 2 {
                body(&mut waves, &mut w);
                count += waves.len() as u32;
            }
            f64::from(count) / start.elapsed().as_secs_f64()
        });
        per_thread.sum::<f64>()
    };
    let steps_per_s = rate(&|waves, w| {
        stepper.transmit(waves, &ones, w);
        stepper.propagate_freely(waves, &propagator, &mut w.fft);
    });
    let scale = 1.0 / (shape.0 * shape.1) as f32;
    let pairs_per_s = rate(&|waves, w| {
        for wave in waves {
            fft.forward(wave, &mut w.fft);
            fft.inverse(wave, &mut w.fft);
            // Keeps the numbers in range without a pass over memory.
            wave[0] *= scale;
        }
    });
    let flops = 2.0 * fft.nominal_flops() * 1e-9;
    Speed { steps_per_s, step_gflops: steps_per_s * flops, fft_gflops: pairs_per_s * flops }
}
