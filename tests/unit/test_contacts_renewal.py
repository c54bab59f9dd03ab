"""A tangent that is renewed beside the moments of measurement: when it is made, when it is used, what it holds."""

from dataclasses import replace

import numpy as np
import pytest

import tissuereg as tr
from support.meshes import block
from tissuereg.body.observe import MarkerObservation
from tissuereg.errors import ConvergenceError
from tissuereg.registration.contacts import renewal
from tissuereg.registration.contacts.settings import ContactSettings, PassSettings

MESH = block(cells=(2, 2, 3))
MATERIAL, STD = tr.Material(young=10.0, poisson=0.4), 0.05
FREE = np.setdiff1d(MESH.surface_nodes, MESH.fixed_nodes)
PLACES = MESH.nodes[FREE[::2]] + [0.5, 0.3, 0.2]
#: Pushed sideways at one corner, from moment to moment.
SHARES = (0.5, 0.55, 0.6, 0.65, 0.7)


def settings(**steps):
    contacts = ContactSettings(
        n_chains=4,
        n_chains_first=4,
        n_chains_on=4,
        n_kept=2,
        powers=(0.1, 1.0, 1.0),
        n_draws=4,
        steps=PassSettings(**steps),
    )
    return tr.RegisterSettings(threads=1, contacts=contacts)


def chain(**steps):
    """Return the registrations of moments that follow each other."""
    body = tr.Body(MESH, MATERIAL)
    registrar = tr.Registrar(
        body, tr.Markers(PLACES, std=STD), None, {"deep": (15.0, 10.0, 20.0)}, settings=settings(**steps)
    )
    top = MESH.nodes[:, 2] == MESH.nodes[:, 2].max()
    seen, rng = MarkerObservation.of(MESH, tr.Markers(PLACES)), np.random.default_rng(5)
    results, last = [], None
    for share in SHARES:
        forces = np.where(top[:, None], [15.0 * share, 0.0, -20.0 * share], 0.0)
        field = tr.Simulator(MESH).solve(tr.Load(forces=forces), MATERIAL).displacement
        moved = seen.predict(field[seen.nodes])
        last = registrar.register(PLACES + moved + STD * rng.standard_normal(moved.shape), after=last)
        results.append(last)
    return results


def test_a_renewed_tangent_is_used_from_the_stated_moment_on_whatever_the_machine_does():
    results = chain(renew_at=1, renewed_after=2)
    draws = [result.draw for result in results]
    assert [draw.moments for draw in draws] == [1, 2, 3, 4, 5]
    assert draws[0].renewal is None
    # Begun at the second moment, used at the fourth, at which the next one begins.
    first = draws[1].renewal
    assert first.moment == 4
    assert draws[2].renewal is first
    tangents = [draw.fit.tangent for draw in draws]
    assert tangents[1] is tangents[0]
    assert tangents[2] is tangents[0]
    assert tangents[3] is first.tangent()
    assert tangents[3] is not tangents[0]
    assert draws[3].renewal.moment == 6
    # Of a body with more unknowns it is used later.
    n_unknowns = draws[0].fit.columns.body.simulator.body.n_unknowns
    for unknowns, wanted in ((n_unknowns, 3), (n_unknowns - 1, 4)):
        assert chain(renew_at=1, renewed_after=1, renewed_unknowns=unknowns)[1].draw.renewal.moment == wanted
    for one, two in zip(results, chain(renew_at=1, renewed_after=2), strict=True):
        assert np.array_equal(one.displacement, two.displacement)
        assert np.array_equal(one.target("deep").covariance, two.target("deep").covariance)


def test_a_renewed_tangent_knows_what_is_asked_and_is_that_of_the_moment_at_which_it_began():
    results = chain(renew_at=1, renewed_after=2)
    assert results[3].work["right_hand_sides"] == 0
    assert results[3].work.get("factorisations", 0) == 0
    fit, made = results[1].draw.fit, results[1].draw.renewal.tangent()
    exact = fit.columns.body.simulator.solve(
        fit.columns.load(fit.state.coefficients), MATERIAL, springs=fit.columns.springs, tolerance=1e-10
    )
    wanted = exact.displacement + fit.state.beside
    assert np.abs(made.moved - wanted).max() < 1e-4 * np.abs(wanted).max()
    # Nearer to the moment that uses it: fewer iterations.
    old = chain(renew_at=10**6)
    assert results[3].work["iterations"] < old[3].work["iterations"]
    assert old[3].draw.renewal is None


def test_where_there_is_no_new_tangent_the_old_one_serves_on(monkeypatch):
    def none(*_):
        message = "no tangent"
        raise ConvergenceError(message, where="load")

    monkeypatch.setattr(renewal, "tangent_at", none)
    results = chain(renew_at=1, renewed_after=1)
    assert results[1].draw.renewal.tangent() is None
    assert len({id(result.draw.fit.tangent) for result in results}) == 1


def test_a_moment_that_takes_few_iterations_renews_nothing():
    most = max(result.work["iterations"] for result in chain(renew_at=10**6)[1:])
    assert all(result.draw.renewal is None for result in chain(renew_at=most + 1))
    assert any(result.draw.renewal is not None for result in chain(renew_at=most))


def test_an_end_that_is_off_the_linear_model_is_linearised_at_once_only_if_it_is_far_off():
    close, far = (chain(renew_at=10**6, as_predicted_on=margin) for margin in (10.0, 0.0))
    assert all(result.work.get("factorisations", 0) == 0 for result in close[1:])
    assert any(result.work.get("factorisations", 0) == 1 for result in far[1:])


@pytest.mark.parametrize("name", ["renew_at", "renewed_after", "as_predicted_on"])
def test_settings_of_the_renewal_are_numbers(name):
    with pytest.raises(tr.TissueRegError, match=name):
        replace(PassSettings(), **{name: float("nan")})
