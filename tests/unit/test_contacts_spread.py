"""Spread: nodes and points agree, and the model's own error is what other stiffness would do."""

from dataclasses import replace

import numpy as np
import pytest

import tissuereg as tr
from support.pushes import MATERIAL, TIGHT, push
from tissuereg.registration.contacts.spread import Spread, unseen_variances
from tissuereg.registration.contacts.tangent import tangent_at


@pytest.fixture(scope="module")
def result():
    settings = tr.RegisterSettings(contacts=tr.RegisterSettings().contacts.__class__(n_draws=1500))
    return tr.register(tr.Body(push().mesh, material=MATERIAL), push().markers(), settings=replace(settings, threads=1))


@pytest.fixture(scope="module")
def spread(result):
    return result.draw.spread


def rows_of(nodes):
    return [(np.array([node]), np.eye(3)[axis : axis + 1]) for node in nodes for axis in range(3)]


def places_of(fit, nodes):
    return fit.columns.body.mesh.nodes[nodes] + fit.state.displacement[nodes]


def free_nodes(count):
    mesh = push().mesh
    return np.random.default_rng(1).choice(np.flatnonzero(mesh.nodes[:, 2] > 4.0), count, replace=False)


def test_the_spread_of_nodes_is_the_covariance_of_points_there(result, spread):
    mesh = push().mesh
    base = mesh.nodes[mesh.fixed_nodes]
    rim = mesh.fixed_nodes[(base[:, :2].min(axis=1) == 0.0) | (base[:, :2].max(axis=1) == 60.0)]
    nodes = np.concatenate([free_nodes(25), rim[:10]])
    fit = spread._fit
    found = spread.points(rows_of(nodes), places_of(fit, nodes))
    wanted = np.sqrt(np.trace(found.covariance, axis1=1, axis2=2))
    # 1,500 draws of a heavy-tailed mixture: a few percent.
    assert result.std[nodes] == pytest.approx(wanted, rel=0.12)
    assert np.mean(result.std[nodes] / wanted) == pytest.approx(1.0, abs=0.04)
    assert result.std[rim].all()
    # The tracker may have drifted: what is held moves as a whole; what no load explains leaves it where it is.
    inner = np.setdiff1d(mesh.fixed_nodes, rim)
    assert result.std[inner].max() < 0.7 * result.std[rim].max()
    assert spread._rest[mesh.fixed_nodes].max() < 1e-3 * spread._rest.max()


def test_many_points_have_the_regions_that_each_would_have_alone(spread):
    fit, nodes = spread._fit, free_nodes(60)
    rows, places = rows_of(nodes), places_of(fit, nodes)
    one_by_one = spread.points(rows, places)
    many = Spread(fit, replace(spread._settings, most_exact=59), 1).points(rows, places)
    assert Spread(fit, replace(spread._settings, most_exact=60), 1).points(rows, places).covariance == pytest.approx(
        one_by_one.covariance
    )
    wanted = np.trace(one_by_one.covariance, axis1=1, axis2=2)
    ratio = np.trace(many.covariance, axis1=1, axis2=2) / wanted
    assert np.abs(ratio - 1.0).max() < 0.3
    assert ratio.mean() == pytest.approx(1.0, abs=0.06)
    # Off the diagonal, too: a region's direction is that of the covariance.
    off = np.linalg.norm(many.covariance - one_by_one.covariance, axis=(1, 2))
    assert np.median(off / wanted) < 0.1
    assert np.abs(many.constrained - one_by_one.constrained).max() < 0.15
    assert many.unseen_std == pytest.approx(one_by_one.unseen_std, rel=0.3)
    assert np.array_equal(spread.points(rows, places).covariance, one_by_one.covariance)


