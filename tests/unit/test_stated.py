"""What is believed of a moment before its latents are found."""

from types import SimpleNamespace

import numpy as np

import tissuereg as tr
from tissuereg.registration.learned.model import Gaussian, error_covariance
from tissuereg.registration.learned.widen import stated


class Linear:
    """A model of one latent that moves two markers along x; its errors are as large as its latent."""

    prior = family = Gaussian(np.zeros(1), 4.0 * np.eye(1))

    def errors(self, latents=None):
        size = 0.3 if latents is None else float(np.abs(latents[0]))
        return SimpleNamespace(markers=size * np.array([[[1.0, 0, 0], [1.0, 0, 0]], [[-1.0, 0, 0], [-1.0, 0, 0]]]))


def test_errors_are_taken_at_the_most_probable_latents_unless_typical_ones_are_enough():
    reference = np.array([[0.0, 0, 0], [30.0, 0, 0]])
    markers = tr.Markers(reference, reference + np.array([1.5, 0.0, 0.0]), std=0.1)
    latents = np.linspace(-3.0, 3.0, 40)[None]
    predicted = np.array([1.0, 0, 0, 1.0, 0, 0])[:, None] * latents
    given = (Linear(), markers, np.arange(2), latents, predicted, np.zeros(6))
    exact, typical = stated(*given), stated(*given, typical=True)
    x = np.array([1.0, 0, 0, 1.0, 0, 0])
    for found, at in ((exact, exact.near), (typical, None)):
        errors = error_covariance(Linear().errors(at).markers.reshape(2, 6))
        np.testing.assert_allclose(found.noise, 0.01 * np.eye(6) + errors, rtol=1e-12, atol=1e-15)
    # The most probable latent, with the errors of a typical event.
    gain = 4.0 * x @ np.linalg.inv(4.0 * np.outer(x, x) + typical.noise)
    for found in (exact, typical):
        np.testing.assert_allclose(found.near, [1.5 * gain @ x], rtol=1e-9)
        assert found.factor == 1.0
    assert exact.noise[0, 0] > 3.0 * typical.noise[0, 0]
