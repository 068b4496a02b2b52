//! The crystals in `structures/` against literature, and supercells along their zone axes.

use std::path::Path;
use stemgen::structure::{Atom, Structure, elements, lattice, min_pair_distance, read};

fn crystal(name: &str) -> Structure {
    let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/..")).join("structures");
    read(&folder.join(name)).unwrap_or_else(|e| panic!("{e}"))
}

/// Standard atomic weights in u.
fn weight(number: u8) -> f64 {
    match elements::symbol(number) {
        "C" => 12.011,
        "N" => 14.007,
        "O" => 15.999,
        "Si" => 28.085,
        "Ti" => 47.867,
        "Ga" => 69.723,
        "Ge" => 72.630,
        "As" => 74.922,
        "Sr" => 87.62,
        "In" => 114.818,
        "Ba" => 137.327,
        "S" => 32.06,
        "Se" => 78.971,
        "Mo" => 95.95,
        "W" => 183.84,
        "Pt" => 195.084,
        other => panic!("no weight for {other}"),
    }
}

/// Density in g/cm3.
fn density(s: &Structure) -> f64 {
    let mass: f64 = s.atoms.iter().map(|a| weight(a.number) * a.occupancy).sum();
    mass * 1.660_539 / lattice::determinant(&s.cell).abs()
}

/// Composition such as `O3 Sr1 Ti1`.
fn composition(s: &Structure) -> String {
    let mut symbols: Vec<&str> = s.atoms.iter().map(|a| elements::symbol(a.number)).collect();
    symbols.sort_unstable();
    symbols
        .chunk_by(|a, b| a == b)
        .map(|chunk| format!("{}{}", chunk[0], chunk.len()))
        .collect::<Vec<_>>()
        .join(" ")
}

/// File, cell content, density (g/cm3) and nearest distance (A) from handbooks. Handbook densities
/// of GaN and InN differ by 1 % from those of their cells; those of MoS2, WSe2 and graphite are for layers as far apart as in the bulk.
const CRYSTALS: [(&str, &str, f64, f64); 12] = [
    ("srtio3.cif", "O3 Sr1 Ti1", 5.12, 1.953),
    ("batio3_cubic.cif", "Ba1 O3 Ti1", 6.01, 2.005),
    ("batio3_tetragonal.cif", "Ba1 O3 Ti1", 6.02, 1.872),
    ("si.cif", "Si8", 2.329, 2.352),
    ("ge.cif", "Ge8", 5.323, 2.450),
    ("gaas.cif", "As4 Ga4", 5.317, 2.448),
    ("gan.cif", "Ga2 N2", 6.15, 1.949),
    ("inn.cif", "In2 N2", 6.81, 2.150),
    ("pt.cif", "Pt4", 21.45, 2.774),
    ("mos2.cif", "Mo1 S2", 5.06, 2.410),
    ("wse2.cif", "Se2 W1", 9.32, 2.526),
    ("graphene.cif", "C2", 2.266, 1.421),
];

#[test]
fn crystals_agree_with_literature() {
    for (name, content, literature, nearest) in CRYSTALS {
        let s = crystal(name);
        assert_eq!(composition(&s), content, "{name}");
        let got = density(&s);
        assert!((got / literature - 1.0).abs() < 0.015, "{name}: density {got}");
        let got = min_pair_distance(&s).unwrap();
        assert!((got - nearest).abs() < 2e-3, "{name}: nearest {got}");
    }
}

#[test]
fn every_crystal_is_in_the_table_and_names_its_source() {
    let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/..")).join("structures");
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_none_or(|e| e != "cif") {
            continue;
        }
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        assert!(CRYSTALS.iter().any(|c| c.0 == name), "{name} is not tested");
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.starts_with("# "), "{name} has no source");
    }
}

/// Distances below `cutoff` between every atom and all others, sorted.
fn distances(s: &Structure, cutoff: f64) -> Vec<f64> {
    let reach = lattice::face_distances(&s.cell).map(|w| (cutoff / w).ceil() as i32 + 1);
    let mut list = Vec::new();
    for a in &s.atoms {
        for b in &s.atoms {
            for i in -reach[0]..=reach[0] {
                for j in -reach[1]..=reach[1] {
                    for k in -reach[2]..=reach[2] {
                        let shift = lattice::row_times([i, j, k].map(f64::from), &s.cell);
                        let d = lattice::norm(std::array::from_fn(|x| {
                            b.position[x] + shift[x] - a.position[x]
                        }));
                        if d > 1e-6 && d < cutoff {
                            list.push(d);
                        }
                    }
                }
            }
        }
    }
    list.sort_by(f64::total_cmp);
    list
}

