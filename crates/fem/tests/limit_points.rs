//! Is an equilibrium found where the load passes a limit point or a bifurcation? Loads are dead, so
//! a stable state always exists; it may lie far from the one before.
#![allow(clippy::expect_used, clippy::panic)]

mod common;

use common::{bar_arrays, nodes_where};
use tissuereg_fem::{
    Body, Element, FemError, Load, Material, Mesh, SolveSettings, is_stable, solve,
};

/// A strip of 60 x 10 x 2 mm, bent up by `rise` in the middle and clamped at both ends.
fn arch(rise: f64, element: Element) -> Body {
    let (mut nodes, tets) = bar_arrays([16, 2, 1], [60.0, 10.0, 2.0]);
    for x in &mut nodes {
        x[2] += rise * (std::f64::consts::PI * x[0] / 60.0).sin();
    }
    let mesh = Mesh::new(nodes, tets).expect("sound");
    let held = nodes_where(&mesh, |x| x[0] < 1e-9 || x[0] > 60.0 - 1e-9);
    Body::new(mesh, element, held).expect("held")
}

/// A force on the nodes in the middle of the arch, mN.
fn pushed(body: &Body, force: f64) -> Load {
    let middle = nodes_where(body.mesh(), |x| (x[0] - 30.0).abs() < 1e-9);
    let mut forces = vec![[0.0; 3]; body.n_nodes()];
    for &node in &middle {
        forces[node] = [0.0, 0.0, force / middle.len() as f64];
    }
    Load::from_forces(forces)
}

/// A slender column, clamped below, pressed from above a little off its axis.
fn column(element: Element) -> Body {
    let (nodes, tets) = bar_arrays([1, 1, 12], [5.0, 5.0, 60.0]);
    let mesh = Mesh::new(nodes, tets).expect("sound");
    let held = nodes_where(&mesh, |x| x[2] < 1e-9);
    Body::new(mesh, element, held).expect("held")
}

fn pressed(body: &Body, force: f64) -> Load {
    let top = nodes_where(body.mesh(), |x| x[2] > 60.0 - 1e-9);
    let mut forces = vec![[0.0; 3]; body.n_nodes()];
    for &node in &top {
        forces[node] = [1e-3 * force, 0.0, -force / top.len() as f64];
    }
    Load::from_forces(forces)
}

/// Loads from gentle to forty times the largest that the straight state carries.
const FORCES: [f64; 6] = [5.0, 20.0, 60.0, 200.0, 800.0, 1600.0];

fn assert_found(body: &Body, load: &Load, most_iterations: usize, what: &str) {
    let material = Material::neo_hookean(10.0, 0.45).expect("sound");
    let settings = SolveSettings::default().with_n_threads(1);
    let answer = match solve(body, &material, load, &settings) {
        Ok(answer) => answer,
        Err(error) => panic!("{what}: {error}"),
    };
    let report = answer.report;
    assert!(report.iterations <= most_iterations, "{what}: {report:?}");
    assert!(report.factorisations <= most_iterations / 4, "{what}: {report:?}");
    assert!(is_stable(body, &material, &answer.displacement).expect("upright"), "{what}");
}

#[test]
fn an_arch_snaps_through() {
    for (element, most) in [(Element::Tet4, 200), (Element::Tet10, 900)] {
        let body = arch(6.0, element);
        for force in FORCES {
            assert_found(&body, &pushed(&body, -force), most, &format!("{element:?} {force} mN"));
        }
    }
}

/// From far below the load that the straight column carries to 40 times that. How a search gets past
/// the limit point depends on rounding, and now and then one runs out of iterations.
#[test]
fn a_column_buckles() {
    let material = Material::neo_hookean(10.0, 0.45).expect("sound");
    let settings = SolveSettings::default().with_n_threads(1);
    for (element, mean_iterations) in [(Element::Tet4, 100), (Element::Tet10, 300)] {
        let body = column(element);
        let (mut found, mut iterations) = (0, 0);
        for k in 0..40 {
            let load = pressed(&body, 0.5 * 1.16_f64.powi(k));
            match solve(&body, &material, &load, &settings) {
                Ok(answer) => {
                    found += 1;
                    iterations += answer.report.iterations;
                    assert!(is_stable(&body, &material, &answer.displacement).expect("upright"));
                }
                Err(FemError::NoEquilibrium(_)) => {}
                Err(error) => panic!("{element:?}: {error}"),
            }
        }
        println!("{element:?}: {found} of 40, {iterations} iterations");
        assert!(found >= 39, "{element:?}: {found} of 40 loads");
        assert!(iterations <= mean_iterations * found, "{element:?}: {iterations} iterations");
    }
}

/// What is found past the limit point is not the straight state, and lies far below it.
#[test]
fn a_buckled_column_has_less_energy_than_a_straight_one() {
    let body = column(Element::Tet4);
    let material = Material::neo_hookean(10.0, 0.45).expect("sound");
    let force = 6.0;
    let bent = solve(&body, &material, &pressed(&body, force), &SolveSettings::default());
    let bent = bent.expect("buckles");
    let energy = |u: &[[f64; 3]], strain: f64| {
        let load = pressed(&body, force).nodal_forces.expect("forces");
        let work: f64 =
            load.iter().zip(u).map(|(f, u)| f.iter().zip(u).map(|(f, u)| f * u).sum::<f64>()).sum();
        strain - work
    };
    let sideways = common::largest(&bent.displacement);
    assert!(sideways > 30.0, "{sideways} mm");
    // A straight column shortens by about F L / (E A) and gains half of that work.
    let shortening = force * 60.0 / (10.0 * 25.0);
    let straight = -0.5 * force * shortening;
    let found = energy(&bent.displacement, bent.report.strain_energy);
    assert!(found < 10.0 * straight, "{found} µJ, straight {straight} µJ");
}
