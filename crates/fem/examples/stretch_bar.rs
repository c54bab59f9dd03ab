//! Stretch a bar by its end and by its weight, without Python: `cargo run --example stretch_bar`.

use tissuereg_fem::{
    Body, Element, FemError, Load, Material, Member, Mesh, SolveSettings, solve, solve_many,
};

/// A box of `cells` cubes with edges `size` mm, every cube cut into six tetrahedra along its diagonal.
fn bar(cells: [usize; 3], size: [f64; 3]) -> Result<Mesh, FemError> {
    let [nx, ny, nz] = cells.map(|n| n + 1);
    let nodes = (0..nx * ny * nz).map(|n| {
        let at = [n / (ny * nz), n / nz % ny, n % nz];
        std::array::from_fn(|i| size[i] * at[i] as f64 / cells[i] as f64)
    });
    let mut tets = Vec::new();
    for cube in 0..cells.iter().product() {
        let (i, j, k) = (cube / (cells[1] * cells[2]), cube / cells[2] % cells[1], cube % cells[2]);
        // Corners by x + 2 y + 4 z, and the six ways along the edges from corner 0 to corner 7.
        let corner = |c: usize| ((i + (c & 1)) * ny + j + (c >> 1 & 1)) * nz + k + (c >> 2);
        for [a, b] in [[1, 3], [3, 2], [2, 6], [6, 4], [4, 5], [5, 1]] {
            tets.push([0, a, b, 7].map(corner));
        }
    }
    Mesh::new(nodes.collect(), tets)
}

fn main() -> Result<(), FemError> {
    // 40 x 20 x 20 mm, clamped at x = 0. Symbolic work is done here, once.
    let mesh = bar([8, 4, 4], [40.0, 20.0, 20.0])?;
    let held: Vec<usize> = (0..mesh.n_nodes()).filter(|&n| mesh.nodes()[n][0] < 1e-9).collect();
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
