"""Stress along a curve of a model with an elastic law and memory.

The formulas are those of the solver (`crates/fem/src/memory`) at one point of homogeneous deformation, with rows as
time steps. Relaxation acts on the second Piola-Kirchhoff stress with an instantaneous modulus; softening multiplies the
isochoric stress; the set is a stress-free stretch ``exp(fraction E_max)``, constant within a step; viscosity is the
Cauchy stress ``2 eta D``. The lateral stress of a bar is zero: without lateral elastic stress there is none to relax
either, so relaxation is exact at any Poisson's ratio; softening and viscosity of a bar are those of its incompressible
limit (with an error of the order of 1 - 2 nu). The elastic response, stress and energy, is that of the solver's own law
at a point; memory acts on parts of the stress, so that plane deformations need its whole tensor, from the first
Piola-Kirchhoff stress at ``F = C^(1/2)``.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.body.material import Material
from tissuereg.diagnosis.material.model import Model
from tissuereg.experiment.effects.history import Relaxation, Softening
from tissuereg.experiment.material_experiment import Curve, MaterialExperiment
from tissuereg.experiment.material_tests import shear_stress, uniaxial_stress


@dataclass(frozen=True)
class _Law:
    """A law with a modulus of 1 kPa and the share of the largest strain that remains; a key of caches by its digest."""

    digest: str
    set_fraction: float
    material: Material = field(compare=False)


def stress_of(model: Model, curve: Curve, rows: Sequence[int] | IntArray | None = None) -> FloatArray:
    """Return the nominal stress of a model along a curve, shape (n_rows,), in kPa, compression negative.

    `model`: law and effects of time and history; `curve`: its strains and times are used, its stress is not. Without
    times relaxation and viscosity are left out; `rows`: indices of the rows to return; all where absent. The history
    includes all rows in either case. The stress is NaN where the law has no solution.
    """
    wanted = np.arange(len(curve.amounts)) if rows is None else np.asarray(rows, dtype=np.int64)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        if not model.remembers:
            amounts, sheared = curve.amounts[wanted], curve.mode == "simple-shear"
            return shear_stress(model.material, amounts) if sheared else uniaxial_stress(model.material, amounts)
        stress = (_sheared if curve.mode == "simple-shear" else _stretched)(model, curve)
        return np.asarray(stress[1:][wanted])


def predicted_stresses(experiment: MaterialExperiment) -> list[FloatArray]:
    """Return the stresses that an experiment's model predicts along its curves.

    Parameters
    ----------
    experiment : MaterialExperiment
        Experiment whose effects are applied, for instance from an ``experiment.extended.toml``.

    Returns
    -------
    list of ndarray of float64
        For each curve, shape (n_rows,): nominal stress of every row, kPa, compression negative; NaN where the law has
        no solution.

    Examples
    --------
    >>> from pathlib import Path
    >>> import numpy as np
    >>> import tissuereg as tr
    >>> from tissuereg.experiment.material_experiment import Curve, MaterialExperiment
    >>> shear = Curve("a", "simple-shear", np.nan, [np.nan] * 3, [0.1, 0.2, 0.3], [0.1, 0.2, 0.3])
    >>> gel = MaterialExperiment("gel", Path("."), tr.Material(3.0, 0.49), None, None, (shear,))
    >>> predicted_stresses(gel)[0].round(4).tolist()
    [0.1007, 0.2013, 0.302]
    """
    model = Model(experiment.material).with_effects(experiment.effects)
    return [stress_of(model, curve) for curve in experiment.curves]


def _law_of(model: Model) -> _Law:
    unit = replace(model.material, young=1.0)
    return _Law(unit.digest(), 0.0 if model.set is None else model.set.fraction, unit)


def _young(model: Model) -> float:
    return float(model.material.young_array[0])


@lru_cache(maxsize=256)
def _from_rest(curve: Curve) -> tuple[FloatArray, FloatArray]:
    """Return stretches (or amounts of shear) and times in s of a curve, each (n + 1,), with the state of rest first.

    The time from rest to the first row follows from the curve's strain rate, and is 0 where that is not known.
    """
    rest = 0.0 if curve.mode == "simple-shear" else 1.0
    times = curve.clock
    if not curve.timed:
        times = np.zeros(len(times))
    lead = 0.0 if math.isnan(curve.rate) else abs(float(curve.strains[0])) / curve.rate
    return np.concatenate([[rest], curve.amounts]), np.concatenate([[times[0] - lead], times])


def _stretched(model: Model, curve: Curve) -> FloatArray:
    stretch, times = _from_rest(curve)
    unit, energy = _stretched_unit(_law_of(model), curve)
    second = _young(model) * unit
    if model.softening is not None:
        second = second * _softened(model.softening, _young(model) * energy)
    if model.relaxation is not None and curve.timed:
        second = _relaxed(model.relaxation, second, times)
    nominal = stretch * second
    if model.rate is not None and curve.timed:
        along = _viscous(stretch**2, times)
        aside = _viscous(1.0 / stretch, times)
        # The lateral stress is zero: Cauchy stress along minus across, over the stretch.
        nominal = nominal + model.rate.viscosity_kpa_s * (stretch * along - aside / stretch**2)
    return np.asarray(nominal)


@lru_cache(maxsize=256)
def _stretched_unit(law: _Law, curve: Curve) -> tuple[FloatArray, FloatArray]:
    """Return axial second Piola-Kirchhoff stress and isochoric energy density of a bar, each (n + 1,), in kPa.

    They belong to a modulus of 1 kPa, at rest and at every row of `curve`.
    """
    material, (stretch, _) = law.material, _from_rest(curve)
    stays = np.exp(law.set_fraction * _largest_before(np.log(stretch)))
    elastic = stretch / stays
    across = elastic**-0.5
    energy = isochoric_energy(material, np.stack([elastic, across, across], axis=1))
    return uniaxial_stress(material, elastic) / elastic / stays**2, energy


def _sheared(model: Model, curve: Curve) -> FloatArray:
    shear, times = _from_rest(curve)
    across, along, energy = _sheared_unit(_law_of(model), curve)
    parts = _young(model) * np.stack([across, along])
    if model.softening is not None:
        parts = parts * _softened(model.softening, _young(model) * energy)
    if model.relaxation is not None and curve.timed:
        parts = _relaxed(model.relaxation, parts, times)
    nominal = parts[0] + shear * parts[1]
    if model.rate is not None and curve.timed:
        nominal = nominal + model.rate.viscosity_kpa_s * _viscous_shear(shear, times)
    return np.asarray(nominal)


@lru_cache(maxsize=256)
def _sheared_unit(law: _Law, curve: Curve) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return stresses 01 and 11 (second Piola-Kirchhoff) and isochoric energy density in shear, each (n + 1,), in kPa.

    They belong to a modulus of 1 kPa, at rest and at every row of `curve`.
    """
    material, (shear, _) = law.material, _from_rest(curve)
    metric = shear_metric(shear)
    back = None if law.set_fraction == 0 else _shear_back(law.set_fraction, metric, shear)
    elastic = metric if back is None else back @ metric @ back
    # Principal stretches in a plane of constant area: their squares have this sum and the product 1.
    half = 0.5 * (elastic[:, 0, 0] + elastic[:, 1, 1])
    larger = np.sqrt(half + np.sqrt(np.maximum(half**2 - 1.0, 0.0)))
    energy = isochoric_energy(material, np.stack([larger, 1.0 / larger, np.ones(len(larger))], axis=1))
    if material.law == "hooke":
        return shear_stress(material, shear), np.zeros(len(shear)), energy
    second = plane_second_pk(material, elastic)
    if back is not None:
        second = back @ second @ back
    return second[:, 0, 1], second[:, 1, 1], energy


