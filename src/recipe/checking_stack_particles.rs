//! Limits of the tables `[[stack.particles]]`, and the forms and orientations of the particles.

use super::checking_extended::{check_place, item_key};
use super::checking_stack::check_whole;
use super::fault::{Checked, crystal_fault, fault, within};
use super::stack_table::{ParticleShape, ParticleSide, StackDirection, StackParticles, StackTable};
use super::stacked_crystals::{CheckedParticles, ParticleForm, ParticleOrientation};
use super::tables::Field;
use crate::models::particles::Metal;
use crate::models::particles::facets::{Facet, Polyhedron};
use crate::models::particles::rotation::Rotation;
use crate::structure::lattice::{Vec3, dot, norm, plane_normal, row_times};
use crate::structure::{Structure, direction};

/// Least and greatest diameter of a particle in nm.
const DIAMETERS_NM: [f64; 2] = [0.8, 30.0];
/// Greatest diameter in nm of the clusters that are searched for.
const GREATEST_CLUSTER_NM: f64 = 10.0;
/// Largest number of particles of a table.
const MOST_PARTICLES: usize = 10_000;
/// Largest cosine between two directions that should be perpendicular.
const TILTED: f64 = 2e-3;
/// Without effect on icosahedra and decahedra.
const ANY_RATIO: f64 = 1.19;

/// Checks the particles; returns their forms and orientations.
pub fn check_stack_particles(table: &StackTable, field: &Field) -> Checked<Vec<CheckedParticles>> {
    if table.along != StackDirection::Z && !table.particles.is_empty() {
        let expected = "particles lie on a face across the beam; expected along = \"z\"";
        return fault("stack.along", format!("{:?}", table.along).to_lowercase(), expected);
    }
    let phases = table.phases();
    let one = |(n, given): (usize, &StackParticles)| {
        let key = |name: &str| item_key("particles", n, name);
        check_room(n, given, table, field)?;
        check_keys(n, given)?;
        let structure = given.crystal.structure().map_err(|e| crystal_fault(&key("crystal"), e))?;
        check_whole(&key("crystal"), &structure)?;
        let form = form(n, given, &structure)?;
        let orientation = orientation(n, given, &structure)?;
        let form = cut(n, given, form, orientation)?;
        let phase = phases.iter().position(|name| *name == given.phase()).unwrap_or(0);
        Ok(CheckedParticles { phase, structure, form, orientation })
    };
    table.particles.iter().enumerate().map(one).collect()
}

/// Checks sizes, numbers and places.
fn check_room(n: usize, given: &StackParticles, table: &StackTable, field: &Field) -> Checked {
    let key = |name: &str| item_key("particles", n, name);
    let [low, high] = given.diameter_nm;
    let greatest = given.shape.cluster().map_or(DIAMETERS_NM[1], |_| GREATEST_CLUSTER_NM);
    within(&key("diameter_nm"), low, DIAMETERS_NM[0], greatest)?;
    within(&key("diameter_nm"), high, DIAMETERS_NM[0], greatest)?;
    if low > high {
        let expected = "expected the least diameter first, then the greatest";
        return fault(&key("diameter_nm"), format!("[{low}, {high}]"), expected);
    }
    within(&key("gap_nm"), given.gap_nm, 0.2, 100.0)?;
    if let Some(contact) = given.contact_angstrom {
        within(&key("contact_angstrom"), contact, 1.0, 5.0)?;
    }
    match given.count {
        Some(_) if !given.positions_nm.is_empty() => {
            let expected = "positions_nm gives their number; leave out one of the two";
            return fault(&key("count"), given.number(), expected);
        }
        Some(count) if !(1..=MOST_PARTICLES).contains(&count) => {
            let expected = format!("expected 1 to {MOST_PARTICLES} particles");
            return fault(&key("count"), count, expected);
        }
        _ => {}
    }
    given.positions_nm.iter().try_for_each(|at| check_place(&key("positions_nm"), *at, field))?;
    let room = match given.side {
        ParticleSide::Entrance => table.begin_nm,
        ParticleSide::Exit => {
            let thick: Option<f64> = table.layers.iter().map(|layer| layer.thickness_nm).sum();
            thick.map_or(0.0, |thick| field.thickness_nm - table.begin_nm - thick)
        }
    };
    if room < 0.3 * high {
        let (name, what) = match given.side {
            ParticleSide::Entrance => ("begin_nm", "raise stack.begin_nm and field.thickness_nm"),
            ParticleSide::Exit => {
                ("layers", "give the last layer its thickness_nm, and raise field.thickness_nm")
            }
        };
        let expected = format!(
            "there are {:.2} nm of vacuum for particles of up to {high} nm on this side; {what}",
            room.max(0.0)
        );
        return fault(&format!("stack.{name}"), format!("{:.2} nm", room.max(0.0)), expected);
    }
    Ok(())
}

