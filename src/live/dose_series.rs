//! A series of recordings of one place.

use ndarray::{Array2, Array3, Axis};

use super::live_history::LiveAcquisition;
use super::live_world::{LiveRequest, LiveWorld};
use crate::engine::check_memory;
use crate::error::{Error, Result};
use crate::progress::Progress;
use crate::recipe::Region;
use crate::setting::Setting;
use crate::world::{DetectorRecording, FieldRecording, RecordedPart};

/// Largest number of recordings in a series.
const MOST_RECORDINGS: usize = 100_000;

/// Recordings of one place, one after the other.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct DoseSeries {
    /// The first recording, with the truth of that time.
    pub first: FieldRecording,
    /// Recorded values, as in the file of a microscope: (recording, row, column).
    pub data: Array3<f64>,
    /// The noise-free image at the intended pixels at the start of each recording: (recording, row, column), as fraction of the beam.
    pub ideal: Array3<f32>,
    /// The same on the other detectors, in the order of the recipe.
    pub others: Vec<DetectorSeries>,
    /// Vacant sites of each column of the first recording at the start of each recording: (recording, column).
    pub vacancies: Array2<i32>,
    /// Mean dose of the place in electrons per square Angstrom before each recording.
    pub dose_before: Vec<f64>,
    /// Number of pixels that the converter of the first detector clipped, in all recordings.
    pub clipped: u64,
    /// The recordings, with the atoms that each removed.
    pub history: Vec<LiveAcquisition>,
}

/// Recordings on another detector than the first. Arrays are as in [`DoseSeries`].
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct DetectorSeries {
    /// Recorded values.
    pub data: Array3<f64>,
    /// The noise-free image at the start of each recording.
    pub ideal: Array3<f32>,
    /// Number of pixels that the converter clipped, in all recordings.
    pub clipped: u64,
}

impl DetectorSeries {
    fn zeros(shape: (usize, usize, usize)) -> Self {
        DetectorSeries { data: Array3::zeros(shape), ideal: Array3::zeros(shape), clipped: 0 }
    }

    fn set(&mut self, number: usize, one: &DetectorRecording) {
        self.data.index_axis_mut(Axis(0), number).assign(&one.data.index_axis(Axis(0), 0));
        self.ideal.index_axis_mut(Axis(0), number).assign(&one.ideal);
        self.clipped += one.clipped;
    }
}

/// Checks that a series may have this number of recordings.
///
/// # Errors
/// [`Error::Invalid`] for none, or more than 100 000.
pub fn check_recordings(count: usize) -> Result<()> {
    if (1..=MOST_RECORDINGS).contains(&count) {
        return Ok(());
    }
    Err(Error::invalid(Setting::Recordings, count, "expected 1 to 100000 recordings"))
}

impl LiveWorld {
    /// Records one place `count` times. The frames of each recording are summed.
    ///
    /// # Errors
    /// Errors of [`LiveWorld::acquire`] and [`check_recordings`]; [`Error::Memory`].
    pub fn dose_series(
        &mut self,
        request: &LiveRequest,
        count: usize,
        progress: &dyn Progress,
    ) -> Result<DoseSeries> {
        check_recordings(count)?;
        let request = LiveRequest { keep_frames: false, ..*request };
        let RecordedPart { centre_nm, size_nm, .. } = request.part;
        let place = Region::centred(centre_nm, size_nm);
        progress.start("recording", "recording", count as u64);
        let mut series: Option<DoseSeries> = None;
        for number in 0..count {
            let dose = self.mean_dose_within(&place);
            let one = self.acquire(&request, progress)?;
            let series = match &mut series {
                Some(series) => series,
                None => series.insert(DoseSeries::of(&one, count)?),
            };
            series.set(number, &one);
            series.dose_before.push(dose);
            series.history.extend(self.history().last().cloned());
            progress.advance(1);
        }
        progress.finish();
        series.ok_or(Error::Interrupted)
    }
}

impl DoseSeries {
    /// Warnings of pixels that the converters clipped.
    pub fn clipping_warnings(&self) -> Vec<String> {
        let clipped = std::iter::once(self.clipped).chain(self.others.iter().map(|o| o.clipped));
        self.first.warnings_of(self.data.len_of(Axis(0)), clipped)
    }

    /// Allocates arrays for `count` recordings like the first.
    fn of(first: &FieldRecording, count: usize) -> Result<Self> {
        let [rows, columns] = first.frame.shape;
        let detectors = 1 + first.others.len();
        let bytes = (count * (rows * columns * 12 * detectors + first.columns.len() * 4)) as u64;
        check_memory(bytes, "record fewer times, or a smaller part")?;
        Ok(DoseSeries {
            first: first.clone(),
            data: Array3::zeros((count, rows, columns)),
            ideal: Array3::zeros((count, rows, columns)),
            others: vec![DetectorSeries::zeros((count, rows, columns)); first.others.len()],
            vacancies: Array2::zeros((count, first.columns.len())),
            dose_before: Vec::with_capacity(count),
            clipped: 0,
            history: Vec::with_capacity(count),
        })
    }

    fn set(&mut self, number: usize, one: &FieldRecording) {
        self.data.index_axis_mut(Axis(0), number).assign(&one.data.index_axis(Axis(0), 0));
        self.clipped += one.clipped;
        self.ideal.index_axis_mut(Axis(0), number).assign(&one.ideal);
        self.others.iter_mut().zip(&one.others).for_each(|(to, from)| to.set(number, from));
        // Losing atoms changes neither the columns of a specimen nor their order.
        let mut vacancies = self.vacancies.row_mut(number);
        for (to, column) in vacancies.iter_mut().zip(&one.columns) {
            *to = column.vacancies as i32;
        }
    }
}
