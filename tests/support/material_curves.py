"""Synthetic material tests: stresses by textbook formulas of an incompressible solid, not by the package.

Nominal stress of a bar is ``2 (W1 + W2/l) (l - l^-2)``, of simple shear ``2 (W1 + W2) g``. Memory is integrated on a
fine grid of times by the midpoint rule. Paths: a ramp to the largest strain, a ramp and a hold, cycles.
"""

import itertools
import math
from dataclasses import replace
from pathlib import Path

import numpy as np

import tissuereg as tr
from tissuereg.diagnosis.material.data import data_of, path_arc
from tissuereg.diagnosis.material.noise import generic_covariance
from tissuereg.experiment.material_experiment import Curve, MaterialExperiment

MU = 10.0 / 3.0


def ramp(largest, rate, n=60):
    """Return times and strains of a ramp at constant rate."""
    times = np.linspace(0.0, abs(largest) / rate, n)
    return times, np.sign(largest) * rate * times


def ramp_and_hold(largest, rate, hold_s, n=50):
    """Return times and strains of a ramp and a hold."""
    times, strains = ramp(largest, rate, n)
    later = times[-1] + np.geomspace(hold_s / 200.0, hold_s, n)
    return np.concatenate([times, later]), np.concatenate([strains, np.full(n, strains[-1])])


def cycles(largest, rate, peaks=(0.5, 1.0, 1.0), n=25):
    """Return times and strains of loadings to shares of the largest strain, each followed by unloading."""
    corners = [0.0]
    for peak in peaks:
        corners += [peak * largest, 0.0]
    strains = np.concatenate([np.linspace(a, b, n)[1:] for a, b in itertools.pairwise(corners)])
    strains = np.concatenate([[0.0], strains])
    return np.concatenate([[0.0], np.cumsum(np.abs(np.diff(strains)))]) / rate, strains


def slopes(law, a, mu=MU):
    """Return W1 and W2 of a law at ``a = I1 - 3``."""
    name, *p = law
    one = np.ones_like(a)
    if name == "plain":
        return 0.5 * mu * one, 0.0 * one
    if name == "fung":
        return 0.5 * mu * np.exp(p[0] * a), 0.0 * one
    if name == "gent":  # a limit of extension: no law of the package
        return 0.5 * mu / (1.0 - a / p[0]), 0.0 * one
    if name == "mooney":
        return 0.5 * mu * (1.0 - p[0]) * one, 0.5 * mu * p[0] * one
    raise ValueError(name)


def elastic(law, mode, strain, mu=MU):
    """Return the nominal stress of an elastic law."""
    strain = np.asarray(strain, dtype=float)
    if law[0] == "ogden":
        alpha = law[1]
        if mode == "simple-shear":
            half = np.arcsinh(strain / 2.0)  # logarithm of the larger principal stretch
            return 2.0 * mu / alpha * np.sinh(alpha * half) / np.cosh(half)
        stretch = 1.0 + strain
        return 2.0 * mu / alpha * (stretch ** (alpha - 1.0) - stretch ** (-alpha / 2.0 - 1.0))
    if law[0] == "fibre":  # along the pull, taut in tension alone
        plain = elastic(("plain",), mode, strain, mu)
        if mode == "simple-shear":
            return plain
        stretch = 1.0 + strain
        e = np.maximum(stretch**2 - 1.0, 0.0)
        return plain + 2.0 * law[1] * mu * e * np.exp(law[2] * e**2) * stretch
    if mode == "simple-shear":
        w1, w2 = slopes(law, strain**2, mu)
        return 2.0 * (w1 + w2) * strain
    stretch = 1.0 + strain
    w1, w2 = slopes(law, stretch**2 + 2.0 / stretch - 3.0, mu)
    return 2.0 * (w1 + w2 / stretch) * (stretch - stretch**-2.0)


def relaxed(law, mode, times, strain, kernel, mu=MU, n=1500):
    """Return the stress of a relaxing solid: the hereditary integral of the second Piola-Kirchhoff stress.

    `kernel` is the share of an early stress that is left after a time. Bars relax as ``P / l``; in shear the law must
    be plain, whose stress is that of the shear component alone.
    """
    fine = np.unique(np.concatenate([np.linspace(times[0], times[-1], n), times]))
    path = np.interp(fine, times, strain)
    divisor = 1.0 if mode == "simple-shear" else 1.0 + path
    second = elastic(law, mode, path, mu) / divisor
    change, middle = np.diff(second), 0.5 * (fine[1:] + fine[:-1])
    out = []
    for time in times:
        before = fine[1:] <= time + 1e-12
        out.append(np.sum(kernel(time - middle[before]) * change[before]))
    return np.array(out) * (1.0 if mode == "simple-shear" else 1.0 + np.asarray(strain))


def prony(*terms):
    """Return the kernel of shares and times."""
    rest = 1.0 - sum(g for g, _ in terms)
    return lambda t: rest + sum(g * np.exp(-t / tau) for g, tau in terms)


