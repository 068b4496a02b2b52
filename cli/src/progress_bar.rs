//! Progress on standard error: bars on a terminal, lines elsewhere.

use super::{signals, text};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::collections::VecDeque;
use std::io::IsTerminal;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use stemgen::progress::Progress;

/// Time until the first line of progress, and between lines.
const FIRST_LINE: Duration = Duration::from_secs(2);
const LINE_EVERY: Duration = Duration::from_secs(8);
/// Time over which the rate is averaged.
const RATE_WINDOW: Duration = Duration::from_secs(60);

/// Draws progress.
pub struct Reporter {
    mode: Mode,
    begun: Instant,
    done: AtomicU64,
    found: AtomicU64,
    /// Time of the next drawing, in ms since `begun`.
    next_ms: AtomicU64,
    stage: Mutex<Option<BarStage>>,
}

#[derive(Clone, Copy, PartialEq)]
enum Mode {
    Silent,
    Lines,
    Bars,
}

struct BarStage {
    name: String,
    unit: String,
    total: u64,
    meter: Meter,
    last_line: Option<Instant>,
    bar: Option<ProgressBar>,
}

/// Rate of the recent past.
struct Meter {
    begun: Instant,
    samples: VecDeque<(Instant, u64)>,
}

impl Reporter {
    /// Makes a reporter, which prints nothing if `quiet`.
    pub fn new(quiet: bool) -> Self {
        let mode = match (quiet, std::io::stderr().is_terminal()) {
            (true, _) => Mode::Silent,
            (false, true) => Mode::Bars,
            (false, false) => Mode::Lines,
        };
        Reporter {
            mode,
            begun: Instant::now(),
            done: AtomicU64::new(0),
            found: AtomicU64::new(0),
            next_ms: AtomicU64::new(0),
            stage: Mutex::new(None),
        }
    }

    fn stage(&self) -> MutexGuard<'_, Option<BarStage>> {
        // The values stay valid even if another thread panicked while drawing.
        self.stage.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Prints a message that is no warning, on standard error.
    pub fn note(&self, message: &str) {
        if self.mode != Mode::Silent && !self.interrupted() {
            text::complain(message);
        }
    }

    fn draw(&self) {
        let Ok(mut guard) = self.stage.try_lock() else { return };
        let Some(stage) = guard.as_mut() else { return };
        let now = Instant::now();
        let done = self.done.load(Relaxed).min(stage.total);
        let rate = stage.meter.rate(now, done.saturating_sub(self.found.load(Relaxed)));
        match &stage.bar {
            Some(bar) => {
                bar.set_position(done);
                bar.set_message(stage.describe(done, rate));
            }
            None => stage.line(now, done, rate),
        }
    }
}

impl Progress for Reporter {
    fn start(&self, name: &str, unit: &str, total: u64) {
        let bar = (self.mode == Mode::Bars).then(|| new_bar(name, total));
        let meter = Meter { begun: Instant::now(), samples: VecDeque::new() };
        let plural = if unit.ends_with('s') { unit.to_owned() } else { format!("{unit}s") };
        let (name, last_line) = (name.to_owned(), None);
        let stage = BarStage { name, unit: plural, total, meter, last_line, bar };
        self.done.store(0, Relaxed);
        self.found.store(0, Relaxed);
        self.next_ms.store(0, Relaxed);
        *self.stage() = Some(stage);
    }

    fn found(&self, n: u64) {
        self.found.fetch_add(n, Relaxed);
        self.advance(n);
    }

    fn advance(&self, n: u64) {
        self.done.fetch_add(n, Relaxed);
        let now = self.begun.elapsed().as_millis() as u64;
        let next = self.next_ms.load(Relaxed);
        let pause = if self.mode == Mode::Bars { 100 } else { 1000 };
        if self.mode != Mode::Silent
            && now >= next
            && self.next_ms.compare_exchange(next, now + pause, Relaxed, Relaxed).is_ok()
        {
            self.draw();
        }
    }

