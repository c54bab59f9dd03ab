//! Is it still cheap? Iterations, factorisations and analyses are part of the contract.
#![allow(clippy::expect_used, clippy::panic)]

mod common;

use common::{bar, clamped_at_x0, nodes_where};
use tissuereg_fem::{
    Body, Element, Load, Material, Member, Method, SolveSettings, Supports, solve, solve_many,
};

fn pulled_bar(force: f64) -> (Body, Load) {
    let body = clamped_at_x0(bar([8, 4, 4], [40.0, 20.0, 20.0]), Element::Tet4);
    let tips = nodes_where(body.mesh(), |x| x[0] > 40.0 - 1e-9);
    let mut forces = vec![[0.0; 3]; body.n_nodes()];
    for &tip in &tips {
        forces[tip] = [force / tips.len() as f64, 0.0, 0.0];
    }
    (body, Load::from_forces(forces))
}

#[test]
fn a_stretch_of_a_tenth_takes_one_factor_and_few_iterations() {
    let (body, load) = pulled_bar(400.0);
    let material = Material::neo_hookean(10.0, 0.45).expect("sound");
    let report =
        solve(&body, &material, &load, &SolveSettings::default()).expect("stretches").report;
    assert_eq!((report.analyses, report.factorisations, report.load_steps), (1, 1, 1));
    assert!((8..=16).contains(&report.iterations), "{report:?}");
    assert_eq!(report.solves, report.iterations);
    assert!(report.evaluations <= report.iterations + 2, "{report:?}");
}

/// The rest factor is carried along; left where it was made, it leads nowhere.
#[test]
fn a_bar_bent_by_two_thirds_of_its_length_needs_no_new_factor() {
    let body = clamped_at_x0(bar([12, 3, 3], [60.0, 12.0, 12.0]), Element::Tet4);
    let tips = nodes_where(body.mesh(), |x| x[0] > 60.0 - 1e-9);
    let mut forces = vec![[0.0; 3]; body.n_nodes()];
    for &tip in &tips {
        forces[tip] = [0.0, 0.0, 30.0 / tips.len() as f64];
    }
    let material = Material::neo_hookean(10.0, 0.45).expect("sound");
    let settings = SolveSettings::default().with_method(Method::QuasiNewton);
    let answer = solve(&body, &material, &Load::from_forces(forces), &settings).expect("bends");
    let (report, deflection) = (answer.report, answer.displacement[tips[0]][2]);
    assert!(deflection > 39.0, "{deflection}");
    assert_eq!((report.factorisations, report.load_steps), (1, 1), "{report:?}");
    assert!((40..=75).contains(&report.iterations), "{report:?}");
}

#[test]
fn newton_takes_five_factors() {
    let (body, load) = pulled_bar(400.0);
    let material = Material::neo_hookean(10.0, 0.45).expect("sound");
    let settings = SolveSettings::default().with_method(Method::Newton);
    let report = solve(&body, &material, &load, &settings).expect("stretches").report;
    assert!((4..=6).contains(&report.iterations), "{report:?}");
    // The rest factor serves the linear start of moved supports and the rounding estimate.
    assert_eq!(report.factorisations, report.iterations + 1);
}

#[test]
fn no_load_takes_no_iteration() {
    let (body, _) = pulled_bar(0.0);
    let material = Material::neo_hookean(10.0, 0.45).expect("sound");
    let answer =
        solve(&body, &material, &Load::default(), &SolveSettings::default()).expect("rests");
    assert_eq!(answer.report.iterations, 0);
    assert!(answer.displacement.iter().all(|u| *u == [0.0; 3]));
}

#[test]
fn a_held_body_without_unknowns_is_solved_at_once() {
    let mesh = bar([1, 1, 1], [10.0; 3]);
    let all: Vec<usize> = (0..mesh.n_nodes()).collect();
    let body = Body::new(mesh, Element::Tet4, Supports::from(all)).expect("held");
    let material = Material::neo_hookean(10.0, 0.45).expect("sound");
    let rows: Vec<[f64; 3]> = body.nodes().iter().map(|x| [0.1 * x[0], 0.0, 0.0]).collect();
    let answer =
        solve(&body, &material, &Load::from_prescribed(rows.clone()), &SolveSettings::default())
            .expect("nothing to find");
    assert_eq!(answer.displacement, rows);
    assert_eq!(answer.report.iterations, 0);
}

/// Proportional stiffness under proportional load is the same problem: the iterations must be the
/// same as well, since the factor is shared and scaled.
#[test]
fn members_of_proportional_stiffness_take_the_same_iterations() {
    let (body, load) = pulled_bar(400.0);
    let (_, double_load) = pulled_bar(800.0);
    let one = Material::neo_hookean(10.0, 0.45).expect("sound");
    let two = Material::neo_hookean(20.0, 0.45).expect("sound");
    let members = [
        Member { material: &one, load: &load, start: None },
        Member { material: &two, load: &double_load, start: None },
    ];
    let reports: Vec<_> = solve_many(&body, &members, &SolveSettings::default())
        .into_iter()
        .map(|o| o.solution().expect("stretches").report)
        .collect();
    assert_eq!(reports[0].iterations, reports[1].iterations);
    assert_eq!(reports[0].factorisations, 1);
}

