"""The timed step: the paper's setting, a network of Table II's form, and work that is counted, not guessed."""

import numpy as np
import pytest

from tissuereg.cli.benchmark.network import write_random_table2
from tissuereg.cli.benchmark.step import StepSettings, step_rows
from tissuereg.errors import ModelError
from tissuereg.phantom import phantom_mesh, truth_mesh
from tissuereg.registration.learned.network import NetworkModel


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("table2")
    write_random_table2(phantom_mesh("small"), made)
    return made


def test_the_random_network_has_the_form_of_table_two_and_files_that_agree(folder):
    network = NetworkModel(folder, phantom_mesh("small"))
    assert [level.bases.shape for level in network.tables.levels] == [(9, 128, 64), (9, 64, 32), (9, 32, 3)]
    sizes = [level.tables[0].shape for level in network.tables.levels]
    assert sizes[-1][0] == phantom_mesh("small").n_nodes
    assert all(fine > 4 * coarse for fine, coarse in sizes)
    latents = np.random.default_rng(0).standard_normal((26, 7))
    by_file, by_tables = network.decode(latents), network.tables.decode(latents)
    # Single precision, relative to displacements of some mm.
    np.testing.assert_allclose(by_file, by_tables, atol=1e-4)
    mean, variance = network.encode(by_file[0])
    assert np.isfinite(mean).all()
    assert np.allclose(variance, np.exp(-4.0))


def test_a_step_is_timed_at_the_papers_setting_and_its_products_are_counted(folder):
    settings = StepSettings(repeats=2, threads=1, model=str(folder), table2=str(folder), n_sets=2)
    rows = step_rows(settings)
    assert [row["name"] for row in rows] == ["step/shipped", "step/table2"]
    for row in rows:
        assert (row["members"], row["markers"], row["counters"]["analyses"], row["repeats"]) == (100, 15, 5, 4)
        assert list(row["stages_s"]) == ["attach", "encode", "assimilate", "judge"]
        assert row["floor_s"] * row["sgemm_multiply_adds_per_s"] == pytest.approx(row["multiply_adds"])
        # The simulation's code and two screenings, then six decodes of the ensembles of one to four pairs; at most
        # 20 M products each.
        assert 1 + 2 * 62 + 600 <= row["members_decoded"] <= 1 + 2 * 62 + 3 * 600
        assert row["members_decoded"] * 1e5 < row["multiply_adds"] < row["members_decoded"] * 2e7


def test_a_model_of_another_body_is_refused(tmp_path):
    write_random_table2(truth_mesh("small"), tmp_path)
    with pytest.raises(ModelError, match="must know a mesh of the phantom"):
        step_rows(StepSettings(model=str(tmp_path)))
