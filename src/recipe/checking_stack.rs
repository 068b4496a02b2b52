//! Limits of the table `[stack]`, and the places of its layers.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::atoms_table::NO_CRYSTAL;
use super::checking_amorphous::packing;
use super::checking_defects::check_defects;
use super::checking_extended::{check_dislocations, check_faults, check_precipitates};
use super::checking_interfaces::{check_exchange, check_roughness};
use super::checking_stack_particles::check_stack_particles;
use super::checking_vacancy_groups::{check_double_vacancies, check_edges, check_lines};
use super::fault::{Checked, crystal_fault, fault, needed, within};
use super::limits::BEYOND_FIELD_NM;
use super::oriented_crystals::{OrientedCrystals, oriented_box};
use super::resolved_recipe::Recipe;
use super::stack_table::{
    DEFAULT_POISSON_RATIO, LayerFit, MOST_PARTS, StackDirection, StackLayer, StackTable,
};
use super::stacked_crystals::{
    CheckedParticles, FittedCrystal, PlacedPrecipitate, StackedCrystals, StackedLayer,
    StackedMatter,
};
use super::tables::Field;
use crate::lengths;
use crate::models::stack::Isometry;
use crate::models::stack::atomic_planes::{AtomicPlane, atomic_planes, parse_formula};
use crate::models::stack::lattice_fit::{CellMatch, closest, coherent, coincident, normal_strain};
use crate::models::stack::layer_places::{LayerMatter, layer_places};
use crate::models::stack::least_distances::LeastDistances;
use crate::models::stack::random_packing::Packing;
use crate::structure::{Structure, elements};

/// Angstrom in a nm.
const PER_NM: f64 = 10.0;
/// Least thickness of a layer in nm.
const THINNEST_NM: f64 = 0.3;
/// Greatest thickness of a specimen along the beam in nm.
const THICKEST_NM: f64 = 1000.0;
/// Largest number of atoms of a specimen that is held in memory.
const MOST_ATOMS: f64 = 1e7;

/// Returns the key of a value of a layer, which counts from 1.
pub fn layer_key(index: usize, name: &str) -> String {
    format!("stack.layers[{}].{name}", index + 1)
}

/// Checks the table of a stack; returns its layers in their places, and all elements that the specimen may hold.
pub fn check_stack(recipe: &Recipe) -> Checked<(OrientedCrystals, Vec<String>)> {
    if recipe.zone_axis != NO_CRYSTAL || recipe.y_axis.is_some() {
        let expected =
            "each layer of a stack has its own zone_axis and y_axis; expected none beside them";
        return fault("zone_axis", &recipe.zone_axis, expected);
    }
    if recipe.crystal.name != NO_CRYSTAL || recipe.crystal.text.is_some() {
        let expected = "each layer of a stack has its own crystal; expected none beside them";
        return fault("crystal", &recipe.crystal.name, expected);
    }
    let table = needed("stack", recipe.stack.as_ref())?;
    within("field.thickness_nm", recipe.field.thickness_nm, 0.2, THICKEST_NM)?;
    within("stack.max_strain", table.max_strain, 0.0, 0.2)?;
    check_begin(table, &recipe.field)?;
    check_numbers(table)?;
    for (n, layer) in table.layers.iter().enumerate() {
        check_layer(table, n, layer)?;
    }
    let mut crystals = read_crystals(table)?;
    fit_layers(table, &mut crystals)?;
    let (nominal, end) = heights(table, &recipe.field)?;
    let mut layers = laid(table, crystals, &recipe.field, &nominal)?;
    check_roughness(table, &recipe.field)?;
    check_exchange(table, &layers)?;
    check_faults(table, &mut layers, &recipe.field)?;
    check_edges(table, &mut layers, &recipe.field)?;
    let dislocations = check_dislocations(table, &layers, &recipe.field)?;
    let lines = check_lines(table, &layers, &recipe.field)?;
    check_double_vacancies(table, &layers)?;
    let precipitates = check_precipitates(table, &recipe.field)?;
    let particles = check_stack_particles(table, &recipe.field)?;
    check_atoms(&layers, end, table, &recipe.field)?;
    let (least, mut symbols) = distances_and_elements(&layers, &precipitates, &particles);
    let bounded = layers.len() > 1
        || !table.faults.is_empty()
        || !table.dislocations.is_empty()
        || !table.edges.is_empty();
    check_point_defects_of_stacks(recipe, bounded)?;
    check_defects(recipe, &mut symbols)?;
    symbols.sort();
    symbols.dedup();
    let phases = table.phases();
    let stack = StackedCrystals {
        phases,
        layers,
        end,
        dislocations,
        precipitates,
        particles,
        lines,
        least,
    };
    Ok((OrientedCrystals::Stack(Arc::new(stack)), symbols))
}

