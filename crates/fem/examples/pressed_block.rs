//! A block of tissue pressed from above, in three stiffnesses at once: `cargo run --example pressed_block`.
//!
//! Nothing but this file and the crate is needed.

use tissuereg_fem::{
    Body, Element, FemError, Load, Material, Member, Mesh, SolveSettings, solve_many,
};

/// Nodes (mm) and tetrahedra of a block of cubes, six tetrahedra each.
fn block(cells: [usize; 3], edge: f64) -> (Vec<[f64; 3]>, Vec<[usize; 4]>) {
    let [nx, ny, nz] = cells;
    let number = |[x, y, z]: [usize; 3]| (z * (ny + 1) + y) * (nx + 1) + x;
    let (mut nodes, mut tets) = (Vec::new(), Vec::new());
    for z in 0..=nz {
        for y in 0..=ny {
            for x in 0..=nx {
                nodes.push([x, y, z].map(|i| edge * i as f64));
                if x == nx || y == ny || z == nz {
                    continue;
                }
                // Corners by x + 2 y + 4 z, and the six ways along the edges from 0 to 7.
                let corner = |c: usize| number([x + (c & 1), y + (c >> 1 & 1), z + (c >> 2 & 1)]);
                for [a, b] in [[1, 3], [3, 2], [2, 6], [6, 4], [4, 5], [5, 1]] {
                    tets.push([0, a, b, 7].map(corner));
                }
            }
        }
    }
    (nodes, tets)
}

/// How far the middle of the top sinks, mm, for each Young's modulus in kPa.
fn sunk(moduli: &[f64]) -> Result<Vec<f64>, FemError> {
    let (nodes, tets) = block([6, 6, 4], 5.0);
    let held: Vec<usize> = (0..nodes.len()).filter(|&n| nodes[n][2] == 0.0).collect();

    // Checks, elimination order, symbolic factor: once a body.
    let body = Body::new(Mesh::new(nodes, tets)?, Element::Tet10, held)?;

    // 2 kPa downwards on the facets of the top that lie within 8 mm of its middle.
    let near = |n: usize| {
        let [x, y, z] = body.nodes()[n];
        z > 19.9 && (x - 15.0).hypot(y - 15.0) < 8.0
    };
    let pressed: Vec<[usize; 3]> = body.mesh().surface_triangles().to_vec();
    let pressed: Vec<_> = pressed.into_iter().filter(|t| t.iter().all(|&n| near(n))).collect();
    let down = vec![[0.0, 0.0, -2.0]; pressed.len()];
    let load = Load::from_forces(body.traction_forces(&pressed, &down)?);

    // One outcome a member; a member that finds no equilibrium is an error value, not a panic.
    let materials = moduli
        .iter()
        .map(|&young| Material::neo_hookean(young, 0.45))
        .collect::<Result<Vec<_>, _>>()?;
    let members: Vec<Member> =
        materials.iter().map(|material| Member { material, load: &load, start: None }).collect();
    let top = (0..body.n_corner_nodes()).find(|&n| body.nodes()[n] == [15.0, 15.0, 20.0]);
    let deep = |u: &[[f64; 3]]| top.map_or(f64::NAN, |n| -u[n][2]);
    Ok(solve_many(&body, &members, &SolveSettings::default())
        .iter()
        .map(|outcome| outcome.solution().map_or(f64::NAN, |s| deep(&s.displacement)))
        .collect())
}

fn main() -> Result<(), FemError> {
    let moduli = [5.0, 10.0, 20.0];
    for (young, depth) in moduli.iter().zip(sunk(&moduli)?) {
        println!("{young:4} kPa: the top sinks by {depth:.3} mm");
    }
    Ok(())
}

#[test]
fn a_stiffer_block_sinks_less_and_by_less_than_its_height() {
    let depths = sunk(&[5.0, 10.0, 20.0]).unwrap();
    assert!(depths.windows(2).all(|pair| pair[1] < pair[0]), "{depths:?}");
    assert!(depths.iter().all(|&depth| depth > 0.1 && depth < 10.0), "{depths:?}");
    // At small strain the depth is in proportion to pressure over modulus.
    let stiff = sunk(&[200.0, 400.0]).unwrap();
    assert!((stiff[0] / stiff[1] - 2.0).abs() < 0.02, "{stiff:?}");
}
