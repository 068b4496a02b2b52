//! Information that the publisher gives about a folder of worlds.

use crate::error::{Error, Result};
use crate::setting::Setting;

/// Licences that data hubs know: the SPDX name, and the hubs' name.
const KNOWN: [(&str, &str); 19] = [
    ("CC0-1.0", "cc0-1.0"),
    ("CC-BY-3.0", "cc-by-3.0"),
    ("CC-BY-4.0", "cc-by-4.0"),
    ("CC-BY-SA-3.0", "cc-by-sa-3.0"),
    ("CC-BY-SA-4.0", "cc-by-sa-4.0"),
    ("CC-BY-NC-4.0", "cc-by-nc-4.0"),
    ("CC-BY-ND-4.0", "cc-by-nd-4.0"),
    ("CC-BY-NC-SA-4.0", "cc-by-nc-sa-4.0"),
    ("CC-BY-NC-ND-4.0", "cc-by-nc-nd-4.0"),
    ("CDLA-Permissive-1.0", "cdla-permissive-1.0"),
    ("CDLA-Permissive-2.0", "cdla-permissive-2.0"),
    ("CDLA-Sharing-1.0", "cdla-sharing-1.0"),
    ("ODC-By-1.0", "odc-by"),
    ("ODbL-1.0", "odbl"),
    ("PDDL-1.0", "pddl"),
    ("MIT", "mit"),
    ("Apache-2.0", "apache-2.0"),
    ("BSD-2-Clause", "bsd-2-clause"),
    ("BSD-3-Clause", "bsd-3-clause"),
];

/// A licence.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DataLicense {
    /// SPDX name of the licence, or its address.
    pub name: String,
    /// Address of the licence's text.
    pub url: String,
    /// Name of the licence on data hubs; `None` if they do not know it.
    pub hub_name: Option<&'static str>,
}

impl DataLicense {
    /// Reads the SPDX name of a licence, in any case, or the address of a licence.
    ///
    /// # Errors
    /// [`Error::Invalid`] for another text.
    pub fn parse(text: &str) -> Result<Self> {
        let text = text.trim();
        if let Some((name, hub)) = KNOWN.iter().find(|(name, _)| name.eq_ignore_ascii_case(text)) {
            let url = format!("https://spdx.org/licenses/{name}.html");
            return Ok(DataLicense { name: (*name).into(), url, hub_name: Some(hub) });
        }
        if is_address(text) {
            return Ok(DataLicense { name: text.into(), url: text.into(), hub_name: None });
        }
        let names: Vec<&str> = KNOWN.iter().map(|(name, _)| *name).collect();
        let expected = format!(
            "expected the address of a licence (https://...), or one of {}",
            names.join(", ")
        );
        Err(Error::invalid(Setting::Card, text, expected))
    }
}

/// The author of the worlds.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum DataCreator {
    /// A person, by name.
    Person(String),
    /// An organization, by name.
    Organization(String),
}

impl DataCreator {
    /// Returns the name.
    pub(crate) fn name(&self) -> &str {
        match self {
            DataCreator::Person(name) | DataCreator::Organization(name) => name,
        }
    }
}

/// Information that the publisher gives about a folder of worlds. Information that is not given is left out of the card, since nobody else
/// has it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CardAbout {
    /// Title of the folder.
    pub title: String,
    /// Description in a sentence or two; the information from the files follows it.
    pub description: Option<String>,
    /// Licence of the data.
    pub license: Option<DataLicense>,
    /// Authors of the data.
    pub creators: Vec<DataCreator>,
    /// Address of the data's page.
    pub url: Option<String>,
    /// Day of publication, `2026-11-23`.
    pub published: Option<String>,
    /// Version of the data, `1.0.0`.
    pub version: String,
    /// Citation of the data.
    pub citation: Option<String>,
}

impl CardAbout {
    /// Describes a folder of worlds by its title and version 1.0.0 alone.
    pub fn new(title: &str) -> Self {
        CardAbout {
            title: title.to_owned(),
            description: None,
            license: None,
            creators: Vec::new(),
            url: None,
            published: None,
            version: "1.0.0".into(),
            citation: None,
        }
    }

