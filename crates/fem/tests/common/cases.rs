//! Random bodies, materials and smooth displacement fields, each from a seed.

use std::f64::consts::PI;

use tissuereg_fem::{
    Body, Element, FemError, Material, Mesh, Stiffness, Supports, internal_forces, is_stable,
};

use super::{Random, bar_arrays};

/// Laws that cases draw from; a new one is one entry more.
pub const LAWS: &[(&str, Law)] = &[("neo-Hookean", Material::new)];

/// Makes a material of a field of stiffness.
pub type Law = fn(Stiffness) -> Result<Material, FemError>;

/// Smallest det F of a manufactured field.
pub const SMALLEST_DET_F: f64 = 0.2;

/// A body with a material.
pub struct Case {
    pub seed: u64,
    pub body: Body,
    pub material: Material,
    /// What was drawn, in words.
    pub words: String,
}

impl Random {
    /// Uniform in (low, high).
    pub fn within(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * 0.5 * (self.next() + 1.0)
    }

    /// One of 0 to n − 1.
    pub fn below(&mut self, n: usize) -> usize {
        (self.within(0.0, n as f64) as usize).min(n - 1)
    }

    pub fn skip(&mut self, n: usize) {
        for _ in 0..n {
            self.next();
        }
    }

    pub fn vector(&mut self, size: f64) -> [f64; 3] {
        std::array::from_fn(|_| size * self.next())
    }
}

/// Body and material of a seed.
pub fn case(seed: u64) -> Case {
    let mut random = Random::new(seed + 1);
    // Neighbouring seeds start alike.
    random.skip(8);
    let (mesh, mesh_words) = mesh(&mut random);
    let element = if random.below(5) < 3 { Element::Tet4 } else { Element::Tet10 };
    let (body, support_words) = supported(&mesh, element, &mut random);
    let (material, law_words) = material(body.n_tets(), &mut random);
    let words = format!("{mesh_words}, {element:?}, {support_words}, {law_words}");
    Case { seed, body, material, words }
}

/// A jittered box, a half ellipsoid, a thin slab or a graded box.
pub fn mesh(random: &mut Random) -> (Mesh, String) {
    let kind = random.below(4);
    let mut cells: [usize; 3] = std::array::from_fn(|_| 1 + random.below(4));
    let mut size: [f64; 3] = std::array::from_fn(|_| random.within(10.0, 60.0));
    let name = ["box", "half ellipsoid", "thin slab", "graded box"][kind];
    match kind {
        1 => {
            cells = [[2, 2, 1], [4, 4, 2]][random.below(2)];
            size = [2.0, 2.0, 1.0];
        }
        2 => {
            cells = [3 + random.below(4), 2 + random.below(4), 1];
            size[2] = random.within(0.05, 0.12) * size[0].max(size[1]);
        }
        _ => {}
    }
    let (mut nodes, tets) = bar_arrays(cells, size);
    let jitter = random.within(0.0, 0.18);
    for x in &mut nodes {
        for i in 0..3 {
            x[i] += jitter * size[i] / cells[i] as f64 * random.next();
        }
    }
    if kind == 1 {
        let axes: [f64; 3] = std::array::from_fn(|_| random.within(20.0, 70.0));
        let root = |p: f64, q: f64| (1.0 - 0.5 * p * p - 0.5 * q * q + p * p * q * q / 3.0).sqrt();
        for x in &mut nodes {
            // Jittered surfaces leave the cube a little.
            let [a, b, c] = [x[0] - 1.0, x[1] - 1.0, x[2]].map(|v| v.clamp(-1.1, 1.1) / 1.1);
            *x = [axes[0] * a * root(b, c), axes[1] * b * root(a, c), axes[2] * c * root(a, b)];
        }
    }
    if kind == 3 {
        let axis = random.below(3);
        let power = random.within(1.5, 2.5);
        for x in &mut nodes {
            let part: f64 = x[axis] / size[axis];
            x[axis] =
                size[axis] * part.signum() * (0.15 * part.abs() + 0.85 * part.abs().powf(power));
        }
    }
    match Mesh::new(nodes, tets) {
        Ok(mesh) => (mesh, format!("{name} {cells:?} cells jitter {jitter:.2}")),
        // Much jitter on a clamped map may invert a tetrahedron: draw again.
        Err(_) => self::mesh(random),
    }
}

