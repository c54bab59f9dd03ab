//! Everything that can go wrong, with the numbers and the place.
//!
//! Messages state what must hold, what was found and where. Lengths are in mm, volumes in mm³,
//! forces in mN, stiffness in kPa.

/// How a body, or a loose part of it, can move without deforming.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct RigidModes {
    /// Names such as "translation x", "rotation about y".
    pub modes: Vec<String>,
    /// Number of parts of the mesh that share no node.
    pub n_parts: usize,
    /// Number of nodes of the first free part.
    pub n_part_nodes: usize,
    /// One node of the first free part.
    pub node: usize,
}

impl std::fmt::Display for RigidModes {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        if self.n_parts > 1 {
            write!(
                f,
                "a loose part of {} nodes (node {} is one; the mesh has {} parts that share no node)",
                self.n_part_nodes, self.node, self.n_parts
            )?;
        } else {
            write!(f, "the body of {} nodes", self.n_part_nodes)?;
        }
        write!(
            f,
            " must be held so that it cannot move without deforming; still free: {}",
            self.modes.join(", ")
        )
    }
}

/// The reason why a body could not be made or a solve found no answer.
///
/// [`is_recoverable`](Self::is_recoverable) is true of errors that concern one member of an ensemble
/// alone (its load was too large), and false of errors of the input as such (a wrong length).
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum FemError {
    /// The mesh has no tetrahedra.
    #[error(
        "the mesh must have at least one tetrahedron and four nodes; found {n_tets} tetrahedra and {n_nodes} nodes"
    )]
    EmptyMesh {
        /// Number of nodes given.
        n_nodes: usize,
        /// Number of tetrahedra given.
        n_tets: usize,
    },
    /// A coordinate is NaN or infinite.
    #[error("node coordinates must be finite numbers in mm; node {node} is at ({}, {}, {})", .position[0], .position[1], .position[2])]
    NonFiniteNode {
        /// Index of the node.
        node: usize,
        /// Its position as given, mm.
        position: [f64; 3],
    },
    /// A tetrahedron names a node that does not exist.
    #[error("tetrahedron {tet} names node {node}, but the mesh has {n_nodes} nodes (0 to {})", .n_nodes.saturating_sub(1))]
    NodeOutOfRange {
        /// Index of the tetrahedron.
        tet: usize,
        /// The index that is out of range.
        node: usize,
        /// Number of nodes.
        n_nodes: usize,
    },
    /// A tetrahedron names the same node twice.
    #[error("tetrahedron {tet} names node {node} more than once; its four corners must differ")]
    RepeatedNode {
        /// Index of the tetrahedron.
        tet: usize,
        /// The repeated node.
        node: usize,
    },
    /// A tetrahedron has negative volume: two of its nodes are in the wrong order.
    #[error(
        "tetrahedron {tet} is inverted: its volume is {volume:.6e} mm^3 and must be positive ({n_inverted} of {n_tets} are; swapping two nodes of each turns it round)"
    )]
    InvertedTet {
        /// Index of the first inverted tetrahedron.
        tet: usize,
        /// Its signed volume, mm³.
        volume: f64,
        /// Number of inverted tetrahedra.
        n_inverted: usize,
        /// Number of tetrahedra.
        n_tets: usize,
    },
    /// A tetrahedron is flat: its volume vanishes compared with its edges.
    #[error(
        "tetrahedron {tet} is degenerate: volume {volume:.3e} mm^3 is {relative:.1e} of its longest edge cubed and must be above {limit:.0e}"
    )]
    DegenerateTet {
        /// Index of the tetrahedron.
        tet: usize,
        /// Its signed volume, mm³.
        volume: f64,
        /// Volume over the cube of the longest edge, dimensionless.
        relative: f64,
        /// Smallest admissible value of `relative`.
        limit: f64,
    },
    /// A node belongs to no tetrahedron, so nothing holds it.
    #[error(
        "every node must belong to a tetrahedron; node {node} belongs to none ({n_unused} such nodes)"
    )]
    UnusedNode {
        /// Index of the first such node.
        node: usize,
        /// Number of such nodes.
        n_unused: usize,
    },
    /// Three or more tetrahedra share one triangle: the mesh overlaps itself.
    #[error("the triangle of nodes {} {} {} belongs to {n_tets} tetrahedra; at most two may share one", .triangle[0], .triangle[1], .triangle[2])]
    OverlappingTets {
        /// Corner nodes of the triangle, ascending.
        triangle: [usize; 3],
        /// Number of tetrahedra that own it.
        n_tets: usize,
    },
    /// A held node does not exist.
    #[error("held node {node} does not exist: the mesh has {n_nodes} nodes (0 to {})", .n_nodes.saturating_sub(1))]
    HeldNodeOutOfRange {
        /// The index that is out of range.
        node: usize,
        /// Number of corner nodes.
        n_nodes: usize,
    },
    /// A node is held twice, so that two rows of prescribed displacements would compete.
    #[error("node {node} is listed more than once among the held nodes")]
    HeldNodeRepeated {
        /// The repeated node.
        node: usize,
    },
    /// The body, or a loose part of it, can move without deforming.
    #[error("{0}")]
    Unconstrained(RigidModes),
    /// The stiffness matrix is singular although no part is free to move as a whole.
    #[error(
        "the stiffness matrix at rest is not positive definite (pivot {pivot} of {n_dofs}): a very flat tetrahedron or a stiffness near the end of its range makes it singular"
    )]
    SingularStiffness {
        /// Position of the failing pivot in the elimination order.
        pivot: usize,
        /// Number of unknowns.
        n_dofs: usize,
    },
    /// The system is too large for 32-bit indices or for memory.
    #[error(
        "a system of {n_dofs} unknowns is too large to be factorised: indices or memory do not suffice"
    )]
    TooLarge {
        /// Number of unknowns.
        n_dofs: usize,
    },
    /// Young's modulus is not a positive finite number.
    #[error("Young's modulus must be positive and finite; found {young} kPa at entry {entry}")]
    BadYoung {
        /// Entry of the stiffness field (0 where it is uniform).
        entry: usize,
        /// The value found, kPa.
        young: f64,
    },
    /// Poisson's ratio lies outside (−1, 0.5).
    #[error(
        "Poisson's ratio must lie strictly between -1 and 0.5; found {poisson} at entry {entry}"
    )]
    BadPoisson {
        /// Entry of the stiffness field (0 where it is uniform).
        entry: usize,
        /// The value found, dimensionless.
        poisson: f64,
    },
    /// A parameter of a law is outside its range.
    #[error("`{name}` of the law must be {must}; found {found}")]
    BadLaw {
        /// Name of the parameter.
        name: &'static str,
        /// What must hold.
        must: &'static str,
        /// The value found.
        found: f64,
    },
    /// A fibre direction has no length.
    #[error("`direction` of the fibres must have a finite length above 0; found {} {} {} at entry {entry}", .direction[0], .direction[1], .direction[2])]
    BadFibre {
        /// Entry of the field of directions (0 where it is uniform).
        entry: usize,
        /// The vector found.
        direction: [f64; 3],
    },
    /// An array has the wrong number of rows.
    #[error("{what} must have {expected} rows; found {found}")]
    WrongLength {
        /// What the array holds.
        what: &'static str,
        /// The number of rows it must have.
        expected: usize,
        /// The number of rows it has.
        found: usize,
    },
    /// A load or a displacement is NaN or infinite.
    #[error("{what} must be finite; row {row} is ({}, {}, {})", .values[0], .values[1], .values[2])]
    NonFinite {
        /// What the array holds.
        what: &'static str,
        /// Index of the first row that is not finite.
        row: usize,
        /// The row as given.
        values: [f64; 3],
    },
    /// A loaded triangle is no facet of the body's surface.
    #[error("triangle {row} with nodes {} {} {} is no facet of the body's surface", .triangle[0], .triangle[1], .triangle[2])]
    NotOnSurface {
        /// Row of the triangle.
        row: usize,
        /// Its corner nodes as given.
        triangle: [usize; 3],
    },
    /// A loaded triangle is listed twice, so that its traction would count twice.
    #[error(
        "triangle {row} with nodes {} {} {} is the facet of row {first} again; each facet may be listed once",
        .triangle[0], .triangle[1], .triangle[2]
    )]
    RepeatedFacet {
        /// Row of the second mention.
        row: usize,
        /// Row of the first.
        first: usize,
        /// Its corner nodes as given in `row`.
        triangle: [usize; 3],
    },
    /// A setting is outside its range.
    #[error("setting `{name}` must be {must}; found {found}")]
    BadSetting {
        /// Name of the setting.
        name: &'static str,
        /// What must hold.
        must: &'static str,
        /// The value found.
        found: f64,
    },
    /// A number that describes a material or a rig is outside its range.
    #[error("`{name}` must be {must}; found {found}")]
    BadParameter {
        /// Name of the number.
        name: &'static str,
        /// What must hold.
        must: &'static str,
        /// The value found.
        found: f64,
    },
    /// A time frame lies before the last one.
    #[error("time must not run backwards: the frame at {time_s} s comes after one at {last_s} s")]
    TimeRunsBack {
        /// Time of the frame, s.
        time_s: f64,
        /// Time of the frame before, s.
        last_s: f64,
    },
    /// The supports count on springs that the load does not have.
    #[error(
        "the supports rest on springs on the triangle of nodes {} {} {}, but the load has no such springs there",
        .triangle[0], .triangle[1], .triangle[2]
    )]
    MissingSprings {
        /// Corner nodes of the triangle.
        triangle: [usize; 3],
    },
    /// No unloaded shape was found.
    #[error(
        "no unloaded shape was found in {iterations} iterations: the loaded one is off by {distance:.3e} mm, tolerance {tolerance:.0e} mm; {}",
        .cause.as_ref().map_or_else(|| "a smaller weight or a stiffer material may have one".to_owned(), |e| e.to_string())
    )]
    NoRestShape {
        /// Iterations done.
        iterations: usize,
        /// Largest distance of a loaded node from where it should be, mm.
        distance: f64,
        /// Requested distance, mm.
        tolerance: f64,
        /// What stopped the search, where it was an error.
        cause: Option<Box<FemError>>,
    },
    /// A displacement given, to start from or to examine, turns a tetrahedron inside out.
    #[error("the displacement given inverts tetrahedron {tet}: det F = {det_f:.3e}")]
    InvertedStart {
        /// Index of the worst tetrahedron.
        tet: usize,
        /// Its smallest det F, dimensionless.
        det_f: f64,
    },
    /// Derivatives were requested at a displacement that is not an equilibrium.
    #[error(
        "derivatives need an equilibrium: the residual of this displacement is {residual:.3e} mN and must be at most {limit:.3e} mN; solve with a smaller tolerance, and with this material and load"
    )]
    NotInEquilibrium {
        /// Norm of the unbalanced forces on free unknowns, mN.
        residual: f64,
        /// Largest admissible norm, mN.
        limit: f64,
    },
    /// The tangent at an equilibrium is singular or indefinite, so that its derivatives do not
    /// exist or mean nothing.
    #[error(
        "the tangent at this equilibrium is not positive definite (pivot {pivot} of {n_dofs}): it is a limit point, or unstable, and has no derivatives"
    )]
    NotStable {
        /// Position of the failing pivot in the elimination order.
        pivot: usize,
        /// Number of unknowns.
        n_dofs: usize,
    },
    /// A derivative by something that the model does not have.
    #[error("there is no derivative by {what}: the model has none")]
    NoSuchCause {
        /// Requested value.
        what: String,
    },
    /// An observation weighs a node that does not exist, or the reaction of one that is not held.
    #[error("an observation weighs {what} of node {node}, which {why}")]
    BadObservation {
        /// The quantity weighed.
        what: &'static str,
        /// Index of the node.
        node: usize,
        /// What is wrong with it.
        why: &'static str,
    },
    /// No state with vanishing residual was found.
    #[error("{0}")]
    NoEquilibrium(Box<NoEquilibrium>),
    /// The caller raised the cancel flag.
    #[error("the solve was cancelled by the caller")]
    Cancelled,
}

