"""Precomputed displacement fields as a simulation, interpolated between them in the actuators' parameters."""

import os
from collections.abc import Iterable, Sequence
from itertools import product
from typing import Any

import numpy as np

from tissuereg._base.arguments import found
from tissuereg._base.arrays import FloatArray, depth, float_array
from tissuereg.body.mesh import Mesh
from tissuereg.errors import ArgumentError, ShapeError
from tissuereg.io.fields import read_displacement


class TablePhysics:
    """A simulation by displacement fields on a grid of the actuators' parameters, interpolated linearly along each.

    Parameters
    ----------
    axes : sequence of array_like of float, shape (n_values,); or one such array
        Two or more ascending values of each parameter, such as a stroke in mm or a share of a load.
    fields : array_like of float, shape (n_values of the first, n_values of the second, ..., n_nodes, 3)
        Displacement at each point of the grid, mm.

    Raises
    ------
    ArgumentError
        If an axis does not ascend.
    ShapeError
        If the fields do not fit the axes, or are not finite.

    Notes
    -----
    Cost of a frame: a weighted sum of two fields for one parameter, four for two. A table cannot hold a registered
    shape by forces: a tracker adds the last correction to its fields as a displacement.

    Examples
    --------
    >>> table = TablePhysics([0.0, 10.0], [[[0.0, 0.0, 0.0]], [[0.0, 0.0, 4.0]]])
    >>> table.field(5.0).tolist()
    [[0.0, 0.0, 2.0]]
    """

    def __init__(self, axes: Any, fields: Any) -> None:
        self.axes = _axes(axes)
        self._fields = float_array("fields", fields, (*(len(axis) for axis in self.axes), None, 3))
        if not np.isfinite(self._fields).all():
            message = "`fields` must be finite everywhere"
            raise ShapeError(message, where="fields")

    @classmethod
    def from_files(
        cls, values: Any, paths: Iterable[str | os.PathLike[str]], mesh: Mesh, name: str = "displacement"
    ) -> "TablePhysics":
        """Return a table of the results that another solver wrote for values of one parameter.

        Parameters
        ----------
        values : array_like of float, shape (n_values,)
            Value of the parameter for each file, in any order.
        paths : iterable of path-like
            Files with the displacement of each node in mm, .vtu, .vtk, .msh or .npz, as
            `tissuereg.io.fields.read_displacement` reads them.
        mesh : Mesh
            Undeformed body, whose nodes the files have.
        name : str
            Name of the point data in the files; .npz files need none.

        Returns
        -------
        TablePhysics
            The simulation by these fields, which are all held in memory.

        Raises
        ------
        FormatError
            If a file cannot be read or is of another mesh.
        ArgumentError, ShapeError
            If there is not one value for each file, or two values are equal.
        """
        files = tuple(paths)
        given = float_array("values", values, (len(files),))
        order = np.argsort(given)
        return cls(given[order], np.array([read_displacement(files[i], mesh, name) for i in order]))

    @property
    def n_nodes(self) -> int:
        """Number of nodes of a field."""
        return int(self._fields.shape[-2])

    def field(self, actuator: Any, *, start: FloatArray | None = None) -> FloatArray:
        """Return the displacement interpolated at values of the parameters.

        Parameters
        ----------
        actuator : float or array_like of float, shape (n_parameters,)
            Value of each parameter, within the table.
        start : object, optional
            Ignored.

        Returns
        -------
        ndarray of float64, shape (n_nodes, 3)
            Displacement of each node, mm.

        Raises
        ------
        ArgumentError
            If a value lies outside of the table, where no fields are given.
        ShapeError
            If there is not one value for each parameter.
        """
        several = actuator if depth("actuator", actuator) else [actuator]
        values = float_array("actuator", several, (len(self.axes),))
        places = [
            _between(number, axis, value) for number, (axis, value) in enumerate(zip(self.axes, values, strict=True))
        ]
        total = np.zeros(self._fields.shape[-2:])
        for corner in product((0, 1), repeat=len(places)):
            weight = float(
                np.prod([share if up else 1.0 - share for up, (_, share) in zip(corner, places, strict=True)])
            )
            if weight > 0.0:
                index = tuple(first + up for up, (first, _) in zip(corner, places, strict=True))
                total += weight * self._fields[index]
        return total


def _axes(axes: Any) -> tuple[FloatArray, ...]:
    several = isinstance(axes, Sequence) and len(axes) > 0 and all(isinstance(axis, Iterable) for axis in axes)
    found_axes = tuple(float_array("axes", axis, (None,)) for axis in (axes if several else [axes]))
    for axis in found_axes:
        if len(axis) < 2 or not (np.isfinite(axis).all() and (np.diff(axis) > 0.0).all()):
            message = f"each of `axes` must hold two or more finite values in ascending order, got {found(axes)}"
            raise ArgumentError(message, where="axes")
    return found_axes


def _between(number: int, axis: FloatArray, value: float) -> tuple[int, float]:
    """Return the number of the grid point before a value, and the share of the way to the next one, 0 to 1."""
    if not axis[0] <= value <= axis[-1]:
        within = f"must lie within the table, {axis[0]:g} to {axis[-1]:g}, got {value:g}"
        message = f"parameter {number + 1} of `actuator` {within}"
        raise ArgumentError(message, where="actuator")
    first = min(int(np.searchsorted(axis, value, side="right")) - 1, len(axis) - 2)
    return first, float((value - axis[first]) / (axis[first + 1] - axis[first]))
