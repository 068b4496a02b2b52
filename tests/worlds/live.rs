//! Live worlds: what electrons take away, that it stays away, and that images show what is left.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, OnceLock};

use stemgen::acquisition::Profile;
use stemgen::imaging::{AuditOptions, Cache, PixelRect, RegionImager, audit};
use stemgen::live::{LiveOptions, LiveRequest, LiveSnapshot, LiveWorld};
use stemgen::progress::Silent;
use stemgen::recipe::{CheckedRecipe, Recipe, Region};
use stemgen::simulation::PatternsRequest;
use stemgen::specimen::{DamagedSpecimen, SiteKind, Specimen, specimen};
use stemgen::world::{BuildMethod, BuildOptions, Electrons, RecordedPart};

/// Oxygen goes with a cross-section of 20 barn: a fifth of it after 1e6 electrons per square Angstrom. One grain, whose library has
/// a fifth of the images that a boundary needs.
fn recipe(changes: &[&str]) -> CheckedRecipe {
    let recipe = Recipe::load("test", None).unwrap();
    let own = ["damage.radiolysis_barn.O=20", "field.thickness_nm=0.4", "boundaries.count=0"];
    let changes: Vec<_> = own.iter().chain(changes).map(|c| c.parse().unwrap()).collect();
    recipe.with_overrides(&changes).unwrap().checked().unwrap()
}

/// Simulations that all tests of this file share.
fn cache() -> Cache {
    static FOLDER: OnceLock<tempfile::TempDir> = OnceLock::new();
    Cache::at(FOLDER.get_or_init(|| tempfile::tempdir().unwrap()).path().to_owned())
}

fn options(method: BuildMethod) -> LiveOptions {
    let imaging = BuildOptions { method, cache: cache(), ..BuildOptions::default() };
    LiveOptions { imaging, ..LiveOptions::default() }
}

fn world(changes: &[&str]) -> LiveWorld {
    LiveWorld::new(&recipe(changes), 7, &options(BuildMethod::Mosaic), &Silent).unwrap()
}

fn request(centre_nm: [f64; 2], zoom: f64, dose: f64) -> LiveRequest {
    let pixel_nm = recipe(&[]).field.pixel_nm() / zoom;
    LiveRequest {
        part: RecordedPart { centre_nm, size_nm: [64.0 * pixel_nm; 2], pixel_nm },
        electrons: Electrons::Dose(dose),
        acquisition: Profile::Ideal.acquisition(),
        keep_frames: false,
    }
}

/// Vacant and present sites of oxygen.
fn oxygen(specimen: &dyn Specimen, region: &Region) -> [usize; 2] {
    let sites = specimen.sites(region);
    let count = |vacant: bool| {
        let own = |s: &&stemgen::specimen::SpecimenSite| {
            s.number == 8 && (s.kind == SiteKind::Vacancy) == vacant
        };
        sites.iter().filter(own).count()
    };
    [count(true), count(false)]
}

/// After a dose D a share 1 - exp(-sigma D) is gone, and no other element.
#[test]
fn a_dose_takes_the_share_that_its_cross_section_says() {
    let recipe = recipe(&["field.thickness_nm=4.0"]);
    let inner = specimen(&recipe).unwrap();
    let damaged = DamagedSpecimen::new(Arc::clone(&inner), &recipe, 1e8);
    let field = recipe.field.full_region();
    let [vacant, present] = oxygen(&*inner, &field);
    let all = inner.sites(&field);
    let mut last = vacant;
    for dose in [1e6, 3e6, 1e7] {
        damaged.expose(|map| {
            let now = map.at([3.0, 3.0]);
            let area = field.grown(1.0);
            let angstrom2 = 100.0 * (area.x[1] - area.x[0]) * (area.y[1] - area.y[0]);
            map.add(&area, (dose - now) * angstrom2);
        });
        let share = 1.0 - (-20e-8f64 * dose).exp();
        let [now, _] = oxygen(&damaged, &field);
        let (lost, expected) = ((now - vacant) as f64, share * present as f64);
        let error = (present as f64 * share * (1.0 - share)).sqrt();
        assert!((lost - expected).abs() < 4.0 * error, "{dose}: {lost} of {expected} +- {error}");
        assert!(now >= last);
        last = now;
        let sites = damaged.query(&field).sites;
        assert_eq!(sites.len(), all.len());
        let moved =
            |(a, b): (&stemgen::specimen::SpecimenSite, &stemgen::specimen::SpecimenSite)| {
                a.position_nm != b.position_nm
                    || a.key != b.key
                    || (a.number != 8 && a.kind != b.kind)
            };
        assert!(!sites.iter().zip(&all).any(moved));
        // Every unit that is in the library holds what the library shows.
        let found = damaged.query(&field);
        let tagged = found.columns.iter().filter(|c| c.unit.is_some()).count();
        assert!(tagged > 0 && tagged >= inner.query(&field).columns.len() * 8 / 10, "{tagged}");
    }
}

