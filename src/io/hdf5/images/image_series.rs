//! Groups images of one detector: the images of a defocus series make one stack with named axes.

use ndarray::{ArrayD, Axis};

use super::image_file::ImageStack;

/// An axis of a stack, other than y and x.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct SeriesAxis {
    /// `defocus` or `thickness`.
    pub name: &'static str,
    /// One value for each image, in Angstrom.
    pub values_angstrom: Vec<f64>,
}

/// The images of one detector, or one image.
#[derive(Debug, Clone)]
pub struct ImageSeries<'s, 'a> {
    /// Name of the images without their defocus.
    pub name: String,
    /// The images, one for each defocus; all have the same shape.
    pub stacks: Vec<&'s ImageStack<'a>>,
}

impl<'s, 'a> ImageSeries<'s, 'a> {
    /// Makes a series of one image, with its thicknesses.
    pub fn of_one(stack: &'s ImageStack<'a>) -> Self {
        ImageSeries { name: stack.name.to_owned(), stacks: vec![stack] }
    }

    /// Groups images by detector, in the order of the first image of each. A single image keeps its name.
    pub fn group(stacks: &'s [ImageStack<'a>]) -> Vec<Self> {
        let mut series: Vec<Self> = Vec::new();
        for stack in stacks {
            let name = series_name(stack.name, stack.defocus_angstrom);
            let fits = |s: &&mut Self| s.name == name && s.stacks[0].data.dim() == stack.data.dim();
            match series.iter_mut().find(fits) {
                Some(found) => found.stacks.push(stack),
                None => series.push(ImageSeries { name, stacks: vec![stack] }),
            }
        }
        for alone in series.iter_mut().filter(|s| s.stacks.len() == 1) {
            alone.name = alone.stacks[0].name.to_owned();
        }
        series
    }

    /// Returns the first image, whose properties all images share.
    pub(crate) fn first(&self) -> &'s ImageStack<'a> {
        self.stacks[0]
    }

    /// Returns the axes before y and x. An axis with one value is left out.
    pub(crate) fn axes(&self) -> Vec<SeriesAxis> {
        let mut axes = Vec::new();
        if self.stacks.len() > 1 {
            let values = self.stacks.iter().map(|stack| stack.defocus_angstrom.unwrap_or_default());
            axes.push(SeriesAxis { name: "defocus", values_angstrom: values.collect() });
        }
        let images = self.first().data.len_of(Axis(0));
        if images > 1 {
            let mut values_angstrom = self.first().thicknesses_angstrom.to_vec();
            values_angstrom.resize(images, 0.0);
            axes.push(SeriesAxis { name: "thickness", values_angstrom });
        }
        axes
    }

    /// Returns the lengths of all axes; the last two are y and x.
    pub(crate) fn shape(&self) -> Vec<usize> {
        let (_, rows, columns) = self.first().data.dim();
        let along = self.axes().into_iter().map(|axis| axis.values_angstrom.len());
        along.chain([rows, columns]).collect()
    }

    /// Returns all values, with these axes.
    pub(crate) fn data(&self) -> ArrayD<f32> {
        let values = self.stacks.iter().flat_map(|stack| stack.data.iter().copied()).collect();
        // The shape always fits the number of values; the empty array is never returned.
        ArrayD::from_shape_vec(self.shape(), values).unwrap_or_else(|_| ArrayD::zeros(vec![0, 0]))
    }

    /// Describes each image, in the order of the data: `defocus 50 A, thickness 20 A`; empty for one image.
    pub(crate) fn labels(&self) -> Vec<String> {
        let mut labels = vec![String::new()];
        for axis in self.axes() {
            let add = |label: &String| {
                let separator = if label.is_empty() { "" } else { ", " };
                let values = axis.values_angstrom.iter();
                let one = |v: &f64| format!("{label}{separator}{} {} A", axis.name, rounded(*v));
                values.map(one).collect::<Vec<_>>()
            };
            labels = labels.iter().flat_map(add).collect();
        }
        labels
    }
}

