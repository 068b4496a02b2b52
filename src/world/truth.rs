//! Ground truth: the sites of the built field, stripe by stripe.

use std::collections::BTreeMap;
use std::ops::Range;

use ndarray::Array2;
use rayon::prelude::*;

use super::recipe::Field;
use super::specimen::{
    AtomColumn, Boundary, BoundaryKind, ParticleTruth, Region, SiteKind, Sites, Specimen,
    SpecimenSite,
};
use crate::error::{Error, Result};
use crate::io::schema::{CompositionText, DefectName, MorphologyName, atom_type};
use crate::io::{LineKind, ParticleBatch, TruthBatch, WorldWriter};
use crate::progress::Progress;
use crate::structure::elements;

/// Rows of pixels that are listed at a time.
const STRIPE_PX: usize = 124;

/// What was listed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counts {
    /// Lattice sites.
    pub sites: u64,
    /// Vacant ones.
    pub vacancies: u64,
    /// Those that hold another element.
    pub substitutions: u64,
    /// Atomic columns.
    pub columns: u64,
}

/// Writes sites, columns, boundaries, phases and particles.
///
/// # Errors
/// Those of the writer, and [`Error::Interrupted`].
pub fn write(
    specimen: &dyn Specimen,
    field: &Field,
    writer: &WorldWriter,
    progress: &dyn Progress,
) -> Result<Counts> {
    let shape = field.pixels(field.built_grid());
    let (first, pixel) = (field.crop_origin_px(), field.pixel_nm());
    let origin = [first[1] as f64 * pixel, first[0] as f64 * pixel];
    let phases = specimen.phases();
    if phases.len() > 1 {
        writer.create_phase_map(&phases)?;
    }
    let mut counts = Counts::default();
    for_each_stripe(specimen, field, "ground truth", progress, |stripe| {
        writer.append(&batch(&stripe.sites, origin, &mut counts))?;
        if phases.len() > 1 {
            let (row, size) = (stripe.rows.start, [stripe.rows.len(), shape[1]]);
            let corner = [first[0] + row, first[1]];
            writer.phase_rows(row, phase_rows(specimen, corner, size, pixel).view())?;
        }
        Ok(())
    })?;
    let built = Region::of_pixels(first, shape, pixel);
    for boundary in specimen.boundaries() {
        write_boundary(&boundary, &phases, &built, origin, writer)?;
    }
    write_particles(specimen, &built, origin, writer)?;
    Ok(counts)
}

/// Some rows of pixels of the built field and the sites there.
pub(super) struct Stripe {
    pub rows: Range<usize>,
    pub sites: Sites,
}

/// Calls `visit` with the sites of the built field, stripe by stripe from the top: the order of the
/// ground truth. Some stripes are made at once, so memory holds that many for each thread.
///
/// # Errors
/// Those of `visit`, and [`Error::Interrupted`].
pub(super) fn for_each_stripe(
    specimen: &dyn Specimen,
    field: &Field,
    stage: &str,
    progress: &dyn Progress,
    mut visit: impl FnMut(&Stripe) -> Result<()>,
) -> Result<()> {
    let shape = field.pixels(field.built_grid());
    let (first, pixel) = (field.crop_origin_px(), field.pixel_nm());
    let stripes: Vec<usize> = (0..shape[0]).step_by(STRIPE_PX).collect();
    progress.start(stage, "row", shape[0] as u64);
    for rows in stripes.chunks(rayon::current_num_threads()) {
        if progress.interrupted() {
            return Err(Error::Interrupted);
        }
        let stripe = |&row: &usize| {
            let rows = row..shape[0].min(row + STRIPE_PX);
            let area = Region::of_pixels([first[0] + row, first[1]], [rows.len(), shape[1]], pixel);
            Stripe { rows, sites: specimen.query(&area) }
        };
        for stripe in rows.par_iter().map(stripe).collect::<Vec<Stripe>>() {
            visit(&stripe)?;
            progress.advance(stripe.rows.len() as u64);
        }
    }
    progress.finish();
    Ok(())
}

fn batch(sites: &Sites, origin: [f64; 2], counts: &mut Counts) -> TruthBatch {
    let mut batch = TruthBatch::default();
    let shifted = |[x, y]: [f64; 2]| [(x - origin[0]) as f32, (y - origin[1]) as f32];
    for column in &sites.columns {
        let members = &sites.sites[column.sites.clone()];
        for site in members {
            let [x, y, z] = site.position_nm;
            batch.positions.push(shifted([x, y]));
            batch.z.push(z as f32);
            batch.types.push(code(site.kind));
            batch.defects.push(site.kind != SiteKind::Pristine);
            batch.numbers.push(i32::from(site.number));
            batch.defect_names.push(defect_name(site));
            batch.columns.push(counts.columns as i32);
        }
        counts.columns += 1;
        push_column(&mut batch, column, members, shifted(column.position_nm));
    }
    counts.sites += sites.sites.len() as u64;
    let of = |kind| sites.sites.iter().filter(|s| s.kind == kind).count() as u64;
    counts.vacancies += of(SiteKind::Vacancy);
    counts.substitutions += of(SiteKind::Substitution);
    batch
}

/// Phases at the centres of pixels.
fn phase_rows(
    specimen: &dyn Specimen,
    first: [usize; 2],
    shape: [usize; 2],
    pixel_nm: f64,
) -> Array2<i32> {
    let mut map = Array2::zeros(shape);
    let lines: Vec<_> = map.outer_iter_mut().collect();
    lines.into_par_iter().enumerate().for_each(|(row, mut line)| {
        for (column, phase) in line.iter_mut().enumerate() {
            let at = [first[1] + column, first[0] + row].map(|p| p as f64 * pixel_nm);
            *phase = specimen.phase_at(at) as i32;
        }
    });
    map
}

