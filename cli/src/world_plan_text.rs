//! The plan of `stemgen build` as text.

use super::plan_text::{self, Lines};
use super::text;
use stemgen::imaging::MosaicCost;
use stemgen::world::WorldPlan;

/// Returns names and values, line by line.
pub fn text_of(plan: &WorldPlan) -> String {
    let mut lines = Lines::default();
    lines.add("material", format!("{} {}", plan.material, plan.zone_axis));
    let ([rows, columns], [ny, nx], [h, w]) = (plan.tiles, plan.pixels, plan.fov_nm);
    let pixel = plan.pixel_nm;
    lines.add("tiles", format!("{rows} x {columns}, {ny} x {nx} pixels of {pixel:.5} nm"));
    lines.add("field", format!("{h:.2} x {w:.2} nm, {:.3} nm thick", plan.thickness_nm));
    let [h, w] = plan.subtile_nm;
    lines.add("sub-tiles", format!("{} of {h:.2} x {w:.2} nm", plan.subtiles));
    let [x, y] = plan.probe_step_angstrom;
    let number = match (plan.particle_probes, plan.plan.probes) {
        (Some(n), _) => format!("{} for the particles, ", text::count(n as u64)),
        // All probes belong to the library.
        (None, 0) => String::new(),
        (None, n) => format!("{} per sub-tile, ", text::count(n as u64)),
    };
    lines.add("probes", format!("{number}{x:.4} x {y:.4} A apart"));
    plan_text::numerics(&plan.plan, &mut lines);
    if let Some(mosaic) = &plan.mosaic {
        lines.add("mosaic", mosaic_line(mosaic, plan.mosaic_used));
        for new in mosaic.new.iter().filter(|_| plan.mosaic_used) {
            let images = text::count(new.images as u64);
            lines.add("new", format!("{images} images: {}", new.why));
        }
    } else if plan.particle_probes.is_some() {
        lines.add("film", "atom by atom, without interference");
    }
    plan_text::costs(&plan.plan, &mut lines);
    if plan.audit_range_s[1] > 0.0 {
        let time = text::duration_range(plan.audit_range_s);
        lines.add("audit", format!("{time} of that"));
    }
    lines.add("disk", format!("at most about {}", text::bytes(plan.disk_bytes)));
    lines.add("output", format!("{} (nothing was simulated or written)", plan.output.display()));
    lines.text()
}

fn mosaic_line(mosaic: &MosaicCost, used: bool) -> String {
    if !used {
        return "saves no time here (a small field, or columns that share few simulations): every sub-tile is simulated".into();
    }
    let count = |n: usize| text::count(n as u64);
    let unique = match mosaic.unique_columns {
        0 => String::new(),
        n => format!("; {} columns share no simulation", text::count(n)),
    };
    format!(
        "library of {} images, {} of them to simulate ({} probes){unique}",
        count(mosaic.images),
        count(mosaic.missing),
        count(mosaic.missing_probes)
    )
}
