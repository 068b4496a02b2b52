//! Tables beside the worlds, as CSV: the contents of their columns, and their writers.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

use super::card_world::CardWorld;
use crate::error::{Error, Result};
use crate::io::{GroundTruth, WorldFile, atom_type};
use crate::progress::Progress;
use crate::structure::elements;

/// Types of values, as Croissant names them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum CardType {
    Text,
    Integer,
    Float32,
    Float64,
    Boolean,
}

impl CardType {
    /// Returns the name in Croissant.
    pub(super) fn croissant(self) -> &'static str {
        match self {
            CardType::Text => "sc:Text",
            CardType::Integer => "sc:Integer",
            CardType::Float32 => "cr:Float32",
            CardType::Float64 => "cr:Float64",
            CardType::Boolean => "sc:Boolean",
        }
    }
}

/// A column of a table.
pub(super) struct CardField {
    pub(super) name: &'static str,
    pub(super) kind: CardType,
    pub(super) text: &'static str,
}

const fn field(name: &'static str, kind: CardType, text: &'static str) -> CardField {
    CardField { name, kind, text }
}

/// A kind of table, of which each world has one.
pub(super) struct CardTable {
    /// Folder of the tables, and prefix of the names of their record sets.
    pub(super) name: &'static str,
    /// Description of a line.
    pub(super) text: &'static str,
    /// Column that identifies a line.
    pub(super) key: &'static str,
    pub(super) fields: &'static [CardField],
    write: fn(&WorldFile, &str, &mut CsvFile, &dyn Progress) -> Result<()>,
}

impl CardTable {
    /// Returns the path of a world's table.
    pub(super) fn path(&self, world: &str) -> String {
        format!("{}/{world}.csv", self.name)
    }
}

const WORLD: CardField =
    field("world", CardType::Text, "name of the world's file without its ending");
const X: CardField =
    field("x_nm", CardType::Float32, "x in nm from the centre of pixel (0, 0); grows to the right");
const Y: CardField =
    field("y_nm", CardType::Float32, "y in nm from the centre of pixel (0, 0); grows downwards");
const Z: CardField = field(
    "z_nm",
    CardType::Float32,
    "depth in nm from the entrance surface; empty where the file has none",
);

/// The table of atomic columns.
pub(super) const COLUMNS: CardTable = CardTable {
    name: "columns",
    text: "One line for each atomic column.",
    key: "column",
    fields: &[
        WORLD,
        field("column", CardType::Integer, "index in /ground_truth/columns, from 0"),
        X,
        Y,
        field("sites", CardType::Integer, "lattice sites in the column, vacant ones too"),
        field("vacancies", CardType::Integer, "how many of them are vacant"),
        field("substitutions", CardType::Integer, "how many of them hold another element"),
        field(
            "composition",
            CardType::Text,
            "the atoms that are there, such as O25 Ti26; empty for none",
        ),
    ],
    write: columns,
};

/// The table of point defects.
pub(super) const DEFECTS: CardTable = CardTable {
    name: "defects",
    text: "One line for each vacancy or substitution.",
    key: "site",
    fields: &[
        WORLD,
        field("site", CardType::Integer, "index in the lists of /ground_truth, from 0"),
        field(
            "column",
            CardType::Integer,
            "index of its column; empty where the file does not tell",
        ),
        X,
        Y,
        Z,
        field("type", CardType::Text, "vacancy or substitution"),
        field(
            "element",
            CardType::Text,
            "the element that is there; of a vacancy the one that is missing",
        ),
    ],
    write: defects,
};

/// The table of particles.
pub(super) const PARTICLES: CardTable = CardTable {
    name: "particles",
    text: "One line for each particle that reaches into the image.",
    key: "particle",
    fields: &[
        WORLD,
        field("particle", CardType::Integer, "index in /ground_truth/particles, from 0"),
        X,
        Y,
        Z,
        field("diameter_nm", CardType::Float32, "diameter in nm"),
        field("morphology", CardType::Text, "its shape"),
        field("qw", CardType::Float32, "unit quaternion from the particle to the field: w"),
        field("qx", CardType::Float32, "the same: x"),
        field("qy", CardType::Float32, "the same: y"),
        field("qz", CardType::Float32, "the same: z"),
    ],
    write: particles,
};

/// All kinds of tables of a world.
pub(super) const TABLES: [&CardTable; 3] = [&COLUMNS, &DEFECTS, &PARTICLES];

/// A CSV file that is being written.
struct CsvFile<'a> {
    path: &'a Path,
    out: BufWriter<File>,
    lines: u64,
}

