//! Cook's membrane and a pressed block near incompressibility, compared with published values.
//!
//! `cargo run --release --example incompressible [-- --fine]`
//!
//! Prints, for linear, averaged and quadratic tets under refinement, the measured displacement, its
//! distance from the published one, the least and largest volume ratio of an element and how rough
//! the pressure is from node to node (`Evenness`).

#[path = "../tests/common/mod.rs"]
mod common;

use std::error::Error;
use std::time::Instant;

use common::incompressible::{BLOCK, BLOCK_POISSON, COOK, Problem, block, cook, evenness};
use tissuereg_fem::{Element, SolveSettings, solve};

const ELEMENTS: [(&str, Element); 3] =
    [("tet4", Element::Tet4), ("tet4-averaged", Element::Tet4Averaged), ("tet10", Element::Tet10)];

fn main() -> Result<(), Box<dyn Error>> {
    let fine = std::env::args().any(|argument| argument == "--fine");
    let cells = |element: Element, cook: bool| -> &[usize] {
        match (element, cook, fine) {
            (Element::Tet10, true, false) => &[4, 8],
            (Element::Tet10, true, true) => &[4, 8, 16, 24],
            (_, true, false) => &[8, 16, 24],
            (_, true, true) => &[8, 16, 24, 32],
            (Element::Tet10, false, false) => &[2, 4],
            (Element::Tet10, false, true) => &[2, 4, 6],
            (_, false, false) => &[2, 4, 8],
            (_, false, true) => &[2, 4, 8, 12],
        }
    };
    println!(
        "| problem, nu | published, mm | element | cells | unknowns | found, mm | off | volume ratios | \
         roughness | iterations, factorisations | s |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|");
    // Published values at 0.499 and 0.4999 enclose that at 0.4995.
    let between = [(0.4995, 0.5 * (COOK[3].1 + COOK[4].1))];
    for (poisson, published) in COOK.iter().chain(&between).copied() {
        for (name, element) in ELEMENTS {
            for &n in cells(element, true) {
                row("Cook", poisson, published, name, n, || cook(n, element, poisson))?;
            }
        }
    }
    for poisson in [BLOCK_POISSON, 0.4995] {
        for (name, element) in ELEMENTS {
            for &n in cells(element, false) {
                row("block", poisson, BLOCK, name, n, || block(n, element, poisson))?;
            }
        }
    }
    Ok(())
}

fn row(
    problem: &str,
    poisson: f64,
    published: f64,
    element: &str,
    cells: usize,
    make: impl FnOnce() -> Problem,
) -> Result<(), Box<dyn Error>> {
    let start = Instant::now();
    let Problem { body, material, load, node, axis } = make();
    let settings = SolveSettings::default().with_tolerance(1e-6);
    let answer = solve(&body, &material, &load, &settings)?;
    let seconds = start.elapsed().as_secs_f64();
    let even = evenness(&body, &answer.displacement);
    let found = answer.displacement[node][axis].abs();
    println!(
        "| {problem}, {poisson:.4} | {published:.3} | {element} | {cells} | {} | {found:.3} | {:+.2} % | \
         {:.3}, {:.3} | {:.2} | {}, {} | {seconds:.2} |",
        body.n_unknowns(),
        100.0 * (found / published - 1.0),
        even.range[0],
        even.range[1],
        even.roughness,
        answer.report.iterations,
        answer.report.factorisations,
    );
    Ok(())
}
