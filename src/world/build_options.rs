//! How a world is built: the options, and the rules for options that are not given.

use crate::engine::{Algorithm, Expansion, window_for};
use crate::error::{Error, Result};
use crate::imaging::simulator::{WINDOW_ANGSTROM, default_window};
use crate::imaging::{AuditOptions, Cache, ImagingCheck, ImagingChoice, MethodChoice, Simulator};
use crate::recipe::{CheckedRecipe, DetectorTables, Recipe, StructureKind};
use crate::setting::Setting;

/// Width of sub-tiles in nm; 4 nm take below 2 GB of memory on two threads.
const SUBTILE_NM: f64 = 4.0;
/// Width of sub-tiles of PRISM in nm; the plane waves of larger ones would take too much memory.
const PRISM_SUBTILE_NM: f64 = 2.5;
/// Width of sub-tiles of the published worlds in nm.
const PUBLISHED_SUBTILE_NM: f64 = 7.0;
/// Width of sub-tiles of mosaics in nm, and their overlap.
const MOSAIC_SUBTILE_NM: f64 = 8.0;
const MOSAIC_OVERLAP_NM: f64 = 0.5;
/// Largest overlap of other sub-tiles in nm.
const OVERLAP_NM: f64 = 1.0;
/// Edge of audited regions in nm. With a largest error the audit takes at least [`LEAST_REGIONS`] regions of [`LIMITED_AUDIT_NM`].
const AUDIT_NM: f64 = 0.8;
const LIMITED_AUDIT_NM: f64 = 0.6;
const LEAST_REGIONS: usize = 4;
/// Largest number of configurations that audits of particles average. Slices are thin there, and multislice of sixteen configurations would
/// take a quarter of the time of the world. The mean of more configurations is nearer to the exact image.
const PARTICLE_AUDIT_CONFIGURATIONS: usize = 4;
/// Least error in per cent for which [`window_for`] has a window.
const LEAST_OF_TABLE: f64 = 0.4;
/// Width of windows in Angstrom where one of several detectors lies within the aperture. In a mosaic of hard SrTiO3 (10 nm, vacancies and a
/// boundary, 8 phonon configurations, two regions) the error of ABF 10-21 mrad is 0.19 % at columns and 0.53 % over all pixels; windows of
/// 7.8 A give 0.71 and 0.89 %.
const BRIGHT_FIELD_WINDOW_ANGSTROM: f64 = 15.6;
/// Interpolation of PRISM if none is given: windows of 10 A in sub-tiles of 2.5 nm.
const INTERPOLATION: [usize; 2] = [4, 4];

/// How the images of a world are made.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum BuildMethod {
    /// A mosaic, or windows where a field is too small for a mosaic to pay; films with particles by their parts; PRISM for detectors at low
    /// angles.
    #[default]
    Auto,
    /// A mosaic, even where it does not pay.
    Mosaic,
    /// Windows that follow the probe.
    Window,
    /// PRISM.
    Prism,
    /// Multislice on the full grid.
    Multislice,
}

/// Sets of engine settings.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum BuildProfile {
    /// Grids that carry all scattering to the detector.
    #[default]
    Default,
    /// The coarser settings of the published STEMGym worlds: PRISM, 0.05 A, slices of 1 A.
    Published,
}

