//! Stacks: how layers fit, where their planes lie, roughness, exchange of elements, amorphous layers, and what is refused.

use std::path::{Path, PathBuf};

use crate::common::{Spots, build};
use crate::specimens::{normal_cdf, number, shortest};
use stemgen::imaging::Cache;
use stemgen::io::WorldFile;
use stemgen::progress::Silent;
use stemgen::recipe::{CheckedRecipe, Recipe, Region};
use stemgen::specimen::{BoundaryKind, SiteKind, SpecimenSite};
use stemgen::world::BuildOptions;

/// Field, microscope and dose of a test.
const REST: &str = r#"
[field]
fov_nm = [4.32, 4.32]
grid = [5, 5]
tile_px = 32
overlap_px = 4
thickness_nm = THICKNESS
[phonons]
configurations = 1
[phonons.sigma_angstrom]
SIGMAS
[optics]
energy_kv = 200.0
convergence_mrad = 21.0
[detector]
inner_mrad = 50.0
outer_mrad = 90.0
[dose]
electrons_per_angstrom2 = 1e5
"#;

/// A recipe with the table `[stack]` and a thickness in nm, for a specimen of some elements. Files of crystals lie in `examples/stacks`.
pub fn recipe(stack: &str, thickness_nm: f64, elements: &[&str]) -> stemgen::Result<Recipe> {
    let sigmas: String = elements.iter().map(|symbol| format!("{symbol} = 0.0\n")).collect();
    let rest = REST.replace("THICKNESS", &format!("{thickness_nm:?}")).replace("SIGMAS", &sigmas);
    let text =
        format!("version = 1\nid = \"stack\"\nstructure = \"stack\"\nseed = 1\n{stack}{rest}");
    Recipe::from_toml_str(&folder().join("test.toml").display().to_string(), &text, None)
}

fn folder() -> PathBuf {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/..")).join("examples/stacks")
}

pub fn checked(stack: &str, thickness_nm: f64, elements: &[&str]) -> CheckedRecipe {
    recipe(stack, thickness_nm, elements).unwrap().checked().unwrap()
}

/// The sites in and about the field.
pub fn sites(recipe: &CheckedRecipe) -> Vec<SpecimenSite> {
    let all = recipe.field.full_region().grown(11.0);
    stemgen::specimen::specimen(recipe).unwrap().sites(&all)
}

const OXIDES: &[&str] = &["Sr", "Ti", "La", "Al", "O"];
const JOINED: &str = r#"
[stack]
max_strain = 0.04
[[stack.layers]]
crystal = "srtio3"
zone_axis = "[001]"
y_axis = "[010]"
thickness_nm = 2.0
last_plane = "TiO2"
[[stack.layers]]
crystal = "laalo3.cif"
zone_axis = "[001]"
y_axis = "[010]"
first_plane = "LaO"
poisson_ratio = 0.25
"#;

/// Sorted coordinates of the atoms of an element along an axis, each once.
fn planes(sites: &[SpecimenSite], symbol: &str, axis: usize) -> Vec<f64> {
    let of = |s: &&SpecimenSite| s.number == number(symbol);
    let mut at: Vec<f64> = sites.iter().filter(of).map(|s| s.position_nm[axis]).collect();
    at.sort_by(f64::total_cmp);
    at.dedup_by(|a, b| (*a - *b).abs() < 1e-4);
    at
}

#[track_caller]
fn assert_spacing(planes: &[f64], expected: f64) {
    assert!(planes.len() > 5, "{}", planes.len());
    for pair in planes.windows(2) {
        assert!((pair[1] - pair[0] - expected).abs() < 1e-6, "{pair:?}, expected {expected}");
    }
}

