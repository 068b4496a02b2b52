//! Worlds of the atoms of a user's file.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use crate::common::{Spots, build, specimen};
use ndarray::Array2;
use stemgen::imaging::{Cache, PixelRect, RegionImager};
use stemgen::io::WorldFile;
use stemgen::live::{LiveOptions, LiveWorld};
use stemgen::progress::Silent;
use stemgen::recipe::{CheckedRecipe, Override, Recipe, Region};
use stemgen::specimen::{DISPLACED_NM, SiteKind};
use stemgen::world::{
    BuildMethod, BuildOptions, ExportOptions, SampleOptions, WorldBuild, WorldPlan, export,
    training_sample,
};

/// A recipe for a file beside it.
const RECIPE: &str = r#"
version = 1
id = "own"
structure = "atoms"
seed = 1
[atoms]
file = "own.xyz"
[field]
fov_nm = [4.32, 4.32]
grid = [5, 5]
tile_px = 32
overlap_px = 4
thickness_nm = 0.8
[phonons]
configurations = 1
[phonons.sigma_angstrom]
Sr = 0.0
Ti = 0.0
O = 0.0
[optics]
energy_kv = 200.0
convergence_mrad = 21.0
[detector]
inner_mrad = 50.0
outer_mrad = 90.0
[dose]
electrons_per_angstrom2 = 1e5
"#;

fn changed(recipe: Recipe, changes: &[&str]) -> Recipe {
    let changes: Vec<Override> = changes.iter().map(|c| c.parse().unwrap()).collect();
    recipe.with_overrides(&changes).unwrap()
}

fn direct() -> BuildOptions {
    let cache = Cache::none();
    BuildOptions { method: BuildMethod::Window, cache, audit_regions: 0, ..BuildOptions::default() }
}

fn imager(recipe: &CheckedRecipe) -> Box<dyn RegionImager> {
    let specimen = stemgen::specimen::specimen(recipe).unwrap();
    direct().policy(recipe).unwrap().imaging.imager(recipe, &specimen).unwrap()
}

/// Writes `rows` of an extended XYZ file whose lines have more columns than element and position.
fn write_atoms(path: &Path, columns: &str, rows: &[String]) {
    let head = format!("Lattice=\"40 0 0 0 40 0 0 0 20\" Properties=species:S:1:pos:R:3{columns}");
    std::fs::write(path, format!("{}\n{head}\n{}\n", rows.len(), rows.join("\n"))).unwrap();
}

fn recipe_beside(folder: &Path, text: &str) -> stemgen::Result<Recipe> {
    let path = folder.join("own.toml");
    std::fs::write(&path, text).unwrap();
    Recipe::from_file(&path, None)
}

/// SrTiO3 with vacancies, as a recipe and as a file of its atoms with a recipe for them.
fn specimen_and_its_file(folder: &Path) -> (Recipe, Recipe) {
    let changes = [
        "boundaries.count=0",
        "field.grid=[5, 5]",
        "field.fov_nm=[4.32, 4.32]",
        "field.tile_px=32",
        "phonons.sigma_angstrom={Sr=0.0, Ti=0.0, O=0.0}",
        "vacancies.rate=0.1",
        "vacancies.cluster_fraction=0.0",
    ];
    let original = changed(Recipe::load("test", None).unwrap(), &changes);
    let path = folder.join("own.xyz");
    let options = ExportOptions { vacancies: true, ..ExportOptions::default() };
    let whole = specimen(&original).unwrap();
    export(&*whole, &original, &path, &options, &Silent, |_| {}).unwrap();
    let text = std::fs::read_to_string(&path).unwrap();
    let (_, first) = text.split_once("first_pixel_angstrom=\"").unwrap();
    let first = first.split('"').next().unwrap().replace(' ', ", ");
    let table = format!("file = \"own.xyz\"\norigin_angstrom = [{first}]");
    let own = recipe_beside(folder, &RECIPE.replace("file = \"own.xyz\"", &table)).unwrap();
    (original, own)
}