/// How a world is built. The defaults write the file that `stemgen build` writes.
#[derive(Debug, Clone, PartialEq)]
pub struct BuildOptions {
    /// Add Poisson noise.
    pub noise: bool,
    /// Also store the noise-free tiles.
    pub keep_clean: bool,
    /// Replace an existing file.
    pub overwrite: bool,
    /// How images are made.
    pub method: BuildMethod,
    /// Settings of the engine.
    pub profile: BuildProfile,
    /// Width in Angstrom of the windows that follow the probe; `None` chooses it from the recipe.
    pub window_angstrom: Option<f64>,
    /// Largest rms error of the image in per cent of its mean: wider windows are taken, then no mosaic, until an audit finds the error.
    pub accuracy_percent: Option<f64>,
    /// Whether probes that share a window are expanded in fewer waves.
    pub expansion: Expansion,
    /// Interpolation of PRISM along x and y.
    pub interpolation: Option<[usize; 2]>,
    /// Number of regions that are simulated exactly beforehand to find the error of a mosaic or film; 0 makes no audit. With a largest
    /// error at least four regions are used.
    pub audit_regions: usize,
    /// Also audits fields that are simulated in windows or by PRISM, not only mosaics and films.
    pub audit_direct: bool,
    /// Largest error of the audit in per cent: wider windows are taken, then no mosaic, until the error is met. Where no window meets it,
    /// the exact engine makes the field.
    pub max_error_percent: Option<f64>,
    /// Where the simulations of mosaics are cached for other worlds.
    pub cache: Cache,
    /// Largest width of a sub-tile in nm; `None` chooses it by the method.
    pub subtile_nm: Option<f64>,
    /// Overlap of sub-tiles in nm; `None` chooses it by the method.
    pub subtile_overlap_nm: Option<f64>,
}

impl Default for BuildOptions {
    fn default() -> Self {
        BuildOptions {
            noise: true,
            keep_clean: false,
            overwrite: false,
            method: BuildMethod::Auto,
            profile: BuildProfile::Default,
            window_angstrom: None,
            accuracy_percent: None,
            expansion: Expansion::Auto,
            interpolation: None,
            audit_regions: 1,
            audit_direct: false,
            max_error_percent: None,
            cache: Cache::of_user(),
            subtile_nm: None,
            subtile_overlap_nm: None,
        }
    }
}

/// The method, the check and the sub-tiles that follow from the options for one recipe.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct BuildPolicy {
    /// How images are made.
    pub imaging: ImagingChoice,
    /// The audit, and the error that it may find at most.
    pub check: ImagingCheck,
    /// Largest width and overlap of sub-tiles in nm.
    pub subtile_nm: [f64; 2],
    /// Warnings about the accuracy.
    pub warnings: Vec<String>,
}

impl BuildOptions {
    /// Derives the policy of a build from the options and a recipe.
    ///
    /// # Errors
    /// [`Error::Invalid`] for options that contradict each other, and errors of [`window_for`].
    pub fn policy(&self, recipe: &CheckedRecipe) -> Result<BuildPolicy> {
        self.check_combination()?;
        let (simulator, warning) = self.simulator(recipe)?;
        let method = self.method_choice(&simulator);
        let subtile_nm = self.subtiles(&simulator, method);
        let check = self.imaging_check(recipe)?;
        let imaging = ImagingChoice { simulator, method, cache: self.cache.clone() };
        Ok(BuildPolicy { imaging, check, subtile_nm, warnings: warning.into_iter().collect() })
    }

    fn published(&self) -> bool {
        self.profile == BuildProfile::Published
    }

    fn check_combination(&self) -> Result<()> {
        use BuildMethod::{Auto, Mosaic, Prism, Window};
        let refuse = |what: Setting, value: String, expected: &str| {
            Err(Error::invalid(what, value, expected))
        };
        let windows = matches!(self.method, Auto | Mosaic | Window);
        let chosen = self.window_angstrom.is_some() || self.accuracy_percent.is_some();
        let numerics = chosen || self.interpolation.is_some() || self.max_error_percent.is_some();
        if self.published() && (numerics || self.method != Auto) {
            let expected = "the published profile sets the numerics; leave out all other settings";
            return refuse(Setting::BuildProfile, "published".into(), expected);
        }
        if chosen && self.interpolation.is_some() {
            let expected = "windows and PRISM are different methods; choose one";
            return refuse(Setting::Interpolation, format!("{:?}", self.interpolation), expected);
        }
        if let Some(width) = self.window_angstrom.filter(|_| !windows) {
            let expected = "belongs to windows and mosaics, not to the method that was chosen";
            return refuse(Setting::WindowAngstrom, width.to_string(), expected);
        }
        if let Some(percent) = self.accuracy_percent.filter(|_| !windows) {
            let expected = "chooses a window, but the chosen method has no windows";
            return refuse(Setting::AccuracyPercent, percent.to_string(), expected);
        }
        if self.interpolation.is_some() && !matches!(self.method, Auto | Prism) {
            let expected = "belongs to PRISM, not to the method that was chosen";
            return refuse(Setting::Interpolation, format!("{:?}", self.interpolation), expected);
        }
        Ok(())
    }

