//! Stretch a bar by its end and by its weight, without Python: `cargo run --example stretch_bar`.

#[path = "../tests/common/mod.rs"]
mod common;

use tissuereg_fem::{
    Body, Element, FemError, Load, Material, Member, SolveSettings, solve, solve_many,
};

fn main() -> Result<(), FemError> {
    // 40 x 20 x 20 mm, clamped at x = 0. Symbolic work is done here, once.
    let mesh = common::bar([8, 4, 4], [40.0, 20.0, 20.0]);
    let held = common::nodes_where(&mesh, |x| x[0] < 1e-9);
    let body = Body::new(mesh, Element::Tet10, held)?;

    // 1 kPa on the far face: a force of 400 mN.
    let is_end = |t: &[usize; 3]| t.iter().all(|&n| body.nodes()[n][0] > 40.0 - 1e-9);
    let end: Vec<[usize; 3]> =
        body.mesh().surface_triangles().iter().copied().filter(is_end).collect();
    let pull = body.traction_forces(&end, &vec![[1.0, 0.0, 0.0]; end.len()])?;
    let weight = [0.0, 0.0, -9.81e-3];
    let load = Load { body_force: weight, ..Load::from_forces(pull) };

    let soft = Material::neo_hookean(10.0, 0.45)?;
    let answer = solve(&body, &soft, &load, &SolveSettings::default())?;
    let tip = body.n_corner_nodes() - 1;
    println!("tip moves by {:.4?} mm", answer.displacement[tip]);
    let held: f64 = answer.reactions.iter().map(|r| r[0]).sum();
    println!("the wall pulls back with {:.3} mN", -held);
    println!("{} iterations, {} factor", answer.report.iterations, answer.report.factorisations);

    // The same load on stiffer bars: all share one factor.
    let materials = [15.0, 20.0, 40.0].map(|young| Material::neo_hookean(young, 0.45));
    let materials = materials.into_iter().collect::<Result<Vec<_>, _>>()?;
    let members: Vec<Member> =
        materials.iter().map(|material| Member { material, load: &load, start: None }).collect();
    for outcome in solve_many(&body, &members, &SolveSettings::default()) {
        match outcome.solution() {
            Some(s) => println!("tip moves by {:.4?} mm", s.displacement[tip]),
            None => println!("failed: {:?}", outcome.error()),
        }
    }
    Ok(())
}