impl<'a> CsvFile<'a> {
    fn create(path: &'a Path, names: impl Iterator<Item = &'static str>) -> Result<Self> {
        let file = File::create(path).map_err(|e| Error::io(path, "create", e))?;
        let mut csv = CsvFile { path, out: BufWriter::new(file), lines: 0 };
        csv.put(&names.collect::<Vec<_>>().join(","))?;
        Ok(csv)
    }

    fn line(&mut self, line: &str) -> Result<()> {
        self.lines += 1;
        self.put(line)
    }

    fn put(&mut self, line: &str) -> Result<()> {
        let written = self.out.write_all(line.as_bytes()).and_then(|()| self.out.write_all(b"\n"));
        written.map_err(|e| Error::io(self.path, "write", e))
    }

    /// Completes the file; returns the number of lines below the header.
    fn finish(self) -> Result<u64> {
        let path = self.path;
        let file = self.out.into_inner().map_err(|e| Error::io(path, "write", e.into_error()))?;
        file.sync_all().map_err(|e| Error::io(path, "write", e))?;
        Ok(self.lines)
    }
}

/// Writes a text as a cell of a CSV file.
fn cell(text: &str) -> String {
    match text.contains([',', '"', '\n', '\r']) {
        true => format!("\"{}\"", text.replace('"', "\"\"")),
        false => text.to_owned(),
    }
}

/// Writes a number as a cell with the fewest digits from which it can be read back; empty for `None`.
fn number(value: Option<f32>) -> String {
    value.filter(|v| v.is_finite()).map(|v| v.to_string()).unwrap_or_default()
}

/// Writes the table of a world, and returns its number of lines.
///
/// # Errors
/// [`Error::Io`], errors of a damaged world, [`Error::Interrupted`].
pub(super) fn write_table(
    table: &CardTable,
    world: &WorldFile,
    name: &str,
    path: &Path,
    progress: &dyn Progress,
) -> Result<u64> {
    let mut csv = CsvFile::create(path, table.fields.iter().map(|f| f.name))?;
    (table.write)(world, name, &mut csv, progress)?;
    csv.finish()
}

fn columns(
    world: &WorldFile,
    name: &str,
    csv: &mut CsvFile,
    progress: &dyn Progress,
) -> Result<()> {
    for (index, c) in world.columns()?.iter().enumerate() {
        if index.is_multiple_of(1 << 16) && progress.interrupted() {
            return Err(Error::Interrupted);
        }
        let [x, y] = c.position_nm.map(|v| number(Some(v)));
        let counts = format!("{},{},{}", c.sites, c.vacancies, c.substitutions);
        csv.line(&format!("{name},{index},{x},{y},{counts},{}", cell(c.composition.as_str())))?;
    }
    Ok(())
}

fn defects(
    world: &WorldFile,
    name: &str,
    csv: &mut CsvFile,
    progress: &dyn Progress,
) -> Result<()> {
    // The visitor cannot return an error, so the first one is kept.
    let mut result = Ok(());
    world.for_each_chunk_of_sites(|first, truth| {
        if result.is_ok() && progress.interrupted() {
            result = Err(Error::Interrupted);
        }
        let lines = (0..truth.types.len()).filter_map(|i| defect(name, first, i, truth));
        for line in lines {
            if result.is_err() {
                return;
            }
            result = csv.line(&line);
        }
    })?;
    result
}

/// Returns the line of a site, if it is a defect.
fn defect(name: &str, first: usize, i: usize, truth: &GroundTruth) -> Option<String> {
    let kind = match truth.types[i] {
        atom_type::VACANCY => "vacancy",
        atom_type::SUBSTITUTION => "substitution",
        _ => return None,
    };
    let [x, y] = truth.positions[i].map(|v| number(Some(v)));
    let z = number(truth.z.get(i).copied());
    let column = truth.columns.get(i).filter(|c| **c >= 0);
    let column = column.map(i32::to_string).unwrap_or_default();
    let element = truth.numbers.get(i).and_then(|n| u8::try_from(*n).ok());
    let element = element.map(elements::symbol).filter(|s| *s != "?").unwrap_or_default();
    Some(format!("{name},{},{column},{x},{y},{z},{kind},{element}", first + i))
}

