//! Particles of any crystal on layers: shapes, orientations, places, contact, truth, and what is refused.

use crate::common::{Spots, build};
use crate::specimens::number;
use crate::stack::{checked, recipe, sites};
use stemgen::imaging::Cache;
use stemgen::io::WorldFile;
use stemgen::progress::Silent;
use stemgen::recipe::Recipe;
use stemgen::specimen::{ParticleTruth, SpecimenSite};
use stemgen::world::BuildOptions;

/// Platinum on GaAs, whose crystals come with the program.
const GOLD_ON_SLAB: &str = r#"
[stack]
along = "z"
begin_nm = 3.0
[[stack.layers]]
crystal = "gaas"
zone_axis = "[001]"
y_axis = "[010]"
[[stack.particles]]
crystal = "pt"
diameter_nm = [2.6, 2.6]
positions_nm = [[2.0, 2.0]]
surface_energies = { "(111)" = 1.0, "(100)" = 1.19 }
contact_plane = "(001)"
y_axis = "[010]"
contact_energy = 0.3
"#;
const ON_SLAB: &[&str] = &["Ga", "As", "Pt"];
const ON_CARBON: &str = r#"
[stack]
along = "z"
begin_nm = 2.5
[[stack.layers]]
amorphous = "C"
[[stack.particles]]
crystal = "srtio3"
count = 3
diameter_nm = [0.9, 1.3]
gap_nm = 0.2
surface_energies = { "(100)" = 1.0, "(110)" = 1.1 }
"#;

fn of(sites: &[SpecimenSite], symbols: &[&str]) -> Vec<[f64; 3]> {
    let numbers: Vec<u8> = symbols.iter().map(|s| number(s)).collect();
    sites.iter().filter(|s| numbers.contains(&s.number)).map(|s| s.position_nm).collect()
}

fn apart(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt()
}

fn nearest(from: &[[f64; 3]], to: &[[f64; 3]]) -> f64 {
    let pairs = from.iter().flat_map(|a| to.iter().map(|b| apart(*a, *b)));
    pairs.fold(f64::INFINITY, f64::min)
}

fn particles(stack: &str, thickness_nm: f64, elements: &[&str]) -> Vec<ParticleTruth> {
    let recipe = checked(stack, thickness_nm, elements);
    stemgen::specimen::specimen(&recipe).unwrap().particles()
}

#[test]
fn a_particle_rests_on_the_slab_with_the_plane_and_the_direction_that_were_asked_for() {
    let found = sites(&checked(GOLD_ON_SLAB, 4.5, ON_SLAB));
    let (metal, slab) = (of(&found, &["Pt"]), of(&found, &["Ga", "As"]));
    // The mean of the shortest distances of Pt-Pt and Ga-As; both faces are flat.
    let contact = 0.5 * (0.39236 / 2f64.sqrt() + 0.56533 * 3f64.sqrt() / 4.0);
    let gap = nearest(&metal, &slab);
    assert!((gap - contact).abs() < 1e-3, "{gap} {contact}");
    assert!(slab.iter().all(|at| at[2] > 2.99));
    // Planes (001) half a cell apart; rows along x and y, since [100] and [010] lie there.
    let lowest = metal.iter().map(|at| at[2]).fold(f64::NEG_INFINITY, f64::max);
    let corner = metal.iter().find(|at| (at[2] - lowest).abs() < 1e-6).unwrap();
    for at in &metal {
        let halves = [0, 1, 2].map(|k| (at[k] - corner[k]) / (0.5 * 0.39236));
        assert!(halves.iter().all(|h| (h - h.round()).abs() < 1e-6), "{halves:?}");
    }
    // Cut at 0.3 where the opposite facet has 1.19: the face on the slab is larger, and lies nearer to the widest plane.
    let on = |z: f64| metal.iter().filter(|at| (at[2] - z).abs() < 1e-6).count();
    let highest = metal.iter().map(|at| at[2]).fold(f64::INFINITY, f64::min);
    assert!(on(lowest) > 2 * on(highest), "{} {}", on(lowest), on(highest));
    let whole = GOLD_ON_SLAB.replace("contact_energy = 0.3\n", "");
    let uncut = of(&sites(&checked(&whole, 4.5, ON_SLAB)), &["Pt"]);
    let tall = |atoms: &[[f64; 3]]| {
        let z = || atoms.iter().map(|at| at[2]);
        z().fold(f64::NEG_INFINITY, f64::max) - z().fold(f64::INFINITY, f64::min)
    };
    // Of equal volume, and flatter.
    assert!((metal.len() as f64 / uncut.len() as f64 - 1.0).abs() < 0.15);
    assert!(tall(&metal) < 0.9 * tall(&uncut), "{} {}", tall(&metal), tall(&uncut));
    let truth = &particles(GOLD_ON_SLAB, 4.5, ON_SLAB)[0];
    let atoms = truth.diameter_nm.powi(3) * std::f64::consts::PI / 6.0 / 0.39236f64.powi(3) * 4.0;
    assert!((atoms - metal.len() as f64).abs() < 0.5, "{atoms} {}", metal.len());
    assert_eq!(truth.morphology, "wulff");
}