/// Refuses what vacancies of stacks do not have.
fn check_point_defects_of_stacks(recipe: &Recipe, bounded: bool) -> Checked {
    let Some(vacancies) = &recipe.vacancies else { return Ok(()) };
    if vacancies.relaxation_angstrom != 0.0 {
        let expected = "expected 0: the atoms of a stack do not relax";
        return fault("vacancies.relaxation_angstrom", vacancies.relaxation_angstrom, expected);
    }
    if vacancies.clusters > 0 {
        let expected = "expected 0: vacancies of a stack gather at its interfaces, faults, edges and dislocations";
        return fault("vacancies.clusters", vacancies.clusters, expected);
    }
    if vacancies.cluster_fraction > 0.0 && !bounded {
        let expected = "expected 0: this stack has no interface, fault, edge or dislocation at which vacancies gather";
        return fault("vacancies.cluster_fraction", vacancies.cluster_fraction, expected);
    }
    Ok(())
}

/// Returns the least distances of the atoms of a stack, and the symbols of its elements.
fn distances_and_elements(
    layers: &[StackedLayer],
    precipitates: &[PlacedPrecipitate],
    particles: &[CheckedParticles],
) -> (LeastDistances, Vec<String>) {
    let boxes = || {
        let of_layers = layers.iter().filter_map(|layer| match &layer.matter {
            StackedMatter::Crystal(crystal) => Some(&crystal.structure),
            StackedMatter::Amorphous(_) => None,
        });
        let of_precipitates = precipitates.iter().map(|p| &p.crystal.structure);
        of_layers.chain(of_precipitates).chain(particles.iter().map(|p| &p.structure))
    };
    let glasses = layers.iter().filter_map(|layer| match &layer.matter {
        StackedMatter::Amorphous(packing) => Some(packing),
        StackedMatter::Crystal(_) => None,
    });
    let (numbers, given) = elements_and_distances(boxes(), glasses);
    let least = LeastDistances::new(boxes(), &given, &numbers);
    let mut symbols: Vec<String> =
        numbers.iter().map(|z| elements::symbol(*z).to_owned()).collect();
    symbols.sort();
    (least, symbols)
}

fn check_begin(table: &StackTable, field: &Field) -> Checked {
    match table.along {
        StackDirection::Z => {
            within("stack.begin_nm", table.begin_nm, 0.0, field.thickness_nm - THINNEST_NM)
        }
        _ if table.begin_nm != 0.0 => {
            let expected = "only a stack along z has vacuum before its first layer; leave it out, or give along = \"z\"";
            fault("stack.begin_nm", table.begin_nm, expected)
        }
        _ => Ok(()),
    }
}

fn check_numbers(table: &StackTable) -> Checked {
    let lists = [
        ("stack.layers", table.layers.len(), 1),
        ("stack.faults", table.faults.len(), 0),
        ("stack.dislocations", table.dislocations.len(), 0),
        ("stack.precipitates", table.precipitates.len(), 0),
        ("stack.particles", table.particles.len(), 0),
        ("stack.edges", table.edges.len(), 0),
        ("stack.vacancy_lines", table.vacancy_lines.len(), 0),
        ("stack.double_vacancies", table.double_vacancies.len(), 0),
    ];
    for (key, count, least) in lists {
        if !(least..=MOST_PARTS).contains(&count) {
            let expected = format!("expected {least} to {MOST_PARTS} tables [[{key}]]");
            return fault(key, format!("{count} tables"), expected);
        }
    }
    let names = table.phases();
    let unfit =
        names.iter().find(|n| n.is_empty() || !n.is_ascii() || n.len() > 32 || n.contains(','));
    match unfit {
        Some(name) => fault(
            "stack.layers",
            format!("phase {name:?}"),
            "expected a name of 1 to 32 ASCII characters without commas; give the layer a name",
        ),
        None => Ok(()),
    }
}