def _shear_back(fraction: float, metric: FloatArray, shear: FloatArray) -> FloatArray:
    """Return the inverse of the permanent stretch in simple shear at every row, shape (n, 2, 2).

    It is ``exp(-fraction E_max)``, with `fraction` the share of the strain that remains and E_max the logarithmic
    strain of the row of largest shear before. `metric` is the right Cauchy-Green tensor (n, 2, 2) in the plane of
    shear, `shear` (n,) the amount.
    """
    sizes = np.abs(shear)
    best = np.maximum.accumulate(sizes)
    first = np.concatenate([[True], sizes[1:] > best[:-1]])
    source = np.maximum.accumulate(np.where(first, np.arange(len(shear)), 0))
    before = np.concatenate([[0], source[:-1]])
    values, vectors = np.linalg.eigh(metric[before])
    return np.asarray(np.einsum("np,nip,njp->nij", values ** (-0.5 * fraction), vectors, vectors))


def _largest_before(values: FloatArray) -> FloatArray:
    """Return, at each of n rows, the entry of `values` (n,) that is largest in size in earlier rows; 0 at the first."""
    sizes = np.abs(values)
    best = np.maximum.accumulate(sizes)
    first = np.concatenate([[True], sizes[1:] > best[:-1]])
    source = np.maximum.accumulate(np.where(first, np.arange(len(values)), 0))
    return np.concatenate([[0.0], values[source[:-1]]])


