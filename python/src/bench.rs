//! Runs one or many episodes of the benchmark.

use crate::builds::CacheChoice;
use crate::errors::{Fault, OrRaise};
use crate::long_call::{LongCall, Running, run};
use crate::recipes::checked;
use crate::words::choice;
use ndarray::{Array1, Array2, Array3, Axis};
use numpy::IntoPyArray;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rayon::prelude::*;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::SystemTime;
use stemgen::benchmark::{
    AgentAction, AgentFindings, BenchmarkWorld, ChangingWorld, DoseCurve, Ending, Episode,
    EpisodeSettings, FieldFacts, FileWorld, InUse, RecipeSource, RecordedAcquisition, Reward,
    Split, Task, TaskKind, TileDose, TileNoise,
};
use stemgen::imaging::Cache;
use stemgen::progress::Silent;
use stemgen::recipe::Recipe;
use stemgen::world::BuildOptions;
use stemgen::{Error, Setting};

/// The world of an episode, or the recipe from which each episode makes one.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct Scene {
    /// Path of a world file; `None` for a recipe.
    world: Option<PathBuf>,
    toml: Option<String>,
    /// Acquisitions change the specimen.
    damage: bool,
    split: String,
    cache: CacheChoice,
}

/// The rules of an episode.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct Rules {
    task: String,
    strict: bool,
    target: Option<String>,
    budget: f64,
    horizon: u32,
    cadence: u32,
    exposure: String,
    noise: Option<String>,
    reward: String,
    phase_stride_px: usize,
    overview: bool,
}

/// The source of worlds.
enum Worlds {
    File(Arc<FileWorld>),
    Recipe { source: Arc<RecipeSource>, split: Split, damage: bool },
}

/// Sources in use by the environments of this process. Environments of different tasks share a specimen and its images. A recipe contains
/// its crystals, so equal recipes make equal worlds.
static SOURCES: InUse<(Recipe, Cache), RecipeSource> = InUse::new();
/// A file by its path, length and time of change, and the cache for images that it does not contain.
type FileKey = (PathBuf, Option<(u64, SystemTime)>, Cache);
static FILES: InUse<FileKey, FileWorld> = InUse::new();

impl Worlds {
    fn new(scene: &Scene, call: &LongCall) -> Result<Self, Fault> {
        let options = BuildOptions { cache: scene.cache.cache(), ..BuildOptions::default() };
        if let Some(path) = &scene.world {
            let about = path.metadata().and_then(|about| Ok((about.len(), about.modified()?))).ok();
            let key = (path.clone(), about, options.cache.clone());
            return Ok(Worlds::File(FILES.get(key, || FileWorld::open(path, &options))?));
        }
        let splits = [("train", Split::Train), ("test", Split::Test)];
        let split = choice(Setting::Episode, &scene.split, &splits)?;
        let recipe = checked(scene.toml.as_deref().unwrap_or_default())?;
        let key = (recipe.recipe().clone(), options.cache.clone());
        let source = SOURCES.get(key, || RecipeSource::new(&recipe, &options, call))?;
        Ok(Worlds::Recipe { source, split, damage: scene.damage })
    }

    fn facts(&self) -> &FieldFacts {
        match self {
            Worlds::File(world) => world.facts(),
            Worlds::Recipe { source, .. } => source.facts(),
        }
    }

    /// Returns the world of an episode (seed, number).
    fn world(
        &self,
        episode: (u64, u32),
        settings: &EpisodeSettings,
        call: &LongCall,
    ) -> Result<Arc<dyn BenchmarkWorld>, Fault> {
        Ok(match self {
            Worlds::File(world) => Arc::clone(world) as Arc<dyn BenchmarkWorld>,
            Worlds::Recipe { source, split, damage } => {
                let seed = split.seed(source.recipe(), episode);
                match damage {
                    true => Arc::new(ChangingWorld::new(source, seed, settings, call)?),
                    false => source.shared_world(seed)?,
                }
            }
        })
    }
}

impl Rules {
    fn task(&self) -> Result<Task, Fault> {
        use TaskKind::{DefectCensus, ParticleCensus, PhaseMapping, Targeted};
        let kinds = [DefectCensus, PhaseMapping, Targeted, ParticleCensus];
        let kinds = kinds.map(|kind| (kind.name(), kind));
        let kind = choice(Setting::Episode, &self.task, &kinds)?;
        let task = Task { kind, strict: self.strict, target: self.target.clone() };
        task.check()?;
        Ok(task)
    }