#[test]
fn a_coherent_layer_has_the_lattice_of_the_first_in_the_interface_and_poissons_across_it() {
    for along in ["x", "y", "z"] {
        let stack = JOINED.replace("[stack]", &format!("[stack]\nalong = \"{along}\""));
        let (thickness, axis) =
            if along == "z" { (4.0, 2) } else { (0.8, usize::from(along == "y")) };
        let recipe = checked(&stack, thickness, OXIDES);
        let sites = sites(&recipe);
        // a of the two CIF files, and the formula of an isotropic layer: e = -nu / (1 - nu) (e1 + e2).
        let strain = 0.3905 / 0.3790 - 1.0;
        let normal = 0.3790 * (1.0 - 0.25 / 0.75 * 2.0 * strain);
        for k in 0..3 {
            assert_spacing_or_few(&planes(&sites, "Sr", k), 0.3905, thickness, k);
            assert_spacing_or_few(
                &planes(&sites, "La", k),
                if k == axis { normal } else { 0.3905 },
                thickness,
                k,
            );
        }
        // TiO2 is the last plane and LaO the first; their distance is the mean of the spacings of both crystals.
        let (titanium, lanthanum) = (planes(&sites, "Ti", axis), planes(&sites, "La", axis));
        let gap = lanthanum[0] - titanium[titanium.len() - 1];
        assert!((gap - 0.25 * (0.3905 + normal)).abs() < 1e-6, "{along}: {gap}");
        assert!(planes(&sites, "Sr", axis).iter().all(|x| *x < titanium[titanium.len() - 1]));
        assert!((0.5 * (titanium[titanium.len() - 1] + lanthanum[0]) - 2.0).abs() < 0.2);
        let specimen = stemgen::specimen::specimen(&recipe).unwrap();
        let stack = specimen.facts().stack.clone().unwrap();
        assert!((stack.layers[1].strain[axis] - (normal / 0.3790 - 1.0)).abs() < 1e-9);
        assert!((stack.layers[1].strain[(axis + 1) % 3] - strain).abs() < 1e-9);
        // Atoms at the faces count once: whole cells.
        let nearest = shortest(&*specimen, &recipe.field.full_region());
        assert!((nearest - 10.0 * 0.5 * normal.min(0.379)).abs() < 0.1, "{along}: {nearest}");
    }
}

fn assert_spacing_or_few(planes: &[f64], expected: f64, thickness_nm: f64, axis: usize) {
    if axis == 2 && thickness_nm < 1.0 {
        assert!(
            (2..=3).contains(&planes.len()) && (planes[1] - planes[0] - expected).abs() < 1e-6,
            "{planes:?}"
        );
    } else {
        let few = &planes[..planes.len().max(6).min(planes.len())];
        match few.len() < 6 {
            true => {
                assert!(few.windows(2).all(|w| (w[1] - w[0] - expected).abs() < 1e-6), "{few:?}")
            }
            false => assert_spacing(few, expected),
        }
    }
}

#[test]
fn a_misfit_layer_keeps_its_lattice_and_coincident_cells_end_together() {
    let misfit = JOINED.replace("first_plane = \"LaO\"\npoisson_ratio = 0.25", "fit = \"misfit\"");
    let found = sites(&checked(&misfit, 0.8, OXIDES));
    assert_spacing(&planes(&found, "La", 0), 0.3790);
    assert_spacing(&planes(&found, "La", 1), 0.3790);
    assert_spacing(&planes(&found, "Sr", 1), 0.3905);
    let coincident = misfit.replace("\"misfit\"", "\"coincident\"").replace("0.04", "0.005");
    let found = sites(&checked(&coincident, 0.8, OXIDES));
    // The fewest cells within 0.5 %: 30 of LaAlO3 on 29 of SrTiO3.
    assert_spacing(&planes(&found, "La", 1), 29.0 / 30.0 * 0.3905);
}

