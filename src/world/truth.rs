//! Writes the ground truth of the built field, stripe by stripe.

use super::field_recording::{FieldRecording, region_of};
use crate::acquisition::{ScanFrame, ScanPath};
use crate::error::Result;
use crate::imaging::pixels::PixelRect;
use crate::io::schema::{CompositionText, DefectName, MorphologyName};
use crate::io::{
    DislocationRow, LayerRow, LineKind, ParticleBatch, TruthBatch, TruthWriter, WorldWriter,
    atom_type,
};
use crate::plane;
use crate::progress::Progress;
use crate::recipe::{Field, Region};
use crate::specimen::stripes::for_each_stripe;
use crate::specimen::{Boundary, BoundaryKind, SiteKind, Sites, Specimen};
use crate::world::region_truth::{
    ColumnTruth, SiteTruth, boundary_parts, list, phase_map, phases_of_points,
};

/// Numbers of sites and columns in the ground truth.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[non_exhaustive]
pub struct Counts {
    /// Lattice sites.
    pub sites: u64,
    /// Vacant sites.
    pub vacancies: u64,
    /// Sites that hold another element.
    pub substitutions: u64,
    /// Atomic columns.
    pub columns: u64,
}

/// Writes sites, columns, boundaries, phases and particles; for a recording along `path` also its drift, and where columns appear.
///
/// # Errors
/// Errors of the writer, and [`crate::Error::Interrupted`].
pub(crate) fn write(
    specimen: &dyn Specimen,
    field: &Field,
    writer: &WorldWriter,
    path: Option<&ScanPath>,
    progress: &dyn Progress,
) -> Result<Counts> {
    let writer = writer.truth();
    let width = field.pixels(field.built_grid())[1];
    let (first, pixel) = (field.crop_origin_px(), field.pixel_nm());
    let origin = field.origin_nm();
    let phases = &specimen.facts().phases;
    if phases.len() > 1 {
        writer.create_phase_map(phases)?;
    }
    let interfaces = interfaces_of(specimen);
    let mut counts = Counts::default();
    for_each_stripe(specimen, field, "ground truth", progress, |stripe| {
        let batch = batch(&stripe.sites, origin, &mut counts);
        writer.append(&batch)?;
        if !interfaces.is_empty() {
            let distances =
                batch.column_positions.iter().map(|p| distance(&interfaces, *p, origin));
            writer.append_interface_distances(&distances.collect::<Vec<_>>())?;
        }
        if let Some(path) = path {
            let places = batch.column_positions.iter().map(|p| appearance(path, *p));
            writer.append_appearances(&places.collect::<Vec<_>>())?;
        }
        if phases.len() > 1 {
            let corner = [first[0] + stripe.rows.start, first[1]];
            let pixels = PixelRect::new(corner, [stripe.rows.len(), width]);
            let map = phase_map(specimen, &pixels, pixel);
            writer.phase_rows(stripe.rows.start, map.view())?;
        }
        Ok(())
    })?;
    write_lines_and_particles(specimen, &field.built_region(), origin, writer)?;
    if let Some(path) = path {
        writer.drift(&path.drift_curve())?;
    }
    Ok(counts)
}

/// Computes where a column at (x, y) in nm appears, in pixels: the mean of all frames.
fn appearance(path: &ScanPath, position_nm: [f32; 2]) -> [f32; 2] {
    let position_nm = position_nm.map(f64::from);
    let frames = path.frames();
    let sum = (0..frames).fold([0.0; 2], |sum, frame| {
        let at = path.appearance_px(frame, position_nm);
        [sum[0] + at[0], sum[1] + at[1]]
    });
    sum.map(|s| (s / frames as f64) as f32)
}

