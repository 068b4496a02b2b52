//! Limits of the amorphous layers of a stack.

use std::collections::BTreeMap;

use super::checking_stack::layer_key;
use super::fault::{Checked, fault, within};
use super::stack_table::StackLayer;
use crate::damage::atomic_mass;
use crate::models::stack::atomic_planes::parse_formula;
use crate::models::stack::least_distances::LeastDistances;
use crate::models::stack::random_packing::Packing;
use crate::structure::elements;

/// Atoms in a cubic Angstrom for 1 g/cm3 and one atomic mass unit.
const PER_ANGSTROM3: f64 = 0.602_214_076;

/// Formula, density in g/cm3, and least distances of pairs of elements in Angstrom.
type KnownGlass = (&'static str, f64, &'static [(&'static str, f64)]);

/// Known amorphous matter: formula, density in g/cm3, and least distances in Angstrom.
///
/// SiO2: density 2.20 g/cm3; Si-O 1.62, O-O 2.65, Si-Si 3.12 A (R. L. Mozzi and B. E. Warren, J. Appl. Cryst. 2 (1969) 164). Si: 2.285
/// g/cm3 (J. S. Custer et al., Appl. Phys. Lett. 64 (1994) 437), 2.35 A. C: 2.0 g/cm3, 1.3 A, as the films of this program. The least
/// distances are about 0.92 times the mean distances.
const GLASSES: [KnownGlass; 3] = [
    ("SiO2", 2.20, &[("Si-O", 1.5), ("O-O", 2.35), ("Si-Si", 2.8)]),
    ("Si", 2.285, &[("Si-Si", 2.15)]),
    ("C", 2.0, &[("C-C", 1.3)]),
];

/// Makes the packing of an amorphous layer.
pub fn packing(n: usize, layer: &StackLayer) -> Checked<Packing> {
    let text = layer.amorphous.clone().unwrap_or_default();
    let formula = match parse_formula(&text) {
        Ok(formula) => formula,
        Err(expected) => return fault(&layer_key(n, "amorphous"), text, expected),
    };
    let known =
        GLASSES.iter().find(|(name, ..)| parse_formula(name).ok().as_ref() == Some(&formula));
    let density = match (layer.density_g_per_cm3, known) {
        (Some(density), _) => density,
        (None, Some((_, density, _))) => *density,
        (None, None) => {
            return fault(
                &layer_key(n, "density_g_per_cm3"),
                "(missing)",
                format!("the program knows no density of amorphous {text}; give it"),
            );
        }
    };
    within(&layer_key(n, "density_g_per_cm3"), density, 0.05, 25.0)?;
    let numbers: Vec<u8> = formula.keys().copied().collect();
    let mut distances = BTreeMap::new();
    for (k, a) in numbers.iter().enumerate() {
        for b in &numbers[k..] {
            let distance = least_distance(n, layer, known.map(|(.., list)| *list), [*a, *b])?;
            distances.insert((*a, *b), distance);
        }
    }
    for pair in layer.least_distance_angstrom.keys() {
        let names = |a: &u8, b: &u8| [elements::symbol(*a), elements::symbol(*b)];
        let fits = |(a, b): &(u8, u8)| is_pair(pair, names(a, b));
        if !distances.keys().any(fits) {
            let known: Vec<String> = distances.keys().map(|(a, b)| names(a, b).join("-")).collect();
            let key = layer_key(n, "least_distance_angstrom");
            return fault(&key, pair, format!("pairs of this layer: {}", known.join(", ")));
        }
    }
    let mass: f64 = formula.iter().map(|(z, count)| *count as f64 * atomic_mass(*z)).sum();
    let units = density / mass * PER_ANGSTROM3;
    let per_angstrom3 = formula.iter().map(|(z, count)| (*z, *count as f64 * units)).collect();
    let least = LeastDistances::new(std::iter::empty(), &distances, &numbers);
    Ok(Packing { per_angstrom3, least })
}

fn is_pair(text: &str, names: [&str; 2]) -> bool {
    text.split_once('-').is_some_and(|(a, b)| [a, b] == names || [b, a] == names)
}

fn least_distance(
    n: usize,
    layer: &StackLayer,
    known: Option<&[(&str, f64)]>,
    pair: [u8; 2],
) -> Checked<f64> {
    let names = pair.map(elements::symbol);
    let given = layer.least_distance_angstrom.iter().find(|(text, _)| is_pair(text, names));
    let key = layer_key(n, "least_distance_angstrom");
    if let Some((_, distance)) = given {
        within(&key, *distance, 0.5, 6.0)?;
        return Ok(*distance);
    }
    let known = known.into_iter().flatten().find(|(text, _)| is_pair(text, names));
    match known {
        Some((_, distance)) => Ok(*distance),
        None => {
            let expected = format!(
                "the program knows no least distance of {}; give it in Angstrom",
                names.join("-")
            );
            fault(&key, "(incomplete)", expected)
        }
    }
}