    fn settings(&self, field: &FieldFacts) -> Result<EpisodeSettings, Fault> {
        let exposures = [("tier", TileDose::Tier), ("physical", TileDose::Physical)];
        let noises = [("poisson", TileNoise::Poisson), ("stored", TileNoise::Stored)];
        let rewards =
            [("none", Reward::None), ("score_gain", Reward::ScoreGain), ("sparse", Reward::Sparse)];
        let own = if field.recorded { TileNoise::Stored } else { TileNoise::Poisson };
        let noise = self.noise.as_deref().map(|n| choice(Setting::Episode, n, &noises));
        let settings = EpisodeSettings {
            budget: self.budget,
            horizon: self.horizon,
            cadence: self.cadence,
            exposure: choice(Setting::Episode, &self.exposure, &exposures)?,
            noise: noise.transpose()?.unwrap_or(own),
            reward: choice(Setting::Episode, &self.reward, &rewards)?,
            phase_stride_px: self.phase_stride_px,
            overview: self.overview,
        };
        settings.check(field)?;
        Ok(settings)
    }
}

/// The state of one of many episodes.
#[derive(Default)]
struct Slot {
    episode: Option<Episode>,
}

/// The result of a step of a slot.
#[derive(Default)]
struct Stepped {
    reward: f64,
    ended: Option<Ending>,
    acquired: Option<RecordedAcquisition>,
    fault: Option<String>,
}

/// The actions of the slots. A slot with an episode (seed, number) begins it; the other slots act.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct Moves {
    begin: Vec<Option<(u64, u32)>>,
    kinds: Vec<i64>,
    positions: Vec<[f64; 2]>,
    zooms: Vec<f64>,
    doses: Vec<f64>,
    reports: Vec<Option<String>>,
}

/// Episodes with one task in worlds of one kind.
#[pyclass(frozen, module = "stemworlds._core")]
pub struct Episodes {
    worlds: Arc<Worlds>,
    task: Task,
    settings: EpisodeSettings,
    slots: Arc<Mutex<Vec<Slot>>>,
}

fn locked(slots: &Mutex<Vec<Slot>>) -> MutexGuard<'_, Vec<Slot>> {
    slots.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Moves {
    fn action(&self, n: usize) -> (AgentAction, Option<String>) {
        let action = match self.kinds[n] {
            0 => AgentAction::Navigate(self.positions[n]),
            1 => AgentAction::Acquire { zoom: self.zooms[n], multiplier: self.doses[n] },
            2 => match AgentFindings::read(self.reports[n].as_deref().unwrap_or("{}")) {
                Ok(findings) => AgentAction::Declare(findings),
                Err(e) => return (AgentAction::Unreadable, Some(e.to_string())),
            },
            _ => AgentAction::Done,
        };
        (action, None)
    }

    fn check(&self, slots: usize) -> Result<(), Fault> {
        let lengths = [
            self.begin.len(),
            self.kinds.len(),
            self.positions.len(),
            self.zooms.len(),
            self.doses.len(),
            self.reports.len(),
        ];
        if lengths == [slots; 6] {
            return Ok(());
        }
        let expected = format!("expected actions for {slots} environments");
        Err(Fault::Value(Setting::Episode, format!("{lengths:?}"), expected))
    }
}

/// Observations of all slots, in arrays whose first axis is the slot.
struct Seen {
    tile: Array3<f32>,
    overview: Array3<f32>,
    position: Array2<f32>,
    dose_left: Array2<f32>,
    step_fraction: Array2<f32>,
    visited: Array3<i8>,
    mask: Array2<i8>,
}

impl Seen {
    fn of(slots: &[Slot], field: &FieldFacts, call: &LongCall) -> Result<Self, Fault> {
        let n = slots.len();
        let overview_px = stemgen::benchmark::OVERVIEW_PX;
        let mut seen = Seen {
            tile: Array3::zeros((n, field.tile_px, field.tile_px)),
            overview: Array3::zeros((n, overview_px, overview_px)),
            position: Array2::zeros((n, 2)),
            dose_left: Array2::zeros((n, 1)),
            step_fraction: Array2::zeros((n, 1)),
            visited: Array3::zeros((n, field.grid[0], field.grid[1])),
            mask: Array2::zeros((n, 4)),
        };
        for (k, episode) in slots.iter().enumerate() {
            let Some(episode) = &episode.episode else { continue };
            seen.tile.index_axis_mut(Axis(0), k).assign(&**episode.tile());
            let visited = seen.visited.index_axis_mut(Axis(0), k);
            ndarray::Zip::from(visited).and(episode.visited()).for_each(|to, v| *to = *v as i8);
            for (axis, value) in episode.position().into_iter().enumerate() {
                seen.position[[k, axis]] = value as f32;
            }
            seen.dose_left[[k, 0]] = episode.dose_left() as f32;
            seen.step_fraction[[k, 0]] = episode.step_fraction() as f32;
            for (which, allowed) in episode.mask().into_iter().enumerate() {
                seen.mask[[k, which]] = i8::from(allowed);
            }
        }
        let windows: Vec<_> = slots.iter().zip(seen.overview.outer_iter_mut()).collect();
        windows.into_par_iter().try_for_each(|(slot, mut to)| -> Result<(), Error> {
            if let Some(episode) = &slot.episode {
                to.assign(&episode.overview(call)?);
            }
            Ok(())
        })?;
        Ok(seen)
    }

