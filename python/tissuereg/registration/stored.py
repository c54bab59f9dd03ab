"""A registration on disk: what is needed to answer later, and its reader."""

import json
import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from tissuereg._base.arguments import place
from tissuereg._base.arrays import FloatArray
from tissuereg._base.provenance import reads
from tissuereg.body.mesh import Mesh
from tissuereg.errors import FormatError
from tissuereg.io.bounds import existing_file, read_text
from tissuereg.io.fields import open_npz, write_npz
from tissuereg.io.meshes import mesh_arrays, mesh_from_archive
from tissuereg.registration.deviations import Deviations
from tissuereg.registration.field import FieldAnswers, RegisteredField
from tissuereg.registration.target import Target, target_named
from tissuereg.registration.trust import Trust

#: Files of a registration's folder that are read.
FIELD, CONTENT = "field.npz", "registration.json"


@dataclass(frozen=True, eq=False)
class StoredRegistration(FieldAnswers):
    """A registration that was read from its folder: it answers what the result itself would.

    Attributes
    ----------
    field : RegisteredField
        Body, displacement and its uncertainty.
    content : dict
        ``registration.json``.
    """

    field: RegisteredField
    content: dict[str, Any]

    @property
    def mesh(self) -> Mesh:
        """The undeformed body."""
        return self.field.mesh

    @property
    def displacement(self) -> FloatArray:
        """Displacement of each node, ndarray of float64, shape (n_nodes, 3), mm."""
        return self.field.displacement

    @cached_property
    def std(self) -> FloatArray:
        """Root of the trace of the covariance of each node, ndarray of float64, shape (n_nodes,), mm."""
        return self.field.uncertainty.std

    @cached_property
    def targets(self) -> dict[str, Target]:
        """Inner points after registration, by name."""
        return {name: _target(entry) for name, entry in self.content["targets"].items()}

    @property
    def trust(self) -> Trust:
        """Whether the result can be trusted, and the reasons if not."""
        told = self.content["trust"]
        names = ("ok", "p_value", "chi_square", "residual_chi_square", "n_obs", "reasons")
        return Trust(**{name: told[name] for name in names})

    def target(self, name: str) -> Target:
        """Return the registered inner point of this name; raise `MarkerError` if there is none."""
        return target_named(self.targets, name)

    def __repr__(self) -> str:
        trusted = "trusted" if self.trust.ok else "not to be trusted"
        return f"StoredRegistration({self.mesh.n_nodes} nodes, {len(self.targets)} targets, {trusted})"


def write_field(path: Path, field: RegisteredField) -> None:
    """Write a field as an .npz; deviations keep three digits."""
    spread = field.uncertainty
    scale = np.abs(spread.modes).max(axis=(1, 2)).clip(1e-30)
    arrays: dict[str, Any] = {
        **mesh_arrays(field.mesh),
        "displacement_mm": field.displacement,
        "modes": (spread.modes / scale[:, None, None]).astype(np.float16),
        "modes_mm": scale,
        "rest_mm2": spread.rest,
        "doubt_mm2": spread.doubt,
    }
    if spread.tail is not None:
        arrays["tail"] = np.array(spread.tail)
    write_npz(path, arrays)


def _read_field(path: Path) -> RegisteredField:
    with open_npz(path) as archive:
        mesh = mesh_from_archive(archive)
        n = mesh.n_nodes
        scale = archive.floats("modes_mm", None)
        modes = archive.floats("modes", len(scale), n, 3) * scale[:, None, None]
        tail = float(archive.floats("tail")) if "tail" in archive else None
        doubt = archive.floats("doubt_mm2", n)
        rest = archive.floats("rest_mm2", n, 3)
        if (rest < 0.0).any() or (tail is not None and not tail > 2.0):
            message = f"{path} must hold variances and a tail above 2 as `save` writes them"
            raise FormatError(message, where=str(path))
        displacement = archive.floats("displacement_mm", n, 3)
        uncertainty = Deviations(modes.astype(np.float32), rest.astype(np.float32), doubt.astype(np.float32), tail)
    return RegisteredField(mesh, displacement, uncertainty)


@reads
def read_registration(folder: str | os.PathLike[str]) -> StoredRegistration:
    """Read what ``tissuereg register --out`` or `Registration.save` wrote.

    Parameters
    ----------
    folder : path-like
        Folder with ``registration.json`` and ``field.npz``.

    Returns
    -------
    StoredRegistration
        Body, displacement, uncertainty, targets and trust; `at` and `transform` work.

    Raises
    ------
    FormatError
        If a file is missing or spoilt.
    """
    where = place("folder", folder, error=FormatError)
    file = existing_file(where / CONTENT)
    try:
        content = json.loads(read_text(file))
        told = StoredRegistration(_read_field(existing_file(where / FIELD)), content)
        _ = told.targets, told.trust
    except (json.JSONDecodeError, RecursionError, KeyError, TypeError, AttributeError, ValueError) as error:
        if isinstance(error, FormatError):
            raise
        message = f"{where} must hold a registration as `save` writes it; got {type(error).__name__}: {error}"
        raise FormatError(message, where=str(where)) from error
    return told


def _target(entry: dict[str, Any]) -> Target:
    mean, reference = (np.array(entry[name], np.float64).reshape(3) for name in ("mean_mm", "reference_mm"))
    covariance = np.array(entry["covariance_mm2"], np.float64).reshape(3, 3)
    start = None if entry["simulation_mm"] is None else np.array(entry["simulation_mm"], np.float64).reshape(3)
    return Target(
        reference, mean, covariance, start, entry["constrained"], entry["flag"], entry["tail_degrees_of_freedom"]
    )


__all__ = ["StoredRegistration", "read_registration", "write_field"]
