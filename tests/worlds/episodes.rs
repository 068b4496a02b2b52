//! Episodes of the benchmark: what an agent sees, what it pays, and how it is scored.

use std::ops::Range;
use std::path::PathBuf;
use std::sync::{Arc, OnceLock};

use ndarray::Array2;
use stemgen::benchmark::{
    AgentAction, AgentFindings, BenchmarkWorld, ChangingWorld, Ending, Episode, EpisodeSettings,
    FileWorld, RecipeSource, Reward, Split, Task, TaskKind, TileDose, TileNoise, TileView,
};
use stemgen::imaging::{Cache, MethodChoice, PixelRect};
use stemgen::progress::Silent;
use stemgen::recipe::{CheckedRecipe, Difficulty, Recipe, Region};
use stemgen::specimen::specimen;
use stemgen::world::{BuildMethod, BuildOptions, build, field_tile};

fn folder() -> PathBuf {
    static FOLDER: OnceLock<tempfile::TempDir> = OnceLock::new();
    FOLDER.get_or_init(|| tempfile::tempdir().unwrap()).path().to_owned()
}

fn options() -> BuildOptions {
    let cache = Cache::at(folder().join("cache"));
    BuildOptions { method: BuildMethod::Mosaic, cache, audit_regions: 0, ..BuildOptions::default() }
}

fn changed(name: &str, tier: Option<Difficulty>, changes: &[&str]) -> CheckedRecipe {
    let changes: Vec<_> = changes.iter().map(|c| c.parse().unwrap()).collect();
    Recipe::load(name, tier).unwrap().with_overrides(&changes).unwrap().checked().unwrap()
}

/// The recipe for tests, thin: 2 x 2 tiles of one grain, whose library has a fifth of the images that a boundary needs.
fn recipe() -> CheckedRecipe {
    changed("test", None, &["field.thickness_nm=0.4", "boundaries.count=0"])
}

fn source() -> &'static RecipeSource {
    static SOURCE: OnceLock<RecipeSource> = OnceLock::new();
    SOURCE.get_or_init(|| RecipeSource::new(&recipe(), &options(), &Silent).unwrap())
}

fn file() -> Arc<dyn BenchmarkWorld> {
    static FILE: OnceLock<Arc<FileWorld>> = OnceLock::new();
    let open = || {
        let path = folder().join("world.h5");
        let options = BuildOptions { keep_clean: true, ..options() };
        build(&recipe(), &path, &options, &Silent).unwrap();
        Arc::new(FileWorld::open(&path, &options).unwrap())
    };
    Arc::clone(FILE.get_or_init(open)) as Arc<dyn BenchmarkWorld>
}

fn task(kind: TaskKind) -> Task {
    Task { kind, strict: false, target: None }
}

fn episode(world: Arc<dyn BenchmarkWorld>, kind: TaskKind, settings: EpisodeSettings) -> Episode {
    Episode::new(world, task(kind), settings, (5, 0)).unwrap()
}

const ACQUIRE: AgentAction = AgentAction::Acquire { zoom: 1.0, multiplier: 1.0 };

fn tile(world: &dyn BenchmarkWorld, n: usize) -> AgentAction {
    let grid = world.facts().grid;
    AgentAction::Navigate(world.facts().centre_of([n / grid[1] % grid[0], n % grid[1]]))
}

fn rms(a: &Array2<f32>, b: &Array2<f32>) -> f64 {
    let square = a.iter().zip(b).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>();
    (square / a.len() as f64).sqrt() / f64::from(b.mean().unwrap())
}

/// A specimen of the benchmark has the image that a world of its recipe and seed has, whatever was looked at before.
#[test]
fn images_of_seeds_are_those_of_worlds() {
    for seed in [3, 4] {
        let world = source().world(seed).unwrap();
        let recipe = source().recipe_of(seed).unwrap();
        let specimen = specimen(&recipe).unwrap();
        let mut imaging = options().policy(&recipe).unwrap().imaging;
        imaging.method = MethodChoice::Mosaic;
        let mut imager = imaging.imager(&recipe, &specimen).unwrap();
        imager.prepare(&Silent).unwrap();
        for first_px in [[124, 0], [17, 93]] {
            let view = TileView { first_px, tile_px: 128, zoom: 1.0 };
            let pixels = PixelRect::new(first_px, [128; 2]);
            let expected = field_tile(&recipe, &*specimen, &*imager, &pixels, None, &Silent);
            assert_eq!(*world.clean(&view, &Silent).unwrap(), expected.unwrap().clean);
        }
    }
}

