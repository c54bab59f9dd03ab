//! The way of moved supports from rest to where the load has them.
//!
//! On a straight chord a turned support shrinks: at half of 120 degrees to half its size. So every
//! connected set of clamped nodes that is displaced much like a rigid body (all of them together,
//! where one rigid motion describes them) turns about its centre at a constant rate; only what
//! that leaves goes straight:
//!
//! ```text
//! u(t) = r(t) + t (u(1) − r(1)),     r(t) = t s + (R(t θ) − I)(X − c)
//! ```
//!
//! `R` and `s` are the best fit in the sense of least squares (Kabsch, Acta Cryst. A 32, 922, 1976).

use nalgebra::{Matrix3, Rotation3, Vector3};

use crate::body::Body;
use crate::groups::Groups;
use crate::load::NodalLoad;

/// Angles up to this go straight, rad: a chord across it is shorter than its arc by 0.2 %.
const STRAIGHT: f64 = 0.2;

/// Share of a displacement without its mean that a rigid motion may leave unexplained.
const UNEXPLAINED: f64 = 0.5;

/// The same for one motion of all supports together.
const UNEXPLAINED_BY_ONE: f64 = 0.25;

/// Where held nodes are at each fraction of the load.
#[derive(Debug, Clone)]
pub(super) struct SupportPath {
    turns: Vec<Turn>,
    /// The first turn is that of all held nodes.
    is_common: bool,
}

/// A rigid motion of a set of nodes.
#[derive(Debug, Clone)]
pub(super) struct Turn {
    nodes: Vec<usize>,
    centre: Vector3<f64>,
    shift: Vector3<f64>,
    /// Axis times angle, rad.
    rotation: Vector3<f64>,
}

impl SupportPath {
    pub(super) fn new(body: &Body, load: &NodalLoad) -> Self {
        if !load.moves_supports {
            return Self { turns: Vec::new(), is_common: false };
        }
        let sets = clamped_sets(body);
        let all: Vec<usize> = sets.iter().flatten().copied().collect();
        let any_held = body.held().iter().filter(|axes| axes.contains(&true)).count();
        if all.len() == any_held
            && let Some(turn) = Turn::fitted(body, load, all, UNEXPLAINED_BY_ONE)
        {
            return Self { turns: vec![turn], is_common: true };
        }
        let turns =
            sets.into_iter().filter_map(|set| Turn::fitted(body, load, set, UNEXPLAINED)).collect();
        Self { turns, is_common: false }
    }

    /// The turn of all held nodes together, where there is one.
    pub(super) fn common(&self) -> Option<&Turn> {
        self.turns.first().filter(|_| self.is_common)
    }

    /// Write the displacement of held axes at a fraction; free ones are left as they are.
    pub(super) fn at_into(&self, body: &Body, load: &NodalLoad, fraction: f64, out: &mut [f64]) {
        for ((value, &end), _) in
            out.iter_mut().zip(&load.prescribed).zip(body.held().as_flattened()).filter(|x| *x.1)
        {
            *value = fraction * end;
        }
        if fraction == 1.0 {
            return;
        }
        for turn in &self.turns {
            for &node in &turn.nodes {
                let x = Vector3::from(body.nodes()[node]);
                let bow = turn.motion(&x, fraction) - fraction * turn.motion(&x, 1.0);
                for i in 0..3 {
                    out[3 * node + i] += bow[i];
                }
            }
        }
    }
}

impl Turn {
    /// Best fit to the prescribed displacement of `nodes`; none where it is no better than a chord.
    fn fitted(body: &Body, load: &NodalLoad, nodes: Vec<usize>, unexplained: f64) -> Option<Self> {
        let place = |n: usize| Vector3::from(body.nodes()[n]);
        let moved =
            |n: usize| place(n) + Vector3::from_column_slice(&load.prescribed[3 * n..3 * n + 3]);
        let count = nodes.len() as f64;
        let centre = nodes.iter().map(|&n| place(n)).sum::<Vector3<f64>>() / count;
        let new_centre = nodes.iter().map(|&n| moved(n)).sum::<Vector3<f64>>() / count;
        let mut covariance = Matrix3::zeros();
        for &n in &nodes {
            covariance += (moved(n) - new_centre) * (place(n) - centre).transpose();
        }
        if !covariance.iter().all(|v| v.is_finite()) {
            return None;
        }
        let svd = covariance.try_svd(true, true, f64::EPSILON, 200)?;
        // Nodes on a line fit rotations about it equally well.
        if svd.singular_values[1] <= 1e-6 * svd.singular_values[0] {
            return None;
        }
        let (u, v_t) = (svd.u?, svd.v_t?);
        let sign = (u * v_t).determinant().signum();
        let matrix = u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * v_t;
        let rotation = Rotation3::from_matrix_unchecked(matrix).scaled_axis();
        if rotation.norm().is_nan() || rotation.norm() <= STRAIGHT {
            return None;
        }
        let turn = Self { nodes, centre, shift: new_centre - centre, rotation };
        let (mut total, mut rest) = (0.0, 0.0);
        for &n in &turn.nodes {
            let u = moved(n) - place(n);
            total += (u - turn.shift).norm_squared();
            rest += (u - turn.motion(&place(n), 1.0)).norm_squared();
        }
        (rest.sqrt() <= unexplained * total.sqrt()).then_some(turn)
    }

    /// Displacement by the rigid motion, at a fraction, of what was at `x` at rest.
    fn motion(&self, x: &Vector3<f64>, fraction: f64) -> Vector3<f64> {
        let arm = x - self.centre;
        Rotation3::new(fraction * self.rotation) * arm - arm + fraction * self.shift
    }

    /// Angle between two fractions, rad.
    pub(super) fn angle(&self, from: f64, to: f64) -> f64 {
        (to - from).abs() * self.rotation.norm()
    }

    /// Carry a displaced body along from one fraction to another.
    pub(super) fn carry(&self, body: &Body, from: f64, to: f64, displacement: &mut [f64]) {
        let rotation = Rotation3::new((to - from) * self.rotation);
        for (u, x) in displacement.as_chunks_mut::<3>().0.iter_mut().zip(body.nodes()) {
            let arm = Vector3::from(*x) + Vector3::from(*u) - self.centre - from * self.shift;
            let new = rotation * arm + self.centre + to * self.shift - Vector3::from(*x);
            *u = new.into();
        }
    }
}

/// Nodes held along all axes, in sets that share elements; sets of one or two nodes left in too.
fn clamped_sets(body: &Body) -> Vec<Vec<usize>> {
    let clamped: Vec<bool> = body.held().iter().map(|axes| *axes == [true; 3]).collect();
    let mut groups = Groups::new(body.n_nodes());
    for element in 0..body.geometry().n_elements() {
        let mut nodes =
            (body.geometry().nodes_of(element).iter()).map(|&n| n as usize).filter(|&n| clamped[n]);
        if let Some(first) = nodes.next() {
            nodes.for_each(|n| groups.join(first, n));
        }
    }
    let number = groups.numbered();
    let mut sets = vec![Vec::new(); number.iter().max().map_or(0, |&m| m + 1)];
    for n in (0..body.n_nodes()).filter(|&n| clamped[n]) {
        sets[number[n]].push(n);
    }
    sets.retain(|set| !set.is_empty());
    sets
}
