//! Files that are easily read wrong: each gives the right atoms, or says what is wrong.

use std::path::{Path, PathBuf};
use stemgen::structure::{
    Format, FrameRange, ReadStructure, Structure, elements, min_pair_distance, parse_noted,
    read_frames, read_noted, sigmas_of_file,
};

fn path(name: &str) -> PathBuf {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/structures")).join(name)
}

fn good(name: &str) -> ReadStructure {
    read_noted(&path("good").join(name)).unwrap_or_else(|e| panic!("{e}"))
}

fn count(structure: &Structure, symbol: &str) -> usize {
    structure.atoms.iter().filter(|a| elements::symbol(a.number) == symbol).count()
}

/// A cubic CIF of 5 A, with more tags and rows of label, type symbol, x, y, z and occupancy.
fn cif(tags: &str, rows: &str) -> ReadStructure {
    let text = format!(
        "data_t\n_cell_length_a 5\n_cell_length_b 5\n_cell_length_c 5\n_cell_angle_alpha 90\n\
         _cell_angle_beta 90\n_cell_angle_gamma 90\n{tags}\nloop_\n_atom_site_label\n\
         _atom_site_type_symbol\n_atom_site_fract_x\n_atom_site_fract_y\n_atom_site_fract_z\n\
         _atom_site_occupancy\n{rows}\n"
    );
    parse_noted(Format::Cif, text.as_bytes(), Path::new("t.cif")).unwrap_or_else(|e| panic!("{e}"))
}

fn drawn(read: &ReadStructure, cells: usize) -> Structure {
    read.structure.repeat([cells; 3]).unwrap().resolve_occupancy(1).unwrap()
}

#[test]
fn each_cell_holds_one_of_the_alternatives() {
    let read = good("disorder_groups.cif");
    let resolved = drawn(&read, 8);
    assert_eq!((count(&resolved, "Pb"), count(&resolved, "I")), (512, 512));
    assert!(min_pair_distance(&resolved).unwrap() > 2.0);
    let first = resolved.atoms.iter().filter(|a| a.number == 53);
    let at_half = first.filter(|a| (a.position[0] / 5.0).fract() < 0.53).count();
    assert!((250..365).contains(&at_half), "{at_half} of 512, expected 0.6 of them");
    assert!(read.notes.is_empty(), "{:?}", read.notes);
}

/// Turning a crystal does not mix the places of its cells.
#[test]
fn alternatives_stay_together_in_turned_cells() {
    let turned = good("disorder_groups.cif").structure.oriented([1, 1, 0], None).unwrap();
    let resolved = turned.repeat([3, 3, 3]).unwrap().resolve_occupancy(1).unwrap();
    assert_eq!(count(&resolved, "Pb"), count(&resolved, "I"));
}

/// A molecule in two orientations: its atoms stand together, though they are far apart.
#[test]
fn atoms_of_a_group_stand_together() {
    let columns = "_atom_site_disorder_assembly\n_atom_site_disorder_group";
    let rows =
        "C1 C .2 .5 .5 .6 A 1\nN1 N .5 .5 .5 .6 A 1\nC2 C .8 .5 .5 .4 A 2\nN2 N .5 .8 .5 .4 A 2";
    let read = cif("", &format!("{columns}\n{rows}"));
    let resolved = drawn(&read, 6);
    assert_eq!((count(&resolved, "C"), count(&resolved, "N")), (216, 216));
    let at = |z: u8, axis: usize, low: f64, high: f64| {
        let inside = |x: f64| (low..high).contains(&(x / 5.0).fract());
        let atoms = resolved.atoms.iter().filter(|a| a.number == z);
        atoms.filter(|a| inside(a.position[axis])).count()
    };
    assert_eq!(at(6, 0, 0.1, 0.3), at(7, 1, 0.4, 0.6));
}

