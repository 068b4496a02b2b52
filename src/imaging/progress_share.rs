//! Progress of one sub-tile as a share of the whole build.

use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use crate::progress::Progress;

/// Turns whatever stages an engine reports into probes of the build.
pub struct SubProgress<'a> {
    outer: &'a dyn Progress,
    probes: u64,
    total: AtomicU64,
    done: AtomicU64,
    reported: AtomicU64,
}

impl<'a> SubProgress<'a> {
    /// For a sub-tile of `probes` probes.
    pub fn new(outer: &'a dyn Progress, probes: usize) -> Self {
        let zero = || AtomicU64::new(0);
        SubProgress { outer, probes: probes as u64, total: zero(), done: zero(), reported: zero() }
    }

    /// The sub-tile is done.
    pub fn complete(&self) {
        self.report(self.probes);
    }

    /// An earlier run has done the sub-tile.
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

impl Progress for SubProgress<'_> {
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

/// Passes on only the wish to stop: pixels are counted elsewhere.
pub struct Quiet<'a>(pub &'a dyn Progress);

impl Progress for Quiet<'_> {
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