/// Checks the values of a layer that need no crystal.
fn check_layer(table: &StackTable, n: usize, layer: &StackLayer) -> Checked {
    let key = |name: &str| layer_key(n, name);
    let last = n + 1 == table.layers.len();
    match layer.thickness_nm {
        Some(nm) => within(&key("thickness_nm"), nm, THINNEST_NM, 5000.0)?,
        None if last => {}
        None => {
            let expected = "only the last layer may leave it out; it then ends with the field";
            return fault(&key("thickness_nm"), "(missing)", expected);
        }
    }
    check_keys(n, layer)?;
    if let Some(shift) = layer.shift_cells {
        shift.iter().try_for_each(|s| within(&key("shift_cells"), *s, -1.0, 1.0))?;
    }
    if let Some(ratio) = layer.poisson_ratio {
        within(&key("poisson_ratio"), ratio, 0.0, 0.499)?;
    }
    check_turn(table, n, layer)?;
    let of_interface = [
        ("roughness_nm", layer.roughness_nm.is_some()),
        ("interdiffusion_nm", layer.interdiffusion_nm.is_some()),
    ];
    match of_interface.iter().find(|(_, given)| *given && n == 0) {
        Some((name, _)) => {
            let expected = "it describes the interface at which a layer begins, and the first layer has none; give it in the next layer";
            fault(&key(name), "(given)", expected)
        }
        None => Ok(()),
    }
}

/// Refuses turned layers where lattices should fit or continue.
fn check_turn(table: &StackTable, n: usize, layer: &StackLayer) -> Checked {
    let Some(turn) = layer.turn_deg else { return Ok(()) };
    let key = layer_key(n, "turn_deg");
    within(&key, turn, -360.0, 360.0)?;
    let expected = if table.along != StackDirection::Z {
        "only layers across the beam can be turned; expected along = \"z\""
    } else if n > 0 && layer.fit != LayerFit::Misfit {
        "a turned lattice cannot fit the first crystal; expected fit = \"misfit\" beside it"
    } else if table.faults.iter().any(|fault| fault.layer == n + 1) {
        "the planes of faults are seen edge on in layers that are not turned; leave out the faults of this layer"
    } else if !table.dislocations.is_empty() {
        "dislocations extend through all layers; expected none beside turned layers"
    } else {
        return Ok(());
    };
    fault(&key, turn, expected)
}

/// Refuses values that a crystal or amorphous matter does not have.
fn check_keys(n: usize, layer: &StackLayer) -> Checked {
    let key = |name: &str| layer_key(n, name);
    let crystal_keys = [
        ("zone_axis", layer.zone_axis.is_some()),
        ("y_axis", layer.y_axis.is_some()),
        ("first_plane", layer.first_plane.is_some()),
        ("last_plane", layer.last_plane.is_some()),
        ("shift_cells", layer.shift_cells.is_some()),
        ("turn_deg", layer.turn_deg.is_some()),
        ("poisson_ratio", layer.poisson_ratio.is_some()),
    ];
    let glass_keys = [
        ("density_g_per_cm3", layer.density_g_per_cm3.is_some()),
        ("least_distance_angstrom", !layer.least_distance_angstrom.is_empty()),
    ];
    let (foreign, kind): (&[(&str, bool)], _) = match (&layer.crystal, &layer.amorphous) {
        (Some(_), None) => (&glass_keys, "a crystal"),
        (None, Some(_)) => (&crystal_keys, "amorphous matter"),
        _ => {
            let expected = "expected either a crystal or amorphous matter in each layer: crystal = \"srtio3\" or amorphous = \"SiO2\"";
            return fault(&key("crystal"), "(missing, or both)", expected);
        }
    };
    if let Some((name, _)) = foreign.iter().find(|(_, given)| *given) {
        return fault(&key(name), "(given)", format!("{kind} has no such value; leave it out"));
    }
    Ok(())
}

