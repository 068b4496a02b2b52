//! Faults, dislocations and precipitates of stacks.

use crate::specimens::shortest;
use crate::stack::{checked, recipe, sites};
use stemgen::recipe::{CheckedRecipe, Recipe, Region};
use stemgen::specimen::{BoundaryKind, SpecimenSite};

const SILICON: &str = r#"
[[stack.layers]]
crystal = "si"
zone_axis = "[110]"
y_axis = "[1-11]"
"#;

const PEROVSKITE: &str = r#"
[[stack.layers]]
crystal = "srtio3"
zone_axis = "[001]"
y_axis = "[010]"
"#;

/// Whether a list of sites holds an atom at a place.
fn holds(sites: &[SpecimenSite], at: [f64; 3], number: u8) -> bool {
    sites
        .iter()
        .any(|s| s.number == number && (0..3).all(|k| (s.position_nm[k] - at[k]).abs() < 1e-6))
}

fn middle(sites: &[SpecimenSite]) -> impl Iterator<Item = &SpecimenSite> {
    let inside = Region { x: [0.0, 4.0], y: [0.0, 4.0] };
    sites.iter().filter(move |s| inside.contains([s.position_nm[0], s.position_nm[1]]))
}

/// Bonds of silicon: sqrt(3) / 4 of the cell.
const BOND_NM: f64 = 0.235_17;

/// Number of bonds of each site in the middle of the field, by the number of bonds; sites at the faces are left out.
fn bonds(sites: &[SpecimenSite], thickness_nm: f64) -> Vec<usize> {
    let mut counts = vec![0; 8];
    let around = Region { x: [-0.5, 4.5], y: [-0.5, 4.5] };
    let near: Vec<&SpecimenSite> =
        sites.iter().filter(|s| around.contains([s.position_nm[0], s.position_nm[1]])).collect();
    for site in middle(sites).filter(|s| (0.3..thickness_nm - 0.4).contains(&s.position_nm[2])) {
        let bonded = near.iter().filter(|other| {
            let d: f64 = (0..3).map(|k| (site.position_nm[k] - other.position_nm[k]).powi(2)).sum();
            d > 0.0 && d.sqrt() < 1.05 * BOND_NM
        });
        counts[bonded.count()] += 1;
    }
    counts
}

#[test]
fn a_twin_is_its_own_mirror_image_and_keeps_all_bonds() {
    let fault = "[[stack.faults]]\nkind = \"twin\"\nplane = \"(1-11)\"\nposition_nm = [2.0, 2.0]\n";
    let recipe = checked(&format!("{SILICON}{fault}"), 1.6, &["Si"]);
    let found = sites(&recipe);
    let boundary = &stemgen::specimen::specimen(&recipe).unwrap().boundaries()[0];
    let plane = boundary.line_nm[0][1];
    assert!((plane - 2.0).abs() < 0.35, "{plane}");
    assert!(matches!(boundary.kind, BoundaryKind::Fault { kind: "twin", .. }));
    let mut count = 0;
    for site in middle(&found) {
        let [x, y, z] = site.position_nm;
        assert!(holds(&found, [x, 2.0 * plane - y, z], 14), "{:?}", site.position_nm);
        count += 1;
    }
    assert!(count > 900, "{count}");
    let counts = bonds(&found, 1.6);
    assert!(counts[4] > 400 && counts.iter().sum::<usize>() == counts[4], "{counts:?}");
    // The crystal itself is no mirror image of itself.
    let whole = sites(&checked(SILICON, 1.6, &["Si"]));
    let mirrored = middle(&whole).all(|s| {
        holds(&whole, [s.position_nm[0], 2.0 * plane - s.position_nm[1], s.position_nm[2]], 14)
    });
    assert!(!mirrored);
}

