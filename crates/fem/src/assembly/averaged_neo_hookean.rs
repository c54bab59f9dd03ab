//! Averaged elements of a plain neo-Hookean law in closed form: a fifth of the time of any law.
//!
//! With `s² = (J̄_a / J_e)^⅔` and `θ̄_a = ln J̄_a`, the energy density at corner `a` of element `e` is
//!
//! ```text
//! w(F, θ̄) = μ/2 (s² I₁ − 3) − μ θ̄ + λ/2 θ̄²
//! ∂w/∂F   = μ s² (F − ⅓ I₁ G)                ∂w/∂θ̄ = p = μ (⅓ s² I₁ − 1) + λ θ̄
//! ∂²w/∂F² = μ s² (1 − ⅔ (F⊗G + G⊗F) + ²⁄₉ I₁ G⊗G + ⅓ I₁ Gᵗ),     Gᵗ : dF = G dFᵀ G
//! ∂²w/∂F∂θ̄ = ⅔ μ s² (F − ⅓ I₁ G)             ∂²w/∂θ̄² = ²⁄₉ μ s² I₁ + λ
//! ```
//!
//! and `d²θ̄_a = Σ_e V_e J_e / (V_a J̄_a) (G⊗G − Gᵗ) − dθ̄_a ⊗ dθ̄_a`. Clamped, the law's own tangent
//! `μ 1 + c Gᵗ + λ G⊗G` at `F_ea`, with `c = μ − λ θ̄` brought to where that is never indefinite,
//! acts on the first derivative of `F_ea`:
//!
//! ```text
//! ∂²/∂F²  = μ s² (1 − ⅓ (F⊗G + G⊗F) + ⅑ I₁ G⊗G) + c (Gᵗ − ⅓ G⊗G)
//! ∂²/∂F∂θ̄ = ⅓ μ s² (F − ⅓ I₁ G)              ∂²/∂θ̄² = ⅑ μ s² I₁ + ⅓ c + λ
//! ```

use super::averages::{Averages, Deformed, Part, around};
use super::loops::{Energy, Loops, PointModel, TangentKind, spatial_gradients};
use crate::element::{Patches, TET4};
use crate::material::{Hyperelastic, Matrix3, NeoHookean, PlainLaws, x_minus_log};

/// An element without its law: `F − G`, `⅓ I₁ − 1` and the isochoric energy over `μ`, all formed
/// from `h`.
struct Shape {
    difference: Matrix3,
    strain: f64,
    energy: f64,
}

impl Shape {
    fn new(h: &Matrix3) -> Option<Self> {
        let unit = NeoHookean { mu: 1.0, lambda: 0.0 }.response(h)?;
        let square: f64 = h.as_flattened().iter().map(|v| v * v).sum();
        let strain = (2.0 * (h[0][0] + h[1][1] + h[2][2]) + square) / 3.0;
        Some(Self { difference: unit.stress, strain, energy: unit.energy })
    }

    /// `F − ⅓ I₁ G`
    fn deviator(&self, inverse: &Matrix3) -> Matrix3 {
        std::array::from_fn(|i| {
            std::array::from_fn(|j| self.difference[i][j] - self.strain * inverse[i][j])
        })
    }

    /// `p` where `s² − 1 = growth`.
    fn pressure(&self, law: &NeoHookean, growth: f64, log: f64) -> f64 {
        law.mu * (growth + (1.0 + growth) * self.strain) + law.lambda * log
    }
}

/// `ln s²`
fn log_growth(deformed: &Deformed, log: f64) -> f64 {
    2.0 / 3.0 * (log - deformed.log)
}

/// Energy, stress and pressures of one element, as the loop for any law has them.
pub(super) fn part(
    laws: PlainLaws,
    averages: &Averages,
    element: usize,
    volume: f64,
    nodes: &[u32],
) -> Option<Part> {
    let deformed = &averages.elements[element];
    let shape = Shape::new(&deformed.h)?;
    let (mut energy, mut shear, mut pressure) = (0.0, 0.0, [0.0; 4]);
    for (a, &node) in nodes.iter().enumerate() {
        let law = laws.at(element, a);
        let log = averages.logs[node as usize];
        let twice = log_growth(deformed, log);
        let growth = twice.exp_m1();
        let isochoric = shape.energy + 1.5 * (x_minus_log(growth, twice) + shape.strain * growth);
        energy += law.mu * isochoric + 0.5 * law.lambda * log * log;
        shear += 0.25 * law.mu * (1.0 + growth);
        pressure[a] = 0.25 * volume * shape.pressure(&law, growth, log);
    }
    Some(Part {
        energy: Energy { total: 0.25 * volume * energy, min_det_f: deformed.det_f() },
        stress: shape.deviator(&deformed.inverse).map(|row| row.map(|v| shear * v)),
        pressure,
    })
}

