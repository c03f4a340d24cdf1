use crate::support::{Replays, Truth, array, problem, settings, table};
use flare_pipe::diagnosis::{Curves, FastColumn, Grid, Replay, Scene};
use flare_pipe::effects;
use realfft::num_complex::Complex;
use std::f64::consts::TAU;
type C64 = Complex<f64>;

fn envelope(x: &[f64], dt: f64, f0: f64) -> Vec<f64> {
    // SDOF, Newmark average acceleration
    let (w, z) = (TAU * f0, 0.05);
    let (mut d, mut v, mut a) = (0.0, 0.0, 0.0);
    let mut out = vec![0.0; x.len()];
    for (i, u) in x.iter().enumerate() {
        let k = w * w + 2.0 * z * w * 2.0 / dt + 4.0 / dt / dt;
        let rhs = -u + 4.0 / dt / dt * d + 4.0 / dt * v + a + 2.0 * z * w * (2.0 / dt * d + v);
        let dn = rhs / k;
        let vn = 2.0 / dt * (dn - d) - v;
        let an = -u - 2.0 * z * w * vn - w * w * dn;
        d = dn;
        v = vn;
        a = an;
        out[i] = d.abs();
    }
    let h = (0.5 / f0 / dt) as usize;
    let n = x.len();
    let m: Vec<f64> =
        (0..n).map(|i| out[i.saturating_sub(h)..(i + h + 1).min(n)].iter().fold(0.0f64, |m, x| m.max(*x))).collect();
    let sm: Vec<f64> = (0..n)
        .map(|i| {
            let r = i.saturating_sub(h)..(i + h + 1).min(n);
            let c = r.len() as f64;
            m[r].iter().sum::<f64>() / c
        })
        .collect();
    let peak = sm.iter().fold(1e-30f64, |m, x| m.max(*x));
    sm.iter().map(|x| x / peak).collect()
}

fn run(
    scene: &Scene,
    g: usize,
    r: usize,
    col: &FastColumn,
    ratio: f64,
    depths: &[f64],
    levels: &[f64],
    f0: f64,
) -> (Vec<C64>, f64) {
    let group = &scene.groups[g];
    let rec = &group.records[r];
    let grid = Grid::around(0.2, 9.5, col.grid_step_hz());
    let u: Vec<C64> = group.frequencies_hz.iter().zip(&rec.channels[0]).map(|(f, a)| a / -(TAU * f).powi(2)).collect();
    let n = rec.window.len() as f64;
    let mut gamma = vec![1e-5; col.n_element()];
    let mut m = col.march(grid, &gamma, depths);
    for _ in 0..10 {
        let norm = m.strain_norm(&group.frequencies_hz, &u);
        for (a, b) in gamma.iter_mut().zip(norm) {
            *a = 0.65 * rec.peak_factor * 2f64.sqrt() / n * b;
        }
        m = col.march(grid, &gamma, depths);
    }
    let peak: Vec<f64> = gamma.iter().map(|g| g / 0.65).collect();
    let env = envelope(&scene.problem.events[rec.event].input, 0.02, f0);
    let mut at = vec![C64::default(); depths.len()];
    let mut y = vec![0.0; rec.window.len()];
    for (l, level) in levels.iter().enumerate() {
        let g: Vec<f64> = peak.iter().map(|p| ratio * p * level).collect();
        let m = col.march(grid, &g, depths);
        let bins: Vec<C64> = group
            .convolver
            .frequencies_hz
            .iter()
            .enumerate()
            .map(|(k, f)| {
                m.response(*f, &mut at);
                at[depths.len() - 1] * rec.padded[0][k]
            })
            .collect();
        let h = group.convolver.history(bins.into_iter());
        for (i, y) in y.iter_mut().enumerate() {
            let e = env[i].clamp(levels[levels.len() - 1], levels[0]).ln();
            let up = if l == 0 { f64::INFINITY } else { levels[l - 1].ln() };
            let dn = if l + 1 == levels.len() { f64::NEG_INFINITY } else { levels[l + 1].ln() };
            let c = level.ln();
            let w = if e >= c {
                if up.is_infinite() { 1.0 } else { ((up - e) / (up - c)).max(0.0) }
            } else if dn.is_infinite() {
                1.0
            } else {
                ((e - dn) / (c - dn)).max(0.0)
            };
            *y += w * h[i];
        }
    }
    (
        scene.bins(g, r, &{
            let mut x = vec![0.0; rec.window.start];
            x.extend(y);
            x
        }),
        gamma.iter().fold(0.0, |m, x| m.max(*x)),
    )
}

