//! Heights of the interfaces of a stack, with their roughness.

use crate::lengths;
use crate::recipe::limits::BEYOND_FIELD_NM;
use crate::recipe::stack_table::DEFAULT_CORRELATION_NM;
use crate::recipe::stacked_crystals::StackedCrystals;
use crate::recipe::{CheckedRecipe, StackTable};
use crate::specimen::roughness::Roughness;
use crate::structure::lattice::Vec3;

/// Width in nm by which rough interfaces reach beyond the atoms about the field.
const MARGIN_NM: f64 = 1.0;

/// The box of a specimen and of the atoms around the field: ranges along x, y and z in Angstrom.
pub(super) type Extent = [[f64; 2]; 3];

/// The interfaces of a stack; interface n is the one at which layer n begins (from 0), and the last is the end of the stack.
#[derive(Debug)]
pub struct Interfaces {
    /// Axis along which layers follow each other, and the two axes in the interfaces.
    pub axis: usize,
    pub in_plane: [usize; 2],
    /// Heights in Angstrom without roughness.
    heights: Vec<f64>,
    rough: Vec<Option<Roughness>>,
    /// Beginning of the second axis of the roughness in nm.
    second_start_nm: f64,
}

impl Interfaces {
    pub fn new(recipe: &CheckedRecipe, table: &StackTable, crystals: &StackedCrystals) -> Self {
        let in_plane = table.along.in_plane();
        let field = recipe.field.full_region();
        let around = field.grown(BEYOND_FIELD_NM + MARGIN_NM);
        let depth = [0.0, recipe.field.thickness_nm];
        let [first, second] = in_plane;
        let wide = [around.x, around.y, depth];
        let built = [field.x, field.y, depth];
        let rough = |n: usize| {
            let layer = table.layers.get(n)?;
            let rms = layer.roughness_nm.filter(|rms| *rms > 0.0 && n > 0)?;
            let length = layer.roughness_correlation_nm.unwrap_or(DEFAULT_CORRELATION_NM);
            let span = wide[second][1] - wide[second][0];
            Some(Roughness::new(
                wide[first],
                built[first],
                span,
                rms,
                length,
                recipe.seed,
                n as u32,
            ))
        };
        let mut heights: Vec<f64> = crystals.layers.iter().map(|layer| layer.begin).collect();
        heights.push(crystals.end);
        // What lies before the first layer belongs to it, except along the beam.
        if table.along.axis() != 2 {
            heights[0] = f64::NEG_INFINITY;
        } else {
            heights[0] -= 1e-6;
        }
        Interfaces {
            axis: table.along.axis(),
            in_plane,
            rough: (0..heights.len()).map(rough).collect(),
            heights,
            second_start_nm: wide[second][0],
        }
    }

    /// Returns the height of an interface at the place of a point, in Angstrom.
    pub fn height(&self, n: usize, at: Vec3) -> f64 {
        let [first, second] = self.in_plane;
        let rough = self.rough[n].as_ref().map_or(0.0, |rough| {
            let [x, y] = lengths::nm([at[first], at[second]]);
            lengths::angstrom_by_division(rough.at(x, y - self.second_start_nm))
        });
        self.heights[n] + rough
    }

    /// Returns the height of an interface without roughness, in Angstrom.
    pub fn flat(&self, n: usize) -> f64 {
        self.heights[n]
    }

    /// Whether a point lies in a layer.
    pub fn holds(&self, layer: usize, at: Vec3) -> bool {
        let s = at[self.axis];
        self.height(layer, at) <= s && s < self.height(layer + 1, at)
    }

    /// Returns the box of a layer within an extent, roughness included.
    pub fn bounds(&self, layer: usize, extent: &Extent) -> Extent {
        let reach = |n: usize| {
            self.rough[n]
                .as_ref()
                .map_or(0.0, |rough| lengths::angstrom_by_division(rough.greatest()))
        };
        let low = self.heights[layer] - reach(layer);
        let high = self.heights[layer + 1] + reach(layer + 1);
        let mut bounds = *extent;
        let along = &mut bounds[self.axis];
        *along = [along[0].max(low), along[1].min(high)];
        bounds
    }

    /// Returns the corners (place in the interface, mean height along the beam) in Angstrom of an interface that is seen edge on.
    pub fn corners(&self, n: usize, range: [f64; 2]) -> Vec<[f64; 2]> {
        match &self.rough[n] {
            None => range.map(|at| [at, self.heights[n]]).to_vec(),
            Some(rough) => {
                let places = rough.corners(lengths::nm(range)).into_iter();
                places
                    .map(|nm| {
                        let [at, rough] =
                            lengths::angstrom_by_division([nm, rough.mean_along_beam(nm)]);
                        [at, self.heights[n] + rough]
                    })
                    .collect()
            }
        }
    }
}
