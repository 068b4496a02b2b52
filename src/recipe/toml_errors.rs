//! Errors of TOML in the words of recipes.

/// The candidate most like `key`, if any is similar.
pub fn nearest<'k>(key: &str, known: impl Iterator<Item = &'k str>) -> Option<&'k str> {
    let scored = known.map(|k| (strsim::jaro_winkler(key, k), k));
    scored.filter(|(score, _)| *score > 0.7).max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, k)| k)
}

/// The dotted key that an error of deserialisation is about, if any, and what to say of it; serde's
/// list of fields yields the nearest known key.
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
            let prefix = place.map(|place| format!("{place}: ")).unwrap_or_default();
            (place.map(str::to_owned), prefix + &message)
        }
    }
}

pub fn unknown_key<'k>(key: &str, known: impl Iterator<Item = &'k str> + Clone) -> String {
    match nearest(key, known.clone()) {
        Some(near) => format!("unknown key `{key}`; did you mean `{near}`?"),
        None => format!("unknown key `{key}`; known: {}", known.collect::<Vec<_>>().join(", ")),
    }
}
