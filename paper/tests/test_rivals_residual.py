"""The linear residual against dense least squares, on residuals that are a linear function of the input."""

import numpy as np
import pytest

import tissuereg as tr
from tissuereg.body.observe import MarkerObservation
from tissuereg.errors import ArgumentError
from tissuereg_paper.rivals import LinearElastic, LinearResidual, Setting

PLACES = np.array([[30.0, 10.0, 40.0], [0.0, 10.0, 40.0], [15.0, 0.0, 30.0], [15.0, 20.0, 35.0], [30.0, 5.0, 20.0]])
FRAME_S, MEMORY_S = 0.025, 0.05


def rival(mesh, std=0.1, **options) -> LinearResidual:
    given = {"reference_mm": PLACES, "std_mm": np.full(5, std), "material": tr.Material(), "frame_s": FRAME_S}
    return LinearResidual(Setting(mesh, **given, threads=1), memory_s=MEMORY_S, **options)


def inputs(mesh, field):
    observed = MarkerObservation(mesh, PLACES, tuple("abcde"))
    return observed.predict(field[observed.nodes])


def simulations(mesh, count, rng):
    """Return fields by two actuators, each moved at random."""
    z = mesh.nodes[:, 2:] / 40.0
    first, second = z * np.array([1.0, 0.2, 0.0]), z * mesh.nodes[:, :1] / 30.0 * np.array([0.0, 1.0, -0.5])
    moves = 1.0 + rng.random((count, 2))
    return [a * first + b * second for a, b in moves]


def test_the_residual_is_that_of_weighted_regularised_least_squares(block_mesh):
    rng = np.random.default_rng(0)
    made = rival(block_mesh)
    xs, rs = [], []
    for field in simulations(block_mesh, 6, rng):
        x = inputs(block_mesh, field)
        r = 0.3 * x + 0.5 + 0.1 * rng.standard_normal(x.shape)
        r[rng.random(5) < 0.3] = np.nan
        found = made.register(PLACES + x + r, field)
        xs.append(x.ravel())
        rs.append(r)
    x, r = np.array(xs), np.array(rs)
    weights = np.exp(-FRAME_S / MEMORY_S * np.arange(6)[::-1])
    seen = np.isfinite(r).all(axis=2)
    squares = np.where(seen, np.nan_to_num(r**2).sum(axis=2) / 3.0 - 0.01, 0.0)
    entry = (weights @ squares.sum(axis=1) / (weights @ seen.sum(axis=1))) / (
        weights @ (x**2).sum(axis=1) / weights.sum()
    )
    for marker in range(5):
        own = seen[:, marker]
        left = (x[own].T * weights[own]) @ x[own] / 0.01 + np.eye(15) / entry
        jacobian = np.linalg.solve(left, (x[own].T * weights[own]) @ r[own, marker] / 0.01).T
        np.testing.assert_allclose(found.kept["residual_mm"][marker], jacobian @ x[-1], atol=1e-11)
        variance = x[-1] @ np.linalg.solve(left, x[-1])
        assert found.kept["residual_std_mm"][marker] == pytest.approx(np.sqrt(variance), rel=1e-8)


def test_a_marker_that_was_lost_has_its_residual_predicted(block_mesh):
    rng = np.random.default_rng(1)
    made, slope = rival(block_mesh, std=1e-5), 0.2 * rng.standard_normal((15, 15))
    for moment, field in enumerate(simulations(block_mesh, 5, rng)):
        x = inputs(block_mesh, field)
        r = (slope @ x.ravel()).reshape(5, 3)
        measured = PLACES + x + r
        if moment == 4:
            measured[2] = np.nan
        found = made.register(measured, field)
    # Two actuators, four moments before: the Jacobian along their inputs is known but for noise and penalty, 1e-5 each.
    np.testing.assert_allclose(found.kept["residual_mm"], r, atol=1e-3)
    assert found.kept["residual_std_mm"][2] < 1e-3


def test_a_jacobian_that_changed_is_forgotten(block_mesh):
    rng = np.random.default_rng(2)
    made = rival(block_mesh, std=1e-3)
    off = []
    for moment, field in enumerate(simulations(block_mesh, 40, rng)):
        x = inputs(block_mesh, field)
        r = (0.1 if moment < 20 else -0.3) * x
        off.append(np.abs(made.register(PLACES + x + r, field).kept["residual_mm"] - r).max())
    # Ten memories later e^-10 of the old moments' weight is left.
    assert off[39] < 1e-3 < 0.1 < off[20]


def test_a_first_moment_is_that_of_linear_elasticity_where_there_is_little_noise(block_mesh):
    field = simulations(block_mesh, 1, np.random.default_rng(3))[0]
    x = inputs(block_mesh, field)
    measured = PLACES + x + np.array([0.3, -0.2, 0.1])
    made = rival(block_mesh, std=1e-4)
    elastic = LinearElastic(made.setting).register(measured, field)
    # Shrunk by the noise over the residual squared, 1e-7.
    np.testing.assert_allclose(made.register(measured, field).displacement_mm, elastic.displacement_mm, atol=1e-4)


def test_what_is_out_of_the_window_has_no_say(block_mesh):
    first, last = simulations(block_mesh, 2, np.random.default_rng(4))
    fresh = rival(block_mesh).register(PLACES + 1.1 * inputs(block_mesh, last), last)
    short = rival(block_mesh, window=1)
    short.register(PLACES + inputs(block_mesh, first) - 0.7, first)
    again = short.register(PLACES + 1.1 * inputs(block_mesh, last), last)
    np.testing.assert_array_equal(again.displacement_mm, fresh.displacement_mm)


def test_a_body_without_residual_is_the_simulation(block_mesh):
    field = simulations(block_mesh, 1, np.random.default_rng(5))[0]
    found = rival(block_mesh).register(PLACES + inputs(block_mesh, field), field)
    np.testing.assert_array_equal(found.displacement_mm, field)


def test_a_moment_without_simulation_is_refused(block_mesh):
    with pytest.raises(ArgumentError, match="`simulation_mm` must be given for the method 'linear residual'"):
        rival(block_mesh).register(PLACES)