/// Writes the truth of a recording: its sites and columns, and the phases, boundaries and particles in it. `origin_nm` is the place of its
/// first pixel in the full field.
///
/// # Errors
/// Errors of the writer.
pub(crate) fn write_recorded(
    specimen: &dyn Specimen,
    recording: &FieldRecording,
    origin_nm: [f64; 2],
    writer: &TruthWriter,
) -> Result<()> {
    let ScanFrame { shape, pixel_nm, .. } = recording.frame;
    let batch = batch_of(&recording.sites, &recording.columns);
    writer.append(&batch)?;
    let interfaces = interfaces_of(specimen);
    if !interfaces.is_empty() {
        let distances = batch.column_positions.iter().map(|p| distance(&interfaces, *p, origin_nm));
        writer.append_interface_distances(&distances.collect::<Vec<_>>())?;
    }
    let places = &recording.position_in_image;
    match recording.options.keep_frames {
        true => writer.appearances_of_frames(places)?,
        false => {
            let mean = places.index_axis(ndarray::Axis(0), 0);
            let pairs = mean.outer_iter().map(|p| [p[0] as f32, p[1] as f32]);
            writer.append_appearances(&pairs.collect::<Vec<_>>())?;
        }
    }
    writer.drift(&recording.drift)?;
    let phases = &specimen.facts().phases;
    if phases.len() > 1 {
        writer.create_phase_map(phases)?;
        let map = phases_of_points(specimen, shape, |row, column| {
            [origin_nm[0] + column as f64 * pixel_nm, origin_nm[1] + row as f64 * pixel_nm]
        });
        writer.phase_rows(0, map.view())?;
    }
    let frame = ScanFrame { origin_nm, ..recording.frame };
    write_lines_and_particles(specimen, &region_of(&frame), origin_nm, writer)
}

fn write_lines_and_particles(
    specimen: &dyn Specimen,
    region: &Region,
    origin: [f64; 2],
    writer: &TruthWriter,
) -> Result<()> {
    let phases = &specimen.facts().phases;
    for boundary in specimen.boundaries() {
        write_boundary(&boundary, phases, region, origin, writer)?;
    }
    write_stack(specimen, region, origin, writer)?;
    let clusters = &specimen.facts().clusters_nm;
    if !clusters.is_empty() {
        let inside = clusters.iter().filter(|centre| region.contains(**centre));
        let place = |centre: &[f64; 2]| plane::sub(*centre, origin).map(|nm| nm as f32);
        writer.clusters(&inside.map(place).collect::<Vec<_>>())?;
    }
    write_particles(specimen, region, origin, writer)
}

/// Returns the interfaces of a stack that are seen edge on; none for other specimens.
fn interfaces_of(specimen: &dyn Specimen) -> Vec<Vec<[f64; 2]>> {
    if specimen.facts().stack.is_none() {
        return Vec::new();
    }
    let all = specimen.boundaries().into_iter();
    all.filter(|b| matches!(b.kind, BoundaryKind::Phase { .. })).map(|b| b.line_nm).collect()
}

/// Computes the distance of a column at (x, y) in nm from `origin` to the nearest line, in nm.
fn distance(lines: &[Vec<[f64; 2]>], position_nm: [f32; 2], origin: [f64; 2]) -> f32 {
    let at = plane::add(position_nm.map(f64::from), origin);
    let segments = lines.iter().flat_map(|line| line.windows(2));
    let to = |ends: &[[f64; 2]]| {
        let [a, b] = [ends[0], ends[1]];
        let along = [b[0] - a[0], b[1] - a[1]];
        let from = [at[0] - a[0], at[1] - a[1]];
        let square = along[0] * along[0] + along[1] * along[1];
        let share =
            if square > 0.0 { (from[0] * along[0] + from[1] * along[1]) / square } else { 0.0 };
        let share = share.clamp(0.0, 1.0);
        (from[0] - share * along[0]).powi(2) + (from[1] - share * along[1]).powi(2)
    };
    segments.map(to).fold(f64::INFINITY, f64::min).sqrt() as f32
}

