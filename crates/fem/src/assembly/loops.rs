//! What all loops over elements read and answer.

use nalgebra::{SMatrix, SymmetricEigen};

use crate::element::{Geometry, PACK};
use crate::material::{Hyperelastic, Material, Matrix3, PlainLaws, Response, Tangent};

/// Elements whose energies are summed together.
pub(super) const CHUNK: usize = 256;

/// Bodies with fewer elements than this are not worth a second thread.
pub(super) const PARALLEL_FROM: usize = 2_000;

/// What a body answers at its quadrature points. The loops below know nothing else of what it is
/// made of or has been through.
pub(crate) trait PointModel: Sync {
    /// Energy, stress and volume ratio; none where the point is inverted.
    fn response(&self, element: usize, point: usize, h: &Matrix3) -> Option<Response>;

    /// `∂P/∂h`; none where the point is inverted.
    fn tangent(&self, element: usize, point: usize, h: &Matrix3) -> Option<Tangent>;

    /// The laws of a plain neo-Hookean body, for which the loops have faster forms.
    fn neo_hookean(&self) -> Option<PlainLaws<'_>> {
        None
    }

    /// The same of a body whose points remember stresses and nothing else.
    fn remembering(&self) -> Option<(PlainLaws<'_>, &Remembered)> {
        None
    }
}

/// What one-point elements add to a law that is split into parts, `Ψ = a_vol (ψ − ψ_iso) + a_iso ψ_iso +
/// ½ S : (C − I)`.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Remembered {
    /// `a_vol`
    pub(crate) volumetric: f64,
    /// `a_iso`; that of the volumetric part where the parts are not separated.
    pub(crate) isochoric: f64,
    /// `S` of eight elements at a time: components 00, 11, 22, 01, 02, 12, kPa. Empty where nothing is
    /// remembered.
    pub(crate) stress: Vec<[[f64; PACK]; 6]>,
}

impl PointModel for Material {
    #[inline(always)]
    fn response(&self, element: usize, point: usize, h: &Matrix3) -> Option<Response> {
        self.law_at(element, point).response(h)
    }

    #[inline(always)]
    fn tangent(&self, element: usize, point: usize, h: &Matrix3) -> Option<Tangent> {
        self.law_at(element, point).tangent(h)
    }

    fn neo_hookean(&self) -> Option<PlainLaws<'_>> {
        self.plain_neo_hookean()
    }
}

/// What every loop over elements reads.
pub(super) struct Loops<'a, M: PointModel> {
    pub(super) geometry: &'a Geometry,
    pub(super) model: &'a M,
    pub(super) displacement: &'a [f64],
}

#[inline(always)]
pub(super) fn local<const N: usize>(
    geometry: &Geometry,
    element: usize,
    values: &[f64],
) -> [[f64; 3]; N] {
    let nodes = &geometry.connectivity[element * N..(element + 1) * N];
    let mut rows = [[0.0; 3]; N];
    for a in 0..N {
        let flat = 3 * nodes[a] as usize;
        rows[a].copy_from_slice(&values[flat..flat + 3]);
    }
    rows
}

#[inline(always)]
pub(super) fn displacement_gradient<const N: usize>(
    u: &[[f64; 3]; N],
    gradients: &[[f64; 3]; N],
    inverse_jacobian: &[[f64; 3]; 3],
) -> Matrix3 {
    let mut local = [[0.0; 3]; 3];
    for a in 0..N {
        for i in 0..3 {
            for k in 0..3 {
                local[i][k] += u[a][i] * gradients[a][k];
            }
        }
    }
    let mut h = [[0.0; 3]; 3];
    for i in 0..3 {
        for j in 0..3 {
            for k in 0..3 {
                h[i][j] += local[i][k] * inverse_jacobian[k][j];
            }
        }
    }
    h
}

/// `∂N/∂X` from `∂N/∂ξ`.
pub(super) fn spatial_gradients<const N: usize>(
    gradients: &[[f64; 3]; N],
    inverse_jacobian: &[[f64; 3]; 3],
) -> [[f64; 3]; N] {
    let mut spatial = [[0.0; 3]; N];
    for a in 0..N {
        for j in 0..3 {
            for k in 0..3 {
                spatial[a][j] += gradients[a][k] * inverse_jacobian[k][j];
            }
        }
    }
    spatial
}

/// Energy and smallest volume ratio of a state.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Energy {
    /// Strain energy, µJ.
    pub(crate) total: f64,
    /// Smallest det F of all quadrature points.
    pub(crate) min_det_f: f64,
}

impl Energy {
    pub(super) const NOTHING: Self = Self { total: 0.0, min_det_f: f64::INFINITY };

    pub(super) fn and(self, other: Self) -> Self {
        Self { total: self.total + other.total, min_det_f: self.min_det_f.min(other.min_det_f) }
    }
}

/// Which tangent an assembly forms.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum TangentKind {
    /// The derivative of the forces.
    Exact,
    /// With the negative eigenvalues of `∂P/∂h` removed at every point: never indefinite.
    Clamped,
}

/// Remove the negative eigenvalues of a symmetric tangent.
pub(super) fn clamp(tangent: &mut Tangent) {
    let matrix = SMatrix::<f64, 9, 9>::from_fn(|i, j| tangent[i][j]);
    // Most points need no change, and a Cholesky factor shows this in a tenth of the time.
    let rounding = 1e-13 * matrix.trace().abs();
    if (matrix + SMatrix::<f64, 9, 9>::identity() * rounding).cholesky().is_some() {
        return;
    }
    let mut eigen = SymmetricEigen::new(matrix);
    if eigen.eigenvalues.iter().all(|&v| v >= 0.0) {
        return;
    }
    eigen.eigenvalues.apply(|v| *v = v.max(0.0));
    let clamped = eigen.recompose();
    for i in 0..9 {
        for j in 0..9 {
            tangent[i][j] = clamped[(i, j)];
        }
    }
}
