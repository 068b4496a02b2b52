//! The view of an acquisition: a square of the field with as many pixels as a tile.

use serde::Serialize;

use crate::imaging::{PixelRect, TurnedRaster};
use crate::plane;
use crate::recipe::Region;

/// Facts of a field that do not change in an episode.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FieldFacts {
    /// Name of the world, for records.
    pub name: String,
    /// Material.
    pub material: String,
    /// Rows and columns of tiles.
    pub grid: [usize; 2],
    /// Edge of a tile in pixels.
    pub tile_px: usize,
    /// Pixels that neighbouring tiles share.
    pub overlap_px: usize,
    /// Edge of a pixel in nm.
    pub pixel_nm: f64,
    /// Dose of the world's tier, in electrons per square Angstrom; 0 where it is not known.
    pub dose: f64,
    /// Scale and offset of tiles: fraction of the beam = value * scale + offset.
    pub scaling: [f64; 2],
    /// Names of the phases; empty for a single phase.
    pub phases: Vec<String>,
    /// Type of defect that targeted characterisation asks for by default: the commonest in a file; vacancies in a recipe that has any.
    pub target: Option<String>,
    /// Whether the data are recorded, so that no noise is ever added.
    pub recorded: bool,
    /// Number of pixels at the edges that no view may reach.
    pub margin_px: usize,
}

impl FieldFacts {
    /// Returns the distance of neighbouring tiles in pixels.
    pub(crate) fn stride_px(&self) -> usize {
        self.tile_px - self.overlap_px
    }

    /// Returns the number of pixels: [rows, columns].
    pub fn shape_px(&self) -> [usize; 2] {
        self.grid.map(|n| n * self.stride_px() + self.overlap_px)
    }

    /// Returns height and width in nm.
    pub fn size_nm(&self) -> [f64; 2] {
        self.shape_px().map(|n| n as f64 * self.pixel_nm)
    }

    /// Returns the tile (row, column) whose middle is nearest to the middle of a view.
    pub(crate) fn tile_of(&self, view: &TileView) -> [usize; 2] {
        plane::per_axis(view.first_px, self.grid, |px, tiles| {
            ((px + self.stride_px() / 2) / self.stride_px()).min(tiles - 1)
        })
    }

    /// Returns the view of a place (x, y), in fractions of the field's width and height: the whole pixels about it, moved inwards where
    /// they would reach out of the field.
    pub fn view_at(&self, position: [f64; 2], zoom: f64) -> TileView {
        let shape = self.shape_px();
        let first = |k: usize| {
            let centre = position[1 - k].clamp(0.0, 1.0) * shape[k] as f64 - 0.5;
            let first = (centre - 0.5 * (self.tile_px as f64 - 1.0)).round().max(0.0) as usize;
            let last = shape[k] - self.tile_px;
            let margin = self.margin_px.min(last / 2);
            first.clamp(margin, last - margin)
        };
        TileView { first_px: [first(0), first(1)], tile_px: self.tile_px, zoom }
    }

    /// Returns the middle (x, y) of a view in fractions of the field's width and height.
    pub(crate) fn position_of(&self, view: &TileView) -> [f64; 2] {
        let shape = self.shape_px();
        [1, 0].map(|k| (view.first_px[k] as f64 + 0.5 * self.tile_px as f64) / shape[k] as f64)
    }

    /// Returns the middle (x, y) of a tile (row, column) in fractions of the field's width and height.
    pub fn centre_of(&self, tile: [usize; 2]) -> [f64; 2] {
        let first_px = tile.map(|n| n * self.stride_px());
        self.position_of(&TileView { first_px, tile_px: self.tile_px, zoom: 1.0 })
    }
}

/// A square of the field.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct TileView {
    /// First row and column of the field's pixels in the view without zoom.
    pub first_px: [usize; 2],
    /// Number of rows, and of columns, of the view.
    pub tile_px: usize,
    /// Zoom: the view shows the middle `1 / zoom` of the width with the same number of pixels.
    pub zoom: f64,
}

impl TileView {
    /// Returns the pixels of the field without zoom.
    pub(crate) fn pixels(&self) -> PixelRect {
        PixelRect::new(self.first_px, [self.tile_px; 2])
    }

    /// Returns the middle (x, y) of the view in nm from the centre of the field's first pixel.
    pub(crate) fn centre_nm(&self, pixel_nm: f64) -> [f64; 2] {
        plane::swapped(self.first_px)
            .map(|px| (px as f64 + 0.5 * (self.tile_px as f64 - 1.0)) * pixel_nm)
    }

    /// Returns the pixels of the view, with the field's pixel (0, 0) at `origin_nm` (x, y).
    pub(crate) fn raster(&self, pixel_nm: f64, origin_nm: [f64; 2]) -> TurnedRaster {
        let centre = self.centre_nm(pixel_nm);
        TurnedRaster {
            centre_nm: plane::add(centre, origin_nm),
            pixel_nm: pixel_nm / self.zoom,
            angle_rad: 0.0,
            shape: [self.tile_px; 2],
        }
    }

    /// Returns the area of the view, in nm from the centre of the field's first pixel.
    pub fn region(&self, pixel_nm: f64) -> Region {
        let [x, y] = self.centre_nm(pixel_nm);
        let half = 0.5 * self.tile_px as f64 * pixel_nm / self.zoom;
        Region { x: [x - half, x + half], y: [y - half, y + half] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn facts() -> FieldFacts {
        FieldFacts {
            name: "a".into(),
            material: "a".into(),
            grid: [3, 5],
            tile_px: 128,
            overlap_px: 4,
            pixel_nm: 0.02,
            dose: 1e4,
            scaling: [1.0, 0.0],
            phases: vec![],
            target: None,
            recorded: false,
            margin_px: 0,
        }
    }

    #[test]
    fn tiles_are_found_by_their_middles() {
        let facts = facts();
        for row in 0..3 {
            for column in 0..5 {
                let at = facts.centre_of([row, column]);
                let single = at.map(|v| f64::from(v as f32));
                for at in [at, single] {
                    let view = facts.view_at(at, 1.0);
                    assert_eq!(view.first_px, [124 * row, 124 * column]);
                    assert_eq!(facts.tile_of(&view), [row, column]);
                }
            }
        }
        assert_eq!(facts.view_at([1.0, 0.0], 2.0).first_px, [0, 4 * 124]);
        assert_eq!(facts.view_at([-7.0, 9.0], 2.0).first_px, [2 * 124, 0]);
        let inner = FieldFacts { margin_px: 3, ..facts };
        assert_eq!(inner.view_at([-7.0, 9.0], 2.0).first_px, [2 * 124 - 3, 3]);
    }

    #[test]
    fn zoom_shows_the_middle() {
        let view = TileView { first_px: [124, 0], tile_px: 128, zoom: 4.0 };
        let (whole, part) = (TileView { zoom: 1.0, ..view }.region(0.02), view.region(0.02));
        assert!((whole.y[0] - 123.5 * 0.02).abs() < 1e-12 && (whole.x[0] + 0.01).abs() < 1e-12);
        assert!((part.x[1] - part.x[0] - 0.64).abs() < 1e-12);
        assert!((part.x[0] + part.x[1] - whole.x[0] - whole.x[1]).abs() < 1e-12);
    }
}