/// The box must hold `cells` cells, and every atom must see the surroundings it had.
#[track_caller]
fn check_oriented(s: &Structure, zone: [i32; 3], cells: usize, edges: [f64; 3]) {
    let o = s.oriented(zone, None).unwrap();
    assert_eq!(o.atoms.len(), cells * s.atoms.len(), "{zone:?}");
    let got = o.orthogonal_box().unwrap();
    for axis in 0..3 {
        assert!((got[axis] - edges[axis]).abs() < 1e-9, "{zone:?}: {got:?}, expected {edges:?}");
        assert!(o.atoms.iter().all(|a| (0.0..got[axis]).contains(&a.position[axis])));
    }
    let cutoff = 5.3;
    let (before, after) = (distances(s, cutoff), distances(&o, cutoff));
    assert_eq!(before.len() * cells, after.len(), "{zone:?}");
    for (i, d) in after.iter().enumerate() {
        assert!((d - before[i / cells]).abs() < 1e-6, "{zone:?}: {d}");
    }
}

#[test]
fn zone_axes_of_cubic_crystals() {
    let a = 3.905;
    let (r2, r3, r6) = (2f64.sqrt(), 3f64.sqrt(), 6f64.sqrt());
    let sto = crystal("srtio3.cif");
    check_oriented(&sto, [0, 0, 1], 1, [a, a, a]);
    check_oriented(&sto, [1, 0, 0], 1, [a, a, a]);
    check_oriented(&sto, [-2, 0, 0], 1, [a, a, a]);
    check_oriented(&sto, [1, 1, 0], 2, [a * r2, a, a * r2]);
    check_oriented(&sto, [1, 1, 1], 6, [a * r6, a * r2, a * r3]);
    check_oriented(&sto, [1, 1, 2], 6, [a * r3, a * r2, a * r6]);
    let a = 5.431;
    check_oriented(&crystal("si.cif"), [1, 1, 0], 2, [a * r2, a, a * r2]);
    let a = 5.65325;
    check_oriented(&crystal("gaas.cif"), [1, -1, 0], 2, [a * r2, a, a * r2]);
}

#[test]
fn zone_axes_of_hexagonal_crystals() {
    let (a, c, r3) = (3.189, 5.185, 3f64.sqrt());
    let gan = crystal("gan.cif");
    // [11-20] is [110] of the three-index notation, [1-100] is [210] or [1-10].
    check_oriented(&gan, [1, 1, 0], 2, [a * r3, c, a]);
    check_oriented(&gan, [1, 0, 0], 2, [a * r3, c, a]);
    check_oriented(&gan, [2, 1, 0], 2, [c, a, a * r3]);
    check_oriented(&gan, [0, 0, 1], 2, [a * r3, a, c]);
    let (a, c) = (3.2094, 5.2107);
    let magnesium = Structure {
        cell: [[a, 0.0, 0.0], [-a / 2.0, a * r3 / 2.0, 0.0], [0.0, 0.0, c]],
        atoms: [[0.0, 0.0, 0.0], [0.0, a / r3, c / 2.0]]
            .map(|position| Atom::new(12, position))
            .to_vec(),
    };
    check_oriented(&magnesium, [0, 0, 1], 2, [a * r3, a, c]);
    check_oriented(&magnesium, [1, 1, 0], 2, [a * r3, c, a]);
}

#[test]
fn up_is_the_y_axis() {
    let gan = crystal("gan.cif");
    let o = gan.oriented([1, 1, 0], Some([0, 0, 1])).unwrap();
    // Gallium-polar: above each Ga, at u c along +c, stands a nitrogen.
    let ga = o.atoms.iter().find(|a| a.number == 31).unwrap();
    let up = o.atoms.iter().any(|n| {
        let d: [f64; 3] = std::array::from_fn(|i| {
            let d = n.position[i] - ga.position[i];
            d - o.cell[i][i] * (d / o.cell[i][i]).round()
        });
        n.number == 7 && d[0].abs() < 1e-9 && d[2].abs() < 1e-9 && (d[1] - 1.9547).abs() < 1e-3
    });
    assert!(up, "{o:?}");
    let down = gan.oriented([1, 1, 0], Some([0, 0, -1])).unwrap();
    assert_ne!(o, down);
}

