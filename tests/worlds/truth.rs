//! Worlds of every material and tier, built over the whole field with a stand-in engine (and thin, to
//! be quick), and measured in the file.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Arc, Mutex};

use crate::common::{Spots, StandIn, build};
use crate::specimens::{normal_cdf, signed_distance};
use ndarray::Array2;
use stemgen::Result;
use stemgen::imaging::PixelBox;
use stemgen::io::{GroundTruth, WorldFile};
use stemgen::progress::Silent;
use stemgen::recipe::{Difficulty, Recipe};
use stemgen::structure::{Site, elements};
use stemgen::world::BuildOptions;

/// An image of one value; remembers the thermal displacement of the elements that it saw.
#[derive(Clone, Default)]
struct Flat {
    sigmas: Arc<Mutex<BTreeMap<&'static str, f64>>>,
}

impl StandIn for Flat {
    const NAME: &'static str = "flat";
    fn parameters(&self) -> serde_json::Value {
        serde_json::json!({})
    }
    fn image(&self, sites: &[Site], pixels: &PixelBox) -> Result<Array2<f64>> {
        let mut sigmas = self.sigmas.lock().unwrap();
        for site in sites {
            sigmas.insert(elements::symbol(site.number), site.sigma_angstrom);
        }
        Ok(Array2::from_elem(pixels.scan.shape, 0.02))
    }
}

struct Built {
    name: String,
    recipe: Recipe,
    world: WorldFile,
    truth: GroundTruth,
    sigmas: BTreeMap<&'static str, f64>,
}

/// The whole field, about 1 nm thick.
fn whole(folder: &Path, material: &str, difficulty: Difficulty) -> Built {
    let mut recipe = Recipe::load(material, difficulty).unwrap();
    recipe.field.thickness_nm = 1.0;
    let name = format!("{material} {}", difficulty.name());
    let path = folder.join(format!("{name}.h5"));
    let engine = Flat::default();
    let options = BuildOptions { noise: false, subtile_nm: Some(7.0), ..BuildOptions::default() };
    build(&recipe, &engine, &path, &options, &Silent).unwrap();
    let world = WorldFile::open(&path).unwrap();
    let truth = world.truth(0..world.site_count().unwrap()).unwrap();
    Built { name, recipe, world, truth, sigmas: engine.sigmas.lock().unwrap().clone() }
}

impl Built {
    /// Sites of an element, or that had it, and those among them with a defect of some name.
    fn rate(&self, elements: &[&str], defect: &str) -> [u64; 2] {
        let mut counts = [0; 2];
        for (number, name) in self.truth.numbers.iter().zip(&self.truth.defect_names) {
            if elements.contains(&elements::symbol(*number as u8)) {
                counts[0] += 1;
                counts[1] += u64::from(name == defect);
            }
        }
        let named = self.truth.defect_names.iter().filter(|n| !n.is_empty()).count() as u64;
        assert_eq!(counts[1], named, "{}: no other defects than {defect}", self.name);
        counts
    }

    #[track_caller]
    fn assert_rate(&self, [sites, defects]: [u64; 2], expected: f64) {
        let (n, rate) = (sites as f64, defects as f64 / sites as f64);
        let error = (expected * (1.0 - expected) / n).sqrt();
        let name = &self.name;
        assert!(
            (rate - expected).abs() < 3.0 * error,
            "{name}: {rate} of {n}, expected {expected}"
        );
    }

    /// Rate of vacancies among the oxygen sites further than 20 nm from all lines.
    fn far_rate(&self, lines: &[Vec<[f64; 2]>]) -> [u64; 2] {
        let mut counts = [0; 2];
        let sites = self.truth.numbers.iter().zip(&self.truth.positions).zip(&self.truth.types);
        for ((_, position), kind) in sites.filter(|((number, _), _)| **number == 8) {
            if signed_distance(lines, position.map(f64::from)).1.abs() > 20.0 {
                counts[0] += 1;
                counts[1] += u64::from(*kind == 1);
            }
        }
        assert!(counts[0] > 20_000, "{}", self.name);
        counts
    }

    /// Misfit of the order parameter, from the shift of oxygen against the titanium of its column, with
    /// a transition of `sigma_nm` across the lines.
    fn misfit(&self, lines: &[Vec<[f64; 2]>], sigma_nm: f64) -> f64 {
        let (mut sum, mut count) = (0.0, 0.0);
        let truth = &self.truth;
        let mut start = 0;
        for column in truth.columns.chunk_by(|a, b| a == b) {
            let members = start..start + column.len();
            start = members.end;
            let find = |number: i32| members.clone().find(|&n| truth.numbers[n] == number);
            let (Some(titanium), Some(oxygen)) = (find(22), find(8)) else { continue };
            let [ti, o] = [titanium, oxygen].map(|n| truth.positions[n].map(f64::from));
            let (line, d) = signed_distance(lines, ti);
            if d.abs() < 4.0 * sigma_nm {
                let order = (o[0] - ti[0]) / (0.033 * 0.4018);
                let rising = if line % 2 == 0 { d } else { -d };
                sum += (order - normal_cdf(rising / sigma_nm)).powi(2);
                count += 1.0;
            }
        }
        (sum / count).sqrt()
    }

