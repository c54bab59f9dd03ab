"""A tangent that is renewed beside the moments of measurement: when it is made, when it is used, what it holds."""

import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

import tissuereg as tr
from support.meshes import block
from tissuereg.body.observe import MarkerObservation
from tissuereg.errors import ConvergenceError
from tissuereg.registration.contacts import renewal
from tissuereg.registration.contacts.answer import Answer
from tissuereg.registration.contacts.fit import Passes
from tissuereg.registration.contacts.settings import ContactSettings, EvidenceSettings, PassSettings
from tissuereg.simulation.sensitivity import Linearised

MESH = block(cells=(2, 2, 3))
MATERIAL, STD = tr.Material(young=10.0, poisson=0.4), 0.05
FREE = np.setdiff1d(MESH.surface_nodes, MESH.fixed_nodes)
PLACES = MESH.nodes[FREE[::2]] + [0.5, 0.3, 0.2]
#: Pushed sideways at one corner, from moment to moment.
SHARES = (0.5, 0.55, 0.6, 0.65, 0.7)


def settings(threads=1, every=10, **steps):
    contacts = ContactSettings(
        n_chains=4,
        n_chains_first=4,
        n_chains_on=4,
        n_kept=2,
        powers=(0.1, 1.0, 1.0),
        n_draws=4,
        evidence=EvidenceSettings(every=every),
        steps=PassSettings(**{"renewed_needs": 0, **steps}),
    )
    return tr.RegisterSettings(threads=threads, contacts=contacts)


def chain(lost=(), before_use=None, **steps):
    """Return the registrations of moments that follow each other; markers of the numbers `lost` are seen at first.

    `before_use`: called before a renewed tangent is used.
    """
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
        places = PLACES + moved + STD * rng.standard_normal(moved.shape)
        if last is not None:
            places[list(lost)] = np.nan
            renewed = last.draw.renewal
            if before_use is not None and renewed is not None and last.draw.moments + 1 >= renewed.moment:
                before_use()
        last = registrar.register(places, after=last)
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
    assert tangents[1].linearised is tangents[0].linearised
    assert tangents[2].linearised is tangents[0].linearised
    assert tangents[3].linearised is first.tangent().linearised
    assert tangents[3].linearised is not tangents[0].linearised
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
    assert len({id(result.draw.fit.tangent.linearised) for result in results}) == 1


def test_what_goes_wrong_in_the_thread_is_raised_at_the_moment_of_its_use_and_told_nowhere_else(monkeypatch):
    def broken(*_):
        message = "no memory left"
        raise MemoryError(message)

    told = []
    monkeypatch.setattr("threading.excepthook", told.append)
    monkeypatch.setattr(renewal, "tangent_at", broken)
    body = tr.Body(MESH, MATERIAL)
    registrar = tr.Registrar(body, tr.Markers(PLACES, std=STD), settings=settings(renew_at=1, renewed_after=2))
    after = None
    for k in range(3):
        after = registrar.register(PLACES + 0.1 * (k + 1), after=after)
    assert after.draw.renewal is not None
    with pytest.raises(MemoryError, match="no memory left"):
        registrar.register(PLACES + 0.4, after=after)
    assert told == []


def test_an_earlier_registration_of_another_material_is_no_start():
    markers = PLACES + 0.4 * (PLACES[:, 2:] - PLACES[:, 2:].min()) / 30.0
    soft, stiff, same = (
        tr.Registrar(tr.Body(MESH, material), tr.Markers(PLACES, std=STD), settings=settings())
        for material in (MATERIAL, tr.Material(young=10.0, poisson=0.2), tr.Material(young=10.0, poisson=0.4))
    )
    first, alone = soft.register(markers), stiff.register(markers)
    found = stiff.register(markers, after=first)
    assert found.draw.moments == 1
    assert np.array_equal(found.displacement, alone.displacement)
    assert same.register(markers, after=first).draw.moments == 2


def test_a_marker_that_stays_lost_asks_for_nothing_new():
    # Markers are off the surface: what moves them depends on where the skin was turned to.
    results = chain(lost=(3, 4), renew_at=10**6, as_predicted_on=10.0)
    assert all(len(result.unseen) == 2 for result in results[1:])
    assert all(result.work.get("right_hand_sides", 0) == 0 for result in results[1:])
    assert len({len(result.draw.fit.tangent._kept) for result in results}) == 1


