//! Physical constants (CODATA 2018), and functions of the beam energy.

/// Largest atomic number in the tables of scattering factors.
pub(crate) const MAX_ATOMIC_NUMBER: u8 = 103;
/// Rest energy of the electron in eV.
pub(crate) const ELECTRON_REST_ENERGY_EV: f64 = 510_998.95;
/// Planck's constant times the speed of light in eV Angstrom.
pub(crate) const HC_EV_ANGSTROM: f64 = 12_398.419_843_320_026;
/// `h^2 / (2 pi m_e e)` in V Angstrom^2: turns a scattering factor in Angstrom into the Fourier
/// transform of a projected potential in V Angstrom^3.
pub(crate) const POTENTIAL_PER_SCATTERING_FACTOR: f64 = 47.877_645;

/// Relativistic electron wavelength in Angstrom,
/// `hc / sqrt(E (E + 2 m c^2))` (Kirkland 2010, eq. 2.5).
pub(crate) fn wavelength_angstrom(energy_ev: f64) -> f64 {
    HC_EV_ANGSTROM / (energy_ev * (energy_ev + 2.0 * ELECTRON_REST_ENERGY_EV)).sqrt()
}

/// Interaction parameter `sigma = 2 pi m e lambda / h^2` (relativistic m) in rad / (V Angstrom)
/// (Kirkland 2010, eq. 5.6).
pub(crate) fn interaction_parameter(energy_ev: f64) -> f64 {
    let gamma = 1.0 + energy_ev / ELECTRON_REST_ENERGY_EV;
    gamma * wavelength_angstrom(energy_ev) / POTENTIAL_PER_SCATTERING_FACTOR
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn published_values_at_200_kv() {
        // Kirkland, Advanced Computing in Electron Microscopy (2010), table 2.2 and fig. 5.1
        assert!((wavelength_angstrom(200e3) - 0.025_079).abs() < 1e-6);
        assert!((interaction_parameter(200e3) - 0.7288e-3).abs() < 1e-7);
        assert!((wavelength_angstrom(100e3) - 0.037_014).abs() < 1e-6);
        // The value of h^2 / (2 pi m e) from its constants.
        let (h, m, e) = (6.626_070_15e-34_f64, 9.109_383_701_5e-31, 1.602_176_634e-19);
        let value = h * h / (2.0 * std::f64::consts::PI * m * e) * 1e20;
        assert!((POTENTIAL_PER_SCATTERING_FACTOR / value - 1.0).abs() < 1e-6, "{value}");
    }
}