/// Reads the crystal of each layer; `None` for amorphous layers.
fn read_crystals(table: &StackTable) -> Checked<Vec<Option<FittedCrystal>>> {
    let read = |(n, layer): (usize, &StackLayer)| {
        let Some(crystal) = &layer.crystal else { return Ok(None) };
        let zone =
            needed(&layer_key(n, "zone_axis"), layer.zone_axis.as_ref()).map_err(|mut f| {
                f.expected =
                    "a crystal needs the direction along the beam, such as \"[001]\"".into();
                f
            })?;
        let oriented = oriented_box(crystal, zone, layer.y_axis.as_deref())
            .map_err(|e| crystal_fault(&layer_key(n, "crystal"), e))?;
        check_whole(&layer_key(n, "crystal"), &oriented.structure)?;
        Ok(Some(FittedCrystal::new(&oriented)))
    };
    table.layers.iter().enumerate().map(read).collect()
}

/// Refuses crystals with mixed or partly occupied sites.
pub fn check_whole(key: &str, crystal: &Structure) -> Checked {
    match crystal.atoms.iter().find(|atom| atom.occupancy != 1.0) {
        Some(atom) => fault(
            key,
            format!("{} with the occupancy {}", elements::symbol(atom.number), atom.occupancy),
            "expected sites that hold one atom each; draw the atoms of mixed sites first (stemgen simulate does), or use interdiffusion_nm",
        ),
        None => Ok(()),
    }
}

/// Strains each layer to fit the first crystal.
fn fit_layers(table: &StackTable, crystals: &mut [Option<FittedCrystal>]) -> Checked {
    let Some(reference) = crystals.iter().flatten().next().map(FittedCrystal::edges) else {
        return Ok(());
    };
    let axes = table.along.in_plane();
    let mut first = true;
    for (n, crystal) in crystals.iter_mut().enumerate() {
        let Some(crystal) = crystal else { continue };
        if std::mem::replace(&mut first, false) {
            continue;
        }
        let layer = &table.layers[n];
        let own = crystal.edges();
        let mut strain = [0.0; 3];
        for axis in axes {
            let found = fitted(table, n, layer.fit, axis, [own[axis], reference[axis]])?;
            strain[axis] = found.map_or(0.0, |found| found.strain);
        }
        let ratio = layer.poisson_ratio.unwrap_or(DEFAULT_POISSON_RATIO);
        strain[table.along.axis()] = normal_strain(axes.map(|axis| strain[axis]), ratio);
        *crystal = crystal.strained(strain);
    }
    Ok(())
}

/// Fits the lengths of the cells of a layer and of the first crystal along one axis.
fn fitted(
    table: &StackTable,
    n: usize,
    fit: LayerFit,
    axis: usize,
    [own, reference]: [f64; 2],
) -> Checked<Option<CellMatch>> {
    let most = table.max_strain;
    let found = match fit {
        LayerFit::Misfit => return Ok(None),
        LayerFit::Coherent => Some(coherent(own, reference)).filter(|f| f.strain.abs() <= most),
        LayerFit::Coincident => coincident(own, reference, most),
    };
    if found.is_some() {
        return Ok(found);
    }
    let name = ["x", "y", "z"][axis];
    let one = coherent(own, reference);
    let few = coincident(own, reference, most).unwrap_or_else(|| closest(own, reference));
    let choice = match fit {
        LayerFit::Coherent => format!(
            "raise stack.max_strain, or choose fit = \"coincident\" ({}:{} cells fit within {:.2} %) or fit = \"misfit\"",
            few.own,
            few.reference,
            100.0 * few.strain.abs()
        ),
        _ => format!(
            "the best coincidence, {}:{} cells, needs {:.2} %; raise stack.max_strain, or choose fit = \"misfit\"",
            few.own,
            few.reference,
            100.0 * few.strain.abs()
        ),
    };
    let expected = format!(
        "the lattices of this layer and the first crystal differ by {:.2} % along {name} ({own:.3} and {reference:.3} A), and \
         stack.max_strain is {:.2} %; {choice}",
        100.0 * one.strain.abs(),
        100.0 * most
    );
    let value = if fit == LayerFit::Coherent { "coherent" } else { "coincident" };
    fault(&layer_key(n, "fit"), value, expected)
}

