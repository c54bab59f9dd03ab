//! What lies on the surface of a body: springs that hold it and a skin that covers it.
//!
//! Both are given on triangles of the surface and add their energy to that of the body. A facet
//! has the three or six nodes of its element's face, all of which belong to one element, so the
//! fronts of the body are theirs as well.

mod blocks;
mod facet;
mod friction;
mod skin;
mod springs;
mod traction;

pub(crate) use blocks::{FacetBlocks, WithFacets};
use facet::facets_of;
pub(crate) use facet::{FacetOwners, facet_owners};
pub use friction::Friction;
pub(crate) use friction::{Slip, must_stick};
pub use skin::Skin;
pub use springs::Springs;

use crate::assembly::TangentKind;
use crate::body::Body;
use crate::error::FemError;
use skin::SkinFacet;
use springs::SpringFacet;

/// Springs and skins of a body, ready for its solver.
#[derive(Debug, Clone, Default)]
pub(crate) struct SurfaceTerms {
    /// Facets of each set of springs.
    springs: Vec<Vec<SpringFacet>>,
    skin: Vec<SkinFacet>,
}

impl SurfaceTerms {
    /// Check springs and skins against a body.
    ///
    /// # Errors
    ///
    /// [`FemError::NotOnSurface`], [`FemError::BadParameter`].
    pub(crate) fn new(body: &Body, springs: &[Springs], skins: &[Skin]) -> Result<Self, FemError> {
        let springs = springs
            .iter()
            .map(|set| {
                set.check()?;
                let facets = facets_of(body, &set.triangles)?;
                Ok(facets.into_iter().map(|facet| SpringFacet::new(facet, set)).collect())
            })
            .collect::<Result<_, FemError>>()?;
        let mut skin = Vec::new();
        for sheet in skins {
            sheet.check()?;
            let facets = facets_of(body, &sheet.triangles)?;
            skin.extend(facets.into_iter().map(|facet| SkinFacet::new(body, facet, sheet)));
        }
        Ok(Self { springs, skin })
    }

    /// Add the forces of a displacement to `force` and return its energy, µJ; none where a facet
    /// of the skin has lost its area.
    pub(crate) fn add_force(&self, displacement: &[f64], force: &mut [f64]) -> Option<f64> {
        let mut energy = 0.0;
        for facet in self.springs.iter().flatten() {
            energy += facet.add_force(displacement, force);
        }
        for facet in &self.skin {
            energy += facet.add_force(displacement, force)?;
        }
        Some(energy)
    }

    /// Tangent at a displacement (none: at rest) as blocks of the cliques that hold the facets;
    /// none where a facet of the skin has lost its area.
    pub(crate) fn blocks(
        &self,
        displacement: Option<&[f64]>,
        kind: TangentKind,
    ) -> Option<FacetBlocks> {
        let mut blocks = FacetBlocks::default();
        for facet in self.springs.iter().flatten() {
            let matrix = facet.matrix(displacement);
            blocks.add(&facet.facet, |a, b| matrix[a][b]);
        }
        for facet in &self.skin {
            let matrix = facet.matrix(displacement, kind)?;
            blocks.add(&facet.facet, |a, b| matrix[a][b]);
        }
        blocks.sort();
        Some(blocks)
    }

    /// Add the tangent at a displacement times a direction to `product`.
    pub(crate) fn add_product(
        &self,
        displacement: &[f64],
        direction: &[f64],
        product: &mut [f64],
    ) -> bool {
        for facet in self.springs.iter().flatten() {
            facet.facet.add_product(&facet.matrix(Some(displacement)), direction, product);
        }
        for facet in &self.skin {
            let Some(matrix) = facet.matrix(Some(displacement), TangentKind::Exact) else {
                return false;
            };
            facet.facet.add_product(&matrix, direction, product);
        }
        true
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
