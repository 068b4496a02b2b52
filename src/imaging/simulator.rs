//! The engine and its settings for a world.

use crate::engine::settings::EXACT_BAND_FRACTION;
use crate::engine::{
    Algorithm, BeyondLimit, Expansion, GridChoice, Phonons, Plan, ProbeBox, ProbeRaster, ProbeStep,
    Scan, Settings, Simulation, Site, WindowChoice, elements, probe_margin_angstrom, sees_tail,
    simulate, window_for,
};
use crate::error::{Error, Result};
use crate::imaging::displaced_atoms::DisplacedAtoms;
use crate::imaging::pixels::PixelBox;
use crate::lengths;
use crate::potential::slices::Slicing;
use crate::progress::Progress;
use crate::progress::ProgressShare;
use crate::recipe::tables::StructureKind;
use crate::recipe::{BEYOND_FIELD_NM, Recipe};
use crate::resample::{Kernel, image_band_limit};
use crate::specimen::DISPLACED_NM;
use ndarray::{Array2, Axis};

/// Simulates sub-tiles of a world with [`crate::engine`].
#[derive(Debug, Clone)]
pub struct Simulator {
    settings: Settings,
}

/// Window of the default engine in Angstrom. Its error is 0.8 % rms of the mean image on five structures up to 10 nm
/// ([`crate::engine::window_for`]).
pub(crate) const WINDOW_ANGSTROM: f64 = 7.8;
/// Error in per cent of the mean image for which [`crate::engine::window_for`] chooses the windows of a world by default.
const ACCURACY_PERCENT: f64 = 0.8;

/// The window of a world by default.
///
/// # Errors
/// Errors of [`window_for`].
pub(crate) fn default_window(recipe: &Recipe) -> Result<WindowChoice> {
    let algorithm = Algorithm::Window { width_angstrom: WINDOW_ANGSTROM };
    let simulator = Simulator::new(recipe, algorithm);
    let thickness_angstrom = recipe.field.thickness_angstrom();
    window_for(ACCURACY_PERCENT, simulator.settings(), thickness_angstrom)
}

/// Specimen beyond the scanned area in Angstrom for engines without windows: as far as a probe spreads.
const SPREAD_ANGSTROM: f64 = 6.0;
/// Reach in Angstrom of an atom's potential, which must not come in from the other side of the periodic box.
pub(crate) const POTENTIAL_REACH_ANGSTROM: f64 = 1.5;

impl Simulator {
    /// Simulates with these settings.
    pub fn of(settings: Settings) -> Self {
        Simulator { settings }
    }

    /// Default settings for a recipe: a grid that carries scattering beyond the detector, slices at the atomic planes (of a user's atoms:
    /// [`Slicing::Auto`]), and the given algorithm.
    pub fn new(recipe: &Recipe, algorithm: Algorithm) -> Self {
        let optics = recipe.optics.optics();
        // Where pixels need no probes between them, they need no probes beyond the edge of the area either.
        let coarse =
            recipe.field.pixel_angstrom() >= Kernel::default_step(image_band_limit(&optics));
        let detectors = recipe.detector.measured();
        let settings = Settings {
            direct_beam: detectors.iter().any(|detector| sees_tail(detector, &optics)),
            probe_step: if coarse { ProbeStep::Scan } else { ProbeStep::Auto },
            optics,
            detectors,
            phonons: Some(Phonons {
                configurations: recipe.phonons.configurations as u32,
                seed: recipe.seed,
            }),
            algorithm,
            slicing: match recipe.structure {
                StructureKind::Atoms | StructureKind::Stack => Slicing::Auto,
                _ => Slicing::Planes,
            },
            ..Settings::default()
        };
        Simulator { settings }
    }

    /// Published settings of the STEMGym worlds: PRISM f = 2, 0.05 A, 1 A slices. This grid carries scattering to 167 mrad only, and a
    /// warning says so.
    pub fn published(recipe: &Recipe) -> Self {
        let mut simulator = Self::new(recipe, Algorithm::Prism { interpolation: [2, 2] });
        simulator.settings.grid = GridChoice::Sampling(0.05);
        simulator.settings.slicing = Slicing::Thickness(1.0);
        simulator.settings.oversampling = Some(1);
        simulator.settings.band_fraction = EXACT_BAND_FRACTION;
        simulator.settings.beyond_limit = BeyondLimit::Warn;
        simulator
    }