def test_moments_that_go_on_from_one_know_the_same_rows_and_add_to_their_own():
    registrar = tr.Registrar(tr.Body(MESH, MATERIAL), tr.Markers(PLACES, std=STD), settings=settings())
    first = registrar.register(PLACES + 0.1)
    one, other = (registrar.register(PLACES + shift, after=first) for shift in (0.11, 0.12))
    tangents = [result.draw.fit.tangent for result in (first, one, other)]
    n_known = len(tangents[0]._kept)
    assert [len(tangent._kept) for tangent in tangents] == 3 * [n_known]
    deep = [(np.array([20]), np.eye(3)[axis : axis + 1]) for axis in range(3)]
    assert tangents[1].sensed(deep)[1] == 3
    assert [len(tangent._kept) for tangent in tangents] == [n_known, n_known + 3, n_known]
    # Solved once for all of them; the bits are the same.
    assert tangents[2].sensed(deep)[1] == 0
    assert np.array_equal(*(tangent.sensed(deep)[0].compliance.forces for tangent in tangents[1:]))


def test_a_tangent_is_renewed_once_moments_have_lost_as_much_by_it_as_a_new_one_takes():
    old = chain(renew_at=10**6, renewed_needs=2)
    lost = np.cumsum([max(0, result.work["iterations"] - 2) for result in old[1:]])
    assert [result.draw.fit.tangent.spent for result in old] == [0, *lost.tolist()]
    at = int(lost[1])
    assert lost[0] < at
    begun = chain(renew_at=at, renewed_needs=2, renewed_after=2)
    assert [result.draw.renewal is not None for result in begun[:3]] == [False, False, True]
    # The new one has lost nothing yet.
    assert begun[4].draw.fit.tangent.spent == max(0, begun[4].work["iterations"] - 2)


def test_a_moment_beside_a_renewal_leaves_it_a_core_and_has_the_same_bits(monkeypatch):
    held, given = threading.Event(), []

    def waits(*arguments):
        held.wait(10.0)
        return made(*arguments)

    def noted(passes, *arguments):
        given.append(passes.threads)
        return sample(passes, *arguments)

    made, sample, alone = renewal._made, Passes._sample, chain(renew_at=1, renewed_after=2)
    monkeypatch.setattr(renewal, "_made", waits)
    monkeypatch.setattr(Passes, "_sample", noted)
    monkeypatch.setattr(renewal, "n_cores", lambda: 4)
    beside = chain(renew_at=1, renewed_after=2, threads=0, before_use=held.set)
    assert [result.draw.fit.samples[0].tolist() for result in beside] == [
        result.draw.fit.samples[0].tolist() for result in alone
    ]
    assert all(np.array_equal(one.displacement, two.displacement) for one, two in zip(alone, beside, strict=True))
    assert set(given) == {0, 3}


def test_evidence_is_not_weighed_beside_a_renewal(monkeypatch):
    weighed = []
    monkeypatch.setattr(Answer, "_unlike_stated", lambda answer: weighed.append(answer.kept is None) or [])
    chain(renew_at=10**6, every=2)
    assert weighed == [True, False, True, False, True]
    weighed.clear()
    # From the second to the fourth moment one is made, from the fourth on the next.
    chain(renew_at=1, renewed_after=2, every=1)
    assert weighed == [True, True, False, True, False]


def test_solves_near_by_go_side_by_side_with_any_threads():
    simulator = tr.Simulator(MESH)
    here = Linearised(simulator, tr.Load(), MATERIAL, np.zeros_like(MESH.nodes), threads=1)
    loads = [tr.Load(body_force=(0.0, 0.0, size)) for size in (0.01, 0.02, 0.03)]
    alone = [here.solve_near(load).displacement for load in loads]
    with ThreadPoolExecutor(3) as pool:
        found = list(pool.map(lambda load: here.solve_near(load, threads=2).displacement, loads))
    assert all(np.array_equal(one, two) for one, two in zip(alone, found, strict=True))


def test_an_end_that_is_off_the_linear_model_is_linearised_at_once_only_if_it_is_far_off():
    close, far = (chain(renew_at=10**6, as_predicted_on=margin) for margin in (10.0, 0.0))
    assert all(result.work.get("factorisations", 0) == 0 for result in close[1:])
    assert any(result.work.get("factorisations", 0) == 1 for result in far[1:])


@pytest.mark.parametrize("name", ["renew_at", "renewed_needs", "renewed_after", "as_predicted_on"])
def test_settings_of_the_renewal_are_numbers(name):
    with pytest.raises(tr.TissueRegError, match=name):
        replace(PassSettings(), **{name: float("nan")})
