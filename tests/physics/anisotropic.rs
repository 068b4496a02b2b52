//! Anisotropic displacements: of CIFs, of atoms at hand, and as they are drawn.

use std::f64::consts::PI;
use std::path::{Path, PathBuf};
use stemgen::engine::displaced;
use stemgen::simulation::{AtomsSource, FromFile, PreparedSpecimen, SigmaChoice, SpecimenRequest};
use stemgen::structure::{
    Atom, DisplacementTensor, Format, Structure, parse, read, sigmas_of_file,
};

type Matrix = [[f64; 3]; 3];

/// Labels and six components on the reciprocal axes.
const ROWS: &str = "Si1 0.0080 0.0062 0.0095 0.0031 0.0002 0.0004\n\
                    Si2 0.0261 0.0143 0.0312 0.0098 -0.0072 -0.0051\n";
/// Indices and structure factors over the form factor, by gemmi 0.7.5 (tests/structures/anisotropic_by_gemmi.py).
const GEMMI: [([f64; 3], [f64; 2]); 6] = [
    ([1.0, 0.0, 0.0], [-3.6332299, 0.0]),
    ([0.0, 2.0, 1.0], [1.1293312, 1.9560590]),
    ([3.0, -1.0, 2.0], [2.0211420, 2.6813685]),
    ([-2.0, 5.0, 1.0], [2.3995492, 0.2935942]),
    ([4.0, 1.0, -6.0], [-1.7153028, -0.8008223]),
    ([1.0, 1.0, 9.0], [1.2791482, -0.4415178]),
];

fn trigonal() -> PathBuf {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/structures/good/trigonal_u.cif");
    Path::new(path).to_owned()
}

/// The trigonal crystal with other rows of displacements.
fn with_rows(columns: &str, rows: &str) -> String {
    let text = std::fs::read_to_string(trigonal()).unwrap();
    let (head, _) = text.rsplit_once("loop_").unwrap();
    format!("{head}loop_\n{columns}\n{rows}\n")
}

fn columns(letter: &str) -> String {
    let all = ["11", "22", "33", "12", "13", "23"];
    let components = all.map(|ij| format!("_atom_site_aniso_{letter}_{ij}"));
    format!("_atom_site_aniso_label\n{}", components.join("\n"))
}

fn tensors(text: &str) -> Vec<Matrix> {
    let read = parse(Format::Cif, text.as_bytes(), Path::new("t.cif")).unwrap();
    read.atoms.iter().map(|atom| atom.displacement.unwrap().matrix()).collect()
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|k| a[k] * b[k]).sum()
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|i| a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3])
}

/// Mean square displacements along pairs of axes: `axes u axes^T`.
fn along(axes: &Matrix, u: &Matrix) -> Matrix {
    let times = |v: [f64; 3]| u.map(|row| dot(row, v));
    axes.map(|a| axes.map(|b| dot(a, times(b))))
}

fn prepare(source: &AtomsSource, zone: Option<[i32; 3]>, sigma: SigmaChoice) -> PreparedSpecimen {
    let request = SpecimenRequest {
        zone,
        up: zone.map(|_| [0, 0, 1]),
        phonons: Some(1),
        sigma_angstrom: Some(sigma),
        repeat: Some([1, 1, 2]),
        ..SpecimenRequest::default()
    };
    request.prepare(source).unwrap()
}

fn from_file() -> SigmaChoice {
    SigmaChoice::FromFile(FromFile::FromFile)
}

/// Conversion and symmetry: the Debye-Waller factors of all atoms, which symmetry made of two, add to the structure factors of gemmi.
#[test]
fn structure_factors_are_those_of_gemmi() {
    let crystal = read(&trigonal()).unwrap();
    assert_eq!(crystal.atoms.len(), 9);
    let [a, b, c] = crystal.cell;
    let volume = dot(a, cross(b, c));
    let reciprocal = [cross(b, c), cross(c, a), cross(a, b)].map(|v| v.map(|x| x / volume));
    for (hkl, expected) in GEMMI {
        let s = [0, 1, 2].map(|k| (0..3).map(|i| hkl[i] * reciprocal[i][k]).sum::<f64>());
        let mut sum = [0.0; 2];
        for atom in &crystal.atoms {
            let u = atom.displacement.unwrap().matrix();
            let factor = (-2.0 * PI * PI * dot(s, u.map(|row| dot(row, s)))).exp();
            let phase = 2.0 * PI * dot(s, atom.position);
            sum[0] += factor * phase.cos();
            sum[1] += factor * phase.sin();
        }
        let off = (sum[0] - expected[0]).hypot(sum[1] - expected[1]);
        assert!(off < 2e-7, "{hkl:?}: {sum:?}, expected {expected:?}");
    }
}