/// What an exported specimen is read back as: the same sites in the same columns, and the same image.
#[test]
fn a_specimen_that_was_written_is_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let (original, own) = specimen_and_its_file(folder.path());
    // The file ends with the field, and the crystal does not: the edges differ.
    let middle = Region { x: [1.0, 3.3], y: [1.0, 3.3] };
    let sites = |recipe: &Recipe| {
        let found = specimen(recipe).unwrap().query(&middle);
        let mut columns: Vec<_> = found
            .columns
            .iter()
            .map(|c| {
                let members = &found.sites[c.sites.clone()];
                let held: Vec<_> =
                    members.iter().map(|s| (s.number, s.kind == SiteKind::Vacancy)).collect();
                (c.position_nm.map(|v| (v * 1e5).round() as i64), held)
            })
            .collect();
        columns.sort();
        columns
    };
    let [a, b] = [&original, &own].map(sites);
    assert!(a.len() > 50 && a.len() == b.len(), "{} and {} columns", a.len(), b.len());
    let mut vacant = 0;
    for ((at, held), (own_at, own_held)) in a.iter().zip(&b) {
        assert!(
            (0..2).all(|k| (at[k] - own_at[k]).abs() <= 1) && held == own_held,
            "{at:?} {own_at:?}"
        );
        vacant += held.iter().filter(|(_, vacant)| *vacant).count();
    }
    assert!(vacant > 5, "{vacant}");
    let pixels = PixelRect::new([56, 56], [32, 32]);
    let image = |recipe: &Recipe| -> Array2<f64> {
        let recipe = recipe.clone().checked().unwrap();
        imager(&recipe).mean_of(&pixels, 1, &Silent).unwrap()
    };
    let [a, b] = [&original, &own].map(image);
    let mean = a.mean().unwrap();
    let worst = (&a - &b).iter().fold(0.0f64, |w, d| w.max(d.abs()));
    println!("largest difference {:.4} % of the mean", 100.0 * worst / mean);
    assert!(worst < 5e-3 * mean, "{worst} of {mean}");
}

#[test]
fn a_region_has_the_same_columns_whichever_way_it_is_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    // No lattice: atoms anywhere, every one at least 0.15 nm from the others.
    let rows: Vec<String> = (0..900u32)
        .map(|n| {
            let [i, j, k] = [n % 15, n / 15 % 15, n / 225].map(f64::from);
            let lean = 0.11 * f64::from(n * 37 % 11);
            format!(
                "{} {:.4} {:.4} {:.4}",
                ["Sr", "Ti", "O"][n as usize % 3],
                2.9 * i + lean,
                2.9 * j - lean,
                2.2 * k
            )
        })
        .collect();
    write_atoms(&folder.path().join("own.xyz"), "", &rows);
    let recipe = recipe_beside(folder.path(), RECIPE).unwrap();
    let own = specimen(&recipe).unwrap();
    let everywhere = Region { x: [-50.0, 50.0], y: [-50.0, 50.0] };
    let whole = own.query(&everywhere);
    assert_eq!(whole.sites.len(), 900);
    let keys: BTreeSet<u64> = whole.sites.iter().map(|s| s.key).collect();
    let ids: BTreeSet<u64> = whole.columns.iter().map(|c| c.id).collect();
    assert_eq!((keys.len(), ids.len()), (900, whole.columns.len()));
    let mut by_parts = BTreeMap::new();
    for n in 0..16u32 {
        let edges = |k: u32| [-50.0, 0.7, 1.5, 2.9, 50.0][k as usize];
        let range = |k: u32| [edges(k), edges(k + 1)];
        let part = Region { x: range(n % 4), y: range(n / 4) };
        let found = own.query(&part);
        let mut bare = found.columns.clone();
        bare.iter_mut().for_each(|column| column.sites = 0..0);
        assert_eq!(own.columns(&part), bare);
        for column in &found.columns {
            assert!(part.contains(column.position_nm));
            let members = found.sites[column.sites.clone()].to_vec();
            assert!(members.windows(2).all(|w| w[0].position_nm[2] <= w[1].position_nm[2]));
            for site in &members {
                let [dx, dy] = [0, 1].map(|k| site.position_nm[k] - column.position_nm[k]);
                assert!(dx.hypot(dy) < DISPLACED_NM);
            }
            by_parts.insert(column.id, members);
        }
    }
    assert_eq!(by_parts.len(), whole.columns.len());
    for column in &whole.columns {
        assert_eq!(by_parts[&column.id], whole.sites[column.sites.clone()]);
    }
    // The order of the lines plays no part.
    let turned: Vec<String> = rows.iter().rev().cloned().collect();
    write_atoms(&folder.path().join("own.xyz"), "", &turned);
    let again = specimen(&recipe_beside(folder.path(), RECIPE).unwrap()).unwrap();
    assert_eq!(again.query(&everywhere), whole);
}