#[test]
fn a_file_and_its_recipe_are_the_same_world() {
    let (file, made) = (file(), source().world(recipe().seed).unwrap());
    assert_eq!(file.facts().target, made.facts().target);
    assert_eq!(file.facts().grid, made.facts().grid);
    let view = TileView { first_px: [30, 77], tile_px: 128, zoom: 1.0 };
    let image = |world: &dyn BenchmarkWorld, view: &TileView| world.clean(view, &Silent).unwrap();
    let plain = rms(&image(&*file, &view), &image(&made, &view));
    assert!(plain < 2e-3, "{plain}");
    // Between pixels, and at the very edge of the field.
    for (first_px, zoom) in [([30, 77], 2.0), ([0, 124], 3.3), ([124, 0], 8.0)] {
        let view = TileView { first_px, tile_px: 128, zoom };
        let difference = rms(&image(&*file, &view), &image(&made, &view));
        assert!(difference < 5e-3, "{zoom}: {difference}");
    }
    let region = Region { x: [0.5, 4.6], y: [-0.01, 4.2] };
    let sorted = |world: &dyn BenchmarkWorld| {
        let truth = world.truth(&region, true).unwrap();
        let mut defects: Vec<_> =
            truth.defects.iter().map(|d| (d.kind.clone(), d.position_nm)).collect();
        defects.sort_by(|a, b| a.partial_cmp(b).unwrap());
        let mut columns: Vec<_> =
            truth.columns.iter().map(|c| (c.position_nm, c.defective)).collect();
        columns.sort_by(|a, b| a.partial_cmp(b).unwrap());
        (defects, columns)
    };
    let (defects, columns) = sorted(&*file);
    assert!(defects.len() > 3 && columns.len() > 50, "{} {}", defects.len(), columns.len());
    assert_eq!((defects, columns), sorted(&made));
    let overview = |world: &dyn BenchmarkWorld| world.overview([0.5, 0.5], 64, &Silent).unwrap();
    let mean = |map: &Array2<f32>| f64::from(map.slice(ndarray::s![..31, ..31]).mean().unwrap());
    let [a, b] = [(&*file), (&made as &dyn BenchmarkWorld)].map(|world| {
        let [scale, offset] = world.facts().scaling;
        mean(&overview(world)) * scale + offset
    });
    assert!((a / b - 1.0).abs() < 0.01, "{a} {b}");
}

