//! What is simulated: lattice sites.

/// A lattice site: where its atom is on average, and how it vibrates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Site {
    /// Mean position in Angstrom, in the frame of the simulated box; the beam runs along +z.
    pub position: [f64; 3],
    /// Atomic number.
    pub number: u8,
    /// Standard deviation of each Cartesian component of the thermal displacement, in Angstrom.
    pub sigma_angstrom: f64,
    /// Identifies the site in the random numbers: its displacement in configuration `c` is a function of
    /// (seed, c, key) alone, whichever box it is simulated in.
    pub key: u64,
}
