//! The global step: one matrix for all three axes, factored once for a length of time step.
//!
//! `A = M + Δt² DᵀW²D` couples no axis with another, so that one scalar matrix on the free nodes serves
//! three right-hand sides. Its second part has the entries `Δt² Σ_e w_e² ∇N_a·∇N_b`, with `w_e² = κ_e V_e`.

use tissuereg_fem::{FemError, ScalarFactor, ScalarScratch};

use super::tets::Tets;

/// The matrix element by element.
pub(super) struct Matrix<'a> {
    pub(super) tets: &'a Tets,
    /// Density, kg/mm³.
    pub(super) density: f64,
    /// `κ` of each tetrahedron, kPa.
    pub(super) kappa: &'a [f64],
    /// Length of the time step, s.
    pub(super) dt: f64,
}

impl Matrix<'_> {
    /// Entries of the pairs of a tetrahedron's nodes.
    pub(super) fn entries(&self, tet: usize) -> [f64; 10] {
        let gradients = self.tets.shape_gradients(tet);
        let volume = self.tets.volume[tet];
        let weight = self.dt * self.dt * self.kappa[tet] * volume;
        let (mut entries, mut pair) = ([0.0; 10], 0);
        for a in 0..4 {
            for b in 0..=a {
                let product: f64 = (0..3).map(|j| gradients[a][j] * gradients[b][j]).sum();
                let mass = if a == b { 0.25 * self.density * volume } else { 0.0 };
                entries[pair] = weight * product + mass;
                pair += 1;
            }
        }
        entries
    }
}

/// Write `A⁻¹ rhs` of the three axes, in elimination order.
///
/// # Errors
///
/// [`FemError::WrongLength`].
pub(super) fn solve_into(
    factor: &ScalarFactor,
    rhs: &[Vec<f64>; 3],
    out: &mut [Vec<f64>; 3],
    scratch: &mut [ScalarScratch; 3],
    parallel: bool,
) -> Result<(), FemError> {
    let [x, y, z] = rhs;
    let [out_x, out_y, out_z] = out;
    let [own_x, own_y, own_z] = scratch;
    let solve = |rhs: &[f64], out: &mut [f64], own: &mut ScalarScratch| {
        factor.solve_into(rhs, out, own, parallel)
    };
    if !parallel {
        solve(x, out_x, own_x)?;
        solve(y, out_y, own_y)?;
        return solve(z, out_z, own_z);
    }
    let (first, (second, third)) = rayon::join(
        || solve(x, out_x, own_x),
        || rayon::join(|| solve(y, out_y, own_y), || solve(z, out_z, own_z)),
    );
    first.and(second).and(third)
}
