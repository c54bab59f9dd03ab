//! Does it agree with others?
#![allow(clippy::expect_used, clippy::panic)]

mod common;

use std::path::Path;

use common::{largest, largest_difference, npz};
use tissuereg_fem::{
    Behaviour, Body, Element, History, Load, Material, Mesh, Softening, SofteningForm,
    SolveSettings, solve,
};

#[test]
fn a_bent_bar_agrees_with_scikit_fem() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/bar_reference.npz");
    let arrays = npz::read(&path).expect("committed");
    let material =
        Material::neo_hookean(arrays["young_kPa"].values[0], arrays["poisson"].values[0])
            .expect("sound");
    let load = Load {
        body_force: arrays["body_force"].rows3()[0],
        ..Load::from_forces(arrays["forces_mN"].rows3())
    };
    for (element, name) in
        [(Element::Tet4, "displacement_tet4_mm"), (Element::Tet10, "displacement_tet10_mm")]
    {
        let mesh =
            Mesh::new(arrays["nodes_mm"].rows3(), arrays["tets"].index_rows()).expect("sound");
        let body = Body::new(mesh, element, arrays["fixed_nodes"].indices()).expect("held");
        let answer = solve(&body, &material, &load, &SolveSettings::default()).expect("bends");
        let reference = arrays[name].rows3();
        let error = largest_difference(&answer.displacement[..body.n_corner_nodes()], &reference);
        assert!(error < 1e-8 * largest(&reference), "{name}: {error} mm");
    }
}

#[test]
fn a_softening_bar_agrees_with_felupe_through_load_and_unload() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data");
    let bar = npz::read(&folder.join("bar_reference.npz")).expect("committed");
    let reference = npz::read(&folder.join("history_reference.npz")).expect("committed");
    let material =
        Material::neo_hookean(bar["young_kPa"].values[0], bar["poisson"].values[0]).expect("sound");
    let [r, m_kpa, beta] = reference["softening"].rows3()[0];
    let behaviour = Behaviour {
        softening: Some(Softening { form: SofteningForm::OgdenRoxburgh, r, m_kpa, beta }),
        ..Behaviour::default()
    };
    let mesh = Mesh::new(bar["nodes_mm"].rows3(), bar["tets"].index_rows()).expect("sound");
    let body = Body::new(mesh, Element::Tet4, bar["fixed_nodes"].indices()).expect("held");
    let mut history = History::new(&body, material, behaviour).expect("sound");
    let frames = reference["displacement_mm"].rows3();
    for (frame, factor) in reference["factors"].values.iter().enumerate() {
        let forces = bar["forces_mN"].rows3();
        let load = Load::from_forces(forces.iter().map(|f| f.map(|v| factor * v)).collect());
        let settings = SolveSettings::default().with_tolerance(1e-10);
        let answer = history.advance(&body, &load, frame as f64, &settings).expect("an answer");
        let wanted = &frames[frame * body.n_nodes()..(frame + 1) * body.n_nodes()];
        let error = largest_difference(&answer.displacement, wanted);
        assert!(error < 1e-6 * largest(wanted), "frame {frame}: {error} mm");
    }
}

/// Files next to the repository: domes solved by FEBio, felupe, scikit-fem and dolfinx.
#[test]
fn the_shared_domes_agree_with_four_solvers() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/reference");
    let files = ["dome_4k_pull", "dome_4k_push", "dome_4k_pull_nu049", "dome_20k_pull"];
    for name in files {
        let path = folder.join(format!("{name}.npz"));
        let Ok(arrays) = npz::read(&path) else {
            println!("skipped: {} is not there", path.display());
            continue;
        };
        let mesh =
            Mesh::new(arrays["nodes_mm"].rows3(), arrays["tets"].index_rows()).expect("sound");
        let body = Body::new(mesh, Element::Tet4, arrays["fixed_nodes"].indices()).expect("held");
        let young = arrays["young_kPa"].values[0];
        let material = Material::neo_hookean(young, arrays["poisson"].values[0]).expect("sound");
        let load = Load::from_forces(arrays["forces_mN"].rows3());
        let answer = solve(&body, &material, &load, &SolveSettings::default()).expect("an answer");
        let reference = arrays["displacement_mm"].rows3();
        let error = largest_difference(&answer.displacement, &reference);
        assert!(error < 1e-8 * largest(&reference), "{name}: {error} mm");
    }
}