    /// The mean image on each detector, in the detectors' order, over some phonon configurations. `atoms` returns the displaced atoms of a
    /// configuration. Elements and mean heights are equal in all configurations.
    ///
    /// # Errors
    /// Errors of [`Plan::new`] and [`simulate`]; [`Error::Interrupted`] when asked to stop.
    pub fn means(
        &self,
        pixels: &PixelBox,
        configurations: usize,
        atoms: impl Fn(usize) -> DisplacedAtoms,
        progress: &dyn Progress,
    ) -> Result<Vec<Array2<f64>>> {
        let settings = Settings { phonons: None, ..self.settings.clone() };
        let first = atoms(0);
        let plan = Plan::new(&settings, pixels.size_angstrom, &first.heights)?;
        let mut simulation = Simulation::new(&plan, &elements(&first.sites))?;
        let mut first = Some(first.sites);
        let mut sums = vec![Array2::<f64>::zeros(pixels.scan.shape); self.detectors()];
        for configuration in 0..configurations {
            let share = ProgressShare::new(progress, pixels.scan.len());
            let sites = first.take().unwrap_or_else(|| atoms(configuration).sites);
            let images = simulation.images(&sites, &pixels.scan, &share)?;
            for (detector, sum) in sums.iter_mut().enumerate() {
                sum.zip_mut_with(&images.image(0, detector), |s, v| *s += f64::from(*v));
            }
            share.complete();
        }
        let mean = |sum: Array2<f64>| sum.mapv(|s| s / configurations as f64);
        Ok(sums.into_iter().map(mean).collect())
    }

    /// Number of detectors.
    pub(crate) fn detectors(&self) -> usize {
        self.settings.detectors.len()
    }

    /// Sets large probe boxes, which act as an infinite specimen (see [`ProbeBox`]).
    #[must_use]
    pub fn with_large_probe_box(&self) -> Self {
        let probe_box = Some(ProbeBox::Large);
        Simulator { settings: Settings { probe_box, ..self.settings.clone() } }
    }

    /// The exact engine with otherwise equal settings: multislice on the full grid, with probes as in an infinite specimen.
    #[must_use]
    pub(crate) fn exact(&self) -> Self {
        let settings = Settings { algorithm: Algorithm::Multislice, ..self.settings.clone() };
        Simulator { settings }.with_large_probe_box()
    }

    /// Whether this engine is as [`Simulator::exact`] makes it.
    pub(crate) fn is_exact(&self) -> bool {
        self.settings.algorithm == Algorithm::Multislice && self.settings.large_probe_box()
    }

    /// Replaces the slices.
    #[must_use]
    pub(crate) fn with_slices(&self, slicing: Slicing) -> Self {
        Simulator { settings: Settings { slicing, ..self.settings.clone() } }
    }

    /// Replaces the number of phonon configurations.
    #[must_use]
    pub(crate) fn with_configurations(&self, configurations: usize) -> Self {
        let of = |phonons: Phonons| Phonons { configurations: configurations as u32, ..phonons };
        Simulator {
            settings: Settings { phonons: self.settings.phonons.map(of), ..self.settings.clone() },
        }
    }

    /// Moves the focus deeper, by this distance in Angstrom.
    #[must_use]
    pub fn with_focus_deeper(&self, angstrom: f64) -> Self {
        let mut settings = self.settings.clone();
        if angstrom != 0.0 {
            settings.optics.aberrations.add_defocus(angstrom);
        }
        Simulator { settings }
    }

    /// Replaces the width of the windows.
    #[must_use]
    pub(crate) fn with_window(&self, width_angstrom: f64) -> Self {
        let algorithm = Algorithm::Window { width_angstrom };
        Simulator { settings: Settings { algorithm, ..self.settings.clone() } }
    }

    /// Replaces the expansion of the windows' probes.
    #[must_use]
    pub fn with_expansion(&self, expansion: Expansion) -> Self {
        Simulator { settings: Settings { expansion, ..self.settings.clone() } }
    }

