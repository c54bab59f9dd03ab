"""The experiment format as declarations: tables and keys of ``experiment.toml``, columns of its comma-separated tables.

`tissuereg.io.experiments` and `tissuereg.io.material_experiments` read files by these declarations;
``docs/experiment.md`` lists them.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg._base.choices import ELEMENTS, Element
from tissuereg._base.fields import belief, choice, flag, number, numbers, path, table, text
from tissuereg.body.material import GRAVITY_MM_PER_S2, LAWS, SHAPE_KEYS, VOLUMETRIC, Material
from tissuereg.errors import ExperimentError, MaterialError
from tissuereg.experiment.material_experiment import HELD_OUT
from tissuereg.io.node_rules import TOLERANCE, node_rule
from tissuereg.io.toml import Keys, Table

#: Words of ``[simulated]``.
MODELS = ("fine", "plain")

Vector = tuple[float, float, float]


def _edge() -> Any:
    meaning = "standard deviation of where the edge of the patch lies"
    return number(meaning, above=0.0, default=None, otherwise="by the patch's size and the mesh's edges", example=1.0)


@dataclass(frozen=True, kw_only=True)
class Top(Keys):
    """Keys above the first table."""

    kind: str = choice(("rig", "material-test"), "what was measured", default="rig")
    name: str | None = text(
        "title of the experiment", default=None, otherwise="the name of the folder", example="my rig"
    )
    tables: Path | None = path(
        "folder of the comma-separated tables, seen from this file",
        default=None,
        otherwise="the file's own folder",
        example=".",
    )


@dataclass(frozen=True, kw_only=True)
class MeshKeys(Keys):
    """The body in its reference shape."""

    heading: ClassVar[str] = "[mesh]"
    needed: ClassVar[bool] = True
    file: Path = path("mesh of tetrahedra in mm (.vtu, .vtk, .msh, .npz), seen from this file")
    surface_std_mm: float | None = number(
        "standard deviation of the distance between the body's surface and the mesh's, along the normal; 0.5 to 1 "
        "after segmentation",
        above=0.0,
        default=None,
        otherwise="0",
        example=0.5,
    )
    surface_length_mm: float | None = number(
        "length over which that distance is correlated", above=0.0, default=None, otherwise="not stated", example=10.0
    )


@dataclass(frozen=True, kw_only=True)
class MaterialKeys(Keys):
    """The believed material of the body. Moduli are those at small strain, whatever the law."""

    heading: ClassVar[str] = "[material]"
    needed: ClassVar[bool] = True
    law: str = choice(LAWS, "strain energy", default="neo-hookean")
    young_kpa: tuple[float, float | None] = belief(
        "Young's modulus; with a standard deviation it is a prior of `diagnose`"
    )
    poisson: tuple[float, float | None] = belief("Poisson's ratio, more than -1 and less than 0.5; likewise")
    density_g_per_cm3: float = number("mass density; counts under gravity", above=0.0, default=1.0)
    volumetric: str = choice(VOLUMETRIC, "energy of volume change", default="log")


@dataclass(frozen=True, kw_only=True)
class GravityKeys(Keys):
    """The body's own weight; leave the table out where it does not act."""

    heading: ClassVar[str] = "[gravity]"
    direction: Vector = numbers(
        "where it points; only the direction counts", 3, directed=True, unit="", example=[0.0, 0.0, -1.0]
    )
    in_reference: bool = flag("whether the mesh already hangs in it", example=True)
    g_mm_per_s2: float = number("its acceleration", above=0.0, default=GRAVITY_MM_PER_S2)


@dataclass(frozen=True, kw_only=True)
class BoundaryKeys(Keys):
    """A patch that is held; one table per patch. Without any, the mesh's node set `fixed` is held."""

    heading: ClassVar[str] = "[[boundary]]"
    name: str = text("of the patch")
    nodes: str | dict[str, Any] = node_rule("which nodes it is")
    kind: str = choice(("fixed",), "how it is held", default="fixed")
    edge_std_mm: float | None = _edge()


@dataclass(frozen=True, kw_only=True)
class ActuatorKeys(Keys):
    """A patch that is moved or pulled; one table per patch. In a case without rows for it its patch is free."""

    heading: ClassVar[str] = "[[actuator]]"
    name: str = text("of the patch, not `fixed`")
    nodes: str | dict[str, Any] = node_rule("which nodes it is")
    kind: str = choice(
        ("displacement", "force"),
        "what is prescribed: its displacement (actuators.csv) or its force (forces_applied.csv)",
    )
    contact: str = choice(("bonded",), "how it holds the body", default="bonded")
    edge_std_mm: float | None = _edge()


@dataclass(frozen=True, kw_only=True)
class MarkersKeys(Keys):
    """The tracked markers on the surface."""

    heading: ClassVar[str] = "[markers]"
    needed: ClassVar[bool] = True
    std_mm: float = number("standard deviation of a measured coordinate", above=0.0)
    reference: Mapping[str, Any] | None = table(
        "place of each marker on the body in the reference shape, unless `reference_time_s` is given",
        words="table: name = [x, y, z]",
        unit="mm",
        default=None,
        otherwise="`reference_time_s` must be given",
    )
    reference_time_s: float | None = number(
        "time of a frame in markers.csv that shows the markers on the body in the reference shape",
        default=None,
        otherwise="`reference` must be given",
        example=0.0,
    )
    rest_case: str | None = text(
        "case without load, for the noise model", default=None, otherwise="none", example="rest"
    )
    trial_share: float | None = number(
        "standard deviation of the difference between two trials of one case, as a share of the markers' motion",
        above=0.0,
        default=None,
        otherwise="0",
        example=0.02,
    )