/// Writes the particles that reach into the built field.
fn write_particles(
    specimen: &dyn Specimen,
    built: &Region,
    origin: [f64; 2],
    writer: &WorldWriter,
) -> Result<()> {
    let all = specimen.particles();
    if all.is_empty() {
        return Ok(());
    }
    let mut batch = ParticleBatch::default();
    let reaches = |p: &&ParticleTruth| {
        built.grown(0.5 * p.diameter_nm).contains([p.centre_nm[0], p.centre_nm[1]])
    };
    for particle in all.iter().filter(reaches) {
        let [x, y, z] = particle.centre_nm;
        batch.centres.push([(x - origin[0]) as f32, (y - origin[1]) as f32, z as f32]);
        batch.diameters.push(particle.diameter_nm as f32);
        let morphology = MorphologyName::from_ascii(&particle.morphology);
        batch.morphologies.push(morphology.unwrap_or_default());
        batch.orientations.push(particle.orientation.map(|q| q as f32));
    }
    writer.particles(&batch)
}

fn push_column(
    batch: &mut TruthBatch,
    column: &AtomColumn,
    members: &[SpecimenSite],
    position: [f32; 2],
) {
    let of = |kind| members.iter().filter(|s| s.kind == kind).count() as i32;
    batch.column_positions.push(position);
    batch.column_counts[0].push(column.sites.len() as i32);
    batch.column_counts[1].push(of(SiteKind::Vacancy));
    batch.column_counts[2].push(of(SiteKind::Substitution));
    let mut present: BTreeMap<u8, usize> = BTreeMap::new();
    for site in members.iter().filter(|s| s.kind != SiteKind::Vacancy) {
        *present.entry(site.number).or_default() += 1;
    }
    let parts: Vec<String> =
        present.iter().map(|(&z, n)| format!("{}{n}", elements::symbol(z))).collect();
    let text = parts.join(" ");
    batch.column_compositions.push(CompositionText::from_ascii(&text).unwrap_or_default());
}

/// Code of [`atom_type`].
pub(super) fn code(kind: SiteKind) -> i32 {
    match kind {
        SiteKind::Pristine => atom_type::PRISTINE,
        SiteKind::Vacancy => atom_type::VACANCY,
        SiteKind::Substitution => atom_type::SUBSTITUTION,
    }
}

/// Name of the defect of a site; empty for none.
pub(super) fn defect_name(site: &SpecimenSite) -> DefectName {
    let symbol = elements::symbol(site.number);
    let name = match site.kind {
        SiteKind::Pristine => return DefectName::default(),
        SiteKind::Vacancy => format!("vacancy_{symbol}"),
        SiteKind::Substitution => format!("substitution_{symbol}"),
    };
    DefectName::from_ascii(&name).unwrap_or_default()
}

/// Writes the parts of a boundary that lie in the built field.
fn write_boundary(
    boundary: &Boundary,
    phases: &[String],
    built: &Region,
    origin: [f64; 2],
    writer: &WorldWriter,
) -> Result<()> {
    let shifted = |[x, y]: [f64; 2]| [(x - origin[0]) as f32, (y - origin[1]) as f32];
    let mut lines: Vec<Vec<[f64; 2]>> = Vec::new();
    for ends in boundary.line_nm.windows(2) {
        let Some([from, to]) = clip([ends[0], ends[1]], built) else { continue };
        match lines.last_mut() {
            Some(line) if line.last() == Some(&from) => line.push(to),
            _ => lines.push(vec![from, to]),
        }
    }
    let name = |phase: usize| phases.get(phase).map_or("", String::as_str);
    let kind = match boundary.kind {
        BoundaryKind::Grain { misorientation_deg, sigma } => {
            LineKind::Grains(misorientation_deg, sigma)
        }
        BoundaryKind::Phase { sides, sharpness_sigma_nm } => {
            LineKind::Phases(sides.map(name), sharpness_sigma_nm)
        }
    };
    for line in lines {
        let points: Vec<[f32; 2]> = line.into_iter().map(shifted).collect();
        writer.boundary(&points, kind)?;
    }
    Ok(())
}

/// The part of a segment inside a region (Liang and Barsky).
fn clip([a, b]: [[f64; 2]; 2], region: &Region) -> Option<[[f64; 2]; 2]> {
    let (mut from, mut to) = (0.0f64, 1.0f64);
    for (k, limits) in [region.x, region.y].into_iter().enumerate() {
        let d = b[k] - a[k];
        if d == 0.0 {
            if !(limits[0]..limits[1]).contains(&a[k]) {
                return None;
            }
            continue;
        }
        let cut = limits.map(|l| (l - a[k]) / d);
        from = from.max(cut[0].min(cut[1]));
        to = to.min(cut[0].max(cut[1]));
    }
    let at = |t: f64| match t {
        0.0 => a,
        1.0 => b,
        _ => [a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])],
    };
    (from < to).then(|| [at(from), at(to)])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn segments_are_clipped_to_the_region() {
        let region = Region { x: [0.0, 4.0], y: [0.0, 2.0] };
        assert_eq!(clip([[1.0, -5.0], [1.0, 5.0]], &region), Some([[1.0, 0.0], [1.0, 2.0]]));
        assert_eq!(clip([[5.0, -5.0], [5.0, 5.0]], &region), None);
        assert_eq!(clip([[-2.0, 1.0], [2.0, 1.0]], &region), Some([[0.0, 1.0], [2.0, 1.0]]));
        assert_eq!(clip([[1.0, 1.0], [2.0, 1.5]], &region), Some([[1.0, 1.0], [2.0, 1.5]]));
    }
}