/// Two layers of one lattice: the second is the first, turned about the middle of the field.
#[test]
fn a_layer_can_be_turned_about_the_beam() {
    let layer = "[[stack.layers]]\ncrystal = \"graphene_layer.cif\"\nzone_axis = \"[001]\"\ny_axis = \"[010]\"\n";
    let stack = format!(
        "[stack]\nalong = \"z\"\n{layer}thickness_nm = 0.3\n{layer}fit = \"misfit\"\nturn_deg = 13.0\n"
    );
    let recipe = checked(&stack, 0.6708, &["C"]);
    let specimen = stemgen::specimen::specimen(&recipe).unwrap();
    let found = specimen.sites(&recipe.field.full_region().grown(3.0));
    let [low, high] = [false, true].map(|above| {
        let side = |s: &&SpecimenSite| (s.position_nm[2] > 0.17) == above;
        found.iter().filter(side).map(|s| s.position_nm).collect::<Vec<_>>()
    });
    assert!((low.len() as f64 / high.len() as f64 - 1.0).abs() < 0.03);
    let field = recipe.field.full_region();
    let middle = [field.x, field.y].map(|[a, b]| 0.5 * (a + b));
    let (sin, cos) = 13f64.to_radians().sin_cos();
    let mut tried = 0;
    for at in low.iter().filter(|at| (0..2).all(|k| (at[k] - middle[k]).abs() < 2.0)) {
        let d = [0, 1].map(|k| at[k] - middle[k]);
        let to = [middle[0] + cos * d[0] - sin * d[1], middle[1] + sin * d[0] + cos * d[1]];
        let near = |other: &&[f64; 3]| (0..2).all(|k| (other[k] - to[k]).abs() < 1e-6);
        let other = high.iter().find(near).unwrap_or_else(|| panic!("{at:?}"));
        assert!((other[2] - at[2] - 0.3354).abs() < 1e-6);
        tried += 1;
    }
    // 38.2 atoms of graphene in a square nm.
    assert!((tried as f64 / (16.0 * 38.2) - 1.0).abs() < 0.05, "{tried}");
    assert_eq!(specimen.facts().stack.as_ref().unwrap().layers[1].turn_deg, 13.0);
    let error = |from: &str, to: &str| -> String {
        let made = recipe_of(&stack.replace(from, to)).and_then(Recipe::checked);
        made.err().map_or("no error".into(), |e| e.to_string())
    };
    assert!(error("fit = \"misfit\"\n", "").contains("expected fit = \"misfit\" beside it"));
    assert!(error("along = \"z\"", "along = \"x\"").contains("expected along = \"z\""));
    assert!(error("13.0", "400.0").contains("stack.layers[2].turn_deg = 400"));
    let edge = "13.0\n[[stack.dislocations]]\nposition_nm = [2.0, 2.0]\nburgers = \"[100]\"";
    assert!(error("13.0", edge).contains("expected none beside turned layers"));
}

fn recipe_of(stack: &str) -> stemgen::Result<Recipe> {
    recipe(stack, 0.6708, &["C"])
}

