"""Regions of another modulus than their surroundings: a ball inside the body, and an outer layer."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.spatial import KDTree

from tissuereg._base.arrays import FloatArray
from tissuereg.body.mesh import Mesh
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.causes.base import Cause, FreeParameters, Values, Variant, free_parameters
from tissuereg.diagnosis.causes.numbers import logistic, logit, three
from tissuereg.experiment.effects import Inclusion, Layer
from tissuereg.experiment.effects.regions import OuterLayer, share_inside

#: Radius and centre, mm.
Ball = tuple[float, tuple[float, float, float]]


@dataclass(frozen=True)
class InclusionCause(Cause, id="inclusion", family="region"):
    """A ball of another modulus, at any place."""

    #: Radii of the hypotheses, over the extent of the body.
    radii: tuple[float, ...] = (0.045, 0.075, 0.115)
    #: Spacing of the grid of centres, over the radius.
    spacing: float = 1.3
    #: Prior deviation of contrast - 1 in the linear range; the effect saturates beyond.
    spread: float = 1.5
    #: Least value of contrast - 1 at the start of a fit.
    least_excess: float = 0.05

    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return one hypothesis, linear in the contrast, for each radius and centre on a grid; none with memory."""
        if not bench.is_elastic:
            return
        balls = balls_in(bench.experiment.mesh, self.radii, self.spacing)
        columns = bench.by_fields(shares_of_balls(bench.experiment.mesh, balls))
        for (radius, centre), column in zip(balls, columns, strict=True):
            label = f"at {' '.join(f'{x:.0f}' for x in centre)} radius {radius:.1f}"
            yield Variant(label, self.spread * column[None], {"centre": centre, "radius": radius})

    def free_parameters(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> FreeParameters:
        """Return five free parameters: centre (3,) in mm, logarithm of the radius in mm, and strength of the contrast.

        The strength is the logarithm of ``contrast - 1`` for a stiff ball, and the logit of ``1 - contrast`` for a soft
        one. A small ball of high contrast and a large one of low contrast have nearly the same effect; in these
        logarithms that valley of the objective is straight.
        """
        centre, radius = np.asarray(variant.settings["centre"]), float(variant.settings["radius"])
        middle = bench.experiment.mesh.nodes.mean(axis=0)
        # In a thin direction of the body the prior and the step are limited by the thickness.
        lengths, extent = np.ptp(bench.experiment.mesh.nodes, axis=0), bench.extent
        wide, step = np.minimum(0.25 * extent, 0.5 * lengths), np.minimum(0.01 * extent, 0.1 * lengths)
        # A stiff ball in a soft body saturates: its effect is (c - 1) / (1 + 0.4 (c - 1)) for small strain.
        linear = float(np.clip(self.spread * amplitudes[0], -0.85, 1.8))
        excess = linear / max(1.0 - 0.4 * linear, 0.2)
        strength = float(np.log(max(excess, self.least_excess))) if excess > 0.0 else logit(-excess)

        def effect(x: FloatArray, young: float) -> tuple[Inclusion]:
            size, contrast = float(np.exp(x[3])), 1.0 + (float(np.exp(x[4])) if excess > 0.0 else -logistic(x[4]))
            return (Inclusion(centre_mm=three(x[:3]), semi_axes_mm=(size, size, size), contrast=contrast),)

        places = zip(centre, middle, wide, step, strict=True)
        size = (np.log(radius), np.log(0.065 * extent), 0.4, 0.05)
        return free_parameters([*places, size, (strength, 0.0, 1.0, 0.05)], effect)

    def sentence(self, values: Values) -> str:
        """Return the finding as a sentence; `values` has the fitted `centre_mm`, `semi_axes_mm` and `contrast`."""
        place, contrast = ", ".join(f"{x:.1f}" for x in values["centre_mm"]), values["contrast"]
        ball = f"{'stiff' if contrast > 1 else 'soft'} inclusion of {values['semi_axes_mm'][0]:.1f} mm radius"
        return f"A {ball} lies at ({place}) mm, {contrast:.2g} times as stiff as its surroundings."


def shares_of_balls(mesh: Mesh, balls: Sequence[Ball]) -> "sparse.csr_array":
    """Return the share of every tetrahedron that lies inside every ball, sparse, shape (n_tets, n_balls).

    The share falls from 1 to 0 over about the width of one tetrahedron.
    """
    if not balls:
        return sparse.csr_array((mesh.n_tets, 0))
    centres = mesh.nodes[mesh.tets].mean(axis=1)
    width = np.cbrt(6.0 * mesh.volumes)
    reach = float(width.max())
    tree = KDTree(centres)
    rows, columns, shares = [], [], []
    for number, (radius, centre) in enumerate(balls):
        near = np.array(tree.query_ball_point(centre, radius + 0.5 * reach), np.int64)
        depth = radius - np.linalg.norm(centres[near] - centre, axis=1)
        rows.append(near)
        columns.append(np.full(len(near), number))
        shares.append(np.clip(0.5 + depth / width[near], 0.0, 1.0))
    entries = (np.concatenate(shares), (np.concatenate(rows), np.concatenate(columns)))
    return sparse.csr_array(entries, shape=(mesh.n_tets, len(balls)))


def balls_in(mesh: Mesh, radii: Sequence[float], spacing: float) -> list[Ball]:
    """Return balls inside a body, on a grid for each radius; `radii`: over the extent, `spacing`: over the radius."""
    tree, reach = KDTree(mesh.nodes[mesh.tets].mean(axis=1)), float(np.cbrt(6.0 * mesh.volumes.max()))
    low, high = mesh.nodes.min(axis=0), mesh.nodes.max(axis=0)
    found: list[Ball] = []
    for radius in (share * mesh.extent for share in radii):
        axes = [_line(float(a), float(b), radius, spacing) for a, b in zip(low, high, strict=True)]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        inside = grid[tree.query(grid)[0] <= reach]
        found += [(radius, (float(x), float(y), float(z))) for x, y, z in inside]
    return found


def _line(low: float, high: float, radius: float, spacing: float) -> FloatArray:
    """Return grid coordinates (n,), mm, of centres of balls along an axis; the middle alone where the body is thin."""
    if high - low < 2.0 * radius:
        return np.array([0.5 * (low + high)])
    return np.arange(low + 0.5 * radius, high, spacing * radius)


@dataclass(frozen=True)
class LayerCause(Cause, id="layer", family="region"):
    """A layer of constant thickness below the free surface, with another modulus."""

    #: Thicknesses of the hypotheses, over the extent of the body.
    thicknesses: tuple[float, ...] = (0.01, 0.02, 0.04, 0.08)
    #: Prior deviation of contrast - 1.
    spread: float = 1.5

    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return one hypothesis for each of several thicknesses of the layer, linear in the contrast."""
        mesh = bench.experiment.mesh
        sizes = [share * bench.extent for share in self.thicknesses]
        if bench.is_elastic:
            shares = np.stack([share_inside(OuterLayer(mesh, size), mesh) for size in sizes], axis=1)
            columns = bench.by_fields(sparse.csr_array(shares))
        else:
            changes = bench.changes([[Layer(thickness_mm=size, contrast=1.5)] for size in sizes])
            columns = np.array([np.zeros(bench.layout.size) if c is None else 2.0 * c for c in changes])
        for size, column in zip(sizes, columns, strict=True):
            yield Variant(f"{size:.1f} mm", self.spread * column[None], {"thickness": size})

    def free_parameters(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> FreeParameters:
        """Return two free parameters: logarithms of the thickness in mm and of the modulus ratio of layer and core."""
        contrast = 1.0 + float(np.clip(self.spread * amplitudes[0], -0.85, 20.0))
        thickness = float(variant.settings["thickness"])
        return free_parameters(
            [(np.log(thickness), np.log(0.025 * bench.extent), 0.7, 0.1), (np.log(contrast), 0.0, 1.2, 0.05)],
            lambda x, young: (Layer(thickness_mm=float(np.exp(x[0])), contrast=float(np.exp(x[1]))),),
        )

    def sentence(self, values: Values) -> str:
        """Return the finding as a sentence; `values` has the fitted `thickness_mm` and modulus ratio `contrast`."""
        contrast, thickness = values["contrast"], values["thickness_mm"]
        kind = "stiffer" if contrast > 1 else "softer"
        return f"An outer layer of {thickness:.2g} mm is {kind} than the core: {contrast:.2g} times its modulus."