#[test]
fn a_stacking_fault_shifts_by_its_vector() {
    let fault = "[[stack.faults]]\nkind = \"stacking_fault\"\nplane = \"(1-11)\"\nposition_nm = [2.0, 2.0]\nshift = \"1/6[1-1-2]\"\n";
    let faulted = checked(&format!("{SILICON}{fault}"), 1.6, &["Si"]);
    let (found, whole) = (sites(&faulted), sites(&checked(SILICON, 1.6, &["Si"])));
    let boundary = &stemgen::specimen::specimen(&faulted).unwrap().boundaries()[0];
    let plane = boundary.line_nm[0][1];
    let BoundaryKind::Fault { kind: "stacking_fault", normal, shift_nm } = boundary.kind else {
        panic!("{boundary:?}")
    };
    // |1/6 [1 -1 -2]| = a sqrt(6) / 6, in the plane.
    assert!(
        (shift_nm[0].abs() - 0.5431 * 6f64.sqrt() / 6.0).abs() < 1e-9 && shift_nm[1].abs() < 1e-9
    );
    assert!((normal[1] - 1.0).abs() < 1e-9);
    let mut moved = 0;
    for site in middle(&found) {
        let beyond = site.position_nm[1] > plane;
        let by = if beyond { shift_nm } else { [0.0; 3] };
        let origin = std::array::from_fn(|k| site.position_nm[k] - by[k]);
        assert!(holds(&whole, origin, 14), "{:?}", site.position_nm);
        moved += usize::from(beyond && !holds(&whole, site.position_nm, 14));
    }
    assert!(moved > 300, "{moved}");
    let counts = bonds(&found, 1.6);
    assert_eq!(counts.iter().sum::<usize>(), counts[4], "{counts:?}");
}

#[test]
fn an_antiphase_boundary_puts_other_atoms_in_the_places() {
    let fault = "[[stack.faults]]\nkind = \"antiphase\"\nplane = \"(100)\"\nposition_nm = [2.0, 2.0]\nshift = \"1/2[011]\"\n";
    let recipe = checked(&format!("{PEROVSKITE}{fault}"), 0.8, &["Sr", "Ti", "O"]);
    let found = sites(&recipe);
    let specimen = stemgen::specimen::specimen(&recipe).unwrap();
    let plane = specimen.boundaries()[0].line_nm[0][0];
    // Rows of Sr along x end at the plane, and continue half a cell aside.
    let rows = |right: bool| {
        let mut rows: Vec<i64> = middle(&found)
            .filter(|s| s.number == 38 && (s.position_nm[0] > plane) == right)
            .map(|s| (s.position_nm[1] / 0.3905 * 100.0).round() as i64 % 100)
            .collect();
        rows.sort_unstable();
        rows.dedup();
        rows
    };
    assert_eq!((rows(false), rows(true)), (vec![0], vec![50]));
    assert!(shortest(&*specimen, &recipe.field.full_region()) > 0.75 * 1.95);
}

/// The displacement of Hirth and Lothe, with the Burgers vector b along x; the arc tangent jumps on the negative x axis.
fn hirth_lothe(b: f64, nu: f64, [x, y]: [f64; 2]) -> [f64; 2] {
    let r2 = x * x + y * y;
    let k = b / (2.0 * std::f64::consts::PI);
    let u = k * (y.atan2(x) + x * y / (2.0 * (1.0 - nu) * r2));
    let v = -k
        * ((1.0 - 2.0 * nu) / (4.0 * (1.0 - nu)) * (r2 / (b * b)).ln()
            + (x * x - y * y) / (4.0 * (1.0 - nu) * r2));
    [u, v]
}

fn with_edge(burgers: &str) -> CheckedRecipe {
    let edge = format!(
        "[[stack.dislocations]]\nposition_nm = [2.1, 2.1]\nburgers = \"{burgers}\"\npoisson_ratio = 0.24\n"
    );
    checked(&format!("{PEROVSKITE}{edge}"), 0.8, &["Sr", "Ti", "O"])
}