/// Displacements that are drawn have the covariance of the tensor, turned with the crystal.
#[test]
fn drawn_displacements_have_the_covariance_of_the_tensor() {
    let crystal = read(&trigonal()).unwrap();
    let zone = [1, 0, 0];
    let specimen = prepare(&AtomsSource::File(trigonal()), Some(zone), from_file());
    assert!(specimen.notes.iter().any(|n| n.contains("anisotropic")), "{:?}", specimen.notes);
    let unit = |v: [f64; 3]| v.map(|x| x / dot(v, v).sqrt());
    let (y, z) = (unit(crystal.cell[2]), unit(crystal.cell[0]));
    let axes = [cross(y, z), y, z];
    // The atoms of a cell follow each other: image 4 of the second site is atom 7.
    let expected = along(&axes, &crystal.atoms[7].displacement.unwrap().matrix());
    let cells = specimen.sites.len() / 9;
    assert!(cells >= 4);
    let (mut found, mut count) = ([[0.0; 3]; 3], 0);
    for cell in 0..cells {
        let site = specimen.sites[9 * cell + 7];
        let stored = site.displacement_tensor();
        let off = (0..9).map(|k| (stored[k / 3][k % 3] - expected[k / 3][k % 3]).abs());
        assert!(off.fold(0.0, f64::max) < 1e-8, "{stored:?}, expected {expected:?}");
        for configuration in 0..10_000 {
            let moved = displaced(&site, 3, configuration);
            let u = [0, 1, 2].map(|k| moved[k] - site.position[k]);
            (0..9).for_each(|k| found[k / 3][k % 3] += u[k / 3] * u[k % 3]);
            count += 1;
        }
    }
    // The standard deviation of a mean over 40 000 squares is below 0.8 % of the largest component.
    let largest = expected.as_flattened().iter().fold(0.0_f64, |m, u| m.max(u.abs()));
    for (sum, u) in found.as_flattened().iter().zip(expected.as_flattened()) {
        let mean = sum / f64::from(count);
        assert!((mean - u).abs() < 0.03 * largest, "{mean}, expected {u}: {found:?}");
    }
}

/// An isotropic tensor moves atoms to the same bits as the standard deviation does, in a turned hexagonal cell too.
#[test]
fn isotropic_tensors_give_the_bits_of_sigma() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("isotropic.cif");
    let row = "0.0064 0.0064 0.0064 0.0032 0 0";
    let text = with_rows(&columns("U"), &format!("Si1 {row}\nSi2 {row}"));
    std::fs::write(&path, text).unwrap();
    let mut crystal = read(&path).unwrap();
    let file = AtomsSource::File(path);
    let sigma = 0.083_712_345_678_9_f64;
    for atom in &mut crystal.atoms {
        let u = sigma * sigma;
        atom.displacement =
            Some(DisplacementTensor::new([[u, 0.0, 0.0], [0.0, u, 0.0], [0.0, 0.0, u]]).unwrap());
    }
    let given = AtomsSource::Given(crystal);
    for (source, sigma) in [(&file, 0.08), (&given, sigma)] {
        for zone in [[0, 0, 1], [2, 1, 0]] {
            let request = SpecimenRequest {
                zone: Some(zone),
                phonons: Some(1),
                sigma_angstrom: Some(from_file()),
                ..SpecimenRequest::default()
            };
            let all = SpecimenRequest {
                sigma_angstrom: Some(SigmaChoice::All(sigma)),
                ..request.clone()
            };
            let places = |request: SpecimenRequest| {
                let sites = request.prepare(source).unwrap().sites;
                sites.iter().map(|s| displaced(s, 1, 5)).collect::<Vec<_>>()
            };
            assert_eq!(places(request), places(all), "{zone:?}");
        }
    }
}

