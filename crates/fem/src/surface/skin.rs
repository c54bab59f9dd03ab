//! A thin skin: a membrane of neo-Hookean material in plane stress.
//!
//! With the in-plane deformation gradient `F (3, 2)` on the undeformed facet, `C = FᵀF (2, 2)`,
//! `J₂ = √det C` and the stretch `λ₃` across the skin that leaves no stress there,
//!
//! ```text
//! ψ = μ/2 (tr C + λ₃² − 3) − μ ln J + λ/2 ln²J,   J = J₂ λ₃,   μ (λ₃² − 1) + λ ln J = 0
//! P = μ (F − G) + λ ln J G,                       G = F C⁻¹
//! ∂P = μ ∂F + (λ ln J − μ) ∂G + λ κ G (G : ∂F),   κ = 2 μ λ₃² / (2 μ λ₃² + λ)
//! ∂G = (I − G Fᵀ) ∂F C⁻¹ − G ∂Fᵀ G
//! ```

use nalgebra::{SMatrix, SymmetricEigen};

use super::facet::{Facet, minus};
use crate::assembly::TangentKind;
use crate::body::Body;
use crate::element::cross;
use crate::error::FemError;
use crate::history::must;
use crate::material::{NeoHookean, x_minus_log};

/// A thin skin on facets of the surface, undeformed in the reference shape.
///
/// Energy `thickness · ∫ ψ dA` over the undeformed facets, with `ψ` the neo-Hookean law of
/// [`NeoHookean`] in plane stress; no stiffness in bending.
///
/// # Reference
///
/// Bonet, Wood, Mahaney and Heywood, Comput. Methods Appl. Mech. Eng. 190, 579 (2000).
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Skin {
    /// Facets by their corner nodes, in any order.
    pub triangles: Vec<[usize; 3]>,
    /// Undeformed thickness, mm; positive.
    pub thickness: f64,
    /// Young's modulus, kPa; positive.
    pub young: f64,
    /// Poisson's ratio, dimensionless, in [0, 0.5).
    pub poisson: f64,
}

impl Skin {
    /// Check ranges.
    ///
    /// # Errors
    ///
    /// [`FemError::BadParameter`].
    pub(crate) fn check(&self) -> Result<(), FemError> {
        let positive = |v: f64| v > 0.0 && v.is_finite();
        must("skin.thickness", "positive and finite", self.thickness, positive(self.thickness))?;
        must("skin.young", "positive and finite", self.young, positive(self.young))?;
        let fits = (0.0..0.5).contains(&self.poisson);
        must("skin.poisson", "at least 0 and below 0.5", self.poisson, fits)
    }
}

/// Three rows of two.
type Plane = [[f64; 2]; 3];

/// One facet of skin.
#[derive(Debug, Clone)]
pub(super) struct SkinFacet {
    pub(super) facet: Facet,
    law: NeoHookean,
    /// Two unit vectors in the undeformed facet, as columns.
    axes: Plane,
    /// Gradients of the shape functions along these axes, at each point, 1/mm.
    gradients: Vec<Vec<[f64; 2]>>,
    /// Volume of skin that belongs to a point, mm³.
    weight: f64,
}

impl SkinFacet {
    pub(super) fn new(body: &Body, facet: Facet, skin: &Skin) -> Self {
        let [a, b, c] = [0, 1, 2].map(|k| body.nodes()[facet.nodes[k]]);
        let (along, other) = (minus(b, a), minus(c, a));
        let length = along.iter().map(|v| v * v).sum::<f64>().sqrt();
        let first = along.map(|v| v / length);
        let second = cross(facet.normal, first);
        let dot = |x: [f64; 3], y: [f64; 3]| x.iter().zip(y).map(|(p, q)| p * q).sum::<f64>();
        let (p, q) = (dot(other, first), dot(other, second));
        // Barycentric coordinates of the corners, by the axes: their sum is constant.
        let slope = [
            [-1.0 / length, (p / length - 1.0) / q],
            [1.0 / length, -p / (length * q)],
            [0.0, 1.0 / q],
        ];
        let gradients = match facet.nodes.len() {
            3 => vec![slope.to_vec()],
            _ => [[4.0, 1.0, 1.0], [1.0, 4.0, 1.0], [1.0, 1.0, 4.0]]
                .map(|l| quadratic_gradients(l.map(|v| v / 6.0), slope))
                .to_vec(),
        };
        let weight = skin.thickness * facet.area / gradients.len() as f64;
        let law = NeoHookean::from_young(skin.young, skin.poisson);
        let axes = std::array::from_fn(|i| [first[i], second[i]]);
        Self { facet, law, axes, gradients, weight }
    }

