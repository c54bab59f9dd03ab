"""Effects outside the catalogue that a finding must beat: what else could look like it.

No catalogue is whole, and what it lacks is imitated by what it has: a thread that holds a place by a ball of other
stiffness. Four kinds of effects stand for what is outside (`OUTSIDE`). Each has columns, as the hypotheses of a cause
have, and by them its evidence in what the model without a finding leaves. With that evidence the finding has a share of
the probability of all, which is its `Outside.probability`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from scipy import sparse
from scipy.special import softmax

from tissuereg._base.arrays import FloatArray
from tissuereg.body.load import Load
from tissuereg.diagnosis.bench import Bench, State, per_tet
from tissuereg.diagnosis.causes import CAUSES, Variant
from tissuereg.diagnosis.causes.actuators import load_of, motion_of, present_pads
from tissuereg.diagnosis.causes.regions import balls_in, shares_of_balls
from tissuereg.diagnosis.evidence import Blocks, Null, log_mean_exp
from tissuereg.diagnosis.fit import Fit, FitTarget
from tissuereg.diagnosis.nuisances import effect_nuisances
from tissuereg.diagnosis.settings import DiagnoseSettings, OutsideSettings
from tissuereg.diagnosis.signals import thinned_patterns
from tissuereg.simulation.sensitivity import Adjoints
from tissuereg.simulation.solve import Simulator

#: Kinds of effects outside the catalogue in words, and the family of causes that each is one of, if any.
OUTSIDE = {
    "stiffness-field": ("stiffness that varies through the body otherwise than in one ball or layer", "region"),
    "held-place": ("a place of the body that something outside holds", ""),
    "growing-place": ("a place of the body that grows or shrinks", ""),
    "pad-motion": ("a pad that turns, or moves otherwise than in proportion to its command", "actuator"),
}


@dataclass(frozen=True)
class Outside:
    """A finding beside the effects outside the catalogue.

    `log_bayes_factor`: of the cause, nats; `kinds`: that of every kind of effect outside the catalogue in its place,
    nats; `probability`: share of the cause among them; `family_probability`: share of it together with kinds of its
    family.
    """

    id: str
    log_bayes_factor: float
    kinds: Mapping[str, float]
    probability: float
    family_probability: float
    settings: DiagnoseSettings

    @property
    def holds(self) -> bool:
        """Whether the cause may be stated, or at least its family."""
        return self.probability >= self.settings.search.stated or self.holds_family

    @property
    def holds_family(self) -> bool:
        """Whether the family alone may be stated, not the cause."""
        stated = self.settings.search.stated
        return self.settings.outside.least_share <= self.probability < stated <= self.family_probability

    @property
    def nearest(self) -> str | None:
        """The likeliest kind of effect outside the catalogue; None where there is none."""
        return nearest_of(self.kinds)

    def to_json(self) -> dict[str, Any]:
        """Return the comparison as plain data for JSON."""
        nearest = self.nearest
        tested = {one.name: getattr(self, one.name) for one in fields(self) if one.name != "settings"}
        words = OUTSIDE[nearest][0] if nearest else None
        return {**tested, "nearest": words, "nearest_id": nearest, "holds": self.holds}


def nearest_of(kinds: Mapping[str, float]) -> str | None:
    """Return the kind with the largest log Bayes factor; None of none."""
    return max(kinds, key=lambda kind: kinds[kind], default=None)


def outside_variants(bench: Bench) -> dict[str, list[Variant]]:
    """Return the hypotheses of every kind of effect outside the catalogue, with unit amplitudes.

    Those of one kind have the same number of columns. There are none for a body with memory, and none of a kind without
    sizes or places. Costs one adjoint solution for each measured number, and 36 solutions for each pad, in every
    equilibrium.
    """
    if not bench.is_elastic:
        return {}
    mesh, rules, tangents = bench.experiment.mesh, bench.settings.outside, bench.tangents
    centres = mesh.nodes[mesh.tets].mean(axis=1)
    # Relative changes of the modulus of every tet, (n_patterns, n_tets), for each length.
    fields = [thinned_patterns(centres, length * mesh.extent, rules) for length in rules.lengths]
    balls = balls_in(mesh, rules.radii, rules.spacing)
    shares = shares_of_balls(mesh, balls)
    weights, pushes = _springs(bench, shares), _growth(bench, shares)

    def rates(adjoints: Adjoints, displacement: FloatArray) -> FloatArray:
        forces = adjoints.forces
        by_modulus = tangents.by_modulus(adjoints).T
        held = -weights @ (forces * displacement)[:, : mesh.n_nodes].sum(axis=2).T
        grown = pushes @ forces.reshape(len(forces), -1).T
        return np.concatenate([*(field @ by_modulus for field in fields), held, grown])

    lengths = [len(field) for field in fields]
    columns = tangents.by_adjoints(rates, sum(lengths) + 2 * len(balls))
    *blocks, held, grown = np.split(columns, np.cumsum([*lengths, len(balls)]))
    grown = grown * _clock(bench)
    # Columns of zeros change no evidence.
    blocks = [np.pad(one, ((0, max(lengths) - len(one)), (0, 0))) for one in blocks]
    places = [" ".join(f"{x:.0f}" for x in centre) + f" radius {radius:.1f}" for radius, centre in balls]
    found = {
        "stiffness-field": [Variant(f"length {x:g}", one) for x, one in zip(rules.lengths, blocks, strict=True)],
        "held-place": [Variant(at, one[None], positive=True) for at, one in zip(places, held, strict=True)],
        "growing-place": [Variant(at, one[None]) for at, one in zip(places, grown, strict=True)],
        "pad-motion": _pad_variants(bench),
    }
    return {kind: several for kind, several in found.items() if several and rules.sizes(kind)}


def _springs(bench: Bench, shares: "sparse.csr_array") -> "sparse.csr_array":
    """Return the stiffness of a unit of springs at every node of each ball, (n_balls, n_nodes), mN/mm."""
    mesh = bench.experiment.mesh
    corners = (np.ones(mesh.tets.size), (mesh.tets.ravel(), np.repeat(np.arange(mesh.n_tets), 4)))
    to_nodes = sparse.csr_array(corners, shape=(mesh.n_nodes, mesh.n_tets))
    volumes = sparse.csr_array(to_nodes @ (shares * mesh.volumes[:, None])).T
    whole = np.maximum(np.asarray(volumes.sum(axis=1)).ravel(), 1e-300)
    return sparse.csr_array(sparse.diags_array(bench.young * mesh.extent / whole) @ volumes)


def _growth(bench: Bench, shares: "sparse.csr_array") -> "sparse.csr_array":
    """Return the nodal forces (n_balls, 3 n_element_nodes), mN, by which a unit of linear strain of each ball acts."""
    mesh, material = bench.experiment.mesh, bench.tangents.worked.material
    simulator, step = Simulator(mesh, element=bench.predictor.element), 1e-6
    # A body that has grown freely is without stress: the forces are those of a ball that is stretched as much.
    stretched = step * simulator.body.nodes
    young = np.broadcast_to(per_tet(material.young_array), (mesh.n_tets,))
    plain = simulator.internal_forces(stretched, material)
    rows = []
    for share in shares.T.toarray():
        stiffer = simulator.internal_forces(stretched, replace(material, young=young * (1.0 + share)))
        rows.append(sparse.csr_array((stiffer - plain).reshape(1, -1) / step))
    return sparse.csr_array(sparse.vstack(rows)) if rows else sparse.csr_array((0, stretched.size))


def _pad_variants(bench: Bench) -> list[Variant]:
    """Return one hypothesis of 36 columns for each pad that a case moves: it shifts and turns in other ways."""
    pads = [pad for pad in present_pads(bench) if pad.kind == "displacement"]
    most = dict.fromkeys((pad.name for pad in pads), 0.0)
    for case in bench.experiment.cases.values():
        most |= {name: max(most.get(name, 0.0), _largest(motion)) for name, motion in case.displacements.items()}

    def moved(state: State) -> list[Load]:
        # Shifts along and turns about three axes, by each component of the motion, and by that times its relative size.
        loads = []
        for pad in pads:
            nodes = state.simulator.held_nodes[state.pad_rows.get(pad.name, [])]
            arms = bench.experiment.mesh.nodes[nodes]
            arms = arms - (arms.mean(axis=0) if len(arms) else 0.0)
            arms = arms / max(_largest(arms), 1e-300)
            shapes = [*np.broadcast_to(np.eye(3)[:, None], (3, *arms.shape)), *np.cross(np.eye(3)[:, None], arms)]
            motion = motion_of(state, pad)
            for size in (1.0, float(np.linalg.norm(motion)) / max(most[pad.name], 1e-300)):
                loads += [load_of(state, pad, component * shape) for component in size * motion for shape in shapes]
        return loads

    if not pads:
        return []
    columns = bench.by(moved, 36 * len(pads)).reshape(len(pads), 36, -1)
    return [Variant(pad.name, block) for pad, block in zip(pads, columns, strict=True)]


def _largest(rows: FloatArray) -> float:
    """Return the largest length of vectors (n, 3); 0 for none."""
    return float(np.linalg.norm(rows, axis=1).max(initial=0.0))


class OutsideBank:
    """The hypotheses of effects outside the catalogue by kind, whitened by the noise once for any residuals."""

    def __init__(self, bank: Mapping[str, Sequence[Variant]], white: Callable[[FloatArray], FloatArray]) -> None:
        self._positive = {kind: several[0].positive for kind, several in bank.items()}
        self._columns = {kind: white(np.stack([one.columns for one in several])) for kind, several in bank.items()}

    def evidence(self, residual: FloatArray, null: Null, rules: OutsideSettings) -> dict[str, float]:
        """Return the log Bayes factor, nats, of every kind against no effect: the mean over hypotheses and sizes."""
        reduced, found = null.reduced(residual)[None], {}
        for kind, columns in self._columns.items():
            kept, positive = null.reduced(columns), self._positive[kind]
            blocks = [Blocks((size * kept).astype(np.float32), positive=positive) for size in rules.sizes(kind)]
            found[kind] = float(log_mean_exp(np.concatenate([one.log_bayes_factors(reduced)[0] for one in blocks])))
        return found


def outside_tests(
    target: FitTarget, found: Fit, rests: Sequence[Fit | None], null: Null, bank: OutsideBank
) -> list[Outside]:
    """Return the comparison of every cause of a fit with the effects outside the catalogue.

    `target`, `found`: of the last fit; `rests`: fits without each of its causes; one without which there is no
    equilibrium has no rival; `null`: covariance of noise and nuisances, the modulus included. The other causes may be
    off in form as when a further cause is looked for, and in their parameters.
    """
    settings, bench = target.bench.settings, target.bench
    changes = [np.zeros(bench.layout.size) if one is None else found.prediction - one.prediction for one in rests]
    forms = [target.white(effect_nuisances(bench, change)) for change in changes]
    slopes = target.slopes(found)
    tests = []
    for number, (name, rest) in enumerate(zip(found.ids, rests, strict=True)):
        if rest is None:
            tests.append(Outside(name, 0.0, {}, 1.0, 1.0, settings))
            continue
        others = [i for i in range(len(changes)) if i != number]
        errors = [null.nuisances, *(forms[i] for i in others), *(slopes[found.slices()[i]] for i in others)]
        # A cause that is off in form is none the less likely for what fits any change; the tracker's are exact.
        errors += [] if CAUSES[name].closed_form else [forms[number]]
        rough = Null(np.concatenate(errors))
        won = [_won(one, rest.residual, found.residual) for one in (rough, target.null)]
        gain = found.log_evidence - rest.log_evidence + won[0] - won[1]
        kinds = bank.evidence(rest.residual, rough, settings.outside)
        own, *shares = softmax(np.array([gain, *kinds.values()]) / settings.evidence.temper).tolist()
        alike = sum(s for s, kind in zip(shares, kinds, strict=True) if OUTSIDE[kind][1] == CAUSES[name].family)
        tests.append(Outside(name, gain, kinds, own, own + alike, settings))
    return tests


def _won(null: Null, before: FloatArray, after: FloatArray) -> float:
    """Return by how much the log likelihood of a residual `after` exceeds that of the one `before`, nats."""
    return 0.5 * float((null.reduced(before) ** 2).sum() - (null.reduced(after) ** 2).sum())


def _clock(bench: Bench) -> FloatArray:
    """Return the time of every measured number (size,) since the first frame, over the duration of all cases."""
    return (bench.layout.times() - bench.first_time) / max(bench.last_time - bench.first_time, 1e-9)
