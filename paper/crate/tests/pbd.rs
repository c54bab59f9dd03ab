//! Position-based dynamics: springs, volumes and observed places against what is known of them.
#![allow(clippy::expect_used, clippy::panic)]

#[path = "../../../crates/fem/tests/common/meshes.rs"]
mod common;

use common::{bar, largest_difference, nodes_where};
use tissuereg_fem::{FemError, Mesh};
use tissuereg_paper::{PaperError, Pbd, PbdConstraint, PbdObservation};

fn spring(compliance: f64) -> PbdConstraint<2> {
    PbdConstraint { particles: [0, 1], rest: 10.0, compliance }
}

/// Edges and tetrahedra of a bar as constraints, with compliances.
fn body(mesh: &Mesh, held: &[usize], edge: f64, tet: f64) -> Pbd {
    let mut pairs: Vec<[usize; 2]> = mesh
        .tets()
        .iter()
        .flat_map(|t| [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]].map(|[a, b]| [t[a], t[b]]))
        .map(|[a, b]| [a.min(b), a.max(b)])
        .collect();
    pairs.sort_unstable();
    pairs.dedup();
    let edges: Vec<_> = pairs
        .into_iter()
        .map(|particles| PbdConstraint { particles, rest: 0.0, compliance: edge })
        .collect();
    let tets: Vec<_> = mesh
        .tets()
        .iter()
        .map(|&particles| PbdConstraint { particles, rest: 0.0, compliance: tet })
        .collect();
    // A gram a node.
    let mut inverse = vec![1e3; mesh.n_nodes()];
    held.iter().for_each(|&node| inverse[node] = 0.0);
    let mut pbd = Pbd::new(inverse, &edges, &tets).expect("sound");
    pbd.set_rest(mesh.nodes()).expect("fits");
    pbd
}

/// Largest change of a tetrahedron's volume, over the volume.
fn largest_change(mesh: &Mesh, places: &[[f64; 3]]) -> f64 {
    let moved = Mesh::new(places.to_vec(), mesh.tets().to_vec()).expect("upright");
    let change = |t: usize| (moved.tet_volume(t) / mesh.tet_volume(t) - 1.0).abs();
    (0..mesh.n_tets()).map(change).fold(0.0, f64::max)
}

#[test]
fn one_spring_moves_both_ends_by_the_closed_form() {
    let (a, dt, masses) = (0.02, 0.1, [2.0, 0.5]);
    let mut pbd = Pbd::new(masses.map(|m| 1.0 / m).to_vec(), &[spring(a)], &[]).expect("sound");
    let mut places = [[0.0, 0.0, 0.0], [3.0, 0.0, 14.0]];
    let (length, inverse) = ((9.0_f64 + 196.0).sqrt(), 1.0 / masses[0] + 1.0 / masses[1]);
    let pull = (10.0 - length) / (inverse + a / (dt * dt));
    pbd.project(&mut places, &[], dt, 20).expect("fits");
    // Along its line a distance is linear: one iteration is exact, the others change nothing.
    let unit = [3.0 / length, 0.0, 14.0 / length];
    for i in 0..3 {
        assert!((places[0][i] + unit[i] * pull / masses[0]).abs() < 1e-12, "{places:?}");
        let far = [3.0, 0.0, 14.0][i] + unit[i] * pull / masses[1];
        assert!((places[1][i] - far).abs() < 1e-12, "{places:?}");
    }
}

#[test]
fn a_weight_on_a_spring_comes_to_rest_where_hooke_has_it() {
    // 3 g on 0.25 mm/mN sag by 3e-3 kg 9810 mm/s² 0.25 mm/mN.
    let (mass, a, dt) = (3e-3, 0.25, 0.05);
    let mut pbd = Pbd::new(vec![0.0, 1.0 / mass], &[spring(a)], &[]).expect("sound");
    let mut places = [[0.0; 3], [0.0, 0.0, -10.0]];
    for _ in 0..200 {
        places[1][2] -= dt * dt * 9810.0;
        pbd.project(&mut places, &[], dt, 1).expect("fits");
    }
    assert!((places[1][2] + 10.0 + mass * 9810.0 * a).abs() < 1e-9, "{places:?}");
}