#[test]
fn elements_are_exchanged_as_the_error_function_and_no_site_is_lost() {
    let abrupt = sites(&checked(&JOINED.replace("2.0", "2.1"), 4.0, OXIDES));
    let stack =
        format!("{JOINED}interdiffusion_nm = 0.6\nexchange = {{ Sr = \"La\", Ti = \"Al\" }}\n");
    let recipe = checked(&stack.replace("2.0", "2.1"), 4.0, OXIDES);
    let mixed = sites(&recipe);
    assert_eq!(abrupt.len(), mixed.len());
    let specimen = stemgen::specimen::specimen(&recipe).unwrap();
    let interface = specimen.boundaries()[0].line_nm[0][0];
    for [below, above] in [["Sr", "La"], ["Ti", "Al"]] {
        let both = [below, above].map(number);
        let of_pair = |s: &&SpecimenSite| both.contains(&s.number);
        assert_eq!(abrupt.iter().filter(of_pair).count(), mixed.iter().filter(of_pair).count());
        let own: Vec<&SpecimenSite> = mixed.iter().filter(of_pair).collect();
        let mut at: Vec<f64> = own.iter().map(|s| s.position_nm[0]).collect();
        at.sort_by(f64::total_cmp);
        at.dedup_by(|a, b| (*a - *b).abs() < 1e-4);
        for x in at.into_iter().filter(|x| (x - interface).abs() < 2.5) {
            let here = own.iter().filter(|s| (s.position_nm[0] - x).abs() < 1e-3);
            let (mut count, mut upper) = (0.0, 0.0);
            for site in here {
                count += 1.0;
                upper += f64::from(u8::from(site.number == both[1]));
                let moved = (x < interface) == (site.number == both[1]);
                assert_eq!(site.kind == SiteKind::Substitution, moved);
            }
            let expected = normal_cdf((x - interface) / 0.6);
            let error = (expected * (1.0 - expected) / count).sqrt() + 1e-3;
            assert!(
                (upper / count - expected).abs() < 4.0 * error,
                "{x}: {} of {count}, {expected}",
                upper
            );
        }
    }
    let BoundaryKind::Phase { sharpness_sigma_nm, sides } = specimen.boundaries()[0].kind else {
        panic!()
    };
    assert_eq!((sharpness_sigma_nm, sides), (0.6, [0, 1]));
}

#[test]
fn rough_interfaces_have_their_height_and_no_atoms_overlap() {
    let stack = format!("{JOINED}roughness_nm = 0.3\nroughness_correlation_nm = 1.0\n");
    let recipe = checked(
        &stack.replace("first_plane = \"LaO\"\n", "").replace("last_plane = \"TiO2\"\n", ""),
        4.0,
        OXIDES,
    );
    let specimen = stemgen::specimen::specimen(&recipe).unwrap();
    let field = recipe.field.full_region();
    let found = specimen.sites(&field);
    // The last Sr of each row of cells along x: its height scatters as the interface does.
    let mut ends = std::collections::BTreeMap::new();
    for site in found.iter().filter(|s| s.number == number("Sr")) {
        let row = [1, 2].map(|k| (site.position_nm[k] / 0.1).round() as i64);
        let end = ends.entry(row).or_insert(f64::NEG_INFINITY);
        *end = site.position_nm[0].max(*end);
    }
    let n = ends.len() as f64;
    let mean = ends.values().sum::<f64>() / n;
    let rms = (ends.values().map(|x| (x - mean).powi(2)).sum::<f64>() / n).sqrt();
    // Whole cells add the variance of a uniform distribution, a^2 / 12.
    let expected = (0.3f64.powi(2) + 0.3905f64.powi(2) / 12.0).sqrt();
    assert!((rms / expected - 1.0).abs() < 0.25, "{rms} {expected}");
    // Least distances: 0.75 of the shortest of each pair in the crystals; Al-O is the shortest bond.
    let nearest = shortest(&*specimen, &field);
    assert!(nearest > 0.75 * 1.8 && nearest < 1.96, "{nearest}");
}

#[test]
fn an_amorphous_layer_has_its_density_and_distances() {
    let stack = r#"
[[stack.layers]]
crystal = "si"
zone_axis = "[110]"
y_axis = "[001]"
thickness_nm = 1.5
[[stack.layers]]
amorphous = "SiO2"
"#;
    let recipe = checked(stack, 2.0, &["Si", "O"]);
    let specimen = stemgen::specimen::specimen(&recipe).unwrap();
    let inside = Region { x: [2.2, 8.2], y: [-1.0, 5.0] };
    let count = |symbol: &str| {
        let of = |s: &&SpecimenSite| s.number == number(symbol);
        specimen.sites(&inside).iter().filter(of).count() as f64
    };
    // 2.20 g/cm3 and 60.08 g/mol: 22.05 formula units in a cubic nm.
    for (symbol, expected) in [("Si", 22.05), ("O", 44.10)] {
        let density = count(symbol) / (6.0 * 6.0 * 2.0);
        assert!((density / expected - 1.0).abs() < 0.05, "{symbol}: {density}");
    }
    assert!(shortest(&*specimen, &inside) >= 1.5);
    let seam = Region { x: [0.5, 2.5], y: [0.0, 4.0] };
    let nearest = shortest(&*specimen, &seam);
    assert!(nearest >= 1.49, "{nearest}");
    assert_eq!(specimen.facts().phases, ["si", "amorphous_SiO2"]);
}