fn particles(
    world: &WorldFile,
    name: &str,
    csv: &mut CsvFile,
    progress: &dyn Progress,
) -> Result<()> {
    let all = world.particles()?;
    let joined =
        |values: &[f32]| values.iter().map(|v| number(Some(*v))).collect::<Vec<_>>().join(",");
    for (index, (centre, diameter)) in all.centres.iter().zip(&all.diameters).enumerate() {
        if progress.interrupted() {
            return Err(Error::Interrupted);
        }
        let (place, diameter) = (joined(centre), number(Some(*diameter)));
        let (shape, turn) =
            (cell(all.morphologies[index].as_str()), joined(&all.orientations[index]));
        csv.line(&format!("{name},{index},{place},{diameter},{shape},{turn}"))?;
    }
    Ok(())
}

/// A world, with the size and the checksum of its file.
pub(super) struct WorldLine<'a> {
    pub(super) world: &'a CardWorld,
    /// Size of the file in bytes.
    pub(super) bytes: u64,
    /// SHA-256 of the file.
    pub(super) sha256: &'a str,
}

/// A column of the table of worlds.
pub(super) struct WorldField {
    pub(super) field: CardField,
    value: fn(&WorldLine) -> String,
}

const fn of_world(
    name: &'static str,
    kind: CardType,
    text: &'static str,
    value: fn(&WorldLine) -> String,
) -> WorldField {
    WorldField { field: field(name, kind, text), value }
}

fn said<T: ToString>(value: &Option<T>) -> String {
    value.as_ref().map(T::to_string).unwrap_or_default()
}

/// Columns of the table of worlds; a value that a file does not give is empty.
pub(super) const WORLD_FIELDS: &[WorldField] = &[
    of_world("world", CardType::Text, "name of the file without its ending", |w| {
        w.world.name.clone()
    }),
    of_world("file", CardType::Text, "name of the file", |w| w.world.file_name()),
    of_world("file_bytes", CardType::Integer, "size of the file in bytes", |w| w.bytes.to_string()),
    of_world("sha256", CardType::Text, "SHA-256 of the file", |w| w.sha256.to_owned()),
    of_world("material", CardType::Text, "material or identifier of the recipe", |w| {
        said(&w.world.facts.material)
    }),
    of_world("difficulty", CardType::Text, "tier of the recipe: easy, medium or hard", |w| {
        w.world.facts.tier.map(|t| t.name().to_owned()).unwrap_or_default()
    }),
    of_world("seed", CardType::Integer, "seed of all random numbers", |w| {
        said(&w.world.facts.seed)
    }),
    of_world("source", CardType::Text, "where the data come from, if the recipe says so", |w| {
        said(&w.world.facts.source)
    }),
    of_world("zone_axis", CardType::Text, "direction of the beam in the crystal", |w| {
        said(&w.world.facts.zone_axis)
    }),
    of_world("height_nm", CardType::Float64, "height of the field in nm", |w| {
        w.world.facts.fov_nm[0].to_string()
    }),
    of_world("width_nm", CardType::Float64, "width of the field in nm", |w| {
        w.world.facts.fov_nm[1].to_string()
    }),
    of_world("height_px", CardType::Integer, "height of the image in pixels", |w| {
        w.world.facts.pixels[0].to_string()
    }),
    of_world("width_px", CardType::Integer, "width of the image in pixels", |w| {
        w.world.facts.pixels[1].to_string()
    }),
    of_world("pixel_nm", CardType::Float64, "edge of a pixel in nm", |w| {
        w.world.facts.pixel_size_nm.to_string()
    }),
    of_world("tile_rows", CardType::Integer, "rows of tiles", |w| {
        w.world.facts.tiles[0].to_string()
    }),
    of_world("tile_columns", CardType::Integer, "columns of tiles", |w| {
        w.world.facts.tiles[1].to_string()
    }),
    of_world("tile_px", CardType::Integer, "edge of a tile in pixels", |w| {
        w.world.facts.tile_size_px.to_string()
    }),
    of_world("overlap_px", CardType::Integer, "pixels that neighbouring tiles share", |w| {
        w.world.facts.overlap_px.to_string()
    }),
    of_world("thickness_nm", CardType::Float64, "thickness of the specimen in nm", |w| {
        said(&w.world.facts.thickness_nm)
    }),
    of_world("energy_kev", CardType::Float64, "energy of the beam in keV", |w| {
        said(&w.world.facts.energy_kev)
    }),
    of_world("convergence_mrad", CardType::Float64, "convergence semiangle in mrad", |w| {
        said(&w.world.facts.convergence_mrad)
    }),
    of_world(
        "detectors",
        CardType::Text,
        "detectors with their angles in mrad, the main one first",
        |w| detectors(w.world),
    ),
    of_world(
        "phonon_configurations",
        CardType::Integer,
        "configurations of displaced atoms that are averaged",
        |w| said(&w.world.facts.phonon_configurations),
    ),
    of_world(
        "dose_electrons_per_angstrom2",
        CardType::Float64,
        "electrons per square Angstrom",
        |w| said(&w.world.facts.dose_electrons_per_angstrom2),
    ),
    of_world("noise", CardType::Boolean, "whether the tiles hold the noise of that dose", |w| {
        said(&w.world.facts.noise)
    }),
    of_world(
        "noise_free_image",
        CardType::Boolean,
        "whether the file holds the image before noise too",
        |w| w.world.facts.noise_free_image.to_string(),
    ),
    of_world("sites", CardType::Integer, "lattice sites, vacant ones too", |w| {
        w.world.facts.sites.to_string()
    }),
    of_world("columns", CardType::Integer, "atomic columns", |w| w.world.facts.columns.to_string()),
    of_world("vacancies", CardType::Integer, "vacant sites", |w| {
        w.world.facts.vacancies.to_string()
    }),
    of_world("substitutions", CardType::Integer, "sites with another element", |w| {
        w.world.facts.substitutions.to_string()
    }),
    of_world("particles", CardType::Integer, "particles that reach into the image", |w| {
        w.world.facts.particles.to_string()
    }),
    of_world("grain_boundaries", CardType::Integer, "lines between grains", |w| {
        w.world.facts.grain_boundaries.to_string()
    }),
    of_world("phase_boundaries", CardType::Integer, "lines between phases", |w| {
        w.world.facts.phase_boundaries.to_string()
    }),
    of_world("engine", CardType::Text, "engine that simulated it", |w| said(&w.world.facts.engine)),
    of_world(
        "audit_bright_percent",
        CardType::Float64,
        "rms error at bright columns that an audit found, in per cent",
        |w| {
            w.world
                .facts
                .audit
                .as_ref()
                .map(|a| a.bright_rms_percent.to_string())
                .unwrap_or_default()
        },
    ),
    of_world("stemgen_version", CardType::Text, "version of stemgen that made it", |w| {
        said(&w.world.facts.stemgen_version)
    }),
    of_world("numerics_version", CardType::Integer, "version of pixel values", |w| {
        said(&w.world.facts.numerics_version)
    }),
    of_world("command", CardType::Text, "the command that makes it again", |w| {
        said(&w.world.command)
    }),
];