    /// Returns the engine, and a warning about its accuracy.
    fn simulator(&self, recipe: &CheckedRecipe) -> Result<(Simulator, Option<String>)> {
        if self.published() {
            return Ok((Simulator::published(recipe), None));
        }
        let (algorithm, warning) = self.algorithm(recipe)?;
        Ok((Simulator::new(recipe, algorithm).with_expansion(self.expansion), warning))
    }

    fn algorithm(&self, recipe: &CheckedRecipe) -> Result<(Algorithm, Option<String>)> {
        let window =
            Algorithm::Window { width_angstrom: self.window_angstrom.unwrap_or(WINDOW_ANGSTROM) };
        let prism = Algorithm::Prism { interpolation: self.interpolation.unwrap_or(INTERPOLATION) };
        if let Some(percent) = self.accuracy_percent {
            let simulator = Simulator::new(recipe, window);
            let thickness_angstrom = recipe.field.thickness_angstrom();
            // The table ends at its least error; for smaller errors the audit finds whether the window is wide enough.
            let table = if percent > 0.0 { percent.max(LEAST_OF_TABLE) } else { percent };
            let choice = window_for(table, simulator.settings(), thickness_angstrom)?;
            let algorithm = Algorithm::Window { width_angstrom: choice.width_angstrom };
            return Ok((algorithm, choice.warning(percent)));
        }
        Ok(match self.method {
            BuildMethod::Auto if self.interpolation.is_some() => (prism, None),
            BuildMethod::Auto if self.window_angstrom.is_none() => by_rule(recipe),
            BuildMethod::Mosaic | BuildMethod::Window if self.window_angstrom.is_none() => {
                bright_field_window(recipe).unwrap_or((window, None))
            }
            BuildMethod::Auto | BuildMethod::Mosaic | BuildMethod::Window => (window, None),
            BuildMethod::Prism => (prism, None),
            BuildMethod::Multislice => (Algorithm::Multislice, None),
        })
    }

    /// Returns the method that the build tries before it simulates the whole field.
    fn method_choice(&self, simulator: &Simulator) -> MethodChoice {
        match self.method {
            BuildMethod::Mosaic => MethodChoice::Mosaic,
            BuildMethod::Auto if simulator.window_angstrom().is_some() && !self.published() => {
                MethodChoice::Auto
            }
            _ => MethodChoice::Direct,
        }
    }

    /// Returns width and overlap of sub-tiles in nm.
    fn subtiles(&self, simulator: &Simulator, method: MethodChoice) -> [f64; 2] {
        let shares = method != MethodChoice::Direct;
        let width = match simulator.settings().algorithm {
            _ if self.published() => PUBLISHED_SUBTILE_NM,
            _ if shares => MOSAIC_SUBTILE_NM,
            Algorithm::Prism { .. } => PRISM_SUBTILE_NM,
            _ => SUBTILE_NM,
        };
        let width = self.subtile_nm.unwrap_or(width);
        let most = if shares { MOSAIC_OVERLAP_NM } else { OVERLAP_NM };
        [width, self.subtile_overlap_nm.unwrap_or((0.25 * width).clamp(0.0, most))]
    }

