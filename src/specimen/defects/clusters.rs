//! Places about which vacancies gather, in place of boundaries.

use crate::recipe::resolved_recipe::Recipe;
use crate::rng::{self, Purpose};

/// Centres of clusters of vacancies. Each is equally likely anywhere in the full field, and depends on the seed and its number only.
#[derive(Debug, Clone, Default)]
pub struct Clusters {
    centres_nm: Vec<[f64; 2]>,
}

impl Clusters {
    /// Draws the centres that a recipe asks for.
    pub fn draw(recipe: &Recipe) -> Self {
        let count = recipe.vacancies.as_ref().map_or(0, |v| v.clusters);
        let field = recipe.field.full_region();
        let centre = |n: usize| {
            let share = |axis| rng::uniform(recipe.seed, Purpose::Cluster, axis, n as u64);
            let place = |[low, high]: [f64; 2], share: f64| low + (high - low) * share;
            [place(field.x, share(0)), place(field.y, share(1))]
        };
        Clusters { centres_nm: (0..count).map(centre).collect() }
    }

    /// Returns the distance of a point (x, y) from the nearest centre in nm; `None` where vacancies gather about boundaries.
    pub fn distance_nm(&self, [x, y]: [f64; 2]) -> Option<f64> {
        let squares = self.centres_nm.iter().map(|[cx, cy]| (x - cx).powi(2) + (y - cy).powi(2));
        squares.min_by(f64::total_cmp).map(f64::sqrt)
    }

    /// Returns the centres (x, y) in nm.
    pub fn centres_nm(&self) -> &[[f64; 2]] {
        &self.centres_nm
    }
}