/// The order and the size of the steps in which a dose comes make no difference.
#[test]
fn what_is_left_depends_on_the_dose_alone() {
    let recipe = recipe(&[]);
    let field = recipe.field.full_region();
    let angstrom2 = 100.0 * (field.x[1] - field.x[0]) * (field.y[1] - field.y[0]);
    let after = |doses: &[f64]| {
        let damaged = DamagedSpecimen::new(specimen(&recipe).unwrap(), &recipe, 1e6);
        for dose in doses {
            damaged.expose(|map| map.add(&field, dose * angstrom2));
            damaged.query(&field);
        }
        damaged.query(&field)
    };
    let once = after(&[524_288.0]);
    assert_eq!(once, after(&[262_144.0, 131_072.0, 131_072.0]));
    assert_ne!(once, after(&[131_072.0]));
}

#[test]
#[ignore = "long"]
fn recordings_change_the_specimen_where_they_are_made() {
    let mut live = world(&["boundaries.count=1"]);
    let [h, w] = live.recipe().field.pixels(live.recipe().field.built_grid());
    let pixel = live.recipe().field.pixel_nm();
    let tile = PixelRect::new([h / 2 - 32, w / 2 - 32], [64, 64]);
    // the same pixels
    let centre = [1, 0].map(|k| (tile.first[k] as f64 + 31.5) * pixel);
    let far = PixelRect::new([4, 4], [64, 64]);
    let (before, there) = (live.look(&tile).unwrap(), live.look(&far).unwrap());
    let first = live.acquire(&request(centre, 1.0, 8e5), &Silent).unwrap();
    assert_eq!(first.ideal.dim(), (64, 64));
    // The recording shows the specimen as it was.
    let worst =
        first.ideal.iter().zip(&before.clean).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    let most = before.clean.iter().copied().fold(0.0, f32::max);
    assert!(worst < 2e-3 * most, "{worst} of {most}");
    let record = &live.history()[0];
    let lost = record.lost["O"];
    assert_eq!(record.lost.len(), 1);
    assert!((record.electrons / (8e5 * 100.0 * (64.0 * pixel).powi(2)) - 1.0).abs() < 1e-9);
    let after = live.look(&tile).unwrap();
    let gone = |tile: &stemgen::world::FieldTile| -> u32 {
        tile.columns.iter().map(|c| c.vacancies).sum()
    };
    assert!(gone(&after) > gone(&before) && u64::from(gone(&after) - gone(&before)) <= lost);
    assert_ne!(after.clean, before.clean);
    assert_eq!(live.look(&far).unwrap().clean, there.clean);
    let error = live.acquire(&request(centre, 1.0, 8e5), &Silent).unwrap_err().to_string();
    assert!(error.contains("made for up to 1000000"), "{error}");
    assert_eq!((live.history().len(), live.look(&tile).unwrap().clean), (1, after.clean));
}