/// Vacancies have their rate and gather at the interface with their standard deviation; substitutions are random.
#[test]
fn vacancies_gather_at_interfaces_and_substitutions_do_not() {
    let defects = "[vacancies]\nelement = \"O\"\nrate = 0.05\ncluster_fraction = 0.9\ncluster_sigma_nm = 0.6\nmax_probability = 0.9\n\
                   [substitutions]\nelement = \"Ti\"\nby = \"Nb\"\nrate = 0.2\n";
    let elements = &[OXIDES, &["Nb"]].concat();
    let recipe = checked(&format!("{JOINED}{defects}"), 6.0, elements);
    let specimen = stemgen::specimen::specimen(&recipe).unwrap();
    let interface = specimen.boundaries()[0].line_nm[0][0];
    let found = specimen.sites(&recipe.field.full_region());
    let oxygen: Vec<&SpecimenSite> = found.iter().filter(|s| s.number == number("O")).collect();
    let vacant: Vec<f64> = oxygen
        .iter()
        .filter(|s| s.kind == SiteKind::Vacancy)
        .map(|s| s.position_nm[0] - interface)
        .collect();
    let n = oxygen.len() as f64;
    let share = vacant.len() as f64 / n;
    assert!((share - 0.05).abs() < 4.0 * (0.05 / n).sqrt(), "{share}");
    // One tenth is uniform over the field of 4.32 nm, the rest Gaussian.
    let near = vacant.iter().filter(|d| d.abs() < 1.2).count() as f64 / vacant.len() as f64;
    let expected = 0.9 * (normal_cdf(2.0) - normal_cdf(-2.0)) + 0.1 * 2.4 / 4.32;
    assert!(
        (near - expected).abs() < 4.0 * (0.25 / vacant.len() as f64).sqrt(),
        "{near} {expected}"
    );
    let niobium = found.iter().filter(|s| s.number == number("Nb"));
    let replaced = niobium.clone().count() as f64;
    assert!(niobium.clone().all(|s| s.kind == SiteKind::Substitution));
    let titanium = found.iter().filter(|s| s.number == number("Ti")).count() as f64;
    let rate = replaced / (replaced + titanium);
    assert!((rate - 0.2).abs() < 4.0 * (0.16 / (replaced + titanium)).sqrt(), "{rate}");
    let refused = |from: &str, to: &str, stack: &str| -> String {
        let text = format!("{stack}{}", defects.replace(from, to));
        let made = self::recipe(&text, 0.8, elements).and_then(Recipe::checked);
        made.err().map_or("no error".into(), |e| e.to_string())
    };
    let relaxed = "cluster_fraction = 0.9\nrelaxation_angstrom = 0.1";
    let message = refused("cluster_fraction = 0.9", relaxed, JOINED);
    assert!(message.contains("the atoms of a stack do not relax"), "{message}");
    let message = refused("cluster_fraction = 0.9", "cluster_fraction = 0.9\nclusters = 3", JOINED);
    assert!(message.contains("gather at its interfaces"), "{message}");
    let message = refused("\"O\"", "\"Fe\"", JOINED);
    assert!(message.contains("vacancies.element = Fe"), "{message}");
    let alone = "[stack]\n[[stack.layers]]\ncrystal = \"srtio3\"\nzone_axis = \"[001]\"\n";
    let message = refused("\"x\"", "\"x\"", alone);
    assert!(message.contains("this stack has no interface"), "{message}");
}

