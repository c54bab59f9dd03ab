//! Times of a linearised equilibrium and of many right-hand sides on it.
//!
//! `cargo run --release --example wide_solves -- FILE.npz ... [--threads N] [--repeat N]
//! [--columns N] [--adjoints]`
//!
//! Archives as in `solve_npz`. Fastest of the repeats, ms; differences over the largest entry.

#[path = "../tests/common/npz.rs"]
mod npz;

use std::error::Error;
use std::path::Path;
use std::time::Instant;

use tissuereg_fem::{
    Body, Cause, Element, Linearised, Load, Material, Mesh, Observation, Precision, SolveSettings,
    solve,
};

fn main() -> Result<(), Box<dyn Error>> {
    let mut settings = SolveSettings::default();
    let (mut files, mut repeat, mut columns, mut adjoints) = (Vec::new(), 5, vec![45, 135], false);
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        let mut value = || arguments.next().ok_or(format!("{argument} needs a value"));
        match argument.as_str() {
            "--threads" => settings.n_threads = value()?.parse()?,
            "--repeat" => repeat = value()?.parse()?,
            "--columns" => columns = vec![value()?.parse()?],
            "--adjoints" => adjoints = true,
            _ => files.push(argument),
        }
    }
    for file in files {
        let arrays = npz::read(Path::new(&file))?;
        let load = Load::from_forces(arrays["forces_mN"].rows3());
        let (young, poisson) = (arrays["young_kPa"].values[0], arrays["poisson"].values[0]);
        let material = Material::neo_hookean(young, poisson)?;
        let mesh = Mesh::new(arrays["nodes_mm"].rows3(), arrays["tets"].index_rows())?;
        let body = Body::new(mesh, Element::Tet4, arrays["fixed_nodes"].indices())?;
        let found = solve(&body, &material, &load, &settings)?.displacement;
        println!("{file}: {} nodes, {} threads", body.n_nodes(), settings.n_threads);
        for precision in [Precision::Double, Precision::Single] {
            let make =
                || Linearised::in_precision(&body, &material, &load, &found, &settings, precision);
            let (ms, here) = fastest(repeat, make);
            let here = here?;
            println!("  {precision:?}: factor {ms:.1} ms, {:?}", here.report());
            for &n in &columns {
                let observations = observations(&body, n);
                let (ms, compliance) = fastest(repeat, || here.compliance(&observations));
                let compliance = compliance?;
                println!("    {n} observations {ms:.1} ms");
                let (ms, responses) = fastest(repeat, || here.responses(&compliance.nodal_forces));
                println!("    {n} responses {ms:.1} ms, {} rows", responses?.len());
                if adjoints {
                    let (ms, adjoints) = fastest(1, || here.adjoints(&observations));
                    let rows: Vec<[f64; 3]> =
                        adjoints?.iter().flat_map(|one| one.nodal_forces.clone()).collect();
                    let off = difference(&compliance.nodal_forces, &rows);
                    println!("    {n} adjoints {ms:.1} ms, off by {off:.1e}");
                }
            }
            let rates = |k: usize| (0..body.n_tets()).map(|t| ((t * k) % 7) as f64).collect();
            let causes: Vec<Cause> = (1..61).map(|k| Cause::YoungField(rates(k))).collect();
            let (ms, forces) = fastest(repeat, || here.unbalanced(&causes));
            println!("    60 fields of moduli {ms:.1} ms, {} rows", forces?.len());
            for by in [1.1, 1.5, 0.5] {
                let near = load.nodal_forces.iter().flatten().map(|f| f.map(|v| by * v)).collect();
                let near = Load::from_forces(near);
                let loose = settings.clone().with_tolerance(1e-6);
                let (ms, found) = fastest(repeat, || here.solve_near(&near, &loose));
                let report = found?.report;
                let (rest_ms, rest) = fastest(repeat, || solve(&body, &material, &near, &loose));
                println!(
                    "    load x {by}: near {} iterations, {} factors, {ms:.1} ms; from rest {}, {rest_ms:.1} ms",
                    report.iterations, report.factorisations, rest?.report.iterations
                );
            }
        }
    }
    Ok(())
}

/// Components of points on the surface.
fn observations(body: &Body, n: usize) -> Vec<Observation> {
    let triangles = body.mesh().surface_triangles();
    let of = |k: usize| {
        let triangle = triangles[(k / 3 * 7919) % triangles.len()];
        let row: [f64; 3] = std::array::from_fn(|i| if i == k % 3 { 1.0 / 3.0 } else { 0.0 });
        Observation::of_displacement(triangle.map(|node| (node, row)))
    };
    (0..n).map(of).collect()
}

fn fastest<R>(repeat: usize, run: impl Fn() -> R) -> (f64, R) {
    let timed = || {
        let begin = Instant::now();
        let result = run();
        (1e3 * begin.elapsed().as_secs_f64(), result)
    };
    let mut best = timed();
    for _ in 1..repeat {
        let next = timed();
        best = if next.0 < best.0 { next } else { best };
    }
    best
}

fn difference(a: &[[f64; 3]], b: &[[f64; 3]]) -> f64 {
    let pairs = a.as_flattened().iter().zip(b.as_flattened());
    let off = pairs.fold(0.0_f64, |m, (x, y)| m.max((x - y).abs()));
    off / b.as_flattened().iter().fold(0.0_f64, |m, v| m.max(v.abs()))
}