/// Refuses values that have no meaning beside others.
fn check_keys(n: usize, given: &StackParticles) -> Checked {
    let key = |name: &str| item_key("particles", n, name);
    let cluster = given.shape.cluster().is_some();
    let energies = !given.surface_energies.is_empty();
    let shape = given.shape.name();
    let refused = [
        (
            "surface_energies",
            energies && given.shape != ParticleShape::Wulff,
            "only shape = \"wulff\" has surface energies; leave them out",
        ),
        (
            "contact_energy",
            given.contact_energy.is_some()
                && (given.shape != ParticleShape::Wulff || given.contact_plane.is_none()),
            "expected it for shape = \"wulff\" with a contact_plane",
        ),
        (
            "zone_axis",
            given.zone_axis.is_some() && cluster,
            "this shape consists of several crystals; leave it out, or limit max_tilt_deg between the beam and the axes of the shape",
        ),
        (
            "contact_plane",
            given.contact_plane.is_some() && (cluster || given.zone_axis.is_some()),
            "expected either zone_axis or contact_plane, for a particle that is one crystal",
        ),
        (
            "y_axis",
            given.y_axis.is_some() && given.zone_axis.is_none() && given.contact_plane.is_none(),
            "expected it beside a zone_axis or a contact_plane",
        ),
        (
            "max_tilt_deg",
            given.max_tilt_deg.is_some() && given.zone_axis.is_none() && !cluster,
            "expected it beside a zone_axis",
        ),
    ];
    if let Some((name, _, expected)) = refused.iter().find(|(_, refused, _)| *refused) {
        return fault(&key(name), format!("(given, shape = \"{shape}\")"), *expected);
    }
    if let Some(tilt) = given.max_tilt_deg {
        within(&key("max_tilt_deg"), tilt, 0.0, 180.0)?;
    }
    Ok(())
}

fn form(n: usize, given: &StackParticles, structure: &Structure) -> Checked<ParticleForm> {
    let Some(morphology) = given.shape.cluster() else {
        return match given.shape {
            ParticleShape::Sphere => Ok(ParticleForm::Sphere),
            _ => polyhedron(n, given, structure),
        };
    };
    let key = item_key("particles", n, "crystal");
    let (_, metal) = Metal::of(structure, ANY_RATIO).map_err(|e| crystal_fault(&key, e))?;
    Ok(ParticleForm::Cluster(morphology, metal))
}

fn polyhedron(n: usize, given: &StackParticles, structure: &Structure) -> Checked<ParticleForm> {
    let key = item_key("particles", n, "surface_energies");
    if given.surface_energies.is_empty() {
        let expected = "the polyhedron of least surface energy needs the energies of its planes, such as { \"(111)\" = 1.28, \"(100)\" = 1.63 } in J/m2; \
                        or choose shape = \"sphere\"";
        return fault(&key, "(missing)", expected);
    }
    let mut families = Vec::new();
    for (plane, energy) in &given.surface_energies {
        let named = format!("{key}.\"{plane}\"");
        within(&named, *energy, 1e-3, 1e3)?;
        match direction::parse_plane(plane) {
            Ok(miller) => families.push((miller, *energy)),
            Err(expected) => return fault(&key, plane, expected),
        }
    }
    let unit = Polyhedron::of_families(structure, &families).or_else(|twice| {
        let plane = given.surface_energies.keys().nth(twice);
        let expected = "the symmetry of the crystal makes it equal to another plane of the list; leave one out";
        fault(&key, plane.map_or("", String::as_str), expected)
    })?;
    match unit.volume() {
        Some(_) => Ok(ParticleForm::Wulff(unit)),
        None => {
            let listed: Vec<&str> = given.surface_energies.keys().map(String::as_str).collect();
            let expected = "these planes and what the symmetry of the crystal makes of them bound no finite particle; expected planes to all sides";
            fault(&key, listed.join(", "), expected)
        }
    }
}