#[test]
fn on_the_side_where_the_beam_leaves_a_particle_is_the_mirror_image() {
    let exit = GOLD_ON_SLAB
        .replace("begin_nm = 3.0\n", "")
        .replace("y_axis = \"[010]\"\n[[", "y_axis = \"[010]\"\nthickness_nm = 1.5\n[[")
        .replace("contact_plane", "side = \"exit\"\ncontact_plane");
    let found = sites(&checked(&exit, 4.5, ON_SLAB));
    let (metal, slab) = (of(&found, &["Pt"]), of(&found, &["Ga", "As"]));
    let end = slab.iter().map(|at| at[2]).fold(f64::NEG_INFINITY, f64::max);
    assert!(metal.iter().all(|at| at[2] > end && at[2] < 4.5));
    let before = of(&sites(&checked(GOLD_ON_SLAB, 4.5, ON_SLAB)), &["Pt"]);
    assert!((metal.len() as f64 / before.len() as f64 - 1.0).abs() < 0.05);
    let low = metal.iter().map(|at| at[2]).fold(f64::INFINITY, f64::min);
    let high = metal.iter().map(|at| at[2]).fold(f64::NEG_INFINITY, f64::max);
    let on = |z: f64| metal.iter().filter(|at| (at[2] - z).abs() < 1e-6).count();
    assert!(on(low) > 2 * on(high));
}

#[test]
#[ignore = "long"]
fn particles_of_a_compound_lie_apart_on_a_rough_film_and_keep_their_bonds() {
    let recipe = checked(ON_CARBON, 3.5, &["Sr", "Ti", "O", "C"]);
    let specimen = stemgen::specimen::specimen(&recipe).unwrap();
    let found = specimen.sites(&recipe.field.full_region());
    let (oxide, carbon) = (of(&found, &["Sr", "Ti", "O"]), of(&found, &["C"]));
    let truth = specimen.particles();
    assert_eq!(truth.len(), 3);
    // No pair is nearer than the mean of the shortest distances of both elements: Ti-O 1.95, Sr-O 2.76 and C-C in the film.
    assert!(nearest(&oxide, &carbon) > 0.15);
    for particle in &truth {
        let [x, y, z] = particle.centre_nm;
        let own: Vec<[f64; 3]> =
            oxide.iter().copied().filter(|at| apart(*at, [x, y, z]) < 1.2).collect();
        let volume = own.len() as f64 * 0.3905f64.powi(3) / 5.0;
        let diameter = (6.0 * volume / std::f64::consts::PI).cbrt();
        assert!((diameter / particle.diameter_nm - 1.0).abs() < 1e-3, "{diameter} {particle:?}");
        // It touches: the distance to the film is a contact, not a gap.
        assert!(nearest(&own, &carbon) < 0.3);
        // Rotated rigidly: the shortest distance is Ti-O.
        let pairs = (0..own.len()).flat_map(|i| (0..i).map(move |j| (i, j)));
        let shortest = pairs.map(|(i, j)| apart(own[i], own[j])).fold(f64::INFINITY, f64::min);
        assert!((shortest - 0.19525).abs() < 1e-6, "{shortest}");
        let rotation = particle.orientation;
        let norm: f64 = rotation.iter().map(|q| q * q).sum();
        assert!((norm - 1.0).abs() < 1e-9);
    }
    for (n, a) in truth.iter().enumerate() {
        for b in &truth[..n] {
            let d = (0..2).map(|k| (a.centre_nm[k] - b.centre_nm[k]).powi(2)).sum::<f64>().sqrt();
            assert!(d > 0.5 * (a.diameter_nm + b.diameter_nm) + 0.2, "{d}");
        }
    }
}

