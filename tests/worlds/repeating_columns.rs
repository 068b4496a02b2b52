//! Columns that repeat among the atoms of a file or of a stack: they share a library.

use std::collections::{BTreeMap, HashMap};
use std::path::Path;

use crate::common::specimen;
use stemgen::engine::Algorithm;
use stemgen::imaging::{
    Audit, AuditOptions, Cache, MosaicImager, PixelRect, RegionImager, Simulator, audit,
};
use stemgen::progress::Silent;
use stemgen::recipe::{Recipe, Region};
use stemgen::specimen::{AtomColumn, SiteKind, SpecimenSite, UnitFamily};

/// SrTiO3, two cells thick, with vacuum beside it; some oxygen is missing. `across` is the number of cells along x and y.
fn crystal_and_vacuum(folder: &Path, across: [u32; 2], detector: &str) -> Recipe {
    let mut rows = Vec::new();
    let [nx, ny] = across;
    for n in 0..nx * ny * 2 {
        let [i, j, k] = [n % nx, n / nx % ny, n / (nx * ny)].map(f64::from);
        let basis = [
            ("Sr", [0.0, 0.0, 0.0]),
            ("Ti", [0.5, 0.5, 0.5]),
            ("O", [0.5, 0.5, 0.0]),
            ("O", [0.5, 0.0, 0.5]),
            ("O", [0.0, 0.5, 0.5]),
        ];
        for (m, (symbol, at)) in basis.into_iter().enumerate() {
            let [x, y, z] = [i + at[0], j + at[1], k + at[2]].map(|v| 3.905 * v);
            let missing = symbol == "O" && (n * 5 + m as u32).wrapping_mul(2_654_435_761) % 97 < 3;
            let label = if missing { "0 vacancy_O" } else { "1 none" };
            rows.push(format!(
                "{} {x:.4} {y:.4} {z:.4} {label}",
                if missing { "X" } else { symbol }
            ));
        }
    }
    let properties = "Properties=species:S:1:pos:R:3:occupancy:R:1:defect:S:1";
    let head = format!("Lattice=\"80 0 0 0 80 0 0 0 20\" {properties}");
    let text = format!("{}\n{head}\n{}\n", rows.len(), rows.join("\n"));
    std::fs::write(folder.join("own.xyz"), text).unwrap();
    let text = format!(
        r#"
        version = 1
        id = "own"
        structure = "atoms"
        seed = 1
        atoms = {{ file = "own.xyz" }}
        field = {{ fov_nm = [7.2, 7.2], grid = [3, 3], tile_px = 120, overlap_px = 0, thickness_nm = 0.8 }}
        phonons = {{ configurations = 1, sigma_angstrom = {{ Sr = 0.084, Ti = 0.060, O = 0.085 }} }}
        optics = {{ energy_kv = 200.0, convergence_mrad = 21.0 }}
        {detector}
        dose = {{ electrons_per_angstrom2 = 1e5 }}
        "#
    );
    let path = folder.join("own.toml");
    std::fs::write(&path, text).unwrap();
    Recipe::from_file(&path, None).unwrap()
}

const HIGH_ANGLES: &str = "detector = { inner_mrad = 50.0, outer_mrad = 90.0 }";

fn mosaic(recipe: &Recipe) -> Box<dyn RegionImager> {
    let simulator = Simulator::new(recipe, Algorithm::Window { width_angstrom: 7.8 });
    let whole = specimen(recipe).unwrap();
    let recipe = recipe.clone().checked().unwrap();
    let mosaic = MosaicImager::new(&recipe, &whole, simulator, Cache::none()).unwrap();
    let mut mosaic: Box<dyn RegionImager> = Box::new(mosaic);
    mosaic.prepare(&Silent).unwrap();
    mosaic
}

fn audited(recipe: &Recipe, at_nm: Vec<[f64; 2]>) -> Audit {
    let options = AuditOptions { at_nm, size_nm: 1.0, ..AuditOptions::default() };
    let whole = specimen(recipe).unwrap();
    audit(&recipe.clone().checked().unwrap(), &*whole, &*mosaic(recipe), &options, &Silent).unwrap()
}

/// A column without its place, as an independent reader of the rule would describe it: atoms by depth about the column.
fn atoms_of(column: &AtomColumn, sites: &[SpecimenSite]) -> Vec<(u8, bool, [i64; 3])> {
    let of = |s: &SpecimenSite| {
        let [x, y, z] = s.position_nm;
        let place = [x - column.position_nm[0], y - column.position_nm[1], z];
        (s.number, s.kind == SiteKind::Vacancy, place.map(|v| (v * 1e3).round() as i64))
    };
    sites[column.sites.clone()].iter().map(of).collect()
}