/// Writes the layers of a stack, and its dislocations in a region.
fn write_stack(
    specimen: &dyn Specimen,
    region: &Region,
    origin: [f64; 2],
    writer: &TruthWriter,
) -> Result<()> {
    let Some(stack) = &specimen.facts().stack else { return Ok(()) };
    let offset = [origin[0], origin[1], 0.0][stack.axis];
    let layer = |layer: &crate::specimen::LayerTruth| {
        let range = [layer.begin_nm, layer.end_nm].map(|nm| (nm - offset) as f32);
        let strain = layer.strain.map(|s| s as f32);
        LayerRow::new(&stack.phases[layer.phase], range, strain, layer.turn_deg as f32)
    };
    let layers: Vec<LayerRow> = stack.layers.iter().map(layer).collect();
    writer.layers(&layers, stack.axis)?;
    let inside = stack.dislocations.iter().filter(|d| region.contains(d.position_nm));
    let rows: Vec<DislocationRow> = inside
        .map(|d| {
            let place = plane::sub(d.position_nm, origin).map(|nm| nm as f32);
            DislocationRow::new(place, d.burgers_nm.map(|b| b as f32))
        })
        .collect();
    if rows.is_empty() { Ok(()) } else { writer.dislocations(&rows) }
}

fn batch(sites: &Sites, origin: [f64; 2], counts: &mut Counts) -> TruthBatch {
    let (listed, columns) = list(sites, origin, counts.columns as usize);
    for column in &columns {
        counts.vacancies += u64::from(column.vacancies);
        counts.substitutions += u64::from(column.substitutions);
    }
    counts.sites += listed.len() as u64;
    counts.columns += columns.len() as u64;
    batch_of(&listed, &columns)
}

fn batch_of(listed: &[SiteTruth], columns: &[ColumnTruth]) -> TruthBatch {
    let mut batch = TruthBatch::default();
    for site in listed {
        let [x, y, z] = site.position_nm;
        batch.positions.push([x, y]);
        batch.z.push(z);
        batch.types.push(atom_type::code(site.kind));
        batch.defects.push(site.kind != SiteKind::Pristine);
        batch.numbers.push(i32::from(site.number));
        let name = DefectName::from_ascii(&site.defect_name());
        batch.defect_names.push(name.unwrap_or_default());
        batch.columns.push(site.column as i32);
    }
    for column in columns {
        batch.column_positions.push(column.position_nm);
        let numbers = [column.sites, column.vacancies, column.substitutions];
        batch.column_counts.iter_mut().zip(numbers).for_each(|(to, n)| to.push(n as i32));
        let composition = CompositionText::from_ascii(&column.composition());
        batch.column_compositions.push(composition.unwrap_or_default());
    }
    batch
}

/// Writes the particles that reach into the built field.
fn write_particles(
    specimen: &dyn Specimen,
    built: &Region,
    origin: [f64; 2],
    writer: &TruthWriter,
) -> Result<()> {
    if specimen.facts().particle_outlines.is_empty() {
        return Ok(());
    }
    let mut batch = ParticleBatch::default();
    for particle in specimen.particles_reaching(built) {
        let [x, y, z] = particle.centre_nm;
        batch.centres.push([(x - origin[0]) as f32, (y - origin[1]) as f32, z as f32]);
        batch.diameters.push(particle.diameter_nm as f32);
        let morphology = MorphologyName::from_ascii(&particle.morphology);
        batch.morphologies.push(morphology.unwrap_or_default());
        batch.orientations.push(particle.orientation.map(|q| q as f32));
    }
    writer.particles(&batch)
}

/// Writes the parts of a boundary that lie in the built field.
fn write_boundary(
    boundary: &Boundary,
    phases: &[String],
    built: &Region,
    origin: [f64; 2],
    writer: &TruthWriter,
) -> Result<()> {
    let shifted = |[x, y]: [f64; 2]| [(x - origin[0]) as f32, (y - origin[1]) as f32];
    let name = |phase: usize| phases.get(phase).map_or("", String::as_str);
    let kind = match boundary.kind {
        BoundaryKind::Grain { misorientation_deg, sigma } => {
            LineKind::Grains(misorientation_deg, sigma)
        }
        BoundaryKind::Phase { sides, sharpness_sigma_nm } => {
            LineKind::Phases(sides.map(name), sharpness_sigma_nm)
        }
        BoundaryKind::Fault { kind, normal, shift_nm } => {
            LineKind::Fault { kind, normal, shift_nm }
        }
    };
    for line in boundary_parts(boundary, built) {
        let points: Vec<[f32; 2]> = line.into_iter().map(shifted).collect();
        writer.boundary(&points, kind)?;
    }
    Ok(())
}