/// Electrons are counted about the noise-free image, with the dose of the tier or that of the budget.
#[test]
fn tiles_have_the_noise_of_their_dose() {
    let world = file();
    let facts = world.facts().clone();
    let view = facts.view_at(facts.centre_of([0, 1]), 1.0);
    let clean = world.clean(&view, &Silent).unwrap();
    for (exposure, dose) in [(TileDose::Tier, facts.dose), (TileDose::Physical, 100.0)] {
        let settings = EpisodeSettings { exposure, ..EpisodeSettings::default() };
        let mut episode = episode(Arc::clone(&world), TaskKind::DefectCensus, settings);
        episode.act(tile(&*world, 1), &Silent).unwrap();
        let action = AgentAction::Acquire { zoom: 1.0, multiplier: 3.0 };
        let acquired = episode.act(action, &Silent).unwrap().acquired.unwrap();
        assert_eq!((acquired.cost, acquired.tile), (300.0, [0, 1]));
        let electrons = dose * 3.0 * (10.0 * facts.pixel_nm).powi(2);
        assert!((acquired.electrons_per_pixel - electrons).abs() < 1e-9 * electrons);
        if exposure == TileDose::Physical {
            // Few electrons, most of them beyond the scale: pixels without any are as many as Poisson's law says.
            let none = episode.tile().iter().filter(|v| **v == 0.0).count() as f64;
            let expected: f64 = clean.iter().map(|v| (-f64::from(*v) * electrons).exp()).sum();
            assert!((none - expected).abs() < 5.0 * expected.sqrt(), "{none} {expected}");
            continue;
        }
        let [scale, offset] = facts.scaling;
        let (mut chi2, mut count) = (0.0, 0.0);
        for (seen, clean) in episode.tile().iter().zip(&*clean) {
            let expected = f64::from(*clean) * electrons;
            let counted = (f64::from(*seen) * scale + offset) * electrons;
            if expected + 6.0 * expected.sqrt() < (scale + offset) * electrons
                && expected - 6.0 * expected.sqrt() > offset * electrons
            {
                chi2 += (counted - expected).powi(2) / expected;
                count += 1.0;
            }
        }
        let mean = chi2 / count;
        assert!(count > 1000.0 && (0.9..1.1).contains(&mean), "{mean} of {count}");
    }
    let settings = EpisodeSettings { noise: TileNoise::Stored, ..EpisodeSettings::default() };
    let mut stored = episode(Arc::clone(&world), TaskKind::DefectCensus, settings);
    stored.act(tile(&*world, 1), &Silent).unwrap();
    stored.act(ACQUIRE, &Silent).unwrap();
    let path = folder().join("world.h5");
    let expected = stemgen::io::WorldFile::open(&path).unwrap().tile(0, 1).unwrap();
    assert_eq!(**stored.tile(), expected);
}

/// What would score 1: the truth of what was seen.
fn right(episode: &Episode) -> AgentAction {
    let defects = Some(episode.seen().defects().to_vec());
    AgentAction::Declare(AgentFindings { defects, ..AgentFindings::default() })
}

/// An agent that is always right has the paper's ceiling; one that says so only at the end nearly nothing.
#[test]
fn curves_are_those_of_the_paper() {
    let world = file();
    for (early, expected) in [(true, 0.90816), (false, 0.01020)] {
        let settings = EpisodeSettings::default();
        let mut episode = episode(Arc::clone(&world), TaskKind::DefectCensus, settings);
        for n in 0..50 {
            episode.act(tile(&*world, n), &Silent).unwrap();
            episode.act(ACQUIRE, &Silent).unwrap();
            if early || n == 49 {
                let said = right(&episode);
                episode.act(said, &Silent).unwrap();
            }
        }
        assert_eq!(episode.mask(), [true, false, true, true]);
        let outcome = episode.act(AgentAction::Done, &Silent).unwrap();
        assert_eq!(outcome.ended, Some(Ending::Done));
        let record = episode.record().unwrap();
        assert_eq!((record.spent, record.acquisitions.len()), (5000.0, 50));
        assert_eq!(record.curve.len(), if early { 10 } else { 1 });
        assert!((record.metrics.dec_auc - expected).abs() < 5e-6, "{:?}", record.metrics);
        assert!(episode.act(AgentAction::Done, &Silent).is_err());
    }
}

/// An acquisition that does not fit is refused, ends the episode, and costs nothing.
#[test]
fn budgets_are_kept() {
    let world = file();
    let settings = EpisodeSettings { budget: 950.0, ..EpisodeSettings::default() };
    let mut episode = episode(world, TaskKind::DefectCensus, settings);
    let zoomed = AgentAction::Acquire { zoom: 3.0, multiplier: 1.0 };
    assert_eq!(episode.act(zoomed.clone(), &Silent).unwrap().ended, None);
    assert!((episode.dose_left() - 50.0 / 950.0).abs() < 1e-12);
    assert_eq!(episode.mask(), [true, true, true, true]);
    let outcome = episode.act(ACQUIRE, &Silent).unwrap();
    assert_eq!((outcome.ended, outcome.acquired), (Some(Ending::Refused), None));
    assert_eq!(episode.spent(), 900.0);
    assert_eq!(episode.mask(), [false; 4]);
    // Nothing was declared.
    let record = episode.record().unwrap();
    assert_eq!((record.curve.len(), record.metrics.dec_auc), (0, 0.0));
}