/// A bar held at one end, which is turned: nothing is strained, whatever the angle.
#[test]
fn a_turn_of_the_only_support_takes_no_iteration() {
    let body = clamped_at_x0(bar([6, 2, 2], [40.0, 10.0, 10.0]), Element::Tet10);
    let material = Material::neo_hookean(10.0, 0.45).expect("sound");
    for degrees in [30.0_f64, 90.0, 170.0] {
        let (sin, cos) = degrees.to_radians().sin_cos();
        let turned = |x: &[f64; 3]| {
            let (y, z) = (x[1] - 5.0, x[2] - 5.0);
            [0.0, cos * y - sin * z - y, sin * y + cos * z - z]
        };
        let rows = body.held_nodes().iter().map(|&n| turned(&body.nodes()[n])).collect();
        let answer =
            solve(&body, &material, &Load::from_prescribed(rows), &SolveSettings::default())
                .expect("turns");
        assert_eq!((answer.report.iterations, answer.report.load_steps), (0, 1), "{degrees}");
        assert!(answer.report.factorisations <= 2, "{degrees}");
        for (u, x) in answer.displacement.iter().zip(body.nodes()) {
            for (found, exact) in u.iter().zip(turned(x)) {
                assert!((found - exact).abs() < 1e-9, "{degrees}: {found} for {exact}");
            }
        }
    }
}

/// One end of a bar is turned about its axis against the other, further than straight chords of
/// its nodes could go: at 180 degrees these meet on the axis.
#[test]
fn a_twist_by_nearly_half_a_turn_is_followed() {
    let mesh = bar([10, 2, 2], [60.0, 10.0, 10.0]);
    let held = nodes_where(&mesh, |x| x[0] < 1e-9 || x[0] > 60.0 - 1e-9);
    let body = Body::new(mesh, Element::Tet4, held).expect("held");
    let material = Material::neo_hookean(10.0, 0.3).expect("sound");
    let (sin, cos) = 170.0_f64.to_radians().sin_cos();
    let rows = (body.held_nodes().iter().map(|&n| body.nodes()[n]))
        .map(|x| {
            let (y, z) = (x[1] - 5.0, x[2] - 5.0);
            if x[0] < 1.0 { [0.0; 3] } else { [0.0, cos * y - sin * z - y, sin * y + cos * z - z] }
        })
        .collect();
    let answer = solve(&body, &material, &Load::from_prescribed(rows), &SolveSettings::default())
        .expect("twists");
    assert!(answer.report.load_steps <= 12, "{:?}", answer.report);
    assert!(answer.report.factorisations <= 40, "{:?}", answer.report);
    let moment: f64 = (body.held_nodes().iter().zip(&answer.reactions))
        .filter(|(n, _)| body.nodes()[**n][0] > 1.0)
        .map(|(&n, r)| {
            let place: Vec<f64> =
                (0..3).map(|i| body.nodes()[n][i] + answer.displacement[n][i] - 5.0).collect();
            place[1] * r[2] - place[2] * r[1]
        })
        .sum();
    assert!(moment > 0.0, "the end resists by {moment} mN mm");
}

/// Every front that is made fits the size that was announced: the cubes of a bar grow as theory predicts.
#[test]
fn the_size_of_a_factor_is_known_before_it_is_made() {
    let size = |n: usize| {
        let body = clamped_at_x0(bar([n, n, n], [20.0, 20.0, 20.0]), Element::Tet4);
        (body.n_unknowns() as f64, body.factor_size())
    };
    let (small_unknowns, small) = size(6);
    let (large_unknowns, large) = size(12);
    let growth = (large_unknowns / small_unknowns).ln();
    // Nested dissection in space: entries grow as n^(4/3), operations as n^2, a little less where small.
    let entries = (large.n_entries as f64 / small.n_entries as f64).ln() / growth;
    let flops = (large.flops / small.flops).ln() / growth;
    assert!((1.15..=1.45).contains(&entries), "{entries}");
    assert!((1.7..=2.3).contains(&flops), "{flops}");
    for (unknowns, one) in [(small_unknowns, small), (large_unknowns, large)] {
        // A factor has its diagonal at least, and no more than a dense one with its filled-up blocks.
        assert!(one.n_entries as f64 > unknowns);
        assert!(one.flops <= (unknowns + 1.0).powi(3) / 3.0 + (unknowns + 1.0).powi(2));
        assert!(one.n_working > 0 && one.n_working < 4 * one.n_entries);
    }
}
