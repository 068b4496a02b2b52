//! What long computations report, and how they are told to stop.

/// Receives progress from the library; the command line draws it.
pub trait Progress: Sync {
    /// A stage begins, of `total` units (probes, slices, tiles ...).
    fn start(&self, stage: &str, unit: &str, total: u64);
    /// `n` more units of the current stage are done; called from any thread.
    fn advance(&self, n: u64);
    /// `n` units of the current stage were done by an earlier run: they say nothing about how fast this one is.
    fn found(&self, n: u64) {
        self.advance(n);
    }
    /// The current stage is over.
    fn finish(&self);
    /// Something the user should know, once.
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