    /// Returns the properties that Croissant requires or recommends, and that were not given.
    pub(crate) fn missing(&self) -> Vec<&'static str> {
        let said = [
            ("license", self.license.is_some()),
            ("creator", !self.creators.is_empty()),
            ("url", self.url.is_some()),
            ("datePublished", self.published.is_some()),
            ("citeAs", self.citation.is_some()),
        ];
        said.into_iter().filter(|(_, there)| !there).map(|(name, _)| name).collect()
    }

    /// Checks the given information.
    ///
    /// # Errors
    /// [`Error::Invalid`] for an empty or unprintable text, or an invalid address, date or version.
    pub fn check(&self) -> Result<()> {
        let fault =
            |value: &str, expected: &str| Err(Error::invalid(Setting::Card, value, expected));
        let names = self.creators.iter().map(DataCreator::name).chain([self.title.as_str()]);
        for name in names {
            if name.trim().is_empty() || name.chars().any(char::is_control) {
                return fault(&format!("{name:?}"), "a title or a name has letters, on one line");
            }
        }
        let texts = [&self.description, &self.citation].into_iter().flatten();
        for text in texts {
            if text.chars().any(|c| c.is_control() && c != '\n') {
                return fault(&format!("{text:?}"), "expected plain text");
            }
        }
        if let Some(url) = self.url.as_deref().filter(|url| !is_address(url)) {
            return fault(url, "expected an address such as https://example.org/worlds");
        }
        if let Some(date) = self.published.as_deref().filter(|date| !is_date(date)) {
            return fault(date, "expected a day as 2026-11-23");
        }
        if !is_version(&self.version) {
            return fault(&self.version, "expected a version of three numbers, 1.0.0");
        }
        Ok(())
    }
}

fn is_address(text: &str) -> bool {
    let rest = text.strip_prefix("https://").or_else(|| text.strip_prefix("http://"));
    let plain = |c: char| c.is_ascii_graphic() && !"\"<>\\^`{|}".contains(c);
    rest.is_some_and(|rest| rest.len() > 2 && rest.chars().all(plain))
}

/// Whether a text is a calendar date, year first.
fn is_date(text: &str) -> bool {
    let digits = |part: &str, n: usize| part.len() == n && part.bytes().all(|b| b.is_ascii_digit());
    let parts: Vec<&str> = text.split('-').collect();
    let [year, month, day] = parts[..] else { return false };
    if !(digits(year, 4) && digits(month, 2) && digits(day, 2)) {
        return false;
    }
    let number = |part: &str| part.parse::<u32>().unwrap_or_default();
    let leap = |y: u32| (y.is_multiple_of(4) && !y.is_multiple_of(100)) || y.is_multiple_of(400);
    let days = match number(month) {
        2 if leap(number(year)) => 29,
        2 => 28,
        4 | 6 | 9 | 11 => 30,
        1..=12 => 31,
        _ => return false,
    };
    (1..=days).contains(&number(day))
}

fn is_version(text: &str) -> bool {
    let plain = |part: &str| {
        let zero = part.len() > 1 && part.starts_with('0');
        (1..=9).contains(&part.len()) && part.bytes().all(|b| b.is_ascii_digit()) && !zero
    };
    text.split('.').count() == 3 && text.split('.').all(plain)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn licences_have_names_and_addresses() {
        let known = DataLicense::parse("cc-by-4.0").unwrap();
        assert_eq!((known.name.as_str(), known.hub_name), ("CC-BY-4.0", Some("cc-by-4.0")));
        assert_eq!(known.url, "https://spdx.org/licenses/CC-BY-4.0.html");
        let own = DataLicense::parse("https://example.org/my-licence").unwrap();
        assert_eq!((own.hub_name, own.url.as_str()), (None, "https://example.org/my-licence"));
        let message = DataLicense::parse("free").unwrap_err().to_string();
        assert!(message.contains("CC-BY-4.0") && message.contains("https://"), "{message}");
    }

    #[test]
    fn what_is_said_is_checked() {
        let about = CardAbout::new("Worlds");
        about.check().unwrap();
        assert_eq!(about.missing(), ["license", "creator", "url", "datePublished", "citeAs"]);
        let fails = |change: fn(&mut CardAbout)| {
            let mut about = CardAbout::new("Worlds");
            change(&mut about);
            about.check().is_err()
        };
        assert!(fails(|a| a.title = " ".into()));
        assert!(fails(|a| a.title = "a\nb".into()));
        assert!(fails(|a| a.creators = vec![DataCreator::Person("\u{7}".into())]));
        assert!(fails(|a| a.url = Some("example.org".into())));
        assert!(fails(|a| a.version = "1.0".into()));
        assert!(fails(|a| a.version = "1.00.0".into()));
        assert!(fails(|a| a.published = Some("2026-02-29".into())));
        assert!(fails(|a| a.published = Some("23.11.2026".into())));
        assert!(is_date("2024-02-29") && is_date("2000-02-29") && !is_date("1900-02-29"));
    }
}
