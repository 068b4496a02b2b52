//! Edges of layers, rows of vacancies and double vacancies of stacks.

use std::collections::BTreeMap;

use crate::common::{Spots, build};
use crate::specimens::number;
use crate::stack::{checked, recipe, sites};
use stemgen::imaging::Cache;
use stemgen::io::WorldFile;
use stemgen::progress::Silent;
use stemgen::recipe::{CheckedRecipe, Region};
use stemgen::specimen::{Boundary, BoundaryKind, SiteKind, SpecimenSite};
use stemgen::world::BuildOptions;

const MOS2: &str =
    "[[stack.layers]]\ncrystal = \"mos2\"\nzone_axis = \"[001]\"\ny_axis = \"[120]\"\n";
const GRAPHENE: &str =
    "[[stack.layers]]\ncrystal = \"graphene\"\nzone_axis = \"[001]\"\ny_axis = \"[120]\"\n";
const MO_S: &[&str] = &["Mo", "S"];
/// The shortest lattice vector of the two layers in nm.
const A_MOS2: f64 = 0.316_02;
const A_GRAPHENE: f64 = 0.2461;

fn layer(tables: &str) -> CheckedRecipe {
    checked(&format!("{MOS2}{tables}"), 0.6147, MO_S)
}

fn lines(recipe: &CheckedRecipe, wanted: &str) -> Vec<Boundary> {
    let all = stemgen::specimen::specimen(recipe).unwrap().boundaries();
    let of = |b: &Boundary| matches!(b.kind, BoundaryKind::Fault { kind, .. } if kind == wanted);
    all.into_iter().filter(of).collect()
}

fn vacant(sites: &[SpecimenSite]) -> Vec<&SpecimenSite> {
    sites.iter().filter(|s| s.kind == SiteKind::Vacancy).collect()
}

/// Number of vacancies and of sites of each column with vacancies, by its place in pm.
fn columns(sites: &[SpecimenSite]) -> BTreeMap<[i64; 2], [usize; 2]> {
    let place = |s: &SpecimenSite| [0, 1].map(|k| (s.position_nm[k] * 1e3).round() as i64);
    let mut found = BTreeMap::new();
    for site in sites {
        let counts: &mut [usize; 2] = found.entry(place(site)).or_default();
        counts[0] += usize::from(site.kind == SiteKind::Vacancy);
        counts[1] += 1;
    }
    found.retain(|_, [vacant, _]| *vacant > 0);
    found
}

#[test]
fn an_edge_leaves_whole_rows_and_vacuum_beyond() {
    for (plane, y, sign) in [("(010)", 3.0, 1.0), ("(0-10)", 1.0, -1.0)] {
        let table = format!("[[stack.edges]]\nplane = \"{plane}\"\nposition_nm = [2.0, {y}]\n");
        let recipe = layer(&table);
        let found = sites(&recipe);
        let [edge] = &lines(&recipe, "edge")[..] else { panic!() };
        let BoundaryKind::Fault { normal, shift_nm, .. } = edge.kind else { panic!() };
        assert!((normal[1] - sign).abs() < 1e-9 && shift_nm == [0.0; 3]);
        let at = edge.line_nm[0][1];
        assert!((at - y).abs() < 0.2 && (edge.line_nm[1][1] - at).abs() < 1e-9, "{at}");
        // The line lies in the middle of the wide gap of 2/3 of the row spacing between the last row and the first that is missing.
        let gap = 0.5 * A_MOS2 * 3f64.sqrt() / 2.0 * 2.0 / 3.0;
        let depth = |s: &SpecimenSite| sign * (at - s.position_nm[1]);
        let nearest = found.iter().map(depth).fold(f64::INFINITY, f64::min);
        assert!((nearest - gap).abs() < 1e-6, "{nearest}");
        // One side ends with molybdenum that keeps 4 of 6 bonds, the other with sulphur that keeps 2 of 3.
        let middle = |s: &&SpecimenSite| (1.5..2.5).contains(&s.position_nm[0]);
        for site in found.iter().filter(middle).filter(|s| depth(s) < nearest + 0.05) {
            let bonds = found.iter().filter(|other| {
                let d: f64 =
                    (0..3).map(|k| (site.position_nm[k] - other.position_nm[k]).powi(2)).sum();
                other.number != site.number && d.sqrt() < 0.26
            });
            let expected = if site.number == number("Mo") { 4 } else { 2 };
            assert_eq!(bonds.count(), expected, "{plane}: {site:?}");
        }
        let whole = sites(&layer(""));
        let kept = whole.iter().filter(|s| depth(s) > 0.0).count();
        assert_eq!(kept, found.len());
    }
    // Along an angle the layer ends where the recipe has it.
    let recipe = layer("[[stack.edges]]\nangle_deg = 30.0\nposition_nm = [2.0, 2.0]\n");
    let along = |s: &SpecimenSite| {
        let [sin, cos] = [0.5, 3f64.sqrt() / 2.0];
        (s.position_nm[0] - 2.0) * cos + (s.position_nm[1] - 2.0) * sin
    };
    let (found, whole) = (sites(&recipe), sites(&layer("")));
    assert!(found.iter().all(|s| along(s) <= 1e-9));
    assert_eq!(found.len(), whole.iter().filter(|s| along(s) <= 1e-9).count());
}

