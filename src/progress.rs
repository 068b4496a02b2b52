//! Progress reports of long computations, and their interruption.

use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

/// Receives progress from the library; the command line displays it.
pub trait Progress: Sync {
    /// A stage begins, of `total` units (probes, slices, tiles ...).
    fn start(&self, stage: &str, unit: &str, total: u64);
    /// `n` more units of the current stage are done; called from any thread.
    fn advance(&self, n: u64);
    /// `n` units of the current stage were done by an earlier run, so they are left out of the speed of this one.
    fn found(&self, n: u64) {
        self.advance(n);
    }
    /// The current stage has ended.
    fn finish(&self);
    /// Something that the user should know, once.
    fn warn(&self, message: &str);
    /// Whether the user asked to stop. Checked often; the computation then returns
    /// [`crate::Error::Interrupted`].
    fn interrupted(&self) -> bool;
}

/// Reports nothing and never interrupts.
#[derive(Debug, Default, Clone, Copy)]
pub struct Silent;

impl Progress for Silent {
    fn start(&self, _: &str, _: &str, _: u64) {}
    fn advance(&self, _: u64) {}
    fn finish(&self) {}
    fn warn(&self, _: &str) {}
    fn interrupted(&self) -> bool {
        false
    }
}

/// Formats a duration: `0.4 s`, `45 s`, `3 min 20 s`, `2 h 05 min`, `3 d 04 h`.
pub fn duration(seconds: f64) -> String {
    let whole = seconds.max(0.0).round().min(1e15) as u64;
    match whole {
        0..10 => format!("{seconds:.1} s"),
        10..100 => format!("{whole} s"),
        100..6000 => format!("{} min {:02} s", whole / 60, whole % 60),
        6000..360_000 => format!("{} h {:02} min", whole / 3600, whole % 3600 / 60),
        _ => format!("{} d {:02} h", whole / 86_400, whole % 86_400 / 3600),
    }
}

/// The progress of one part as a share of the whole. The stages that the part reports become its share.
pub(crate) struct ProgressShare<'a> {
    outer: &'a dyn Progress,
    probes: u64,
    total: AtomicU64,
    done: AtomicU64,
    reported: AtomicU64,
}

impl<'a> ProgressShare<'a> {
    /// Reports the progress of a part that counts as `probes` probes of the whole.
    pub fn new(outer: &'a dyn Progress, probes: usize) -> Self {
        let zero = || AtomicU64::new(0);
        ProgressShare {
            outer,
            probes: probes as u64,
            total: zero(),
            done: zero(),
            reported: zero(),
        }
    }

    /// Reports that the part is done.
    pub fn complete(&self) {
        self.report(self.probes);
    }

    /// Reports that an earlier run has done the part.
    pub fn found(&self) {
        self.reported.store(self.probes, Relaxed);
        self.outer.found(self.probes);
    }

    fn report(&self, probes: u64) {
        let before = self.reported.fetch_max(probes, Relaxed);
        if probes > before {
            self.outer.advance(probes - before);
        }
    }
}

impl Progress for ProgressShare<'_> {
    fn start(&self, _: &str, _: &str, total: u64) {
        self.total.store(total, Relaxed);
        self.done.store(0, Relaxed);
    }
    fn advance(&self, n: u64) {
        let done = self.done.fetch_add(n, Relaxed) + n;
        let total = self.total.load(Relaxed).max(1);
        let share = done.min(total) as f64 / total as f64;
        self.report((share * self.probes as f64) as u64);
    }
    fn finish(&self) {}
    fn warn(&self, message: &str) {
        self.outer.warn(message);
    }
    fn interrupted(&self) -> bool {
        self.outer.interrupted()
    }
}

/// Passes on warnings and interruptions, but no stages: these are counted elsewhere.
pub struct InterruptOnly<'a>(pub &'a dyn Progress);

impl Progress for InterruptOnly<'_> {
    fn start(&self, _: &str, _: &str, _: u64) {}
    fn advance(&self, _: u64) {}
    fn finish(&self) {}
    fn warn(&self, message: &str) {
        self.0.warn(message);
    }
    fn interrupted(&self) -> bool {
        self.0.interrupted()
    }
}
