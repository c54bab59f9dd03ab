"""The prior fitted on the spot: it covers what the markers saw, from simulations that tissue could bear."""

import warnings

import numpy as np
import pytest

from tissuereg.latent import fitted
from tissuereg.latent.fitted import FittedPriorSettings, Motion, fit_prior
from tissuereg.simulate.solve import Simulator

N_MEMBERS = 60


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("TISSUEREG_CACHE", str(tmp_path))


@pytest.fixture
def batches(monkeypatch):
    """What every call of `Simulator.solve_many` found, by element."""
    seen = []
    solve_many = Simulator.solve_many

    def kept(self, *arguments, **settings):
        found = solve_many(self, *arguments, **settings)
        seen.append((self.element, found))
        return found

    monkeypatch.setattr(Simulator, "solve_many", kept)
    return seen


def wide_motion(mesh) -> Motion:
    """Three markers on top of the block that moved by a fifth of its height."""
    top = np.flatnonzero(mesh.nodes[:, 2] > 40 - 1e-9)[[0, 7, 19]]
    moved = np.tile((8.0, 0.0, 0.0), (3, 1))
    return Motion(lambda fields: fields[..., top, :], moved, ("a", "b", "c"), 0.1)


def test_members_stay_within_what_tissue_strains_and_the_prior_covers_the_markers(block_mesh, batches):
    motion = wide_motion(block_mesh)
    settings = FittedPriorSettings(n_members=N_MEMBERS, n_latent=N_MEMBERS)
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # no marker is out of reach
        model = fit_prior(Simulator(block_mesh), motion, settings=settings)
    (_, (_, members), _, (_, held_out)) = batches
    assert len(members.failed) == len(held_out.failed) == 0
    # The bound is on the linear answer; a body that bends turns as well, which this strain counts.
    strains = fitted._strains(block_mesh, members.displacement)
    assert np.quantile(strains, 0.9) < 1.3 * settings.most_event_strain
    reach = 1.6449 * np.linalg.norm(motion.predict(model.components)[:, :, 0], axis=0)
    assert (reach > 0.7 * 8.0).all(), reach


def test_held_out_members_have_ten_nodes_an_element_and_all_count(block_mesh, batches):
    settings = FittedPriorSettings(n_members=N_MEMBERS)
    model = fit_prior(Simulator(block_mesh), wide_motion(block_mesh), settings=settings)
    assert [element for element, _ in batches] == ["tet4", "tet4", "tet4", "tet10"]
    assert model.card["held_out"] == len(model.error_fields) == settings.n_held_out
    assert model.card["members"] == N_MEMBERS