#[test]
fn rows_of_vacancies_have_their_length_and_both_ends() {
    for (missing, per_column) in [("all", 2), ("entrance", 1), ("exit", 1)] {
        let table = format!(
            "[[stack.vacancy_lines]]\nelement = \"S\"\ndirection = \"[100]\"\nlength_nm = 1.58\nmissing = \"{missing}\"\n\
             positions_nm = [[2.0, 2.0]]\n"
        );
        let recipe = layer(&table);
        let found = sites(&recipe);
        let columns = columns(&found);
        assert_eq!(columns.len(), 5);
        assert!(columns.values().all(|c| *c == [per_column, 2]), "{missing} {columns:?}");
        let missing_at = vacant(&found);
        assert!(missing_at.iter().all(|s| s.number == number("S")));
        let depth = |s: &&&SpecimenSite| s.position_nm[2] < 0.3;
        let first = missing_at.iter().filter(depth).count();
        assert_eq!(first, if missing == "exit" { 0 } else { 5 });
        let [line] = &lines(&recipe, "vacancy_line")[..] else { panic!() };
        let [from, to] = line.line_nm[..] else { panic!() };
        assert!((to[0] - from[0] - 4.0 * A_MOS2).abs() < 1e-6 && (to[1] - from[1]).abs() < 1e-6);
        let x = |s: &&&SpecimenSite| s.position_nm[0];
        let [low, high] = missing_at
            .iter()
            .fold([f64::INFINITY, 0.0], |[l, h], s| [f64::min(l, x(&s)), f64::max(h, x(&s))]);
        assert!((low - from[0]).abs() < 1e-6 && (high - to[0]).abs() < 1e-6);
        // The middle column is the one nearest to the place.
        assert!((0.5 * (from[0] + to[0]) - 2.0).abs() < 0.16 && (from[1] - 2.0).abs() < 0.2);
    }
}

#[test]
fn random_rows_have_their_density_and_do_not_meet() {
    let table = "[[stack.vacancy_lines]]\nelement = \"C\"\ndirection = \"[110]\"\nlength_nm = 1.0\nper_um2 = 4e5\n";
    let recipe = checked(&format!("{GRAPHENE}{table}"), 0.3354, &["C"]);
    let lines = lines(&recipe, "vacancy_line");
    let field = recipe.field.full_region();
    let area = (field.x[1] - field.x[0]) * (field.y[1] - field.y[0]);
    assert_eq!(lines.len(), (0.4 * area).round() as usize);
    for line in &lines {
        let [from, to] = line.line_nm[..] else { panic!() };
        let length = (to[0] - from[0]).hypot(to[1] - from[1]);
        assert!((length - 3.0 * A_GRAPHENE).abs() < 1e-6, "{length}");
    }
    assert_eq!(vacant(&sites(&recipe)).len(), 4 * lines.len());
}

