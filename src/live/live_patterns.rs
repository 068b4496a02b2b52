//! Diffraction patterns of a place of a live world (4D-STEM).
//!
//! The atoms about the place, as they are now, become a specimen of their own, and their patterns are simulated in windows. Patterns have
//! ideal scans: neither scan errors nor the errors of a detector of currents are added. Thermal displacements are drawn anew for every
//! place, so a pattern is not of the configurations that the images of the world show.

use std::collections::BTreeMap;

use super::live_world::{LiveRequest, LiveWorld};
use crate::acquisition::{Acquisition, Exposure, Profile, ScanFrame, ScanPath};
use crate::error::{Error, Result};
use crate::imaging::displaced_atoms::mean_atoms;
use crate::lengths;
use crate::plane;
use crate::progress::Progress;
use crate::recipe::Region;
use crate::setting::Setting;
use crate::simulation::{
    AtomsSource, LengthUnit, MicroscopeRequest, PatternBand, PatternsRequest, ScanRequest,
    SigmaChoice, SimulationJob, SimulationRequest, pattern_window_angstrom,
};
use crate::structure::{Atom, Structure, elements};
use crate::world::{RecordedPart, RecordingOptions, scan_of};

/// Empty space in Angstrom between the outermost atoms and their periodic images.
const GAP_ANGSTROM: f64 = 2.0;
/// Atoms are kept to this distance in Angstrom outside the windows of the outermost probes: the reach of an atom's potential.
const POTENTIAL_REACH_ANGSTROM: f64 = 2.0;

/// Patterns of a place that are ready to be simulated.
pub struct PlacePatterns {
    job: SimulationJob,
    part: RecordedPart,
    path: ScanPath,
    exposure: Exposure,
    /// Place (x, y) of the first probe in nm from the centre of the first built pixel.
    origin_nm: [f64; 2],
}

impl PlacePatterns {
    /// The simulation, with the atoms about the place. Its box has an origin of its own.
    pub fn job(&self) -> &SimulationJob {
        &self.job
    }

    /// Place (x, y) of the first probe in nm from the centre of the first built pixel of the field.
    pub fn origin_nm(&self) -> [f64; 2] {
        self.origin_nm
    }
}

impl LiveWorld {
    /// Prepares the patterns of a place of the specimen as it is now. Of the request's scan only the dwell time is used.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a part outside the field, for a dose above the world's largest, and for a specimen with carbon on its faces,
    /// which patterns would leave out; errors of [`SimulationJob::new`].
    pub fn patterns_at(
        &self,
        request: &LiveRequest,
        patterns: &PatternsRequest,
    ) -> Result<PlacePatterns> {
        self.check_faces()?;
        let dwell_us = request.acquisition.dwell_us;
        let options = RecordingOptions {
            acquisition: Acquisition { dwell_us, ..Profile::Ideal.acquisition() },
            electrons: request.electrons,
            seed: self.recording_seed(),
            keep_frames: false,
            keep_stages: false,
        };
        let (path, exposure) = scan_of(self.recipe(), &request.part, &options)?;
        self.check_inside(path.frame())?;
        self.check_scan(&request.part, &path, &exposure)?;
        let job = SimulationJob::new(self.pattern_request(path.frame(), &exposure, patterns))?;
        let (first, field) = (path.frame().origin_nm, self.recipe().field.origin_nm());
        let origin_nm = [first[0] - field[0], first[1] - field[1]];
        Ok(PlacePatterns { job, part: request.part, path, exposure, origin_nm })
    }