def _softened(softening: Softening, energy: FloatArray) -> FloatArray:
    from scipy.special import erf

    if softening.form == "damage":
        return np.asarray(1.0 + (1.0 - 1.0 / softening.r) * np.expm1(-np.maximum.accumulate(energy) / softening.m_kpa))
    largest = np.concatenate([[0.0], np.maximum.accumulate(energy)[:-1]])
    below = np.maximum(largest - energy, 0.0)
    return np.asarray(1.0 - erf(below / (softening.m_kpa + softening.beta * largest)) / softening.r)


def _relaxed(relaxation: Relaxation, elastic: FloatArray, times: FloatArray) -> FloatArray:
    """Return the stress after relaxation, ``(1 - sum g) S + sum g_i H_i``, shape (..., n), in kPa.

    S is the `elastic` stress (..., n), linear in time within a step; `times` (n,) are in s; g_i and H_i are the share
    and the history stress of each term of the Prony series. Simo's recursion ``H_n = e_n H_n-1 + beta_n dS_n``, with
    decay e_n, mean decay beta_n and stress change dS_n of a step, is evaluated for all steps at once by recursive
    doubling.
    """
    shares, taus = np.array(relaxation.g), np.array(relaxation.tau_s)
    x = np.diff(times) / taus[:, None]
    beta = np.where(x > 0, -np.expm1(-x) / np.where(x > 0, x, 1.0), 1.0)
    changes = np.diff(elastic, axis=-1)[..., None, :] * beta
    held = np.concatenate([np.broadcast_to(elastic[..., None, :1], (*changes.shape[:-1], 1)), changes], axis=-1)
    decay = np.concatenate([np.zeros((len(taus), 1)), np.exp(-x)], axis=1)
    joined = 1
    while joined < len(times):
        held[..., joined:] = held[..., joined:] + decay[:, joined:] * held[..., :-joined]
        decay[:, joined:] = decay[:, joined:] * decay[:, :-joined]
        joined *= 2
    return np.asarray((1.0 - shares.sum()) * elastic + np.einsum("i,...in->...n", shares, held))


def _viscous(square: FloatArray, times: FloatArray) -> FloatArray:
    """Return the rate ``2 / dt C_n^-1 dE C_n^-1`` of a principal direction, shape (n,), in 1/s; 0 where no time passes.

    C = `square` (n,) is the squared stretch, C_n its value at a step's start, dE the change of the strain (C - 1) / 2
    in the step and dt its duration, from `times` (n,) in s.
    """
    steps = np.diff(times)
    flow = np.diff(square) / square[:-1] ** 2
    return np.concatenate([[0.0], np.where(steps > 0, flow / np.where(steps > 0, steps, 1.0), 0.0)])


