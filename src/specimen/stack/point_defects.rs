//! Vacancies and substitutions of a stack: random, or gathered at its interfaces, faults, edges and dislocations.

use rayon::prelude::*;

use super::interfaces::Interfaces;
use crate::error::Result;
use crate::lengths;
use crate::recipe::CheckedRecipe;
use crate::recipe::stacked_crystals::StackedCrystals;
use crate::specimen::defects::rules::Defects;
use crate::specimen::defects::vacancies::DistanceHistogram;
use crate::specimen::held_columns::PlacedSite;
use crate::specimen::sites::{SiteKind, SpecimenSite};
use crate::structure::lattice::dot;

/// The rules for the sites of a stack.
pub(super) struct PointDefects<'s> {
    rules: Defects,
    crystals: &'s StackedCrystals,
    interfaces: &'s Interfaces,
    /// Whether vacancies gather, so that distances count.
    gathered: bool,
}

impl<'s> PointDefects<'s> {
    /// Fits the rules to the sites in the full field.
    ///
    /// # Errors
    /// A rate that the greatest probability leaves no room for.
    pub(super) fn fit(
        recipe: &CheckedRecipe,
        crystals: &'s StackedCrystals,
        interfaces: &'s Interfaces,
        sites: &[PlacedSite],
    ) -> Result<Self> {
        let gathered = recipe.vacancies.as_ref().is_some_and(|v| v.cluster_fraction > 0.0);
        let rules = Defects::default();
        let mut found = PointDefects { rules, crystals, interfaces, gathered };
        let field = recipe.field.full_region();
        let rules = Defects::fit(recipe, |element, histogram: &mut DistanceHistogram| {
            let own = |(site, _): &&PlacedSite| {
                let [x, y, _] = site.position_nm;
                site.number == element && site.kind == SiteKind::Pristine && field.contains([x, y])
            };
            let distances: Vec<f64> =
                sites.par_iter().filter(own).map(|(site, _)| found.distance_nm(site)).collect();
            distances.into_iter().for_each(|nm| histogram.add(nm, 1));
        })?;
        found.rules = rules;
        Ok(found)
    }

    /// Returns the kind of a site and the element that it holds. A site whose atom was exchanged over an interface stays as it is.
    pub(super) fn of(&self, site: &SpecimenSite) -> (SiteKind, u8) {
        if site.kind != SiteKind::Pristine {
            return (site.kind, site.number);
        }
        self.rules.at(self.distance_nm(site)).of(site.key, site.number)
    }

    /// Returns the distance in nm from the nearest interface, planar fault, edge or dislocation, as if each went on for ever; infinite where
    /// vacancies do not gather.
    fn distance_nm(&self, site: &SpecimenSite) -> f64 {
        if !self.gathered {
            return f64::INFINITY;
        }
        let at = lengths::angstrom_by_division(site.position_nm);
        let layers = &self.crystals.layers;
        let of_interfaces = (1..layers.len())
            .map(|n| (at[self.interfaces.axis] - self.interfaces.height(n, at)).abs());
        let of_faults = layers
            .iter()
            .flat_map(|layer| &layer.faults)
            .map(|plane| (dot(at, plane.normal) - plane.distance).abs());
        let of_edges = layers
            .iter()
            .flat_map(|layer| &layer.edges)
            .map(|edge| (dot(at, edge.normal) - edge.distance).abs());
        let of_lines = self
            .crystals
            .dislocations
            .iter()
            .map(|line| (at[0] - line.position[0]).hypot(at[1] - line.position[1]));
        let of_planes = of_interfaces.chain(of_faults).chain(of_edges);
        lengths::nm(of_planes.chain(of_lines).fold(f64::INFINITY, f64::min))
    }
}
