"""What a trained model is worth beside contacts: errors of the same events, and the sentence that says when it pays."""

import numpy as np
import pytest

import tissuereg as tr
from tissuereg.phantom import phantom_mesh, shipped_model_folder
from tissuereg.registration.learned.network import NetworkModel
from tissuereg.registration.worth import Worth, worth, worth_text


@pytest.mark.parametrize(
    ("alone", "simulated", "said"),
    [
        (Worth(12, 3.0, 0.2, 0.3), Worth(12, 1.0, 0.1, 0.2), "It pays without a simulation and with a simulation."),
        (Worth(12, 3.0, 0.4, 0.3), Worth(12, 1.0, 0.1, 0.2), "It pays with a simulation."),
        (Worth(12, 3.0, 0.4, 0.3), Worth(12, 0.1, 0.2, 0.3), "It does not pay on these events"),
        (Worth(12, 3.0, 0.2, 0.3), None, "It pays without a simulation."),
        (None, None, "No event could be registered"),
    ],
)
def test_it_pays_where_the_models_error_is_the_smallest(alone, simulated, said):
    text = worth_text(alone, simulated)
    assert said in text
    assert text.count("| without a simulation |") == (alone is not None)
    if simulated is not None:
        assert f"| with a simulation | 12 | {simulated.before:.2f} | {simulated.model:.2f} |" in text


def test_events_are_registered_in_both_ways_from_the_same_markers():
    mesh = phantom_mesh()
    model = NetworkModel(shipped_model_folder(), mesh, threads=1)
    truths = model.decode(0.5 * np.random.default_rng(2).standard_normal((26, 2)))
    found = worth(model, mesh, truths, [None, None], 3)
    assert found.events == 2
    # Two different answers, both far better than nothing.
    assert found.model != found.contacts
    assert max(found.model, found.contacts) < 0.2 * found.before
    near = worth(model, mesh, truths, list(0.9 * truths), 3)
    assert near.before == pytest.approx(0.1 * found.before)


def test_events_that_cannot_be_registered_are_left_out(monkeypatch):
    def refused(*given, **more):
        raise tr.errors.ConvergenceError

    monkeypatch.setattr("tissuereg.registration.worth.register", refused)
    mesh = phantom_mesh()
    assert worth(None, mesh, np.zeros((2, mesh.n_nodes, 3)), [None, None]) is None