/// Two phases side by side, a substitution and a vacancy in each of some rows, and empty space beside.
fn labelled(folder: &Path) -> PathBuf {
    let mut rows = Vec::new();
    for n in 0..40u32 {
        let (i, j) = (n % 8, n / 8);
        let phase = if i < 4 { "film" } else { "substrate" };
        for k in 0..3u32 {
            let at = format!("{} {} {}", 4 * i, 4 * j, 2 * k);
            rows.push(match (i, k) {
                (1, 1) => format!("Ti {at} 1 substitution_Ti {phase}"),
                (6, 1) => format!("X {at} 0 vacancy_O {phase}"),
                _ => format!("Sr {at} 1 none {phase}"),
            });
        }
    }
    let path = folder.join("own.xyz");
    write_atoms(&path, ":occupancy:R:1:defect:S:1:phase:S:1", &rows);
    path
}

fn labelled_recipe(folder: &Path) -> Recipe {
    labelled(folder);
    recipe_beside(folder, &RECIPE.replace("O = 0.0\n", "")).unwrap()
}

#[test]
fn labels_of_the_file_are_the_truth_of_the_world() {
    let folder = tempfile::tempdir().unwrap();
    let recipe = labelled_recipe(folder.path());
    let path = folder.path().join("world.h5");
    let options = BuildOptions { cache: Cache::none(), ..BuildOptions::default() };
    let summary = build(&recipe, &Spots::new(), &path, &options, &Silent).unwrap();
    assert_eq!((summary.counts.sites, summary.counts.columns), (120, 40));
    assert_eq!((summary.counts.vacancies, summary.counts.substitutions), (5, 5));
    let world = WorldFile::open(&path).unwrap();
    assert_eq!(world.phase_names().unwrap(), ["film", "substrate"]);
    let [rows, columns] = world.shape();
    let map = world.phase_map(0..rows, 0..columns).unwrap().unwrap();
    // The atoms lie in the middle of the field; the border between the phases is theirs.
    for ((_, column), phase) in map.indexed_iter() {
        let middle = (columns as f64 - 1.0) / 2.0;
        let side = column as f64 - middle;
        assert!(side.abs() < 1.0 || *phase == i32::from(side > 0.0), "{column}: {phase}");
    }
    let truth = world.truth(0..120).unwrap();
    let of = |name: &str| truth.defect_names.iter().filter(|n| *n == name).count();
    assert_eq!((of("vacancy_O"), of("substitution_Ti"), of("")), (5, 5, 110));
    // The world's recipe makes it again, wherever the recipe was: the file lies beside.
    let text = world.metadata().recipe.clone().unwrap();
    let again = Recipe::from_toml_str(&path.display().to_string(), &text, None).unwrap();
    assert_eq!(again, recipe);
    again.checked().unwrap();
}

/// The engine itself: a field that is empty for the most part, its plan and its audit; samples, and electrons that take atoms away.
#[test]
fn everything_that_worlds_are_made_for_takes_own_atoms() {
    let folder = tempfile::tempdir().unwrap();
    let changes = ["field.fov_nm=[7.2, 7.2]", "field.grid=[1, 1]", "field.tile_px=96"];
    let recipe = changed(labelled_recipe(folder.path()), &changes).checked().unwrap();
    let options = BuildOptions { audit_regions: 1, audit_direct: true, ..direct() };
    let path = folder.path().join("world.h5");
    let world = WorldBuild::new(&recipe, &options).unwrap();
    assert!(world.warnings().unwrap().iter().any(|w| w.contains("no atom vibrates")));
    let plan = WorldPlan::new(&recipe, &world, path.clone()).unwrap();
    assert!(serde_json::to_string(&plan).unwrap().contains("own"));
    let summary = world.run(&path, &Silent).unwrap();
    assert_eq!(summary.counts.sites, 120);
    let audit = summary.audit.unwrap();
    assert!(audit.bright_rms_percent < 5.0, "{audit:?}");
    // A library of so few columns would save nothing.
    let auto = BuildOptions { cache: Cache::none(), ..BuildOptions::default() };
    let cost = WorldBuild::new(&recipe, &auto).unwrap().cost().unwrap();
    assert!(cost.mosaic.is_none_or(|mosaic| !mosaic.pays));
    let samples = SampleOptions {
        all_detectors: false,
        size_px: 32,
        pixel_nm: [0.05, 0.06],
        angle_rad: [-3.0, 3.0],
        dose: [1e4, 1e5],
        sigma_px: 1.0,
        seed: 3,
    };
    let own = stemgen::specimen::specimen(&recipe).unwrap();
    let sample = training_sample(&recipe, &*own, &*imager(&recipe), &samples, 0, &Silent).unwrap();
    assert!(sample.clean.iter().all(|v| v.is_finite()));
    let damaged =
        changed(recipe.recipe().clone(), &["damage.radiolysis_barn.Sr=1e8"]).checked().unwrap();
    let live = LiveOptions { imaging: direct(), ..LiveOptions::default() };
    LiveWorld::new(&damaged, 1, &live, &Silent).unwrap();
}

