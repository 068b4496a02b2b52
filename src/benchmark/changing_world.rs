//! A world of a recipe that acquisitions damage.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use ndarray::{Array2, Axis};

use super::benchmark_world::{BenchmarkWorld, PhaseSamples, RecordedView, RegionTruth};
use super::episode_settings::EpisodeSettings;
use super::recipe_world::{RecipeSource, RecipeWorld, truth_of};
use super::view::{FieldFacts, TileView};
use crate::acquisition::Profile;
use crate::error::Result;
use crate::lengths;
use crate::live::{LiveOptions, LiveRequest, LiveWorld};
use crate::progress::Progress;
use crate::recipe::Region;
use crate::resample::MARGIN;
use crate::world::{Electrons, RecordedPart};

/// A specimen that loses atoms to the electrons that image it, by the cross-sections in the table `[damage]` of its recipe. A view shows
/// the specimen at the beginning of its acquisition; this is also the truth of the view. The overview was taken before the episode.
/// Recordings stay 3 pixels away from the edge of the field.
pub struct ChangingWorld {
    facts: FieldFacts,
    still: Arc<RecipeWorld>,
    live: Mutex<LiveWorld>,
}

impl ChangingWorld {
    /// Makes the world of a seed, for an episode with these rules.
    ///
    /// # Errors
    /// Errors of [`LiveWorld::new`].
    pub fn new(
        source: &RecipeSource,
        seed: u64,
        settings: &EpisodeSettings,
        progress: &dyn Progress,
    ) -> Result<Self> {
        let still = source.shared_world(seed)?;
        let imaging = source.options().clone();
        let most_dose = settings.most_dose(still.facts());
        // Agents see the main detector.
        let main = source.recipe().detector.all().into_iter().take(1).map(|d| d.name).collect();
        let detectors = Some(main);
        let live = LiveOptions { imaging, most_dose, detectors, ..LiveOptions::default() };
        let live = Mutex::new(LiveWorld::new(source.recipe(), seed, &live, progress)?);
        let facts = FieldFacts { margin_px: MARGIN, ..still.facts().clone() };
        Ok(ChangingWorld { facts, still, live })
    }

    fn live(&self) -> MutexGuard<'_, LiveWorld> {
        self.live.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl BenchmarkWorld for ChangingWorld {
    fn facts(&self) -> &FieldFacts {
        &self.facts
    }

    fn clean(&self, view: &TileView, progress: &dyn Progress) -> Result<Arc<Array2<f32>>> {
        self.still.clean(view, progress)
    }

    fn stored(&self, view: &TileView) -> Result<Array2<f32>> {
        self.still.stored(view)
    }

    fn overview(
        &self,
        position: [f64; 2],
        size: usize,
        progress: &dyn Progress,
    ) -> Result<Array2<f32>> {
        self.still.overview(position, size, progress)
    }

    fn truth(&self, region: &Region, columns: bool) -> Result<RegionTruth> {
        let live = self.live();
        Ok(truth_of(live.specimen(), region, live.recipe().field.origin_nm(), columns))
    }

    fn phases(&self, stride_px: usize) -> Result<Arc<PhaseSamples>> {
        self.still.phases(stride_px)
    }

    fn exposed(
        &self,
        view: &TileView,
        dose: f64,
        columns: bool,
        progress: &dyn Progress,
    ) -> Result<Option<RecordedView>> {
        let pixel_nm = self.facts().pixel_nm;
        let region = view.region(pixel_nm);
        let truth = self.truth(&region, columns)?;
        let fine = pixel_nm / view.zoom;
        let request = LiveRequest {
            part: RecordedPart {
                centre_nm: view.centre_nm(pixel_nm),
                size_nm: [view.tile_px as f64 * fine; 2],
                pixel_nm: fine,
            },
            electrons: Electrons::Dose(dose),
            acquisition: Profile::Ideal.acquisition(),
            keep_frames: false,
        };
        let recording = self.live().acquire(&request, progress)?;
        let electrons = dose * lengths::square_angstrom2(fine);
        let image = recording.data.index_axis(Axis(0), 0).mapv(|n| (n / electrons) as f32);
        Ok(Some(RecordedView { image, truth }))
    }
}
