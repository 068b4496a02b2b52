//! What an audit looks at.

/// What is audited.
#[derive(Debug, Clone, PartialEq)]
pub struct AuditOptions {
    /// Number of regions, drawn at random.
    pub regions: usize,
    /// Their edge in nm.
    pub size_nm: f64,
    /// Every how many-th pixel is compared, along each axis; `None`: about every 0.5 Angstrom.
    pub stride: Option<usize>,
    /// Seed of their places.
    pub seed: u64,
    /// Centres (x, y) in nm of the built field, in place of random ones.
    pub at_nm: Vec<[f64; 2]>,
    /// Phonon configurations that are compared, in the mean; all when `None`.
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