@dataclass(frozen=True, kw_only=True)
class ForcesKeys(Keys):
    """Noise of forces.csv; the two come together."""

    heading: ClassVar[str] = "[forces]"
    std_mN: float = number("standard deviation of a measured force component", above=0.0, example=5.0)  # noqa: N815 (the unit)


@dataclass(frozen=True, kw_only=True)
class TargetKeys(Keys):
    """An inner point of the body; one table per point."""

    heading: ClassVar[str] = "[[target]]"
    name: str = text("of the point")
    reference: Vector = numbers("its place in the reference shape", 3, unit="mm")


@dataclass(frozen=True, kw_only=True)
class SimulatedKeys(Keys):
    """Written by `simulate`: the model that made the data, so that `diagnose` compares with the same one.

    Experiments that were measured do not have it. It is ignored, with a warning, where mesh or tables are not those
    that it is about.
    """

    heading: ClassVar[str] = "[simulated]"
    model: str = choice(MODELS, "the fine model, or the mesh as it is")
    element: Element = choice(ELEMENTS, "its elements")
    tables_sha256: str | None = text(
        "of the mesh and the tables that it made, targets left out", default=None, otherwise="not checked"
    )


@dataclass(frozen=True, kw_only=True)
class MaterialTestKeys(Keys):
    """How a material test is judged."""

    heading: ClassVar[str] = "[test]"
    hold_out: str | None = choice(
        HELD_OUT, "what the proof of a finding leaves out", default=None, otherwise="chosen by the data"
    )
    std_kpa: float | None = number(
        "standard deviation of a measured stress", above=0.0, default=None, otherwise="estimated"
    )


#: Tables of a rig's ``experiment.toml`` in the order of the page; ``[[effect]]`` follows.
RIG: tuple[type[Keys], ...] = (
    Top, MeshKeys, MaterialKeys, GravityKeys, BoundaryKeys, ActuatorKeys, MarkersKeys, ForcesKeys, TargetKeys,
    SimulatedKeys,
)  # fmt: skip


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
    ('"box x0 y0 z0 x1 y1 z1"', "{ low_mm = [x0, y0, z0], high_mm = [x1, y1, z1] }", "those in a box along the axes"),
    (
        '"near FILE r"',
        "",
        "those within r mm of a surface (.stl, .ply, .obj ...); not in this file: make a node set of it",
    ),
)


@dataclass(frozen=True)
class CsvTable:
    """Columns and meaning of one comma-separated table in the folder of an experiment.

    Attributes
    ----------
    file : str
        Name of the file.
    who : str
        Name of the third column: ``marker``, ``actuator`` or ``target``.
    unit : str
        Unit of the three numbers in a row, ``mm`` or ``mN``.
    meaning : str
        Meaning of a row, in words.
    presence : str
        When the file must be there, in words.
    """

    file: str
    who: str
    unit: str
    meaning: str
    presence: str

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns: ``case``, ``time_s``, that in `who`, and x, y and z with the unit, such as ``x_mm``."""
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


def folder_and_name(top: Table) -> tuple[Path, str]:
    """Return the folder of an experiment's comma-separated tables, and the experiment's title.

    `top`: content of ``experiment.toml``, whose keys above the first table are taken. The title is the name of the
    file's folder where none is given. Raises `ExperimentError` if a key does not hold what it must.
    """
    given = Top.of(top)
    tables = top.file.parent / (given.tables or "")
    return tables, given.name or top.file.absolute().parent.name or "experiment"


def read_material(top: Table) -> tuple[Material, float | None, float | None]:
    """Return the believed material, and the standard deviations of Young's modulus (kPa) and of Poisson's ratio.

    `top`: content of ``experiment.toml``, whose table ``[material]`` is taken. The material holds the mean values. A
    standard deviation that is not stated is None. Raises `ExperimentError` if the table is absent, a key is missing or
    unknown, or a value out of its range.
    """
    table = MaterialKeys.found(top)
    assert table is not None  # it is needed
    given = MaterialKeys.of(table)
    (young, young_std), (poisson, poisson_std) = given.young_kpa, given.poisson
    shape = {key: table.need(key) for key in SHAPE_KEYS[given.law]}
    try:
        material = Material(young, poisson, given.law, given.density_g_per_cm3, shape, given.volumetric)
    except MaterialError as error:
        table.refuse(str(error))
    table.finish()
    return material, young_std, poisson_std


def material_table(material: Material, young_std: float | None, poisson_std: float | None) -> dict[str, Any]:
    """Return the table ``[material]`` of an experiment file, values by key, which `read_material` reads back.

    `material`: a material that is the same in the whole body; `young_std`, `poisson_std`: standard deviations of
    Young's modulus in kPa and of Poisson's ratio; None if not stated. Raises `ExperimentError` if one of the two varies
    over the body.
    """
    return {
        "law": material.law,
        **{key: value if np.ndim(value) == 0 else list(value) for key, value in material.shape.items()},
        "volumetric": material.volumetric,
        "young_kpa": _stated("young", material.young_array, young_std),
        "poisson": _stated("poisson", material.poisson_array, poisson_std),
        "density_g_per_cm3": material.density,
    }


def _stated(name: str, mean: FloatArray, std: float | None) -> float | list[float]:
    if mean.size != 1:
        message = f"`{name}` of an experiment file must be one for the whole body, got {mean.size} values"
        raise ExperimentError(message, where=name)
    return float(mean[0]) if std is None else [float(mean[0]), std]
