//! Writes the card for people: README.md, whose header (YAML) data hubs read.

use super::card_about::{CardAbout, DataCreator};
use super::card_croissant::{KEYWORDS, description, record_set};
use super::card_markdown::{Markdown, printable, quoted, short, size};
use super::card_tables::{CardField, CardTable, TABLES, WorldLine, detectors};
use super::card_words::{CardWords, counted, probe};

/// Mark in every card that this module writes, and in no other file.
pub(super) const MARK: &str =
    "<!-- Written by stemgen from the world files of this folder, and written anew by it. -->";

/// Description of the contents of a world file.
const SCHEMA: &str = include_str!("card_schema.md");
/// Instructions for loading a world, `WORLD.h5`.
const LOADING: &str = include_str!("card_loading.md");
/// Instructions for loading a table; `RECORDS` stands for its name.
const RECORDS: &str = include_str!("card_records.md");

/// Information about a world beyond its line in the table.
pub(super) struct ReadmeWorld<'a> {
    pub(super) line: WorldLine<'a>,
    /// Path of the world's picture.
    pub(super) picture: String,
    /// Description of the part that a second picture shows, and its path.
    pub(super) part: Option<(&'a str, String)>,
    /// Tables of the world.
    pub(super) tables: Vec<&'static CardTable>,
}

impl ReadmeWorld<'_> {
    fn has(&self, table: &CardTable) -> bool {
        self.tables.iter().any(|t| t.name == table.name)
    }

    fn name(&self) -> String {
        self.line.world.name.clone()
    }

    /// Summarises the contents: `246 vacancies, 1 grain boundary`.
    fn contents(&self) -> String {
        let f = &self.line.world.facts;
        let large = |n: u64| usize::try_from(n).unwrap_or(usize::MAX);
        let all = [
            (large(f.vacancies), "vacancy", "vacancies"),
            (large(f.substitutions), "substitution", "substitutions"),
            (f.particles, "particle", "particles"),
            (f.grain_boundaries, "grain boundary", "grain boundaries"),
            (f.phase_boundaries, "phase boundary", "phase boundaries"),
        ];
        let there = all.into_iter().filter(|(n, ..)| *n > 0);
        let parts: Vec<String> = there.map(|(n, one, many)| counted(n, one, many)).collect();
        if parts.is_empty() { "no defects".into() } else { parts.join(", ") }
    }
}

/// Writes the card.
pub(super) fn readme(about: &CardAbout, words: &CardWords, worlds: &[ReadmeWorld]) -> String {
    let mut page = Markdown::new();
    head(about, words, worlds, &mut page);
    page.paragraph(MARK);
    page.paragraph(format!("# {}", printable(&about.title)));
    // The publisher's text may be Markdown; text from the files may not.
    page.paragraph(description(about, &printable(&words.summary)));
    pictures(worlds, &mut page);
    table_of_worlds(worlds, &mut page);
    loading(worlds, &mut page);
    page.paragraph(SCHEMA.trim_end());
    tables_beside(worlds, &mut page);
    simulation(words, worlds, &mut page);
    commands(worlds, &mut page);
    let lists = [
        ("What it is for", &words.uses),
        ("Biases", &words.biases),
        ("Limits", &words.limitations),
    ];
    for (title, sentences) in lists.into_iter().filter(|(_, list)| !list.is_empty()) {
        page.paragraph(format!("## {title}"));
        page.list(&sentences.iter().map(|s| printable(s)).collect::<Vec<_>>());
    }
    publication(about, words, &mut page);
    page.text()
}

