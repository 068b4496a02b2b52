//! The speed of this machine, and the time that a plan needs.

use std::time::{Duration, Instant};

use rayon::prelude::*;

use crate::engine::{Cost, Plan};
use crate::fft::{Fft2, good_size};

/// Duration of the measurement of speed.
const MEASURED: Duration = Duration::from_millis(200);
/// Transforms with more points than this are not slower per operation than smaller ones, but need memory.
const MOST_POINTS: usize = 1 << 22;
/// Observed ratios of real to estimated time on an idle machine: shortest and longest.
const OFF: [f64; 2] = [0.7, 1.5];

/// Nominal floating-point operations per second, on all threads at once.
struct MachineSpeed {
    /// Speed under the machine's current load.
    now: f64,
    /// Speed of an idle machine.
    alone: f64,
}

/// The speed of transforms of the plan's wave grid, or of a smaller one.
fn speed(plan: &Plan) -> MachineSpeed {
    let (mut ny, mut nx) = plan.wave_grid.shape();
    while ny * nx > MOST_POINTS {
        (ny, nx) = (good_size(ny.div_ceil(2), 1), good_size(nx.div_ceil(2), 1));
    }
    let fft = Fft2::new(ny, nx);
    let run = |_: usize| {
        let (mut data, mut scratch) = (fft.buffer(), fft.scratch());
        let (begun, busy) = (Instant::now(), thread_seconds());
        let mut done = 0.0;
        while done == 0.0 || begun.elapsed() < MEASURED {
            fft.forward(&mut data, &mut scratch);
            fft.inverse(&mut data, &mut scratch);
            done += 2.0 * fft.nominal_flops();
        }
        let busy = (thread_seconds() - busy).max(1e-9);
        [done / begun.elapsed().as_secs_f64(), done / busy]
    };
    let sum = |a: [f64; 2], b: [f64; 2]| [a[0] + b[0], a[1] + b[1]];
    let speeds = (0..threads()).into_par_iter().with_max_len(1).map(run);
    let [now, alone] = speeds.reduce(|| [0.0; 2], sum);
    MachineSpeed { now, alone: alone.max(now) }
}

/// Seconds that this thread has computed, or of the wall clock where the system does not report them.
fn thread_seconds() -> f64 {
    #[cfg(unix)]
    {
        let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
        time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
    }
    #[cfg(not(unix))]
    {
        static BEGUN: std::sync::LazyLock<Instant> = std::sync::LazyLock::new(Instant::now);
        BEGUN.elapsed().as_secs_f64()
    }
}

/// Shortest and longest estimated time in seconds of `runs` simulations, each at this cost.
pub fn seconds(plan: &Plan, cost: &Cost, runs: usize) -> [f64; 2] {
    if runs == 0 {
        return [0.0; 2];
    }
    range(runs as f64 * cost.nominal_flops(), &speed(plan))
}

/// Shortest time in seconds of these operations, on an idle machine, and longest time, under the current load.
fn range(flops: f64, speed: &MachineSpeed) -> [f64; 2] {
    [OFF[0] * flops / speed.alone, OFF[1] * flops / speed.now]
}

/// Number of computing threads.
pub fn threads() -> usize {
    rayon::current_num_threads()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::{Scan, Settings};

    /// Other load makes the longest time longer, and leaves the shortest unchanged.
    #[test]
    fn ranges_of_time_hold_what_else_runs() {
        let quiet = MachineSpeed { now: 1e9, alone: 1e9 };
        let busy = MachineSpeed { now: 0.25e9, alone: 1e9 };
        assert_eq!(range(2e9, &quiet), [1.4, 3.0]);
        assert_eq!(range(2e9, &busy), [1.4, 12.0]);
    }

    #[test]
    fn a_machine_is_measured() {
        let plan = Plan::new(&Settings::default(), [12.0, 12.0, 4.0], &[2.0]).unwrap();
        let step_angstrom = [0.5; 2];
        let scan = Scan { origin_angstrom: [2.0; 2], step_angstrom, shape: [8, 8] };
        let cost = Cost::new(&plan, &scan);
        let speed = speed(&plan);
        assert!(0.0 < speed.now && speed.now <= speed.alone && speed.alone.is_finite());
        let [least, most] = seconds(&plan, &cost, 1);
        assert!(0.0 < least && 2.0 * least < most, "{least} {most}");
        assert_eq!(seconds(&plan, &cost, 0), [0.0; 2]);
    }
}
