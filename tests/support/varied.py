"""Variants of a simulation on the small phantom, a model that is calibrated for them, and markers."""

import numpy as np

import tissuereg as tr
from support.small_model import SMALL_MODEL
from tissuereg.registration.learned.calibration import Calibration, Change, FieldErrors, Rehearsal
from tissuereg.registration.learned.components import Components
from tissuereg.registration.learned.network import NetworkModel

STD = 0.05


def drawn(mesh):
    """Ten smooth fields about a push, zero at the base."""
    rng = np.random.default_rng(8)
    x = mesh.nodes / mesh.extent
    waves = [np.sin(x @ rng.normal(scale=3.0, size=3) + rng.uniform(0.0, 6.0)) for _ in range(10)]
    height = x[:, 2] - x[:, 2].min()
    push = height[:, None] * np.array([3.0, 0.5, -1.0])
    return push + 3.0 * height[None, :, None] * np.array(waves)[:, :, None] * rng.standard_normal((10, 1, 3))


def calibrated(mesh, change_mm, widening=1.0, pairs=True, unrelated_mm=1.0):
    """Return the small model, whose simulations are off by so much in one pattern, and hardly in their codes."""
    model = NetworkModel(SMALL_MODEL, mesh, threads=1)
    height = mesh.nodes[:, 2:] - mesh.nodes[:, 2].min()
    pattern = np.ones((1, mesh.n_nodes, 3)) * height / mesh.extent
    none = np.zeros((mesh.n_nodes, 3))
    change = Change(
        np.array([0.0, 0.3]), 1e-10 * np.eye(26)[None], FieldErrors(pattern, np.full((1, 1, 1), change_mm**2), none)
    )
    model.calibration = Calibration(
        Components(np.ones(1), np.zeros((1, 26)), 1e-10 * np.eye(26)[None]),
        FieldErrors(pattern, np.full((1, 1, 1), unrelated_mm**2), none),
        Rehearsal(np.ones(1), np.ones((1, 1))),
        change if pairs else None,
        Rehearsal(np.array([1.0, 1.5]), np.array([[0.1, 0.2], [0.3, 0.4]]), widening) if pairs else None,
    )
    return model


def places(mesh):
    """Return nodes of twelve markers, and of a target."""
    free = np.setdiff1d(np.unique(mesh.surface), mesh.fixed_nodes)
    inner = np.setdiff1d(np.arange(mesh.n_nodes), np.union1d(mesh.surface_nodes, mesh.fixed_nodes))
    return free[:: len(free) // 12][:12], int(inner[40])


def measured(mesh, variants, seed=1):
    """Return a truth among what the variants span, and noisy markers of it."""
    rng = np.random.default_rng(seed)
    shares = rng.dirichlet(np.ones(len(variants)))
    truth = variants.mean(axis=0) + np.tensordot(2.0 * (shares - shares.mean()), variants, 1)
    seen, _ = places(mesh)
    reference = mesh.nodes[seen]
    return truth, tr.Markers(reference, reference + truth[seen] + STD * rng.standard_normal((12, 3)), STD)
