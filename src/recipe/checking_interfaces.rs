//! Limits of the interfaces of a stack: roughness and the exchange of elements.

use super::checking_stack::{extent, layer_key};
use super::fault::{Checked, fault, within};
use super::limits::BEYOND_FIELD_NM;
use super::stack_table::{DEFAULT_CORRELATION_NM, StackTable};
use super::stacked_crystals::{StackedLayer, StackedMatter};
use super::tables::Field;
use crate::lengths;
use crate::structure::elements;

/// Largest number of points of all rough interfaces together, six for each correlation length along both axes.
const MOST_INTERFACE_POINTS: f64 = 2e7;

/// Checks the roughness of the interfaces.
pub fn check_roughness(table: &StackTable, field: &Field) -> Checked {
    let [start, end] = extent(table, field);
    let thicknesses: Vec<f64> = table
        .layers
        .iter()
        .map(|layer| layer.thickness_nm.unwrap_or(lengths::nm(end - start)))
        .collect();
    let mut points = 0.0;
    for (n, layer) in table.layers.iter().enumerate() {
        let Some(rms) = layer.roughness_nm else {
            if layer.roughness_correlation_nm.is_some() {
                let key = layer_key(n, "roughness_correlation_nm");
                return fault(&key, "(alone)", "expected roughness_nm beside it");
            }
            continue;
        };
        let most = 0.25 * thicknesses[n].min(thicknesses[n - 1]);
        within(&layer_key(n, "roughness_nm"), rms, 0.0, most)?;
        let length = layer.roughness_correlation_nm.unwrap_or(DEFAULT_CORRELATION_NM);
        within(&layer_key(n, "roughness_correlation_nm"), length, 0.5, 1000.0)?;
        let beyond = 2.0 * (BEYOND_FIELD_NM + 1.0);
        let sizes = [field.fov_nm[1] + beyond, field.fov_nm[0] + beyond, field.thickness_nm];
        let area: f64 = table.along.in_plane().iter().map(|k| sizes[*k]).product();
        points += 36.0 * area / (length * length);
        if points > MOST_INTERFACE_POINTS {
            let expected = "the rough interfaces have too many points; expected a longer correlation, or a smaller field";
            return fault(&layer_key(n, "roughness_correlation_nm"), length, expected);
        }
    }
    Ok(())
}

/// Checks the elements that neighbouring crystals exchange.
pub fn check_exchange(table: &StackTable, layers: &[StackedLayer]) -> Checked {
    let symbols = |n: usize| -> Option<Vec<&str>> {
        let StackedMatter::Crystal(crystal) = &layers[n].matter else { return None };
        let mut all: Vec<&str> =
            crystal.structure.atoms.iter().map(|atom| elements::symbol(atom.number)).collect();
        all.sort_unstable();
        all.dedup();
        Some(all)
    };
    for (n, layer) in table.layers.iter().enumerate() {
        let (key, exchange) = (layer_key(n, "exchange"), &layer.exchange);
        let width = layer.interdiffusion_nm.unwrap_or(0.0);
        within(&layer_key(n, "interdiffusion_nm"), width, 0.0, 20.0)?;
        if width == 0.0 && exchange.is_empty() {
            continue;
        }
        if width == 0.0 || exchange.is_empty() {
            let expected = "expected interdiffusion_nm above 0 and exchange = { Sr = \"La\" } together, or neither";
            return fault(&key, "(alone)", expected);
        }
        let sides = if n == 0 { None } else { symbols(n - 1).zip(symbols(n)) };
        let Some((below, above)) = sides else {
            return fault(
                &key,
                "(given)",
                "only two crystals that lie on each other exchange elements; leave it out",
            );
        };
        let mut taken = Vec::new();
        for (from, to) in exchange {
            if !below.contains(&from.as_str()) {
                return fault(
                    &key,
                    from,
                    format!("expected an element of the layer before: {}", below.join(", ")),
                );
            }
            if !above.contains(&to.as_str()) || from == to || taken.contains(&to) {
                let expected = format!(
                    "expected for each element another element of this layer, each once: {}",
                    above.join(", ")
                );
                return fault(&key, format!("{from} = {to:?}"), expected);
            }
            taken.push(to);
        }
    }
    Ok(())
}