/// Blocks that are kept are those that would be made anew.
#[test]
fn kept_images_are_those_of_the_specimen_as_it_is() {
    let mut live = world(&[]);
    let recipe = live.imaged_recipe().clone();
    let pixel = recipe.field.pixel_nm();
    let policy = options(BuildMethod::Mosaic).imaging.policy(&recipe).unwrap();
    for (x, y, dose) in [(2.0, 2.0, 2e5), (3.1, 2.2, 3e5), (2.4, 3.9, 4e5), (9.0, 5.5, 1e5)] {
        let first = [y, x].map(|nm| (nm / pixel) as usize - 50);
        let rect = PixelRect::new(first, [150, 120]);
        let kept = live.imager().mean_of(&rect, 1, &Silent).unwrap();
        let again = damaged_again(&live);
        let mut anew = policy.imaging.imager(&recipe, &again).unwrap();
        anew.prepare(&Silent).unwrap();
        let made = anew.mean_of(&rect, 1, &Silent).unwrap();
        let off = kept.iter().zip(&made).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        let most = made.iter().copied().fold(0.0, f64::max);
        assert!(off < 1e-6 * most, "{off} of {most}");
        let region = rect.region(pixel);
        assert_eq!(live.specimen().query(&region), again.query(&region));
        live.acquire(&request([x, y], 1.0, dose), &Silent).unwrap();
    }
}

/// A specimen of its own that has had the same doses.
fn damaged_again(live: &LiveWorld) -> Arc<dyn Specimen> {
    let recipe = live.recipe();
    let again = DamagedSpecimen::new(specimen(recipe).unwrap(), recipe, 1e6);
    again.expose(|map| map.clone_from(&live.specimen().dose()));
    Arc::new(again)
}

#[test]
fn the_same_recordings_give_the_same_bytes_on_any_number_of_threads() {
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut live = world(&[]);
            let mut out = Vec::new();
            for n in 0..6 {
                let place = [2.0 + 0.7 * f64::from(n), 2.2 + 0.4 * f64::from(n % 3)];
                let mut request = request(place, 1.0 + f64::from(n % 2), 5e4);
                request.acquisition = Profile::Routine.acquisition();
                out.push(live.acquire(&request, &Silent).unwrap());
            }
            (out, live.snapshot())
        })
    };
    let (one, three) = (run(1), run(3));
    assert_eq!(one.0, three.0);
    assert_eq!(one.1, three.1);
}

#[test]
fn a_world_goes_on_from_a_snapshot() {
    let mut live = world(&[]);
    live.acquire(&request([3.0, 3.0], 1.0, 3e5), &Silent).unwrap();
    let snapshot = live.snapshot();
    let text = serde_json::to_string(&snapshot).unwrap();
    let second = live.acquire(&request([3.2, 3.0], 2.0, 3e5), &Silent).unwrap();
    let third = live.acquire(&request([3.2, 3.0], 2.0, 1e5), &Silent).unwrap();
    // in the same world, and in a new one
    let stored: LiveSnapshot = serde_json::from_str(&text).unwrap();
    let other =
        LiveSnapshot { recipe: stored.recipe.replace("seed = 7", "seed = 8"), ..stored.clone() };
    assert_ne!(other.recipe, stored.recipe);
    for mut again in [world(&[]), live] {
        let error = again.restore(&other).unwrap_err().to_string();
        assert!(error.contains("another recipe or seed"), "{error}");
        again.restore(&stored).unwrap();
        assert_eq!(again.snapshot(), snapshot);
        assert_eq!(again.acquire(&request([3.2, 3.0], 2.0, 3e5), &Silent).unwrap(), second);
        assert_eq!(again.acquire(&request([3.2, 3.0], 2.0, 1e5), &Silent).unwrap(), third);
    }
}

