//! Changes of a recipe's values from outside: `vacancies.rate=0.02`.

use crate::error::{Error, Result};
use std::str::FromStr;
use toml::{Table, Value};

/// A dotted key and its new TOML value; `None` removes the key.
#[derive(Debug, Clone, PartialEq)]
pub struct Override {
    text: String,
    keys: Vec<String>,
    value: Option<Value>,
}

impl FromStr for Override {
    type Err = Error;

    /// Reads `key=value`. A value that is no TOML is taken as a string, since shells remove quotes.
    fn from_str(text: &str) -> Result<Self> {
        let wrong = |message: &str| Err(Error::set(text, message));
        let Some((key, value)) = text.split_once('=') else {
            return wrong("write key=value, such as vacancies.rate=0.02");
        };
        let keys = dotted(text, key)?;
        let value = value.trim();
        if value.is_empty() || value.contains(['\n', '\r']) {
            return wrong("the value is missing, or longer than a line");
        }
        let parsed = toml::from_str::<Table>(&format!("v = {value}"));
        let value = parsed.ok().and_then(|mut table| table.remove("v"));
        let value = value.unwrap_or_else(|| Value::String(value_text(text)));
        Ok(Override { text: text.to_owned(), keys, value: Some(value) })
    }
}

/// Splits a dotted key into its names.
fn dotted(text: &str, key: &str) -> Result<Vec<String>> {
    let keys: Vec<String> =
        key.split('.').map(|k| k.trim().trim_matches(['"', '\'']).to_owned()).collect();
    let plain = |k: &String| {
        !k.is_empty() && k.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-')
    };
    match keys.iter().all(plain) {
        true => Ok(keys),
        false => Err(Error::set(
            text,
            "the key is made of names with dots between, such as vacancies.rate",
        )),
    }
}

/// Returns the text after the `=`.
fn value_text(text: &str) -> String {
    text.split_once('=').map_or("", |(_, value)| value).trim().to_owned()
}

impl Override {
    /// Makes a change that removes a value or a table from a recipe.
    ///
    /// # Errors
    /// [`Error::Set`] for a text that is no key.
    pub fn without(key: &str) -> Result<Self> {
        Ok(Override { text: key.to_owned(), keys: dotted(key, key)?, value: None })
    }

    /// Applies the change to a table: tables are merged, other values replaced.
    ///
    /// # Errors
    /// [`Error::Set`] for removing a key that the table does not hold.
    pub(super) fn apply(&self, table: &mut Table) -> Result<()> {
        let Some(value) = &self.value else { return self.remove(table) };
        let nested = self.keys.iter().rev().fold(value.clone(), |value, key| {
            Value::Table(Table::from_iter([(key.clone(), value)]))
        });
        if let Value::Table(nested) = nested {
            merge(table, nested);
        }
        Ok(())
    }

    fn remove(&self, table: &mut Table) -> Result<()> {
        let Some((last, path)) = self.keys.split_last() else { return Ok(()) };
        let inner = path.iter().try_fold(table, |t, key| t.get_mut(key)?.as_table_mut());
        match inner.and_then(|t| t.remove(last)) {
            Some(_) => Ok(()),
            None => {
                Err(self.error("the recipe does not contain this key, so it cannot be removed"))
            }
        }
    }

    /// Whether the change sets `key` (dotted), a table that holds it, or a part of it.
    pub(super) fn concerns(&self, key: &str) -> bool {
        let own = self.keys.join(".");
        let within = |whole: &str, part: &str| {
            part.strip_prefix(whole).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
        };
        within(&own, key) || within(key, &own)
    }

    /// Returns an error that names this change.
    pub(super) fn error(&self, message: impl Into<String>) -> Error {
        Error::set(&self.text, message)
    }
}