/// Returns the nominal heights of the interfaces, and the end of the last layer, in Angstrom along the stack.
fn heights(table: &StackTable, field: &Field) -> Checked<(Vec<f64>, f64)> {
    let [start, whole] = extent(table, field);
    let mut at = start;
    let mut nominal = Vec::new();
    for (n, layer) in table.layers.iter().enumerate() {
        let last = n + 1 == table.layers.len();
        let Some(nm) = layer.thickness_nm else {
            break;
        };
        at += PER_NM * nm;
        if at > whole + 1e-6 || !last && at > whole - PER_NM * THINNEST_NM {
            let expected = format!(
                "the layers up to this one are {:.3} nm thick together, and the field has {:.3} nm along the stack; expected at least {THINNEST_NM} nm for each layer",
                lengths::nm(at - start),
                lengths::nm(whole - start)
            );
            return fault(&layer_key(n, "thickness_nm"), nm, expected);
        }
        if !last {
            nominal.push(at);
        }
    }
    let open = table.layers.last().is_none_or(|layer| layer.thickness_nm.is_none());
    // A layer that ends with the field continues beyond it; along the beam nothing does.
    let beyond = if table.along.axis() == 2 { whole } else { f64::INFINITY };
    Ok((nominal, if open { beyond } else { at }))
}

/// Returns where the stack begins and the field ends along it, in Angstrom.
pub fn extent(table: &StackTable, field: &Field) -> [f64; 2] {
    let region = field.full_region();
    let nm = match table.along.axis() {
        0 => region.x,
        1 => region.y,
        _ => [table.begin_nm, field.thickness_nm],
    };
    nm.map(|nm| PER_NM * nm)
}

/// Puts the layers in their places.
fn laid(
    table: &StackTable,
    crystals: Vec<Option<FittedCrystal>>,
    field: &Field,
    nominal: &[f64],
) -> Checked<Vec<StackedLayer>> {
    let axis = table.along.axis();
    let matter = |(n, crystal): (usize, &Option<FittedCrystal>)| -> Checked<LayerMatter> {
        let Some(crystal) = crystal else { return Ok(LayerMatter::Amorphous) };
        let planes = atomic_planes(&crystal.structure, axis);
        let layer = &table.layers[n];
        let first = plane_index(n, "first_plane", layer.first_plane.as_deref(), &planes)?;
        let last = plane_index(n, "last_plane", layer.last_plane.as_deref(), &planes)?;
        Ok(LayerMatter::Crystal { length: crystal.edges()[axis], planes, first, last })
    };
    let matters: Vec<LayerMatter> =
        crystals.iter().enumerate().map(matter).collect::<Checked<_>>()?;
    let [start, _] = extent(table, field);
    let places = layer_places(&matters, start, nominal).or_else(|n| {
        let expected = "the layer has no room for one of its atomic planes; make it thicker";
        fault(&layer_key(n, "thickness_nm"), table.layers[n].thickness_nm.unwrap_or(0.0), expected)
    })?;
    let phases = table.phases();
    let mut layers = Vec::new();
    for ((n, crystal), place) in crystals.into_iter().enumerate().zip(places) {
        let layer = &table.layers[n];
        let matter = match crystal {
            Some(mut crystal) => {
                crystal.origin[axis] = place.origin;
                let (edges, shift) = (crystal.edges(), layer.shift_cells.unwrap_or([0.0; 2]));
                for (k, shift) in table.along.in_plane().into_iter().zip(shift) {
                    crystal.origin[k] = shift * edges[k];
                }
                StackedMatter::Crystal(crystal)
            }
            None => StackedMatter::Amorphous(packing(n, layer)?),
        };
        let phase = phases.iter().position(|name| *name == layer.phase()).unwrap_or(0);
        layers.push(StackedLayer {
            phase,
            matter,
            begin: place.begin,
            turn: turned(layer, field),
            faults: Vec::new(),
            fault_kinds: Vec::new(),
            edges: Vec::new(),
        });
    }
    Ok(layers)
}

