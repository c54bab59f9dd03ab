//! Dry friction: springs along a facet that slip where they pull harder than its pressure holds.
//!
//! Within a step the pressure is given, so that the sliding has a potential: with the stretch `s` of
//! a spring of stiffness `k` and the traction `L` that holds, `½ k s²` up to `s = L/k` and
//! `L s − L²/2k` beyond. The state is what has slipped by the end of the step (after Ortiz and
//! Stainier, Comput. Methods Appl. Mech. Eng. 171, 419 (1999)).

use super::facet::Facet;
use crate::element::cross;
use crate::springs::{Friction, Springs};

/// Share of the stiffness in the plane that slips never take: it keeps a body in its place that
/// nothing presses down.
pub(super) const LEFT: f64 = 1e-6;

/// What a point of a facet remembers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Slip {
    /// Where its spring in the plane pulls nothing: displacement in the plane, mm.
    anchor: [f64; 3],
    /// kPa.
    pressure: f64,
}

/// The springs in the plane of one facet, point by point.
#[derive(Debug, Clone)]
pub(super) struct Slipping {
    friction: Friction,
    /// kPa/mm
    normal: f64,
    /// kPa/mm
    stick: f64,
    /// Weight over the area and shape functions of each point.
    points: Vec<(f64, Vec<f64>)>,
    pub(super) slips: Vec<Slip>,
}

/// Stretch of a point's spring, its length and the traction that holds.
struct Pulled {
    stretch: [f64; 3],
    size: f64,
    holds: f64,
}

/// Weights, over the area, and barycentric coordinates of the points of a facet with three nodes:
/// right for products of shape functions.
const POINTS3: [(f64, [f64; 3]); 3] = {
    let (w, a, b) = (1.0 / 3.0, 2.0 / 3.0, 1.0 / 6.0);
    [(w, [a, b, b]), (w, [b, a, b]), (w, [b, b, a])]
};

/// The same for six nodes, of degree four (Dunavant, Int. J. Numer. Methods Eng. 21, 1129 (1985)).
const POINTS6: [(f64, [f64; 3]); 6] = {
    let (w, a, b) = (0.223_381_589_678_011_47, 0.108_103_018_168_070_23, 0.445_948_490_915_964_9);
    let (v, c, d) = (0.109_951_743_655_321_87, 0.816_847_572_980_458_5, 0.091_576_213_509_770_74);
    [(w, [a, b, b]), (w, [b, a, b]), (w, [b, b, a]), (v, [c, d, d]), (v, [d, c, d]), (v, [d, d, c])]
};

impl Slipping {
    pub(super) fn new(facet: &Facet, springs: &Springs, friction: Friction) -> Self {
        let rest = Slip { anchor: [0.0; 3], pressure: 0.0 };
        let points = points(facet);
        let slips = vec![rest; points.len()];
        let stick = (1.0 - LEFT) * springs.tangential;
        Self { friction, normal: springs.normal, stick, points, slips }
    }

    /// Displacement at a point: along the normal (outward), and in the plane.
    fn displaced(facet: &Facet, shape: &[f64], displacement: &[f64]) -> (f64, [f64; 3]) {
        let mut u = [0.0; 3];
        for (&node, n) in facet.nodes.iter().zip(shape) {
            for (i, sum) in u.iter_mut().enumerate() {
                *sum += n * displacement[3 * node + i];
            }
        }
        let across: f64 = (0..3).map(|i| u[i] * facet.normal[i]).sum();
        (across, std::array::from_fn(|i| u[i] - across * facet.normal[i]))
    }

    fn pulled(&self, slip: &Slip, along: [f64; 3]) -> Pulled {
        let stretch: [f64; 3] = std::array::from_fn(|i| along[i] - slip.anchor[i]);
        let size = stretch.iter().map(|v| v * v).sum::<f64>().sqrt();
        let holds = self.friction.cohesion + self.friction.coefficient * slip.pressure;
        Pulled { stretch, size, holds }
    }