#[test]
fn horizons_end_episodes() {
    let settings = EpisodeSettings { horizon: 3, ..EpisodeSettings::default() };
    let mut episode = episode(file(), TaskKind::DefectCensus, settings);
    assert_eq!(episode.act(ACQUIRE, &Silent).unwrap().ended, None);
    assert_eq!(episode.act(AgentAction::Unreadable, &Silent).unwrap().ended, None);
    let said = right(&episode);
    assert_eq!(episode.act(said, &Silent).unwrap().ended, Some(Ending::Horizon));
    let record = episode.record().unwrap();
    assert_eq!((record.unreadable, record.metrics.final_score), (1, 1.0));
}

/// Gains add up to the final score; without one look nothing is worth anything.
#[test]
fn rewards_add_up() {
    let world = file();
    let of = |reward| {
        let settings = EpisodeSettings { reward, ..EpisodeSettings::default() };
        let mut episode = episode(Arc::clone(&world), TaskKind::DefectCensus, settings);
        let mut sum = 0.0;
        let empty = AgentAction::Declare(AgentFindings::default());
        let mut pay = |episode: &mut Episode, action| {
            sum += episode.act(action, &Silent).unwrap().reward;
        };
        pay(&mut episode, empty);
        assert_eq!(episode.score().unwrap(), 0.0);
        for n in 0..4 {
            pay(&mut episode, tile(&*world, n));
            pay(&mut episode, ACQUIRE);
            if n == 2 {
                let said = right(&episode);
                pay(&mut episode, said);
            }
        }
        pay(&mut episode, AgentAction::Done);
        (sum, episode.score().unwrap())
    };
    let (gains, score) = of(Reward::ScoreGain);
    assert!(score > 0.3 && score < 1.0 && (gains - score).abs() < 1e-12, "{gains} {score}");
    assert_eq!(of(Reward::Sparse), (score, score));
    assert_eq!(of(Reward::None), (0.0, score));
}

/// The same seed, number and actions give the same bytes; another number does not.
#[test]
fn episodes_repeat() {
    let world: Arc<dyn BenchmarkWorld> = Arc::new(source().world(9).unwrap());
    let run = |number: u32, threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let settings = EpisodeSettings::default();
        let task = task(TaskKind::DefectCensus);
        let again: Arc<dyn BenchmarkWorld> = Arc::new(source().world(9).unwrap());
        let mut episode = Episode::new(again, task, settings, (5, number)).unwrap();
        pool.install(|| {
            episode.act(tile(&*world, 2), &Silent).unwrap();
            episode.act(AgentAction::Acquire { zoom: 1.7, multiplier: 1.0 }, &Silent).unwrap();
            (episode.tile().clone(), episode.overview(&Silent).unwrap())
        })
    };
    let first = run(0, 1);
    assert_eq!(first, run(0, 3));
    assert_ne!(first.0, run(1, 1).0);
}

/// Episodes in one specimen share a world while it is in use. What one has looked at changes nothing for another.
#[test]
fn worlds_in_use_are_shared() {
    let (source, alone) = (source(), source().world(31).unwrap());
    let (one, other) = (source.shared_world(31).unwrap(), source.shared_world(31).unwrap());
    assert!(Arc::ptr_eq(&one, &other));
    assert!(!Arc::ptr_eq(&one, &source.shared_world(33).unwrap()));
    let view = one.facts().view_at([0.3, 0.6], 1.0);
    let looked = one.clean(&view, &Silent).unwrap();
    assert!(Arc::ptr_eq(&looked, &other.clean(&view, &Silent).unwrap()));
    for at in [[0.3, 0.6], [0.4, 0.5]] {
        let view = one.facts().view_at(at, 1.0);
        let (shared, own) = (other.clean(&view, &Silent), alone.clean(&view, &Silent));
        assert_eq!(shared.unwrap(), own.unwrap());
    }
    let gone = Arc::downgrade(&one);
    drop((one, other));
    assert!(gone.upgrade().is_none());
    source.shared_world(31).unwrap();
}

