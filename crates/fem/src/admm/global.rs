//! The global step: one matrix for all three axes, factored once for a length of time step.
//!
//! `A = M + Δt² DᵀW²D` couples no axis with another, so that one scalar matrix on the free nodes serves
//! three right-hand sides. Its second part has the entries `Δt² Σ_e w_e² ∇N_a·∇N_b`, with `w_e² = κ_e V_e`.

use crate::element::Geometry;
use crate::error::FemError;
use crate::system::SolveScratch;
use crate::system::factor::{Blocks, Entries, Factor, Making};
use crate::system::pattern::Pattern;

/// Where a scalar per node stands among the three axes of the crate's systems.
const AXIS: usize = 2;

/// Free nodes in elimination order.
#[derive(Debug)]
pub(super) struct Order(Pattern);

impl Order {
    /// # Errors
    ///
    /// [`FemError::TooLarge`].
    pub(super) fn new(
        points: &[[f64; 3]],
        geometry: &Geometry,
        held: &[bool],
    ) -> Result<Self, FemError> {
        let axes: Vec<[bool; 3]> = held.iter().map(|&held| [true, true, held]).collect();
        Pattern::new(points, geometry.elements(), &axes).map(Self)
    }

    pub(super) fn n_free(&self) -> usize {
        self.0.n_unknowns()
    }

    /// Node of each unknown.
    pub(super) fn nodes(&self) -> impl Iterator<Item = usize> {
        self.0.unknown2flat.iter().map(|&flat| flat as usize / 3)
    }

    /// Factor the matrix.
    ///
    /// # Errors
    ///
    /// [`FemError::SingularStiffness`], [`FemError::TooLarge`].
    pub(super) fn factor(&self, matrix: &Matrix, parallel: bool) -> Result<Factor, FemError> {
        Factor::new(&self.0.fronts, matrix, Entries::Double, Making { parallel, cancel: None })
    }

    /// Write `A⁻¹ rhs`, both by axis and in elimination order.
    pub(super) fn solve_into(
        &self,
        factor: &Factor,
        rhs: &[Vec<f64>; 3],
        out: &mut [Vec<f64>; 3],
        scratch: &mut [SolveScratch; 3],
        parallel: bool,
    ) {
        let [x, y, z] = rhs;
        let [out_x, out_y, out_z] = out;
        let [own_x, own_y, own_z] = scratch;
        let solve = |rhs: &[f64], out: &mut [f64], own: &mut SolveScratch| {
            factor.solve_into(&self.0.fronts, 1.0, rhs, out, own, parallel);
        };
        if parallel {
            rayon::join(
                || solve(x, out_x, own_x),
                || rayon::join(|| solve(y, out_y, own_y), || solve(z, out_z, own_z)),
            );
        } else {
            solve(x, out_x, own_x);
            solve(y, out_y, own_y);
            solve(z, out_z, own_z);
        }
    }
}

/// The matrix element by element.
pub(super) struct Matrix<'a> {
    pub(super) geometry: &'a Geometry,
    /// Density, kg/mm³.
    pub(super) density: f64,
    /// `κ` of each tetrahedron, kPa.
    pub(super) kappa: &'a [f64],
    /// Length of the time step, s.
    pub(super) dt: f64,
}

impl Blocks for Matrix<'_> {
    fn width(&self, _clique: usize) -> usize {
        4
    }

    fn blocks_into(&self, clique: usize, blocks: &mut [[f64; 9]]) -> bool {
        let gradients = shape_gradients(&self.geometry.inverse_jacobian[clique]);
        let volume = self.geometry.volume[clique];
        let weight = self.dt * self.dt * self.kappa[clique] * volume;
        let mut pair = 0;
        for a in 0..4 {
            for b in 0..=a {
                let product: f64 = (0..3).map(|j| gradients[a][j] * gradients[b][j]).sum();
                let mass = if a == b { 0.25 * self.density * volume } else { 0.0 };
                blocks[pair] = [0.0; 9];
                blocks[pair][4 * AXIS] = weight * product + mass;
                pair += 1;
            }
        }
        true
    }
}

/// `∇N_a` of the four nodes, 1/mm.
#[inline(always)]
pub(super) fn shape_gradients(inverse_jacobian: &[[f64; 3]; 3]) -> [[f64; 3]; 4] {
    let [b, c, d] = *inverse_jacobian;
    let first = std::array::from_fn(|j| -(b[j] + c[j] + d[j]));
    [first, b, c, d]
}
