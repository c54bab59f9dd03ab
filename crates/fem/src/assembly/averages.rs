//! Volume ratios averaged at the nodes, of a state and along a rate.

use rayon::prelude::*;

use super::loops::{Energy, PARALLEL_FROM, displacement_gradient, local};
use crate::element::{Geometry, Patches, TET4};
use crate::material::{Matrix3, Tangent, cofactor, det_f_minus_one};

/// Volume ratios of a state, by element and by node.
#[derive(Debug)]
pub(super) struct Averages {
    pub(super) elements: Vec<Deformed>,
    /// `J̄_a − 1`
    pub(super) nodes: Vec<f64>,
    /// `ln J̄_a`
    pub(super) logs: Vec<f64>,
}

impl Averages {
    /// `s − 1` and `F_ea − I` at the corner of an element that is a node.
    pub(super) fn corner(&self, element: usize, node: u32) -> (f64, Matrix3) {
        self.elements[element].averaged(self.logs[node as usize])
    }

    /// `V_a J̄_a`
    pub(super) fn grown_volume(&self, patches: &Patches, node: usize) -> f64 {
        patches.volume[node] * (1.0 + self.nodes[node])
    }

    /// What a displacement rate `(3 n_nodes)` does to elements and nodes.
    pub(super) fn rates(&self, geometry: &Geometry, patches: &Patches, rate: &[f64]) -> Rates {
        let elements: Vec<(Matrix3, f64)> = (0..geometry.n_elements())
            .map(|element| {
                let u = local::<4>(geometry, element, rate);
                let jacobian = &geometry.inverse_jacobian[element];
                let dh = displacement_gradient(&u, &TET4.gradients[0], jacobian);
                (dh, dot(&self.elements[element].inverse, &dh))
            })
            .collect();
        let grown = |element: usize, _| {
            geometry.volume[element] * self.elements[element].det_f() * elements[element].1
        };
        let nodes = (0..patches.volume.len())
            .map(|node| sum_around(geometry, node, grown) / self.grown_volume(patches, node))
            .collect();
        Rates { elements, nodes }
    }
}

/// How volume ratios change along a displacement rate.
pub(super) struct Rates {
    /// `dh` and `θ = dJ/J`.
    pub(super) elements: Vec<(Matrix3, f64)>,
    /// `θ̄ = dJ̄/J̄`
    pub(super) nodes: Vec<f64>,
}

/// How one element is deformed.
#[derive(Debug, Clone, Copy)]
pub(super) struct Deformed {
    /// Displacement gradient.
    pub(super) h: Matrix3,
    /// `G = F⁻ᵀ`
    pub(super) inverse: Matrix3,
    /// `J − 1`
    x: f64,
    /// `ln J`
    pub(super) log: f64,
}

impl Deformed {
    /// None unless `0 < J < ∞`.
    fn new(h: Matrix3) -> Option<Self> {
        let x = det_f_minus_one(&h);
        let det_f = 1.0 + x;
        if !(det_f > 0.0 && det_f < f64::INFINITY) {
            return None;
        }
        let inverse = cofactor(&deformation(&h)).map(|row| row.map(|v| v / det_f));
        Some(Self { h, inverse, x, log: x.ln_1p() })
    }

    pub(super) fn det_f(&self) -> f64 {
        1.0 + self.x
    }

    /// `s − 1` and `F_ea − I` for a corner where `ln J̄ = log`.
    fn averaged(&self, log: f64) -> (f64, Matrix3) {
        let growth = ((log - self.log) / 3.0).exp_m1();
        let mut h = self.h;
        for i in 0..3 {
            for j in 0..3 {
                h[i][j] += growth * (self.h[i][j] + f64::from(u8::from(i == j)));
            }
        }
        (growth, h)
    }
}

/// `I + h`
pub(super) fn deformation(h: &Matrix3) -> Matrix3 {
    let mut f = *h;
    for i in 0..3 {
        f[i][i] += 1.0;
    }
    f
}

/// `a : b`
pub(super) fn dot(a: &Matrix3, b: &Matrix3) -> f64 {
    a.as_flattened().iter().zip(b.as_flattened()).map(|(x, y)| x * y).sum()
}

/// `tangent : direction`
pub(super) fn times(tangent: &Tangent, direction: &Matrix3) -> Matrix3 {
    std::array::from_fn(|i| {
        std::array::from_fn(|j| {
            tangent[3 * i + j].iter().zip(direction.as_flattened()).map(|(t, d)| t * d).sum()
        })
    })
}

pub(super) fn add_scaled(sum: &mut Matrix3, factor: f64, m: &Matrix3) {
    for i in 0..3 {
        for j in 0..3 {
            sum[i][j] += factor * m[i][j];
        }
    }
}

/// `value(0)` to `value(n − 1)`, none where one is none.
pub(super) fn all<T: Send>(
    n: usize,
    parallel: bool,
    value: impl Fn(usize) -> Option<T> + Send + Sync,
) -> Option<Vec<T>> {
    if parallel && n >= PARALLEL_FROM {
        (0..n).into_par_iter().with_min_len(256).map(value).collect()
    } else {
        (0..n).map(value).collect()
    }
}

/// Averaged displacement gradients at the corners of all elements; not a number where one is
/// inverted.
pub(super) fn gradients(geometry: &Geometry, displacement: &[f64]) -> Vec<Matrix3> {
    let averages =
        geometry.patches.as_ref().and_then(|p| averages(geometry, p, displacement, true));
    let Some(averages) = averages else {
        return vec![[[f64::NAN; 3]; 3]; 4 * geometry.n_elements()];
    };
    geometry
        .connectivity
        .chunks_exact(4)
        .enumerate()
        .flat_map(|(element, nodes)| nodes.iter().map(move |&node| (element, node)))
        .map(|(element, node)| averages.corner(element, node).1)
        .collect()
}

pub(super) fn averages(
    geometry: &Geometry,
    patches: &Patches,
    displacement: &[f64],
    parallel: bool,
) -> Option<Averages> {
    let elements = all(geometry.n_elements(), parallel, |element| {
        let u = local::<4>(geometry, element, displacement);
        let jacobian = &geometry.inverse_jacobian[element];
        Deformed::new(displacement_gradient(&u, &TET4.gradients[0], jacobian))
    })?;
    let nodes = all(patches.volume.len(), parallel, |node| {
        let part = |element: usize, _| geometry.volume[element] * elements[element].x;
        Some(sum_around(geometry, node, part) / patches.volume[node].max(f64::MIN_POSITIVE))
    })?;
    let logs = nodes.iter().map(|x: &f64| x.ln_1p()).collect();
    Some(Averages { elements, nodes, logs })
}

/// Sum over the elements around a node, of which it is corner `a`.
pub(super) fn sum_around(
    geometry: &Geometry,
    node: usize,
    part: impl Fn(usize, usize) -> f64,
) -> f64 {
    around(geometry, node).map(|(element, a)| part(element, a)).sum()
}

/// Elements around a node, and which of their corners it is.
pub(super) fn around(
    geometry: &Geometry,
    node: usize,
) -> impl Iterator<Item = (usize, usize)> + Clone + '_ {
    let (starts, places) = &geometry.node2place;
    let own = &places[starts[node] as usize..starts[node + 1] as usize];
    own.iter().map(|&place| (place as usize / 4, place as usize % 4))
}

/// What one element gives to its stress and to the pressures of its corners.
pub(super) struct Part {
    pub(super) energy: Energy,
    /// `¼ Σ_a (s P − p G)`
    pub(super) stress: Matrix3,
    /// `¼ V_e p` at each corner.
    pub(super) pressure: [f64; 4],
}
