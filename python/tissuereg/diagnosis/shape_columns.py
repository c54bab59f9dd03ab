"""Sensitivity columns of the body's shape (`shape`), from derivatives on the fine mesh.

Strains are singular at the rim of a pad. On the user's elements, which are hardly smaller than a pad, the error of a
derivative by the pad's place or height is as large as the derivative itself. The fine mesh has the rim among its edges
and small elements around it, where four-node elements suffice.
"""

from collections.abc import Iterator

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.correction import make_correction
from tissuereg.diagnosis.predictor import Predictor
from tissuereg.diagnosis.shape import Direction, shape_directions
from tissuereg.diagnosis.tangents import Tangents
from tissuereg.simulation.fine import rough_element, without_time


def shape_columns(bench: Bench, fine: FloatArray) -> Iterator[tuple[Direction, FloatArray]]:
    """Yield the directions of the shape with their sensitivity columns.

    Parameters
    ----------
    bench : Bench
        The believed model. A model with memory is replaced by its elastic counterpart.
    fine : ndarray of float64, shape (size,)
        Prediction of the believed model on the fine mesh with ten-node elements, mm and mN.

    Yields
    ------
    tuple of Direction and ndarray of float64, shape (size,)
        Change per mm, in mm and mN; forces are mapped to those of ten-node elements (`Correction`).

    Raises
    ------
    ConvergenceError
        If a frame has no equilibrium.

    Notes
    -----
    Costs one factored tangent of the fine mesh for each state, and for each direction and state one evaluation of the
    internal forces and one solution.
    """
    experiment, element = bench.fine.fine, rough_element(bench.fine.fine)
    if not bench.is_elastic:
        experiment = without_time(experiment, element)
    predictor = Predictor(experiment, bench.layout, element=element, threads=bench.predictor.threads)
    directions = shape_directions(experiment, bench.experiment.mesh)
    columns = Tangents(predictor).by_shapes([direction.motion for direction in directions])
    corrected = make_correction(bench.layout, predictor.predict(), fine).of_columns(columns)
    yield from zip(directions, corrected, strict=True)
