//! The recording of a whole field in one scan, band by band.

use std::ops::Range;
use std::sync::Arc;

use ndarray::{Array2, s};

use super::noise_free::refinement;
use crate::acquisition::{
    Acquisition, Exposure, Recorder, ScanFrame, ScanPath, SourceImage, clipping_warning,
};
use crate::error::{Error, Result};
use crate::lengths;
use crate::recipe::Recipe;
use crate::resample::{Kernel, TAPS, samples_around};
use crate::setting::Setting;

/// The scan of a built field. Its values are the counts converted back to fractions of the beam, as if the detector had no errors.
pub struct FieldScan {
    acquisition: Acquisition,
    recorder: Recorder,
    kernel: Arc<Kernel>,
    /// Edge of a pixel of the noise-free image.
    pixel_nm: f64,
    /// Shape of the noise-free image: [rows, columns].
    shape: [usize; 2],
}

/// Rows of a field: the values that are stored, and whether the beam was inside the field in all frames.
#[derive(Debug, Clone)]
pub struct ScannedRows {
    /// Values as fraction of the beam.
    pub values: Array2<f32>,
    /// False where the beam left the field: the pixel then shows the field's edge.
    pub valid: Array2<bool>,
}

impl FieldScan {
    /// Returns the scan of the field of a recipe; `None` if the recipe has no recording.
    ///
    /// # Errors
    /// [`Error::Invalid`] for fields that are too small.
    pub fn of(recipe: &Recipe) -> Result<Option<Self>> {
        let Some(table) = recipe.acquisition else { return Ok(None) };
        let acquisition = table.resolved();
        if acquisition.contamination_angstrom3_per_electron > 0.0 {
            let rate = acquisition.contamination_angstrom3_per_electron;
            let value = format!("contamination_angstrom3_per_electron = {rate}");
            let expected = "carbon grows in recordings of a part (acquire) and in live worlds only: expected 0 where a whole world is recorded";
            return Err(Error::invalid(Setting::Acquisition, value, expected));
        }
        let field = &recipe.field;
        let (meant, pixel_nm) = (field.pixels(field.built_grid()), field.pixel_nm());
        let parts = refinement(recipe);
        let (shape, source_nm) = (meant.map(|n| n * parts), pixel_nm / parts as f64);
        if shape.iter().any(|n| *n < TAPS) {
            let expected = format!("a recording needs at least {TAPS} x {TAPS} pixels");
            let value = format!("{} x {}", meant[0], meant[1]);
            return Err(Error::invalid(Setting::TilePixels, value, expected));
        }
        let (dose, dwell) = (recipe.dose.electrons_per_angstrom2, acquisition.dwell_us);
        let exposure =
            Exposure::of_dose(dose, dwell, acquisition.frames, lengths::angstrom(pixel_nm))?;
        let frame = ScanFrame { shape: meant, pixel_nm, origin_nm: [0.0; 2] };
        let path = ScanPath::new(&acquisition, frame, recipe.seed);
        let kernel =
            Arc::new(Kernel::new(lengths::angstrom(source_nm), recipe.optics.image_band_limit())?);
        let recorder = Recorder::new(&acquisition, path, exposure, recipe.seed);
        Ok(Some(FieldScan { acquisition, recorder, kernel, pixel_nm: source_nm, shape }))
    }

    /// Returns the path of the beam, in nm from the centre of the first built pixel.
    pub fn path(&self) -> &ScanPath {
        self.recorder.path()
    }

    /// Returns the settings of scan and detector.
    pub fn acquisition(&self) -> &Acquisition {
        &self.acquisition
    }

    /// Returns the exposure: how many electrons fall on each pixel.
    pub fn exposure(&self) -> &Exposure {
        self.recorder.exposure()
    }

    /// Returns the two coefficients of counts = fraction * first + second, all frames together.
    pub fn counts_of_fraction(&self) -> [f64; 2] {
        let Acquisition { frames, gain_counts, dark_counts, .. } = self.acquisition;
        let frames = frames as f64;
        [gain_counts * self.exposure().electrons_per_pixel * frames, dark_counts * frames]
    }