    /// Simulates the patterns of a place and passes them to `take` by rows. At the end, the electrons change the specimen.
    ///
    /// # Errors
    /// [`Error::Memory`], errors of [`SimulationJob::patterns`] and of `take`. After an error the world is unchanged.
    pub fn acquire_patterns(
        &mut self,
        place: &PlacePatterns,
        take: &mut dyn FnMut(PatternBand<'_>) -> Result<()>,
        progress: &dyn Progress,
    ) -> Result<()> {
        self.check_scan(&place.part, &place.path, &place.exposure)?;
        place.job.check_memory()?;
        place.job.patterns(0, None, take, progress)?;
        self.change_by_scan(&place.part, &place.path, &place.exposure);
        Ok(())
    }

    fn check_faces(&self) -> Result<()> {
        let expected = "patterns leave out carbon on the faces of a specimen: leave the table out, or record an image";
        if self.recipe().surface.is_some() {
            return Err(Error::invalid(Setting::Pattern, "surface", expected));
        }
        match self.has_carbon() {
            true => Err(Error::invalid(Setting::Pattern, "carbon from earlier scans", expected)),
            false => Ok(()),
        }
    }

    /// Refuses a raster with a probe outside the built field.
    fn check_inside(&self, frame: &ScanFrame) -> Result<()> {
        let built = self.recipe().field.built_region();
        let half = 0.5 * self.recipe().field.pixel_nm();
        let probes = probes(frame);
        let inside = |field: [f64; 2], probes: [f64; 2]| {
            probes[0] >= field[0] - half && probes[1] <= field[1] + half
        };
        if inside(built.x, probes.x) && inside(built.y, probes.y) {
            return Ok(());
        }
        let place = |v: [f64; 2]| format!("{:.2} to {:.2} nm", v[0], v[1]);
        let value = format!("probes from x = {}, y = {}", place(probes.x), place(probes.y));
        let expected = format!(
            "expected probes inside the field, x = {}, y = {} (of the full field)",
            place(built.x),
            place(built.y)
        );
        Err(Error::invalid(Setting::RecordedRegionNm, value, expected))
    }

    /// The request for the patterns of a raster over the atoms about it.
    fn pattern_request(
        &self,
        frame: &ScanFrame,
        exposure: &Exposure,
        patterns: &PatternsRequest,
    ) -> SimulationRequest {
        let recipe = self.recipe();
        let thickness_angstrom = lengths::angstrom(self.specimen_thickness_nm());
        let microscope = MicroscopeRequest::of_recipe(recipe);
        let window = pattern_window_angstrom(&microscope, thickness_angstrom);
        let margin_nm = lengths::nm(0.5 * window + POTENTIAL_REACH_ANGSTROM);
        let area = probes(frame).grown(margin_nm);
        let [width, height] = area.size_angstrom().map(|edge| edge + GAP_ANGSTROM);
        let moved = |[x, y, z]: [f64; 3]| [x + 0.5 * GAP_ANGSTROM, y + 0.5 * GAP_ANGSTROM, z];
        let sites = mean_atoms(self.specimen(), &area, &recipe.phonons);
        let atoms: Vec<Atom> =
            sites.iter().map(|site| Atom::new(site.number, moved(site.position))).collect();
        let cell = [[width, 0.0, 0.0], [0.0, height, 0.0], [0.0, 0.0, thickness_angstrom]];
        let mut sigmas = BTreeMap::new();
        for site in &sites {
            sigmas.insert(elements::symbol(site.number).to_owned(), site.sigma_angstrom);
        }
        let mut request = SimulationRequest::new(AtomsSource::Given(Structure { cell, atoms }));
        request.electrons_per_angstrom2 = Some(exposure.dose());
        request.patterns = Some(patterns.clone());
        request.specimen.seed = self.recording_seed();
        if recipe.phonons.configurations > 0 {
            request.specimen.phonons = Some(recipe.phonons.configurations as u32);
            request.specimen.sigma_angstrom = Some(SigmaChoice::ByElement(sigmas));
        }
        request.microscope = microscope;
        let first = [area.x[0], area.y[0]];
        let start =
            lengths::angstrom(plane::sub(frame.origin_nm, first)).map(|at| at + 0.5 * GAP_ANGSTROM);
        let points = [frame.shape[1], frame.shape[0]];
        let end = plane::add(start, points.map(|n| frame.pixel_angstrom() * n as f64));
        request.scan = ScanRequest {
            start: Some(start),
            end: Some(end),
            unit: LengthUnit::Angstrom,
            step_angstrom: None,
            points: Some(points),
        };
        request
    }

    fn specimen_thickness_nm(&self) -> f64 {
        use crate::specimen::Specimen;
        self.specimen().layout().facts().thickness_nm
    }
}

/// The probes of a raster: first and last along x and y.
fn probes(frame: &ScanFrame) -> Region {
    let last = |k: usize| frame.origin_nm[k] + (frame.shape[1 - k] as f64 - 1.0) * frame.pixel_nm;
    Region { x: [frame.origin_nm[0], last(0)], y: [frame.origin_nm[1], last(1)] }
}
