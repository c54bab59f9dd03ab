"""The experiment format as declarations: tables and keys of ``experiment.toml``, columns of its comma-separated tables.

`tissuereg.io.experiments` and `tissuereg.io.material_experiments` read files by them; ``docs/experiment.md`` lists
them.
"""

from dataclasses import dataclass

from tissuereg.body.material import GRAVITY_MM_PER_S2, LAWS, VOLUMETRIC
from tissuereg.experiment.material_experiment import HELD_OUT
from tissuereg.io.declared import (
    Declaration,
    Key,
    a_belief,
    a_flag,
    a_node_rule,
    a_number,
    a_text,
    a_vector,
)
from tissuereg.io.node_rules import TOLERANCE
from tissuereg.io.toml import Table

#: Words of ``[simulated]``.
MODELS, ELEMENTS = ("fine", "plain"), ("tet4", "tet4-averaged", "tet10")

_EDGE = a_number(
    "edge_std_mm",
    "standard deviation of where the edge of the patch lies",
    None,
    positive=True,
    otherwise="a share of the patch's size",
)

TOP = Declaration(
    "",
    "Keys above the first table.",
    (
        a_text("kind", "what was measured", "rig", among=("rig", "material-test")),
        a_text("name", "title of the experiment", None, otherwise="the name of the folder"),
        a_text(
            "tables",
            "folder of the comma-separated tables, seen from this file",
            None,
            otherwise="the file's own folder",
        ),
    ),
)

MESH = Declaration(
    "[mesh]",
    "The body in its reference shape.",
    (
        a_text("file", "mesh of tetrahedra in mm (.vtu, .vtk, .msh, .npz), seen from this file", words="path"),
        a_number(
            "surface_std_mm",
            "standard deviation of the distance between the body's surface and the mesh's, along the normal; "
            "0.5 to 1 after segmentation",
            None,
            positive=True,
            otherwise="0",
        ),
        a_number(
            "surface_length_mm",
            "length over which that distance is correlated",
            None,
            positive=True,
            otherwise="not stated",
        ),
    ),
    needed=True,
)

MATERIAL = Declaration(
    "[material]",
    "The believed material of the body. Moduli are those at small strain, whatever the law.",
    (
        a_text("law", "strain energy", "neo-hookean", among=LAWS),
        a_belief("young_kpa", "Young's modulus; with a standard deviation it is a prior of `diagnose`"),
        a_belief("poisson", "Poisson's ratio, more than -1 and less than 0.5; likewise"),
        a_number("density_g_per_cm3", "mass density; counts under gravity", 1.0, positive=True),
        a_text("volumetric", "energy of volume change", "log", among=VOLUMETRIC),
    ),
    needed=True,
)

GRAVITY = Declaration(
    "[gravity]",
    "The body's own weight; leave the table out where it does not act.",
    (
        a_vector("direction", "where it points; only the direction counts", unit="", directed=True),
        a_flag("in_reference", "whether the mesh already hangs in it"),
        a_number("g_mm_per_s2", "its acceleration", GRAVITY_MM_PER_S2, positive=True),
    ),
)

BOUNDARY = Declaration(
    "[[boundary]]",
    "A patch that is held; one table per patch. Without any, the mesh's node set `fixed` is held.",
    (
        a_text("name", "of the patch"),
        a_node_rule("nodes", "which nodes it is"),
        a_text("kind", "how it is held", "fixed", among=("fixed",)),
        _EDGE,
    ),
)

ACTUATOR = Declaration(
    "[[actuator]]",
    "A patch that is moved or pulled; one table per patch. In a case without rows for it its patch is free.",
    (
        a_text("name", "of the patch, not `fixed`"),
        a_node_rule("nodes", "which nodes it is"),
        a_text(
            "kind",
            "what is prescribed: its displacement (actuators.csv) or its force (forces_applied.csv)",
            among=("displacement", "force"),
        ),
        a_text("contact", "how it holds the body", "bonded", among=("bonded",)),
        _EDGE,
    ),
)


def _reference(table: Table) -> Table | None:
    return table.table("reference")


MARKERS = Declaration(
    "[markers]",
    "The tracked markers on the surface.",
    (
        a_number("std_mm", "standard deviation of a measured coordinate", positive=True),
        Key(
            "reference",
            "table: name = [x, y, z]",
            "place of each marker on the body in the reference shape, unless `reference_time_s` is given",
            None,
            _reference,
            "mm",
            "`reference_time_s` must be given",
        ),
        a_number(
            "reference_time_s",
            "time of a frame in markers.csv that shows the markers on the body in the reference shape",
            None,
            otherwise="`reference` must be given",
        ),
        a_text("rest_case", "case without load, for the noise model", None, otherwise="none"),
        a_number(
            "trial_share",
            "standard deviation of the difference between two trials of one case, as a share of the markers' motion",
            None,
            positive=True,
            otherwise="0",
        ),
    ),
    needed=True,
)

