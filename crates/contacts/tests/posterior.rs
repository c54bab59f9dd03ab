//! Calibration: truths drawn from the prior itself lie in regions as often as the regions say.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use common::{Case, Numbers};
use faer::{Mat, Par};
use tissuereg_contacts::{ChainSettings, Configuration, Family, Observed, Patch, Prior, Wrong};

const N_TRUTHS: usize = 400;
const N_DRAWS: usize = 99;

/// Places on a line of 30 with responses that fade; 4 markers and 2 points between them.
fn case() -> (Case, Mat<f64>) {
    let respond = |at: f64, column: usize, axis: usize| {
        let near = 1.0 / (1.0 + ((at - (column / 3) as f64) / 4.0).powi(2));
        near * if axis == column % 3 { 1.0 } else { 0.2 }
    };
    let by = |places: &[f64]| {
        Mat::from_fn(3 * places.len(), 90, |i, j| respond(places[i / 3], j, i % 3))
    };
    let mut patches = vec![Patch::default(); 30];
    for place in 1..30 {
        patches[place].neighbours.push(place - 1);
        patches[place - 1].neighbours.push(place);
    }
    for place in (2..28).step_by(5) {
        patches[place].texture = vec![(place - 1, 0.4), (place + 1, 0.4)];
    }
    let prior = Prior {
        n_slots: 2,
        variances: vec![0.25, 4.0],
        log_empty: 0.4_f64.ln(),
        log_filled: vec![0.01_f64.ln(); 60],
        families: vec![Family {
            variances: vec![0.01; 90],
            factors: vec![0.3, 1.0, 3.0],
            log_prior: [0.3, 0.4, 0.3].map(f64::ln).to_vec(),
        }],
        wrong: Wrong {
            rows: (0..4).map(|m| (3 * m..3 * m + 3).collect()).collect(),
            variance: 4.0,
            log_odds: (0.1_f64 / 0.9).ln(),
        },
    };
    let noise = Mat::from_fn(12, 12, |i, j| if i == j { 0.04 } else { 0.0 });
    let observed = Observed { innovation: vec![0.0; 12], noise };
    let columns = by(&[3.0, 11.0, 18.0, 26.0]);
    (Case { columns, patches, prior, observed }, by(&[7.0, 22.0]))
}

/// An entry by its probability.
fn chosen(uniform: f64, log_probability: impl Iterator<Item = f64>) -> usize {
    let mut sum = 0.0;
    log_probability
        .take_while(|log| {
            sum += log.exp();
            sum <= uniform
        })
        .count()
}

/// Coefficients and innovation drawn from the prior.
fn truth(case: &Case, numbers: &mut Numbers) -> (Vec<f64>, Vec<f64>) {
    let prior = &case.prior;
    let family = &prior.families[0];
    let factor = family.factors[chosen(numbers.uniform(), family.log_prior.iter().copied())];
    let mut variances: Vec<f64> = family.variances.iter().map(|v| factor * v).collect();
    for _ in 0..prior.n_slots {
        let filled = prior.log_filled.iter().copied();
        let entry = chosen(numbers.uniform(), std::iter::once(prior.log_empty).chain(filled));
        if let Some(entry) = entry.checked_sub(1).map(|entry| entry.min(59)) {
            let (patch, own) = (entry / 2, prior.variances[entry % 2]);
            let texture = case.patches[patch].texture.iter().copied();
            for (inner, ratio) in std::iter::once((patch, 1.0)).chain(texture) {
                variances[3 * inner..3 * inner + 3]
                    .iter_mut()
                    .for_each(|v| *v += own * ratio * ratio);
            }
        }
    }
    let coefficients: Vec<f64> = variances.iter().map(|v| v.sqrt() * numbers.normal()).collect();
    let wrong: Vec<bool> = (0..4).map(|_| numbers.uniform() < 0.1).collect();
    let innovation = (0..12).map(|i| {
        let moved: f64 = (0..90).map(|j| case.columns[(i, j)] * coefficients[j]).sum();
        let variance =
            case.observed.noise[(i, i)] + if wrong[i / 3] { prior.wrong.variance } else { 0.0 };
        moved + variance.sqrt() * numbers.normal()
    });
    let innovation = innovation.collect();
    (coefficients, innovation)
}

