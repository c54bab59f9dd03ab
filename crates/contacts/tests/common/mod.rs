//! Problems shared by tests, the bench and the example.
#![allow(dead_code, missing_docs, clippy::unwrap_used)]

pub mod textbook;

use faer::{Mat, Par};
use tissuereg_contacts::{
    ChainSettings, ContactsError, Dictionary, Family, Observed, Patch, Prior, Problem, Run, Wrong,
};

/// A small generator of uniform and standard normal numbers (SplitMix64 and Box-Muller): the same numbers everywhere.
pub struct Numbers(u64);

impl Numbers {
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x2545_F491_4F6C_DD1D) ^ 0x9E37_79B9_7F4A_7C15)
    }

    pub fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }

    pub fn uniforms(&mut self, n_rows: usize, n_columns: usize) -> Mat<f64> {
        // Row by row: another chain changes nothing in those before.
        let rows: Vec<f64> = (0..n_rows * n_columns).map(|_| self.uniform()).collect();
        Mat::from_fn(n_rows, n_columns, |i, j| rows[i * n_columns + j])
    }

    pub fn normals(&mut self, n_rows: usize, n_columns: usize) -> Mat<f64> {
        let columns: Vec<f64> = (0..n_rows * n_columns).map(|_| self.normal()).collect();
        Mat::from_fn(n_rows, n_columns, |i, j| columns[i + j * n_rows])
    }
}

/// All that a problem is made of, to be changed at will.
#[derive(Clone)]
pub struct Case {
    pub columns: Mat<f64>,
    pub patches: Vec<Patch>,
    pub prior: Prior,
    pub observed: Observed,
}

impl Case {
    pub fn try_problem(&self) -> Result<Problem, ContactsError> {
        let dictionary = Dictionary::new(self.columns.clone(), self.patches.clone())?;
        Problem::new(dictionary, self.prior.clone(), self.observed.clone())
    }

    pub fn problem(&self) -> Problem {
        self.try_problem().unwrap()
    }

    /// Five observations, four patches of two sizes, one or two slots, texture inside patch 3, one family with two
    /// levels over everything and one more column, one group of two observations that may be wrong.
    pub fn tiny(n_slots: usize) -> Self {
        let mut numbers = Numbers::new(5);
        let columns = numbers.normals(5, 13);
        let mut patches = vec![Patch::default(); 4];
        patches[3].texture = vec![(0, 0.5), (1, 0.3)];
        // Lists of unequal length: the ratio of proposals counts.
        for (a, b) in [(0, 1), (0, 2), (0, 3), (1, 3)] {
            patches[a].neighbours.push(b);
            patches[b].neighbours.push(a);
        }
        let mut variances = vec![0.04; 13];
        variances[12] = 0.3;
        let prior = Prior {
            n_slots,
            variances: vec![0.3, 4.0],
            log_empty: 0.6_f64.ln(),
            log_filled: [0.08, 0.04, 0.05, 0.03, 0.06, 0.02, 0.07, 0.05].map(f64::ln).to_vec(),
            families: vec![Family {
                variances,
                factors: vec![0.25, 2.0],
                log_prior: vec![0.6_f64.ln(), 0.4_f64.ln()],
            }],
            wrong: Wrong { rows: vec![vec![1, 2]], variance: 9.0, log_odds: 0.2_f64.ln() },
        };
        let noise = Mat::from_fn(5, 5, |i, j| if i == j { 0.3 } else { 0.05 });
        let innovation = vec![0.9, -1.6, 0.4, 1.1, -0.3];
        Self { columns, patches, prior, observed: Observed { innovation, noise } }
    }

    /// As a registration has it: markers on a ball of 60 mm, 1,372 patches of five radii, six sizes, a background and a
    /// body force; two patches pushed by 4 and 7 mm, 0.1 mm noise, one marker 5 mm off.
    pub fn organ(n_markers: usize) -> Self {
        let mut numbers = Numbers::new(3);
        let radii = [6.0, 10.0, 16.0, 25.0, 40.0];
        let (centres, levels) = places(&[900, 320, 110, 32, 10]);
        let n_patches = centres.len();
        let markers: Vec<[f64; 3]> = (0..n_markers).map(|k| on_ball(k, n_markers)).collect();
        let mut columns = Mat::zeros(3 * n_markers, 3 * n_patches + 3);
        for (m, marker) in markers.iter().enumerate() {
            for (p, centre) in centres.iter().enumerate() {
                let near = (distance(marker, centre) / radii[levels[p]]).powi(2);
                for (a, axis) in marker.iter().enumerate() {
                    for (b, other) in centre.iter().enumerate() {
                        let same = if a == b { 1.0 } else { 0.0 };
                        let moved = 0.9 * same + 0.1 * axis * other / 3600.0;
                        columns[(3 * m + a, 3 * p + b)] = moved / (1.0 + near);
                    }
                }
            }
            for a in 0..3 {
                columns[(3 * m + a, 3 * n_patches + a)] = 1.0 + 0.3 * marker[a] / 60.0;
            }
        }
        let n_obs = 3 * n_markers;
        let mut innovation: Vec<f64> = (0..n_obs)
            .map(|i| 4.0 * columns[(i, 3 * 400)] - 7.0 * columns[(i, 3 * 1300 + 2)])
            .map(|moved| moved + 0.1 * numbers.normal())
            .collect();
        innovation[3 * (n_markers / 2)] += 5.0;
        let patches = lying(&centres, &levels, &radii);
        let noise = Mat::from_fn(n_obs, n_obs, |i, j| if i == j { 0.02 } else { 0.0 });
        let prior = organ_prior(&levels, &radii, n_markers, columns.ncols());
        Self { columns, patches, prior, observed: Observed { innovation, noise } }
    }
}

