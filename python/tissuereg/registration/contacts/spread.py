"""Uncertainty of a registration: covariance of points and nodes, and how much the markers constrain a point.

The covariance of a point has four parts. The first, from all causes, is the mixture over samples. The second is the
effect of an error in Poisson's ratio on the answer: it moves the point and the markers, and the fit's reaction to the
markers moves the point once more, through the gain; so does an error of where a sure support ends. The third is the
rest of a displacement that no load explains. The fourth allows for one more contact, anywhere, that no sample contains
because no marker detected it: its variance given the markers, times a probability.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.body.load import Load
from tissuereg.registration.contacts.fit import ContactFit
from tissuereg.registration.contacts.patches import Patches
from tissuereg.registration.contacts.places import smooth_fields
from tissuereg.registration.contacts.sensed import Row, Sensed
from tissuereg.registration.contacts.settings import DISCRETISATION, EFFORT, ContactSettings
from tissuereg.registration.contacts.tangent import Uncertain
from tissuereg.registration.deviations import Deviations
from tissuereg.simulation.sensitivity import ModulusField

if TYPE_CHECKING:
    from scipy.sparse import csr_array


@dataclass(frozen=True, eq=False)
class Points:
    """Uncertainty of points of the body.

    `covariance` (n_points, 3, 3): covariance of the places by contacts and model errors, in the tracker's frame, mm^2;
    `constrained` (n_points,): share of the variance under one more, unseen contact that the markers remove, 0 to 1;
    `unseen_std` (n_points,): standard deviation due to such a contact, given the markers, mm.
    """

    covariance: FloatArray
    constrained: FloatArray
    unseen_std: FloatArray


class Spread:
    """Covariances of points and nodes for one fit.

    `fit`: contacts and equilibrium that were found; `settings`: uncertainty of the model; `threads`: threads to use, 0
    takes all cores; `further`: other uncertain parameters of the model, each with its standard deviation in the
    parameter's unit.
    """

    def __init__(
        self,
        fit: ContactFit,
        settings: ContactSettings,
        threads: int,
        further: Sequence[tuple[Uncertain, float]] = (),
    ) -> None:
        self._fit, self._settings, self._threads = fit, settings, threads
        poisson = ModulusField("poisson", np.full(fit.columns.body.mesh.n_tets, settings.poisson_std))
        self._errors = [(poisson, 1.0), *further]
        self._of_supports = _support_errors(fit, settings)
        self._edges = edge_errors(fit)
        self._model_at_data = self._by_model(self._sensed(fit.observations.rows))
        self._suggested: FloatArray | None = None
        self._known: dict[int, Deviations] = {}
        self._unseen_known: dict[int, FloatArray] = {}
        self._unseen_variances = unseen_variances(fit.columns.body.patches, settings, fit.columns.n_columns)

    @cached_property
    def _model_forces(self) -> FloatArray:
        """Unbalanced nodal forces (n_errors, n_element_nodes, 3), mN, by one standard deviation of each model error."""
        of_causes = [-scale * self._fit.tangent.unbalanced(cause) for cause, scale in self._errors]
        return np.concatenate([of_causes, self._of_supports])

    def _sensed(self, rows: Sequence[Row]) -> Sensed:
        found, solved = self._fit.tangent.sensed(rows)
        self._fit.counters["right_hand_sides"] += solved
        return found

    def _moments(self, responses: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return means (n_points, 3), mm, and covariances (n_points, 3, 3), mm^2, of points over the posterior samples.

        `responses` (3 n_points, n_columns): displacement of the points by a unit coefficient of every cause, mm. Third
        result: change of the coefficients by which the fit answers each error of the model, (n_columns, n_errors); it
        does not depend on the points.
        """
        fit = self._fit
        _, gain, means, covariance, *_ = fit.sampler.moments(
            list(fit.samples), np.ascontiguousarray(responses), threads=self._threads
        )
        self._suggested = np.asarray(gain @ self._model_at_data)
        return means, covariance, self._suggested

    def _by_model(self, sensed: Sensed) -> FloatArray:
        """Return the displacement of observations by one standard deviation of each model error, (n_rows, n_errors).

        The unit is mm. `sensed`: sensitivities of the observations to nodal forces.
        """
        parts = [-scale * self._fit.tangent.by_cause(sensed, cause)[:, None] for cause, scale in self._errors]
        if len(self._of_supports):
            parts.append(sensed.image(None, lambda one: _products(one.forces, self._of_supports)))
        if len(self._edges):
            parts.append(_products(sensed.image("prescribed", lambda one: one.prescribed), self._edges))
        return np.concatenate(parts, axis=1)

    def points(self, rows: Sequence[Row], places: FloatArray, seed: int = 0) -> Points:
        """Return the uncertainty of points: covariances, mm^2, and how much the markers constrain them.

        `rows`: nodes (k,) and weights (k, 3) of x, y and z of each point; `places` (n_points, 3): their positions in
        the body's frame, mm; `seed`: of the draws that stand for many points. Cost: one right-hand side per row, or
        per draw.
        """
        fit = self._fit
        if len(places) > self._settings.most_exact:
            return self._points_by_draws(rows, seed)
        sensed = self._sensed(rows)
        responses = fit.columns.responses(sensed, places, beside=(list(rows), fit.tangent.stiffness_forces))
        means, covariance, suggested = self._moments(responses)
        # Second moment about the answer, which is not quite the mean of the last linearisation.
        off = means - (responses @ fit.state.coefficients).reshape(-1, 3)
        covariance = covariance + np.einsum("pa,pb->pab", off, off)
        remaining = self._by_model(sensed) - responses @ suggested
        remaining = remaining.reshape(len(places), 3, remaining.shape[1])
        covariance = covariance + np.einsum("pak,pbk->pab", remaining, remaining)
        return self._with_unseen(covariance, rows, *self._unseen(responses))

    def _with_unseen(
        self, covariance: FloatArray, rows: Sequence[Row], unseen: FloatArray, before: FloatArray
    ) -> Points:
        """Return the uncertainty of points with that by what no marker sees, from their covariances, mm^2.

        `covariance` (n, 3, 3): by causes that were found and errors of the model; `unseen` (n, 3, 3), `before` (n,): by
        one more contact given the markers, and its trace without them.
        """
        left = [self._rest[nodes] @ np.abs(weights[:, row % 3]) for row, (nodes, weights) in enumerate(rows)]
        covariance[:, [0, 1, 2], [0, 1, 2]] += np.reshape(left, (-1, 3))
        turn = self._fit.state.frame.rotation
        covariance = covariance + self._settings.unseen_chance * unseen
        square = np.maximum(np.trace(unseen, axis1=1, axis2=2), 0.0)
        return Points(turn @ covariance @ turn.T, 1.0 - square / np.maximum(before, 1e-300), np.sqrt(square))

    def _points_by_draws(self, rows: Sequence[Row], seed: int) -> Points:
        """Return the uncertainty of many points from that of nodes; standard deviations are within some per cent."""
        n_nodes, drawn = self._fit.columns.body.mesh.n_nodes, self.deviations(seed)
        read = _reader(rows, n_nodes)
        covariance = np.zeros((len(rows) // 3, 3, 3))
        for mode in drawn.modes:
            moved = (read @ mode.ravel().astype(np.float64)).reshape(-1, 3)
            covariance += moved[:, :, None] * moved[:, None]
        # The variances of points between nodes, as those of the nodes around them.
        around = abs(read)
        covariance[:, [0, 1, 2], [0, 1, 2]] += (around @ drawn.rest.ravel().astype(np.float64)).reshape(-1, 3)
        after, before = ((around @ np.repeat(one / 3.0, 3)).reshape(-1, 3).sum(axis=1) for one in self._unseen_of(seed))
        return Points(covariance, 1.0 - after / np.maximum(before, 1e-300), np.sqrt(after))

    def _unseen_of(self, seed: int) -> FloatArray:
        """Return the variance of every node, mm^2, by one more contact: given the markers, and without them, (2, n)."""
        if seed not in self._unseen_known:
            rng = np.random.default_rng([seed, 11])
            both = self._unseen_draws(rng, self._settings.n_draws // 2)
            found = [np.sum(self._fields(drawn, None) ** 2, axis=(0, 2)) / len(drawn) for drawn in both]
            self._unseen_known[seed] = np.array(found)
        return self._unseen_known[seed]

    def _fields(self, change: FloatArray, errors: FloatArray | None) -> FloatArray:
        """Return the displacement fields (n, n_nodes, 3), mm, by changes of coefficients (n, n_columns) and errors.

        `errors` (n, n_errors): in standard deviations; None for none.
        """
        n_forces = len(self._model_forces)
        forces = np.zeros((1, *self._model_forces.shape[1:]))
        if errors is not None:
            forces = np.tensordot(errors[:, :n_forces], self._model_forces, 1)
        fields = linear_fields(self._fit, change, forces)[:, : self._fit.columns.body.mesh.n_nodes]
        if errors is not None and len(self._edges):
            fields = fields + np.tensordot(errors[:, n_forces:], self._edge_fields, 1)
        return fields

    @cached_property
    def _edge_fields(self) -> FloatArray:
        """Displacement by each error of where a sure support ends, (n_edges, n_nodes, 3), mm."""
        columns = self._fit.columns
        none = np.zeros((1, *self._model_forces.shape[1:]))
        return np.concatenate(
            [
                linear_fields(self._fit, np.zeros((len(edges), columns.n_columns)), none, edges)[
                    :, : columns.body.mesh.n_nodes
                ]
                for edges in (self._edges[some] for some in _in_parts(len(self._edges)))
            ]
        )

    @cached_property
    def _reaction(self) -> FloatArray:
        """Change of the coefficients by which the fit answers each error of the model, (n_columns, n_errors)."""
        suggested = self._suggested
        return self._moments(np.zeros((0, self._fit.columns.n_columns)))[2] if suggested is None else suggested

    @cached_property
    def _rest(self) -> FloatArray:
        """Variance at every node of what no load explains and no marker sees, (n_nodes,), mm^2."""
        columns = self._fit.columns
        if columns.unexplained is None:
            return np.zeros(columns.body.mesh.n_nodes)
        return np.asarray(columns.rest_sizes(self._fit.samples[1]).mean() * columns.unexplained.left)

    def rest_draws(self, rng: np.random.Generator, count: int) -> FloatArray:
        """Return drawn displacements (count, n_nodes, 3), mm, that no load explains and no marker sees."""
        columns = self._fit.columns
        if columns.unexplained is None:
            return np.zeros((count, columns.body.mesh.n_nodes, 3))
        fields = columns.unexplained.rest
        sizes = np.sqrt(self._sizes(count))[:, None, None]
        return np.asarray(sizes * (fields @ rng.standard_normal((count, fields.shape[1], 3))))

    @cached_property
    def _under_unseen(self) -> FloatArray:
        """Cholesky factor (n_obs, n_obs), mm, of the observations' covariance by noise and one contact anywhere."""
        own = self._fit.observations.responses
        return np.asarray(
            np.linalg.cholesky((own * self._unseen_variances) @ own.T + np.diag(self._fit.observations.variances))
        )

    def _unseen(self, responses: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return how far one more contact, which no marker detected, may move points.

        `responses` (3 n, n_columns): displacement of the points by a unit coefficient of every cause, mm. Result:
        covariance (n, 3, 3) given the markers, and its trace (n,) without them, mm^2.
        """
        cross = (responses * self._unseen_variances) @ self._fit.observations.responses.T
        taken = np.linalg.solve(self._under_unseen, cross.T).T.reshape(len(cross) // 3, 3, cross.shape[1])
        scaled = (responses * np.sqrt(self._unseen_variances)).reshape(len(taken), 3, responses.shape[1])
        before, after = (np.matmul(part, np.moveaxis(part, 1, 2)) for part in (scaled, taken))
        return before - after, np.trace(before, axis1=1, axis2=2)

    def _unseen_draws(self, rng: np.random.Generator, count: int) -> tuple[FloatArray, FloatArray]:
        """Return drawn coefficients, mm, of one more contact that the markers did not detect, and of one anywhere.

        Both are of shape (count, n_columns).
        """
        own, variances = self._fit.observations.responses, self._unseen_variances
        drawn = np.sqrt(variances) * rng.standard_normal((count, len(variances)))
        measured = drawn @ own.T + np.sqrt(self._fit.observations.variances) * rng.standard_normal((count, len(own)))
        half = np.linalg.solve(self._under_unseen, measured.T)
        return np.asarray(drawn - (variances * (own.T @ np.linalg.solve(self._under_unseen.T, half)).T)), drawn

    def deviations(self, seed: int, fields: FloatArray | None = None) -> Deviations:
        """Return the uncertainty of the displacement of every node, in the tracker's frame, from draws.

        `seed`: of all random numbers; `fields` (n_draws, n_nodes, 3): posterior displacement fields in equilibrium, in
        the tracker's frame, mm; if None, fields are drawn from the linear model. It holds contacts and model errors.
        Cost: one right-hand side per draw.
        """
        if fields is None and seed in self._known:
            return self._known[seed]
        fit, rng = self._fit, np.random.default_rng([seed, 9])
        turn, count = fit.state.frame.rotation, self._settings.n_draws
        drawn = np.zeros((count, fit.columns.n_columns))
        if fields is None:
            drawn = self.coefficients(rng, count) - fit.state.coefficients
        errors = rng.standard_normal((count, len(self._model_forces) + len(self._edges)))
        # The fit's reaction to an error moves the nodes as a change of the coefficients does.
        drawn = drawn - errors @ self._reaction.T
        drawn += np.sqrt(self._settings.unseen_chance) * self._unseen_draws(rng, count)[0]
        roots = np.concatenate([self._fields(drawn[some], errors[some]) @ turn.T for some in _in_parts(count)])
        missed = np.zeros(fit.columns.body.mesh.n_nodes)
        if fields is None:
            roots = (roots + self.rest_draws(rng, count)) / np.sqrt(count)
            if fit.columns.unexplained is not None:
                missed = fit.columns.rest_sizes(fit.samples[1]).mean() * fit.columns.unexplained.missed
        else:
            off = (fields - fields.mean(axis=0)) / np.sqrt(max(1, len(fields) - 1))
            roots = np.concatenate([roots / np.sqrt(count), off])
        after, before = self._unseen_of(seed)
        least = self._settings.report.least_constrained
        found = Deviations.of(roots, after - (1.0 - least) * before, besides=missed)
        if fields is None:
            self._known[seed] = found
        return found

    def coefficients(self, rng: np.random.Generator, count: int) -> FloatArray:
        """Return coefficients of the causes drawn from the posterior, shape (count, n_columns), in mm."""
        fit = self._fit
        n_obs, order = len(fit.observations.variances), self._order(count)
        chosen = [np.ascontiguousarray(part[order]) for part in fit.samples]
        normals = rng.standard_normal((count, fit.columns.n_columns + n_obs))
        return np.asarray(fit.sampler.draws(chosen, normals, threads=self._threads))

    def _order(self, count: int) -> IntArray:
        """Return the samples that drawn coefficients take in turn, int64 (n,): at most `count`, from all chains."""
        n_samples = len(self._fit.samples[0])
        if count >= n_samples:
            return np.arange(n_samples)
        return np.asarray((np.arange(count) * max(1, n_samples // count)) % n_samples)

    def _sizes(self, count: int) -> FloatArray:
        """Return the variance, mm^2, of a displacement that no load explains, in the sample of each draw, (count,)."""
        sizes = self._fit.columns.rest_sizes(self._fit.samples[1])[self._order(count)]
        return np.asarray(sizes[np.arange(count) % len(sizes)])


def _reader(rows: Sequence[Row], n_nodes: int) -> "csr_array":
    """Return the matrix (n_rows, 3 n_nodes) that reads observations from a displacement field."""
    from scipy.sparse import csr_array

    nodes, weights = [nodes for nodes, _ in rows], np.concatenate([weights for _, weights in rows])
    places = 3 * np.concatenate(nodes)[:, None] + np.arange(3)
    numbers = np.repeat(np.arange(len(rows)), [3 * len(one) for one in nodes])
    return csr_array((weights.ravel(), (numbers, places.ravel())), shape=(len(rows), 3 * n_nodes))


def _in_parts(count: int) -> Iterator[slice]:
    """Yield slices that divide `count` rows into blocks: whole displacement fields are large and are made in blocks."""
    for first in range(0, count, EFFORT.fields_at_once):
        yield slice(first, min(first + EFFORT.fields_at_once, count))


def _products(rates: FloatArray, errors: FloatArray) -> FloatArray:
    """Return the sums (n_rows, n_errors) over nodes and axes of rates (n_rows, n, 3) times errors (n_errors, n, 3)."""
    size = rates.shape[1] * rates.shape[2]
    return np.asarray(rates.reshape(-1, size) @ errors.reshape(-1, size).T)


def unseen_variances(patches: Patches, settings: ContactSettings, n_columns: int) -> FloatArray:
    """Return the variances (n_columns,), mm^2, of the coefficients under one more contact, anywhere as in the prior."""
    count = np.bincount(patches.level)
    likely = 1.0 / (len(count) * count[patches.level])
    variances = np.zeros(n_columns)
    variances[: 3 * patches.n_patches] = np.repeat(likely * (settings.unseen_share * patches.radii) ** 2 / 3.0, 3)
    return variances


def linear_fields(
    fit: ContactFit, change: FloatArray, forces: FloatArray, held: FloatArray | None = None
) -> FloatArray:
    """Return the displacement fields (n, n_element_nodes, 3), mm, that changes of the load cause, to first order.

    `fit`: the fit, with the linearised equilibrium; `change` (n, n_columns): changes of coefficients; `forces` (n,
    n_element_nodes, 3): further nodal forces, mN; `held` (n, n_held, 3): motions of the held nodes, mm; None for none.
    """
    columns, linearised = fit.columns, fit.tangent.linearised
    total = np.ascontiguousarray(forces + columns.forces(change))
    if held is None:
        fields = linearised.responses(total)
    else:
        causes = [Load(forces=one, prescribed=moved) for one, moved in zip(total, held, strict=True)]
        fields = linearised.derivatives(causes).all_displacement
    if columns.moves:
        places = columns.body.simulator.body.nodes + fit.state.displacement
        rigid = columns.rigid_field(places)
        frames = np.stack([columns.frame(one) for one in change])
        fields = fields + np.tensordot(frames, rigid, 1)
    for part in columns.beside(change, fit.tangent.by_stiffness).values():
        fields[:, : columns.body.mesh.n_nodes] += part
    return np.asarray(fields)


def _support_errors(fit: ContactFit, settings: ContactSettings) -> FloatArray:
    """Return the nodal forces (n_fields, n_element_nodes, 3), mN, by errors of the doubtful supports' stiffness.

    Each is one standard deviation along a smooth field; there are none if no support is doubtful.
    """
    columns = fit.columns
    simulator = columns.body.simulator
    if columns.body.base is None or columns.springs is None:
        return np.zeros((0, simulator.body.n_nodes, 3))
    forces = np.asarray(simulator.spring_forces(fit.state.displacement, springs=columns.springs)).sum(axis=0)
    nodes = np.flatnonzero(np.abs(forces).max(axis=1) > 0.0)
    if not len(nodes):
        return np.zeros((0, simulator.body.n_nodes, 3))
    smooth = smooth_fields(simulator.body.nodes[nodes], DISCRETISATION.support_fields)
    fields = np.zeros((len(smooth), simulator.body.n_nodes))
    fields[:, nodes] = smooth
    return np.asarray(settings.support_log_std * fields[:, :, None] * forces)


def edge_errors(fit: ContactFit) -> FloatArray:
    """Return motions (n_fields, n_held, 3), mm, of the surely held nodes by errors of where their support ends.

    Each is one standard deviation along a smooth field and a principal axis: where the edge lies about an element
    elsewhere, the nodes at it move as their free neighbours do. There are none if no node is surely held.
    """
    body = fit.columns.body
    n_nodes, edge = body.mesh.n_nodes, body.held_edge
    none = np.zeros((0, len(body.supports.sure), 3))
    if edge is None:
        return none
    moved = fit.state.displacement[edge.free]
    if not moved.any():
        return none
    square = np.zeros((n_nodes, 3, 3))
    np.add.at(square, edge.at, moved[:, :, None] * moved[:, None])
    count = np.bincount(edge.at, minlength=n_nodes)[edge.rim, None, None]
    values, ways = np.linalg.eigh(square[edge.rim] / count)
    ways *= np.sqrt(np.maximum(values, 0.0))[:, None]
    fields = np.zeros((3 * len(edge.smooth), len(edge.rim) + 1, 3))  # the last column is of all nodes off the rim
    fields[:, :-1] = np.einsum("fn,nxk->fknx", edge.smooth, ways).reshape(-1, len(edge.rim), 3)
    return np.asarray(fields[:, edge.column])


__all__ = ["Points", "Spread", "linear_fields", "unseen_variances"]