    /// Returns how an imager is checked before the world is made with it.
    fn imaging_check(&self, recipe: &CheckedRecipe) -> Result<ImagingCheck> {
        let limit = self.max_error_percent.map(|limit| (Setting::LargestErrorPercent, limit));
        let limit = limit.or(self.accuracy_percent.map(|p| (Setting::AccuracyPercent, p)));
        if let Some((setting, limit)) = limit
            && self.audit_regions == 0
        {
            let expected = "needs an audit of at least one region";
            return Err(Error::invalid(setting, limit, expected));
        }
        let thin = recipe.structure == StructureKind::Particles;
        let (regions, size_nm) = match limit {
            Some(_) => (self.audit_regions.max(LEAST_REGIONS), LIMITED_AUDIT_NM),
            None => (self.audit_regions, AUDIT_NM),
        };
        let audit = AuditOptions {
            regions,
            size_nm,
            configurations: thin.then_some(PARTICLE_AUDIT_CONFIGURATIONS),
            ..AuditOptions::default()
        };
        let audit = (self.audit_regions > 0).then_some(audit);
        let direct = self.audit_direct && self.method != BuildMethod::Multislice;
        let (max_error_percent, accuracy_percent) = (self.max_error_percent, self.accuracy_percent);
        Ok(ImagingCheck { audit, direct, max_error_percent, accuracy_percent })
    }
}

/// Removes the detectors within the aperture, and centres of mass, from a recipe of several detectors; also returns their names. `None` if no
/// detector or every detector is removed.
fn without_bright_field(recipe: &Recipe) -> Option<(Recipe, Vec<String>)> {
    let DetectorTables::Several(tables) = &recipe.detector else { return None };
    let semiangle = recipe.optics.convergence_mrad;
    let (bright, others): (Vec<_>, Vec<_>) =
        tables.iter().cloned().partition(|d| d.outer_mrad <= semiangle || d.centre_of_mass);
    let found = !bright.is_empty() && !others.is_empty();
    found.then(|| {
        let names = bright.into_iter().map(|d| d.name).collect();
        (Recipe { detector: DetectorTables::Several(others), ..recipe.clone() }, names)
    })
}

/// Chooses windows for recipes of several detectors of which one lies within the aperture; also returns a warning about their accuracy.
fn bright_field_window(recipe: &CheckedRecipe) -> Option<(Algorithm, Option<String>)> {
    let (others, bright) = without_bright_field(recipe)?;
    let width = default_window(&others).ok()?.width_angstrom;
    let width_angstrom = width.max(BRIGHT_FIELD_WINDOW_ANGSTROM);
    let warning = format!(
        "{} sees the direct beam, which needs windows of {width_angstrom:.1} A and about four times the time; a mosaic of them has errors \
         of 0.2 % at columns and 0.5 % over all pixels (hard SrTiO3, ABF 10-21 mrad)",
        bright.join(", ")
    );
    Some((Algorithm::Window { width_angstrom }, Some(warning)))
}

/// Chooses the algorithm where none is given: windows as wide as the specimen is thick; PRISM for detectors at low angles, which windows
/// and mosaics cannot simulate. Also returns a warning about its accuracy.
fn by_rule(recipe: &CheckedRecipe) -> (Algorithm, Option<String>) {
    if let Some(choice) = bright_field_window(recipe) {
        return choice;
    }
    match default_window(recipe) {
        Ok(choice) => {
            let width_angstrom = choice.width_angstrom;
            let warning = (!choice.beyond_measured.is_empty()).then(|| {
                format!(
                    "windows of {width_angstrom:.1} A: their error was not measured for {}; the audit measures it",
                    choice.beyond_measured.join(", ")
                )
            });
            (Algorithm::Window { width_angstrom }, warning)
        }
        Err(why) => {
            let algorithm = Algorithm::Prism { interpolation: INTERPOLATION };
            (algorithm, Some(format!("neither mosaic nor windows: {why}; PRISM is used")))
        }
    }
}