fn supported(mesh: &Mesh, element: Element, random: &mut Random) -> (Body, String) {
    loop {
        let direction = random.vector(1.0);
        let along = |x: &[f64; 3]| -> f64 { (0..3).map(|i| direction[i] * x[i]).sum() };
        let mut order: Vec<usize> = (0..mesh.n_nodes()).collect();
        order.sort_by(|&a, &b| along(&mesh.nodes()[a]).total_cmp(&along(&mesh.nodes()[b])));
        let share = random.within(0.08, 0.35);
        let count = ((share * mesh.n_nodes() as f64) as usize).max(3);
        let end = &order[..count];
        let (supports, words) = match random.below(4) {
            0 => {
                let far = &order[mesh.n_nodes() - (count / 2).max(1)..];
                let all = end.iter().chain(far).copied().collect::<Vec<_>>();
                (Supports::from(all), "clamped at two ends")
            }
            1 => {
                let mut axes = [true; 3];
                axes[random.below(3)] = false;
                (Supports::new().hold(&end[..3]).hold_axes(&end[3..], axes), "sliding")
            }
            _ => (Supports::from(end.to_vec()), "clamped at one end"),
        };
        if let Ok(body) = Body::new(mesh.clone(), element, supports)
            && body.n_unknowns() > 0
        {
            return (body, format!("{words} ({count} of {} nodes)", mesh.n_nodes()));
        }
    }
}

fn material(n_tets: usize, random: &mut Random) -> (Material, String) {
    let (name, law) = LAWS[random.below(LAWS.len())];
    let young = |random: &mut Random| 10f64.powf(random.within(0.0, 2.0));
    // Half of them nearly incompressible.
    let poisson =
        if random.below(2) == 0 { random.within(0.0, 0.45) } else { random.within(0.45, 0.499) };
    let stiffness = if random.below(2) == 0 {
        Stiffness::Uniform { young: young(random), poisson }
    } else {
        let young = (0..n_tets).map(|_| young(random)).collect();
        Stiffness::PerTet { young, poisson: vec![poisson] }
    };
    let field = if matches!(stiffness, Stiffness::Uniform { .. }) { "uniform" } else { "per tet" };
    (law(stiffness).expect("within its range"), format!("{name} {field} nu {poisson:.4}"))
}

/// A smooth field with its internal forces, positive definite tangent and min det F above
/// [`SMALLEST_DET_F`].
pub struct Manufactured {
    pub displacement: Vec<[f64; 3]>,
    pub forces: Vec<[f64; 3]>,
    pub moves_supports: bool,
    pub min_det_f: f64,
    /// Fields drawn before one was stable.
    pub rejected: usize,
}

/// Stable field of a case: between a third and all of the largest multiple of a random shape that is
/// stable and keeps elements upright enough; some with the supports turned by up to a right angle.
pub fn manufactured(case: &Case) -> Manufactured {
    let Case { body, material, .. } = case;
    let mut random = Random::new(case.seed + 1_000_003);
    random.skip(8);
    let moves_supports = random.below(2) == 0;
    let turns = moves_supports && random.below(2) == 0;
    let mut rejected = 0;
    loop {
        let shape = smooth_field(body, moves_supports, &mut random);
        let upright = |field: &[[f64; 3]]| min_det_f(body, field) > SMALLEST_DET_F;
        let stable = |field: &[[f64; 3]]| is_stable(body, material, field) == Ok(true);
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..10 {
            let middle = 0.5 * (low + high);
            let field = scaled(&shape, middle);
            if upright(&field) && stable(&field) {
                low = middle;
            } else {
                high = middle;
            }
        }
        // Compressed shapes buckle at once and would leave fields of hardly any size.
        if low < if rejected < 40 { 0.1 } else { 0.01 } {
            rejected += 1;
            continue;
        }
        let mut displacement = scaled(&shape, low * random.within(0.3, 1.0));
        if turns {
            turn(body, random.vector(1.0), random.within(0.0, 0.5 * PI), &mut displacement);
        }
        if upright(&displacement) && stable(&displacement) {
            let forces = internal_forces(body, material, &displacement).expect("upright");
            let min_det_f = min_det_f(body, &displacement);
            return Manufactured { displacement, forces, moves_supports, min_det_f, rejected };
        }
        rejected += 1;
    }
}