    /// Replaces the distance of probes.
    #[must_use]
    pub(crate) fn with_probe_step(&self, probe_step: ProbeStep) -> Self {
        Simulator { settings: Settings { probe_step, ..self.settings.clone() } }
    }

    /// Settings of the engine.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// The plan for a sub-tile of `scanned_angstrom` (x, y) in a specimen of the given thickness, whose atoms have mean heights `z`
    /// (Angstrom). It shows grids and memory.
    ///
    /// # Errors
    /// Errors of [`Plan::new`].
    pub fn plan(
        &self,
        scanned_angstrom: [f64; 2],
        thickness_angstrom: f64,
        z: &[f64],
    ) -> Result<Plan> {
        let side = scanned_angstrom.map(|l| l + 2.0 * self.margin_angstrom());
        Plan::new(&self.settings, [side[0], side[1], thickness_angstrom], z)
    }

    /// The probes that are propagated for a sub-tile of this plan, with this number of pixels (rows, columns).
    ///
    /// # Errors
    /// Errors of [`ProbeRaster::new`].
    pub(crate) fn probes(
        &self,
        plan: &Plan,
        shape: [usize; 2],
        pixel_angstrom: f64,
    ) -> Result<ProbeRaster> {
        let origin_angstrom = [self.margin_angstrom() + 0.5 * pixel_angstrom; 2];
        ProbeRaster::new(plan, &Scan { origin_angstrom, step_angstrom: [pixel_angstrom; 2], shape })
    }

    /// Name of the algorithm.
    pub fn name(&self) -> &'static str {
        match self.settings.algorithm {
            Algorithm::Multislice => "multislice",
            Algorithm::Prism { .. } => "prism",
            Algorithm::Window { .. } => "window",
        }
    }

    /// Settings that decide the image.
    pub(crate) fn parameters(&self) -> serde_json::Value {
        serde_json::to_value(&self.settings).unwrap_or_default()
    }

    /// Width of the windows in Angstrom, if the algorithm has windows.
    pub fn window_angstrom(&self) -> Option<f64> {
        match self.settings.algorithm {
            Algorithm::Window { width_angstrom } => Some(width_angstrom),
            _ => None,
        }
    }

    /// Width in Angstrom of the specimen that is needed beyond the scanned area on each side.
    pub fn margin_angstrom(&self) -> f64 {
        let half_window = self.window_angstrom().map_or(SPREAD_ANGSTROM, |width| width / 2.0);
        half_window + POTENTIAL_REACH_ANGSTROM + probe_margin_angstrom(&self.settings)
    }

    /// Refuses settings that need more specimen around the field than there is.
    ///
    /// # Errors
    /// [`Error::Invalid`].
    pub(crate) fn check_margin(&self) -> Result<()> {
        let margin = self.margin_angstrom();
        if (0.0..=lengths::angstrom(BEYOND_FIELD_NM - DISPLACED_NM)).contains(&margin) {
            return Ok(());
        }
        let expected = format!(
            "expected a smaller margin: the specimen extends {} A beyond the field",
            lengths::angstrom(BEYOND_FIELD_NM)
        );
        Err(Error::invalid(crate::Setting::EngineMarginAngstrom, margin, expected))
    }

    /// The image of some atoms, given by their mean positions, on each detector, [row, column] = [y, x], as fraction of the beam: the mean
    /// over the phonon configurations of the settings. The box holds the specimen from the entrance surface z = 0 to its exit surface.
    ///
    /// # Errors
    /// Errors of [`Plan::new`] and [`simulate`]; [`Error::Interrupted`] when asked to stop.
    pub(crate) fn images(
        &self,
        sites: &[Site],
        pixels: &PixelBox,
        progress: &dyn Progress,
    ) -> Result<Vec<Array2<f32>>> {
        let heights: Vec<f64> = sites.iter().map(|s| s.position[2]).collect();
        let plan = Plan::new(&self.settings, pixels.size_angstrom, &heights)?;
        let images = simulate(&plan, sites, &pixels.scan, progress)?;
        let at_exit = images.data.index_axis_move(Axis(0), 0);
        Ok(at_exit.outer_iter().map(|image| image.to_owned()).collect())
    }
}
