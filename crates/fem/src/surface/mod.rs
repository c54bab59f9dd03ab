//! What lies on the surface of a body: springs that hold it.
//!
//! They are given on triangles of the surface and add their energy to that of the body. A facet
//! has the three or six nodes of its element's face, all of which belong to one element, so the
//! fronts of the body are theirs as well.

mod blocks;
mod facet;
mod friction;
mod spring_facet;
mod traction;

pub(crate) use blocks::{FacetBlocks, WithFacets};
use facet::facets_of;
pub(crate) use friction::Slip;

use crate::body::Body;
use crate::error::FemError;
use crate::springs::Springs;
use spring_facet::SpringFacet;

/// Springs of a body, ready for its solver.
#[derive(Debug, Clone, Default)]
pub(crate) struct SurfaceTerms {
    /// Facets of each set of springs.
    springs: Vec<Vec<SpringFacet>>,
}

impl SurfaceTerms {
    /// Check springs against a body.
    ///
    /// # Errors
    ///
    /// [`FemError::NotOnSurface`], [`FemError::BadParameter`].
    pub(crate) fn new(body: &Body, springs: &[Springs]) -> Result<Self, FemError> {
        let springs = springs
            .iter()
            .map(|set| {
                set.check()?;
                let facets = facets_of(body, &set.triangles)?;
                Ok(facets.into_iter().map(|facet| SpringFacet::new(facet, set)).collect())
            })
            .collect::<Result<_, FemError>>()?;
        Ok(Self { springs })
    }

    /// Add the forces of a displacement to `force` and return its energy, µJ.
    pub(crate) fn add_force(&self, displacement: &[f64], force: &mut [f64]) -> f64 {
        let facets = self.springs.iter().flatten();
        facets.fold(0.0, |energy, facet| energy + facet.add_force(displacement, force))
    }

    /// Tangent at a displacement (none: at rest) as blocks of the cliques that hold the facets.
    pub(crate) fn blocks(&self, displacement: Option<&[f64]>) -> FacetBlocks {
        let mut blocks = FacetBlocks::default();
        for facet in self.springs.iter().flatten() {
            let matrix = facet.matrix(displacement);
            blocks.add(&facet.facet, |a, b| matrix[a][b]);
        }
        blocks.sort();
        blocks
    }

    /// Add the tangent at a displacement times a direction to `product`.
    pub(crate) fn add_product(&self, displacement: &[f64], direction: &[f64], product: &mut [f64]) {
        for facet in self.springs.iter().flatten() {
            facet.facet.add_product(&facet.matrix(Some(displacement)), direction, product);
        }
    }

    /// What points that may slip remember, in their order; none without friction.
    pub(crate) fn slips(&self) -> Vec<Slip> {
        self.springs.iter().flatten().flat_map(|facet| facet.slips()).copied().collect()
    }

    /// What they remember at a displacement: the pressure there, and with `slid` what has slipped.
    pub(crate) fn slips_after(&self, displacement: &[f64], slid: bool) -> Vec<Slip> {
        let facets = self.springs.iter().flatten();
        facets.flat_map(|facet| facet.slips_after(displacement, slid)).collect()
    }

    /// Go on from what as many points remember.
    pub(crate) fn go_on_from(&mut self, slips: &[Slip]) {
        let points = self.springs.iter_mut().flatten().flat_map(SpringFacet::slips_mut);
        points.zip(slips).for_each(|(point, slip)| *point = *slip);
    }

    /// Forces of each set of springs on the body, one row per node, mN.
    pub(crate) fn spring_forces(&self, displacement: &[f64]) -> Vec<Vec<[f64; 3]>> {
        self.springs
            .iter()
            .map(|set| {
                let mut force = vec![0.0; displacement.len()];
                for facet in set {
                    facet.add_force(displacement, &mut force);
                }
                force.as_chunks::<3>().0.iter().map(|row| row.map(|v| -v)).collect()
            })
            .collect()
    }
}