/// What was damaged on its way is refused, and so is what no world can have done; the world stays as it was.
#[test]
fn damaged_snapshots_are_refused() {
    let mut live = world(&[]);
    live.acquire(&request([3.0, 3.0], 1.0, 3e5), &Silent).unwrap();
    let before = live.snapshot();
    assert_eq!((before.version, before.digest.len()), (2, 64));
    let value = serde_json::to_value(&before).unwrap();
    let printed = |value: serde_json::Value| {
        let snapshot: LiveSnapshot = serde_json::from_value(value).unwrap();
        world(&[]).restore(&snapshot).unwrap_err().to_string()
    };
    type Change = fn(&mut serde_json::Value);
    let changes: [(Change, &str); 7] = [
        (|v| v["history"][0]["duration_s"] = (-1.0).into(), "lasted -1 s"),
        (|v| v["history"][0]["number"] = 4.into(), "the number 4"),
        (|v| v["history"][0]["begun_s"] = (-5.0).into(), "begun at -5 s"),
        (|v| v["history"][0]["shape"] = serde_json::json!([0, 5]), "[0, 5] pixels"),
        (|v| v["history"][0]["lost"] = serde_json::json!({ "Qq": 3 }), "`Qq`, which is no element"),
        (|v| v["history"][0]["dose"] = 0.0.into(), "a dose of 0"),
        (|v| v["most_dose"] = 0.0.into(), "`most_dose` is 0"),
    ];
    for (change, part) in changes {
        let mut changed = value.clone();
        change(&mut changed);
        let found = printed(changed.clone());
        assert!(found.contains("its digest does not match"), "{found}");
        // Snapshots of version 1 have none.
        changed["version"] = 1.into();
        changed["digest"] = "".into();
        let found = printed(changed);
        assert!(found.contains(part), "no `{part}` in {found}");
    }
    let mut old = value.clone();
    old["version"] = 1.into();
    old.as_object_mut().unwrap().remove("digest");
    live.restore(&serde_json::from_value(old).unwrap()).unwrap();
    assert_eq!(live.snapshot(), before);
    let mut later = value;
    later["version"] = 3.into();
    assert!(printed(later).contains("version 3"));
}

/// Places that overlap add up to more than the mean of any recording: such a moment can be gone back to as well. And what is told of
/// a place is what it was given.
#[test]
#[ignore = "long"]
fn a_moment_of_uneven_doses_can_be_gone_back_to() {
    let few = LiveOptions { most_dose: 5e5, ..options(BuildMethod::Mosaic) };
    let mut live = LiveWorld::new(&recipe(&[]), 7, &few, &Silent).unwrap();
    let first = request([2.3, 2.5], 1.0, 4.4e5);
    live.acquire(&first, &Silent).unwrap();
    let half = 0.5 * first.part.size_nm[0] - 0.05;
    let place = Region { x: [2.3 - half, 2.3 + half], y: [2.5 - half, 2.5 + half] };
    assert!((live.mean_dose(&place) / 4.4e5 - 1.0).abs() < 1e-9, "{}", live.mean_dose(&place));
    live.acquire(&request([3.1, 2.5], 1.0, 2.2e5), &Silent).unwrap();
    let moment = live.snapshot();
    assert!(live.specimen().dose().greatest() > 5e5);
    live.restore(&moment).unwrap();
    assert_eq!(live.snapshot(), moment);
}

/// Many recordings in little memory: blocks are dropped, and come back the same.
#[test]
#[ignore = "long"]
fn memory_is_bounded_and_images_do_not_depend_on_it() {
    let small = LiveOptions { image_bytes: 0, ..options(BuildMethod::Mosaic) };
    let mut tight = LiveWorld::new(&recipe(&[]), 7, &small, &Silent).unwrap();
    let mut roomy = world(&[]);
    for n in 0..60 {
        let place = [1.2 + 0.15 * f64::from(n), 1.5 + 0.07 * f64::from(n)];
        let request = request(place, 1.0, 1e4);
        let [a, b] = [&mut tight, &mut roomy].map(|w| w.acquire(&request, &Silent).unwrap());
        assert_eq!(a, b);
        assert!(tight.kept_blocks() <= 16);
    }
    assert!(roomy.kept_blocks() > 16);
    assert_eq!(tight.snapshot(), roomy.snapshot());
}

/// A column that has lost atoms shows the image of the atoms that are left, as the exact engine finds it.
#[test]
#[ignore = "long"]
fn damaged_places_pass_an_audit() {
    let mut live = world(&["phonons.configurations=2"]);
    let centre = [5.0, 3.5];
    live.acquire(&request(centre, 1.0, 1e6), &Silent).unwrap();
    assert!(live.history()[0].lost["O"] > 10);
    let options =
        AuditOptions { regions: 1, size_nm: 0.8, at_nm: vec![centre], ..AuditOptions::default() };
    let found =
        audit(live.imaged_recipe(), live.specimen(), live.imager(), &options, &Silent).unwrap();
    assert!(found.bright_rms_percent < 0.5 && found.all_rms_percent < 0.5, "{found:?}");
}

