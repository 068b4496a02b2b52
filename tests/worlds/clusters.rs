//! Vacancies that gather in clusters at random places.

use crate::common::{Spots, build, specimen};
use stemgen::progress::Silent;
use stemgen::recipe::{Difficulty, Recipe};
use stemgen::specimen::SiteKind;
use stemgen::world::BuildOptions;

const RATE: f64 = 0.02;
const SHARE: f64 = 0.8;
const SIGMA_NM: f64 = 2.5;

/// A thin specimen of a material with so many clusters.
fn recipe(material: &str, clusters: usize, seed: u64) -> Recipe {
    let mut recipe = Recipe::load(material, Difficulty::Medium).unwrap();
    recipe.seed = seed;
    recipe.field.thickness_nm = 0.8;
    let vacancies = recipe.vacancies.as_mut().unwrap();
    vacancies.rate = RATE;
    vacancies.cluster_fraction = SHARE;
    vacancies.cluster_sigma_nm = SIGMA_NM;
    vacancies.max_probability = 0.5;
    vacancies.clusters = clusters;
    recipe
}

/// Distance of a point from the nearest of several.
fn nearest([x, y]: [f64; 2], centres: &[[f64; 2]]) -> f64 {
    centres.iter().map(|[a, b]| (x - a).hypot(y - b)).fold(f64::INFINITY, f64::min)
}

/// Grains with columns of a library, and domains: the rate is kept, and the density about the centres is the profile's.
#[test]
fn vacancies_lie_about_the_centres() {
    for material in ["srtio3", "batio3"] {
        let recipe = recipe(material, 20, 3);
        let specimen = specimen(&recipe).unwrap();
        let centres = specimen.facts().clusters_nm.clone();
        let field = recipe.field.full_region();
        assert_eq!(centres.len(), 20);
        assert!(centres.iter().all(|centre| field.contains(*centre)), "{centres:?}");
        // Rings about the centres, and all that is further away: sites of O, and vacancies.
        let edges = [0.5, 1.0, 1.5, 2.0, 2.5, f64::INFINITY].map(|edge| edge * SIGMA_NM);
        let mut counts = [[0_u64; 2]; 6];
        for site in specimen.sites(&field).iter().filter(|site| site.number == 8) {
            let [x, y, _] = site.position_nm;
            let ring = edges.iter().position(|edge| nearest([x, y], &centres) < *edge).unwrap();
            counts[ring][0] += 1;
            counts[ring][1] += u64::from(site.kind == SiteKind::Vacancy);
        }
        let total = counts.iter().fold([0; 2], |sum, ring| [sum[0] + ring[0], sum[1] + ring[1]]);
        let rate = |[sites, vacant]: [u64; 2]| vacant as f64 / sites as f64;
        // Columns draw their contents as wholes, so that the error is a little larger than of independent sites.
        let error = (RATE / total[0] as f64).sqrt();
        assert!((rate(total) - RATE).abs() < 6.0 * error, "{material}: {}", rate(total));
        let uniform = (1.0 - SHARE) * RATE;
        let background = rate(counts[5]);
        assert!(background < 1.5 * uniform, "{material}: {background} far from clusters");
        // The excess of a ring follows the Gaussian; its middle stands for the ring.
        let excess: Vec<f64> = counts[..5].iter().map(|ring| rate(*ring) - uniform).collect();
        for (n, found) in excess.iter().enumerate() {
            let t = [0.35, 0.78, 1.27, 1.76, 2.26][n];
            let expected = excess[0] * f64::exp(-0.5 * (t * t - 0.35 * 0.35));
            assert!(
                (found - expected).abs() < 0.12 * excess[0],
                "{material}, ring {n}: {excess:?}"
            );
        }
        assert!(excess[0] > 20.0 * uniform, "{material}: {excess:?}");
    }
}

#[test]
fn centres_depend_on_the_seed_and_stand_in_the_truth() {
    let centres = |seed| specimen(&recipe("batio3", 4, seed)).unwrap().facts().clusters_nm.clone();
    assert_eq!(centres(1), centres(1));
    assert!(centres(1).iter().all(|centre| nearest(*centre, &centres(2)) > 1e-3));
    // More clusters leave the first where they are.
    let more = specimen(&recipe("batio3", 9, 1)).unwrap().facts().clusters_nm.clone();
    assert_eq!(more[..4], centres(1));
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("w.h5");
    let mut recipe = recipe("srtio3", 300, 5).with_grid(4, 4).unwrap();
    build(&recipe, &Spots::new(), &path, &BuildOptions::default(), &Silent).unwrap();
    let file = hdf5::File::open(&path).unwrap();
    let listed = file.dataset("ground_truth/cluster_positions").unwrap();
    let listed = listed.read_2d::<f32>().unwrap();
    let (built, origin) = (recipe.field.built_region(), recipe.field.origin_nm());
    let all = specimen(&recipe).unwrap().facts().clusters_nm.clone();
    let inside: Vec<[f32; 2]> = all
        .iter()
        .filter(|centre| built.contains(**centre))
        .map(|centre| [0, 1].map(|k| (centre[k] - origin[k]) as f32))
        .collect();
    assert!(!inside.is_empty() && inside.len() < 300);
    assert_eq!(listed.outer_iter().map(|row| [row[0], row[1]]).collect::<Vec<_>>(), inside);
    // Without clusters a recipe is written as before, and a world lists none.
    recipe.vacancies.as_mut().unwrap().clusters = 0;
    assert!(!recipe.to_toml().contains("clusters ="));
    let path = folder.path().join("v.h5");
    build(&recipe, &Spots::new(), &path, &BuildOptions::default(), &Silent).unwrap();
    assert!(hdf5::File::open(&path).unwrap().dataset("ground_truth/cluster_positions").is_err());
}

#[test]
fn clusters_that_gather_nothing_are_refused() {
    let mut recipe = recipe("srtio3", 5, 1);
    recipe.vacancies.as_mut().unwrap().cluster_fraction = 0.0;
    let fault = specimen(&recipe).err().unwrap().to_string();
    assert!(
        fault.contains("vacancies.clusters = 5") && fault.contains("cluster_fraction"),
        "{fault}"
    );
}