impl FemError {
    /// Return whether an ensemble may drop this member and continue.
    ///
    /// True for what depends on how far one member is loaded, false for wrong input and for a
    /// cancelled solve.
    ///
    /// # Examples
    ///
    /// ```
    /// use tissuereg_fem::FemError;
    ///
    /// assert!(!FemError::Cancelled.is_recoverable());
    /// assert!(FemError::InvertedStart { tet: 3, det_f: -0.1 }.is_recoverable());
    /// ```
    pub fn is_recoverable(&self) -> bool {
        matches!(
            self,
            Self::NoEquilibrium(_) | Self::InvertedStart { .. } | Self::NoRestShape { .. }
        )
    }

    /// Return what the error is about.
    pub fn class(&self) -> ErrorClass {
        match self {
            Self::EmptyMesh { .. }
            | Self::NonFiniteNode { .. }
            | Self::NodeOutOfRange { .. }
            | Self::RepeatedNode { .. }
            | Self::InvertedTet { .. }
            | Self::DegenerateTet { .. }
            | Self::UnusedNode { .. }
            | Self::OverlappingTets { .. }
            | Self::SingularStiffness { .. }
            | Self::TooLarge { .. } => ErrorClass::Mesh,
            Self::HeldNodeOutOfRange { .. }
            | Self::HeldNodeRepeated { .. }
            | Self::Unconstrained(_)
            | Self::MissingSprings { .. } => ErrorClass::Support,
            Self::BadYoung { .. }
            | Self::BadPoisson { .. }
            | Self::BadLaw { .. }
            | Self::BadFibre { .. }
            | Self::BadParameter { .. }
            | Self::NoSuchCause { .. } => ErrorClass::Material,
            Self::NonFinite { .. }
            | Self::NotOnSurface { .. }
            | Self::RepeatedFacet { .. }
            | Self::TimeRunsBack { .. }
            | Self::BadObservation { .. }
            | Self::InvertedStart { .. } => ErrorClass::Load,
            Self::WrongLength { .. } => ErrorClass::Shape,
            Self::BadSetting { .. } => ErrorClass::Setting,
            Self::NoRestShape { .. }
            | Self::NotInEquilibrium { .. }
            | Self::NotStable { .. }
            | Self::NoEquilibrium(_) => ErrorClass::Convergence,
            Self::Cancelled => ErrorClass::Cancelled,
        }
    }

