//! Values outside their limits.

use crate::error::Error;
pub(crate) use crate::setting::Fault;
use crate::structure::elements;

/// Result of a check.
pub type Checked<T = ()> = std::result::Result<T, Fault>;

pub fn within(key: &str, value: f64, low: f64, high: f64) -> Checked {
    match (low..=high).contains(&value) {
        true => Ok(()),
        false => fault(key, value, format!("expected a value from {low:.6} to {high:.6}")),
    }
}

pub fn fault<T>(key: &str, value: impl ToString, expected: impl Into<String>) -> Checked<T> {
    Err(Fault { key: key.to_owned(), value: value.to_string(), expected: expected.into() })
}

pub fn needed<'t, T>(key: &str, table: Option<&'t T>) -> Checked<&'t T> {
    match table {
        Some(table) => Ok(table),
        None => fault(key, "(missing)", "this kind of structure needs the table"),
    }
}

pub fn one_of(key: &str, symbol: &String, elements: &[String]) -> Checked {
    match elements.contains(symbol) {
        true => Ok(()),
        false => fault(
            key,
            symbol,
            format!("expected an element of the crystal: {}", elements.join(", ")),
        ),
    }
}

/// Checks the symbol of a guest element: its usual spelling, and that it differs from the element that it replaces.
pub fn check_guest(key: &str, guest: &str, host: &str) -> Checked {
    let known = elements::atomic_number(guest).map(elements::symbol);
    if known.ok() != Some(guest) {
        return fault(key, guest, "expected the symbol of an element such as \"In\"");
    }
    match guest == host {
        true => fault(key, guest, "expected another element than the one it replaces"),
        false => Ok(()),
    }
}

/// Converts an error of the crystal to a fault of the key that it comes from.
pub fn crystal_fault(table: &str, error: Error) -> Fault {
    let sibling = |name: &str| match table.rsplit_once('.') {
        Some((parent, _)) => format!("{parent}.{name}"),
        None => name.to_owned(),
    };
    match error {
        Error::Invalid { setting: crate::Setting::Zone, value, expected } => {
            Fault { key: sibling("zone_axis"), value, expected }
        }
        Error::Invalid { setting: crate::Setting::Up, value, expected } => {
            Fault { key: sibling("y_axis"), value, expected }
        }
        Error::Invalid { value, expected, .. } => Fault { key: table.into(), value, expected },
        Error::Parse { path, line, message } => {
            let value = format!("{}:{line}", path.display());
            Fault { key: table.into(), value, expected: message }
        }
        other => Fault { key: table.into(), value: String::new(), expected: other.to_string() },
    }
}