/// Writes the header that data hubs read.
fn head(about: &CardAbout, words: &CardWords, worlds: &[ReadmeWorld], page: &mut Markdown) {
    page.line(format!("---\npretty_name: {}", quoted(&about.title)));
    match about.license.as_ref().map(|license| (license.hub_name, &license.url)) {
        Some((Some(name), _)) => page.line(format!("license: {name}")),
        Some((None, url)) => {
            page.line(format!("license: other\nlicense_name: own\nlicense_link: {}", quoted(url)));
        }
        None => page.line("license: unknown"),
    }
    if words.all_simulated {
        page.line("annotations_creators:\n- machine-generated");
    }
    page.line("task_categories:\n- image-segmentation\n- object-detection");
    let tiles = |w: &ReadmeWorld| w.line.world.facts.tiles.iter().product::<usize>();
    let category = match worlds.iter().map(tiles).sum() {
        0..1000_usize => "n<1K",
        1000..10_000 => "1K<n<10K",
        10_000..100_000 => "10K<n<100K",
        100_000..1_000_000 => "100K<n<1M",
        _ => "n>1M",
    };
    page.line(format!("size_categories:\n- {category}\ntags:"));
    KEYWORDS.iter().for_each(|word| page.line(format!("- {}", quoted(word))));
    page.line("configs:\n- config_name: worlds\n  data_files: worlds.csv\n  default: true");
    for table in TABLES.into_iter().filter(|table| worlds.iter().any(|w| w.has(table))) {
        let name = table.name;
        page.line(format!("- config_name: {name}\n  data_files: {name}/*.csv"));
    }
    page.line("---");
}

/// Adds two pictures in a line: a world and a part of it, or two worlds if no parts are needed.
fn pictures(worlds: &[ReadmeWorld], page: &mut Markdown) {
    let title = |w: &ReadmeWorld| format!("**{}**: {}", w.name(), w.contents());
    let picture = |text: &str, path: &str| format!("![{text}]({path})");
    let whole = |w: &ReadmeWorld| [title(w), picture(&w.name(), &w.picture)];
    let part = |w: &ReadmeWorld| match &w.part {
        Some((text, path)) => [(*text).to_owned(), picture(text, path)],
        None => Default::default(),
    };
    let pairs: Vec<[[String; 2]; 2]> = match worlds.iter().any(|w| w.part.is_some()) {
        true => worlds.iter().map(|w| [whole(w), part(w)]).collect(),
        false => {
            let second = |pair: &[ReadmeWorld]| pair.get(1).map(whole).unwrap_or_default();
            worlds.chunks(2).map(|pair| [whole(&pair[0]), second(pair)]).collect()
        }
    };
    let rows = pairs.into_iter().flat_map(|[left, right]| {
        let ([title, picture], [other, second]) = (left, right);
        [[title, other], [picture, second]]
    });
    let rows: Vec<[String; 2]> = rows.collect();
    if let Some(([left, right], below)) = rows.split_first() {
        page.table([left, right], below.iter().cloned());
    }
    page.paragraph(
        "Rings, or a tint where columns are too small, mark vacancies and substitutions; tints and lines mark phases, boundaries and particles, as the legends say.",
    );
}

fn or_dash<T: ToString>(value: Option<T>) -> String {
    value.map_or_else(|| "-".into(), |v| printable(&v.to_string()))
}

fn table_of_worlds(worlds: &[ReadmeWorld], page: &mut Markdown) {
    page.paragraph("## The worlds");
    page.paragraph(
        "Fields are height x width, tiles rows x columns, doses in electrons per square Angstrom.",
    );
    let head = [
        "world",
        "material",
        "difficulty",
        "seed",
        "field (nm)",
        "tiles",
        "pixel (nm)",
        "dose",
        "sites",
        "defects",
    ];
    let row = |w: &ReadmeWorld| {
        let f = &w.line.world.facts;
        let noise = if f.noise == Some(false) { " (no noise)" } else { "" };
        [
            w.name(),
            or_dash(f.material.as_ref()),
            or_dash(f.tier.map(|t| t.name())),
            or_dash(f.seed),
            f.fov_nm.map(|nm| short(nm, 2)).join(" x "),
            f.tiles.map(|n| n.to_string()).join(" x "),
            short(f.pixel_size_nm, 5),
            or_dash(f.dose_electrons_per_angstrom2) + noise,
            f.sites.to_string(),
            w.contents(),
        ]
    };
    page.table(head, worlds.iter().map(row));
    let row = |w: &ReadmeWorld| {
        [w.line.world.file_name(), size(w.line.bytes), format!("`{}`", w.line.sha256)]
    };
    page.table(["file", "size", "SHA-256"], worlds.iter().map(row));
    page.paragraph(
        "[worlds.csv](worlds.csv) tells more of each world; [croissant.json](croissant.json) lists all files with \
         their SHA-256.",
    );
}