#[test]
fn a_stretched_body_comes_back_to_its_volume_where_volumes_are_rigid() {
    let mesh = bar([4, 2, 2], [40.0, 20.0, 20.0]);
    let after = |compliance: f64| {
        let mut places: Vec<[f64; 3]> =
            mesh.nodes().iter().map(|x| [1.2 * x[0], x[1], x[2]]).collect();
        // Edges that hardly resist.
        body(&mesh, &[], 1e6, compliance).project(&mut places, &[], 1.0, 1000).expect("fits");
        largest_change(&mesh, &places)
    };
    // What a thousand rounds of Gauss-Seidel leave of a fifth.
    assert!(after(0.0) < 1e-3, "{}", after(0.0));
    assert!(after(1e9) > 0.1, "{}", after(1e9));
}

#[test]
fn an_observation_of_tiny_compliance_is_met_and_a_soft_one_is_not() {
    let mesh = bar([4, 2, 2], [40.0, 20.0, 20.0]);
    let held = nodes_where(&mesh, |x| x[0] < 1e-9);
    let end = nodes_where(&mesh, |x| x[0] > 40.0 - 1e-9);
    let weights = vec![(end[0], 0.5), (end[1], 0.3), (end[2], 0.2)];
    let at = |places: &[[f64; 3]]| -> [f64; 3] {
        std::array::from_fn(|i| weights.iter().map(|&(node, b)| b * places[node][i]).sum())
    };
    let place = at(mesh.nodes()).map(|v| v + 3.0);
    let off = |compliance: f64| {
        let mut places = mesh.nodes().to_vec();
        let seen = PbdObservation { weights: weights.clone(), place, compliance };
        body(&mesh, &held, 0.1, 0.01).project(&mut places, &[seen], 0.1, 300).expect("fits");
        largest_difference(&[at(&places)], &[place])
    };
    // It is met last in every iteration.
    assert!(off(1e-9) < 1e-6, "{} mm", off(1e-9));
    assert!(off(10.0) > 0.5, "{} mm", off(10.0));
}

#[test]
fn places_that_are_kept_stay() {
    let mesh = bar([4, 2, 2], [40.0, 20.0, 20.0]);
    let mut pbd = body(&mesh, &[], 0.1, 0.01);
    let moved: Vec<[f64; 3]> =
        mesh.nodes().iter().map(|x| [x[0] * 1.1, x[1] - x[0], x[2]]).collect();
    pbd.set_rest(&moved).expect("fits");
    let mut places = moved.clone();
    pbd.project(&mut places, &[], 0.1, 10).expect("fits");
    // Rounding.
    assert!(largest_difference(&places, &moved) < 1e-11);
    assert_eq!(pbd.rest().1.len(), mesh.n_tets());
}

#[test]
fn wrong_constraints_are_refused() {
    let wrong = PbdConstraint { particles: [0, 2], rest: 1.0, compliance: 0.0 };
    let missing = Pbd::new(vec![1.0, 1.0], &[wrong], &[]).err();
    assert_eq!(missing, Some(PaperError::NoSuchParticle { particle: 2, n_particles: 2 }));
    let must = "0 or more";
    let negative = FemError::BadParameter { name: "compliance", must, found: -1.0 };
    assert_eq!(Pbd::new(vec![1.0, 1.0], &[spring(-1.0)], &[]).err(), Some(negative.into()));
    let mut pbd = Pbd::new(vec![1.0, 1.0], &[spring(0.0)], &[]).expect("sound");
    let seen = PbdObservation { weights: vec![(5, 1.0)], place: [0.0; 3], compliance: 0.0 };
    let mut places = [[0.0; 3], [1.0, 0.0, 0.0]];
    let missing = pbd.project(&mut places, &[seen], 0.1, 1).err();
    assert_eq!(missing, Some(PaperError::NoSuchParticle { particle: 5, n_particles: 2 }));
    let bad = FemError::BadSetting { name: "dt", must: "above 0, in s", found: f64::NAN };
    assert_eq!(
        pbd.project(&mut places, &[], f64::NAN, 1).err().map(|e| e.to_string()),
        Some(bad.to_string())
    );
}
