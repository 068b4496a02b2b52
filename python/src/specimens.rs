//! Lays out the atoms of a recipe's specimen.

use crate::errors::Fault;
use crate::long_call::{LongCall, Running, run};
use crate::recipes::checked;
use ndarray::{Array1, Array2};
use numpy::IntoPyArray;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::PathBuf;
use stemgen::io::atom_type;
use stemgen::recipe::Region;
use stemgen::specimen::{Sites, SurfaceLayers, for_each_stripe, specimen};
use stemgen::world::draw_specimen;
use stemgen::{Error, Setting};

/// Sites in a list.
#[derive(Default)]
struct SiteLists {
    positions_nm: Vec<[f64; 3]>,
    numbers: Vec<i32>,
    types: Vec<i32>,
    columns: Vec<i64>,
    first_column: usize,
}

impl SiteLists {
    fn add(&mut self, sites: &Sites, origin_nm: [f64; 2]) {
        for (n, column) in sites.columns.iter().enumerate() {
            for site in &sites.sites[column.sites.clone()] {
                let [x, y, z] = site.position_nm;
                self.positions_nm.push([x - origin_nm[0], y - origin_nm[1], z]);
                self.numbers.push(i32::from(site.number));
                self.types.push(atom_type::code(site.kind));
                self.columns.push((self.first_column + n) as i64);
            }
        }
        self.first_column += sites.columns.len();
    }

    /// Adds the carbon on the faces of a specimen in a region, as pristine atoms without a column.
    fn add_layers(&mut self, layers: &SurfaceLayers, region: &Region, origin_nm: [f64; 2]) {
        for (layer, area) in layers.parts(region) {
            for atom in layer.atoms(&area) {
                let [x, y, z] = atom.position.map(|v| 0.1 * v);
                let corner = [area.x[0] - origin_nm[0], area.y[0] - origin_nm[1]];
                self.positions_nm.push([x + corner[0], y + corner[1], z]);
                self.numbers.push(i32::from(atom.number));
                self.types.push(atom_type::PRISTINE);
                self.columns.push(-1);
            }
        }
        let down = 0.1 * layers.before_angstrom();
        self.positions_nm.iter_mut().for_each(|place| place[2] += down);
    }
}

/// Returns the lattice sites of a recipe's built field, in the order of the ground truth, or of a region (x0, y0, x1, y1) in nm, as a dict
/// of arrays. Positions count from the centre of the first built pixel, and along the beam from the entrance face.
#[pyfunction]
pub fn specimen_sites(
    py: Python<'_>,
    toml: String,
    region_nm: Option<[f64; 4]>,
    running: Running,
) -> PyResult<Py<PyDict>> {
    let work = move |call: &LongCall| -> Result<(SiteLists, [[f64; 2]; 2], f64), Fault> {
        let recipe = checked(&toml)?;
        let specimen = specimen(&recipe)?;
        let origin = recipe.field.origin_nm();
        let mut lists = SiteLists::default();
        let region = match region_nm {
            None => {
                for_each_stripe(&*specimen, &recipe.field, "sites", call, |stripe| {
                    lists.add(&stripe.sites, origin);
                    Ok(())
                })?;
                recipe.field.built_region()
            }
            Some(corners) => {
                let region = region_of(corners, origin, &recipe.field.full_region())?;
                lists.add(&specimen.query(&region), origin);
                region
            }
        };
        let mut thickness_nm = specimen.facts().thickness_nm;
        if let Some(layers) = SurfaceLayers::of(&recipe, thickness_nm) {
            lists.add_layers(&layers, &region, origin);
            thickness_nm = 0.1 * layers.thickness_angstrom();
        }
        let edges = [region.x, region.y];
        let relative = [0, 1].map(|k| edges[k].map(|v| v - origin[k]));
        Ok((lists, relative, thickness_nm))
    };
    let (lists, [x, y], thickness_nm) = run(py, running, work)?;
    let positions: Array2<f64> = ndarray::arr2(&lists.positions_nm);
    let out = PyDict::new(py);
    out.set_item("positions_nm", positions.into_pyarray(py))?;
    out.set_item("numbers", Array1::from(lists.numbers).into_pyarray(py))?;
    out.set_item("types", Array1::from(lists.types).into_pyarray(py))?;
    out.set_item("columns", Array1::from(lists.columns).into_pyarray(py))?;
    out.set_item("x_nm", x)?;
    out.set_item("y_nm", y)?;
    out.set_item("thickness_nm", thickness_nm)?;
    Ok(out.unbind())
}

/// Returns a rectangle of the full field. Its corners are given from the first built pixel, which lies at `origin` in the full field.
///
/// # Errors
/// The rectangle is empty, or lies outside of the field.
pub fn region_of(
    [x0, y0, x1, y1]: [f64; 4],
    origin: [f64; 2],
    full: &Region,
) -> Result<Region, Fault> {
    let region =
        Region { x: [x0 + origin[0], x1 + origin[0]], y: [y0 + origin[1], y1 + origin[1]] };
    let there = region.intersection(full);
    // The comparisons are written so that NaN is refused.
    if there.x[0] < there.x[1] && there.y[0] < there.y[1] && x0 < x1 && y0 < y1 {
        return Ok(region);
    }
    let expected = format!(
        "expected left, upper, right and lower edge in nm, within {:.2}, {:.2} to {:.2}, {:.2}",
        full.x[0] - origin[0],
        full.y[0] - origin[1],
        full.x[1] - origin[0],
        full.y[1] - origin[1]
    );
    Err(Error::invalid(Setting::Region, format!("{x0}, {y0}, {x1}, {y1}"), expected).into())
}

/// Draws the projected specimen of a recipe as PNG.
#[pyfunction]
pub fn draw_recipe(py: Python<'_>, toml: String, out: PathBuf, running: Running) -> PyResult<()> {
    run(py, running, move |call| Ok(draw_specimen(&checked(&toml)?, &out, call)?))
}
