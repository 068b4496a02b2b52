//! An episode: an agent moves the view, spends its dose, and declares its findings.

use std::sync::Arc;

use ndarray::Array2;
use serde::{Deserialize, Serialize};

use super::benchmark_world::{BenchmarkWorld, PhaseSamples, RegionTruth, TrueColumn};
use super::dose_efficiency::DoseCurve;
use super::electron_counts::AcquisitionKey;
use super::episode_record::{EpisodeRecord, RecordedAcquisition};
use super::episode_settings::{EpisodeSettings, MULTIPLIER, OVERVIEW_PX, Reward, TileNoise, ZOOM};
use super::findings::{AgentFindings, FoundColumn};
use super::seen_truth::SeenTruth;
use super::task::{Task, TaskKind, TaskScore};
use super::view::{FieldFacts, TileView};
use crate::error::{Error, Result};
use crate::plane;
use crate::progress::Progress;
use crate::setting::Setting;

/// A budget counts as kept up to this relative error.
const ROUNDING: f64 = 1e-9;

/// An action of an agent.
#[derive(Debug, Clone, PartialEq)]
pub enum AgentAction {
    /// Moves to a place (x, y) in fractions of the field's width and height, at no cost.
    Navigate([f64; 2]),
    /// Records the view at the present place.
    Acquire {
        /// The view shows 1 / zoom of a tile's width; the dose grows with the square of the zoom.
        zoom: f64,
        /// Multiple of the reference dose.
        multiplier: f64,
    },
    /// Declares the findings in the field, which replace all earlier ones.
    Declare(AgentFindings),
    /// A declaration that could not be read: the earlier findings stay.
    Unreadable,
    /// Ends the episode.
    Done,
}

/// Reason for the end of an episode.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Ending {
    /// The agent ended it.
    Done,
    /// The cost of an acquisition exceeded the budget.
    Refused,
    /// No steps were left.
    Horizon,
}

/// Result of a step.
#[derive(Debug, Clone, PartialEq)]
pub struct StepOutcome {
    /// Reward of the step.
    pub reward: f64,
    /// Reason for the end of the episode, if it ended.
    pub ended: Option<Ending>,
    /// The acquisition, if one was made.
    pub acquired: Option<RecordedAcquisition>,
}

/// One episode.
pub struct Episode {
    world: Arc<dyn BenchmarkWorld>,
    settings: EpisodeSettings,
    task: Task,
    seed: u64,
    number: u32,
    step: u32,
    view: TileView,
    spent: f64,
    tile: Arc<Array2<f32>>,
    visited: Array2<u8>,
    seen: SeenTruth,
    findings: Option<AgentFindings>,
    declared: u32,
    unreadable: u32,
    acquisitions: Vec<RecordedAcquisition>,
    curve: DoseCurve,
    /// Whether the score has to be recorded before more dose is spent.
    due: bool,
    paid: f64,
    ended: Option<Ending>,
}

impl Episode {
    /// Starts an episode at the middle of the field. The noise of acquisitions depends on seed, number and step alone.
    ///
    /// # Errors
    /// Errors of [`EpisodeSettings::check`] and [`Task::check`], and [`Error::Invalid`] for a field that is smaller than a tile.
    pub fn new(
        world: Arc<dyn BenchmarkWorld>,
        task: Task,
        settings: EpisodeSettings,
        (seed, number): (u64, u32),
    ) -> Result<Self> {
        let field = world.facts();
        settings.check(field)?;
        task.check()?;
        let view = field.view_at([0.5, 0.5], 1.0);
        let task = match task.kind {
            TaskKind::Targeted => {
                Task { target: task.target.or_else(|| field.target.clone()), ..task }
            }
            _ => task,
        };
        Ok(Episode {
            tile: Arc::new(Array2::zeros([field.tile_px; 2])),
            visited: Array2::zeros(field.grid),
            world,
            settings,
            task,
            seed,
            number,
            step: 0,
            view,
            spent: 0.0,
            seen: SeenTruth::default(),
            findings: None,
            declared: 0,
            unreadable: 0,
            acquisitions: Vec::new(),
            curve: DoseCurve::default(),
            due: false,
            paid: 0.0,
            ended: None,
        })
    }

    /// Carries out one action.
    ///
    /// # Errors
    /// [`Error::Invalid`] after the end and for numbers that are not finite; errors of the world. The episode is then unchanged.
    pub fn act(&mut self, action: AgentAction, progress: &dyn Progress) -> Result<StepOutcome> {
        if self.ended.is_some() {
            let expected = "the episode has ended; begin another one";
            return Err(Error::invalid(Setting::Episode, "an action", expected));
        }
        let mut acquired = None;
        let mut pays = false;
        let mut ended = None;
        match action {
            AgentAction::Navigate(position) => self.navigate(position)?,
            AgentAction::Acquire { zoom, multiplier } => {
                let [zoom, multiplier] = within([zoom, multiplier])?;
                match self.acquire(zoom, multiplier, progress)? {
                    Some(what) => {
                        acquired = Some(what);
                        pays = true;
                    }
                    None => ended = Some(Ending::Refused),
                }
            }
            AgentAction::Declare(findings) => {
                findings.check()?;
                self.findings = Some(findings);
                self.declared += 1;
                pays = true;
            }
            AgentAction::Unreadable => self.unreadable += 1,
            AgentAction::Done => ended = Some(Ending::Done),
        }
        self.step += 1;
        if self.step >= self.settings.horizon {
            ended = ended.or(Some(Ending::Horizon));
        }
        if ended.is_some() {
            self.note()?;
            self.ended = ended;
        }
        let reward = self.reward(pays)?;
        Ok(StepOutcome { reward, ended, acquired })
    }