    /// Starts a recording at the first row. `clean` returns rows of the noise-free image; where the pixel is too coarse it is the image of
    /// a [`super::noise_free::refined`] recipe.
    pub fn begin<'a>(
        &'a self,
        clean: impl Fn(Range<usize>) -> Result<Array2<f32>> + 'a,
    ) -> FieldScanRows<'a> {
        FieldScanRows {
            scan: self,
            clean: Box::new(clean),
            late: vec![0.0; self.acquisition.frames],
            clipped: 0,
            last: None,
        }
    }

    fn record(
        &self,
        rows: Range<usize>,
        clean: &dyn Fn(Range<usize>) -> Result<Array2<f32>>,
        (late, clipped): (&mut [f64], &mut u64),
    ) -> Result<ScannedRows> {
        let [_, [low, high]] = self.path().reach_nm(rows.clone());
        let Range { start: first, end } =
            samples_around([low, high].map(|nm| nm / self.pixel_nm), 0..self.shape[0]);
        let origin = [0.0, first as f64 * self.pixel_nm];
        let image = SourceImage::with_kernel(
            clean(first..end)?,
            self.pixel_nm,
            origin,
            self.kernel.clone(),
        );
        let [scale, dark] = self.counts_of_fraction();
        let shape = [rows.len(), self.path().frame().shape[1]];
        let mut values = Array2::<f64>::zeros(shape);
        let mut valid = Array2::from_elem(shape, true);
        for (frame, late) in late.iter_mut().enumerate() {
            let recorded = self.recorder.rows(frame, rows.clone(), &image, late);
            *clipped += recorded.clipped;
            values.zip_mut_with(&recorded.values, |sum, value| *sum += f64::from(*value));
            for ((k, column), valid) in valid.indexed_iter_mut() {
                let place = self.path().place_nm(frame, rows.start + k, column);
                *valid &= self.holds(place);
            }
        }
        Ok(ScannedRows { values: values.mapv(|v| ((v - dark) / scale) as f32), valid })
    }

    /// Whether a place lies on a pixel of the field.
    fn holds(&self, place_nm: [f64; 2]) -> bool {
        let [x, y] = place_nm.map(|nm| nm / self.pixel_nm + 0.5);
        let [rows, columns] = self.shape.map(|n| n as f64);
        (0.0..columns).contains(&x) && (0.0..rows).contains(&y)
    }
}

/// A recording under way. Bands are requested from top to bottom; a band may begin with rows of the band before.
pub struct FieldScanRows<'a> {
    scan: &'a FieldScan,
    clean: Box<dyn Fn(Range<usize>) -> Result<Array2<f32>> + 'a>,
    /// Late light of the detector in each frame.
    late: Vec<f64>,
    /// Number of pixels so far that the converter clipped.
    clipped: u64,
    /// The band before, and its first row.
    last: Option<(usize, ScannedRows)>,
}

impl FieldScanRows<'_> {
    /// Warns of pixels that the converter clipped in the rows recorded so far.
    pub fn clipping_warning(&self) -> Option<String> {
        let Acquisition { frames, bits, .. } = self.scan.acquisition;
        let [rows, columns] = self.scan.path().frame().shape;
        clipping_warning(self.clipped, rows * columns * frames, bits)
    }

    /// Records rows.
    ///
    /// # Errors
    /// Errors of the noise-free image.
    pub fn rows(&mut self, rows: Range<usize>) -> Result<ScannedRows> {
        let kept = self.last.take().and_then(|(first, last)| {
            let own = rows.start.checked_sub(first).filter(|skip| *skip < last.values.nrows())?;
            let part = s![own.., ..];
            Some((last.values.slice(part).to_owned(), last.valid.slice(part).to_owned()))
        });
        let start = rows.start + kept.as_ref().map_or(0, |(values, _)| values.nrows());
        let so_far = (&mut self.late[..], &mut self.clipped);
        let new = self.scan.record(start..rows.end, &*self.clean, so_far)?;
        let band = match kept {
            None => new,
            Some((values, valid)) => ScannedRows {
                values: stacked(&values, &new.values),
                valid: stacked(&valid, &new.valid),
            },
        };
        self.last = Some((rows.start, band.clone()));
        Ok(band)
    }
}

/// Stacks rows above other rows.
fn stacked<T: Copy + Default>(upper: &Array2<T>, lower: &Array2<T>) -> Array2<T> {
    let (above, columns) = upper.dim();
    let mut both = Array2::from_elem((above + lower.nrows(), columns), T::default());
    both.slice_mut(s![..above, ..]).assign(upper);
    both.slice_mut(s![above.., ..]).assign(lower);
    both
}
