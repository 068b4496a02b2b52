//! Describes errors of TOML with the keys of recipes.

use serde::de::{Deserializer, Visitor};

use super::atoms_table::AtomsTable;
use super::detector_tables::{DetectorTable, NamedDetectorTable};
use super::optics_table::OpticsTable;
use super::stack_table::{Precipitate, StackDislocation, StackFault, StackLayer, StackTable};
use super::tables::*;
use super::vacancy_groups_table::{DoubleVacancies, StackEdge, VacancyLines};

/// Returns the candidate most similar to `key`, if any is similar.
pub fn nearest<'k>(key: &str, known: impl Iterator<Item = &'k str>) -> Option<&'k str> {
    let scored = known.map(|k| (strsim::jaro_winkler(key, k), k));
    scored.filter(|(score, _)| *score > 0.7).max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, k)| k)
}

/// Returns the dotted key that an error of deserialisation is about, if any, and a message. From serde's list of fields the message
/// suggests the nearest known key.
pub fn explain(error: &toml::de::Error) -> (Option<String>, String) {
    let text = error.to_string();
    let place = text.lines().find_map(|l| l.strip_prefix("in `")?.strip_suffix('`'));
    let quoted: Vec<&str> = error.message().split('`').skip(1).step_by(2).collect();
    let within = |key: &str| place.map_or(key.to_owned(), |place| format!("{place}.{key}"));
    let message = error.message().trim();
    match quoted.split_first() {
        Some((key, known)) if message.starts_with("unknown field") => {
            (Some(within(key)), unknown_key(key, known.iter().copied()))
        }
        Some((key, _)) if message.starts_with("missing field") => {
            (Some(within(key)), message.to_owned())
        }
        _ => {
            let message = message
                .replace("expected f64", "expected a number")
                .replace("expected usize", "expected a whole number")
                .replace("expected u64", "expected a whole number")
                .replace("expected u32", "expected a whole number");
            let message = with_keys(&message);
            let prefix = place.map(|place| format!("{place}: ")).unwrap_or_default();
            (place.map(str::to_owned), prefix + &message)
        }
    }
}

/// Replaces the name of a Rust type in a message with the keys of its table.
fn with_keys(message: &str) -> String {
    let Some((before, name)) = message.split_once("expected struct ") else {
        return message.to_owned();
    };
    let name = name.split_whitespace().next().unwrap_or_default();
    let keys = keys_of(name);
    match keys.is_empty() {
        true => format!("{before}expected a table"),
        false if name == "DetectorTable" => format!(
            "{before}expected a table with the keys {}, or several tables [[detector]] that have a name too",
            keys.join(", ")
        ),
        false => format!("{before}expected a table with the keys {}", keys.join(", ")),
    }
}

/// Refuses all values, and keeps the keys of the table that was asked for. Serde's code to read a table is not compiled for it.
struct KeysOfTable<'k>(&'k mut &'static [&'static str]);

impl<'de> Deserializer<'de> for KeysOfTable<'_> {
    type Error = serde::de::value::Error;

    fn deserialize_any<V: Visitor<'de>>(self, _: V) -> Result<V::Value, Self::Error> {
        Err(serde::de::Error::custom("no table"))
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        keys: &'static [&'static str],
        _: V,
    ) -> Result<V::Value, Self::Error> {
        *self.0 = keys;
        Err(serde::de::Error::custom("keys only"))
    }

    serde::forward_to_deserialize_any! {
        bool i8 i16 i32 i64 u8 u16 u32 u64 f32 f64 char str string bytes byte_buf option unit unit_struct newtype_struct seq tuple
        tuple_struct map enum identifier ignored_any
    }
}

/// Returns the keys of a table of recipes, by the name of its type.
fn keys_of(name: &str) -> &'static [&'static str] {
    fn known<T: serde::de::DeserializeOwned>() -> &'static [&'static str] {
        let mut keys: &'static [&'static str] = &[];
        // It always refuses.
        let _ = T::deserialize(KeysOfTable(&mut keys));
        keys
    }
    match name {
        "Field" => known::<Field>(),
        "Boundaries" => known::<Boundaries>(),
        "DomainTable" => known::<DomainTable>(),
        "Alloy" => known::<Alloy>(),
        "Wells" => known::<Wells>(),
        "Particles" => known::<Particles>(),
        "AtomsTable" => known::<AtomsTable>(),
        "StackTable" => known::<StackTable>(),
        "StackLayer" => known::<StackLayer>(),
        "StackFault" => known::<StackFault>(),
        "StackDislocation" => known::<StackDislocation>(),
        "Precipitate" => known::<Precipitate>(),
        "StackEdge" => known::<StackEdge>(),
        "VacancyLines" => known::<VacancyLines>(),
        "DoubleVacancies" => known::<DoubleVacancies>(),
        "Vacancies" => known::<Vacancies>(),
        "Substitutions" => known::<Substitutions>(),
        "PhononTable" => known::<PhononTable>(),
        "OpticsTable" => known::<OpticsTable>(),
        "DetectorTable" => known::<DetectorTable>(),
        "NamedDetectorTable" => known::<NamedDetectorTable>(),
        "Dose" => known::<Dose>(),
        _ => &[],
    }
}

pub fn unknown_key<'k>(key: &str, known: impl Iterator<Item = &'k str> + Clone) -> String {
    match nearest(key, known.clone()) {
        Some(near) => format!("unknown key `{key}`; did you mean `{near}`?"),
        None => format!("unknown key `{key}`; known: {}", known.collect::<Vec<_>>().join(", ")),
    }
}