/// An acquisition shows, and is scored by, the specimen as it was when it began.
#[test]
#[ignore = "long"]
fn doses_change_worlds_for_later() {
    let changes = [
        "field.thickness_nm=0.4",
        "field.tile_px=64",
        "damage.radiolysis_barn.O=4000",
        "dose.electrons_per_angstrom2=1e4",
    ];
    let recipe = changed("test", None, &changes);
    // Without a library, which would take longer for all that may be lost.
    let direct = BuildOptions { method: BuildMethod::Window, ..options() };
    let settings = EpisodeSettings { budget: 500.0, ..EpisodeSettings::default() };
    let source = RecipeSource::new(&recipe, &direct, &Silent).unwrap();
    let world: Arc<dyn BenchmarkWorld> =
        Arc::new(ChangingWorld::new(&source, 4, &settings, &Silent).unwrap());
    let still = source.world(4).unwrap();
    let mut episode = episode(Arc::clone(&world), TaskKind::DefectCensus, settings);
    let mut seen = Vec::new();
    for _ in 0..2 {
        episode.act(ACQUIRE, &Silent).unwrap();
        seen.push(episode.seen().defects().len());
    }
    let view = world.facts().view_at([0.5, 0.5], 1.0);
    let before = still.truth(&view.region(world.facts().pixel_nm), false).unwrap().defects.len();
    assert_eq!(seen[0], before);
    assert!(seen[1] > seen[0], "{seen:?}");
    // At an edge of the field too.
    episode.act(AgentAction::Navigate([0.0, 1.0]), &Silent).unwrap();
    episode.act(ACQUIRE, &Silent).unwrap();
}

#[test]
fn seeds_for_training_are_never_those_for_scores() {
    let recipe = recipe();
    let seeds = |split: Split| {
        (0..200).map(|n| split.seed(&recipe, (n / 2, n as u32 % 2))).collect::<Vec<_>>()
    };
    let (train, test) = (seeds(Split::Train), seeds(Split::Test));
    assert!(train.iter().all(|s| s % 2 == 0) && test.iter().all(|s| s % 2 == 1));
    let mut all = [train, test].concat();
    all.sort_unstable();
    all.dedup();
    assert_eq!(all.len(), 400);
    assert!(all.iter().all(|s| i64::try_from(*s).is_ok()));
}

/// Where particles lie is told, and shown by overviews, before any is simulated; tiles with them are not cut off.
#[test]
fn particles_are_seen_from_afar() {
    let changes = [
        "field.fov_nm=[8.0, 8.0]",
        "field.grid=[5, 5]",
        "field.tile_px=132",
        "field.thickness_nm=1.0",
        "particles.count=1",
        "particles.diameter_nm=[1.2, 1.6]",
        "phonons.configurations=1",
    ];
    let recipe = changed("pt", Some(Difficulty::Easy), &changes);
    let options = BuildOptions { method: BuildMethod::Auto, ..options() };
    let source = RecipeSource::new(&recipe, &options, &Silent).unwrap();
    let facts = source.facts();
    let [height, width] = facts.size_nm();
    let whole = Region { x: [0.0, width], y: [0.0, height] };
    let world = source.world(1).unwrap();
    let particle = world.truth(&whole, false).unwrap().particles.remove(0);
    let placed = world.specimen().particles().remove(0);
    assert_eq!(particle.position_nm, placed.outline().centre_nm);
    assert_eq!(particle.diameter_nm, placed.diameter_nm);

    let overview = world.overview([0.5; 2], 80, &Silent).unwrap();
    let [x, y] = particle.position_nm;
    let mean = |distances_nm: Range<f64>| {
        let place = |n: usize| (8.0 * n as f64 + 3.5) * facts.pixel_nm;
        let distance = |(i, j): (usize, usize)| (place(j) - x).hypot(place(i) - y);
        let chosen =
            overview.indexed_iter().filter(|(at, _)| distances_nm.contains(&distance(*at)));
        let values: Vec<f32> = chosen.map(|(_, v)| *v).collect();
        values.iter().sum::<f32>() / values.len() as f32
    };
    let (on, beside) = (mean(0.0..0.4), mean(1.5..9.0));
    assert!(on > 4.0 * beside && beside > 0.0, "{on} {beside}");

    let tile = world.clean(&facts.view_at([x / width, y / height], 1.0), &Silent).unwrap();
    let brightest = tile.iter().fold(0.0f64, |m, v| m.max(f64::from(*v)));
    let share = brightest / facts.scaling[0];
    assert!((0.3..1.0).contains(&share), "{share}");
}