#[test]
fn shapes_of_metals_and_spheres_and_tilts() {
    let elements = &["C", "Pt"];
    for (shape, more) in
        [("icosahedral", ""), ("decahedral", "max_tilt_deg = 2.0\n"), ("sphere", "")]
    {
        let stack = ON_CARBON
            .replace("srtio3", "pt")
            .replace("surface_energies", &format!("shape = \"{shape}\"\n{more}#"));
        let truth = particles(&stack, 3.5, elements);
        assert_eq!(truth.len(), 3);
        assert!(
            truth.iter().all(|p| p.morphology == shape && (0.85..1.35).contains(&p.diameter_nm))
        );
    }
    let tilted = format!("{ON_CARBON}zone_axis = \"[110]\"\nmax_tilt_deg = 4.0\n");
    for particle in particles(&tilted, 3.5, &["Sr", "Ti", "O", "C"]) {
        let [w, x, y, z] = particle.orientation;
        // The z component of the rotated direction [110] / sqrt(2).
        let along = [2.0 * (x * z - w * y), 2.0 * (y * z + w * x)];
        let cosine = (along[0] + along[1]) / 2f64.sqrt();
        assert!(cosine > 4f64.to_radians().cos() - 1e-9 && z.is_finite(), "{cosine}");
    }
}

#[test]
#[ignore = "long"]
fn particles_do_not_depend_on_the_number_of_threads() {
    let recipe = checked(ON_CARBON, 3.5, &["Sr", "Ti", "O", "C"]);
    let made = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| sites(&recipe))
    };
    assert!(made(1) == made(3));
    let other = recipe.with_seed(2).unwrap();
    let specimen = |recipe| stemgen::specimen::specimen(recipe).unwrap().particles();
    assert_ne!(specimen(&recipe), specimen(&other));
}

/// The file lists the particles, and its phase map holds their projections.
#[test]
fn the_truth_of_a_world_lists_particles_and_maps_their_projections() {
    let recipe = recipe(GOLD_ON_SLAB, 4.5, ON_SLAB).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("world.h5");
    let options = BuildOptions { cache: Cache::none(), ..BuildOptions::default() };
    build(&recipe, &Spots::new(), &path, &options, &Silent).unwrap();
    let world = WorldFile::open(&path).unwrap();
    assert_eq!(world.phase_names().unwrap(), ["gaas", "pt"]);
    let file = hdf5::File::open(&path).unwrap();
    let listed = file.group("ground_truth/particles").unwrap();
    let centres = listed.dataset("centre").unwrap();
    let centre = centres.read_raw::<f32>().unwrap();
    let [rows, width] = world.shape();
    let map = world.phase_map(0..rows, 0..width).unwrap().unwrap();
    let pixel = world.metadata().pixel_size_nm;
    let area = map.iter().filter(|phase| **phase == 1).count() as f64 * pixel * pixel;
    let own = particles(GOLD_ON_SLAB, 4.5, ON_SLAB);
    let circle = std::f64::consts::FRAC_PI_4 * own[0].diameter_nm.powi(2);
    // Flatter than a sphere, and with an edge of half a bond.
    assert!((1.0..1.6).contains(&(area / circle)), "{area} {circle}");
    let mut middle = [0.0; 2];
    let mut count = 0.0;
    for ((row, column), _) in map.indexed_iter().filter(|(_, phase)| **phase == 1) {
        middle = [middle[0] + column as f64 * pixel, middle[1] + row as f64 * pixel];
        count += 1.0;
    }
    for k in 0..2 {
        assert!((middle[k] / count - f64::from(centre[k])).abs() < 0.06, "{middle:?} {centre:?}");
    }
    let text = world.metadata().recipe.clone().unwrap();
    assert_eq!(Recipe::from_toml_str("again.toml", &text, None).unwrap(), recipe);
}