/// Sixteen chains of nine sweeps, as the first pass of a registration runs them.
pub fn run(problem: &Problem, settings: &ChainSettings, n_chains: usize, par: Par) -> Run {
    let uniforms = Numbers::new(1).uniforms(n_chains, problem.n_uniforms(settings));
    problem.run(settings, uniforms.as_ref(), &[], par).unwrap()
}

fn organ_prior(levels: &[usize], radii: &[f64], n_markers: usize, n_columns: usize) -> Prior {
    let sizes: [f64; 6] = [0.1, 0.3, 1.0, 3.0, 10.0, 30.0];
    let n_patches = levels.len();
    let count = |level: usize| levels.iter().filter(|&&l| l == level).count() as f64;
    let log_filled = levels.iter().flat_map(|&level| {
        let weights = sizes.map(|size| (-0.5 * (size / (0.5 * radii[level])).powi(2)).exp());
        let total: f64 = weights.iter().sum();
        weights.map(|weight| (0.4 / 1.4 / 5.0 / count(level) * weight / total).max(1e-300).ln())
    });
    let steps = (-6..=6).map(|k| 0.5 * f64::from(k));
    let family = |first: usize, last: usize, variance: f64, median: f64, spread: f64| Family {
        variances: (0..n_columns)
            .map(|j| if (first..last).contains(&j) { variance } else { 0.0 })
            .collect(),
        factors: steps.clone().map(|s| median * median * (2.0 * spread * s).exp()).collect(),
        log_prior: steps.clone().map(|s| -0.5 * s * s).collect(),
    };
    Prior {
        n_slots: 3,
        variances: sizes.map(|size| size * size).to_vec(),
        log_empty: -(1.4_f64.ln()),
        log_filled: log_filled.collect(),
        families: vec![
            family(0, 3 * n_patches, 0.3025, 0.0165, 1.0),
            family(3 * n_patches, n_columns, 1.0, 0.1, 2.0),
        ],
        wrong: Wrong {
            rows: (0..n_markers).map(|m| (3 * m..3 * m + 3).collect()).collect(),
            variance: 36.0,
            log_odds: 0.005_f64.ln(),
        },
    }
}

/// A place on a ball of 60 mm: the spiral of Fibonacci.
fn on_ball(k: usize, n: usize) -> [f64; 3] {
    let z = 1.0 - 2.0 * (k as f64 + 0.5) / n as f64;
    let (across, angle) = ((1.0 - z * z).sqrt(), 2.399_963_229_728_653 * k as f64);
    [60.0 * across * angle.cos(), 60.0 * across * angle.sin(), 60.0 * z]
}

fn places(counts: &[usize]) -> (Vec<[f64; 3]>, Vec<usize>) {
    let all = counts.iter().enumerate();
    let all = all.flat_map(|(level, &n)| (0..n).map(move |k| (on_ball(k, n), level)));
    all.unzip()
}

fn distance(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt()
}

fn lying(centres: &[[f64; 3]], levels: &[usize], radii: &[f64]) -> Vec<Patch> {
    let one = |p: usize| {
        let mut patch = Patch::default();
        for q in (0..centres.len()).filter(|&q| q != p) {
            let (gap, larger) =
                (distance(&centres[p], &centres[q]), radii[levels[p].max(levels[q])]);
            let reach = if levels[p] == levels[q] { 1.05 } else { 0.49 };
            if levels[p].abs_diff(levels[q]) <= 1 && gap < reach * larger {
                patch.neighbours.push(q);
            }
            if levels[q] + 1 == levels[p] && gap < radii[levels[p]] {
                patch.texture.push((q, 0.5 * radii[levels[q]] / radii[levels[p]]));
            }
        }
        patch
    };
    (0..centres.len()).map(one).collect()
}