/// `Σ_e ¼ V_e p` at every node; none where an element is inverted.
pub(super) fn nodal_pressures<M: PointModel>(
    loops: &Loops<'_, M>,
    laws: PlainLaws,
    averages: &Averages,
) -> Option<Vec<f64>> {
    let geometry = loops.geometry;
    let mut sums = vec![0.0; averages.nodes.len()];
    for element in 0..geometry.n_elements() {
        let nodes = geometry.nodes_of(element);
        let part = part(laws, averages, element, geometry.volume[element], nodes)?;
        for (&node, p) in nodes.iter().zip(part.pressure) {
            sums[node as usize] += p;
        }
    }
    Some(sums)
}

/// Coefficients of one corner, weighted with a quarter of the element's volume.
struct Corner {
    /// Of the mixed derivative, over `F − ⅓ I₁ G`.
    mixed: f64,
    /// By `θ̄` twice.
    nodal: f64,
    /// `μ s²`
    shear: f64,
    /// `c`
    twist: f64,
}

fn corner(
    law: &NeoHookean,
    deformed: &Deformed,
    trace: f64,
    log: f64,
    weight: f64,
    kind: TangentKind,
) -> Corner {
    let square = log_growth(deformed, log).exp();
    let shear = weight * law.mu * square;
    if kind == TangentKind::Exact {
        let nodal = 2.0 / 9.0 * shear * trace + weight * law.lambda;
        return Corner { mixed: 2.0 / 3.0 * shear, nodal, shear, twist: 0.0 };
    }
    let limit = law.mu * square / largest_stretch_bound(&deformed.inverse);
    let twist = weight * (law.mu - law.lambda * log).clamp(-limit, limit);
    let nodal = shear * trace / 9.0 + twist / 3.0 + weight * law.lambda;
    Corner { mixed: shear / 3.0, nodal, shear, twist }
}

/// Not less than the square of the largest singular value: `‖G‖₁ ‖G‖_∞`.
pub(super) fn largest_stretch_bound(g: &Matrix3) -> f64 {
    let row = |i: usize| g[i].iter().map(|v| v.abs()).sum::<f64>();
    let column = |j: usize| g.iter().map(|r| r[j].abs()).sum::<f64>();
    let most = |of: &dyn Fn(usize) -> f64| (0..3).map(of).fold(0.0, f64::max);
    most(&row) * most(&column)
}

/// What the patches of a plain neo-Hookean body read.
pub(super) struct PlainPatches<'a> {
    pub(super) laws: PlainLaws<'a>,
    /// `Σ_e ¼ V_e p` at every node.
    pub(super) pressures: Vec<f64>,
}