/// Squared Mahalanobis distance.
fn distance(covariance: &[[f64; 3]; 3], off: [f64; 3]) -> f64 {
    let a = covariance;
    let minor = |i: usize, j: usize| {
        let (r, s) = ([(i + 1) % 3, (i + 2) % 3], [(j + 1) % 3, (j + 2) % 3]);
        a[r[0]][s[0]] * a[r[1]][s[1]] - a[r[0]][s[1]] * a[r[1]][s[0]]
    };
    let determinant: f64 = (0..3).map(|j| a[0][j] * minor(0, j)).sum();
    (0..3).map(|i| (0..3).map(|j| off[i] * minor(j, i) * off[j]).sum::<f64>()).sum::<f64>()
        / determinant
}

/// Distances of both points of every truth to their moments; ranks of one component among draws.
fn trials() -> (Vec<f64>, Vec<usize>) {
    let (mut case, points) = case();
    let mut numbers = Numbers::new(12);
    let mut powers = vec![0.1, 0.4];
    powers.resize(16, 1.0);
    let settings = ChainSettings::default().with_powers(powers).with_n_kept(10);
    let (mut distances, mut ranks) = (Vec::new(), Vec::new());
    for _ in 0..N_TRUTHS {
        let (coefficients, innovation) = truth(&case, &mut numbers);
        case.observed.innovation = innovation;
        let problem = case.problem();
        let uniforms = numbers.uniforms(10, problem.n_uniforms(&settings));
        let run = problem.run(&settings, uniforms.as_ref(), &[], Par::Seq).unwrap();
        let samples: Vec<Configuration> =
            run.samples.into_iter().map(|s| s.configuration).collect();
        let moments = problem.moments(&samples, points.as_ref(), Par::Seq).unwrap();
        let along = |row: usize, c: &dyn Fn(usize) -> f64| {
            (0..90).map(|j| points[(row, j)] * c(j)).sum::<f64>()
        };
        for point in 0..2 {
            let off = [0, 1, 2]
                .map(|a| along(3 * point + a, &|j| coefficients[j]) - moments.means[point][a]);
            distances.push(distance(&moments.covariances[point], off));
        }
        let drawn =
            problem.draws(&samples, numbers.normals(102, N_DRAWS).as_ref(), Par::Seq).unwrap();
        let place = along(1, &|j| coefficients[j]);
        ranks.push((0..N_DRAWS).filter(|&draw| along(1, &|j| drawn[(j, draw)]) < place).count());
    }
    (distances, ranks)
}

#[test]
fn truths_of_the_prior_lie_in_their_regions() {
    let (distances, ranks) = trials();
    // The 90 % quantile of chi square with three degrees of freedom. Regions have the moments of a mixture with heavy
    // tails, so that a few more than 90 % lie inside; a covariance 25 times too wide or too narrow holds nearly all or
    // hardly any.
    let share = |scale: f64| {
        distances.iter().filter(|d| *d / scale < 6.251).count() as f64 / distances.len() as f64
    };
    let fits = |share: f64| (0.87..0.96).contains(&share);
    assert!(fits(share(1.0)), "{}", share(1.0));
    assert!(!fits(share(25.0)) && !fits(share(0.04)), "{} {}", share(25.0), share(0.04));
    // Ranks among draws are exact whatever the shape: binomial, 400 of 0.9 and of 0.5, four standard errors.
    let between = |low: usize, high: usize| {
        ranks.iter().filter(|&&rank| (low..high).contains(&rank)).count() as f64
            / ranks.len() as f64
    };
    assert!((between(5, 95) - 0.9).abs() < 0.06, "{}", between(5, 95));
    assert!((between(25, 75) - 0.5).abs() < 0.1, "{}", between(25, 75));
    assert!((between(0, 50) - 0.5).abs() < 0.1, "{}", between(0, 50));
}