    fn slides(&self, pulled: &Pulled) -> bool {
        self.stick * pulled.size > pulled.holds
    }

    /// Add the forces of a displacement and return its energy, µJ.
    pub(super) fn add_force(&self, facet: &Facet, displacement: &[f64], force: &mut [f64]) -> f64 {
        let mut energy = 0.0;
        for ((weight, shape), slip) in self.points.iter().zip(&self.slips) {
            let (_, along) = Self::displaced(facet, shape, displacement);
            let pulled = self.pulled(slip, along);
            let Pulled { size, holds, .. } = pulled;
            let (slope, stored) = match self.slides(&pulled) {
                true => (holds / size, holds * (size - 0.5 * holds / self.stick)),
                false => (self.stick, 0.5 * self.stick * size * size),
            };
            let area = weight * facet.area;
            energy += area * stored;
            for (&node, n) in facet.nodes.iter().zip(shape) {
                for i in 0..3 {
                    force[3 * node + i] += area * n * slope * pulled.stretch[i];
                }
            }
        }
        energy
    }

    /// Tangent between all pairs of nodes at a displacement (none: where nothing slips), mN/mm.
    pub(super) fn matrix(
        &self,
        facet: &Facet,
        displacement: Option<&[f64]>,
    ) -> Vec<Vec<[[f64; 3]; 3]>> {
        let n_nodes = facet.nodes.len();
        let mut matrix = vec![vec![[[0.0; 3]; 3]; n_nodes]; n_nodes];
        for ((weight, shape), slip) in self.points.iter().zip(&self.slips) {
            let mut stiffness = plane(facet, self.stick);
            if let Some(displacement) = displacement {
                let (_, along) = Self::displaced(facet, shape, displacement);
                let pulled = self.pulled(slip, along);
                if self.slides(&pulled) {
                    stiffness = across_slip(facet, &pulled);
                }
            }
            for (a, na) in shape.iter().enumerate() {
                for (b, nb) in shape.iter().enumerate() {
                    for (row, k) in matrix[a][b].iter_mut().zip(&stiffness) {
                        for (sum, k) in row.iter_mut().zip(k) {
                            *sum += weight * facet.area * na * nb * k;
                        }
                    }
                }
            }
        }
        matrix
    }

    /// What is remembered at a displacement if it holds: the pressure there, and with `slid` what has
    /// slipped under the pressure so far.
    pub(super) fn after(&self, facet: &Facet, displacement: &[f64], slid: bool) -> Vec<Slip> {
        let point = |((_, shape), slip): (&(f64, Vec<f64>), &Slip)| {
            let (across, along) = Self::displaced(facet, shape, displacement);
            let pressure = (self.normal * across).max(0.0);
            let pulled = self.pulled(slip, along);
            let mut anchor = slip.anchor;
            if slid && self.slides(&pulled) {
                let share = 1.0 - pulled.holds / (self.stick * pulled.size);
                anchor = std::array::from_fn(|i| slip.anchor[i] + share * pulled.stretch[i]);
            }
            Slip { anchor, pressure }
        };
        self.points.iter().zip(&self.slips).map(point).collect()
    }
}

impl Slip {
    /// How far the pressures of two states of the same points lie apart: norm over norm.
    pub(crate) fn apart(one: &[Self], other: &[Self]) -> f64 {
        let norm =
            |values: &mut dyn Iterator<Item = f64>| values.map(|v| v * v).sum::<f64>().sqrt();
        let between = norm(&mut one.iter().zip(other).map(|(a, b)| a.pressure - b.pressure));
        let size = norm(&mut one.iter().map(|a| a.pressure));
        if between > 0.0 { between / size.max(f64::MIN_POSITIVE) } else { 0.0 }
    }
}