    fn gradient(&self, displacement: &[f64], gradients: &[[f64; 2]]) -> Plane {
        let mut h = [[0.0; 2]; 3];
        for (&node, g) in self.facet.nodes.iter().zip(gradients) {
            for i in 0..3 {
                for k in 0..2 {
                    h[i][k] += displacement[3 * node + i] * g[k];
                }
            }
        }
        h
    }

    /// Add the forces of a displacement and return its energy, µJ.
    pub(super) fn add_force(&self, displacement: &[f64], force: &mut [f64]) -> Option<f64> {
        let mut energy = 0.0;
        for gradients in &self.gradients {
            let h = self.gradient(displacement, gradients);
            let state = Membrane::new(&self.law, &self.axes, &h)?;
            energy += self.weight * state.energy(&self.law);
            let stress = state.stress(&self.law);
            for (&node, g) in self.facet.nodes.iter().zip(gradients) {
                for i in 0..3 {
                    force[3 * node + i] +=
                        self.weight * (stress[i][0] * g[0] + stress[i][1] * g[1]);
                }
            }
        }
        Some(energy)
    }

    /// Tangent between all pairs of its nodes, mN/mm.
    pub(super) fn matrix(
        &self,
        displacement: Option<&[f64]>,
        kind: TangentKind,
    ) -> Option<Vec<Vec<[[f64; 3]; 3]>>> {
        let n = self.facet.nodes.len();
        let mut matrix = vec![vec![[[0.0; 3]; 3]; n]; n];
        for gradients in &self.gradients {
            let h = displacement.map_or([[0.0; 2]; 3], |u| self.gradient(u, gradients));
            let mut tangent = Membrane::new(&self.law, &self.axes, &h)?.tangent(&self.law);
            if kind == TangentKind::Clamped {
                tangent = clamped(tangent);
            }
            for (a, ga) in gradients.iter().enumerate() {
                for (b, gb) in gradients.iter().enumerate() {
                    for (row, column) in (0..36).map(|k| (k / 6, k % 6)) {
                        matrix[a][b][row / 2][column / 2] +=
                            self.weight * ga[row % 2] * tangent[(row, column)] * gb[column % 2];
                    }
                }
            }
        }
        Some(matrix)
    }
}

/// Gradients of the six shape functions at barycentric coordinates `l`.
fn quadratic_gradients(l: [f64; 3], slope: [[f64; 2]; 3]) -> Vec<[f64; 2]> {
    let corner = |a: usize| slope[a].map(|s| (4.0 * l[a] - 1.0) * s);
    let middle = |[a, b]: [usize; 2]| {
        std::array::from_fn(|k| 4.0 * (l[a] * slope[b][k] + l[b] * slope[a][k]))
    };
    vec![corner(0), corner(1), corner(2), middle([0, 1]), middle([1, 2]), middle([2, 0])]
}

/// A membrane point: what energy, stress and tangent share.
struct Membrane {
    /// `F`
    f: Plane,
    /// `G = F C⁻¹`
    g: Plane,
    inverse_c: [[f64; 2]; 2],
    /// `C − I`
    change: [[f64; 2]; 2],
    /// `ln J`
    log: f64,
    /// `ln λ₃`
    across: f64,
}

