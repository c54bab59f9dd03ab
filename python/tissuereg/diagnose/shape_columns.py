"""How everything measured follows another shape of the body, by derivatives on the fine mesh.

Strains are singular at the rim of a pad. On the user's elements, which are hardly smaller than a pad, a derivative by
the pad's place or height is wrong by as much as it is large. The fine mesh has the rim as a line of its edges and small
elements round it; there elements of first order are good enough.
"""

from collections.abc import Iterator

from tissuereg._arrays import FloatArray
from tissuereg.diagnose.bench import Bench
from tissuereg.diagnose.correction import make_correction
from tissuereg.diagnose.predictor import Predictor
from tissuereg.diagnose.shape import Direction, shape_directions
from tissuereg.diagnose.tangents import Tangents
from tissuereg.simulate.fine import rough_element, without_time


def shape_columns(bench: Bench, fine: FloatArray) -> Iterator[tuple[Direction, FloatArray]]:
    """Yield what every direction of the shape changes.

    Parameters
    ----------
    bench : Bench
        The believed model. One that goes through time follows its shape as the body does that depends on its load
        alone.
    fine : ndarray of float64, shape (size,)
        What the believed model says on the fine mesh in ten-node elements, mm and mN.

    Yields
    ------
    tuple of Direction and ndarray of float64, shape (size,)
        Over one mm, mm and mN: forces as ten-node elements would give them (`Correction`).

    Raises
    ------
    ConvergenceError
        If a frame finds no equilibrium.

    Notes
    -----
    One tangent of the fine mesh a state, one evaluation of the internal forces and one solution a direction and state.
    """
    experiment, element = bench.fine.fine, rough_element(bench.fine.fine)
    if not bench.is_elastic:
        experiment = without_time(experiment, element)
    predictor = Predictor(experiment, bench.layout, element=element, threads=bench.predictor.threads)
    directions = shape_directions(experiment, bench.experiment.mesh)
    columns = Tangents(predictor).by_shapes([direction.motion for direction in directions])
    corrected = make_correction(bench.layout, predictor.predict(), fine).of_columns(columns)
    yield from zip(directions, corrected, strict=True)
