"""Further data sets join the training split, and nothing else."""

import numpy as np
import pytest
from conftest import make_block, write_dataset

from tissuereg_training.data import read_dataset
from tissuereg_training.errors import ExperimentError, FormatError, MeshError
from tissuereg_training.training_split import TrainingSplit


@pytest.fixture
def block():
    return make_block(3, 3, 4)


@pytest.fixture
def dataset(block, tmp_path):
    return read_dataset(write_dataset(tmp_path / "first", block, 40))


def test_all_members_of_further_data_are_trained_on_after_the_first_ones_split(dataset, block, tmp_path):
    more = [write_dataset(tmp_path / f"more{seed}", block, 15, seed=seed, chunks=3) for seed in (5, 6)]
    split = TrainingSplit(dataset, more)
    wanted = [dataset.fields[dataset.split.train], *(read_dataset(folder).fields for folder in more)]
    for _ in range(2):  # it can be walked through again
        np.testing.assert_array_equal(np.concatenate(list(split)), np.concatenate(wanted))
    assert len(split) == 32 + 30
    assert len(set(split.fingerprints)) == 2


def test_data_without_further_folders_is_its_own_training_split(dataset):
    split = TrainingSplit(dataset)
    np.testing.assert_array_equal(np.concatenate(list(split)), dataset.fields[dataset.split.train])
    assert split.fingerprints == []


def test_members_that_the_first_set_holds_are_refused_so_that_no_test_field_is_trained_on(dataset, block, tmp_path):
    again = write_dataset(tmp_path / "again", block, 40, chunks=5)
    with pytest.raises(ExperimentError, match=r"its member 0 is there already\. Make it with another seed"):
        TrainingSplit(dataset, [again])
    other = write_dataset(tmp_path / "other", block, 9, seed=5)
    with pytest.raises(ExperimentError, match="other members"):
        TrainingSplit(dataset, [other, other])


def test_another_mesh_and_spoilt_files_are_refused(dataset, block, tmp_path):
    with pytest.raises(MeshError, match="must hold fields on the mesh of"):
        TrainingSplit(dataset, [write_dataset(tmp_path / "wide", make_block(4, 3, 4), 9, seed=5)])
    with pytest.raises(FormatError, match=r"readable dataset\.json"):
        TrainingSplit(dataset, [tmp_path / "nothing"])