/// Lists the detectors: `HAADF 68-200; ABF 10-21`.
pub(super) fn detectors(world: &CardWorld) -> String {
    let one = |d: &crate::detect::Detector| format!("{} {}-{}", d.name, d.inner_mrad, d.outer_mrad);
    world.facts.detectors.iter().map(one).collect::<Vec<_>>().join("; ")
}

/// Writes the table of worlds.
///
/// # Errors
/// [`Error::Io`].
pub(super) fn write_worlds(worlds: &[WorldLine], path: &Path) -> Result<u64> {
    let mut csv = CsvFile::create(path, WORLD_FIELDS.iter().map(|f| f.field.name))?;
    for world in worlds {
        let cells = WORLD_FIELDS.iter().map(|f| cell(&(f.value)(world)));
        csv.line(&cells.collect::<Vec<_>>().join(","))?;
    }
    csv.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_quoted_where_they_must_be() {
        assert_eq!(cell("O25 Ti26"), "O25 Ti26");
        assert_eq!(cell("a,b \"c\""), "\"a,b \"\"c\"\"\"");
        assert_eq!(number(Some(0.1953)), "0.1953");
        assert_eq!(number(Some(f32::NAN)) + &number(None), "");
        let thousandth = number(Some(1.0e-3));
        assert_eq!(thousandth.parse(), Ok(1.0e-3_f32));
    }

    #[test]
    fn no_column_has_the_name_of_another() {
        let of = |table: &CardTable| table.fields.iter().map(|f| f.name).collect::<Vec<_>>();
        let mut all: Vec<Vec<&str>> = TABLES.into_iter().map(of).collect();
        all.push(WORLD_FIELDS.iter().map(|f| f.field.name).collect());
        for (table, mut names) in TABLES.map(|t| t.key).into_iter().chain(["world"]).zip(all) {
            assert!(names.contains(&table) && names.contains(&"world"));
            let count = names.len();
            names.sort_unstable();
            names.dedup();
            assert_eq!(names.len(), count);
        }
    }
}