def test_errors_of_the_model_are_slopes_of_solves(spread):
    fit, nodes = spread._fit, free_nodes(4)
    simulator, load = fit.columns.body.simulator, fit.columns.load(fit.state.coefficients)
    # At the end itself: the passes may have kept the tangent where the last step began.
    here, _ = tangent_at(fit.columns, MATERIAL, fit.state, 1)
    exact = Spread(replace(fit, tangent=here), spread._settings, 1)
    found = exact._by_model(here.sensed(rows_of(nodes))[0])
    assert np.abs(found - spread._by_model(fit.tangent.sensed(rows_of(nodes))[0])).max() < 0.1 * np.abs(found).max()
    step = 0.02

    def moved(sign):
        material = tr.Material(8.0, 0.4 + sign * step * 0.02)
        return simulator.solve(load, material, start=fit.state.displacement, **TIGHT).displacement[nodes].ravel()

    edges = spread._edges
    assert found.shape == (12, 1 + len(edges))
    for k in (0, len(edges) // 2):
        ends = [
            simulator.solve(
                tr.Load(load.forces, load.body_force, prescribed=load.prescribed + sign * step * edges[k]),
                MATERIAL,
                start=fit.state.displacement,
                **TIGHT,
            ).displacement[nodes]
            for sign in (1, -1)
        ]
        slope = (ends[0] - ends[1]).ravel() / (2 * step)
        assert np.abs(found[:, 1 + k] - slope).max() < 2e-3 * np.abs(slope).max(), k
    slope = (moved(1) - moved(-1)) / (2 * step)
    assert np.abs(found[:, 0] - slope).max() < 2e-3 * np.abs(slope).max()


def test_a_change_of_the_stiffness_is_the_slope_of_solves(spread):
    fit, nodes = spread._fit, free_nodes(4)
    body, load, step = fit.columns.body, fit.columns.load(fit.state.coefficients), 0.02
    here, _ = tangent_at(fit.columns, MATERIAL, fit.state, 1)
    rows = rows_of(nodes)
    found = fit.columns.responses(here.sensed(rows)[0], places_of(fit, nodes), beside=(rows, here.stiffness_forces))
    block = next(family.columns for family in fit.columns.families if family.name == "stiffness")
    for k, profile in enumerate(body.profiles):
        ends = [
            body.simulator.solve(
                load, MATERIAL.scaled(np.exp(sign * step * profile)), start=fit.state.displacement, **TIGHT
            ).displacement[nodes]
            for sign in (1, -1)
        ]
        slope = (ends[0] - ends[1]).ravel() / (2 * step)
        assert np.abs(found[:, block][:, k] - slope).max() < 2e-3 * np.abs(slope).max(), k
        assert here.by_stiffness[k][nodes].ravel() == pytest.approx(found[:, block][:, k], rel=1e-3, abs=1e-6)


def test_the_model_is_part_of_the_covariance_and_markers_take_most_of_it_back(spread):
    fit = spread._fit
    alone = Spread(fit, replace(spread._settings, unseen_chance=0.0), 1)
    at_data = alone._by_model(fit.tangent.sensed(fit.observations.rows)[0])
    for nodes, most in ((push().nodes, 0.35), (free_nodes(10), 1.0)):
        rows = rows_of(nodes)
        sensed = fit.tangent.sensed(rows)[0]
        responses = fit.columns.responses(sensed, places_of(fit, nodes), beside=(rows, fit.tangent.stiffness_forces))
        _, gain, means, contacts, *_ = fit.sampler.moments(list(fit.samples), np.ascontiguousarray(responses))
        off = means - (responses @ fit.state.coefficients).reshape(-1, 3)
        contacts = contacts + np.einsum("pa,pb->pab", off, off)
        # What no load explains and no marker sees is not the model's error.
        contacts[:, [0, 1, 2], [0, 1, 2]] += alone._rest[nodes, None]
        turn = fit.state.frame.rotation
        model = turn.T @ alone.points(rows, places_of(fit, nodes)).covariance @ turn - contacts
        by_model = alone._by_model(sensed)
        # What the error does to a point, and what it does to the markers, through the gain.
        left = (by_model - responses @ gain @ at_data).reshape(len(nodes), 3, -1)
        wanted = np.einsum("pak,pbk->pab", left, left)
        assert np.abs(model - wanted).max() < 1e-8 * np.abs(wanted).max()
        # Where a marker sits, a load that is not there undoes what the stiffness did; elsewhere a good part of it.
        assert 0.0 < np.trace(wanted, axis1=1, axis2=2).sum() < most * (by_model**2).sum()


def test_a_point_at_a_marker_is_constrained_and_one_more_contact_leaves_little(spread):
    fit, nodes = spread._fit, push().nodes
    near = spread.points(rows_of(nodes), places_of(fit, nodes))
    assert near.constrained.min() > 0.9
    everywhere = spread.points(rows_of(free_nodes(60)), places_of(fit, free_nodes(60)))
    assert ((everywhere.constrained >= 0) & (everywhere.constrained <= 1)).all()
    assert everywhere.constrained.min() < near.constrained.min()
    assert everywhere.unseen_std.max() > 2 * near.unseen_std.max()


def test_an_unseen_contact_is_anywhere_alike_and_a_share_of_its_radius(spread):
    patches, settings = spread._fit.columns.body.patches, spread._settings
    found = unseen_variances(patches, settings, spread._fit.columns.n_columns)
    of_patch = found[: 3 * patches.n_patches].reshape(-1, 3)
    likely = of_patch.sum(axis=1) / (settings.unseen_share * patches.radii) ** 2
    assert likely.sum() == pytest.approx(1.0)
    assert np.bincount(patches.level, likely) == pytest.approx(1.0 / (patches.level.max() + 1))
    assert np.ptp(of_patch, axis=1).max() == 0.0
    assert not found[3 * patches.n_patches :].any()


def test_room_for_an_unseen_contact_is_in_the_regions(spread):
    fit, nodes = spread._fit, free_nodes(40)
    rows, places = rows_of(nodes), places_of(spread._fit, nodes)
    whole = spread.points(rows, places)
    without = Spread(fit, replace(spread._settings, unseen_chance=0.0), 1).points(rows, places)
    room = np.trace(whole.covariance - without.covariance, axis1=1, axis2=2)
    assert room == pytest.approx(spread._settings.unseen_chance * whole.unseen_std**2)
    # The textbook's covariance of a linear Gaussian model.
    responses = fit.columns.responses(fit.tangent.sensed(rows)[0], places)
    prior = np.diag(unseen_variances(fit.columns.body.patches, spread._settings, fit.columns.n_columns))
    own = fit.observations.responses
    left = prior - prior @ own.T @ np.linalg.solve(
        own @ prior @ own.T + np.diag(fit.observations.variances), own @ prior
    )
    wanted = np.einsum("pc,cd,pd->p", responses, left, responses).reshape(-1, 3).sum(axis=1)
    assert whole.unseen_std**2 == pytest.approx(wanted, rel=1e-6)
    before = np.einsum("pc,c,pc->p", responses, np.diag(prior), responses).reshape(-1, 3).sum(axis=1)
    assert whole.constrained == pytest.approx(1.0 - wanted / before, abs=1e-6)


def test_one_more_contact_widens_regions_where_markers_tell_little(spread):
    rows, places = rows_of(free_nodes(80)), places_of(spread._fit, free_nodes(80))
    whole = spread.points(rows, places)
    without = Spread(spread._fit, replace(spread._settings, unseen_chance=0.0), 1).points(rows, places)
    wider = np.trace(whole.covariance, axis1=1, axis2=2) / np.trace(without.covariance, axis1=1, axis2=2)
    least = np.argsort(whole.constrained)[:20]
    assert wider.min() >= 1.0
    assert np.median(wider[least]) > 1.02


def test_an_answer_that_is_not_the_mean_of_the_samples_has_wider_regions(spread):
    fit, nodes = spread._fit, free_nodes(12)
    rows, places = rows_of(nodes), places_of(spread._fit, nodes)
    responses = fit.columns.responses(fit.tangent.sensed(rows)[0], places, beside=(rows, fit.tangent.stiffness_forces))
    shift = np.zeros(fit.columns.n_columns)
    shift[3 * push().patch + 2] = 0.7
    away = replace(fit, state=replace(fit.state, coefficients=fit.state.coefficients + shift))
    turn = fit.state.frame.rotation
    here, there = (
        turn.T @ Spread(one, spread._settings, 1).points(rows, places).covariance @ turn for one in (fit, away)
    )
    means = np.asarray(fit.sampler.moments(list(fit.samples), np.ascontiguousarray(responses))[2])
    off, farther = (means - (responses @ one.state.coefficients).reshape(-1, 3) for one in (fit, away))
    wanted = np.einsum("pa,pb->pab", farther, farther) - np.einsum("pa,pb->pab", off, off)
    assert np.abs(wanted).max() > 1e-3
    assert there - here == pytest.approx(wanted, rel=1e-6, abs=1e-9)


def test_drawn_coefficients_have_the_mean_and_the_gain_of_the_moments(spread):
    fit = spread._fit
    drawn = spread.coefficients(np.random.default_rng(0), 4000)
    mean, gain, *_ = fit.sampler.moments(list(fit.samples), np.zeros((0, fit.columns.n_columns)))
    error = drawn.std(axis=0) / np.sqrt(len(drawn))
    assert (np.abs(drawn.mean(axis=0) - mean) < 6 * error + 1e-12).all()
    assert gain.shape == (fit.columns.n_columns, len(fit.observations.variances))


def test_what_was_sought_of_supports_stays_uncertain_in_the_regions():
    target = {"deep": (40.0, 20.0, 9.0)}
    body = tr.Body(push().mesh, MATERIAL, held="perhaps")
    found = tr.register(body, push().markers(), targets=target, settings=tr.RegisterSettings(threads=1))
    draw = found.draw
    alone = Spread(draw.fit, draw.spread._settings, 1)
    nodes = free_nodes(10)
    rows, places = rows_of(nodes), places_of(draw.fit, nodes)
    whole, without = (one.points(rows, places).covariance for one in (draw.spread, alone))
    more = np.trace(whole - without, axis1=1, axis2=2)
    assert more.min() >= -1e-12 * np.trace(whole, axis1=1, axis2=2).max()
    assert more.max() > 1e-6