    fn metadata(&self, configurations: usize, dose: f64, sigmas: &[(&str, f64)]) {
        assert_eq!(self.world.metadata().dose_electrons_per_angstrom2, Some(dose));
        let text = self.world.metadata().recipe.clone().unwrap();
        let stored = Recipe::from_toml_str("stored", &text, None).unwrap();
        assert_eq!(stored, self.recipe);
        assert_eq!(stored.phonons.configurations, configurations, "{}", self.name);
        let expected: BTreeMap<&str, f64> = sigmas.iter().copied().collect();
        assert_eq!(self.sigmas, expected, "{}", self.name);
    }

    fn phase_map(&self) -> Array2<i32> {
        let [height, width] = self.world.shape();
        self.world.phase_map(0..height, 0..width).unwrap().unwrap()
    }
}

fn in_f64(lines: Vec<Vec<[f32; 2]>>) -> Vec<Vec<[f64; 2]>> {
    lines.into_iter().map(|l| l.into_iter().map(|p| p.map(f64::from)).collect()).collect()
}

const TIERS: [(usize, f64); 3] = [(4, 1e4), (8, 5e3), (16, 1e3)];

#[test]
fn strontium_titanate() {
    let folder = tempfile::tempdir().unwrap();
    let table = [(1, 0.05, 0.6), (2, 0.03, 0.7), (3, 0.01, 0.8)];
    for ((difficulty, (count, rate, clustered)), (n, dose)) in
        Difficulty::ALL.into_iter().zip(table).zip(TIERS)
    {
        let built = whole(folder.path(), "srtio3", difficulty);
        built.metadata(n, dose, &[("Sr", 0.084), ("Ti", 0.060), ("O", 0.085)]);
        built.assert_rate(built.rate(&["O"], "vacancy_O"), rate);
        let lines = in_f64(built.world.boundaries().unwrap());
        assert_eq!(lines.len(), count);
        built.assert_rate(built.far_rate(&lines), (1.0 - clustered) * rate);
        assert!(built.world.phase_boundaries().unwrap().is_empty());
        assert!(built.world.phase_map(0..1, 0..1).unwrap().is_none());
    }
}

#[test]
#[ignore = "long"]
fn barium_titanate() {
    let folder = tempfile::tempdir().unwrap();
    let table =
        [(1, 0.04, 0.6, 0.0, 80.0), (2, 0.03, 0.7, 0.05, 50.0), (3, 0.015, 0.8, 0.10, 25.0)];
    for ((difficulty, row), (n, dose)) in Difficulty::ALL.into_iter().zip(table).zip(TIERS) {
        let (count, rate, clustered, waviness, sharpness_px) = row;
        let built = whole(folder.path(), "batio3", difficulty);
        built.metadata(n, dose, &[("Ba", 0.080), ("Ti", 0.080), ("O", 0.090)]);
        built.assert_rate(built.rate(&["O"], "vacancy_O"), rate);
        assert!(built.world.boundaries().unwrap().is_empty());
        let lines = in_f64(built.world.phase_boundaries().unwrap());
        assert_eq!(lines.len(), count);
        built.assert_rate(built.far_rate(&lines), (1.0 - clustered) * rate);
        let sigma = sharpness_px * built.world.metadata().pixel_size_nm;
        let misfits = [0.9, 1.0, 1.1].map(|s| built.misfit(&lines, s * sigma));
        assert!(misfits[1] < 0.5 * misfits[0].min(misfits[2]), "{}: {misfits:?}", built.name);
        let map = built.phase_map();
        let [height, width] = built.world.shape();
        let pixel = built.world.metadata().pixel_size_nm;
        // The map changes where the lines are, from 0 at the left; the lines are as wavy as asked.
        for row in (0..height).step_by(97) {
            let line = map.row(row);
            let changes: Vec<usize> = (1..width).filter(|&c| line[c] != line[c - 1]).collect();
            assert_eq!((changes.len(), line[0]), (count, 0), "{} row {row}", built.name);
            for (change, polyline) in changes.iter().zip(&lines) {
                let y = row as f64 * pixel;
                let pair = polyline.windows(2).find(|p| p[0][1] <= y && y <= p[1][1]).unwrap();
                let t = (y - pair[0][1]) / (pair[1][1] - pair[0][1]);
                let x = pair[0][0] + t * (pair[1][0] - pair[0][0]);
                let found = (*change as f64 - 0.5) * pixel;
                assert!((found - x).abs() < pixel, "{}: {found} {x}", built.name);
            }
        }
        for (k, line) in lines.iter().enumerate() {
            let mean = (k + 1) as f64 / (count + 1) as f64;
            let shares = line.iter().map(|p| (p[0] / (width as f64 * pixel) - mean).abs());
            let greatest = shares.fold(0.0, f64::max);
            assert!((greatest - waviness).abs() < 1e-3, "{}: {greatest}", built.name);
        }
    }
}