impl<M: PointModel> Loops<'_, M> {
    /// Blocks of the patch around a node, as [`Loops::patch_tangent`] for a plain neo-Hookean law.
    ///
    /// What couples the nodes of one element alone is added once, in the patch of its first node.
    pub(super) fn plain_patch_tangent(
        &self,
        patches: &Patches,
        averages: &Averages,
        plain: &PlainPatches,
        centre: usize,
        kind: TangentKind,
        blocks: &mut [[f64; 9]],
    ) -> bool {
        blocks.fill([0.0; 9]);
        let geometry = self.geometry;
        let patch_volume = averages.grown_volume(patches, centre);
        let width = patches.nodes_of(centre).len();
        let (mut growth, mut mixed) = (vec![[0.0; 3]; width], vec![[0.0; 3]; width]);
        let mut nodal = match kind {
            TangentKind::Exact => -plain.pressures[centre],
            TangentKind::Clamped => 0.0,
        };
        for (element, a) in around(geometry, centre) {
            let deformed = &averages.elements[element];
            let Some(shape) = Shape::new(&deformed.h) else { return false };
            let nodes = geometry.nodes_of(element);
            let jacobian = &geometry.inverse_jacobian[element];
            let gradients = spatial_gradients(&TET4.gradients[0], jacobian);
            let weight = 0.25 * geometry.volume[element];
            let trace = 3.0 + 3.0 * shape.strain;
            let of_corner = |a: usize| {
                let log = averages.logs[nodes[a] as usize];
                corner(&plain.laws.at(element, a), deformed, trace, log, weight, kind)
            };
            let own = of_corner(a);
            nodal += own.nodal;
            let share = geometry.volume[element] * deformed.det_f() / patch_volume;
            let deviator = shape.deviator(&deformed.inverse);
            let places: [usize; 4] = std::array::from_fn(|b| patches.place(centre, nodes[b]));
            for (gradient, &place) in gradients.iter().zip(&places) {
                for i in 0..3 {
                    for j in 0..3 {
                        growth[place][i] += share * deformed.inverse[i][j] * gradient[j];
                        mixed[place][i] += own.mixed * deviator[i][j] * gradient[j];
                    }
                }
            }
            if a > 0 {
                continue;
            }
            let (mut shear, mut twist) = (0.0, 0.0);
            for corner in (0..4).map(of_corner) {
                shear += corner.shear;
                twist += corner.twist;
            }
            let form = match kind {
                TangentKind::Exact => {
                    let pressure: f64 =
                        nodes.iter().map(|&n| plain.nodal_stress(patches, averages, n)).sum();
                    let pressure = geometry.volume[element] * deformed.det_f() * pressure;
                    ElementForm {
                        shear,
                        across: -2.0 / 3.0 * shear,
                        along: 2.0 / 9.0 * shear * trace + pressure,
                        twist: shear * trace / 3.0 - pressure,
                    }
                }
                TangentKind::Clamped => ElementForm {
                    shear,
                    across: -shear / 3.0,
                    along: shear * trace / 9.0 - twist / 3.0,
                    twist,
                },
            };
            form.add(deformed, &gradients, &places, blocks);
        }
        let mut pair = 0;
        for a in 0..width {
            for b in 0..=a {
                let block = &mut blocks[pair];
                pair += 1;
                for i in 0..3 {
                    let (own, other) = (growth[a][i], mixed[a][i] + nodal * growth[a][i]);
                    for k in 0..3 {
                        block[3 * i + k] += other * growth[b][k] + own * mixed[b][k];
                    }
                }
            }
        }
        true
    }
}

impl PlainPatches<'_> {
    /// `Q_a = Σ_e ¼ V_e p / (V_a J̄_a)`
    fn nodal_stress(&self, patches: &Patches, averages: &Averages, node: u32) -> f64 {
        let node = node as usize;
        self.pressures[node] / averages.grown_volume(patches, node)
    }
}

/// `shear 1 + across (F⊗G + G⊗F) + along G⊗G + twist Gᵗ`
struct ElementForm {
    shear: f64,
    across: f64,
    along: f64,
    twist: f64,
}

impl ElementForm {
    fn add(
        &self,
        deformed: &Deformed,
        gradients: &[[f64; 3]; 4],
        places: &[usize; 4],
        blocks: &mut [[f64; 9]],
    ) {
        let pushed = |m: &Matrix3, shift: f64| -> [[f64; 3]; 4] {
            std::array::from_fn(|a| {
                std::array::from_fn(|i| {
                    (0..3).map(|j| m[i][j] * gradients[a][j]).sum::<f64>() + shift * gradients[a][i]
                })
            })
        };
        let (f, g) = (pushed(&deformed.h, 1.0), pushed(&deformed.inverse, 0.0));
        for a in 0..4 {
            for b in 0..4 {
                if places[b] > places[a] {
                    continue;
                }
                let block = &mut blocks[places[a] * (places[a] + 1) / 2 + places[b]];
                let product: f64 = (0..3).map(|j| gradients[a][j] * gradients[b][j]).sum();
                for i in 0..3 {
                    for k in 0..3 {
                        block[3 * i + k] += self.across * (f[a][i] * g[b][k] + g[a][i] * f[b][k])
                            + self.along * g[a][i] * g[b][k]
                            + self.twist * g[b][i] * g[a][k];
                    }
                    block[4 * i] += self.shear * product;
                }
            }
        }
    }
}