/// Turn the displaced body about the origin.
fn turn(body: &Body, axis: [f64; 3], angle: f64, displacement: &mut [[f64; 3]]) {
    let axis = nalgebra::Unit::new_normalize(nalgebra::Vector3::from(axis));
    let rotation = nalgebra::Rotation3::from_axis_angle(&axis, angle);
    for (u, x) in displacement.iter_mut().zip(body.nodes()) {
        let x = nalgebra::Vector3::from(*x);
        *u = (rotation * (x + nalgebra::Vector3::from(*u)) - x).into();
    }
}

fn scaled(shape: &[[f64; 3]], factor: f64) -> Vec<[f64; 3]> {
    shape.iter().map(|row| row.map(|v| factor * v)).collect()
}

/// An affine map and three waves no shorter than the body.
fn smooth_field(body: &Body, moves_supports: bool, random: &mut Random) -> Vec<[f64; 3]> {
    let nodes = body.nodes();
    let corner = |pick: fn(f64, f64) -> f64| -> [f64; 3] {
        std::array::from_fn(|i| nodes.iter().map(|x| x[i]).fold(nodes[0][i], pick))
    };
    let (low, high) = (corner(f64::min), corner(f64::max));
    let extent = (0..3).map(|i| high[i] - low[i]).fold(0.0, f64::max);
    let mut affine = random.matrix(0.8);
    (0..3).for_each(|i| affine[i][i] = random.within(-0.5, 1.0));
    let waves: Vec<_> = (0..3)
        .map(|_| (random.vector(0.3 * extent), random.vector(5.0 / extent), 3.0 * random.next()))
        .collect();
    let held = body.held_nodes();
    let weight = |x: &[f64; 3]| {
        let square = held.iter().map(|&n| (0..3).map(|i| (x[i] - nodes[n][i]).powi(2)).sum());
        let distance = square.fold(f64::INFINITY, |m: f64, v: f64| m.min(v)).sqrt();
        if moves_supports { 1.0 } else { distance / (distance + 0.3 * extent) }
    };
    let mut field: Vec<[f64; 3]> = nodes
        .iter()
        .map(|x| {
            let w = weight(x);
            std::array::from_fn(|i| {
                let linear: f64 = (0..3).map(|j| affine[i][j] * (x[j] - low[j])).sum();
                let waving: f64 = waves
                    .iter()
                    .map(|(a, k, phase)| {
                        a[i] * ((0..3).map(|j| k[j] * x[j]).sum::<f64>() + phase).sin()
                    })
                    .sum();
                w * (linear + waving)
            })
        })
        .collect();
    // A held mid-edge node moves by the mean of its ends.
    for (e, &[a, b]) in body.mid_edges().iter().enumerate() {
        if held.contains(&a) && held.contains(&b) {
            field[body.n_corner_nodes() + e] =
                std::array::from_fn(|i| 0.5 * (field[a][i] + field[b][i]));
        }
    }
    field
}

/// Smallest det F at corners of the elements, by hand.
pub fn min_det_f(body: &Body, displacement: &[[f64; 3]]) -> f64 {
    let mesh = body.mesh();
    let place =
        |n: usize| -> [f64; 3] { std::array::from_fn(|i| body.nodes()[n][i] + displacement[n][i]) };
    let middle = |a: usize, b: usize| {
        let edge = [a.min(b), a.max(b)];
        body.mid_edges().binary_search(&edge).ok().map(|e| place(body.n_corner_nodes() + e))
    };
    let mut smallest = f64::INFINITY;
    for (t, tet) in mesh.tets().iter().enumerate() {
        for (k, &here) in tet.iter().enumerate() {
            let x = place(here);
            // Tangents of the three edges at this corner: of a parabola through the middle.
            let tangents: Vec<[f64; 3]> = tet
                .iter()
                .filter(|&&n| n != here)
                .map(|&n| {
                    let (y, m) = (place(n), middle(here, n));
                    std::array::from_fn(|i| match m {
                        Some(m) => 4.0 * m[i] - 3.0 * x[i] - y[i],
                        None => y[i] - x[i],
                    })
                })
                .collect();
            let [a, b, c] = [tangents[0], tangents[1], tangents[2]];
            let det = a[0] * (b[1] * c[2] - b[2] * c[1])
                + a[1] * (b[2] * c[0] - b[0] * c[2])
                + a[2] * (b[0] * c[1] - b[1] * c[0]);
            let sign = if k % 2 == 0 { 1.0 } else { -1.0 };
            smallest = smallest.min(sign * det / (6.0 * mesh.tet_volume(t)));
        }
    }
    smallest
}