    fn fill<'py>(self, py: Python<'py>, out: &Bound<'py, PyDict>) -> PyResult<()> {
        out.set_item("tile", self.tile.into_pyarray(py))?;
        out.set_item("overview", self.overview.into_pyarray(py))?;
        out.set_item("position", self.position.into_pyarray(py))?;
        out.set_item("dose_left", self.dose_left.into_pyarray(py))?;
        out.set_item("step_fraction", self.step_fraction.into_pyarray(py))?;
        out.set_item("visited", self.visited.into_pyarray(py))?;
        out.set_item("action_mask", self.mask.into_pyarray(py))
    }
}

fn name_of(ending: Ending) -> &'static str {
    match ending {
        Ending::Done => "done",
        Ending::Refused => "refused",
        Ending::Horizon => "horizon",
    }
}

fn acquired<'py>(py: Python<'py>, what: &RecordedAcquisition) -> PyResult<Bound<'py, PyDict>> {
    let out = PyDict::new(py);
    out.set_item("row", what.tile[0])?;
    out.set_item("column", what.tile[1])?;
    out.set_item("centre_nm", (what.centre_nm[0], what.centre_nm[1]))?;
    out.set_item("size_nm", what.size_nm)?;
    out.set_item("zoom", what.zoom)?;
    out.set_item("dose", what.multiplier)?;
    out.set_item("cost", what.cost)?;
    out.set_item("electrons_per_pixel", what.electrons_per_pixel)?;
    Ok(out)
}

#[pymethods]
impl Episodes {
    #[new]
    fn new(
        py: Python<'_>,
        scene: Scene,
        rules: Rules,
        count: usize,
        running: Running,
    ) -> PyResult<Self> {
        run(py, running, move |call| {
            let worlds = Worlds::new(&scene, call)?;
            let (task, settings) = (rules.task()?, rules.settings(worlds.facts())?);
            let slots = (0..count).map(|_| Slot::default()).collect();
            Ok(Episodes {
                worlds: Arc::new(worlds),
                task,
                settings,
                slots: Arc::new(Mutex::new(slots)),
            })
        })
    }

    /// Returns the facts of the field, the rules and the task as JSON.
    fn facts(&self, py: Python<'_>) -> PyResult<String> {
        let facts = serde_json::json!({
            "field": self.worlds.facts(), "settings": self.settings, "task": self.task,
        });
        serde_json::to_string(&facts).map_err(Fault::from).or_raise(py)
    }

    /// Executes one step of all slots. Returns a dict of arrays.
    fn step(&self, py: Python<'_>, moves: Moves, running: Running) -> PyResult<Py<PyDict>> {
        let (worlds, slots) = (Arc::clone(&self.worlds), Arc::clone(&self.slots));
        let (task, settings) = (self.task.clone(), self.settings.clone());
        let (seen, stepped, facts) = run(py, running, move |call| {
            let mut slots = locked(&slots);
            moves.check(slots.len())?;
            let act = |(n, slot): (usize, &mut Slot)| -> Result<Stepped, Fault> {
                if let Some(which) = moves.begin[n] {
                    let world = worlds.world(which, &settings, call)?;
                    let (task, settings) = (task.clone(), settings.clone());
                    slot.episode = Some(Episode::new(world, task, settings, which)?);
                    return Ok(Stepped::default());
                }
                let Some(episode) = &mut slot.episode else {
                    let expected = "reset the environment first".to_owned();
                    return Err(Fault::Value(Setting::Episode, "a step".into(), expected));
                };
                let (action, fault) = moves.action(n);
                let done = episode.act(action, &WithoutProgress(call))?;
                let (reward, ended, acquired) = (done.reward, done.ended, done.acquired);
                Ok(Stepped { reward, ended, acquired, fault })
            };
            let stepped =
                slots.par_iter_mut().enumerate().map(act).collect::<Result<Vec<_>, _>>()?;
            let seen = Seen::of(&slots, worlds.facts(), call)?;
            let facts = |slot: &Slot| {
                let of = |e: &Episode| (e.spent(), e.acquisitions().len(), e.unreadable());
                slot.episode.as_ref().map_or((0.0, 0, 0), of)
            };
            let facts: Vec<_> = slots.iter().map(facts).collect();
            Ok((seen, stepped, facts))
        })?;
        let out = PyDict::new(py);
        seen.fill(py, &out)?;
        let reward: Array1<f64> = stepped.iter().map(|s| s.reward).collect();
        out.set_item("reward", reward.into_pyarray(py))?;
        let ended: Vec<_> = stepped.iter().map(|s| s.ended.map(name_of)).collect();
        out.set_item("ended", ended)?;
        let lists: Vec<_> = stepped
            .iter()
            .map(|s| s.acquired.as_ref().map(|what| acquired(py, what)).transpose())
            .collect::<PyResult<_>>()?;
        out.set_item("acquired", lists)?;
        out.set_item("fault", stepped.iter().map(|s| s.fault.as_deref()).collect::<Vec<_>>())?;
        out.set_item("spent", facts.iter().map(|f| f.0).collect::<Vec<_>>())?;
        out.set_item("tiles", facts.iter().map(|f| f.1).collect::<Vec<_>>())?;
        out.set_item("unreadable", facts.iter().map(|f| f.2).collect::<Vec<_>>())?;
        Ok(out.unbind())
    }