/// Comparing phases at every eighth pixel changes the score of maps in parts like tiles by less than stated.
#[test]
fn phases_are_compared_at_some_pixels() {
    let changes = [
        "field.thickness_nm=0.4",
        "phonons.configurations=1",
        "detector.inner_mrad=50",
        "detector.outer_mrad=90",
    ];
    let recipe = changed("batio3", Some(Difficulty::Hard), &changes);
    let recipe = recipe.recipe().clone().with_grid(12, 40).unwrap().checked().unwrap();
    // One tile is looked at: a library would take longer.
    let direct = BuildOptions { method: BuildMethod::Window, ..options() };
    let source = RecipeSource::new(&recipe, &direct, &Silent).unwrap();
    let world: Arc<dyn BenchmarkWorld> = Arc::new(source.world(6).unwrap());
    assert_eq!(world.facts().phases.len(), 2);
    let truth = world.phases(1).unwrap();
    let by_tile = Array2::from_shape_fn((12, 40), |(i, j)| {
        truth.phases[[i * 124 + 64, j * 124 + 64]] * i32::from(j != 7)
    });
    let score = |phase_stride_px: usize, map: Option<&Array2<i32>>| {
        let settings = EpisodeSettings { phase_stride_px, ..EpisodeSettings::default() };
        let mut episode = episode(Arc::clone(&world), TaskKind::PhaseMapping, settings);
        episode.act(ACQUIRE, &Silent).unwrap();
        let findings = AgentFindings { phases: map.cloned(), ..AgentFindings::default() };
        episode.act(AgentAction::Declare(findings), &Silent).unwrap();
        episode.score().unwrap()
    };
    let (all, some) = (score(1, Some(&by_tile)), score(8, Some(&by_tile)));
    assert!(all > 0.8 && all < 0.99, "{all}");
    assert!((all - some).abs() < 0.002, "{all} {some}");
    assert_eq!(score(1, Some(&truth.phases)), 1.0);
    assert_eq!(score(8, None), 0.0);
}

#[test]
fn bad_rules_and_actions_are_refused() {
    let bad = [
        EpisodeSettings { budget: 0.0, ..EpisodeSettings::default() },
        EpisodeSettings { budget: f64::NAN, ..EpisodeSettings::default() },
        EpisodeSettings { horizon: 0, ..EpisodeSettings::default() },
        EpisodeSettings { cadence: 0, ..EpisodeSettings::default() },
        EpisodeSettings { phase_stride_px: 0, ..EpisodeSettings::default() },
    ];
    for settings in bad {
        let task = task(TaskKind::DefectCensus);
        assert!(Episode::new(file(), task, settings.clone(), (0, 0)).is_err(), "{settings:?}");
    }
    let mut episode = episode(file(), TaskKind::DefectCensus, EpisodeSettings::default());
    assert!(episode.act(AgentAction::Navigate([f64::NAN, 0.0]), &Silent).is_err());
    let odd = AgentAction::Acquire { zoom: f64::INFINITY, multiplier: 1.0 };
    assert!(episode.act(odd, &Silent).is_err());
    assert_eq!((episode.spent(), episode.step_fraction()), (0.0, 0.0));
    // Beyond their limits, zoom and dose are moved into them.
    let far = AgentAction::Acquire { zoom: 0.0, multiplier: 1e9 };
    assert_eq!(episode.act(far, &Silent).unwrap().acquired.unwrap().cost, 1000.0);
    let settings = EpisodeSettings { noise: TileNoise::Stored, ..EpisodeSettings::default() };
    let made: Arc<dyn BenchmarkWorld> = Arc::new(source().world(2).unwrap());
    let task = task(TaskKind::Targeted);
    let mut stored = Episode::new(made, task, settings, (0, 0)).unwrap();
    assert!(stored.act(ACQUIRE, &Silent).unwrap_err().to_string().contains("no stored tiles"));
}
