//! The names of all settings that the library checks, and values outside their limits.

/// Declares [`Setting`] from lines `Variant = "name with unit"`.
macro_rules! settings {
    ($($(#[doc = $doc:literal])* $variant:ident = $name:literal,)*) => {
        /// A setting, or another value that the library checks, as [`Error`](crate::Error) names it.
        ///
        /// Not `#[non_exhaustive]`, on purpose: a front end finds with one exhaustive `match` which of its own
        /// options mends a setting, so that the compiler finds a setting that it forgets.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
        pub enum Setting {
            $($(#[doc = $doc])* $variant,)*
        }

        impl Setting {
            /// All settings.
            pub const ALL: &[Setting] = &[$(Setting::$variant,)*];

            /// The name for a reader, with the unit.
            pub fn name(self) -> &'static str {
                match self {
                    $(Setting::$variant => $name,)*
                }
            }
        }
    };
}

/// A value of a table outside its limits.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Fault {
    /// Its key, with dots.
    pub key: String,
    /// The value.
    pub value: String,
    /// What is allowed, and what to do.
    pub expected: String,
}

impl Fault {
    /// The same, of a table that is part of another one.
    #[must_use]
    pub(crate) fn in_table(self, table: &str) -> Self {
        Fault { key: format!("{table}.{}", self.key), ..self }
    }
}

/// Checks a value against the least and the greatest that are allowed; NaN is never allowed.
pub(crate) fn check_range(
    key: impl Into<String>,
    value: f64,
    [low, high]: [f64; 2],
) -> Result<(), Fault> {
    if (low..=high).contains(&value) {
        return Ok(());
    }
    let expected = format!("expected {low} to {high}");
    Err(Fault { key: key.into(), value: value.to_string(), expected })
}

settings! {
    // The microscope
    /// Energy of the beam.
    EnergyKev = "energy (keV)",
    /// Semiangle of the probe-forming aperture.
    SemiangleMrad = "semiangle (mrad)",
    /// A coefficient of the aberration function.
    Aberration = "aberration",
    /// The defocus, or one of a series.
    Defocus = "defocus (A)",
    /// The mistilt of the specimen.
    MistiltMrad = "mistilt (mrad)",
    /// The standard deviation of the focus.
    FocalSpreadAngstrom = "focal spread (A)",
    /// The share of the source's long tails.
    SourceLorentzShare = "Lorentz share of the source",
    /// The width of the electron source.
    SourceSizeAngstrom = "source size (A)",
    /// A detector: its angles or its place.
    Detector = "detector",
    /// The name of a detector, which no other may have.
    DetectorName = "detector name",
    /// The number of pixels along an edge of a diffraction pattern.
    PatternPixels = "pixels of a pattern",
    /// The largest angle along the axes of a diffraction pattern.
    MaxAngleMrad = "largest angle of a pattern (mrad)",
    /// The width of the rings over which diffraction patterns are summed.
    RingWidthMrad = "width of the rings (mrad)",
    /// The modulation transfer function of a pixelated detector.
    DetectorMtf = "transfer function of the detector",
    /// The list of detectors.
    Detectors = "detectors",
    // The specimen of a simulation
    /// A file with a structure.
    StructureFile = "structure file",
    /// A crystal: its name, or what a model asks of it.
    Crystal = "crystal",
    /// The cell of a structure.
    Cell = "cell",
    /// The zone axis.
    Zone = "zone",
    /// The lattice direction along +y.
    Up = "up",
    /// The strain that may make a cell orthogonal.
    MaxStrain = "largest strain (%)",
    /// Frames of a trajectory.
    Frames = "frames",
    /// How often a cell is repeated.
    Repeat = "repeat",
    /// The number of atoms that a repeated or turned cell would have.
    SupercellAtoms = "number of atoms in the supercell",
    /// The occupancy of one atom.
    Occupancy = "occupancy",
    /// The sum of the occupancies of one site.
    SiteOccupancy = "sum of occupancies on one site",
    /// The standard deviation of thermal displacements.
    ThermalSigma = "sigma (A)",
    /// Mean square displacements of single atoms.
    Displacements = "displacements (A^2)",
    /// Temperature of the specimen.
    Temperature = "temperature (K)",
    /// The diameter of a cluster.
    ClusterDiameterNm = "diameter_nm",
    // The numerics of a simulation
    /// The algorithm of the simulation.
    Algorithm = "algorithm",
    /// The edges of the simulated box.
    CellAngstrom = "cell (A)",
    /// The edge of the simulated box along the beam.
    CellHeightAngstrom = "cell height (A)",
    /// The number of grid points along x and y.
    Gpts = "gpts",
    /// The distance of grid points.
    SamplingAngstrom = "sampling (A)",
    /// The thickness of a slice.
    SliceThicknessAngstrom = "slice thickness (A)",
    /// The heights that atoms of one slice may span.
    SliceSpanAngstrom = "span of slices (A)",
    /// A thickness at which images are recorded.
    ThicknessAngstrom = "thickness (A)",
    /// How far beyond the largest detector angle the grid carries scattering.
    AngleMargin = "angle margin",
    /// The part of the reciprocal grid that is kept.
    BandFraction = "band fraction",
    /// The width of the band limit's soft edge.
    BandTaper = "band taper",
    /// The error of waves that are expanded in a basis.
    ExpansionPercent = "expansion (%)",
    /// How much finer the potential's grid is.
    Oversampling = "oversampling",
    /// The number of frozen-phonon configurations.
    PhononConfigurations = "phonon configurations",
    /// The box in which the probe has norm 1.
    ProbeBox = "probe box",
    /// PRISM's interpolation factors.
    Interpolation = "interpolation",
    /// The width of the window around each probe.
    WindowAngstrom = "window (A)",
    /// The accuracy that a window is chosen for.
    AccuracyPercent = "accuracy (%)",
    /// A diffraction pattern.
    Pattern = "pattern",
    /// Where probes stand.
    Scan = "scan",
    /// Whether a plane wave is imaged in place of probes.
    PlaneWave = "plane wave",
    /// The distance of samples that are interpolated.
    SampleStepAngstrom = "step between samples (A)",
    // Worlds
    /// The name of a recipe that comes with the program.
    Material = "material",
    /// The difficulty of a recipe.
    Difficulty = "difficulty",
    /// A key of a recipe, or a recipe as a whole.
    Recipe = "recipe",
    /// The tiles of a world, rows x columns.
    Grid = "grid",
    /// The alloy of a recipe.
    Alloy = "alloy",
    /// The fraction of sites that the alloy substitutes.
    AlloyRate = "alloy.rate",
    /// The other end member of an alloy.
    AlloyEndMember = "alloy.end_member",
    /// The number of grain boundaries.
    BoundaryCount = "boundaries.count",
    /// The coincidence number of grain boundaries.
    BoundarySigma = "boundaries.sigma",
    /// The domains of a recipe.
    Domains = "domains",
    /// The crystal of the domains.
    DomainCrystal = "domains.crystal",
    /// The particles of a recipe.
    Particles = "particles",
    /// The number of particles.
    ParticleCount = "particles.count",
    /// The diameters of particles.
    ParticleDiameterNm = "particles.diameter_nm",
    /// The fraction of sites that are vacant.
    VacancyRate = "vacancies.rate",
    /// The number of sites in a crystal's cell.
    CrystalSites = "sites of the crystal",
    /// The number of sites in one column of a crystal's cell.
    ColumnSites = "sites of a column",
    /// The width of a sub-tile, and how far sub-tiles overlap.
    SubtileNm = "sub-tile (nm)",
    /// Which of several processes this is.
    Shard = "shard",
    /// The set of engine settings of a build.
    BuildProfile = "profile",
    /// A rectangle of pixels of a field.
    TilePixels = "tile (px)",
    /// Electrons per square Angstrom.
    Dose = "dose",
    /// The current of the beam.
    BeamCurrentPa = "beam current (pA)",
    /// How an image is recorded.
    Acquisition = "acquisition",
    /// The part of a field that is recorded.
    RecordedRegionNm = "recorded region (nm)",
    /// The edge of a recorded pixel.
    RecordedPixelNm = "recorded pixel (nm)",
    /// How far around an image an engine needs the atoms.
    EngineMarginAngstrom = "engine margin (A)",
    /// The shape of an image that an engine returned.
    EngineImageShape = "shape of image",
    /// A pixel of an image that an engine returned.
    Intensity = "intensity",
    /// The library of column images.
    Library = "library",
    /// The error up to which a world is accepted.
    LargestErrorPercent = "largest error (%)",
    /// The width of a region that is simulated again.
    AuditedRegionNm = "audited region (nm)",
    /// The centre of a region that is simulated again.
    AuditCentreNm = "centre of audit (nm)",
    /// The vacuum above and below an exported specimen.
    VacuumAngstrom = "vacuum (A)",
    // Files
    /// The file that will be written.
    Output = "output",
    /// The name of the file that will be written: its ending.
    OutputName = "name of the output",
    /// A file with a world.
    WorldFile = "world file",
    /// A score of an agent.
    Score = "score",
    /// The rules of an episode of the benchmark, or an action in it.
    Episode = "episode",
    /// What an agent declares.
    Findings = "findings",
    /// The list of released worlds.
    Manifest = "manifest",
    /// The number of sites in a world file.
    SitesInFile = "sites in file",
    /// A range of a world's sites.
    SiteRange = "range of sites",
    /// A region of a world's image.
    Region = "region",
    /// The noiseless image of a world.
    CleanImage = "noiseless image",
    /// The array in a file of several.
    DataSet = "data set",
    /// The order of an image's axes in its file.
    ImageAxes = "axes",
    /// Which image of a stack.
    ImageIndex = "index",
    /// The unit of an image's values.
    ImageUnits = "units",
    /// The edge of a pixel of a recorded image.
    ReplayPixelNm = "pixel of the recorded image (nm)",
    /// A spacing of the specimen that calibrates a recorded image.
    ReplaySpacingNm = "known spacing (nm)",
    /// A recorded image that becomes a world.
    ReplayImage = "recorded image",
    // Pictures and reports
    /// What is drawn over a picture.
    Overlay = "overlay",
    /// The colours of a picture.
    Colormap = "colormap",
    /// The values drawn as black and white.
    ContrastRange = "contrast range",
    /// The percentiles drawn as black and white.
    ContrastPercentiles = "contrast percentiles",
    /// The size of a picture.
    LongestSidePixels = "longest side (pixels)",
    /// The pixel of an image that is drawn.
    PixelAngstrom = "pixel (A)",
    /// The images of a page.
    Images = "images",
    /// The shape of an image that is drawn.
    ImageShape = "image shape",
    /// A pixel of an image.
    ImageValue = "image value",
    /// Where a marker is drawn.
    MarkerPosition = "marker position",
    /// A page of images.
    Page = "page",
    /// A figure of a report.
    Figure = "figure",
    /// What a publisher says of a folder of worlds.
    Card = "data card",
    // Live worlds
    /// The greatest dose that a live world is made for.
    MostDose = "greatest dose (electrons per square Angstrom)",
    /// How often a place is recorded.
    Recordings = "recordings",
    /// A stored moment of a live world.
    Snapshot = "snapshot",
    // Validation
    /// A case of the validation.
    Case = "case",
    /// A stored reference of the validation.
    Reference = "reference",
    /// A scattering factor of a published table.
    ScatteringFactor = "scattering factor",
    /// The probability of a false alarm in a comparison.
    Alpha = "alpha",
    /// The pixels of two worlds that are compared.
    PixelSizeNm = "pixel size (nm)",
    // Detectability
    /// The kind and the depth of a defect.
    Defect = "defect",
    /// The column that holds a defect.
    DefectSite = "site of the defect",
    /// Thicknesses at which a defect is looked for.
    DefectThicknessNm = "thickness (nm)",
    /// The share of columns without a defect that a test reports.
    FalseAlarms = "false alarms",
    /// The share of the defects that a test finds.
    Power = "power",
    /// The share of columns that hold the defect.
    DefectRate = "rate of the defect",
    /// The radius of the patch around a column whose pixels a test reads.
    PatchRadiusAngstrom = "radius of the patch (A)",
    /// The number of phonon configurations that a world averages.
    AveragedConfigurations = "averaged configurations",
    /// The number of simulated experiments that judge a test.
    Experiments = "simulated experiments",
}

impl std::fmt::Display for Setting {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::Setting;

    #[test]
    fn no_two_settings_have_one_name() {
        let mut names: Vec<&str> = Setting::ALL.iter().map(|s| s.name()).collect();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), Setting::ALL.len());
    }
}
