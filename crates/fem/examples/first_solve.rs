//! One tetrahedron, held at its base and pulled at its top: `cargo run --example first_solve`.

use tissuereg_fem::{Body, Element, FemError, Load, Material, Mesh, SolveSettings, solve};

fn main() -> Result<(), FemError> {
    let nodes = vec![[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 10.0, 0.0], [0.0, 0.0, 10.0]]; // mm
    let mesh = Mesh::new(nodes, vec![[0, 1, 2, 3]])?;
    let body = Body::new(mesh, Element::Tet4, [0, 1, 2])?; // held nodes
    let material = Material::neo_hookean(10.0, 0.45)?; // kPa, Poisson's ratio
    let mut forces = vec![[0.0; 3]; body.n_nodes()];
    forces[3] = [0.0, 0.0, 20.0]; // mN
    let answer = solve(&body, &material, &Load::from_forces(forces), &SolveSettings::default())?;

    println!("the top moves by {:.4?} mm", answer.displacement[3]);
    let held: f64 = answer.reactions.iter().map(|reaction| reaction[2]).sum();
    assert!((held + 20.0).abs() < 1e-6, "the held nodes pull back with {held} mN");
    Ok(())
}