    /// Return where the error is, in words such as "tet 7" or "held node 3"; none where it concerns the
    /// whole input.
    pub fn place(&self) -> Option<String> {
        Some(match self {
            Self::NonFiniteNode { node, .. } | Self::UnusedNode { node, .. } => {
                format!("node {node}")
            }
            Self::NodeOutOfRange { tet, .. }
            | Self::RepeatedNode { tet, .. }
            | Self::InvertedTet { tet, .. }
            | Self::DegenerateTet { tet, .. } => format!("tet {tet}"),
            Self::OverlappingTets { triangle: [a, b, c], .. }
            | Self::MissingSprings { triangle: [a, b, c] } => format!("triangle {a} {b} {c}"),
            Self::HeldNodeOutOfRange { node, .. } | Self::HeldNodeRepeated { node } => {
                format!("held node {node}")
            }
            Self::Unconstrained(rigid) => format!("node {}", rigid.node),
            Self::BadYoung { entry, .. } => format!("young, entry {entry}"),
            Self::BadPoisson { entry, .. } => format!("poisson, entry {entry}"),
            Self::BadFibre { entry, .. } => format!("direction, entry {entry}"),
            Self::BadLaw { name, .. }
            | Self::BadSetting { name, .. }
            | Self::BadParameter { name, .. } => (*name).to_owned(),
            Self::WrongLength { what, .. } => (*what).to_owned(),
            Self::NonFinite { what, row, .. } => format!("{what}, row {row}"),
            Self::NotOnSurface { row, .. } | Self::RepeatedFacet { row, .. } => {
                format!("triangle {row}")
            }
            Self::TimeRunsBack { time_s, .. } => format!("time {time_s} s"),
            Self::NoSuchCause { what } => what.clone(),
            Self::BadObservation { what, node, .. } => format!("{what}, node {node}"),
            Self::InvertedStart { tet, .. } => format!("start, tet {tet}"),
            Self::NoEquilibrium(failure) => format!("tet {}", failure.worst_tets.first()?.tet),
            Self::EmptyMesh { .. }
            | Self::SingularStiffness { .. }
            | Self::TooLarge { .. }
            | Self::NoRestShape { .. }
            | Self::NotInEquilibrium { .. }
            | Self::NotStable { .. }
            | Self::Cancelled => return None,
        })
    }
}