#[test]
#[ignore]
fn explore() {
    let array = array();
    let mut problem = problem(&array, &[], Truth { elements: 60, max_step_s: 0.005, seed: 6, events: 4 });
    let slow = [table("kind = 'layer_velocity'\nln_factor = -0.04\ntop_m = 0.0\nbottom_m = 17.0")];
    let inputs: Vec<Vec<f64>> = problem.events.iter().map(|e| e.input.clone()).collect();
    for scale in [0.1, 0.3, 1.0] {
        for (e, i) in problem.events.iter_mut().zip(&inputs) {
            e.input = i.iter().map(|x| x * scale).collect();
        }
        let (before, after) = (Replays(&problem).replay(&[]).unwrap(), Replays(&problem).replay(&slow).unwrap());
        let scene = Scene::new(&problem, &settings()).unwrap();
        let curves = Curves::default();
        let mut p2 = array.profile.clone();
        effects::apply(&slow, &mut p2, &Default::default()).unwrap();
        let cols = [FastColumn::new(&array.profile, 40, &curves).unwrap(), FastColumn::new(&p2, 40, &curves).unwrap()];
        let f0 = flare_pipe::column::Column::new(&array.profile, &Default::default()).unwrap().frequency_hz();
        let mut totals = vec![[0.0f64; 4]; 7];
        for g in 0..scene.groups.len() {
            for r in 0..2 {
                let e = scene.groups[g].records[r].event;
                let pga = problem.events[e].input.iter().fold(0.0f64, |m, x| m.max(x.abs())) / 9.81;
                let fe = [&before, &after].map(|b| scene.bins(g, r, &b[e].as_ref().unwrap()[2]));
                print!("scale {scale} e{e} pga {pga:.4}:");
                let configs: Vec<(f64, Vec<f64>)> = vec![
                    (0.65, vec![1.0]),
                    (0.8, vec![1.0]),
                    (0.65, vec![1.0, 0.3, 0.1]),
                    (0.8, vec![1.0, 0.3, 0.1]),
                    (1.0, vec![1.0, 0.3, 0.1]),
                    (0.8, vec![1.0, 0.55, 0.3, 0.15, 0.07]),
                    (1.0, vec![1.0, 0.55, 0.3, 0.15, 0.07]),
                ];
                for (ci, (ratio, levels)) in configs.iter().enumerate() {
                    let f: Vec<(Vec<C64>, f64)> =
                        cols.iter().map(|c| run(&scene, g, r, c, *ratio, &[11.0, 6.0, 0.0], levels, f0)).collect();
                    let n = fe[0].len();
                    let (mut a, mut s, mut d, mut ds, mut k) = (0.0, 0.0, 0.0, 0.0, 0.0);
                    for i in 0..n {
                        a += (f[0].0[i] - fe[0][i]).norm_sqr();
                        s += fe[0][i].norm_sqr();
                        let lo = i.saturating_sub(2);
                        let hi = (i + 3).min(n);
                        let cross: C64 = (lo..hi).map(|m| fe[0][m] * f[0].0[m].conj()).sum();
                        let pw: f64 = (lo..hi).map(|m| f[0].0[m].norm_sqr()).sum();
                        let kk = cross / pw;
                        let df = f[1].0[i] - f[0].0[i];
                        let dfe = fe[1][i] - fe[0][i];
                        d += (df - dfe).norm_sqr();
                        k += (kk * df - dfe).norm_sqr();
                        ds += dfe.norm_sqr();
                    }
                    print!(" [{:.2} {:.2} K{:.2}]", (a / s).sqrt(), (d / ds).sqrt(), (k / ds).sqrt());
                    let t = &mut totals[ci];
                    t[0] += a / s;
                    t[1] += d / ds;
                    t[2] += k / ds;
                    t[3] += 1.0;
                }
                println!();
            }
        }
        println!(
            "scale {scale} TOTAL {:?}",
            totals
                .iter()
                .map(|t| format!(
                    "{:.2} {:.2} K{:.2}",
                    (t[0] / t[3]).sqrt(),
                    (t[1] / t[3]).sqrt(),
                    (t[2] / t[3]).sqrt()
                ))
                .collect::<Vec<_>>()
        );
    }
}
