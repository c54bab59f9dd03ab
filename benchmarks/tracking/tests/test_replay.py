"""A replay in real time, on a clock of its own."""

from types import SimpleNamespace

import numpy as np
import pytest

import tissuereg as tr
import tracking.tracking as benchmark
from support.meshes import block
from tissuereg.tracking import fitted_prior


def test_a_replay_counts_what_it_drops_and_times_what_it_registers():
    mesh = block(cells=(2, 2, 3))
    places = mesh.nodes[np.setdiff1d(mesh.surface_nodes, mesh.fixed_nodes)][::3]
    now_s = [0.0]

    def clock():
        return now_s[0]

    def wait(seconds):
        now_s[0] += seconds

    def slow(share):
        now_s[0] += 2.4 / benchmark.HZ
        return share * (mesh.nodes[:, 2:] > 0.0) * np.ones(3)

    motion = SimpleNamespace(
        measured=np.repeat(places[None], 10, axis=0), shares=np.zeros(10), of=lambda frame, _: [float(frame)]
    )
    model = fitted_prior(mesh, largest_mm=1.0, n_events=20, n_latent=4, threads=1)
    registrar = tr.Registrar(mesh, places, model, settings=tr.RegisterSettings(threads=1))
    tracker = tr.Tracker(registrar, simulator=slow, restart="reference")
    row = benchmark.replayed(motion, tracker, clock=clock, wait=wait)
    # A frame takes 2.4 intervals, so that every second or third one is registered: 0, 2, 4, 7, 9.
    assert (row["registered"], row["dropped"]) == (5, 5)
    assert row["lesion_mm"] == pytest.approx(np.mean([0, 2, 4, 7, 9]))
    assert row["latency_median_ms"] == pytest.approx(np.median(row["latency_ms"]))
    assert min(row["latency_ms"]) == pytest.approx(2.4e3 / benchmark.HZ)
    assert row["hz"] == pytest.approx(5 / (9 / benchmark.HZ + 1e-3 * row["latency_ms"][-1]))