/// What an error is about. The list is complete: every [`FemError`] has one of these.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum ErrorClass {
    /// Nodes and tetrahedra, or the matrix made from them.
    Mesh,
    /// What holds the body.
    Support,
    /// Laws, moduli, behaviours, and what derivatives are taken by.
    Material,
    /// Loads, and other fields over a body.
    Load,
    /// The length of a list.
    Shape,
    /// A setting of the solver.
    Setting,
    /// A search that found no answer, or a state that is none.
    Convergence,
    /// The caller's wish.
    Cancelled,
}

/// Why an equilibrium search ended, and the last good state.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error(
    "no equilibrium at load fraction {tried_fraction:.4} after {iterations} iterations and \
     {factorisations} factorisations{}; the last \
     equilibrium found is at load fraction {load_fraction:.4}; {reason}; smallest det F = \
     {min_det_f:.3e}, worst tetrahedra {}; {}",
    residual_clause(*.residual, *.tolerance), worst_list(.worst_tets), .reason.suggestion()
)]
#[non_exhaustive]
pub struct NoEquilibrium {
    /// Largest fraction of the load for which an equilibrium was found.
    pub load_fraction: f64,
    /// Displacement of every node in that equilibrium, mm: a start for a search under less load.
    pub displacement: Vec<[f64; 3]>,
    /// The fraction at which the search ended.
    pub tried_fraction: f64,
    /// Iterations done in all.
    pub iterations: usize,
    /// Numeric factors made in all.
    pub factorisations: usize,
    /// Norm of the residual forces at the end, mN; 0 where supports could not be moved, so that
    /// no forces were balanced.
    pub residual: f64,
    /// Required norm, mN; 0 in the same case.
    pub tolerance: f64,
    /// Smallest det F of the state where the search ended, dimensionless.
    pub min_det_f: f64,
    /// Up to five tetrahedra with the smallest det F, worst first.
    pub worst_tets: Vec<WorstTet>,
    /// What stopped the search.
    pub reason: StopReason,
}