/// Returns the rotation of a layer about the middle of the field.
fn turned(layer: &StackLayer, field: &Field) -> Isometry {
    let region = field.full_region();
    let middle = [region.x, region.y].map(|[low, high]| 0.5 * PER_NM * (low + high));
    layer.turn_deg.map_or(Isometry::IDENTITY, |deg| Isometry::about_beam(deg.to_radians(), middle))
}

/// Finds the plane of a formula.
fn plane_index(
    n: usize,
    name: &str,
    formula: Option<&str>,
    planes: &[AtomicPlane],
) -> Checked<Option<usize>> {
    let Some(text) = formula else { return Ok(None) };
    let wanted = parse_formula(text);
    let found = wanted.ok().and_then(|wanted| planes.iter().position(|p| p.formula == wanted));
    if found.is_some() {
        return Ok(found);
    }
    let mut names: Vec<String> = planes.iter().map(AtomicPlane::name).collect();
    names.sort();
    names.dedup();
    let expected = format!(
        "expected one of the atomic planes of the crystal along the stack: {}",
        names.join(", ")
    );
    fault(&layer_key(n, name), text, expected)
}

/// Collects the elements of a stack, and the least distances in its amorphous layers.
fn elements_and_distances<'c>(
    boxes: impl Iterator<Item = &'c Structure>,
    glasses: impl Iterator<Item = &'c Packing>,
) -> (Vec<u8>, BTreeMap<(u8, u8), f64>) {
    let mut numbers: Vec<u8> =
        boxes.flat_map(|crystal| crystal.atoms.iter().map(|atom| atom.number)).collect();
    let mut given: BTreeMap<(u8, u8), f64> = BTreeMap::new();
    for packing in glasses {
        let own: Vec<u8> = packing.per_angstrom3.iter().map(|(z, _)| *z).collect();
        for (k, a) in own.iter().enumerate() {
            for b in &own[k..] {
                let distance = packing.least.of(*a, *b);
                let known = given.entry((*a, *b)).or_insert(distance);
                *known = known.min(distance);
            }
        }
        numbers.extend(own);
    }
    numbers.sort_unstable();
    numbers.dedup();
    (numbers, given)
}

/// Refuses specimens that do not fit into memory, before they are made.
fn check_atoms(layers: &[StackedLayer], end: f64, table: &StackTable, field: &Field) -> Checked {
    let around = field.full_region().grown(BEYOND_FIELD_NM);
    let lengths =
        [around.x, around.y, [0.0, field.thickness_nm]].map(|[l, h]| [PER_NM * l, PER_NM * h]);
    let axis = table.along.axis();
    let area: f64 =
        table.along.in_plane().iter().map(|k| lengths[*k][1] - lengths[*k][0]).product();
    let mut atoms = 0.0;
    for (n, layer) in layers.iter().enumerate() {
        let begin = if n == 0 && axis != 2 { lengths[axis][0] } else { layer.begin };
        let stop = layers.get(n + 1).map_or(end.min(lengths[axis][1]), |next| next.begin);
        let density = match &layer.matter {
            StackedMatter::Crystal(crystal) => crystal.density(),
            StackedMatter::Amorphous(packing) => packing.per_angstrom3.iter().map(|(_, d)| d).sum(),
        };
        atoms += density * area * (stop - begin).max(0.0);
    }
    if atoms > MOST_ATOMS {
        let expected = format!(
            "about {atoms:.0} atoms lie in the field and {BEYOND_FIELD_NM} nm around it, and at most {MOST_ATOMS:.0} are held in memory; \
             take a smaller field, or a thinner specimen"
        );
        return fault("field.fov_nm", format!("{:?}", field.fov_nm), expected);
    }
    Ok(())
}
