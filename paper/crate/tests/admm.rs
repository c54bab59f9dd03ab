//! Projective dynamics by ADMM: against the crate's own equilibria, and what motion must keep.
#![allow(clippy::expect_used, clippy::panic)]

#[path = "../../../crates/fem/tests/common/meshes.rs"]
mod common;

use common::{Random, bar, largest, largest_difference, nodes_where};
use tissuereg_fem::{
    Body, Element, FemError, Load, Material, Mesh, SolveSettings, Stiffness, internal_forces, solve,
};
use tissuereg_paper::AdmmBody;

fn soft(poisson: f64) -> Stiffness {
    Stiffness::Uniform { young: 10.0, poisson }
}

fn small_bar() -> (Mesh, Vec<usize>) {
    let mesh = bar([6, 2, 2], [60.0, 20.0, 20.0]);
    let clamped = nodes_where(&mesh, |x| x[0] < 1e-9);
    (mesh, clamped)
}

/// Forces that pull and bend the free end of the bar by some centimetre, mN.
fn end_forces(mesh: &Mesh) -> Vec<[f64; 3]> {
    let end = nodes_where(mesh, |x| x[0] > 60.0 - 1e-9);
    let mut forces = vec![[0.0; 3]; mesh.n_nodes()];
    for &node in &end {
        forces[node] = [200.0 / end.len() as f64, 0.0, -150.0 / end.len() as f64];
    }
    forces
}

fn equilibrium(mesh: &Mesh, held: &[usize], poisson: f64, load: &Load) -> Vec<[f64; 3]> {
    let body = Body::new(mesh.clone(), Element::Tet4, held).expect("supported");
    let material = Material::new(soft(poisson)).expect("in range");
    solve(&body, &material, load, &SolveSettings::default()).expect("an equilibrium").displacement
}

/// Random displacements of the nodes that are not held, mm.
fn shaken(mesh: &Mesh, held: &[usize], size: f64) -> Vec<[f64; 3]> {
    let mut random = Random::new(7);
    let mut rows: Vec<[f64; 3]> =
        (0..mesh.n_nodes()).map(|_| std::array::from_fn(|_| size * random.next())).collect();
    held.iter().for_each(|&node| rows[node] = [0.0; 3]);
    rows
}

fn still(body: &AdmmBody) -> Vec<[f64; 3]> {
    vec![[0.0; 3]; body.n_nodes()]
}

#[test]
fn without_inertia_iterations_converge_to_the_equilibrium_of_the_elements() {
    let (mesh, held) = small_bar();
    let forces = end_forces(&mesh);
    for poisson in [0.3, 0.45] {
        let wanted = equilibrium(&mesh, &held, poisson, &Load::from_forces(forces.clone()));
        let distances: Vec<f64> = [100, 200, 400, 800, 1600]
            .iter()
            .map(|&n| {
                let mut body = AdmmBody::new(&mesh, &held, &soft(poisson), 0.0).expect("supported");
                body.step(1.0, n, Some(&forces), None).expect("a step");
                largest_difference(body.displacement(), &wanted)
            })
            .collect();
        println!("{poisson}: {distances:?} of {}", largest(&wanted));
        for pair in distances.windows(2) {
            // Linear convergence: every doubling takes at least half away, down to the equilibrium's own tolerance.
            assert!(pair[1] < 0.5 * pair[0] || pair[1] < 1e-6, "{poisson}: {distances:?}");
        }
        // Near incompressibility the weight is far above the shear modulus and shear converges slowly: what 1,600
        // iterations leave at 0.45 is 3e-5 of the displacement.
        assert!(distances[4] < 1e-4 * largest(&wanted), "{poisson}: {distances:?}");
    }
}

