//! A body: mesh, element type and supports, with everything that is made once from them.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, OnceLock};
use std::time::Instant;

use crate::assembly::NodalGradients;
use crate::element::{Element, Geometry, edges_of};
use crate::error::FemError;
use crate::material::Shape;
use crate::mesh::{FacetOwners, Mesh, ascending, facet_owners};
use crate::rigid::check_rigid_modes;
use crate::supports::Supports;
use crate::system::factor::Factor;
use crate::system::pattern::Pattern;
use crate::system::{FactorSize, PlainOrder};

/// A supported mesh with its element data, elimination order and symbolic factor.
///
/// Made once, used by any number of solves, from any number of threads. Material and load come
/// with each solve. The factor of the undeformed stiffness made last is kept (one factor; its
/// memory is that of the numbers in it), so that a next solve with a proportional stiffness
/// starts warm; results do not depend on it.
///
/// # Nodes
///
/// Corner nodes first, with the mesh's indices; for [`Element::Tet10`] one node in the middle of
/// every edge follows. A mid-edge node is held where its edge lies on the surface and both ends
/// are held (axis by axis).
///
/// # Cost
///
/// On 4,000 nodes about 20 ms, on 20,000 about 170 ms.
///
/// # Examples
///
/// ```
/// use tissuereg_fem::{Body, Element, Mesh};
///
/// let nodes = vec![[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 10.0, 0.0], [0.0, 0.0, 10.0]];
/// let mesh = Mesh::new(nodes, vec![[0, 1, 2, 3]])?;
/// let body = Body::new(mesh, Element::Tet10, [0, 1, 2])?;
/// assert_eq!((body.n_corner_nodes(), body.n_nodes()), (4, 10));
/// # Ok::<(), tissuereg_fem::FemError>(())
/// ```
#[derive(Debug)]
pub struct Body {
    shape: Arc<ShapeOfBody>,
    supports: Supports,
    held: Vec<[bool; 3]>,
    pattern: Arc<Pattern>,
    plain_order: OnceLock<Result<PlainOrder, FemError>>,
    /// The factor made last, and of what.
    kept: Mutex<Option<(Shape, Arc<Factor>)>>,
    analyse_seconds: f64,
}

impl Body {
    /// Analyse a mesh with elements of one type and the given supports.
    ///
    /// # Errors
    ///
    /// [`FemError::HeldNodeOutOfRange`], [`FemError::HeldNodeRepeated`],
    /// [`FemError::Unconstrained`] with the rigid modes left free, by name, and
    /// [`FemError::TooLarge`].
    pub fn new(
        mesh: Mesh,
        element: Element,
        supports: impl Into<Supports>,
    ) -> Result<Self, FemError> {
        let start = Instant::now();
        let edges = match element {
            Element::Tet4 | Element::Tet4Averaged => Vec::new(),
            Element::Tet10 => edges_of(&mesh),
        };
        let n_nodes = mesh.n_nodes() + edges.len();
        if n_nodes.max(element.n_nodes() * mesh.n_tets()) > (u32::MAX / 4) as usize {
            return Err(FemError::TooLarge { n_dofs: 3 * n_nodes });
        }
        let (geometry, nodes) = Geometry::new(&mesh, element, &edges);
        let shape = ShapeOfBody::new(mesh, nodes, edges, geometry);
        Self::supported(shape, supports.into(), start)
    }

    /// The same body with other supports; mesh and element data are shared, the elimination order
    /// is made anew. A history can continue from one to the other.
    ///
    /// # Errors
    ///
    /// As [`Body::new`].
    ///
    /// # Examples
    ///
    /// ```
    /// use tissuereg_fem::{Body, Element, Mesh};
    ///
    /// let nodes = vec![[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 10.0, 0.0], [0.0, 0.0, 10.0]];
    /// let body = Body::new(Mesh::new(nodes, vec![[0, 1, 2, 3]])?, Element::Tet4, [0, 1, 2])?;
    /// let pushed = body.with_supports([0, 1, 2, 3])?;
    /// assert_eq!((body.n_unknowns(), pushed.n_unknowns()), (3, 0));
    /// # Ok::<(), tissuereg_fem::FemError>(())
    /// ```
    pub fn with_supports(&self, supports: impl Into<Supports>) -> Result<Self, FemError> {
        Self::supported(Arc::clone(&self.shape), supports.into(), Instant::now())
    }

    /// The same body with its corner nodes undeformed at other places; supports, elimination order
    /// and symbolic factor are shared.
    ///
    /// # Errors
    ///
    /// As [`Mesh::moved_to`].
    pub fn moved_to(&self, nodes: Vec<[f64; 3]>) -> Result<Self, FemError> {
        let start = Instant::now();
        let mesh = self.mesh().moved_to(nodes)?;
        let edges = self.shape.edges.clone();
        let (geometry, nodes) = Geometry::new(&mesh, self.element(), &edges);
        Ok(Self {
            shape: ShapeOfBody::new(mesh, nodes, edges, geometry),
            supports: self.supports.clone(),
            held: self.held.clone(),
            pattern: Arc::clone(&self.pattern),
            plain_order: OnceLock::new(),
            kept: Mutex::default(),
            analyse_seconds: start.elapsed().as_secs_f64(),
        })
    }