    /// Returns the record of a slot as JSON.
    fn record(&self, py: Python<'_>, slot: usize, running: Running) -> PyResult<String> {
        self.of(py, slot, running, |episode| {
            serde_json::to_string(&episode.record()?).map_err(Fault::from)
        })
    }

    /// Returns the score of the last declaration in a slot.
    fn score(&self, py: Python<'_>, slot: usize, running: Running) -> PyResult<f64> {
        self.of(py, slot, running, |episode| Ok(episode.score()?))
    }

    /// Returns the truth of the acquired tiles of a slot, as a report.
    fn truth_seen(&self, py: Python<'_>, slot: usize, running: Running) -> PyResult<String> {
        self.of(py, slot, running, |episode| Ok(episode.truth_seen()?.report()))
    }

    /// Returns the central part of the overview, with `size` pixels along each axis, for pictures.
    fn overview<'py>(
        &self,
        py: Python<'py>,
        slot: usize,
        size: usize,
        running: Running,
    ) -> PyResult<Bound<'py, numpy::PyArray2<f32>>> {
        let image = self.of(py, slot, running, move |episode| {
            Ok(episode.world().overview([0.5, 0.5], size, &Silent)?)
        })?;
        Ok(image.into_pyarray(py))
    }
}

impl Episodes {
    fn of<T: Send + 'static>(
        &self,
        py: Python<'_>,
        slot: usize,
        running: Running,
        tell: impl FnOnce(&Episode) -> Result<T, Fault> + Send + 'static,
    ) -> PyResult<T> {
        let slots = Arc::clone(&self.slots);
        run(py, running, move |_| {
            let slots = locked(&slots);
            match slots.get(slot).and_then(|slot| slot.episode.as_ref()) {
                Some(episode) => tell(episode),
                None => {
                    let expected = "reset the environment first".to_owned();
                    Err(Fault::Value(Setting::Episode, "no episode".into(), expected))
                }
            }
        })
    }
}

/// Passes on interrupts and warnings, but no progress.
struct WithoutProgress<'a>(&'a LongCall);

impl stemgen::progress::Progress for WithoutProgress<'_> {
    fn start(&self, _: &str, _: &str, _: u64) {}
    fn advance(&self, _: u64) {}
    fn finish(&self) {}
    fn warn(&self, message: &str) {
        self.0.warn(message);
    }
    fn interrupted(&self) -> bool {
        self.0.interrupted()
    }
}

/// Computes the metrics of a [`DoseCurve`] from records (share of the budget, score). Returns them as JSON.
#[pyfunction]
pub fn dose_metrics(
    py: Python<'_>,
    records: Vec<[f64; 2]>,
    checkpoints: usize,
) -> PyResult<String> {
    let metrics = || -> Result<String, Fault> {
        serde_json::to_string(&dose_curve(records)?.metrics_of(checkpoints)).map_err(Fault::from)
    };
    metrics().or_raise(py)
}

/// Returns the scores of a [`DoseCurve`] at equally spaced shares of the budget, from records (share of the budget, score).
#[pyfunction]
pub fn dose_checkpoints(
    py: Python<'_>,
    records: Vec<[f64; 2]>,
    checkpoints: usize,
) -> PyResult<Vec<f64>> {
    dose_curve(records).map(|curve| curve.checkpoints(checkpoints)).or_raise(py)
}

fn dose_curve(records: Vec<[f64; 2]>) -> Result<DoseCurve, Fault> {
    let mut curve = DoseCurve::default();
    for [share, score] in records {
        curve.record(share, score)?;
    }
    Ok(curve)
}