FORCES = Declaration(
    "[forces]",
    "Noise of forces.csv; the two come together.",
    (a_number("std_mN", "standard deviation of a measured force component", positive=True),),
)

TARGET = Declaration(
    "[[target]]",
    "An inner point of the body; one table per point.",
    (
        a_text("name", "of the point"),
        a_vector("reference", "its place in the reference shape", unit="mm"),
    ),
)

SIMULATED = Declaration(
    "[simulated]",
    "Written by `simulate`: the model that made the data, so that `diagnose` compares with the same one. Experiments "
    "that were measured do not have it.",
    (
        a_text("model", "the fine model, or the mesh as it is", among=MODELS),
        a_text("element", "its elements", among=ELEMENTS),
    ),
)

TEST = Declaration(
    "[test]",
    "How a material test is judged.",
    (
        a_text(
            "hold_out", "what the proof of a finding leaves out", None, among=HELD_OUT, otherwise="chosen by the data"
        ),
        a_number("std_kpa", "standard deviation of a measured stress", None, positive=True, otherwise="estimated"),
    ),
)

#: Tables of a rig's ``experiment.toml`` in the order of the page; ``[[effect]]`` follows.
RIG = (TOP, MESH, MATERIAL, GRAVITY, BOUNDARY, ACTUATOR, MARKERS, FORCES, TARGET, SIMULATED)

#: Forms of a rule for nodes: text, table, meaning.
NODE_FORMS = (
    ('"base"', '"base"', "the node set of that name in the mesh"),
    (
        '"plane nx ny nz d tol"',
        "{ plane = [nx, ny, nz, d], tolerance_mm = tol }",
        "all nodes within `tol` mm of the plane n . x = d, n brought to length 1, d in mm; "
        f"`tol` is {TOLERANCE:g} where it is left out",
    ),
    ('"ball x y z r"', "{ centre_mm = [x, y, z], radius_mm = r }", "the nodes of the surface within r mm of the point"),
)


@dataclass(frozen=True)
class CsvTable:
    """One comma-separated table of an experiment folder.

    Attributes
    ----------
    file : str
        Its name.
    who : str
        Name of the third column: marker, actuator or target.
    unit : str
        Unit of the three numbers.
    meaning : str
        What a row holds.
    presence : str
        When the file must be there.
    """

    file: str
    who: str
    unit: str
    meaning: str
    presence: str

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns."""
        return ("case", "time_s", self.who, *(f"{axis}_{self.unit}" for axis in "xyz"))


MARKERS_CSV = CsvTable(
    "markers.csv", "marker", "mm", "where the marker was seen; empty cells: not seen", "for `diagnose` and `register`"
)
ACTUATORS_CSV = CsvTable(
    "actuators.csv",
    "actuator",
    "mm",
    "prescribed displacement of a displacement actuator, from its place when the case begins",
    "where there is such an actuator",
)
APPLIED_CSV = CsvTable(
    "forces_applied.csv", "actuator", "mN", "prescribed force of a force actuator", "where there is such an actuator"
)
FORCES_CSV = CsvTable(
    "forces.csv",
    "actuator",
    "mN",
    "force on the body measured at an actuator",
    "where [forces] is given, for `diagnose`",
)
TARGETS_CSV = CsvTable(
    "targets.csv", "target", "mm", "where an inner point was measured, by another device; never fitted", "optional"
)

#: Tables of a rig's folder.
CSV_TABLES = (MARKERS_CSV, ACTUATORS_CSV, APPLIED_CSV, FORCES_CSV, TARGETS_CSV)

#: Columns of a material test's ``test.csv``, with their meaning.
TEST_COLUMNS = {
    "specimen": "name of the specimen",
    "mode": "`tension`, `compression` or `simple-shear`",
    "rate_per_s": "rate of strain, 1/s; empty: not known",
    "time_s": "s; empty: not known; where it falls, another load history begins",
    "stretch_or_shear": "stretch (1 at rest), or amount of shear (0 at rest)",
    "stress_kPa": "nominal stress, kPa, compression negative; empty: not measured",
}

#: Table of an actuator's prescribed values, by its kind.
CONTROL_TABLES = {"displacement": ACTUATORS_CSV, "force": APPLIED_CSV}