#[test]
fn an_orthogonal_cell_stays_as_it_is() {
    let bto = crystal("batio3_tetragonal.cif");
    assert_eq!(bto.oriented([0, 0, 1], None).unwrap(), bto);
    assert_eq!(bto.oriented([0, 0, 3], Some([0, 1, 0])).unwrap(), bto);
    let mut long = bto.clone();
    long.cell[1][1] = 6.0;
    assert_eq!(long.oriented([0, 0, 1], None).unwrap(), long);
}

/// The signed volume of three bonds keeps its sign only if nothing is mirrored.
#[test]
fn chirality_survives() {
    let cell = [[6.0, 0.0, 0.0], [0.0, 6.0, 0.0], [0.0, 0.0, 6.0]];
    let positions = [[0.0; 3], [1.0, 0.2, 0.0], [0.1, 1.3, 0.0], [0.0, 0.3, 1.7]];
    let atoms: Vec<Atom> = positions
        .iter()
        .enumerate()
        .map(|(i, &position)| Atom::new(i as u8 + 1, position))
        .collect();
    let right = Structure { cell, atoms };
    let left_handed_vectors = Structure { cell: [cell[1], cell[0], cell[2]], ..right.clone() };
    for s in [right, left_handed_vectors] {
        for zone in [[0, 0, 1], [1, 0, 0], [0, -1, 0], [1, 1, 0], [1, -1, 1], [2, 1, 0]] {
            let o = s.oriented(zone, None).unwrap();
            assert!((chiral_volume(&o) - 2.176).abs() < 1e-6, "{zone:?} {}", chiral_volume(&o));
        }
    }
}

fn chiral_volume(o: &Structure) -> f64 {
    let center = o.atoms.iter().find(|a| a.number == 1).unwrap().position;
    let bond = |number: u8| -> [f64; 3] {
        o.atoms
            .iter()
            .filter(|a| a.number == number)
            .map(|a| {
                std::array::from_fn(|i| {
                    let d = a.position[i] - center[i];
                    d - o.cell[i][i] * (d / o.cell[i][i]).round()
                })
            })
            .min_by(|a, b| lattice::norm(*a).total_cmp(&lattice::norm(*b)))
            .unwrap()
    };
    lattice::determinant(&[bond(2), bond(3), bond(4)])
}

#[test]
fn cells_without_right_angles_say_how_near_they_come() {
    let beta = 100f64.to_radians();
    let cell = [[5.1, 0.0, 0.0], [0.0, 6.3, 0.0], [7.3 * beta.cos(), 0.0, 7.3 * beta.sin()]];
    let atoms = vec![Atom::new(40, [0.0; 3])];
    let s = Structure { cell, atoms };
    let error = s.oriented([0, 0, 1], None).unwrap_err().to_string();
    assert!(error.contains("no orthogonal box") && error.contains("degrees off"), "{error}");
    let error = s.oriented([0, 0, 1], Some([1, 0, 0])).unwrap_err().to_string();
    assert!(error.contains("encloses 100.000 degrees"), "{error}");
}

#[test]
fn angles_within_the_tolerance_are_made_right() {
    let beta = 90.03f64.to_radians();
    let cell = [[5.1, 0.0, 0.0], [0.0, 6.3, 0.0], [7.3 * beta.cos(), 0.0, 7.3 * beta.sin()]];
    let position = lattice::row_times([0.5, 0.25, 0.75], &cell);
    let s = Structure { cell, atoms: vec![Atom { occupancy: 0.5, ..Atom::new(40, position) }] };
    let o = s.oriented([0, 0, 1], None).unwrap();
    assert_eq!(o.atoms.len(), 1);
    let edges = o.orthogonal_box().unwrap();
    let expected = [5.1, 6.3, 7.3];
    let mut sorted = edges;
    sorted.sort_by(f64::total_cmp);
    for (got, expected) in sorted.iter().zip(expected) {
        assert!((got - expected).abs() < 1e-9);
    }
    assert_eq!(o.atoms[0].occupancy, 0.5);
}
