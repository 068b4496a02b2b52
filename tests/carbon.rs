//! Amorphous carbon: density, pair correlation, angles, and a film without seams or repetition.
use stemgen::structure::carbon::block;
use stemgen::structure::carbon::film::Film;
use stemgen::structure::carbon::network::{Neighbours, Network};
use std::time::Instant;

#[test]
fn look() {
    let t = Instant::now();
    let _ = block::network();
    println!("block {:.2}", t.elapsed().as_secs_f64());
    let film = Film::new(1, 50.0);
    let t = Instant::now();
    let atoms = film.atoms(&[[0.0, 200.0], [0.0, 200.0]]);
    println!("film {} in {:.2} s density {}", atoms.len(), t.elapsed().as_secs_f64(), atoms.len() as f64 / (200.0*200.0*50.0) / 0.05013854);
    let network = Network { positions: atoms.iter().map(|a| a.position).collect(), period: [f64::INFINITY; 3] };
    let near = Neighbours::new(&network, 3.0);
    for (name, pick) in [("all", 0), ("inner", 1), ("seam", 2), ("node", 3), ("surface", 4)] {
        let (mut n, mut cn, mut ang, mut a2, mut na, mut least) = (0, [0usize; 9], 0.0, 0.0, 0, 9.0f64);
        let mut sum = 0.0;
        let mut hist = [0usize; 30];
        for (i, p) in network.positions.iter().enumerate() {
            let d = [p[0], p[1]].map(|v| (v - 65.0 * (v / 65.0).round()).abs());
            let zin = p[2] > 4.0 && p[2] < 46.0;
            let edge = p[0] < 5.0 || p[0] > 195.0 || p[1] < 5.0 || p[1] > 195.0;
            if edge { continue; }
            let ok = match pick { 0 => true, 1 => zin && d[0] > 5.0 && d[1] > 5.0, 2 => zin && (d[0] < 2.5) != (d[1] < 2.5), 3 => zin && d[0] < 4.0 && d[1] < 4.0, _ => !zin };
            if !ok { continue; }
            n += 1;
            let mut b = vec![];
            for &j in near.of(i) {
                let v = network.vector(i, j as usize);
                let r = (0..3).map(|k| v[k] * v[k]).sum::<f64>().sqrt();
                least = least.min(r);
                hist[((r - 1.2) / 0.06).clamp(0.0, 29.0) as usize] += 1;
                if r < 1.85 { sum += r; b.push(v.map(|x| x / r)); }
            }
            cn[b.len()] += 1;
            for x in 0..b.len() { for y in 0..x { let t = (0..3).map(|k| b[x][k] * b[y][k]).sum::<f64>().acos().to_degrees(); ang += t; a2 += t * t; na += 1; } }
        }
        let m = ang / na as f64;
        let c: usize = cn.iter().enumerate().map(|(k, v)| k * v).sum();
        println!("{name}: n {n} least {least:.3} bond {:.4} cn {:.3} {:?} angle {m:.1} +- {:.1}", sum / c as f64, c as f64 / n as f64, cn.map(|v| (v as f64 / n as f64 * 1e4).round() / 1e4), (a2 / na as f64 - m * m).sqrt());
        println!("   {:?}", hist.map(|h| (h as f64 / n as f64 * 1000.0).round() / 1000.0));
    }
}