/// B is 8 pi^2 U, and beta is 2 pi^2 a*_i a*_j U; mmCIF gives U on Cartesian axes.
#[test]
fn notations_are_one_tensor() {
    let expected = tensors(&with_rows(&columns("U"), ROWS));
    let crystal = read(&trigonal()).unwrap();
    let scaled = |factors: [f64; 6]| -> String {
        let row = |line: &str| {
            let mut words = line.split(' ');
            let label = words.next().unwrap();
            let values =
                words.zip(factors).map(|(u, f)| (u.parse::<f64>().unwrap() * f).to_string());
            format!("{label} {}\n", values.collect::<Vec<_>>().join(" "))
        };
        ROWS.lines().map(row).collect()
    };
    let a = 1.0 / (4.9134 * 0.75_f64.sqrt());
    let c = 1.0 / 5.4052;
    let beta = [a * a, a * a, c * c, a * a, a * c, a * c].map(|f| 2.0 * PI * PI * f);
    let b = with_rows(&columns("B"), &scaled([8.0 * PI * PI; 6]));
    let beta = with_rows(&columns("beta"), &scaled(beta));
    let components = ["11", "22", "33", "12", "13", "23"];
    let tags = components.map(|ij| format!("_atom_site_anisotrop.U[{}][{}]", &ij[..1], &ij[1..]));
    let row = |index: usize, label: &str| {
        let u = crystal.atoms[index].displacement.unwrap().matrix();
        let place = |ij: &str| ij.bytes().map(|d| usize::from(d - b'1')).collect::<Vec<_>>();
        let values = components.map(|ij| u[place(ij)[0]][place(ij)[1]].to_string());
        format!("{label} {}\n", values.join(" "))
    };
    let cartesian = with_rows(
        &format!("_atom_site_anisotrop.id\n{}", tags.join("\n")),
        &[row(0, "Si1"), row(3, "Si2")].concat(),
    );
    for text in [b, beta, cartesian] {
        for (got, expected) in tensors(&text).as_flattened().iter().zip(expected.as_flattened()) {
            let off = (0..3).map(|k| (got[k] - expected[k]).abs()).fold(0.0, f64::max);
            assert!(off < 1e-9, "{got:?}, expected {expected:?}");
        }
    }
}

#[test]
fn tensors_that_no_vibration_has_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bad.cif");
    let stated = |second: &str| {
        let first = ROWS.lines().next().unwrap();
        let text = with_rows(&columns("U"), &format!("{first}\nSi2 {second}"));
        std::fs::write(&path, text).unwrap();
        sigmas_of_file(&path)
    };
    let notes = stated("0.02 0.02 -0.001 0.01 0 0").unwrap().notes;
    assert!(notes[0].contains("1 sites") && notes[0].contains("Si2 (-0.0010)"), "{notes:?}");
    let own: Vec<bool> =
        read(&path).unwrap().atoms.iter().map(|atom| atom.displacement.is_some()).collect();
    assert_eq!(own, [[true; 3], [false; 3], [false; 3]].concat());
    let sites = prepare(&AtomsSource::File(path.clone()), Some([1, 0, 0]), from_file());
    let note = sites.notes.iter().any(|n| n.contains("for 12 of 36 atoms"));
    assert!(note, "{:?}", sites.notes);
    // Zeros are no displacement.
    assert!(stated("0 0 0 0 0 0").unwrap().notes.is_empty());
    let error = stated("1.5 0.02 0.03 0 0 0").unwrap_err().to_string();
    assert!(error.contains("`Si2`") && error.contains("at most 1"), "{error}");
    let refused = |u: Matrix| DisplacementTensor::new(u).unwrap_err().to_string();
    let tilted = [[0.01, 0.02, 0.0], [0.02, 0.01, 0.0], [0.0, 0.0, 0.01]];
    assert!(refused(tilted).contains("-0.010000 square Angstrom"), "{}", refused(tilted));
    let skew = [[0.01, 0.002, 0.0], [0.001, 0.01, 0.0], [0.0, 0.0, 0.01]];
    assert!(refused(skew).contains("symmetric"));
    let in_plane = [[0.01, 0.0, 0.0], [0.0, 0.01, 0.0], [0.0; 3]];
    let flat = Atom {
        displacement: Some(DisplacementTensor::new(in_plane).unwrap()),
        ..Atom::new(14, [1.0; 3])
    };
    let cell = [[4.0, 0.0, 0.0], [0.0, 4.0, 0.0], [0.0, 0.0, 4.0]];
    let given = AtomsSource::Given(Structure { cell, atoms: vec![flat] });
    let site = prepare(&given, None, from_file()).sites[0];
    let moved = displaced(&site, 1, 1);
    assert!(moved[2] == 1.0 && moved[0] != 1.0);
    let still = Atom { displacement: None, ..flat };
    let some = AtomsSource::Given(Structure { cell, atoms: vec![still] });
    let request = SpecimenRequest {
        phonons: Some(1),
        sigma_angstrom: Some(from_file()),
        ..SpecimenRequest::default()
    };
    assert!(request.prepare(&some).unwrap_err().to_string().contains("no file"));
}