fn loading(worlds: &[ReadmeWorld], page: &mut Markdown) {
    let Some(first) = worlds.first() else { return };
    page.paragraph(LOADING.trim_end().replace("WORLD.h5", &first.line.world.file_name()));
    if let Some(table) = TABLES.into_iter().find(|table| first.has(table)) {
        let set = record_set(table, &first.name());
        page.paragraph(RECORDS.trim_end().replace("RECORDS", &set));
    }
}

fn tables_beside(worlds: &[ReadmeWorld], page: &mut Markdown) {
    page.paragraph("### The tables beside");
    for one in TABLES {
        let with = worlds.iter().filter(|w| w.has(one)).count();
        if with == 0 {
            continue;
        }
        let of = if with == worlds.len() { "of every world" } else { "of worlds that have some" };
        page.paragraph(format!("`{}/WORLD.csv`, {of}: {}", one.name, one.text));
        let row = |f: &CardField| [format!("`{}`", f.name), printable(f.text)];
        page.table(["column", "what"], one.fields.iter().map(row));
    }
}

fn simulation(words: &CardWords, worlds: &[ReadmeWorld], page: &mut Markdown) {
    page.paragraph("## How it was made");
    page.paragraph(printable(&words.collection));
    let head = [
        "world",
        "engine",
        "probe",
        "detectors (mrad)",
        "thickness (nm)",
        "phonon configurations",
        "audit",
    ];
    let row = |w: &ReadmeWorld| {
        let f = &w.line.world.facts;
        let audit = f.audit.as_ref().map(|a| a.bright_rms_percent).filter(|p| p.is_finite());
        [
            w.name(),
            or_dash(f.engine.as_ref()),
            or_dash(probe(w.line.world)),
            printable(&detectors(w.line.world)),
            or_dash(f.thickness_nm.map(|t| short(t, 2))),
            or_dash(f.phonon_configurations),
            or_dash(audit.map(|p| format!("{p:.2} %"))),
        ]
    };
    page.table(head, worlds.iter().map(row));
    page.paragraph(
        "The audit is the rms error at bright columns, in random regions, against multislice without shortcuts.",
    );
    page.paragraph(printable(&words.raw));
    let values = words.preprocessing.iter().chain([&words.missing]);
    page.list(&values.map(|s| printable(s)).collect::<Vec<_>>());
    if words.all_simulated {
        page.paragraph(printable(&words.annotation));
    }
}

fn commands(worlds: &[ReadmeWorld], page: &mut Markdown) {
    let all: Vec<&str> = worlds.iter().filter_map(|w| w.line.world.command.as_deref()).collect();
    if !all.is_empty() {
        page.paragraph("### Making it again");
        let recipes = worlds.iter().any(|w| w.line.world.recipe_text.is_some());
        let recipes = if recipes { " to which `recipes/` is copied" } else { "" };
        page.paragraph(format!("With the same version of stemgen, in another folder{recipes}:"));
        page.code("sh", &all.join("\n"));
        let note = |w: &ReadmeWorld| {
            Some(format!("{}: {}.", w.name(), printable(w.line.world.note.as_ref()?)))
        };
        let notes: Vec<String> = worlds.iter().filter_map(note).collect();
        if !notes.is_empty() {
            page.paragraph(
                "Where the result may differ, as the program says that wrote this card:",
            );
            page.list(&notes);
        }
    }
}

fn publication(about: &CardAbout, words: &CardWords, page: &mut Markdown) {
    page.paragraph("## Licence, authors, version");
    let license = match &about.license {
        Some(license) if license.name == license.url => format!("<{}>", license.url),
        Some(license) => format!("[{}]({})", license.name, license.url),
        None => "not stated".into(),
    };
    let mut lines = vec![format!("Licence: {license}.")];
    let names: Vec<String> = about.creators.iter().map(DataCreator::name).map(printable).collect();
    if !names.is_empty() {
        lines.push(format!("By {}.", names.join(", ")));
    }
    let day = about.published.as_ref().map(|day| format!(", published on {day}"));
    lines.push(format!("Version {}{}.", about.version, day.unwrap_or_default()));
    lines.extend(about.url.as_ref().map(|url| format!("Page: <{url}>")));
    lines.push(format!("Personal or sensitive information: {}", words.personal));
    lines.push(format!("Impact on people: {}", words.social));
    lines.push(printable(&words.maintenance));
    page.list(&lines);
    if let Some(citation) = &about.citation {
        page.paragraph("To be cited as:");
        page.code("", citation);
    }
}