#[test]
fn moved_supports_lead_to_the_equilibrium_too() {
    let (mesh, _) = small_bar();
    let held = nodes_where(&mesh, |x| x[0] < 1e-9 || x[0] > 60.0 - 1e-9);
    let moved: Vec<[f64; 3]> = held
        .iter()
        .map(|&n| if mesh.nodes()[n][0] > 1.0 { [-6.0, 0.0, 8.0] } else { [0.0; 3] })
        .collect();
    let wanted = equilibrium(&mesh, &held, 0.4, &Load::from_prescribed(moved.clone()));
    let mut body = AdmmBody::new(&mesh, &held, &soft(0.4), 0.0).expect("supported");
    body.step(1.0, 600, None, Some(&moved)).expect("a step");
    let distance = largest_difference(body.displacement(), &wanted);
    println!("{distance} mm");
    // Of 10 mm; the equilibrium is known to some 1e-8.
    assert!(distance < 1e-5, "{distance} mm");
}

#[test]
fn a_converged_step_balances_inertia_internal_forces_and_load() {
    let (mesh, held) = small_bar();
    let (dt, forces) = (0.02, end_forces(&mesh));
    let mut body = AdmmBody::new(&mesh, &held, &soft(0.45), 1.0).expect("supported");
    let before = shaken(&mesh, &held, 0.5);
    let velocity: Vec<[f64; 3]> = before.iter().map(|u| u.map(|v| 40.0 * v)).collect();
    body.set_state(&before, &velocity).expect("fits");
    body.step(dt, 2000, Some(&forces), None).expect("a step");
    let after = body.displacement();
    let model = Body::new(mesh.clone(), Element::Tet4, held.as_slice()).expect("supported");
    let material = Material::new(soft(0.45)).expect("in range");
    let inner = internal_forces(&model, &material, after).expect("upright");
    let size = largest(&inner);
    for node in (0..mesh.n_nodes()).filter(|node| !held.contains(node)) {
        for i in 0..3 {
            let change = after[node][i] - before[node][i] - dt * velocity[node][i];
            let inertia = body.masses()[node] * change / (dt * dt);
            let balance: f64 = inertia + inner[node][i] - forces[node][i];
            // What two thousand iterations leave.
            assert!(balance.abs() < 1e-6 * size, "node {node}: {balance:e} of {size} mN");
        }
    }
}

#[test]
fn a_released_body_never_gains_energy() {
    let (mesh, held) = small_bar();
    let forces = end_forces(&mesh);
    let bent = equilibrium(&mesh, &held, 0.45, &Load::from_forces(forces));
    let mut body = AdmmBody::new(&mesh, &held, &soft(0.45), 1.0).expect("supported");
    body.set_state(&bent, &still(&body)).expect("fits");
    let mut energy = body.elastic_energy() + body.kinetic_energy();
    let first = energy;
    for _ in 0..40 {
        body.step(0.005, 100, None, None).expect("a step");
        let next = body.elastic_energy() + body.kinetic_energy();
        // What iterations that end early may leave.
        assert!(next <= energy + 1e-9 * first, "{energy} to {next} uJ");
        energy = next;
    }
    assert!(energy < 0.9 * first, "implicit Euler takes energy away: {first} to {energy} uJ");
}

#[test]
fn a_free_body_keeps_its_momentum_and_its_centre_moves_straight_on() {
    let (mesh, _) = small_bar();
    let mut body = AdmmBody::new(&mesh, &[], &soft(0.45), 1.0).expect("it has inertia");
    let push: Vec<[f64; 3]> =
        shaken(&mesh, &[], 200.0).iter().map(|v| [v[0] + 100.0, v[1], v[2] - 50.0]).collect();
    body.set_state(&shaken(&mesh, &[], 1.0), &push).expect("fits");
    let masses = body.masses().to_vec();
    let sum = |rows: &[[f64; 3]]| -> [f64; 3] {
        std::array::from_fn(|i| rows.iter().zip(&masses).map(|(row, m)| m * row[i]).sum())
    };
    let (momentum, place) = (sum(body.velocity()), sum(body.displacement()));
    for step in 1..=20 {
        // Few iterations: momentum does not wait for convergence.
        body.step(0.01, 3, None, None).expect("a step");
        for i in 0..3 {
            let (now, here) = (sum(body.velocity())[i], sum(body.displacement())[i]);
            let there = place[i] + 0.01 * f64::from(step) * momentum[i];
            // Rounding of some thousand sums, times 1/dt.
            assert!((now - momentum[i]).abs() < 1e-9 * largest(&[momentum]), "{now}");
            assert!((here - there).abs() < 1e-9 * largest(&[momentum]), "{here} {there}");
        }
    }
}

