//! The sites of the built field, stripe by stripe from the top: the order of the ground truth.

use std::ops::Range;

use rayon::prelude::*;

use super::atom_columns::Sites;
use super::specimen_trait::Specimen;
use crate::error::{Error, Result};
use crate::progress::Progress;
use crate::recipe::region::Region;
use crate::recipe::tables::Field;

/// Number of rows of pixels that are listed at a time.
const STRIPE_PX: usize = 124;

/// Some rows of pixels of the built field, and the sites in them.
pub struct Stripe {
    /// Rows of the built field.
    pub rows: Range<usize>,
    /// Columns and sites in these rows.
    pub sites: Sites,
}

/// Calls `visit` with the sites of the built field, stripe by stripe from the top: the order of the ground truth. Several stripes are made
/// in parallel, so memory holds several for each thread.
///
/// # Errors
/// Errors of `visit`, and [`Error::Interrupted`].
pub fn for_each_stripe(
    specimen: &dyn Specimen,
    field: &Field,
    stage: &str,
    progress: &dyn Progress,
    mut visit: impl FnMut(&Stripe) -> Result<()> + Send,
) -> Result<()> {
    let shape = field.pixels(field.built_grid());
    let (first, pixel) = (field.crop_origin_px(), field.pixel_nm());
    let stripes: Vec<usize> = (0..shape[0]).step_by(STRIPE_PX).collect();
    progress.start(stage, "row", shape[0] as u64);
    let stripe = |&row: &usize| {
        let rows = row..shape[0].min(row + STRIPE_PX);
        let area = Region::of_pixels([first[0] + row, first[1]], [rows.len(), shape[1]], pixel);
        Stripe { rows, sites: specimen.query(&area) }
    };
    let listed = |rows: &[usize]| rows.par_iter().map(stripe).collect::<Vec<Stripe>>();
    let mut visit_all = |stripes: &[Stripe]| {
        stripes.iter().try_for_each(|stripe| {
            visit(stripe)?;
            progress.advance(stripe.rows.len() as u64);
            Ok(())
        })
    };
    // One thread visits stripes while the others list the next ones.
    let mut ready = Vec::new();
    for rows in stripes.chunks(rayon::current_num_threads()) {
        if progress.interrupted() {
            return Err(Error::Interrupted);
        }
        let (visited, next) = rayon::join(|| visit_all(&ready), || listed(rows));
        visited?;
        ready = next;
    }
    visit_all(&ready)?;
    progress.finish();
    Ok(())
}