#[test]
fn double_vacancies_have_their_rate() {
    let double = |element: &str, pair: &str, rate: f64| {
        format!(
            "[[stack.double_vacancies]]\nelement = \"{element}\"\npair = \"{pair}\"\nrate = {rate}\n"
        )
    };
    let recipe = layer(&double("S", "column", 0.05));
    let found = sites(&recipe);
    let all = found.iter().filter(|s| s.number == number("S")).count();
    let columns = columns(&found);
    assert!(columns.values().all(|c| *c == [2, 2]));
    let rate = 2.0 * columns.len() as f64 / all as f64;
    // The rate holds for the whole specimen, which reaches 1 nm farther than the sites of this test.
    assert!((rate - 0.05).abs() < 5.0 * (0.1 / all as f64).sqrt() / 2.0, "{rate} of {all}");

    let graphene = |tables: &str| checked(&format!("{GRAPHENE}{tables}"), 0.3354, &["C"]);
    let found = sites(&graphene(&double("C", "neighbours", 0.03)));
    let gone = vacant(&found);
    let rate = gone.len() as f64 / found.len() as f64;
    assert!((rate - 0.03).abs() < 5.0 * (0.06 / found.len() as f64).sqrt(), "{rate}");
    let bond = A_GRAPHENE / 3f64.sqrt();
    let inside = Region { x: [-5.0, 9.0], y: [-5.0, 9.0] };
    let middle = gone.iter().filter(|s| inside.contains([s.position_nm[0], s.position_nm[1]]));
    for site in middle {
        let partner = gone.iter().any(|other| {
            let [dx, dy] = [0, 1].map(|k| site.position_nm[k] - other.position_nm[k]);
            (dx.hypot(dy) - bond).abs() < 1e-6
        });
        assert!(partner, "{site:?}");
    }
    // Single vacancies are drawn among the other sites.
    let single = "[vacancies]\nelement = \"S\"\nrate = 0.1\ncluster_fraction = 0.0\ncluster_sigma_nm = 1.0\nmax_probability = 0.25\n";
    let found = sites(&layer(&(double("S", "column", 0.05) + single)));
    let vacancies = vacant(&found).len() as f64 / all as f64;
    assert!((vacancies - (0.05 + 0.95 * 0.1)).abs() < 5.0 * (0.15 / all as f64).sqrt());
}

/// The two layers of a bilayer have their own edges, and a turned layer turns its edges and rows.
#[test]
fn edges_and_rows_belong_to_their_layer() {
    let two = "[stack]\nalong = \"z\"\n[[stack.layers]]\ncrystal = \"graphene_layer.cif\"\nzone_axis = \"[001]\"\ny_axis = \"[010]\"\n\
               thickness_nm = 0.3\nname = \"lower\"\n[[stack.layers]]\ncrystal = \"graphene_layer.cif\"\nzone_axis = \"[001]\"\n\
               y_axis = \"[010]\"\nfit = \"misfit\"\nturn_deg = 20.0\nname = \"upper\"\n";
    let tables = "[[stack.edges]]\nlayer = 2\nplane = \"(100)\"\nposition_nm = [2.0, 2.0]\n\
                  [[stack.vacancy_lines]]\nlayer = 2\nelement = \"C\"\ndirection = \"[010]\"\nlength_nm = 1.0\npositions_nm = [[0.5, 2.0]]\n";
    let recipe = checked(&format!("{two}{tables}"), 0.6708, &["C"]);
    let whole = sites(&checked(two, 0.6708, &["C"]));
    let found = sites(&recipe);
    let [edge] = &lines(&recipe, "edge")[..] else { panic!() };
    let BoundaryKind::Fault { normal, .. } = edge.kind else { panic!() };
    assert!((normal[1].atan2(normal[0]).to_degrees() - 20.0).abs() < 1e-6, "{normal:?}");
    let lower = |s: &&SpecimenSite| s.position_nm[2] < 0.3;
    assert_eq!(found.iter().filter(lower).count(), whole.iter().filter(lower).count());
    let upper = found.iter().filter(|s| !lower(s));
    let [[x, y], _] = edge.line_nm[..] else { panic!() };
    let beyond = |s: &SpecimenSite| {
        (s.position_nm[0] - x) * normal[0] + (s.position_nm[1] - y) * normal[1] > 0.0
    };
    assert!(!upper.clone().any(beyond) && upper.count() > 1000);
    let gone = vacant(&found);
    assert!(!gone.is_empty() && gone.iter().all(|s| s.position_nm[2] > 0.3));
    let [line] = &lines(&recipe, "vacancy_line")[..] else { panic!() };
    let [from, to] = line.line_nm[..] else { panic!() };
    let slope = (to[1] - from[1]).atan2(to[0] - from[0]).to_degrees();
    assert!((slope - 110.0).abs() < 1e-6, "{slope}");
}