/// mmCIF names the alternative locations of each residue. The two residues here lie farther apart than any bond.
#[test]
fn alternative_locations_of_mmcif_stand_together_residue_by_residue() {
    let columns = "_atom_site.label_alt_id\n_atom_site.auth_asym_id\n_atom_site.auth_seq_id";
    let rows = "C1 C .1 .2 .2 .6 A X 1\nN1 N .4 .2 .2 .6 A X 1\nC2 C .1 .2 .5 .4 B X 1\n\
                S1 S .4 .2 .5 .4 B X 1\nP1 P .6 .6 .8 .5 A X 2\nF1 F .9 .6 .8 .5 B X 2\n\
                O1 O .6 .9 .2 1 . X 3";
    let read = cif("", &format!("{columns}\n{rows}"));
    assert!(read.notes.is_empty(), "{:?}", read.notes);
    let resolved = drawn(&read, 6);
    let of = |symbol| count(&resolved, symbol);
    assert_eq!((of("C"), of("N") + of("S"), of("P") + of("F"), of("O")), (216, 216, 216, 216));
    // Each carbon of the first alternative has its nitrogen, whatever the other residue does.
    let low = |z: u8| {
        let atoms = resolved.atoms.iter().filter(|a| a.number == z);
        let mut cells: Vec<_> = atoms
            .filter(|a| (a.position[2] / 5.0).fract() < 0.3)
            .map(|a| a.position.map(|x| (x / 5.0) as usize))
            .collect();
        cells.sort_unstable();
        cells
    };
    assert_eq!(low(6), low(7));
    assert!(
        (90..170).contains(&of("N")) && (75..140).contains(&of("P")),
        "{}, {}",
        of("N"),
        of("P")
    );
}

#[test]
fn sites_closer_than_a_bond_are_alternatives_without_groups_too() {
    let read = cif("", "I1 I .5 .5 .5 .6\nI2 I .56 .5 .5 .4");
    let resolved = drawn(&read, 6);
    assert_eq!(resolved.atoms.len(), 216);
    // Three positions of a split site, each a third.
    let read = cif("", "K1 K .5 .5 .5 .333\nK2 K .6 .5 .5 .333\nK3 K .55 .58 .5 .334");
    assert_eq!(drawn(&read, 6).atoms.len(), 216);
    // A hydroxyl group of half occupancy keeps its hydrogen: 0.95 A is a bond.
    let read = cif("", "O1 O .5 .5 .5 .5\nH1 H .69 .5 .5 .5");
    let resolved = drawn(&read, 8);
    let pairs = min_pair_distance(&resolved).unwrap();
    assert!((pairs - 0.95).abs() < 1e-6, "both are there in some cells");
}

#[test]
fn sites_that_are_too_full_to_exclude_each_other_are_reported() {
    let read = cif("", "I1 I .5 .5 .5 .8\nI2 I .6 .5 .5 .7");
    assert!(read.notes[0].contains("closer than any bond"), "{:?}", read.notes);
    assert!(read.notes[0].contains("0.50 A apart"), "{:?}", read.notes);
}

#[test]
fn magnetic_operations_are_understood() {
    let read = good("magnetic.cif");
    assert_eq!((count(&read.structure, "Mn"), count(&read.structure, "O")), (4, 8));
    let centred = good("magnetic_centred.cif").structure;
    assert_eq!((count(&centred, "Mn"), count(&centred, "O")), (2, 4));
}

#[test]
fn water_is_oxygen_and_said() {
    let read = good("water_labels.cif");
    assert_eq!((count(&read.structure, "Ca"), count(&read.structure, "O")), (2, 4));
    assert!(read.notes[0].contains("2 sites are named as water"), "{:?}", read.notes);
}

#[test]
fn pairs_and_loops_are_one() {
    let iron = good("items_not_loop.cif").structure;
    assert_eq!(count(&iron, "Fe"), 1);
    let both = good("two_atom_loops.cif").structure;
    assert_eq!((count(&both, "Si"), count(&both, "O")), (1, 1));
}

#[test]
fn cartesian_sites_are_read() {
    let carbon = good("cartesian_sites.cif").structure;
    for (atom, expected) in carbon.atoms.iter().zip([[0.1, 0.2, 0.3], [2.1, 2.2, 2.3]]) {
        for (x, e) in atom.position.iter().zip(expected) {
            assert!((x - e).abs() < 1e-12, "{:?}", atom.position);
        }
    }
    // In a frame of the file's own: x along b, moved by 1 A.
    let text = std::fs::read_to_string(path("good/cartesian_sites.cif")).unwrap();
    let mut frame = String::from("_atom_sites_Cartn_tran_vector_1 1\n");
    for (i, row) in [[0, 5, 0], [5, 0, 0], [0, 0, 6]].iter().enumerate() {
        for (j, value) in row.iter().enumerate() {
            frame += &format!("_atom_sites_Cartn_tran_matrix_{}{} {value}\n", i + 1, j + 1);
        }
    }
    let text = text.replacen("loop_", &format!("{frame}loop_"), 1);
    let read = parse_noted(Format::Cif, text.as_bytes(), Path::new("t.cif")).unwrap();
    let [x, y, z] = read.structure.atoms[1].position;
    assert!((x - 2.2).abs() + (y - 1.1).abs() + (z - 2.3).abs() < 1e-9, "{x} {y} {z}");
}