    fn navigate(&mut self, position: [f64; 2]) -> Result<()> {
        if !position.iter().all(|v| v.is_finite()) {
            let expected = "a place is two finite numbers, fractions of the field";
            return Err(Error::invalid(Setting::Episode, format!("{position:?}"), expected));
        }
        self.view = self.world.facts().view_at(position, 1.0);
        Ok(())
    }

    /// Makes an acquisition; `None` if its cost exceeds the budget.
    fn acquire(
        &mut self,
        zoom: f64,
        multiplier: f64,
        progress: &dyn Progress,
    ) -> Result<Option<RecordedAcquisition>> {
        let cost = EpisodeSettings::cost(zoom, multiplier);
        if self.spent + cost > self.settings.budget * (1.0 + ROUNDING) {
            return Ok(None);
        }
        let world = Arc::clone(&self.world);
        let field = world.facts();
        let view = TileView { zoom, ..self.view };
        let electrons_per_pixel = self.settings.electrons_per_pixel(field, multiplier);
        let (tile, truth) = self.recorded(&view, multiplier, electrons_per_pixel, progress)?;
        // The score of everything seen so far is recorded before this view is added.
        if self.due {
            self.note()?;
        }
        let [row, column] = field.tile_of(&view);
        self.spent += cost;
        self.tile = Arc::new(tile);
        self.visited[[row, column]] = 1;
        self.seen.add(view.region(field.pixel_nm), truth);
        let what = RecordedAcquisition {
            step: self.step,
            tile: [row, column],
            centre_nm: view.centre_nm(field.pixel_nm),
            size_nm: field.tile_px as f64 * field.pixel_nm / zoom,
            zoom,
            multiplier,
            cost,
            electrons_per_pixel,
        };
        self.acquisitions.push(what.clone());
        self.due = (self.acquisitions.len() as u32).is_multiple_of(self.settings.cadence);
        Ok(Some(what))
    }

    /// Returns the tile of a view, and the truth of the view.
    fn recorded(
        &self,
        view: &TileView,
        multiplier: f64,
        electrons_per_pixel: f64,
        progress: &dyn Progress,
    ) -> Result<(Array2<f32>, RegionTruth)> {
        let (world, field) = (&self.world, self.world.facts());
        let columns = matches!(self.task.kind, TaskKind::DefectCensus | TaskKind::Targeted);
        let [scale, offset] = field.scaling;
        let scaled = |v: f32| ((f64::from(v) - offset) / scale).clamp(0.0, 1.0) as f32;
        if self.settings.noise == TileNoise::Stored {
            let truth = world.truth(&view.region(field.pixel_nm), columns)?;
            return Ok((world.stored(view)?, truth));
        }
        let dose = self.settings.dose(field) * multiplier * view.zoom * view.zoom;
        if let Some(found) = world.exposed(view, dose, columns, progress)? {
            return Ok((found.image.mapv(scaled), found.truth));
        }
        let truth = world.truth(&view.region(field.pixel_nm), columns)?;
        let clean = world.clean(view, progress)?;
        let key = AcquisitionKey { seed: self.seed, episode: self.number, step: self.step };
        let mut image = key.counted(&clean, electrons_per_pixel);
        image.mapv_inplace(scaled);
        Ok((image, truth))
    }

    /// Records the score of the declaration so far, if there is one: the curve begins with the first declaration.
    fn note(&mut self) -> Result<()> {
        self.due = false;
        if self.findings.is_none() {
            return Ok(());
        }
        let share = (self.spent / self.settings.budget).min(1.0);
        let score = self.score()?;
        self.curve.record(share, score)
    }

    fn phases(&self) -> Result<Option<Arc<PhaseSamples>>> {
        match self.task.kind {
            TaskKind::PhaseMapping => self.world.phases(self.settings.phase_stride_px).map(Some),
            _ => Ok(None),
        }
    }

    /// Returns the score of the last declaration against everything seen so far. It is 0 before the first declaration, and before the first
    /// acquisition.
    ///
    /// # Errors
    /// Errors of the world.
    pub fn score(&self) -> Result<f64> {
        match &self.findings {
            Some(findings) if !self.acquisitions.is_empty() => {
                self.task.score(findings, &self.seen, self.phases()?.as_deref())
            }
            _ => Ok(0.0),
        }
    }

    /// Returns all forms of the score; `None` where [`Episode::score`] is 0 because nothing was declared or seen.
    ///
    /// # Errors
    /// Errors of the world.
    pub(crate) fn all_scores(&self) -> Result<Option<TaskScore>> {
        match &self.findings {
            Some(findings) if !self.acquisitions.is_empty() => {
                self.task.all_scores(findings, &self.seen, self.phases()?.as_deref()).map(Some)
            }
            _ => Ok(None),
        }
    }