/// A tetrahedron close to inversion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WorstTet {
    /// Index of the tetrahedron.
    pub tet: usize,
    /// Smallest det F of its quadrature points, dimensionless.
    pub det_f: f64,
}

/// What stopped an equilibrium search.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum StopReason {
    /// The iterations allowed were used up, or factorisations took the time of as many.
    IterationsUsedUp,
    /// Load steps became smaller than the smallest allowed.
    StepTooSmall,
    /// A prescribed displacement would invert a tetrahedron.
    PrescribedInverts,
    /// The residual stopped falling before the tolerance was reached.
    Stalled,
}

impl std::fmt::Display for StopReason {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::IterationsUsedUp => {
                "the iterations allowed, or their time in factorisations, were used up"
            }
            Self::StepTooSmall => "load steps became too small",
            Self::PrescribedInverts => "the prescribed displacements would invert a tetrahedron",
            Self::Stalled => "the residual stopped falling",
        })
    }
}

impl StopReason {
    /// Return what a user may do about it, one clause.
    pub fn suggestion(self) -> &'static str {
        match self {
            Self::IterationsUsedUp => "allow more iterations or a smaller load",
            Self::StepTooSmall => {
                "reduce the load, spread it over a larger patch or check its unit (mN)"
            }
            Self::PrescribedInverts => {
                "reduce the prescribed displacements or check their unit (mm)"
            }
            Self::Stalled => {
                "set a tolerance above the rounding of these forces, or check their unit (mN)"
            }
        }
    }
}

fn residual_clause(residual: f64, tolerance: f64) -> String {
    if tolerance == 0.0 {
        return String::new();
    }
    format!(": residual {residual:.3e} mN, tolerance {tolerance:.3e} mN")
}

fn worst_list(worst: &[WorstTet]) -> String {
    if worst.is_empty() {
        return "unknown".to_string();
    }
    let entries: Vec<String> =
        worst.iter().map(|w| format!("{} ({:.2e})", w.tet, w.det_f)).collect();
    entries.join(", ")
}