#[test]
fn atoms_about_an_edge_dislocation_lie_where_hirth_and_lothe_put_them() {
    let recipe = with_edge("[100]");
    let specimen = stemgen::specimen::specimen(&recipe).unwrap();
    let truth = specimen.facts().stack.clone().unwrap();
    let dislocation = &truth.dislocations[0];
    assert!((dislocation.burgers_nm[0] - 0.3905).abs() < 1e-9);
    let [cx, cy] = dislocation.position_nm;
    assert!((cx - 2.1).abs() < 1e-9 && (cy - 2.1).abs() < 0.2);
    // Between two planes of atoms: a quarter of the cell beside a plane.
    assert!((((cy / 0.3905 * 2.0).rem_euclid(1.0)) - 0.5).abs() < 1e-6, "{cy}");
    let (found, whole) = (sites(&recipe), sites(&checked(PEROVSKITE, 0.8, &["Sr", "Ti", "O"])));
    let mut count = 0;
    for site in middle(&whole) {
        let [x, y, z] = site.position_nm;
        let [u, v] = hirth_lothe(0.3905, 0.24, [x - cx, y - cy]);
        // Atoms of the core may be left out.
        if (x - cx).hypot(y - cy) > 0.5 {
            assert!(holds(&found, [x + u, y + v, z], site.number), "{x} {y}: {u} {v}");
            count += 1;
        }
    }
    assert!(count > 800, "{count}");
    let nearest = shortest(&*specimen, &recipe.field.full_region());
    assert!(nearest >= 0.75 * 1.9525 - 1e-9, "{nearest}");
}

/// A circuit of steps from one Sr column to the next, as many to the left as to the right and as many down as up, ends beside its beginning
/// if it goes around the line, and at its beginning if not.
#[test]
fn the_burgers_circuit_fails_to_close_by_one_lattice_vector() {
    for (burgers, axis) in [("[100]", 0), ("[0-10]", 1)] {
        let recipe = with_edge(burgers);
        let specimen = stemgen::specimen::specimen(&recipe).unwrap();
        let truth = specimen.facts().stack.clone().unwrap().dislocations[0].clone();
        let columns: Vec<[f64; 2]> = sites(&recipe)
            .iter()
            .filter(|s| s.number == 38 && s.position_nm[2] < 0.1)
            .map(|s| [s.position_nm[0], s.position_nm[1]])
            .collect();
        let nearest = |at: [f64; 2]| {
            let off = |p: &[f64; 2]| (p[0] - at[0]).hypot(p[1] - at[1]);
            *columns.iter().min_by(|a, b| off(a).total_cmp(&off(b))).unwrap()
        };
        let circuit = |centre: [f64; 2]| {
            let start = nearest([centre[0] - 1.6, centre[1] - 1.6]);
            let mut at = start;
            for [dx, dy] in [[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]] {
                for _ in 0..8 {
                    at = nearest([at[0] + 0.3905 * dx, at[1] + 0.3905 * dy]);
                }
            }
            [at[0] - start[0], at[1] - start[1]]
        };
        // The lattice steps add to 0, so the gap is the displacement gained on the way from x to y.
        let gap = circuit(truth.position_nm);
        let expected = [0, 1].map(|k| truth.burgers_nm[k]);
        assert!((gap[0] - expected[0]).hypot(gap[1] - expected[1]) < 0.05, "{burgers}: {gap:?}");
        assert!((expected[axis].abs() - 0.3905).abs() < 1e-9);
        let [x, y] = truth.position_nm;
        let away = circuit([x + 4.0, y + 4.0]);
        assert!(away[0].hypot(away[1]) < 1e-9, "{away:?}");
    }
}