#[test]
fn a_world_lists_them_and_threads_give_the_same_bytes() {
    let tables = "[[stack.edges]]\nplane = \"(0-10)\"\nposition_nm = [2.0, 1.0]\n\
                  [[stack.vacancy_lines]]\nelement = \"S\"\ndirection = \"[100]\"\nlength_nm = 1.0\nper_um2 = 2e5\n\
                  [[stack.double_vacancies]]\nelement = \"S\"\npair = \"column\"\nrate = 0.05\n";
    let recipe = recipe(&format!("{MOS2}{tables}"), 0.6147, MO_S).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let world = |threads: usize| {
        let path = folder.path().join(format!("{threads}.h5"));
        let options = BuildOptions { cache: Cache::none(), ..BuildOptions::default() };
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| build(&recipe, &Spots::new(), &path, &options, &Silent)).unwrap();
        path
    };
    let paths = [1, 2].map(world);
    let lines = WorldFile::open(&paths[0]).unwrap().fault_lines().unwrap();
    assert_eq!(lines.len(), 1 + 4, "{lines:?}");
    let bytes = paths.map(|path| {
        let truth = hdf5::File::open(&path).unwrap().group("ground_truth").unwrap();
        let kinds = truth.group("fault_lines").unwrap();
        let kind = |n: usize| {
            let line = kinds.dataset(&n.to_string()).unwrap();
            line.attr("kind").unwrap().read_scalar::<hdf5::types::VarLenUnicode>().unwrap()
        };
        let kinds: Vec<String> = (0..5).map(|n| kind(n).to_string()).collect();
        assert_eq!(kinds, ["edge", "vacancy_line", "vacancy_line", "vacancy_line", "vacancy_line"]);
        let list = |name: &str| truth.dataset(name).unwrap();
        let places = list("atom_positions").read_raw::<f32>().unwrap();
        let types = list("atom_types").read_raw::<i32>().unwrap();
        assert!(types.iter().filter(|t| **t == 1).count() >= 24);
        (places, types)
    });
    assert_eq!(bytes[0], bytes[1]);
}

#[test]
fn wrong_tables_are_refused_with_the_choices() {
    let refused = |tables: &str, expected: &[&str]| {
        let text = format!("{MOS2}{tables}");
        let message = match recipe(&text, 0.6147, MO_S).and_then(|r| r.checked()) {
            Ok(checked) => stemgen::specimen::specimen(&checked).err().unwrap().to_string(),
            Err(error) => error.to_string(),
        };
        for words in expected {
            assert!(message.contains(words), "{tables}: {message}");
        }
    };
    let edge = |key: &str| format!("[[stack.edges]]\n{key}\nposition_nm = [2.0, 2.0]\n");
    refused(&edge(""), &["stack.edges[1].plane", "zigzag", "armchair", "angle_deg"]);
    refused(&edge("plane = \"(010)\"\nangle_deg = 3.0"), &["missing, or both"]);
    refused(&edge("plane = \"(011)\""), &["encloses", "holds the zone axis"]);
    refused(&edge("layer = 2\nplane = \"(010)\""), &["stack.edges[1].layer", "from 1 to 1"]);
    refused(&edge("side = 1"), &["plane"]);
    let row = |keys: &str| {
        format!(
            "[[stack.vacancy_lines]]\nelement = \"S\"\ndirection = \"[100]\"\nlength_nm = 1.0\n{keys}\n"
        )
    };
    refused(&row(""), &["vacancy_lines[1].per_um2", "positions_nm"]);
    refused(&row("per_um2 = 10.0"), &["makes 0 lines in the field"]);
    refused(&row("per_um2 = 1e7"), &["finds no place", "lower per_um2 or length_nm"]);
    refused(&row("per_um2 = 1e5").replace("\"S\"", "\"O\""), &["Mo, S"]);
    refused(
        &row("per_um2 = 1e5").replace("[100]", "[101]"),
        &["perpendicular to the beam", "zigzag"],
    );
    refused(&row("positions_nm = [[200.0, 2.0]]"), &["positions_nm"]);
    let beyond = edge("angle_deg = 0.0") + &row("positions_nm = [[4.0, 2.0]]");
    refused(&beyond, &["no row of S lies within 1 nm of (4, 2) nm"]);
    let double = |pair: &str, element: &str, rate: f64| {
        format!(
            "[[stack.double_vacancies]]\nelement = \"{element}\"\npair = \"{pair}\"\nrate = {rate}\n"
        )
    };
    refused(
        &double("column", "Mo", 0.1),
        &["no two atoms of Mo lie behind each other", "neighbours"],
    );
    refused(&double("column", "S", 0.5), &["double_vacancies[1].rate", "0.4"]);
    refused(&double("row", "S", 0.1), &["column", "neighbours"]);
}
