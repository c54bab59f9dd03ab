//! The shape of a stiffness: what a factor of it depends on, up to a number.

use std::hash::{DefaultHasher, Hash, Hasher};

use super::field::Material;
use super::stiffness::{Fibres, Layout, Stiffness};
use crate::error::FemError;
use crate::springs::Springs;

/// Rest stiffness up to a factor: what a rest factor depends on.
///
/// All laws share the rest stiffness of the neo-Hookean one; fibres add theirs.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Shape {
    /// Moduli over the largest, rounded to 24 bits; one entry where uniform.
    young: Vec<f32>,
    pub(crate) poisson: Vec<f64>,
    layout: Layout,
    /// Fibres as far as they matter at rest.
    fibres: Option<Fibres>,
    /// Springs, their stiffness over the same modulus.
    pub(crate) springs: Vec<Springs>,
}

impl Shape {
    /// Shape of a stiffness with springs and the modulus that was divided out, kPa.
    pub(crate) fn of(material: &Material, springs: &[Springs]) -> (Self, f64) {
        let stiffness = material.stiffness();
        let (young, poisson) = stiffness.fields();
        let largest = young.iter().fold(0.0_f64, |m, &v| m.max(v));
        let fibres = material.fibres().filter(|fibres| fibres.k1_over_mu > 0.0);
        let mut shape = Self {
            young: young.iter().map(|v| (v / largest) as f32).collect(),
            poisson: poisson.to_vec(),
            layout: stiffness.layout(),
            fibres: fibres.map(|fibres| Fibres { k2: 0.0, tension_only: false, ..fibres.clone() }),
            springs: springs.to_vec(),
        };
        for set in &mut shape.springs {
            // At rest all sticks.
            set.friction = None;
            set.normal /= largest;
            set.tangential /= largest;
        }
        shape.simplify();
        (shape, largest)
    }

    /// Fields that are constant after all have the shape of uniform ones.
    fn simplify(&mut self) {
        if self.poisson.windows(2).all(|w| w[0] == w[1]) {
            self.poisson.truncate(1);
        }
        if self.poisson.len() == 1 && self.young.windows(2).all(|w| w[0] == w[1]) {
            self.young.truncate(1);
            self.layout = Layout::Uniform;
        }
    }

    /// Number by which equal shapes are found.
    pub(crate) fn key(&self) -> u64 {
        let mut hasher = DefaultHasher::new();
        self.young.iter().for_each(|v| v.to_bits().hash(&mut hasher));
        self.poisson.iter().for_each(|v| v.to_bits().hash(&mut hasher));
        self.layout.hash(&mut hasher);
        if let Some(fibres) = &self.fibres {
            fibres.k1_over_mu.to_bits().hash(&mut hasher);
            let all = fibres.directions.vectors().as_flattened();
            all.iter().for_each(|v| v.to_bits().hash(&mut hasher));
        }
        for set in &self.springs {
            (set.normal.to_bits(), set.tangential.to_bits(), &set.triangles).hash(&mut hasher);
        }
        hasher.finish()
    }

    /// A material of this shape with Poisson's ratios up to `most`.
    pub(crate) fn material(&self, most: f64) -> Result<Material, FemError> {
        // A modulus of zero after rounding would make the shape singular.
        let young: Vec<f64> = self.young.iter().map(|&v| f64::from(v).max(1e-30)).collect();
        let poisson: Vec<f64> = self.poisson.iter().map(|nu| nu.min(most)).collect();
        let material = Material::new(match (self.layout, young.as_slice(), poisson.as_slice()) {
            (_, &[young], &[poisson]) => Stiffness::Uniform { young, poisson },
            (Layout::PerPoint(n_points), ..) => Stiffness::PerPoint { n_points, young, poisson },
            _ => Stiffness::PerTet { young, poisson },
        })?;
        match &self.fibres {
            Some(fibres) => material.with_fibres(fibres.clone()),
            None => Ok(material),
        }
    }
}
