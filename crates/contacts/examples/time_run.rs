#![allow(missing_docs, clippy::unwrap_used)]
#[path = "../tests/common/mod.rs"]
mod common;
use common::{Case, run};
use faer::Par;
use tissuereg_contacts::ChainSettings;
fn main() {
    let case = Case::organ(15);
    let (problem, settings) = (case.problem(), ChainSettings::default());
    let r = run(&problem, &settings, 16, Par::Seq);
    println!("{:?}", r.counters);
    for (name, powers, n_local, n_level) in [
        ("all", settings.powers.clone(), 4, 2),
        ("tables", vec![1.0; 9], 0, 0),
        ("steps", vec![1.0; 9], 4, 0),
        ("levels", vec![1.0; 9], 0, 2),
    ] {
        let s = ChainSettings { powers, n_kept: 1, n_local, n_level, ..settings.clone() };
        let mut best = f64::MAX;
        let mut c = None;
        for _ in 0..5 {
            let t = std::time::Instant::now();
            let r = run(&problem, &s, 16, Par::Seq);
            best = best.min(t.elapsed().as_secs_f64());
            c = Some(r.counters);
        }
        println!("{name}: {:.1} ms {c:?}", best * 1e3);
    }
}
