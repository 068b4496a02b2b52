use std::time::Instant;
use stemgen::world::{Difficulty, Recipe, Region, specimen, SiteKind};
#[test]
fn look() {
    for d in Difficulty::ALL {
        let recipe = Recipe::load("pt", d).unwrap();
        let t = Instant::now();
        let s = specimen(&recipe).unwrap();
        println!("{} new {:.2} s thickness {:.2}", d.name(), t.elapsed().as_secs_f64(), s.thickness_nm());
        let t = Instant::now();
        let ps = s.particles();
        println!("particles {:.2} s", t.elapsed().as_secs_f64());
        for p in &ps { println!("  {} d {:.2} at {:.1} {:.1} {:.2}", p.morphology, p.diameter_nm, p.centre_nm[0], p.centre_nm[1], p.centre_nm[2]); }
        let t = Instant::now();
        let f = recipe.field.full_region();
        let sites = s.query(&f);
        println!("query {:.2} s: {} sites {} columns", t.elapsed().as_secs_f64(), sites.sites.len(), sites.columns.len());
        let pt: Vec<_> = sites.sites.iter().filter(|s| s.number == 78).collect();
        let vac = pt.iter().filter(|s| s.kind == SiteKind::Vacancy).count();
        let cols: Vec<usize> = sites.columns.iter().filter(|c| c.id >> 60 == 1).map(|c| c.sites.len()).collect();
        println!("pt {} vacant {} cols {} mean {:.2}", pt.len(), vac as f64 / pt.len() as f64, cols.len(), pt.len() as f64 / cols.len() as f64);
        let px = recipe.field.pixel_nm();
        let mut with = 0;
        let mut by = vec![false; 1600];
        for a in &pt { let [x, y, _] = a.position_nm;
            for r in 0..40 { for c in 0..40 {
                let reg = Region::of_pixels([r * 124, c * 124], [128, 128], px);
                if reg.contains([x, y]) { by[r * 40 + c] = true; }
            } } }
        with += by.iter().filter(|b| **b).count();
        println!("tiles empty {:.4}", 1.0 - with as f64 / 1600.0);
        if d == Difficulty::Easy { let t = Instant::now(); let n = s.sites(&f.grown(12.0)).len(); println!("all {n} {:.1}", t.elapsed().as_secs_f64());
        let status = std::fs::read_to_string("/proc/self/status").unwrap(); println!("{}", status.lines().find(|l| l.starts_with("VmHWM")).unwrap()); }
    }
}
#[test]
fn rows() {
    let recipe = Recipe::load("pt", Difficulty::Easy).unwrap();
    let s = specimen(&recipe).unwrap();
    for p in s.particles() {
        let r = 0.75 * p.diameter_nm;
        let q = s.query(&Region { x: [p.centre_nm[0] - r, p.centre_nm[0] + r], y: [p.centre_nm[1] - r, p.centre_nm[1] + r] });
        let mut h = std::collections::BTreeMap::new();
        for c in q.columns.iter().filter(|c| c.id >> 60 == 1) { *h.entry(c.sites.len()).or_insert(0) += 1; }
        println!("{} {:.2} {:?}", p.morphology, p.diameter_nm, h);
    }
}