    fn finish(&self) {
        if let Some(BarStage { bar: Some(bar), .. }) = self.stage().take() {
            bar.finish_and_clear();
        }
    }

    fn warn(&self, message: &str) {
        // After Ctrl-C the error and its hint are enough.
        if self.mode == Mode::Silent || self.interrupted() {
            return;
        }
        let print = || text::complain(&format!("warning: {message}"));
        match self.stage().as_ref().and_then(|s| s.bar.as_ref()) {
            Some(bar) => bar.suspend(print),
            None => print(),
        }
    }

    fn interrupted(&self) -> bool {
        signals::asked_to_stop()
    }
}

impl BarStage {
    fn describe(&self, done: u64, rate: Option<f64>) -> String {
        let of = format!("{} of {} {}", text::count(done), text::count(self.total), self.unit);
        match rate {
            Some(rate) if rate > 0.0 => {
                let left = text::duration((self.total - done) as f64 / rate);
                format!("{of}, {} per s, {left} left", text::significant(rate, 2))
            }
            _ => of,
        }
    }

    fn line(&mut self, now: Instant, done: u64, rate: Option<f64>) {
        let due = match self.last_line {
            Some(last) => now >= last + LINE_EVERY,
            None => now >= self.meter.begun + FIRST_LINE,
        };
        if due {
            self.last_line = Some(now);
            let percent = 100.0 * done as f64 / self.total.max(1) as f64;
            let text = self.describe(done, rate);
            text::complain(&format!("{}: {percent:.0} %, {text}", self.name));
        }
    }
}

impl Meter {
    /// Returns units per second since the first sample; `None` at first. The first sample comes with the first unit, so that the time of
    /// preparations does not count.
    fn rate(&mut self, now: Instant, done: u64) -> Option<f64> {
        if self.samples.back().is_none_or(|(t, _)| now > *t + Duration::from_secs(1)) {
            self.samples.push_back((now, done));
        }
        while self.samples.len() > 2 && now > self.samples[1].0 + RATE_WINDOW {
            self.samples.pop_front();
        }
        let &(then, before) = self.samples.front()?;
        let seconds = now.saturating_duration_since(then).as_secs_f64();
        (seconds > 1.0).then(|| done.saturating_sub(before) as f64 / seconds)
    }
}

fn new_bar(name: &str, total: u64) -> ProgressBar {
    let bar = ProgressBar::with_draw_target(Some(total), ProgressDrawTarget::stderr_with_hz(10));
    let style = ProgressStyle::with_template("{prefix} {wide_bar} {percent:>3} %  {msg}");
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
    bar.set_prefix(name.to_owned());
    bar
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rate_is_that_of_the_recent_past() {
        let begun = Instant::now();
        let mut meter = Meter { begun, samples: VecDeque::new() };
        let at = |s: u64| begun + Duration::from_secs(s);
        assert_eq!(meter.rate(at(0), 0), None);
        for s in 1..=100 {
            meter.rate(at(s), 10 * s);
        }
        let fast = (101..=200).filter_map(|s| meter.rate(at(s), 1000 + 50 * (s - 100))).last();
        assert!((fast.unwrap() - 50.0).abs() < 1e-9, "{fast:?}");
    }

    #[test]
    fn a_rate_is_finite_whatever_the_clock_says() {
        let begun = Instant::now() + Duration::from_secs(1 << 20);
        let mut meter = Meter { begun, samples: VecDeque::new() };
        // The clock jumps to and fro, as on a machine that slept, and stands still.
        for (i, s) in
            [5, 3, 1 << 19, 4, 4, 4, 1 << 30, 7, 0].into_iter().cycle().take(100).enumerate()
        {
            for now in [begun + Duration::from_secs(s), begun - Duration::from_secs(s.min(1 << 20))]
            {
                let rate = meter.rate(now, (i as u64 * 7) % 50);
                assert!(rate.is_none_or(|rate| rate.is_finite() && rate >= 0.0), "{rate:?}");
            }
            assert!(meter.samples.len() < 1000);
        }
    }
}
