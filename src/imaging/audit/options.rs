//! Options of an audit.

/// Which regions, pixels and configurations an audit compares.
#[derive(Debug, Clone, PartialEq)]
pub struct AuditOptions {
    /// Number of regions, drawn at random.
    pub regions: usize,
    /// Edge of the regions in nm.
    pub size_nm: f64,
    /// Every `stride`-th pixel is compared along each axis; `None`: about every 0.5 Angstrom.
    pub stride: Option<usize>,
    /// Seed of the places of the regions.
    pub seed: u64,
    /// Centres (x, y) of regions in nm of the built field; they replace the random ones.
    pub at_nm: Vec<[f64; 2]>,
    /// Number of phonon configurations whose mean is compared; all when `None`.
    pub configurations: Option<usize>,
}

impl Default for AuditOptions {
    fn default() -> Self {
        AuditOptions {
            regions: 3,
            size_nm: 1.0,
            stride: None,
            seed: 1,
            at_nm: Vec::new(),
            configurations: None,
        }
    }
}
