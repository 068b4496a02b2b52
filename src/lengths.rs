//! Conversion of lengths: fields and worlds are in nm, atoms and probes in Angstrom.

/// A length, or an array of lengths.
pub(crate) trait Length: Sized {
    /// Applies a function to each length.
    fn each(self, of: impl Fn(f64) -> f64 + Copy) -> Self;
}

impl Length for f64 {
    fn each(self, of: impl Fn(f64) -> f64 + Copy) -> Self {
        of(self)
    }
}

impl<L: Length, const N: usize> Length for [L; N] {
    fn each(self, of: impl Fn(f64) -> f64 + Copy) -> Self {
        self.map(|length| length.each(of))
    }
}

/// Converts nm to Angstrom.
pub(crate) fn angstrom<L: Length>(nm: L) -> L {
    nm.each(|nm| 10.0 * nm)
}

/// Converts nm to Angstrom by division, which rounds in another way than [`angstrom`]. The positions of atoms in worlds depend on it.
pub(crate) fn angstrom_by_division<L: Length>(nm: L) -> L {
    nm.each(|nm| nm / 0.1)
}

/// Converts Angstrom to nm.
pub(crate) fn nm<L: Length>(angstrom: L) -> L {
    angstrom.each(|angstrom| 0.1 * angstrom)
}

/// The area of a square in square Angstrom from its edge in nm.
pub(crate) fn square_angstrom2(edge_nm: f64) -> f64 {
    angstrom(edge_nm).powi(2)
}
