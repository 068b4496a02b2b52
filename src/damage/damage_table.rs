//! The table `[damage]` of a recipe: how easily the beam displaces the atoms of each element.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::knock_on::vibrating_knock_on_angstrom2;
use crate::setting::{Fault, check_range};

/// A barn in square Angstrom.
pub(crate) const BARN_ANGSTROM2: f64 = 1e-8;
/// Threshold energies in eV.
const THRESHOLD_EV: [f64; 2] = [1.0, 1000.0];
/// Velocities of vibration in m/s.
const VIBRATION_M_PER_S: [f64; 2] = [0.0, 1e4];
/// Effective cross-sections of radiolysis in barn.
const RADIOLYSIS_BARN: [f64; 2] = [0.0, 1e9];

/// Damage of the specimen by the beam. Atoms of elements that are not named stay in place.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DamageTable {
    /// Threshold energy in eV for displacing an atom permanently (knock-on), by symbol of the element.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub threshold_ev: BTreeMap<String, f64>,
    /// Root-mean-square velocity of an atom's vibration along the beam in m/s, by symbol of the element: at a temperature T it is the root
    /// of k T / M, or more with zero-point motion. Atoms that the table leaves out are hit at rest.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub vibration_m_per_s: BTreeMap<String, f64>,
    /// Effective cross-section in barn for the loss of an atom by ionisation, by symbol of the element.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub radiolysis_barn: BTreeMap<String, f64>,
}

impl DamageTable {
    /// Cross-section in square Angstrom for the loss of an atom of an element, by its symbol and atomic number: an atom is lost with the
    /// probability `1 - exp(-cross-section dose)`.
    pub(crate) fn cross_section_angstrom2(&self, symbol: &str, number: u8, energy_kv: f64) -> f64 {
        let knock_on = self.threshold_ev.get(symbol);
        let vibration = self.vibration_m_per_s.get(symbol).copied().unwrap_or(0.0);
        let knock_on = knock_on.map_or(0.0, |ev| {
            vibrating_knock_on_angstrom2(number, 1e3 * energy_kv, *ev, vibration)
        });
        let radiolysis = self.radiolysis_barn.get(symbol).map_or(0.0, |b| b * BARN_ANGSTROM2);
        knock_on + radiolysis
    }

    /// The symbols of all elements that the table names.
    pub(crate) fn elements(&self) -> impl Iterator<Item = (&'static str, &String)> {
        let of = |name| move |symbol| (name, symbol);
        let first = self.threshold_ev.keys().map(of("threshold_ev"));
        let second = first.chain(self.vibration_m_per_s.keys().map(of("vibration_m_per_s")));
        second.chain(self.radiolysis_barn.keys().map(of("radiolysis_barn")))
    }

    /// Checks every value against its limits.
    ///
    /// # Errors
    /// The first value outside its limits.
    pub(crate) fn check(&self) -> Result<(), Fault> {
        for (element, threshold) in &self.threshold_ev {
            check_range(format!("threshold_ev.{element}"), *threshold, THRESHOLD_EV)?;
        }
        for (element, velocity) in &self.vibration_m_per_s {
            check_range(format!("vibration_m_per_s.{element}"), *velocity, VIBRATION_M_PER_S)?;
        }
        for (element, barn) in &self.radiolysis_barn {
            check_range(format!("radiolysis_barn.{element}"), *barn, RADIOLYSIS_BARN)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::knock_on::knock_on_angstrom2;
    use super::*;

    #[test]
    fn knock_on_and_radiolysis_add_up() {
        let one = |v: f64| BTreeMap::from([("C".to_owned(), v)]);
        let table = DamageTable {
            threshold_ev: one(17.0),
            radiolysis_barn: one(5.0),
            ..DamageTable::default()
        };
        let both = table.cross_section_angstrom2("C", 6, 200.0);
        let knock_on = knock_on_angstrom2(6, 200e3, 17.0);
        assert!(knock_on > 0.0 && (both - knock_on - 5e-8).abs() < 1e-15);
        assert_eq!(table.cross_section_angstrom2("O", 8, 200.0), 0.0);
        assert_eq!(table.check(), Ok(()));
        let fault = DamageTable { threshold_ev: one(-3.0), ..table }.check().unwrap_err();
        assert_eq!((fault.key.as_str(), fault.value.as_str()), ("threshold_ev.C", "-3"));
    }
}
