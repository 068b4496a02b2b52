//! Writes the card for programs: Croissant 1.1 (JSON-LD) with the fields of the RAI vocabulary 1.0.
//!
//! <https://docs.mlcommons.org/croissant/docs/croissant-spec-1.1.html>,
//! <https://docs.mlcommons.org/croissant/docs/croissant-rai-spec.html>.

use serde_json::{Map, Value, json};

use super::card_about::{CardAbout, DataCreator};
use super::card_tables::{CardField, CardTable, WORLD_FIELDS};
use super::card_words::CardWords;
use super::card_writer::CardFile;

/// The JSON-LD context that Croissant 1.1 recommends, and the vocabulary of provenance.
const CONTEXT: &str = r#"{
    "@language": "en",
    "@vocab": "https://schema.org/",
    "arrayShape": "cr:arrayShape",
    "citeAs": "cr:citeAs",
    "column": "cr:column",
    "conformsTo": "dct:conformsTo",
    "containedIn": "cr:containedIn",
    "cr": "http://mlcommons.org/croissant/",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "dct": "http://purl.org/dc/terms/",
    "description": {"@container": "@language"},
    "equivalentProperty": "cr:equivalentProperty",
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "extract": "cr:extract",
    "field": "cr:field",
    "fileObject": "cr:fileObject",
    "fileProperty": "cr:fileProperty",
    "fileSet": "cr:fileSet",
    "format": "cr:format",
    "includes": "cr:includes",
    "isArray": "cr:isArray",
    "isLiveDataset": "cr:isLiveDataset",
    "jsonPath": "cr:jsonPath",
    "key": "cr:key",
    "md5": "cr:md5",
    "name": {"@container": "@language"},
    "parentField": "cr:parentField",
    "path": "cr:path",
    "prov": "http://www.w3.org/ns/prov#",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "recordSet": "cr:recordSet",
    "references": "cr:references",
    "regex": "cr:regex",
    "repeated": "cr:repeated",
    "replace": "cr:replace",
    "samplingRate": "cr:samplingRate",
    "sc": "https://schema.org/",
    "separator": "cr:separator",
    "source": "cr:source",
    "subField": "cr:subField",
    "transform": "cr:transform"
}"#;

/// Keywords for searches.
pub(super) const KEYWORDS: [&str; 7] = [
    "electron microscopy",
    "STEM",
    "HAADF",
    "atomic resolution",
    "materials science",
    "point defects",
    "ground truth",
];

/// A table of a world in its file.
pub(super) struct RecordSource<'a> {
    pub(super) table: &'static CardTable,
    pub(super) world: &'a str,
}

/// Writes the card: `files` are all files of the folder except croissant.json and README.md.
pub(super) fn croissant(
    about: &CardAbout,
    words: &CardWords,
    files: &[CardFile],
    tables: &[RecordSource],
) -> String {
    let mut all = Map::new();
    let mut put = |name: &str, value: Value| drop(all.insert(name.to_owned(), value));
    put("@context", serde_json::from_str(CONTEXT).unwrap_or_default());
    put("@type", json!("sc:Dataset"));
    let standards =
        ["http://mlcommons.org/croissant/1.1", "http://mlcommons.org/croissant/RAI/1.0"];
    put("conformsTo", json!(standards));
    put("name", json!(about.title));
    put("description", json!(description(about, &words.summary)));
    put("version", json!(about.version));
    put("keywords", json!(KEYWORDS));
    put("isLiveDataset", json!(false));
    if let Some(license) = &about.license {
        put("license", json!(license.url));
    }
    if !about.creators.is_empty() {
        put("creator", about.creators.iter().map(creator).collect());
    }
    let texts =
        [("url", &about.url), ("datePublished", &about.published), ("citeAs", &about.citation)];
    for (name, text) in texts.into_iter().filter(|(_, text)| text.is_some()) {
        put(name, json!(text));
    }
    responsible(words).into_iter().for_each(|(name, value)| put(&format!("rai:{name}"), value));
    put("distribution", files.iter().map(file_object).collect());
    let sets = tables.iter().map(|t| records_of_world(t));
    put("recordSet", std::iter::once(records_of_worlds()).chain(sets).collect());
    // Strings, numbers and maps with string keys can always be written.
    serde_json::to_string_pretty(&Value::Object(all)).unwrap_or_default() + "\n"
}