fn orientation(
    n: usize,
    given: &StackParticles,
    structure: &Structure,
) -> Checked<ParticleOrientation> {
    let key = |name: &str| item_key("particles", n, name);
    let along = match (&given.zone_axis, &given.contact_plane) {
        (Some(zone), _) => match direction::parse(zone) {
            Ok(indices) => row_times(indices.map(f64::from), &structure.cell),
            Err(expected) => return fault(&key("zone_axis"), zone, expected),
        },
        (None, Some(plane)) => match direction::parse_plane(plane) {
            // The layers lie behind a particle on the side of the gun.
            Ok(miller) => plane_normal(&structure.cell, miller).map(|v| given.side.inward() * v),
            Err(expected) => return fault(&key("contact_plane"), plane, expected),
        },
        (None, None) => {
            let near = given.max_tilt_deg.map(ParticleOrientation::ZoneAxes);
            return Ok(near.unwrap_or(ParticleOrientation::Any));
        }
    };
    let upright = Rotation::to_z(along);
    let max_tilt_deg = given.max_tilt_deg.unwrap_or(0.0);
    let Some(text) = &given.y_axis else {
        return Ok(ParticleOrientation::Axis { rotation: upright, turned: true, max_tilt_deg });
    };
    let up: Vec3 = match direction::parse(text) {
        Ok(indices) => row_times(indices.map(f64::from), &structure.cell),
        Err(expected) => return fault(&key("y_axis"), text, expected),
    };
    let cosine = dot(up, along) / (norm(up) * norm(along));
    if cosine.abs() > TILTED {
        let expected = format!(
            "it encloses {:.2} degrees with the {}; expected a perpendicular direction",
            cosine.abs().min(1.0).acos().to_degrees(),
            if given.zone_axis.is_some() { "zone axis" } else { "normal of the contact plane" }
        );
        return fault(&key("y_axis"), text, expected);
    }
    let [x, y, _] = upright.apply(up);
    let turn = libm::atan2(x, y);
    let rotation = Rotation::about([0.0, 0.0, 1.0], turn).after(upright);
    Ok(ParticleOrientation::Axis { rotation, turned: false, max_tilt_deg })
}

/// Cuts a polyhedron at its contact plane, and gives it unit volume (W. L. Winterbottom, Acta Metall. 15, 303 (1967)).
fn cut(
    n: usize,
    given: &StackParticles,
    form: ParticleForm,
    orientation: ParticleOrientation,
) -> Checked<ParticleForm> {
    let ParticleForm::Wulff(mut unit) = form else { return Ok(form) };
    if let (Some(energy), ParticleOrientation::Axis { rotation, .. }) =
        (given.contact_energy, orientation)
    {
        let normal = rotation.inverse().apply([0.0, 0.0, given.side.inward()]);
        // The cut replaces the facet of its own plane.
        unit.facets.retain(|facet| dot(facet.normal, normal) < 1.0 - 1e-6);
        unit = unit.cut(Facet { normal, distance: energy });
    }
    match unit.volume() {
        Some(volume) => Ok(ParticleForm::Wulff(unit.scaled(1.0 / libm::cbrt(volume)))),
        None => {
            let key = item_key("particles", n, "contact_energy");
            let expected = "nothing of the particle is left; expected more than the negative surface energy of the contact plane";
            fault(&key, given.contact_energy.unwrap_or(0.0), expected)
        }
    }
}