/// A particle of about 1.4 nm on 1 nm of carbon, 8 x 8 nm, of which the beam takes atoms of both elements.
fn film() -> CheckedRecipe {
    let changes = [
        "field.fov_nm=[8.0, 8.0]",
        "field.grid=[5, 5]",
        "field.thickness_nm=1.0",
        "particles.count=1",
        "particles.diameter_nm=[1.2, 1.6]",
        "particles.max_tilt_deg=180.0",
        "damage.radiolysis_barn.C=20",
        "damage.radiolysis_barn.Pt=10",
        "phonons.configurations=1",
        "detector={inner_mrad=50, outer_mrad=90}",
    ];
    let changes: Vec<_> = changes.iter().map(|c| c.parse().unwrap()).collect();
    let recipe = Recipe::load("pt", stemgen::recipe::Difficulty::Easy).unwrap();
    recipe.with_overrides(&changes).unwrap().checked().unwrap()
}

/// Present atoms by element, and the keys of those that are gone.
fn left(specimen: &dyn Specimen, region: &Region) -> (BTreeMap<u8, usize>, BTreeSet<u64>) {
    let (mut atoms, mut gone) = (BTreeMap::new(), BTreeSet::new());
    for site in specimen.sites(region) {
        match site.kind {
            SiteKind::Vacancy => drop(gone.insert(site.key)),
            _ => *atoms.entry(site.number).or_default() += 1,
        }
    }
    (atoms, gone)
}

/// Atoms of particles and of the film under them are lost one by one, each element with its own probability.
#[test]
fn films_and_particles_lose_the_share_that_their_cross_sections_say() {
    let recipe = film();
    let damaged = DamagedSpecimen::new(specimen(&recipe).unwrap(), &recipe, 1e8);
    let field = recipe.field.full_region();
    let (all, vacant) = left(&damaged, &field);
    let mut last = vacant.clone();
    for dose in [1e6, 4e6] {
        let area = field.grown(1.0);
        let angstrom2 = 100.0 * (area.x[1] - area.x[0]) * (area.y[1] - area.y[0]);
        let now = damaged.dose().at([3.0, 3.0]);
        damaged.expose(|map| map.add(&area, (dose - now) * angstrom2));
        let (atoms, gone) = left(&damaged, &field);
        for (number, barn) in [(6, 20.0f64), (78, 10.0)] {
            let (whole, share) = (all[&number] as f64, 1.0 - (-barn * 1e-8 * dose).exp());
            let lost = whole - atoms[&number] as f64;
            let error = (whole * share * (1.0 - share)).sqrt();
            let off = (lost - whole * share).abs();
            assert!(off < 4.0 * error, "{number} after {dose}: {lost} of {whole}, {share}");
        }
        // what is gone stays away
        assert!(gone.is_superset(&last) && gone.len() > last.len());
        last = gone;
    }
}

/// Images of a film, kept or not, are those of a new world that has had the same doses: near the place and away from it, bit by bit, and
/// with any number of threads. The exact engine finds the same for the atoms that are left.
#[test]
#[ignore = "long"]
fn films_show_the_atoms_that_are_left() {
    let recipe = film();
    let mut live = LiveWorld::new(&recipe, 7, &options(BuildMethod::Auto), &Silent).unwrap();
    let pixel = live.imaged_recipe().field.pixel_nm();
    let specimen: &dyn Specimen = live.specimen();
    let at = specimen.particles()[0].centre_nm;
    let around = |x: f64, y: f64| {
        let first = [y, x].map(|nm| ((nm / pixel) as usize).saturating_sub(40));
        PixelRect::new(first, [80, 80])
    };
    let places = [around(at[0], at[1]), around(at[0] + 0.9, at[1] - 0.6), around(0.7, 0.7)];
    let images =
        |imager: &dyn RegionImager| places.map(|place| imager.mean_of(&place, 1, &Silent).unwrap());
    let before = images(live.imager());
    for (away, dose) in [(0.0, 4e5), (0.3, 3e5)] {
        live.acquire(&request([at[0] + away, at[1]], 1.0, dose), &Silent).unwrap();
    }
    let lost = |element: &str| live.history().iter().map(|h| h.lost[element]).sum::<u64>();
    assert!(lost("C") > 20 && lost("Pt") > 1, "{:?}", live.history());
    let after = images(live.imager());
    assert_ne!(after[0], before[0]);
    let fresh = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut again =
                LiveWorld::new(&recipe, 7, &options(BuildMethod::Auto), &Silent).unwrap();
            again.restore(&live.snapshot()).unwrap();
            images(again.imager())
        })
    };
    assert_eq!(after, fresh(1));
    assert_eq!(after, fresh(3));
    let options = AuditOptions {
        regions: 1,
        size_nm: 0.6,
        at_nm: vec![[at[0], at[1]]],
        ..AuditOptions::default()
    };
    let found =
        audit(live.imaged_recipe(), live.specimen(), live.imager(), &options, &Silent).unwrap();
    println!("bright {:.3} %, all {:.3} %", found.bright_rms_percent, found.all_rms_percent);
    assert!(found.bright_rms_percent < 0.8 && found.all_rms_percent < 0.5, "{found:?}");
}