/// Joins the publisher's description and the summary of the files.
pub(super) fn description(about: &CardAbout, summary: &str) -> String {
    match &about.description {
        Some(own) => format!("{own}\n\n{summary}"),
        None => summary.to_owned(),
    }
}

fn creator(creator: &DataCreator) -> Value {
    let kind = match creator {
        DataCreator::Person(_) => "Person",
        DataCreator::Organization(_) => "Organization",
    };
    json!({ "@type": kind, "name": creator.name() })
}

/// Returns the fields of the RAI vocabulary.
fn responsible(words: &CardWords) -> Vec<(&'static str, Value)> {
    let mut fields = vec![
        ("dataCollection", json!(words.collection)),
        ("dataCollectionMissingData", json!(words.missing)),
        ("dataCollectionRawData", json!(words.raw)),
        ("dataPreprocessingProtocol", json!(words.preprocessing)),
        ("dataBiases", json!(words.biases)),
        ("dataLimitations", json!(words.limitations)),
        ("dataUseCases", json!(words.uses)),
        ("dataSocialImpact", json!(words.social)),
        ("personalSensitiveInformation", json!([words.personal])),
        ("dataReleaseMaintenancePlan", json!(words.maintenance)),
    ];
    if words.all_simulated {
        fields.extend([
            ("hasSyntheticData", json!(true)),
            ("dataCollectionType", json!(["Others: numerical simulation"])),
            ("dataAnnotationProtocol", json!([words.annotation])),
            ("annotationsPerItem", json!("None by people; one exact label for each atomic site.")),
            ("machineAnnotationTools", json!(words.tools)),
        ]);
    }
    fields.retain(|(_, value)| value.as_array().is_none_or(|list| !list.is_empty()));
    fields
}

fn file_object(file: &CardFile) -> Value {
    let name = file.path.rsplit('/').next().unwrap_or_default();
    let mut object = json!({
        "@type": "cr:FileObject",
        "@id": file.path,
        "name": name,
        "description": file.text,
        "contentUrl": file.path,
        "contentSize": format!("{} B", file.bytes),
        "encodingFormat": file.media_type,
        "sha256": file.sha256,
    });
    if let Some(command) = &file.command {
        object["prov:wasGeneratedBy"] = json!({ "@type": "prov:Activity", "prov:label": command });
    }
    object
}

/// Returns the name of the record set of a world's table.
pub(super) fn record_set(table: &CardTable, world: &str) -> String {
    format!("{}_{world}", table.name)
}

fn records_of_worlds() -> Value {
    let fields = WORLD_FIELDS.iter().map(|f| record_field("worlds", "worlds.csv", &f.field));
    json!({
        "@type": "cr:RecordSet",
        "@id": "worlds",
        "name": "worlds",
        "description": "One line for each world.",
        "key": { "@id": "worlds/world" },
        "field": fields.collect::<Vec<_>>(),
    })
}

fn records_of_world(source: &RecordSource) -> Value {
    let (set, path) = (record_set(source.table, source.world), source.table.path(source.world));
    let field = |f: &CardField| {
        let mut field = record_field(&set, &path, f);
        if f.name == "world" {
            field["references"] = json!({ "field": { "@id": "worlds/world" } });
        }
        field
    };
    json!({
        "@type": "cr:RecordSet",
        "@id": set,
        "name": set,
        "description": format!("{} Of the world {}.", source.table.text, source.world),
        "key": { "@id": format!("{set}/{}", source.table.key) },
        "field": source.table.fields.iter().map(field).collect::<Vec<_>>(),
    })
}

fn record_field(set: &str, file: &str, field: &CardField) -> Value {
    json!({
        "@type": "cr:Field",
        "@id": format!("{set}/{}", field.name),
        "name": field.name,
        "description": field.text,
        "dataType": field.kind.croissant(),
        "source": { "fileObject": { "@id": file }, "extract": { "column": field.name } },
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_context_is_json() {
        let context: Value = serde_json::from_str(CONTEXT).unwrap();
        assert_eq!(context["rai"], "http://mlcommons.org/croissant/RAI/");
    }
}
