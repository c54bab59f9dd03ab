"""What experiment files of both kinds, rigs and material tests, have in common: title, tables' folder, material."""

from pathlib import Path

from tissuereg.body.material import SHAPE_KEYS, Material
from tissuereg.errors import MaterialError
from tissuereg.io.experiment_keys import MATERIAL, TOP
from tissuereg.io.toml import Table


def folder_and_name(top: Table) -> tuple[Path, str]:
    """Take the keys above the first table of an experiment file.

    Parameters
    ----------
    top : Table
        Of a rig or a material test.

    Returns
    -------
    folder : Path
        Of the comma-separated tables.
    name : str
        Title; that of the file's folder where none is given.

    Raises
    ------
    ExperimentError
        If a key does not hold what it must.
    """
    given = TOP.values(top)
    tables = top.file.parent / (given["tables"] or "")
    return tables, given["name"] or top.file.absolute().parent.name or "experiment"


def read_material(top: Table) -> tuple[Material, float | None, float | None]:
    """Return the believed material, and standard deviations of Young's modulus and Poisson's ratio where stated.

    Parameters
    ----------
    top : Table
        Of a rig or a material test.

    Returns
    -------
    material : Material
        Means.
    young_std, poisson_std : float or None
        kPa; dimensionless.

    Raises
    ------
    ExperimentError
        If the table is absent, a key is missing or unknown, or a value out of its range.
    """
    table = MATERIAL.table(top)
    assert table is not None  # it is needed
    given = MATERIAL.values(table)
    (young, young_std), (poisson, poisson_std) = given["young_kpa"], given["poisson"]
    shape = {key: table.need(key) for key in SHAPE_KEYS[given["law"]]}
    try:
        material = Material(young, poisson, given["law"], given["density_g_per_cm3"], shape, given["volumetric"])
    except MaterialError as error:
        table.refuse(str(error))
    table.finish()
    return material, young_std, poisson_std