#[test]
fn sites_do_not_depend_on_the_number_of_threads() {
    let stack = format!(
        "{JOINED}roughness_nm = 0.2\ninterdiffusion_nm = 0.3\nexchange = {{ Sr = \"La\" }}\n"
    ) + "[[stack.layers]]\namorphous = \"C\"\nroughness_nm = 0.2\n";
    let stack = stack.replace("poisson_ratio", "thickness_nm = 1.0\npoisson_ratio");
    let recipe = checked(&stack, 0.8, &["Sr", "Ti", "La", "Al", "O", "C"]);
    let made = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| sites(&recipe))
    };
    let one = made(1);
    assert!(one.len() > 10_000 && one == made(3));
    let other = recipe.with_seed(2).unwrap();
    assert_ne!(one, sites(&other));
}

/// The file of a world of a stack: its phases, interface, layers, distances, and the recipe that makes it again.
#[test]
fn the_truth_of_a_world_lists_layers_and_interfaces() {
    let recipe = recipe(JOINED, 0.4, OXIDES).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("world.h5");
    let options = BuildOptions { cache: Cache::none(), ..BuildOptions::default() };
    build(&recipe, &Spots::new(), &path, &options, &Silent).unwrap();
    let world = WorldFile::open(&path).unwrap();
    assert_eq!(world.phase_names().unwrap(), ["srtio3", "laalo3"]);
    let line = &world.phase_boundaries().unwrap()[0];
    let layers = world.layers().unwrap();
    assert_eq!(layers.len(), 2);
    assert!(
        (layers[0].range_nm[1] - line[0][0]).abs() < 1e-6 && layers[1].range_nm[1].is_infinite()
    );
    assert!((f64::from(layers[1].strain[1]) - (3.905 / 3.790 - 1.0)).abs() < 1e-6);
    let file = hdf5::File::open(&path).unwrap();
    let columns = file.group("ground_truth/columns").unwrap();
    let distances = columns.dataset("interface_distance").unwrap().read_raw::<f32>().unwrap();
    let places = world.columns().unwrap();
    assert_eq!(distances.len(), places.len());
    for (column, distance) in places.iter().zip(&distances) {
        assert!(((column.position_nm[0] - line[0][0]).abs() - distance).abs() < 1e-4);
    }
    let [rows, width] = world.shape();
    let map = world.phase_map(0..rows, 0..width).unwrap().unwrap();
    let pixel = world.metadata().pixel_size_nm;
    for ((_, column), phase) in map.indexed_iter() {
        let off = column as f64 * pixel - f64::from(line[0][0]);
        assert!(off.abs() < 0.15 || (off > 0.0) == (*phase == 1), "{column}: {phase}");
    }
    let text = world.metadata().recipe.clone().unwrap();
    assert_eq!(Recipe::from_toml_str("again.toml", &text, None).unwrap(), recipe);
}