impl Membrane {
    /// None where the facet has lost its area.
    fn new(law: &NeoHookean, axes: &Plane, h: &Plane) -> Option<Self> {
        let mut change = [[0.0; 2]; 2];
        for a in 0..2 {
            for b in 0..2 {
                change[a][b] = (0..3)
                    .map(|i| h[i][a] * axes[i][b] + axes[i][a] * h[i][b] + h[i][a] * h[i][b])
                    .sum();
            }
        }
        let det = 1.0 + trace(&change) + determinant(&change);
        if !(det > 0.0 && det < f64::INFINITY) {
            return None;
        }
        let inverse_c = [
            [(1.0 + change[1][1]) / det, -change[0][1] / det],
            [-change[1][0] / det, (1.0 + change[0][0]) / det],
        ];
        let f: Plane = std::array::from_fn(|i| [axes[i][0] + h[i][0], axes[i][1] + h[i][1]]);
        let g = times(&f, &inverse_c);
        let log2 = 0.5 * (trace(&change) + determinant(&change)).ln_1p();
        let across = across(law, log2);
        Some(Self { f, g, inverse_c, change, log: log2 + across, across })
    }

    /// Energy density, kPa, as `μ/2 [(y − ln(1 + y)) − det(C − I) + (e^{2x} − 1 − 2x)] + λ/2 ln²J`
    /// with `1 + y = det C` and `x = ln λ₃`, in which nothing of first order cancels.
    fn energy(&self, law: &NeoHookean) -> f64 {
        let second = determinant(&self.change);
        let y = trace(&self.change) + second;
        let z = (2.0 * self.across).exp_m1();
        // e^{2x} − 1 − 2x = z − ln(1 + z)
        let shear = x_minus_log(y, y.ln_1p()) - second + x_minus_log(z, z.ln_1p());
        0.5 * law.mu * shear + 0.5 * law.lambda * self.log * self.log
    }

    /// `P = μ G (C − I) + λ ln J G`, kPa.
    fn stress(&self, law: &NeoHookean) -> Plane {
        let own = times(&self.g, &self.change);
        std::array::from_fn(|i| {
            std::array::from_fn(|k| law.mu * own[i][k] + law.lambda * self.log * self.g[i][k])
        })
    }

    /// `∂P/∂F` as `[2 i + a, 2 k + b]`, kPa.
    fn tangent(&self, law: &NeoHookean) -> SMatrix<f64, 6, 6> {
        let (f, g) = (&self.f, &self.g);
        let square = (2.0 * self.across).exp() * 2.0 * law.mu;
        let volumetric = law.lambda * square / (square + law.lambda);
        let twist = law.lambda * self.log - law.mu;
        SMatrix::from_fn(|row, column| {
            let (i, a, k, b) = (row / 2, row % 2, column / 2, column % 2);
            let same = if i == k { 1.0 } else { 0.0 };
            let projected = same - (0..2).map(|c| g[i][c] * f[k][c]).sum::<f64>();
            let turned = projected * self.inverse_c[b][a] - g[i][b] * g[k][a];
            let own = if a == b { law.mu * same } else { 0.0 };
            own + twist * turned + volumetric * g[i][a] * g[k][b]
        })
    }
}

/// `ln λ₃` of a skin without stress across: the root of `μ (e^{2x} − 1) + λ (ln J₂ + x)`, which is
/// increasing and convex, so that Newton's iteration comes down to it from the second guess on.
fn across(law: &NeoHookean, log2: f64) -> f64 {
    let mut x = -law.lambda * log2 / (2.0 * law.mu + law.lambda);
    for _ in 0..60 {
        let value = law.mu * (2.0 * x).exp_m1() + law.lambda * (log2 + x);
        let step = value / (2.0 * law.mu * (2.0 * x).exp() + law.lambda);
        x -= step;
        if step.abs() <= 1e-16 * (1.0 + x.abs()) {
            break;
        }
    }
    x
}

fn clamped(tangent: SMatrix<f64, 6, 6>) -> SMatrix<f64, 6, 6> {
    let mut eigen = SymmetricEigen::new(tangent);
    eigen.eigenvalues.apply(|v| *v = v.max(0.0));
    eigen.recompose()
}

fn times(a: &Plane, b: &[[f64; 2]; 2]) -> Plane {
    std::array::from_fn(|i| std::array::from_fn(|k| a[i][0] * b[0][k] + a[i][1] * b[1][k]))
}

fn trace(m: &[[f64; 2]; 2]) -> f64 {
    m[0][0] + m[1][1]
}

fn determinant(m: &[[f64; 2]; 2]) -> f64 {
    m[0][0] * m[1][1] - m[0][1] * m[1][0]
}