    fn reward(&mut self, pays: bool) -> Result<f64> {
        match self.settings.reward {
            Reward::None => Ok(0.0),
            Reward::Sparse if self.ended.is_some() => self.score(),
            Reward::Sparse => Ok(0.0),
            Reward::ScoreGain if pays => {
                let score = self.score()?;
                let gain = score - self.paid;
                self.paid = score;
                Ok(gain)
            }
            Reward::ScoreGain => Ok(0.0),
        }
    }

    /// Returns the world.
    pub fn world(&self) -> &Arc<dyn BenchmarkWorld> {
        &self.world
    }

    /// Returns facts of the field.
    pub(crate) fn field(&self) -> &FieldFacts {
        self.world.facts()
    }

    /// Returns the last tile in units of tiles, [row, column]; zeros before the first.
    pub fn tile(&self) -> &Arc<Array2<f32>> {
        &self.tile
    }

    /// Returns the part of the overview about the present place, [row, column], of [`OVERVIEW_PX`] pixels.
    ///
    /// # Errors
    /// Errors of the world.
    pub fn overview(&self, progress: &dyn Progress) -> Result<Array2<f32>> {
        match self.settings.overview {
            true => self.world.overview(self.position(), OVERVIEW_PX, progress),
            false => Ok(Array2::zeros([OVERVIEW_PX; 2])),
        }
    }

    /// Returns the present place (x, y) in fractions of the field.
    pub fn position(&self) -> [f64; 2] {
        self.field().position_of(&self.view)
    }

    /// Returns the share of the budget that is left.
    pub fn dose_left(&self) -> f64 {
        (1.0 - self.spent / self.settings.budget).max(0.0)
    }

    /// Returns the electrons per square Angstrom that were spent.
    pub fn spent(&self) -> f64 {
        self.spent
    }

    /// Returns the share of the steps that were made.
    pub fn step_fraction(&self) -> f64 {
        f64::from(self.step) / f64::from(self.settings.horizon)
    }

    /// Returns a map of the tiles (row, column): 1 for tiles in which something was acquired.
    pub fn visited(&self) -> &Array2<u8> {
        &self.visited
    }

    /// Returns whether navigating, acquiring with the least dose, declaring and ending have any effect now.
    pub fn mask(&self) -> [bool; 4] {
        let going = self.ended.is_none();
        let least = EpisodeSettings::cost(ZOOM[0], MULTIPLIER[0]);
        let fits = self.spent + least <= self.settings.budget * (1.0 + ROUNDING);
        [going, going && fits, going, going]
    }

    /// Returns the truth of everything seen.
    pub fn seen(&self) -> &SeenTruth {
        &self.seen
    }

    /// Returns the findings that an agent with the truth of everything seen would declare. Phases are known there only.
    ///
    /// # Errors
    /// Errors of the world.
    pub fn truth_seen(&self) -> Result<AgentFindings> {
        let seen = &self.seen;
        let phases = match self.phases()? {
            Some(samples) => seen.phases(&samples, self.field().pixel_nm),
            None => None,
        };
        let column = |c: &TrueColumn| FoundColumn { position_nm: c.position_nm, score: 1.0 };
        Ok(AgentFindings {
            counts: None,
            defects: Some(seen.defects().to_vec()),
            phases,
            particles: seen.particles().to_vec(),
            columns: seen.columns().iter().filter(|c| c.defective).map(column).collect(),
        })
    }

    /// Returns the number of declarations that could not be read.
    pub fn unreadable(&self) -> u32 {
        self.unreadable
    }

    /// Returns the acquisitions so far.
    pub fn acquisitions(&self) -> &[RecordedAcquisition] {
        &self.acquisitions
    }

    /// Returns the record of the episode so far, with its scores.
    ///
    /// # Errors
    /// Errors of the world.
    pub fn record(&self) -> Result<EpisodeRecord> {
        let counts = (self.declared, self.unreadable, self.step);
        Ok(EpisodeRecord {
            world: self.field().name.clone(),
            task: self.task.clone(),
            settings: self.settings.clone(),
            seed: self.seed,
            episode: self.number,
            ended: self.ended,
            steps: counts.2,
            declared: counts.0,
            unreadable: counts.1,
            spent: self.spent,
            curve: self.curve.records().to_vec(),
            metrics: self.curve.metrics(),
            scores: self.all_scores()?,
            acquisitions: self.acquisitions.clone(),
        })
    }
}

/// Moves zoom and multiplier into their limits.
fn within(values: [f64; 2]) -> Result<[f64; 2]> {
    if !values.iter().all(|v| v.is_finite()) {
        let expected = "zoom and dose are finite numbers";
        return Err(Error::invalid(Setting::Episode, format!("{values:?}"), expected));
    }
    let limits = [ZOOM, MULTIPLIER];
    Ok(plane::per_axis(values, limits, |v, [low, high]| v.clamp(low, high)))
}