#[test]
fn a_world_without_damage_stays_as_it_is() {
    let thin = ["field.thickness_nm=0.4", "boundaries.count=0"].map(|c| c.parse().unwrap());
    let recipe = Recipe::load("test", None).unwrap().with_overrides(&thin).unwrap();
    let recipe = recipe.checked().unwrap();
    let mut live = LiveWorld::new(&recipe, 1, &options(BuildMethod::Mosaic), &Silent).unwrap();
    let tile = PixelRect::new([60, 60], [64, 64]);
    let before = live.look(&tile).unwrap();
    live.acquire(&request([3.0, 3.0], 1.0, 1e11), &Silent).unwrap();
    assert!(live.history()[0].lost.is_empty());
    assert_eq!(live.look(&tile).unwrap().clean, before.clean);
}

#[test]
fn what_makes_no_sense_is_refused_with_what_is_allowed() {
    let mut live = world(&[]);
    for (request, part) in [
        (request([3.0, 3.0], 1.0, -1.0), "0.001 to 1e12"),
        (request([300.0, 3.0], 1.0, 10.0), "would leave the field"),
        (request([f64::NAN, 3.0], 1.0, 10.0), "finite place"),
        (request([3.0, 3.0], 1e9, 10.0), "0.0001 to 10 nm"),
    ] {
        let error = live.acquire(&request, &Silent).unwrap_err().to_string();
        assert!(error.contains(part), "{error}");
    }
    assert!(live.history().is_empty());
    let error = live.look(&PixelRect::new([0, 0], [9999, 3])).unwrap_err().to_string();
    assert!(error.contains("rectangle in the full field"), "{error}");
    let most = LiveOptions { most_dose: -5.0, ..options(BuildMethod::Mosaic) };
    let Err(error) = LiveWorld::new(&recipe(&[]), 1, &most, &Silent) else { panic!("accepted") };
    assert!(error.to_string().contains("0.001 to 1e12"), "{error}");
}

#[test]
fn damage_of_elements_that_are_not_there_is_refused() {
    for (change, part) in [
        ("damage.threshold_ev.Fe=20", "expected an element of the crystal"),
        ("damage.threshold_ev.O=-3", "1 to 1000"),
        ("damage.radiolysis_barn.O=1e12", "0 to 1000000000"),
        ("damage.threshold=3", "threshold_ev"),
    ] {
        let recipe = Recipe::load("test", None).unwrap();
        let error = recipe.with_overrides(&[change.parse().unwrap()]).and_then(|r| r.checked());
        let error = error.unwrap_err().to_string();
        assert!(error.contains(part), "{change}: {error}");
    }
}