#[test]
fn a_precipitate_has_its_lattice_and_the_matrix_ends_before_it() {
    let stack = r#"
[[stack.layers]]
crystal = "si"
zone_axis = "[001]"
y_axis = "[010]"
[[stack.precipitates]]
name = "particle"
crystal = "pt"
zone_axis = "[110]"
y_axis = "[001]"
centre_nm = [2.0, 2.0, 1.5]
size_nm = [2.4, 2.4, 2.4]
"#;
    let recipe = checked(stack, 3.0, &["Si", "Pt"]);
    let specimen = stemgen::specimen::specimen(&recipe).unwrap();
    let found = specimen.sites(&recipe.field.full_region());
    let platinum: Vec<&SpecimenSite> = found.iter().filter(|s| s.number == 78).collect();
    let volume = 4.0 / 3.0 * std::f64::consts::PI * 1.2f64.powi(3);
    let expected = volume * 4.0 / 0.39236f64.powi(3);
    assert!((platinum.len() as f64 / expected - 1.0).abs() < 0.1, "{} {expected}", platinum.len());
    let radius = |s: &SpecimenSite| {
        (0..3).map(|k| (s.position_nm[k] - [2.0, 2.0, 1.5][k]).powi(2)).sum::<f64>().sqrt()
    };
    assert!(platinum.iter().all(|s| radius(s) < 1.2001));
    assert!(found.iter().filter(|s| s.number == 14).all(|s| radius(s) > 1.1999));
    // [001] of Pt lies along y: planes a / 2 apart.
    let mut heights: Vec<f64> = platinum.iter().map(|s| s.position_nm[1]).collect();
    heights.sort_by(f64::total_cmp);
    heights.dedup_by(|a, b| (*a - *b).abs() < 1e-4);
    assert!(heights.windows(2).all(|w| (w[1] - w[0] - 0.19618).abs() < 1e-6), "{heights:?}");
    assert_eq!(specimen.facts().phases, ["si", "particle"]);
    assert_eq!(specimen.phase_at([2.0, 2.0]), 1);
    // Si-Pt: the mean of 0.75 times the two shortest distances, 1.92 A.
    let nearest = shortest(&*specimen, &recipe.field.full_region());
    assert!(nearest >= 0.75 * 2.3517 - 1e-4, "{nearest}");
}

#[test]
fn defects_that_cannot_be_made_are_refused() {
    let error = |stack: String, elements: &[&str]| -> String {
        let made = recipe(&stack, 0.8, elements).and_then(Recipe::checked);
        made.err().map_or("no error".into(), |e| e.to_string())
    };
    let fault = |text: &str| {
        error(format!("{SILICON}[[stack.faults]]\nposition_nm = [2.0, 2.0]\n{text}\n"), &["Si"])
    };
    let edge = |text: &str| {
        error(format!("{PEROVSKITE}[[stack.dislocations]]\n{text}\n"), &["Sr", "Ti", "O"])
    };
    let place = "position_nm = [2.0, 2.0]";
    let cases = [
        (fault("kind = \"twin\"\nplane = \"(001)\""), "encloses 0.0 degrees"),
        (fault("kind = \"twin\"\nplane = \"(110)\""), "encloses 90.0 degrees with the beam"),
        (fault("kind = \"twin\"\nplane = \"[111]\""), "expected a lattice plane such as"),
        (
            fault("kind = \"twin\"\nplane = \"(1-11)\"\nlayer = 2"),
            "expected the number of a layer, from 1 to 1",
        ),
        (
            fault("kind = \"twin\"\nplane = \"(1-11)\"\nshift = \"[100]\""),
            "has no shift; leave it out",
        ),
        (fault("kind = \"stacking_fault\"\nplane = \"(1-11)\""), "needs its shift"),
        (
            fault("kind = \"stacking_fault\"\nplane = \"(1-11)\"\nshift = \"1/3[1-11]\""),
            "encloses 90.0 degrees with the plane",
        ),
        (
            fault("kind = \"stacking_fault\"\nplane = \"(1-11)\"\nshift = \"1/2[110]\""),
            "so that there is no fault",
        ),
        (fault("kind = \"slip\"\nplane = \"(1-11)\""), "twin"),
        (
            edge(&format!("{place}\nburgers = \"[001]\"")),
            "encloses 90.0 degrees with the plane of the image",
        ),
        (edge(&format!("{place}\nburgers = \"1/2[110]\"")), "no lattice vector of the crystal"),
        (
            edge("position_nm = [200.0, 2.0]\nburgers = \"[100]\""),
            "stack.dislocations[1].position_nm = 200",
        ),
    ];
    for (n, (message, part)) in cases.iter().enumerate().skip(1) {
        assert!(message.contains(part), "case {n}: {message}");
    }
    // (001) holds [110].
    assert_eq!(cases[0].0, "no error");
}
