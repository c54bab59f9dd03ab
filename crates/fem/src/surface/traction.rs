//! Tractions on facets of the surface as nodal forces.

use std::collections::BTreeMap;

use super::facet::{facets_of, minus};
use crate::body::Body;
use crate::check::{check_finite, check_length};
use crate::element::{Element, cross};
use crate::error::FemError;
use crate::mesh::ascending;

impl Body {
    /// Consistent nodal forces (mN) of dead tractions on facets of the surface.
    ///
    /// A constant traction `t` on a facet of undeformed area `A` gives `t A / 3` to each corner of
    /// a four-node element's facet, and to each mid-edge node of a ten-node element's.
    ///
    /// # Shapes
    ///
    /// `triangles` one row of three corner nodes a facet, in any order; `traction` one row a
    /// facet, kPa; the result one row per node of the body.
    ///
    /// # Errors
    ///
    /// [`FemError::WrongLength`], [`FemError::NonFinite`], [`FemError::NotOnSurface`],
    /// [`FemError::RepeatedFacet`].
    ///
    /// # Examples
    ///
    /// ```
    /// use tissuereg_fem::{Body, Element, Mesh};
    ///
    /// let nodes = vec![[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 10.0, 0.0], [0.0, 0.0, 10.0]];
    /// let body = Body::new(Mesh::new(nodes, vec![[0, 1, 2, 3]])?, Element::Tet4, [0, 1, 2])?;
    /// let forces = body.traction_forces(&[[0, 1, 3]], &[[0.0, 3.0, 0.0]])?;
    /// assert_eq!(forces[3], [0.0, 50.0, 0.0]);
    /// # Ok::<(), tissuereg_fem::FemError>(())
    /// ```
    pub fn traction_forces(
        &self,
        triangles: &[[usize; 3]],
        traction: &[[f64; 3]],
    ) -> Result<Vec<[f64; 3]>, FemError> {
        check_length("traction (one row a triangle)", triangles.len(), traction.len())?;
        check_finite("traction", traction)?;
        // Facets of the surface with the row that loads them.
        let mut surface: BTreeMap<[usize; 3], Option<usize>> =
            self.mesh().surface_triangles().iter().map(|&t| (ascending(t), None)).collect();
        let mut forces = vec![[0.0; 3]; self.n_nodes()];
        for (row, (&triangle, t)) in triangles.iter().zip(traction).enumerate() {
            let Some(loaded_by) = surface.get_mut(&ascending(triangle)) else {
                return Err(FemError::NotOnSurface { row, triangle });
            };
            if let Some(first) = loaded_by.replace(row) {
                return Err(FemError::RepeatedFacet { row, first, triangle });
            }
            let third = area(triangle.map(|n| self.nodes()[n])) / 3.0;
            for node in self.facet_carriers(triangle) {
                for i in 0..3 {
                    forces[node][i] += third * t[i];
                }
            }
        }
        Ok(forces)
    }

    /// Consistent nodal forces (mN) of a dead pressure (kPa) on facets of the surface: a traction
    /// against the outward normal of the undeformed facet.
    ///
    /// # Shapes
    ///
    /// As [`Body::traction_forces`]; `pressure` one entry a facet.
    ///
    /// # Errors
    ///
    /// As [`Body::traction_forces`].
    ///
    /// # Examples
    ///
    /// ```
    /// use tissuereg_fem::{Body, Element, Mesh};
    ///
    /// let nodes = vec![[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 10.0, 0.0], [0.0, 0.0, 10.0]];
    /// let body = Body::new(Mesh::new(nodes, vec![[0, 1, 2, 3]])?, Element::Tet4, [0, 1, 2])?;
    /// // The facet in the plane y = 0; its outward normal is −y.
    /// let forces = body.pressure_forces(&[[0, 1, 3]], &[3.0])?;
    /// assert!((forces[3][1] - 50.0).abs() < 1e-12);
    /// # Ok::<(), tissuereg_fem::FemError>(())
    /// ```
    pub fn pressure_forces(
        &self,
        triangles: &[[usize; 3]],
        pressure: &[f64],
    ) -> Result<Vec<[f64; 3]>, FemError> {
        check_length("pressure (one entry a triangle)", triangles.len(), pressure.len())?;
        let facets = facets_of(self, triangles)?;
        let traction: Vec<[f64; 3]> =
            facets.iter().zip(pressure).map(|(f, p)| f.normal.map(|n| -p * n)).collect();
        self.traction_forces(triangles, &traction)
    }

    /// Nodes of a facet that carry a constant traction in equal parts.
    fn facet_carriers(&self, [a, b, c]: [usize; 3]) -> [usize; 3] {
        match self.element() {
            Element::Tet4 | Element::Tet4Averaged => [a, b, c],
            Element::Tet10 => [[a, b], [b, c], [a, c]].map(|[p, q]| {
                let edge = [p.min(q), p.max(q)];
                self.n_corner_nodes() + self.mid_edges().partition_point(|e| *e < edge)
            }),
        }
    }
}

fn area([a, b, c]: [[f64; 3]; 3]) -> f64 {
    let twice = cross(minus(b, a), minus(c, a));
    0.5 * twice.iter().map(|c| c * c).sum::<f64>().sqrt()
}
