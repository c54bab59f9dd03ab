"""Many registrations at once: each is that of `register`, whoever makes it."""

from contextlib import nullcontext
from functools import partial

import numpy as np
import pytest

import tissuereg as tr
from support.answers import told
from support.meshes import block
from tissuereg.errors import ArgumentError, MarkerError, ModelError, ShapeError
from tissuereg.parallel import Failed, InProcess, Processes
from tissuereg.registration.contacts.settings import ContactSettings

PLACES = np.array([[30.0, 10.0, 40.0], [0.0, 10.0, 40.0], [15.0, 0.0, 30.0]])

#: A moment each; the third has no marker.
MEASURED = PLACES + np.array([[[0.5, 0.0, 0.0]], [[0.0, 0.4, 0.1]], [[np.nan] * 3], [[-0.3, 0.2, 0.0]]])

FEW = ContactSettings(n_chains=2, n_chains_first=2, max_passes=1, n_kept=1, powers=(1.0,), n_draws=2)
OPTIONS = {"targets": {"deep": (15.0, 10.0, 20.0)}, "settings": tr.RegisterSettings(threads=1, contacts=FEW), "seed": 3}


@pytest.fixture(scope="module")
def body():
    return block(cells=(2, 2, 3))


@pytest.fixture(scope="module")
def markers():
    return tr.Markers(PLACES, PLACES, 0.2, ["a", "b", "c"])


@pytest.fixture(scope="module")
def singly(body, markers):
    """The registrations one by one; None where there is none."""
    moments = [tr.Markers(PLACES, one, 0.2, markers.names) for one in MEASURED]
    return [None if np.isnan(one.measured).all() else tr.register(body, one, **OPTIONS) for one in moments]


def bits(result):
    """What a registration says, without its times and the work that those before it have spared it."""
    return (
        told(result, "work"),
        result.displacement.tobytes(),
        result.node_covariance.tobytes(),
        result.draws(1).tobytes(),
    )


@pytest.mark.parametrize("where", [nullcontext, InProcess, partial(Processes, 2)])
def test_every_result_is_that_of_register_in_its_order(body, markers, singly, where):
    counted = []
    with where() as executor:
        found = list(tr.register_many(body, markers, MEASURED, executor=executor, progress=counted.append, **OPTIONS))
    assert counted == [1, 2, 3, 4]
    assert len(found) == 4
    assert isinstance(found[2], Failed)
    assert found[2].index == 2
    assert isinstance(found[2].error, MarkerError)
    for one, alone in zip(found, singly, strict=True):
        if alone is not None:
            assert bits(one) == bits(alone)
            assert one.mesh is body


def test_moments_may_have_markers_of_their_own_and_are_taken_as_they_are_needed(body, singly):
    taken = []

    def moments():
        for number in (0, 1, 3):
            taken.append(number)
            yield tr.Markers(PLACES, MEASURED[number], 0.2, ["a", "b", "c"])

    run = tr.register_many(body, moments(), **OPTIONS)
    assert bits(next(run)) == bits(singly[0])
    assert taken == [0]
    assert [bits(one) for one in run] == [bits(singly[1]), bits(singly[3])]
    assert list(tr.register_many(body, [])) == []


def test_a_worker_keeps_what_depends_on_the_body_alone(body, markers, monkeypatch):
    from tissuereg.registration import many as registrations

    with monkeypatch.context() as changed:
        made = []
        plain = registrations.Registrar
        changed.setattr(
            registrations, "Registrar", lambda *given, **options: made.append(1) or plain(*given, **options)
        )
        list(tr.register_many(body, markers, MEASURED, executor=InProcess(), **{**OPTIONS, "seed": 4}))
    assert made == [1]


def test_what_is_wrong_for_all_moments_is_raised_and_what_cannot_be_sent_named(body, markers):
    with pytest.raises(ArgumentError, match="option"):
        tr.register_many(body, markers, MEASURED, surface=PLACES)
    with pytest.raises(ShapeError, match="measured"):
        tr.register_many(body, markers, PLACES)
    with pytest.raises(ArgumentError, match="many moments"):
        tr.register_many(body, markers)
    with pytest.raises(ArgumentError, match="element"):
        list(tr.register_many(tr.Body(body, element="tet5"), markers, MEASURED))
    with pytest.raises(ModelError, match="no-model"):
        list(tr.register_many(body, markers, MEASURED, model="no-model"))
    with pytest.raises(ArgumentError, match="by its folder"):
        list(tr.register_many(body, markers, MEASURED, model=lambda: None, executor=InProcess()))