    fn supported(
        shape: Arc<ShapeOfBody>,
        supports: Supports,
        start: Instant,
    ) -> Result<Self, FemError> {
        let ShapeOfBody { mesh, nodes, edges, geometry, .. } = &*shape;
        let held_corners = supports.axes_by_node(mesh.n_nodes())?;
        check_resting(mesh, &supports)?;
        check_rigid_modes(mesh, &held_corners, supports.resting())?;
        let held = with_mid_edges(mesh, edges, held_corners);
        let pattern = Arc::new(Pattern::new(nodes, geometry.cliques(), &held)?);
        Ok(Self {
            shape,
            supports,
            held,
            pattern,
            plain_order: OnceLock::new(),
            kept: Mutex::default(),
            analyse_seconds: start.elapsed().as_secs_f64(),
        })
    }

    /// The mesh of corner nodes.
    pub fn mesh(&self) -> &Mesh {
        &self.shape.mesh
    }

    /// Element type.
    pub fn element(&self) -> Element {
        self.shape.geometry.element
    }

    /// Undeformed positions of all nodes, mm.
    pub fn nodes(&self) -> &[[f64; 3]] {
        &self.shape.nodes
    }

    /// Number of nodes, mid-edge nodes included.
    pub fn n_nodes(&self) -> usize {
        self.shape.nodes.len()
    }

    /// Number of nodes of the mesh.
    pub fn n_corner_nodes(&self) -> usize {
        self.shape.mesh.n_nodes()
    }

    /// Number of tetrahedra.
    pub fn n_tets(&self) -> usize {
        self.shape.mesh.n_tets()
    }

    /// Held nodes as they were given.
    pub fn held_nodes(&self) -> &[usize] {
        self.supports.nodes()
    }

    /// Supports as they were given.
    pub fn supports(&self) -> &Supports {
        &self.supports
    }

    /// Number of unknown displacement components.
    pub fn n_unknowns(&self) -> usize {
        self.pattern.n_unknowns()
    }

    /// How large the factor of its stiffness is and what making it costs; no factor is made.
    pub fn factor_size(&self) -> FactorSize {
        self.pattern.fronts.size()
    }

    /// Corners of the edge whose middle is each node after the corner nodes; empty for
    /// elements of four nodes.
    pub fn mid_edges(&self) -> &[[usize; 2]] {
        &self.shape.edges
    }

    /// Seconds spent in [`Body::new`].
    pub fn analyse_seconds(&self) -> f64 {
        self.analyse_seconds
    }

    pub(crate) fn geometry(&self) -> &Geometry {
        &self.shape.geometry
    }

    /// Mean displacement gradients at the nodes; computed at first use.
    pub(crate) fn nodal_gradients(&self) -> &NodalGradients {
        self.shape.gradients.get_or_init(|| NodalGradients::new(self.geometry()))
    }

    /// Volume that counts for each node: its nodal force under a body force of one, mm³.
    pub(crate) fn volume_weights(&self) -> Vec<f64> {
        let mut weights = vec![0.0; self.n_nodes()];
        for element in 0..self.geometry().n_elements() {
            for (node, weight) in self.geometry().volume_weights(element) {
                weights[node] += weight;
            }
        }
        weights
    }

    pub(crate) fn pattern(&self) -> &Pattern {
        &self.pattern
    }

    /// Order of plain linear tets on the unknowns of a body of [`Element::Tet4Averaged`], made when
    /// first needed.
    ///
    /// # Errors
    ///
    /// [`FemError::TooLarge`].
    pub(crate) fn plain_order(&self) -> Result<&PlainOrder, FemError> {
        let make = || {
            let elements = self.geometry().elements();
            PlainOrder::new(self.nodes(), elements, &self.held, &self.pattern)
        };
        self.plain_order.get_or_init(make).as_ref().map_err(FemError::clone)
    }

    /// Owners of the surface's triangles, found at first use.
    pub(crate) fn facet_owners(&self) -> &FacetOwners {
        self.shape.facet_owners.get_or_init(|| facet_owners(self.mesh()))
    }

    /// The factor that [`Body::keep_factor`] was given last, if it is that of this shape.
    pub(crate) fn kept_factor(&self, shape: &Shape) -> Option<Arc<Factor>> {
        let slot = self.kept.lock().ok()?;
        slot.as_ref().filter(|(kept, _)| kept == shape).map(|(_, factor)| Arc::clone(factor))
    }

    /// Keep the factor of the undeformed stiffness of a shape in place of the one before.
    pub(crate) fn keep_factor(&self, shape: Shape, factor: &Arc<Factor>) {
        if let Ok(mut slot) = self.kept.lock() {
            *slot = Some((shape, Arc::clone(factor)));
        }
    }

    /// Held axes of all nodes.
    pub(crate) fn held(&self) -> &[[bool; 3]] {
        &self.held
    }