#[test]
fn an_inverted_body_comes_back() {
    let (mesh, held) = small_bar();
    let mut body = AdmmBody::new(&mesh, &held, &soft(0.45), 1.0).expect("supported");
    body.set_state(&shaken(&mesh, &held, 12.0), &still(&body)).expect("fits");
    assert_eq!(body.elastic_energy(), f64::INFINITY, "some tetrahedra are inverted");
    for _ in 0..40 {
        body.step(0.05, 50, None, None).expect("a step");
    }
    assert!(body.elastic_energy() < 1.0, "{} uJ", body.elastic_energy());
}

#[test]
fn the_bits_do_not_depend_on_the_number_of_threads() {
    let (mesh, held) = small_bar();
    let forces = end_forces(&mesh);
    let run = |parallel: bool, n_threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n_threads).build().expect("threads");
        pool.install(|| {
            let mut body = AdmmBody::new(&mesh, &held, &soft(0.45), 1.0).expect("supported");
            body.set_parallel(parallel);
            for _ in 0..3 {
                body.step(0.025, 7, Some(&forces), None).expect("a step");
            }
            (body.displacement().to_vec(), body.velocity().to_vec())
        })
    };
    let alone = run(false, 1);
    for n_threads in [1, 2, 5] {
        assert_eq!(run(true, n_threads), alone, "{n_threads} threads");
    }
}

#[test]
fn wrong_input_is_refused_and_changes_nothing() {
    let (mesh, held) = small_bar();
    let make = |held: &[usize], density| AdmmBody::new(&mesh, held, &soft(0.45), density).err();
    let must = "0 or more, in g/cm^3";
    let wrong = FemError::BadParameter { name: "density", must, found: -1.0 };
    assert_eq!(make(&held, -1.0), Some(wrong));
    assert!(matches!(make(&[], 0.0), Some(FemError::Unconstrained(_))));
    assert!(matches!(make(&[999], 1.0), Some(FemError::HeldNodeOutOfRange { node: 999, .. })));
    let many = Stiffness::PerTet { young: vec![10.0; 3], poisson: vec![0.3] };
    let short = AdmmBody::new(&mesh, &held, &many, 1.0).err();
    assert!(matches!(short, Some(FemError::WrongLength { found: 3, .. })), "{short:?}");

    let mut body = AdmmBody::new(&mesh, &held, &soft(0.45), 1.0).expect("supported");
    let start = shaken(&mesh, &held, 0.1);
    body.set_state(&start, &still(&body)).expect("fits");
    let bad = |found| FemError::BadSetting { name: "dt", must: "above 0, in s", found };
    assert_eq!(body.step(0.0, 1, None, None).err(), Some(bad(0.0)));
    let few = body.step(0.1, 1, Some(&[[0.0; 3]]), None).err();
    assert!(matches!(few, Some(FemError::WrongLength { found: 1, .. })));
    let huge = vec![[1e305; 3]; mesh.n_nodes()];
    let far = body.step(1e3, 2, Some(&huge), None).err();
    assert!(matches!(far, Some(FemError::NonFinite { .. })), "{far:?}");
    assert_eq!(body.displacement(), start);
    assert_eq!(body.velocity(), still(&body));
}