#[test]
fn columns_with_equal_atoms_and_neighbours_share_a_family() {
    let folder = tempfile::tempdir().unwrap();
    let recipe = crystal_and_vacuum(folder.path(), [16, 18], HIGH_ANGLES);
    let whole = specimen(&recipe).unwrap();
    let found = whole.query(&recipe.field.full_region());
    let mut families: HashMap<UnitFamily, Vec<&AtomColumn>> = HashMap::new();
    let mut alone = 0;
    for column in &found.columns {
        match column.unit {
            Some(tag) => families.entry(tag.family).or_default().push(column),
            None => alone += 1,
        }
    }
    // Four kinds of columns in the crystal, more at its faces and beside vacancies.
    let largest = families.values().map(Vec::len).max().unwrap();
    assert!(families.len() > 8 && largest > 100, "{} families, {largest}", families.len());
    assert!(alone > 0 && alone < found.columns.len() / 4, "{alone} of {}", found.columns.len());
    let near = |column: &AtomColumn| -> BTreeMap<[i64; 2], usize> {
        let [x, y] = column.position_nm;
        let region = Region { x: [x - 0.5, x + 0.5], y: [y - 0.5, y + 0.5] };
        let others = whole.query(&region).columns.into_iter().map(|other| {
            let [dx, dy] = [0, 1].map(|k| other.position_nm[k] - column.position_nm[k]);
            ([dx, dy].map(|v| (v * 1e2).round() as i64), other.sites.len())
        });
        others.collect()
    };
    for members in families.values() {
        assert!(members.len() >= 4);
        let (first, surroundings) = (members[0], near(members[0]));
        let counts = |column: &AtomColumn| {
            let mut atoms: Vec<_> = atoms_of(column, &found.sites)
                .into_iter()
                .map(|(number, vacant, _)| (number, vacant))
                .collect();
            atoms.sort_unstable();
            atoms
        };
        for column in members {
            assert_eq!(counts(column), counts(first));
            assert_eq!(near(column), surroundings, "{column:?}");
        }
    }
    // Every family has a library cell whose unit holds the atoms of its columns.
    for (family, members) in &families {
        let cell = whole.library_cell(*family).unwrap();
        let unit = &cell.units[0];
        assert_eq!((cell.units.len(), unit.members.len()), (1, 1));
        let held = unit.members[0].iter().filter(|site| site.number > 0).count();
        let atoms = atoms_of(members[0], &found.sites);
        assert_eq!(held, atoms.iter().filter(|(_, vacant, _)| !vacant).count());
        let inside = |v: f64, k: usize| (0.0..=cell.box_angstrom[k]).contains(&v);
        let all = cell.surroundings.iter().flatten().chain(&unit.members[0]);
        assert!(all.clone().count() > 100);
        assert!(all.into_iter().all(|s| (0..2).all(|k| inside(s.position[k], k))));
    }
}

#[test]
fn the_scan_of_a_unit_lies_where_a_tilted_beam_meets_it() {
    let folder = tempfile::tempdir().unwrap();
    let recipe = crystal_and_vacuum(folder.path(), [8, 8], HIGH_ANGLES);
    let tilted =
        recipe.clone().with_overrides(&["optics.mistilt_mrad=[20.0, 0.0]".parse().unwrap()]);
    let middle = |recipe: &Recipe| {
        let whole = specimen(recipe).unwrap();
        let columns = whole.columns(&recipe.field.full_region());
        let tag = columns.iter().find_map(|column| column.unit).unwrap();
        let cell = whole.library_cell(tag.family).unwrap();
        let unit = cell.units[0].centre;
        [0, 1].map(|k| cell.scan_origin[k] + 0.5 * cell.scanned[k] - unit[k])
    };
    let [straight, tilted] = [middle(&recipe), middle(&tilted.unwrap())];
    // Half of 8 A of thickness.
    let way = 4.0 * 0.02f64.tan();
    assert!((straight[0] - tilted[0] - way).abs() < 2e-3, "{straight:?} {tilted:?}");
    assert!((straight[1] - tilted[1]).abs() < 1e-9);
}

#[test]
fn the_mosaic_of_own_atoms_passes_an_audit_inside_and_at_the_edge() {
    let folder = tempfile::tempdir().unwrap();
    let recipe = crystal_and_vacuum(folder.path(), [10, 10], HIGH_ANGLES);
    // The crystal covers 1.7 to 5.5 nm along x; the second region holds its face and vacuum.
    let found = audited(&recipe, vec![[3.7, 3.5], [2.0, 3.6]]);
    // In one configuration, neighbours that vibrate otherwise change a column by one or two per cent.
    assert!(found.bright_rms_percent < 2.5, "{}", found.bright_rms_percent);
    assert!(found.all_rms_percent < 0.5, "{}", found.all_rms_percent);
    // Column by column the vacancies and displacements are those of the exact image.
    for kind in found.kinds.iter().filter(|kind| kind.kind != "O") {
        assert!(kind.columns > 5 && kind.correlation > 0.98, "{kind:?}");
    }
}

#[test]
fn vacuum_beside_own_atoms_is_bright_in_the_bright_field() {
    let folder = tempfile::tempdir().unwrap();
    let bright = "detector = { inner_mrad = 0.0, outer_mrad = 15.0 }";
    let recipe = crystal_and_vacuum(folder.path(), [4, 4], bright);
    let empty = PixelRect::new([100, 0], [8, 8]);
    let image = mosaic(&recipe).mean_of(&empty, 1, &Silent).unwrap();
    let vacuum = (15.0f64 / 21.0).powi(2);
    let worst = image.iter().map(|v| (v / vacuum - 1.0).abs()).fold(0.0, f64::max);
    assert!(worst < 0.02, "{worst}: {image}");
}
