//! Solve the problems of NumPy archives and compare with the displacement they hold.
//!
//! `cargo run --release --example solve_npz -- FILE.npz ... [--threads N] [--repeat N] [--method M]
//! [--tet10] [--averaged] [--scale LOAD_FACTOR] [--poisson NU] [--tolerance T]`
//!
//! Arrays: `nodes_mm (n, 3)`, `tets (m, 4)`, `fixed_nodes`, `forces_mN (n, 3)`, `young_kPa`,
//! `poisson`, and `displacement_mm (n, 3)` where there is one.

#[path = "../tests/common/npz.rs"]
mod npz;

use std::error::Error;
use std::path::Path;
use std::time::Instant;

use tissuereg_fem::{Body, Element, Load, Material, Mesh, Method, SolveSettings, solve};

fn main() -> Result<(), Box<dyn Error>> {
    let mut settings = SolveSettings::default();
    let (mut files, mut repeat, mut scale, mut poisson) = (Vec::new(), 3, 1.0, None);
    let mut element = Element::Tet4;
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        let mut value = || arguments.next().ok_or(format!("{argument} needs a value"));
        match argument.as_str() {
            "--threads" => settings.n_threads = value()?.parse()?,
            "--repeat" => repeat = value()?.parse()?,
            "--scale" => scale = value()?.parse()?,
            "--poisson" => poisson = Some(value()?.parse::<f64>()?),
            "--tolerance" => settings.tolerance = value()?.parse()?,
            "--tet10" => element = Element::Tet10,
            "--averaged" => element = Element::Tet4Averaged,
            "--method" => {
                settings.method = match value()?.as_str() {
                    "newton" => Method::Newton,
                    "quasi-newton" => Method::QuasiNewton,
                    _ => Method::Auto,
                }
            }
            _ => files.push(argument),
        }
    }
    for file in files {
        let arrays = npz::read(Path::new(&file))?;
        let forces: Vec<[f64; 3]> =
            arrays["forces_mN"].rows3().iter().map(|f| f.map(|v| scale * v)).collect();
        let load = Load::from_forces(forces);
        let nu = poisson.unwrap_or(arrays["poisson"].values[0]);
        let material = Material::neo_hookean(arrays["young_kPa"].values[0], nu)?;
        let mut fastest = [f64::INFINITY; 6];
        for round in 0..repeat {
            let start = Instant::now();
            let mesh = Mesh::new(arrays["nodes_mm"].rows3(), arrays["tets"].index_rows())?;
            let checked = start.elapsed().as_secs_f64();
            let body = Body::new(mesh, element, arrays["fixed_nodes"].indices())?;
            let answer = solve(&body, &material, &load, &settings)?;
            let cold = start.elapsed().as_secs_f64();
            let again = Instant::now();
            let answer_warm = solve(&body, &material, &load, &settings)?;
            let warm = again.elapsed().as_secs_f64();
            assert_eq!(answer.displacement, answer_warm.displacement);
            let stages = [
                checked,
                body.analyse_seconds(),
                answer.report.seconds.factor,
                answer.report.seconds.iterate,
                cold,
                warm,
            ];
            for (least, seconds) in fastest.iter_mut().zip(stages) {
                *least = least.min(1e3 * seconds);
            }
            if round + 1 < repeat {
                continue;
            }
            let largest = |rows: &[[f64; 3]]| {
                rows.iter().map(|u| u.iter().map(|c| c * c).sum::<f64>().sqrt()).fold(0.0, f64::max)
            };
            let u = &answer.displacement;
            println!(
                "{file}: {} nodes, {} tets, largest {:.6} mm",
                u.len(),
                body.n_tets(),
                largest(u)
            );
            if let Some(reference) = arrays.get("displacement_mm") {
                let difference: Vec<[f64; 3]> = reference
                    .rows3()
                    .iter()
                    .zip(u)
                    .map(|(a, b)| std::array::from_fn(|i| a[i] - b[i]))
                    .collect();
                println!("  differs from the reference by {:.2e} mm", largest(&difference));
            }
            let [checked, analyse, factor, iterate, cold, warm] = fastest;
            println!(
                "  ms, fastest of {repeat}: mesh {checked:.1}, analyse {analyse:.1}, factor \
                 {factor:.1}, iterate {iterate:.1}; cold {cold:.1}, warm {warm:.1}"
            );
            println!("  {:?}", answer.report);
        }
    }
    Ok(())
}