#[test]
fn silicon_germanium() {
    let folder = tempfile::tempdir().unwrap();
    for ((difficulty, rate), (n, dose)) in
        Difficulty::ALL.into_iter().zip([0.05, 0.03, 0.01]).zip(TIERS)
    {
        let built = whole(folder.path(), "sige", difficulty);
        built.metadata(n, dose, &[("Si", 0.078), ("Ge", 0.085)]);
        built.assert_rate(built.rate(&["Si", "Ge"], "substitution_Ge"), rate);
        // The mean place of the guests of a linear gradient is two thirds of the way.
        let width = built.world.metadata().fov_nm[1];
        let guests =
            built.truth.numbers.iter().zip(&built.truth.positions).filter(|(n, _)| **n == 32);
        let places: Vec<f64> = guests.map(|(_, p)| f64::from(p[0]) / width).collect();
        let mean = places.iter().sum::<f64>() / places.len() as f64;
        let error = (1.0 / 18.0 / places.len() as f64).sqrt();
        assert!((mean - 2.0 / 3.0).abs() < 4.0 * error, "{}: {mean}", built.name);
        assert!(built.world.phase_map(0..1, 0..1).unwrap().is_none());
    }
}

#[test]
#[ignore = "long"]
fn gallium_nitride() {
    let folder = tempfile::tempdir().unwrap();
    // Rate, wells, their width, and the shares of indium outside and inside.
    let table = [
        (0.05, 5, 4.0, (1e-3, 0.205)),
        (0.03, 6, 3.0, (2e-3, 0.135)),
        (0.01, 8, 2.0, (2e-3, 0.050)),
    ];
    for ((difficulty, row), (n, dose)) in Difficulty::ALL.into_iter().zip(table).zip(TIERS) {
        let (rate, count, width_nm, outside_and_inside) = row;
        let built = whole(folder.path(), "gan", difficulty);
        built.metadata(n, dose, &[("Ga", 0.059), ("N", 0.063), ("In", 0.065)]);
        built.assert_rate(built.rate(&["Ga", "In"], "substitution_In"), rate);
        assert_eq!(built.world.phase_boundaries().unwrap().len(), 2 * count);
        let map = built.phase_map();
        let share = map.iter().filter(|p| **p == 1).count() as f64 / map.len() as f64;
        let expected = count as f64 * width_nm / 80.0;
        assert!((share / expected - 1.0).abs() < 0.01, "{}: {share} {expected}", built.name);
        // Only the wells hold indium, but for the roughness along the beam; there its share is even.
        let pixel = built.world.metadata().pixel_size_nm;
        let mut inside = [[0u64; 2]; 2];
        for (number, position) in built.truth.numbers.iter().zip(&built.truth.positions) {
            if *number == 31 || *number == 49 {
                let at = position.map(|v| (f64::from(v) / pixel).round().max(0.0) as usize);
                let [row, column] = [at[1].min(map.nrows() - 1), at[0].min(map.ncols() - 1)];
                let counts = &mut inside[map[(row, column)] as usize];
                counts[0] += 1;
                counts[1] += u64::from(*number == 49);
            }
        }
        let indium = inside.map(|[n, i]| i as f64 / n as f64);
        let (most_outside, expected) = outside_and_inside;
        assert!(indium[0] <= most_outside, "{}: {indium:?}", built.name);
        assert!((indium[1] / expected - 1.0).abs() < 0.06, "{}: {indium:?}", built.name);
        let row = map.row(map.nrows() / 2);
        let starts = (1..row.len()).filter(|&c| row[c] > row[c - 1]).count();
        assert_eq!(starts, count, "{}", built.name);
    }
}

#[test]
fn the_noise_is_that_of_the_dose_in_every_tier() {
    let folder = tempfile::tempdir().unwrap();
    for material in ["srtio3", "batio3", "sige", "gan"] {
        for (difficulty, (_, dose)) in Difficulty::ALL.into_iter().zip(TIERS) {
            let path = folder.path().join(format!("{material}_{}.h5", difficulty.name()));
            let recipe = Recipe::load(material, difficulty).unwrap().with_grid(1, 2).unwrap();
            let options = BuildOptions { keep_clean: true, ..BuildOptions::default() };
            build(&recipe, &Spots::new(), &path, &options, &Silent).unwrap();
            let world = WorldFile::open(&path).unwrap();
            let [scale, offset] = world.metadata().scaling.unwrap();
            let (mut square, mut expected) = (0.0, 0.0);
            let pixel = 10.0 * world.metadata().pixel_size_nm;
            for column in 0..2 {
                let (tile, clean) =
                    (world.tile(0, column).unwrap(), world.clean_tile(0, column).unwrap());
                for (noisy, clean) in tile.iter().zip(&clean) {
                    let error = f64::from(*noisy) * scale + offset - f64::from(*clean);
                    square += error * error;
                    expected += f64::from(*clean) / (dose * pixel * pixel);
                }
            }
            let ratio = square / expected;
            assert!((ratio - 1.0).abs() < 0.05, "{material} {}: {ratio}", difficulty.name());
        }
    }
}