/// Merges `over` into `base`, table by table; its values replace the values of `base`.
pub(crate) fn merge(base: &mut toml::Table, over: toml::Table) {
    for (key, value) in over {
        match (base.get_mut(&key), value) {
            (Some(toml::Value::Table(inner)), toml::Value::Table(more)) => merge(inner, more),
            (_, value) => drop(base.insert(key, value)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recipe::{Difficulty, Recipe};

    fn parsed(text: &str) -> (Vec<String>, Value) {
        let change: Override = text.parse().unwrap();
        (change.keys, change.value.unwrap())
    }

    #[test]
    fn values_are_toml_or_plain_words() {
        assert_eq!(parsed("seed = 7"), (vec!["seed".into()], Value::Integer(7)));
        let keys = vec!["a".to_owned(), "Ti-O".to_owned()];
        assert_eq!(parsed("a.\"Ti-O\"=1.5"), (keys, Value::Float(1.5)));
        assert_eq!(parsed("e=\"O\"").1, Value::String("O".into()));
        assert_eq!(parsed("e=O").1, Value::String("O".into()));
        assert_eq!(parsed("g=[2, 3]").1, Value::Array(vec![2.into(), 3.into()]));
        assert_eq!(parsed("t=a=b").1, Value::String("a=b".into()));
        for bad in ["", "seed", "=3", "a..b=3", "a b=3", "a=", "a=1\nb=2"] {
            assert!(bad.parse::<Override>().is_err(), "{bad}");
        }
    }

    #[test]
    fn they_are_laid_over_a_table() {
        let mut table: Table = toml::from_str("[v]\nrate = 1\nelement = \"O\"").unwrap();
        parsed_over("v.rate=2", &mut table);
        parsed_over("v={cap=3}", &mut table);
        let expected = "[v]\nrate = 2\nelement = \"O\"\ncap = 3";
        assert_eq!(table, toml::from_str::<Table>(expected).unwrap());
    }

    #[test]
    fn values_and_tables_can_be_taken_away() {
        let recipe = Recipe::load("srtio3", Difficulty::Easy).unwrap();
        let without = |key: &str| recipe.with_overrides(&[Override::without(key).unwrap()]);
        assert!(without("vacancies").unwrap().vacancies.is_none());
        assert!(without("boundaries.sigma").unwrap().boundaries.unwrap().sigma.is_none());
        for (key, part) in
            [("vacancies.rat", "does not contain this key"), ("seed", "missing field `seed`")]
        {
            let message = without(key).unwrap_err().to_string();
            assert!(message.starts_with(key) && message.contains(part), "{message}");
        }
    }

    fn parsed_over(text: &str, table: &mut Table) {
        text.parse::<Override>().unwrap().apply(table).unwrap();
    }

    #[test]
    fn the_one_at_fault_is_found() {
        let change: Override = "v.w={rate=2}".parse().unwrap();
        for key in ["v.w.rate", "v.w", "v"] {
            assert!(change.concerns(key), "{key}");
        }
        assert!(!change.concerns("v.ww.rate") && !change.concerns("w"));
    }

    fn overridden(changes: &[&str]) -> crate::Result<Recipe> {
        let changes: Vec<Override> =
            changes.iter().map(|c| c.parse()).collect::<crate::Result<_>>()?;
        let recipe = Recipe::load("srtio3", Difficulty::Easy).unwrap().with_overrides(&changes)?;
        Ok(recipe.checked()?.recipe().clone())
    }

    #[test]
    fn values_can_be_changed_one_by_one() {
        let changes = ["vacancies.rate=0.02", "dose.electrons_per_angstrom2=700", "seed=9"];
        let recipe = overridden(&changes).unwrap();
        let vacancies = recipe.vacancies.as_ref().unwrap();
        assert_eq!((vacancies.rate, vacancies.cluster_fraction), (0.02, 0.6));
        assert_eq!((recipe.dose.electrons_per_angstrom2, recipe.seed), (700.0, 9));
        assert_eq!(Recipe::from_toml_str("copy", &recipe.to_toml(), None).unwrap(), recipe);
        let last =
            overridden(&["seed=3", "vacancies={rate=0.1, element=\"Ti\"}", "seed=4"]).unwrap();
        let vacancies = last.vacancies.as_ref().unwrap();
        assert_eq!((last.seed, vacancies.rate, vacancies.element.as_str()), (4, 0.1, "Ti"));
    }

    #[test]
    fn changes_that_do_not_fit_are_named() {
        let cases: [(&[&str], &[&str]); 12] = [
            (&["boundaries=[1,1]"], &["boundaries=[1,1]: ", "expected a table"]),
            (&["dose=100"], &["dose=100: ", "a table with the keys electrons_per_angstrom2"]),
            (
                &["phonons=4"],
                &["a table with the keys configurations, library_seed, sigma_angstrom"],
            ),
            (&["vacancies.rat=0.1", "seed=2"], &["vacancies.rat=0.1: ", "did you mean `rate`?"]),
            (&["vacances.rate=0.1"], &["did you mean `vacancies`?"]),
            (&["seed=2", "vacancies.rate=abc", "field.grid=[40, 40]"], &["vacancies.rate=abc: "]),
            (&["boundaries.count=1.5"], &["boundaries.count", "expected a whole number"]),
            (&["vacancies.rate=-1", "seed=2"], &["vacancies.rate=-1: ", "from 0", "to 0.25"]),
            (&["vacancies=3"], &["vacancies=3: "]),
            (&["field.grid=[2]"], &["field.grid=[2]: ", "length 2"]),
            (&["vacancies.max_probability=0.01"], &["vacancies.rate = 0.05"]),
            (&["vacancies"], &["write key=value"]),
        ];
        for (changes, parts) in cases {
            let message = overridden(changes).unwrap_err().to_string();
            for part in parts {
                assert!(message.contains(part), "{changes:?}: no `{part}` in {message}");
            }
        }
    }
}