/// U_eq = (U33 + 4/3 (U11 + U22 - U12)) / 3 in a hexagonal cell.
#[test]
fn anisotropic_displacements_follow_the_metric_of_the_cell() {
    let sigmas = sigmas_of_file(&path("good/hexagonal_u.cif")).unwrap().sigmas;
    let expected = ((0.03 + 4.0 / 3.0 * 0.04) / 3.0_f64).sqrt();
    assert!((sigmas.of(14).unwrap() - expected).abs() < 1e-9);
    assert!((expected - 0.1667).abs() < 1e-4);
}

#[test]
fn the_origin_of_a_cell_is_honoured() {
    let read = good("origin.xyz").structure;
    assert_eq!(read.atoms[0].position, [0.0; 3]);
    assert_eq!(read.atoms[1].position, [2.0; 3]);
}

#[test]
fn comments_in_a_poscar_are_passed_over() {
    assert_eq!(good("POSCAR_comments").structure, good("POSCAR_comments").structure);
    assert_eq!(good("POSCAR_comments").structure.cell[0], [4.0, 0.0, 0.0]);
}

#[test]
fn the_frames_of_an_xdatcar_are_read_as_such() {
    let all = FrameRange { start: 0, end: None, step: 1 };
    let frames = read_frames(&path("bad/XDATCAR_two_frames"), all).unwrap();
    assert_eq!(frames.len(), 2);
    assert!((frames[1].structure.atoms[0].position[0] - 0.04).abs() < 1e-12);
}

#[test]
fn a_composition_that_is_not_the_formulas_is_reported() {
    let notes = |tags: &str, rows: &str| cif(tags, rows).notes;
    let cscl = "Cs1 Cs 0 0 0 1\nCl1 Cl .5 .5 .5 1";
    assert!(notes("_chemical_formula_sum 'Cs Cl'\n_cell_formula_units_Z 1", cscl).is_empty());
    let wrong_z = notes("_chemical_formula_sum 'Cs Cl'\n_cell_formula_units_Z 4", cscl);
    for part in ["Cl 1, Cs 1", "_cell_formula_units_Z 4", "Cl 4, Cs 4", "1.000 formula units"] {
        assert!(wrong_z[0].contains(part), "{part}: {wrong_z:?}");
    }
    let other = notes("_chemical_formula_sum 'Cs Cl3'", cscl);
    assert!(other[0].contains("check"), "{other:?}");
    let water = notes("_chemical_formula_sum 'Cs Cl H2'", cscl);
    assert!(water[0].contains("hydrogen is not among the sites"), "{water:?}");
    // The sum of the whole cell, as pymatgen writes it.
    let cell = "Cs1 Cs 0 0 0 1\nCs2 Cs 0 0 .5 1\nCl1 Cl .5 .5 .25 1\nCl2 Cl .5 .5 .75 1";
    assert!(notes("_chemical_formula_sum 'Cs2 Cl2'\n_cell_formula_units_Z 2", cell).is_empty());
    let half = "Cs1 Cs 0 0 0 .5\nRb1 Rb 0 0 0 .5\nCl1 Cl .5 .5 .5 1";
    assert!(notes("_chemical_formula_sum 'Cs0.5 Rb0.5 Cl'", half).is_empty());
}

#[test]
fn a_multiplicity_that_the_operations_do_not_make_is_reported() {
    let read = cif("", "_atom_site_symmetry_multiplicity\nSi1 Si 0 0 0 1 8");
    let note = &read.notes[0];
    assert!(note.contains("`Si1`") && note.contains("is 8") && note.contains("make 1"), "{note}");
    assert!(cif("", "_atom_site_symmetry_multiplicity\nSi1 Si 0 0 0 1 1").notes.is_empty());
}