def softened(mode, strain, r, m, mu=MU):
    """Return the stress of a plain solid that softens below its largest energy (Ogden and Roxburgh)."""
    strain = np.asarray(strain, dtype=float)
    stretch = 1.0 + strain
    a = strain**2 if mode == "simple-shear" else stretch**2 + 2.0 / stretch - 3.0
    energy = 0.5 * mu * a
    largest = np.maximum.accumulate(energy)
    factor = np.array([1.0 - math.erf((w - e) / m) / r for w, e in zip(largest, energy, strict=True)])
    return factor * elastic(("plain",), mode, strain, mu)


def left_strained(mode, strain, fraction, mu=MU):
    """Return the stress of a plain bar of which a share of the largest logarithmic strain stays."""
    logs = np.log1p(np.asarray(strain, dtype=float))
    largest, stays = 0.0, []
    for value in logs:
        stays.append(np.exp(fraction * largest))
        largest = value if abs(value) > abs(largest) else largest
    stays = np.array(stays)
    stretch = np.exp(logs) / stays
    return elastic(("plain",), mode, stretch - 1.0, mu) / stays


def viscous(mode, times, strain, eta, mu=MU):
    """Return the stress of a plain solid with a viscosity."""
    strain = np.asarray(strain, dtype=float)
    steps = np.diff(times)
    rate = np.concatenate([[0.0], np.diff(strain) / np.where(steps > 0, steps, np.inf)])
    flow = eta * rate if mode == "simple-shear" else 3.0 * eta * rate / (1.0 + strain) ** 2
    return elastic(("plain",), mode, strain, mu) + flow


def spoilt(stress, rng, noise=0.01, factor=0.0):
    """Return a stress with white noise of a share of its peak, and a specimen's factor."""
    stress = np.asarray(stress, dtype=float)
    peak = np.abs(stress).max()
    return stress * (1.0 + factor * rng.standard_normal()) + noise * peak * rng.standard_normal(len(stress))


LARGEST = {"tension": 0.3, "compression": -0.35, "simple-shear": 0.5}


def measured(specimen, mode, rate, times, strain, stress):
    """Return a curve of the package from strains; without a rate it has no times either."""
    amounts = strain if mode == "simple-shear" else 1.0 + strain
    known = times if rate == rate else np.full(len(times), np.nan)
    return Curve(specimen, mode, rate, known, amounts, stress)


def in_modes(rng, law, *, modes=tuple(LARGEST), specimens=("a",), noise=0.01, mu=MU, change=None, timed=True):
    """Return ramps of an elastic law in some modes; specimens differ by a factor of 5 %."""
    curves = []
    for specimen in specimens:
        factor = 1.0 + 0.05 * rng.standard_normal() if len(specimens) > 1 else 1.0
        for mode in modes:
            times, strain = ramp(LARGEST[mode], 0.01, 40)
            stress = factor * elastic(law, mode, strain, mu)
            if change is not None:
                stress = change(mode, strain, stress)
            rate = 0.01 if timed else np.nan
            curves.append(measured(specimen, mode, rate, times, strain, spoilt(stress, rng, noise)))
    return curves


def histories(rng, answer, *, modes=("tension", "simple-shear"), rates=(0.01, 0.1), path="hold", noise=0.01):
    """Return curves of `answer(mode, times, strain)` along ramps with holds or along cycles."""
    curves = []
    for mode in modes:
        for rate in rates:
            size = LARGEST[mode]
            times, strain = ramp_and_hold(size, rate, 100.0) if path == "hold" else cycles(size, rate)
            curves.append(measured("a", mode, rate, times, strain, spoilt(answer(mode, times, strain), rng, noise)))
    return curves


def with_lasting_errors(curves, rng, size=0.02):
    """Return curves with errors of a share of the stress that last a quarter of the way, a fifth of them rough."""
    return [_off(curve, rng, size, np.eye(len(curve.amounts))) for curve in curves]


def _off(curve, rng, size, rough):
    arc = path_arc(curve)
    level = np.abs(curve.stress) + 0.1 * np.abs(curve.stress).max()
    smooth = np.exp(-0.5 * ((arc[:, None] - arc[None, :]) / 0.25) ** 2)
    factor = np.linalg.cholesky(0.8 * smooth + (0.2 + 1e-9) * rough)
    return replace(curve, stress=curve.stress + size * level * (factor @ rng.standard_normal(len(arc))))


def with_smooth_misfit(curves, rng, size):
    """Return curves with a relative misfit that differs between modes and that no cause of the catalogue explains."""
    data = data_of(believed(curves), max_rows=10**6)
    factor = np.linalg.cholesky(generic_covariance(data) + 1e-12 * np.diag(data.level**2))
    misfit = size * factor @ rng.standard_normal(len(data.stress))
    parts = np.split(misfit, np.cumsum([len(rows) for rows in data.rows])[:-1])
    return [replace(curve, stress=_added(curve, *part)) for curve, *part in zip(curves, data.rows, parts, strict=True)]


def _added(curve, rows, misfit):
    stress = curve.stress.copy()
    stress[rows] += misfit
    return stress


def believed(curves, young=10.0, folder=Path(), **changes):
    """Return an experiment whose believed material is neo-Hookean, nearly incompressible, its modulus known to 30 %."""
    material = tr.Material(young, 0.4999)
    values = {"effects": (), "hold_out": None, "stress_std": None, **changes}
    return MaterialExperiment("made up", folder, material, 0.3 * young, None, tuple(curves), **values)