    /// Displacement of all nodes, flat, that is `rows` at held nodes and zero where free.
    /// A held mid-edge node moves by the mean of its ends.
    pub(crate) fn held_displacement(&self, rows: &[[f64; 3]]) -> Vec<f64> {
        let mut all = vec![0.0; 3 * self.n_nodes()];
        for (&node, row) in self.held_nodes().iter().zip(rows) {
            all[3 * node..3 * node + 3].copy_from_slice(row);
        }
        for (e, &[a, b]) in self.shape.edges.iter().enumerate() {
            for i in 0..3 {
                all[3 * (self.n_corner_nodes() + e) + i] = 0.5 * (all[3 * a + i] + all[3 * b + i]);
            }
        }
        for (value, held) in all.iter_mut().zip(self.held.as_flattened()) {
            if !held {
                *value = 0.0;
            }
        }
        all
    }

    /// Reactions of held nodes from the unbalanced forces of all nodes; a held mid-edge node
    /// passes half of its own to each end, which keeps resultant and moment.
    pub(crate) fn reactions(&self, unbalanced: &[f64]) -> Vec<[f64; 3]> {
        let mut at_corner = BTreeMap::new();
        for &node in self.held_nodes() {
            at_corner.insert(node, self.held_part(node, unbalanced));
        }
        for (e, ends) in self.shape.edges.iter().enumerate() {
            let part = self.held_part(self.n_corner_nodes() + e, unbalanced);
            for end in ends {
                if let Some(sum) = at_corner.get_mut(end) {
                    for i in 0..3 {
                        sum[i] += 0.5 * part[i];
                    }
                }
            }
        }
        self.held_nodes().iter().map(|n| at_corner.get(n).copied().unwrap_or_default()).collect()
    }

    /// Whose forces [`Body::reactions`] adds up: place of the held node, node and share.
    pub(crate) fn reaction_parts(&self) -> Vec<(usize, usize, f64)> {
        let mut parts: Vec<(usize, usize, f64)> =
            self.held_nodes().iter().enumerate().map(|(place, &node)| (place, node, 1.0)).collect();
        let places: BTreeMap<usize, usize> =
            parts.iter().map(|&(place, node, _)| (node, place)).collect();
        for (e, ends) in self.shape.edges.iter().enumerate() {
            let middle = self.n_corner_nodes() + e;
            if self.held[middle].contains(&true) {
                let own = ends.iter().filter_map(|end| places.get(end));
                parts.extend(own.map(|&place| (place, middle, 0.5)));
            }
        }
        parts
    }

    fn held_part(&self, node: usize, values: &[f64]) -> [f64; 3] {
        std::array::from_fn(|i| if self.held[node][i] { values[3 * node + i] } else { 0.0 })
    }
}

/// The part of a body that does not depend on its supports.
#[derive(Debug)]
struct ShapeOfBody {
    mesh: Mesh,
    nodes: Vec<[f64; 3]>,
    edges: Vec<[usize; 2]>,
    geometry: Geometry,
    /// Computed at first use.
    gradients: OnceLock<NodalGradients>,
    /// The same.
    facet_owners: OnceLock<FacetOwners>,
}

impl ShapeOfBody {
    fn new(
        mesh: Mesh,
        nodes: Vec<[f64; 3]>,
        edges: Vec<[usize; 2]>,
        geometry: Geometry,
    ) -> Arc<Self> {
        Arc::new(Self {
            mesh,
            nodes,
            edges,
            geometry,
            gradients: OnceLock::new(),
            facet_owners: OnceLock::new(),
        })
    }
}

/// Check that what rests on springs lies on the surface.
fn check_resting(mesh: &Mesh, supports: &Supports) -> Result<(), FemError> {
    if supports.resting().is_empty() {
        return Ok(());
    }
    let surface: BTreeSet<[usize; 3]> =
        mesh.surface_triangles().iter().map(|&t| ascending(t)).collect();
    for (row, resting) in supports.resting().iter().enumerate() {
        if !surface.contains(&ascending(resting.triangle)) {
            return Err(FemError::NotOnSurface { row, triangle: resting.triangle });
        }
    }
    Ok(())
}

/// Held axes of corner nodes, followed by those of mid-edge nodes.
fn with_mid_edges(mesh: &Mesh, edges: &[[usize; 2]], mut held: Vec<[bool; 3]>) -> Vec<[bool; 3]> {
    let mut on_surface = vec![false; edges.len()];
    for triangle in mesh.surface_triangles() {
        for k in 0..3 {
            let (a, b) = (triangle[k], triangle[(k + 1) % 3]);
            let edge = edges.partition_point(|e| *e < [a.min(b), a.max(b)]);
            if let Some(mark) = on_surface.get_mut(edge) {
                *mark = true;
            }
        }
    }
    for (&[a, b], on_surface) in edges.iter().zip(on_surface) {
        held.push(std::array::from_fn(|i| on_surface && held[a][i] && held[b][i]));
    }
    held
}