/// Weights over the area and shape functions at the points of a facet.
fn points(facet: &Facet) -> Vec<(f64, Vec<f64>)> {
    match facet.nodes.len() {
        3 => POINTS3.iter().map(|(w, l)| (*w, l.to_vec())).collect(),
        _ => POINTS6.iter().map(|(w, l)| (*w, quadratic(*l))).collect(),
    }
}

/// Shape functions of six nodes at barycentric coordinates.
fn quadratic([a, b, c]: [f64; 3]) -> Vec<f64> {
    let corner = |l: f64| l * (2.0 * l - 1.0);
    vec![corner(a), corner(b), corner(c), 4.0 * a * b, 4.0 * b * c, 4.0 * c * a]
}

/// The same stiffness in all directions of a facet's plane.
fn plane(facet: &Facet, k: f64) -> [[f64; 3]; 3] {
    let n = facet.normal;
    std::array::from_fn(|i| std::array::from_fn(|j| k * (f64::from(i == j) - n[i] * n[j])))
}

/// A spring that slips resists a turn of its stretch alone.
fn across_slip(facet: &Facet, pulled: &Pulled) -> [[f64; 3]; 3] {
    let side = cross(facet.normal, pulled.stretch.map(|v| v / pulled.size));
    let slope = pulled.holds / pulled.size;
    std::array::from_fn(|i| std::array::from_fn(|j| slope * side[i] * side[j]))
}

#[cfg(test)]
#[allow(clippy::expect_used)]
mod tests {
    use super::*;
    use crate::body::Body;
    use crate::element::Element;
    use crate::mesh::Mesh;
    use crate::surface::facet::facets_of;
    use crate::surface::spring_facet::SpringFacet;

    /// Forces are the energy's derivatives, and the tangent is theirs, sticking and slipping.
    #[test]
    fn forces_and_tangent_are_derivatives() {
        let nodes = vec![[0.0, 0.0, 0.0], [9.0, 1.0, 0.5], [1.0, 8.0, -0.3], [2.0, 1.0, 7.0]];
        for element in [Element::Tet4, Element::Tet10] {
            let mesh = Mesh::new(nodes.clone(), vec![[0, 1, 2, 3]]).expect("sound");
            let body = Body::new(mesh, element, [0, 1, 2]).expect("held");
            let facet = facets_of(&body, &[[0, 1, 2]]).expect("on the surface").remove(0);
            let friction = Some(Friction { coefficient: 0.4, cohesion: 0.28 });
            let springs =
                Springs { triangles: vec![[0, 1, 2]], normal: 2.0, tangential: 1.5, friction };
            let one = SpringFacet::new(facet, &springs);
            for size in [0.05, 0.6] {
                let n = 3 * body.n_nodes();
                let at: Vec<f64> =
                    (0..n).map(|k| size * ((7 * k % 11) as f64 / 5.0 - 1.0)).collect();
                let force = |u: &[f64]| {
                    let mut force = vec![0.0; n];
                    let energy = one.add_force(u, &mut force);
                    (energy, force)
                };
                let matrix = one.matrix(Some(&at));
                let slides = one.slips_after(&at, true) != one.slips_after(&at, false);
                assert_eq!(slides, size > 0.5);
                for (b, &node) in one.facet.nodes.iter().enumerate() {
                    for k in 0..3 {
                        let ends = [1e-5, -1e-5].map(|step| {
                            let mut u = at.clone();
                            u[3 * node + k] += step;
                            force(&u)
                        });
                        let slope = (ends[0].0 - ends[1].0) / 2e-5;
                        assert!((slope - force(&at).1[3 * node + k]).abs() < 1e-6);
                        for (a, &row) in one.facet.nodes.iter().enumerate() {
                            for i in 0..3 {
                                let slope =
                                    (ends[0].1[3 * row + i] - ends[1].1[3 * row + i]) / 2e-5;
                                assert!((slope - matrix[a][b][i][k]).abs() < 1e-5, "{a} {b}");
                            }
                        }
                    }
                }
            }
        }
    }
}