#[test]
fn a_cell_is_repeated_over_the_field() {
    let folder = tempfile::tempdir().unwrap();
    let head = "Lattice=\"3.9 0 0 0 3.9 0 0 0 9\" Properties=species:S:1:pos:R:3";
    std::fs::write(
        folder.path().join("own.xyz"),
        format!("2\n{head}\nSr 0 0 0\nTi 1.95 1.95 1.95\n"),
    )
    .unwrap();
    let text = RECIPE.replace("O = 0.0\n", "").replace("file =", "repeat = true\nfile =");
    let recipe = recipe_beside(folder.path(), &text).unwrap();
    let own = specimen(&recipe).unwrap();
    let field = recipe.field.full_region();
    let density = own.sites(&field).len() as f64 / (4.32 * 4.32);
    let expected = 2.0 / (0.39 * 0.39);
    assert!((density / expected - 1.0).abs() < 0.1, "{density} and {expected}");
    let beyond = field.grown(11.0);
    assert!(own.sites(&beyond).len() as f64 > 0.95 * expected * 26.0 * 26.0);
    let oblique = head.replace("3.9 0 0 0 3.9 0 0 0 9", "3.9 0 0 1 3.9 0 0 0 9");
    std::fs::write(
        folder.path().join("own.xyz"),
        format!("2\n{oblique}\nSr 0 0 0\nTi 1.95 1.95 1.95\n"),
    )
    .unwrap();
    let message = recipe_beside(folder.path(), &text).unwrap().checked().unwrap_err().to_string();
    assert!(message.contains("atoms.repeat") && message.contains("orthogonalise"), "{message}");
}

#[test]
fn a_file_that_changed_or_went_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let path = labelled(folder.path());
    let recipe = labelled_recipe(folder.path());
    let digest = recipe.atoms.as_ref().unwrap().sha256.clone().unwrap();
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(&path, text.replace("Sr 0 0 0", "Sr 0 0 0.001")).unwrap();
    let message = recipe.clone().checked().unwrap_err().to_string();
    let parts =
        ["atoms.file", "has changed since the recipe was resolved", &digest, "remove `sha256`"];
    assert!(parts.iter().all(|part| message.contains(part)), "{message}");
    std::fs::remove_file(&path).unwrap();
    let message = recipe.clone().checked().unwrap_err().to_string();
    assert!(message.contains("the file does not exist") && message.contains(&digest), "{message}");
    // Another file of the same content does, if it is named.
    let other = folder.path().join("other.xyz");
    std::fs::write(&other, text).unwrap();
    let change = format!("atoms.file={:?}", other.display().to_string());
    assert_eq!(
        changed(recipe, &[&change]).checked().unwrap().atoms.as_ref().unwrap().sha256,
        Some(digest)
    );
}

#[test]
fn what_does_not_fit_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let error = |from: &str, to: &str| -> String {
        labelled(folder.path());
        let text = RECIPE.replace("O = 0.0\n", "").replace(from, to);
        match recipe_beside(folder.path(), &text).and_then(Recipe::checked) {
            Ok(recipe) => stemgen::specimen::specimen(&recipe).map(|_| ()).unwrap_err().to_string(),
            Err(error) => error.to_string(),
        }
    };
    let cases = [
        ("seed = 1", "seed = 1\ncrystal = \"srtio3\"", "expected no crystal"),
        ("seed = 1", "seed = 1\nzone_axis = \"[001]\"", "expected no zone_axis"),
        ("[atoms]\nfile = \"own.xyz\"", "", "this kind of structure needs the table"),
        ("own.xyz", "none.xyz", "none.xyz: cannot read"),
        ("own.xyz", "own.pdb", "atoms.file = "),
        ("file =", "fil =", "did you mean `file`?"),
        ("thickness_nm = 0.8", "thickness_nm = 0.3", "expected 0.4000 nm, the extent"),
        ("Ti = 0.0\n", "", "`Ti` is missing"),
        ("file =", "origin_angstrom = [900.0, 0.0]\nfile =", "no atom of it lies in the field"),
        (
            "[phonons]",
            "[boundaries]\ncount = 1\nmisorientation_deg = 1.0\n[phonons]",
            "expected structure = \"grains\"",
        ),
    ];
    for (from, to, part) in cases {
        let message = error(from, to);
        assert!(message.contains(part), "{from} -> {to}: {message}");
    }
}