def _viscous_shear(shear: FloatArray, times: FloatArray) -> FloatArray:
    """Return the nominal viscous shear stress over the viscosity, shape (n,), in 1/s; 0 where no time passes.

    `shear` (n,): amounts of shear; `times` (n,): s.
    """
    metric, steps = shear_metric(shear), np.diff(times)
    before = shear[:-1]
    inverse = np.empty((len(before), 2, 2))
    inverse[:, 0, 0], inverse[:, 1, 1] = 1.0 + before**2, 1.0
    inverse[:, 0, 1] = inverse[:, 1, 0] = -before
    flow = inverse @ np.diff(metric, axis=0) @ inverse
    nominal = flow[:, 0, 1] + shear[1:] * flow[:, 1, 1]
    return np.concatenate([[0.0], np.where(steps > 0, nominal / np.where(steps > 0, steps, 1.0), 0.0)])


def shear_metric(shear: FloatArray) -> FloatArray:
    """Return the right Cauchy-Green tensor in the plane of simple shear ``F = I + shear e0 e1``, shape (n, 2, 2).

    `shear` (n,): amounts of shear. The tensors have the determinant 1.
    """
    metric = np.zeros((len(shear), 2, 2))
    metric[:, 0, 0] = 1.0
    metric[:, 0, 1] = metric[:, 1, 0] = shear
    metric[:, 1, 1] = 1.0 + shear**2
    return metric


def plane_second_pk(material: Material, metric: FloatArray) -> FloatArray:
    """Return the in-plane second Piola-Kirchhoff stress of an area-preserving plane deformation, (n, 2, 2), kPa.

    `material`: homogeneous; not of the law hooke; `metric` (n, 2, 2): right Cauchy-Green tensor in the plane, of
    determinant 1.
    """
    identity = np.eye(2)
    # The root of a matrix of determinant 1.
    stretch = (metric + identity) / np.sqrt(metric[:, 0, 0] + metric[:, 1, 1] + 2.0)[:, None, None]
    gradients = np.zeros((len(metric), 3, 3))
    gradients[:, :2, :2] = stretch - identity
    _, stress = material.core_law().response(gradients, *_moduli(material))
    return np.asarray(_inverse(stretch) @ stress[:, :2, :2])


def isochoric_energy(material: Material, stretches: FloatArray) -> FloatArray:
    """Return the energy density at volume-preserving principal stretches, shape (n,), in kPa, without fibres.

    `material`: homogeneous; `stretches` (n, 3): principal stretches of product 1.
    """
    young, poisson = _moduli(material)
    # Without a lambda, St. Venant and Kirchhoff's energy is that of the change of shape; Hooke's is taken for it.
    law = "st-venant-kirchhoff" if material.law == "hooke" else material.law
    gradients = np.zeros((len(stretches), 3, 3))
    gradients[:, range(3), range(3)] = stretches - 1.0
    plain = replace(material, law=law, fibre=None)
    return plain.core_law().response(gradients, young / (1.0 + poisson), 0.0)[0]


def _moduli(material: Material) -> tuple[float, float]:
    return float(material.young_array[0]), float(material.poisson_array[0])


def _inverse(metric: FloatArray) -> FloatArray:
    inverse = np.empty_like(metric)
    inverse[:, 0, 0], inverse[:, 1, 1] = metric[:, 1, 1], metric[:, 0, 0]
    inverse[:, 0, 1] = inverse[:, 1, 0] = -metric[:, 0, 1]
    determinant = metric[:, 0, 0] * metric[:, 1, 1] - metric[:, 0, 1] ** 2
    return np.asarray(inverse / determinant[:, None, None])