#[test]
fn what_does_not_fit_is_refused_with_the_rule_and_the_choices() {
    let cases = [
        (
            "max_strain = 0.04",
            "max_strain = 0.02",
            "differ by 3.03 % along y (3.790 and 3.905 A), and stack.max_strain is 2.00 %",
        ),
        (
            "max_strain = 0.04",
            "max_strain = 0.02",
            "fit = \"coincident\" (21:20 cells fit within 1.87 %)",
        ),
        ("max_strain = 0.04", "max_strain = 0.5", "stack.max_strain = 0.5"),
        (
            "first_plane = \"LaO\"",
            "first_plane = \"TiO2\"",
            "stack.layers[2].first_plane = TiO2: expected one of the atomic planes",
        ),
        ("first_plane = \"LaO\"", "first_plane = \"TiO2\"", "AlO2, LaO"),
        (
            "thickness_nm = 2.0\n",
            "",
            "stack.layers[1].thickness_nm = (missing): only the last layer may leave it out",
        ),
        (
            "thickness_nm = 2.0",
            "thickness_nm = 4.2",
            "the layers up to this one are 4.200 nm thick together",
        ),
        ("poisson_ratio = 0.25", "poisson_ratio = 0.6", "stack.layers[2].poisson_ratio = 0.6"),
        (
            "poisson_ratio = 0.25",
            "interdiffusion_nm = 0.3",
            "exchange = { Sr = \"La\" } together, or neither",
        ),
        (
            "poisson_ratio = 0.25",
            "interdiffusion_nm = 0.3\nexchange = { Sr = \"Ti\" }",
            "each once: Al, La, O",
        ),
        (
            "poisson_ratio = 0.25",
            "interdiffusion_nm = 0.3\nexchange = { La = \"Al\" }",
            "an element of the layer before: O, Sr, Ti",
        ),
        ("poisson_ratio = 0.25", "roughness_nm = 2.0", "stack.layers[2].roughness_nm = 2"),
        (
            "poisson_ratio = 0.25",
            "roughness = 2.0",
            "unknown key `roughness`; did you mean `roughness_nm`?",
        ),
        ("poisson_ratio = 0.25", "amorphous = \"SiO2\"", "either a crystal or amorphous matter"),
        ("crystal = \"laalo3.cif\"", "crystal = \"lao.cif\"", "lao.cif"),
        (
            "[stack]",
            "[boundaries]\ncount = 1\nmisorientation_deg = 1.0\n[stack]",
            "expected structure = \"grains\"",
        ),
        (
            "[stack]",
            "zone_axis = \"[001]\"\n[stack]",
            "each layer of a stack has its own zone_axis",
        ),
        (
            "zone_axis = \"[001]\"\ny_axis = \"[010]\"\nthickness",
            "zone_axis = \"[001]\"\ny_axis = \"[011]\"\nthickness",
            "stack.layers[1].y_axis",
        ),
    ];
    let error = |stack: &str, elements: &[&str]| -> String {
        let made = recipe(stack, 0.8, elements).and_then(Recipe::checked);
        made.err().map_or("no error".into(), |e| e.to_string())
    };
    for (from, to, part) in cases {
        assert!(JOINED.contains(from), "{from}");
        let message = error(&JOINED.replacen(from, to, 1), OXIDES);
        assert!(message.contains(part), "{from} -> {to}: {message}");
    }
    // The line is the one of the table at fault, not the first with this key.
    let message = error(&JOINED.replace("poisson_ratio = 0.25", "poisson_ratio = 0.6"), OXIDES);
    assert!(message.contains("test.toml:19:"), "{message}");
    let glass = "[[stack.layers]]\namorphous = \"GeO2\"\n";
    assert!(error(glass, &["Ge", "O"]).contains("no density of amorphous GeO2"));
    let glass = format!("{glass}density_g_per_cm3 = 3.66\n");
    assert!(error(&glass, &["Ge", "O"]).contains("no least distance of O-O"));
    let message = error(&format!("{glass}zone_axis = \"[001]\"\n"), &["Ge", "O"]);
    assert!(message.contains("amorphous matter has no such value"), "{message}");
    let none = "[stack]\nlayers = []\n";
    assert!(error(none, &["O"]).contains("expected 1 to 200 tables [[stack.layers]]"));
}

/// The examples are checked, and their specimens made.
#[test]
fn the_examples_are_recipes() {
    let mut count = 0;
    let particles = folder().with_file_name("particles");
    let files = [folder(), particles].map(|folder| std::fs::read_dir(folder).unwrap());
    for entry in files.into_iter().flatten() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|e| e == "toml") {
            let recipe = CheckedRecipe::from_file(&path, None).unwrap();
            let specimen = stemgen::specimen::specimen(&recipe).unwrap();
            assert!(specimen.sites(&recipe.field.full_region()).len() > 600, "{}", path.display());
            count += 1;
        }
    }
    assert_eq!(count, 9);
}