impl SeriesAxis {
    /// Returns first value and step, if the steps are equal to a thousandth.
    pub(crate) fn even(&self) -> Option<[f64; 2]> {
        let [first, second, ..] = self.values_angstrom[..] else { return None };
        let step = second - first;
        let at = |n: usize| first + n as f64 * step;
        let mut values = self.values_angstrom.iter().enumerate();
        let even = values.all(|(n, v)| (v - at(n)).abs() <= 1e-3 * step.abs());
        (even && step != 0.0).then_some([first, step])
    }
}

/// Rounds a length to a hundredth of an Angstrom, and drops zeros at the end.
pub(crate) fn rounded(angstrom: f64) -> f64 {
    (100.0 * angstrom).round() / 100.0
}

/// Returns `HAADF` and `HAADF_noisy` for `HAADF_defocus_50A` and `HAADF_defocus_50A_noisy`.
fn series_name(name: &str, defocus_angstrom: Option<f64>) -> String {
    let part = defocus_angstrom.map(|defocus| format!("_defocus_{defocus}A"));
    match part.as_deref().and_then(|part| Some((name.rfind(part)?, part.len()))) {
        Some((at, length)) => format!("{}{}", &name[..at], &name[at + length..]),
        None => name.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::{Array3, ArrayView3};

    fn stack<'a>(
        name: &'a str,
        data: ArrayView3<'a, f32>,
        defocus_angstrom: Option<f64>,
    ) -> ImageStack<'a> {
        ImageStack {
            name,
            data,
            units: "",
            step_angstrom: [0.2; 2],
            origin_angstrom: [0.0; 2],
            thicknesses_angstrom: &[10.0, 20.004][..data.dim().0],
            defocus_angstrom,
            annulus_mrad: None,
            sector_degrees: None,
            electrons_per_pixel: None,
        }
    }

    #[test]
    fn images_of_a_series_are_put_together() {
        let data = [0.0, 1.0].map(|v| Array3::from_elem((2, 3, 4), v));
        let one = |name, n: usize, defocus| stack(name, data[n].view(), defocus);
        let all = [
            one("A_defocus_0A", 0, Some(0.0)),
            one("A_defocus_-50.5A", 1, Some(-50.5)),
            one("A_defocus_0A_noisy", 0, Some(0.0)),
            one("A_defocus_-50.5A_noisy", 1, Some(-50.5)),
            one("B", 0, None),
        ];
        let series = ImageSeries::group(&all);
        let names: Vec<&str> = series.iter().map(|s| s.name.as_str()).collect();
        assert_eq!(names, ["A", "A_noisy", "B"]);
        assert_eq!(series[0].shape(), [2, 2, 3, 4]);
        assert_eq!(series[2].shape(), [2, 3, 4]);
        let axes = series[0].axes();
        assert_eq!((axes[0].name, axes[0].even()), ("defocus", Some([0.0, -50.5])));
        assert_eq!(axes[1].name, "thickness");
        assert_eq!(series[0].data()[[1, 0, 2, 3]], 1.0);
        assert_eq!(series[0].labels()[1], "defocus 0 A, thickness 20 A");
        assert_eq!(series[0].labels()[2], "defocus -50.5 A, thickness 10 A");
        assert_eq!(ImageSeries::group(&all[..1])[0].name, "A_defocus_0A");
    }

    #[test]
    fn uneven_steps_are_not_even() {
        let axis = |values: &[f64]| SeriesAxis { name: "", values_angstrom: values.to_vec() };
        assert_eq!(axis(&[1.0, 2.0, 3.0]).even(), Some([1.0, 1.0]));
        assert_eq!(axis(&[1.0, 2.0, 4.0]).even(), None);
        assert_eq!(axis(&[1.0]).even(), None);
    }
}
