//! A world that keeps its noise-free image as the source of recordings.

use ndarray::Array2;

use super::noise_free::NoiseFree;
use crate::error::Result;
use crate::imaging::PixelRect;
use crate::io::WorldFile;
use crate::plane;
use crate::progress::Progress;
use crate::recipe::CheckedRecipe;

/// A world that was built with its noise-free images. It has no images that a centre of mass is made of.
pub(crate) struct WorldSource<'a> {
    /// The world.
    pub world: &'a WorldFile,
    /// Recipe of the world.
    pub recipe: &'a CheckedRecipe,
}

impl NoiseFree for WorldSource<'_> {
    fn recipe(&self) -> &CheckedRecipe {
        self.recipe
    }

    fn extent_px(&self) -> [[usize; 2]; 2] {
        let field = &self.recipe.field;
        let (first, shape) = (field.crop_origin_px(), field.pixels(field.built_grid()));
        [first, plane::add(first, shape)]
    }

    fn pixels(
        &self,
        pixels: &PixelRect,
        measured: &[usize],
        _progress: &dyn Progress,
    ) -> Result<Vec<Array2<f32>>> {
        let first = self.recipe.field.crop_origin_px();
        let range = |k: usize| {
            let start = pixels.first[k] - first[k];
            start..start + pixels.shape[k]
        };
        let read = |world: &WorldFile| {
            let image = world.stitched_clean(range(0), range(1))?;
            world.check_finite(&image, [range(0).start, range(1).start], true)?;
            Ok(image)
        };
        let names = self.recipe.detector.measured();
        let one = |number: &usize| match number {
            0 => read(self.world),
            n => read(&self.world.on_detector(&names[*n].name)?),
        };
        measured.iter().map(one).collect()
    }
}