#[test]
#[ignore = "long"]
fn particles_that_cannot_be_are_refused_with_the_rule() {
    let error = |stack: &str, elements: &[&str]| -> String {
        let made = recipe(stack, 4.5, elements).and_then(Recipe::checked);
        let made = made.and_then(|recipe| stemgen::specimen::specimen(&recipe).map(|_| ()));
        made.err().map_or("no error".into(), |e| e.to_string())
    };
    let energies = "surface_energies = { \"(111)\" = 1.0, \"(100)\" = 1.19 }";
    let cases = [
        ("along = \"z\"\nbegin_nm = 3.0", "along = \"x\"", "expected along = \"z\""),
        (
            "along = \"z\"",
            "along = \"x\"",
            "only a stack along z has vacuum before its first layer",
        ),
        (energies, "", "needs the energies of its planes"),
        (energies, "surface_energies = { \"111\" = 1.0 }", "expected a lattice plane"),
        (
            energies,
            "surface_energies = { \"(111)\" = 1.0, \"(-111)\" = 1.0 }",
            "equal to another plane of the list",
        ),
        (
            energies,
            "shape = \"sphere\"\nsurface_energies = { \"(111)\" = 1.0 }",
            "only shape = \"wulff\" has surface energies",
        ),
        (energies, "shape = \"sphere\"", "contact_energy"),
        (energies, "shape = \"cube\"", "expected"),
        ("contact_energy = 0.3", "contact_energy = -1.2", "nothing of the particle is left"),
        (
            "contact_plane = \"(001)\"",
            "contact_plane = \"(011)\"",
            "encloses 45.00 degrees with the normal of the contact plane",
        ),
        ("contact_plane = \"(001)\"", "zone_axis = \"[001]\"", "with a contact_plane"),
        (
            "contact_plane",
            "zone_axis = \"[001]\"\ncontact_plane",
            "either zone_axis or contact_plane",
        ),
        (
            "begin_nm = 3.0",
            "begin_nm = 0.5",
            "there are 0.50 nm of vacuum for particles of up to 2.6 nm",
        ),
        ("begin_nm = 3.0", "begin_nm = 1.5", "nm out of the specimen; raise stack.begin_nm"),
        ("begin_nm = 3.0", "begin_nm = 4.4", "stack.begin_nm = 4.4"),
        ("[2.6, 2.6]", "[2.6, 2.0]", "the least diameter first"),
        ("[2.6, 2.6]", "[0.1, 2.0]", "stack.particles[1].diameter_nm = 0.1"),
        ("[[2.0, 2.0]]", "[[2.0, 2.0], [2.5, 2.5]]", "stack.particles[1], particle 2"),
        ("[[2.0, 2.0]]", "[[200.0, 2.0]]", "stack.particles[1].positions_nm"),
        ("positions_nm = [[2.0, 2.0]]", "count = 40", "no place was found for another"),
        ("positions_nm = [[2.0, 2.0]]", "count = 0", "expected 1 to 10000 particles"),
        ("positions_nm", "count = 1\npositions_nm", "leave out one of the two"),
        (
            "contact_energy",
            "side = \"exit\"\ncontact_energy",
            "give the last layer its thickness_nm",
        ),
    ];
    for (from, to, part) in cases {
        assert!(GOLD_ON_SLAB.contains(from), "{from}");
        let message = error(&GOLD_ON_SLAB.replacen(from, to, 1), ON_SLAB);
        assert!(message.contains(part), "{from} -> {to}: {message}");
    }
    let icosahedra = ON_CARBON.replace("surface_energies", "shape = \"icosahedral\"\n#");
    let message = error(&icosahedra, &["Sr", "Ti", "O", "C"]);
    assert!(message.contains("face-centred cubic metal"), "{message}");
    let open = ON_CARBON
        .replace("crystal = \"srtio3\"", "crystal = \"gan\"")
        .replace("\"(100)\" = 1.0, \"(110)\" = 1.1", "\"(001)\" = 1.0");
    let message = error(&open, &["Ga", "N", "C"]);
    assert!(message.contains("bound no finite particle"), "{message}");
}