/// `cargo test --release --test worlds -- --ignored --nocapture measured`, with the library of SrTiO3 easy in the cache: times of
/// looks, 10 000 recordings, and audits after nearly 1e6 electrons per square Angstrom.
#[test]
#[ignore = "takes minutes, and half an hour with an empty cache"]
fn measured_latency_memory_and_audits() {
    let recipe = CheckedRecipe::load("srtio3", stemgen::recipe::Difficulty::Easy).unwrap();
    let begun = std::time::Instant::now();
    let mut live = LiveWorld::new(&recipe, 11, &LiveOptions::default(), &Silent).unwrap();
    println!("a new world, library cached: {:?}", begun.elapsed());
    let times = |live: &LiveWorld, n: usize| {
        let mut ms: Vec<f64> = (0..n)
            .map(|k| {
                let at = std::time::Instant::now();
                let first = [130 + 150 * (k % 25), 140 + 170 * (k / 25)];
                live.look(&PixelRect::new(first, [128, 128])).unwrap();
                1e3 * at.elapsed().as_secs_f64()
            })
            .collect();
        ms.sort_by(f64::total_cmp);
        [ms[0], ms[n / 2], ms[n * 99 / 100]]
    };
    println!("first looks (least, median, 99 %) in ms: {:.2?}", times(&live, 300));
    println!("later looks: {:.2?}", times(&live, 300));
    let pixel_nm = recipe.field.pixel_nm();
    let request = |n: usize, dose: f64| LiveRequest {
        part: RecordedPart {
            centre_nm: [5.0 + 0.37 * (n % 200) as f64, 5.0 + 0.81 * (n / 200 % 90) as f64],
            size_nm: [128.0 * pixel_nm; 2],
            pixel_nm,
        },
        electrons: Electrons::Dose(dose),
        acquisition: Profile::Ideal.acquisition(),
        keep_frames: false,
    };
    let place = request(6060, 0.0);
    for n in 0..4 {
        let begun = std::time::Instant::now();
        live.acquire(&LiveRequest { electrons: Electrons::Dose(2.4e5), ..place }, &Silent).unwrap();
        println!("recording {n} of a place that dies: {:?}", begun.elapsed());
    }
    println!("lost: {:?}", live.history().iter().map(|h| h.lost["O"]).collect::<Vec<_>>());
    let options =
        AuditOptions { regions: 1, at_nm: vec![place.part.centre_nm], ..AuditOptions::default() };
    let found = audit(live.imaged_recipe(), live.specimen(), live.imager(), &options, &Silent);
    let found = found.unwrap();
    println!("audit: bright {:.3} %, all {:.3} %", found.bright_rms_percent, found.all_rms_percent);
    assert!(found.bright_rms_percent < 0.5 && found.all_rms_percent < 0.5);
    let memory = || {
        let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
        status.lines().find(|l| l.starts_with("VmRSS")).unwrap_or_default().to_owned()
    };
    let begun = std::time::Instant::now();
    for n in 0..10_000 {
        live.acquire(&request(n, 1e2), &Silent).unwrap();
        if n % 2500 == 0 {
            println!(
                "{n} recordings: {:?}, {}, {} blocks",
                begun.elapsed(),
                memory(),
                live.kept_blocks()
            );
        }
    }
    println!("10 000 recordings: {:?}, {}", begun.elapsed(), memory());
}

/// Patterns are of the atoms that are left, and the place of a probe is that of an image's pixel.
#[test]
fn patterns_are_of_the_atoms_that_are_left() {
    let mut world = world(&[]);
    let asked = request([1.9, 1.9], 1.0, 1.0);
    let oxygen = |world: &LiveWorld| {
        let place = world.patterns_at(&asked, &PatternsRequest::default()).unwrap();
        let job = place.job();
        let middle = [0, 1].map(|k| {
            let n = job.scan().shape[1 - k] as f64;
            place.origin_nm()[k] + 0.05 * (n - 1.0) * job.scan().step_angstrom[k]
        });
        assert!((0..2).all(|k| (middle[k] - 1.9).abs() < 1e-9), "{middle:?}");
        job.specimen().composition()["O"]
    };
    let before = oxygen(&world);
    world.acquire(&request([1.9, 1.9], 1.0, 9e5), &Silent).unwrap();
    assert!(oxygen(&world) < before, "{} of {before}", oxygen(&world));
    let outside = request([0.1, 1.6], 1.0, 1.0);
    let fault = world.patterns_at(&outside, &PatternsRequest::default()).err().unwrap();
    assert!(fault.to_string().contains("probes inside the field"), "{fault}");
}
