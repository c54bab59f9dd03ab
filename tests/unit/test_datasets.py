"""Data sets: made in any process with the same bits, opened lazily, spoilt ones refused by name."""

import itertools
import json
import pickle
import re
import sys

import h5py
import numpy as np
import pytest

import tissuereg as tr
from support.meshes import block
from support.scripts import REPOSITORY
from tissuereg.errors import ArgumentError, EnsembleError, ExperimentError, FormatError, MissingPackageError
from tissuereg.io.datasets import Dataset
from tissuereg.io.hdf5 import packed
from tissuereg.io.meshes import write_vtu
from tissuereg.io.stores import LocalStore, RemoteStore, store_of
from tissuereg.parallel import Processes
from tissuereg.simulation.chunks import SOLVE
from tissuereg.simulation.dataset import make_dataset
from tissuereg.simulation.recipe import read_recipe

RECIPE = """
seed = 4
[mesh]
file = "mesh.vtu"
[data]
members = 22
chunk = 6
largest_mm = [1.0, 8.0]
[pairs]
members = 0
"""


def recipe_in(folder, text=RECIPE):
    write_vtu(folder / "mesh.vtu", block())
    (folder / "recipe.toml").write_text(text)
    return read_recipe(folder / "recipe.toml")


def files(folder):
    return {file.name: file.read_bytes() for file in folder.iterdir()}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made")
    recipe = recipe_in(folder)
    return recipe, folder / "data", make_dataset(recipe, folder / "data", threads=1)


@pytest.fixture
def spoilable(made, tmp_path):
    folder = tmp_path / "data"
    folder.mkdir()
    for name, content in files(made[1]).items():
        (folder / name).write_bytes(content)
    return folder


def all_bits(data):
    return [data.displacement[:], data.parameters[:], data.failed]


# --- made ---


def test_threads_and_processes_do_not_change_a_bit(made, tmp_path):
    recipe, folder, _ = made
    make_dataset(recipe, tmp_path / "threads", threads=2)
    with Processes(2) as pool:
        make_dataset(recipe, tmp_path / "processes", executor=pool)
    assert files(tmp_path / "threads") == files(folder)
    assert files(tmp_path / "processes") == files(folder)


def test_a_chunk_does_not_depend_on_those_before_it(made, tmp_path):
    recipe, folder, _ = made
    for name in ("recipe.sha256", "chunk_0000.h5", "chunk_0002.h5"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    make_dataset(recipe, tmp_path)
    assert files(tmp_path) == files(folder)


def test_a_file_does_not_depend_on_when_its_arrays_are_let_go(monkeypatch):
    arrays = {"rows": np.arange(24.0).reshape(8, 3), "group/a": np.arange(8), "group/b": np.array(["one", "two"])}
    usual = packed(arrays, {"number": 1}, frozenset({"rows"}))
    create, kept = h5py.Group.create_dataset, []

    def kept_open(*given, **settings):
        kept.append(create(*given, **settings))  # as the profiler of a Dask worker does that looks at the running frame
        return kept[-1]

    monkeypatch.setattr(h5py.Group, "create_dataset", kept_open)
    assert packed(arrays, {"number": 1}, frozenset({"rows"})) == usual
    assert len(kept) == 3


def test_a_task_that_fails_in_another_process_says_why(tmp_path):
    recipe = recipe_in(
        tmp_path, RECIPE.replace("[1.0, 8.0]", "[1e4, 2e4]\nmost_mm = 1e5").replace("chunk = 6", "chunk = 11")
    )
    with (
        Processes(1) as pool,
        pytest.raises(EnsembleError, match="at least half of a chunk") as raised,
    ):
        make_dataset(recipe, tmp_path / "data", executor=pool)
    assert all(isinstance(index, int) and reason for index, reason in raised.value.dropped)
    assert not (tmp_path / "data" / "dataset.json").exists()


def test_what_is_there_is_not_made_again(made, spoilable):
    recipe, _, first = made
    again = make_dataset(recipe, spoilable)
    assert again["members_per_s"] is None
    assert (again["members"], again["failed"], again["motion"]) == (
        first["members"],
        first["failed"],
        first["motion"],
    )


def test_a_place_of_fsspec_holds_the_same_bytes(made):
    recipe, folder, _ = made
    make_dataset(recipe, "memory://bucket/data")
    store = store_of("memory://bucket/data")
    assert {name: store.read(name) for name in store.names()} == files(folder)
    ours, theirs = tr.open_dataset(folder), tr.open_dataset("memory://bucket/data")
    np.testing.assert_array_equal(theirs.displacement[5:9], ours.displacement[5:9])
    theirs.verify()


def test_a_file_system_with_a_rename_never_shows_a_part(tmp_path):
    from fsspec.implementations.local import LocalFileSystem

    seen = []

    class Watched(LocalFileSystem):
        protocol = "watched"

        def pipe_file(self, path, value, **given):
            super().pipe_file(path, value[:3])
            seen.append({file.name for file in tmp_path.iterdir()})
            super().pipe_file(path, value)

        def mv(self, *given, **further):
            if len(seen) > 1:
                raise ConnectionError(5, "the line is dead")
            super().mv(*given, **further)

    store = RemoteStore("watched://", Watched(), str(tmp_path))
    store.write("a.txt", b"all of it")
    assert "a.txt" not in seen[0]
    assert store.read("a.txt") == b"all of it"
    with pytest.raises(OSError, match="the line is dead"):
        store.write("a.txt", b"something else")
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == {"a.txt": b"all of it"}


def test_a_url_without_fsspec_names_the_package(monkeypatch):
    monkeypatch.setitem(sys.modules, "fsspec.core", None)
    with pytest.raises(MissingPackageError, match="pip install fsspec"):
        store_of("s3://bucket/data")


def test_an_unknown_protocol_is_refused():
    with pytest.raises(ArgumentError, match="nosuch"):
        store_of("nosuch://bucket/data")


def test_another_recipe_seed_or_an_older_form_is_refused(made, spoilable, tmp_path):
    recipe = made[0]
    with pytest.raises(ExperimentError, match="another's"):
        make_dataset(recipe, spoilable, seed=5)
    with pytest.raises(ExperimentError, match="another's"):
        make_dataset(recipe_in(tmp_path, RECIPE.replace("members = 0", "members = 3")), spoilable)
    (spoilable / "recipe.sha256").write_text("0" * 64)
    (spoilable / "dataset.json").write_text(json.dumps({"schema": "tissuereg.dataset/1"}))
    with pytest.raises(FormatError, match=r"older form tissuereg.dataset/1"):
        make_dataset(recipe, spoilable)


def test_a_member_that_would_move_too_far_moves_less(tmp_path):
    text = RECIPE.replace("[1.0, 8.0]", "[1.0, 15.0]\nmost_mm = {}")
    make_dataset(recipe_in(tmp_path, text.format(1000.0)), tmp_path / "free")
    make_dataset(recipe_in(tmp_path, text.format(15.0)), tmp_path / "bounded")
    free, bounded = tr.open_dataset(tmp_path / "free"), tr.open_dataset(tmp_path / "bounded")
    largest = [np.linalg.norm(data.displacement[:], axis=2).max(axis=1) for data in (free, bounded)]
    far = largest[0] > 15.0
    assert far.any()
    assert largest[1].max() <= 15.0
    np.testing.assert_array_equal(free.displacement[:][~far], bounded.displacement[:][~far])
    for row in np.flatnonzero(far):
        less = bounded.parameters[row]["linear_largest_mm"] / free.parameters[row]["linear_largest_mm"]
        forces = [data.parameters[row]["patch_force_mN"] for data in (bounded, free)]
        np.testing.assert_allclose(forces[0], less * forces[1], rtol=1e-12)
        assert less < 1.0


def test_the_motion_is_that_of_the_members(made):
    data, said = tr.open_dataset(made[1]), made[2]["motion"]
    fields = data.displacement[:].astype(float)
    mean = np.linalg.norm(fields, axis=2).mean(axis=1)
    assert said["mean_node_mm"]["mean"] == pytest.approx(mean.mean())
    assert said["largest_mm"]["largest"] == pytest.approx(np.linalg.norm(fields, axis=2).max())
    chunks = [fields[first : first + 6] for first in range(0, len(fields), 6)]
    apart = [np.linalg.norm(a - b, axis=1).mean() for chunk in chunks for a, b in itertools.combinations(chunk, 2)]
    assert said["n_pairs"] == len(apart)
    assert said["apart_mm"]["mean"] == pytest.approx(np.mean(apart))
    assert said["share_apart_7_mm"] == np.mean(np.array(apart) >= 7.0)


# --- opened ---


def test_a_data_set_states_what_it_holds(made):
    recipe, folder, said = made
    data = tr.open_dataset(folder)
    assert len(data) == said["members"] == len(data.displacement) == len(data.parameters)
    assert len(data) + len(data.failed) == recipe.data.members
    assert data.recipe == recipe.raw
    assert data.mesh.digest() == recipe.mesh().digest()
    assert data.displacement.shape == (len(data), block().n_nodes, 3)
    rows = np.concatenate(list(data.split.values()))
    np.testing.assert_array_equal(np.sort(rows), np.arange(len(data)))
    assert [len(part) for part in data.split.values()] == [len(data) - 4, 2, 2]
    assert data.index[-1] == recipe.data.members - 1
    data.verify()


def test_a_member_is_the_equilibrium_of_its_parameters(made):
    data = tr.open_dataset(made[1])
    row = 13
    told, mesh = data.parameters[row], data.mesh
    patches = [i for i, radius in enumerate(told["patch_radius_mm"]) if np.isfinite(radius)]
    corners = mesh.nodes[mesh.surface]
    free = ~np.isin(mesh.surface, mesh.fixed_nodes).all(axis=1)
    centres = corners.mean(axis=1)
    areas = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    forces = np.zeros_like(mesh.nodes)
    for patch in patches:
        near = np.linalg.norm(centres - told["patch_centre_mm"][patch], axis=1) <= told["patch_radius_mm"][patch]
        share = np.where(near & free, areas, 0.0) / areas[near & free].sum()
        for corner in range(3):
            np.add.at(forces, mesh.surface[:, corner], np.outer(share / 3, told["patch_force_mN"][patch]))
    load = tr.Load(forces=forces, body_force=told["body_force_mN_per_mm3"])
    found = tr.simulate(mesh, load, tr.Material(told["young_kpa"], told["poisson"])).displacement
    # The data are solved to 1e-6 of the load and kept as float32 (6e-8 of some mm).
    np.testing.assert_allclose(data.displacement[row], found, atol=1e-4)


def test_rows_slices_and_lists_agree(made):
    data = tr.open_dataset(made[1])
    everything = data.displacement[:]
    for row in (0, 5, 6, 17, -1):
        np.testing.assert_array_equal(data.displacement[row], everything[row])
    np.testing.assert_array_equal(data.displacement[4:14:3], everything[4:14:3])
    np.testing.assert_array_equal(data.displacement[[9, 2]], everything[[9, 2]])
    assert data.parameters[7]["young_kpa"] == data.parameters[5:9][2]["young_kpa"]
    np.testing.assert_array_equal(data.displacement[np.array(3)], everything[3])
    for beyond in (len(data), -len(data) - 1):
        with pytest.raises(IndexError, match=f"from -22 to 21, got {beyond}"):
            data.displacement[beyond]
    for wrong in ("a", True, [True] * 22, np.ones(22, dtype=bool), 1.5, [[1]], None):
        with pytest.raises(ArgumentError, match="whole number"):
            data.displacement[wrong]


def test_a_program_that_knows_only_the_page_reads_a_member(made, monkeypatch):
    page = (REPOSITORY / "docs" / "files.md").read_text(encoding="utf-8")
    code = next(text for text in re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL) if "h5py" in text)
    monkeypatch.chdir(made[1].parent)
    names: dict = {}
    exec(code.replace("4711", "13"), names)
    data = tr.open_dataset(made[1])
    np.testing.assert_array_equal(names["displacement"], data.displacement[13])
    assert names["young"] == data.parameters[13]["young_kpa"]


def test_the_page_names_all_that_a_data_set_holds(made):
    page = (REPOSITORY / "docs" / "files.md").read_text(encoding="utf-8")
    with h5py.File(made[1] / "chunk_0000.h5") as file:
        names = [*(set(file) - {"parameters"}), *file["parameters"], *file.attrs]
    for name in [*names, *json.loads((made[1] / "dataset.json").read_text())]:
        assert f"`{name}`" in page or f"`parameters/{name}`" in page, name


def test_reading_one_member_reads_no_other(tmp_path):
    recipe = recipe_in(tmp_path, RECIPE.replace("members = 22\nchunk = 6", "members = 60\nchunk = 60"))
    make_dataset(recipe, tmp_path / "data")
    counted, opened = [], []

    class Counting(LocalStore):
        def source(self, name):
            file = super().source(name)
            inner = file.readinto
            opened.append(file)

            class Handle:
                seek, tell, close = file.seek, file.tell, file.close

                def read(self, size=-1):
                    content = file.read(size)
                    counted.append(len(content))
                    return content

                def readinto(self, room):
                    counted.append(inner(room))
                    return counted[-1]

            return Handle()

    data = Dataset(Counting(tmp_path / "data"))
    assert counted == []
    data.displacement[3]
    counted.clear()
    data.displacement[41]
    for file in opened:
        file.close()
    one = block().n_nodes * 12
    # The field and its checksum, and nodes of the tree of chunks, a few kB each: 60 members would be 86 kB.
    assert one <= sum(counted) <= one + 8192


@pytest.mark.parametrize("locking", [True, False, "best-effort"])
def test_a_file_that_the_same_program_has_open_already_is_read(made, locking):
    with h5py.File(made[1] / "chunk_0001.h5", locking=locking) as file:
        np.testing.assert_array_equal(tr.open_dataset(made[1]).displacement[6], file["displacement_mm"][0])


def test_a_file_that_cannot_be_opened_is_not_said_to_be_spoilt(spoilable, monkeypatch):
    data = tr.open_dataset(spoilable)
    data.displacement[0]

    def refused(*_, **__):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("pathlib.Path.open", refused)
    with pytest.raises(FormatError, match=r"chunk_0001\.h5 must be readable: .*Permission denied") as raised:
        data.displacement[7]
    assert "Delete" not in str(raised.value)


def test_a_pickled_data_set_reads_on(made):
    data = tr.open_dataset(made[1])
    field = data.displacement[3]
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(data)).displacement[3], field)


def test_a_failed_member_is_recorded_with_its_reason(tmp_path, monkeypatch):
    monkeypatch.setitem(SOLVE, "max_iterations", 9)  # the larger motions of this set take more
    recipe = recipe_in(tmp_path)
    said = make_dataset(recipe, tmp_path / "data")
    data = tr.open_dataset(tmp_path / "data")
    assert said["failed"]
    assert [list(one) for one in data.failed] == said["failed"]
    assert all(reason for _, reason in data.failed)
    assert len(data) == recipe.data.members - len(data.failed)
    assert set(data.index) == set(range(recipe.data.members)) - {index for index, _ in data.failed}
    again = make_dataset(recipe, tmp_path / "data")
    assert again["failed"] == said["failed"]


def test_a_member_that_fails_alone_in_its_chunk_ends_no_data_set(tmp_path, monkeypatch):
    monkeypatch.setitem(SOLVE, "max_iterations", 9)
    said = make_dataset(recipe_in(tmp_path, RECIPE.replace("chunk = 6", "chunk = 1")), tmp_path / "data")
    data = tr.open_dataset(tmp_path / "data")
    assert said["failed"]
    assert said["motion"]["n_pairs"] == 0
    assert {0, 1} == {entry["members"] for entry in data.card["chunks"]}
    assert np.isfinite(data.displacement[:]).all()
    assert len(data.parameters[:]) == len(data) == 22 - len(said["failed"])
    data.verify()


def test_a_data_set_of_which_most_fails_is_none(tmp_path, monkeypatch):
    monkeypatch.setitem(SOLVE, "max_iterations", 1)
    recipe = recipe_in(tmp_path, RECIPE.replace("members = 22\nchunk = 6", "members = 5\nchunk = 2"))
    with pytest.raises(EnsembleError, match="at least half of the members must find equilibrium, 0 of 5 did") as raised:
        make_dataset(recipe, tmp_path / "data")
    assert len(raised.value.dropped) == 5
    assert not (tmp_path / "data" / "dataset.json").exists()


# --- spoilt ---


def test_a_missing_chunk_is_named(spoilable):
    data = tr.open_dataset(spoilable)
    (spoilable / "chunk_0001.h5").unlink()
    for use in (lambda: data.displacement[7], lambda: data.parameters[7], data.verify):
        with pytest.raises(FormatError, match=r"chunk_0001\.h5") as raised:
            use()
        assert raised.value.where == str(spoilable / "chunk_0001.h5")
    assert np.isfinite(data.displacement[0]).all()


def test_one_flipped_bit_is_noticed_by_whoever_reads_it(spoilable):
    chunk = spoilable / "chunk_0001.h5"
    data = tr.open_dataset(spoilable)
    field = data.displacement[6]
    content = bytearray(chunk.read_bytes())
    place = content.index(field.tobytes()) + 100
    content[place] ^= 4
    chunk.write_bytes(content)
    spoilt = tr.open_dataset(spoilable)
    with pytest.raises(FormatError, match=r"chunk_0001\.h5"):
        spoilt.displacement[6]
    assert np.isfinite(spoilt.displacement[7]).all()
    with pytest.raises(FormatError, match=r"chunk_0001\.h5.*SHA-256"):
        spoilt.verify()


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda file: file.attrs.__setitem__("number", 3), "chunk 1"),
        (lambda file: file.attrs.__setitem__("recipe_sha256", "0"), "another fingerprint"),
        (lambda file: file.__delitem__("displacement_mm"), "displacement_mm"),
        (lambda file: file.move("displacement_mm", "other"), "displacement_mm"),
    ],
)
def test_a_chunk_of_something_else_is_refused(spoilable, made, spoil, words):
    with h5py.File(spoilable / "chunk_0001.h5", "a") as file:
        spoil(file)
    with pytest.raises(FormatError, match=words):
        tr.open_dataset(spoilable).displacement[6]
    with pytest.raises(FormatError, match=words):
        make_dataset(made[0], spoilable)


def test_a_file_that_was_altered_gets_no_new_card(made, spoilable):
    card, chunk = (spoilable / "dataset.json").read_bytes(), spoilable / "chunk_0001.h5"
    with h5py.File(chunk, "a") as file:
        file["parameters/young_kpa"][0] = 1.0
    with pytest.raises(FormatError, match=r"chunk_0001\.h5 must be the file that was written") as raised:
        make_dataset(made[0], spoilable)
    assert raised.value.where == str(chunk)
    assert (spoilable / "dataset.json").read_bytes() == card
    chunk.unlink()
    make_dataset(made[0], spoilable)
    assert files(spoilable) == files(made[1])


def test_pairs_are_those_of_the_file_and_none_without_one(made, tmp_path):
    assert tr.open_dataset(made[1]).pairs is None
    recipe = recipe_in(tmp_path, RECIPE.replace("members = 22", "members = 2").replace("members = 0", "members = 2"))
    make_dataset(recipe, tmp_path / "data")
    simulations, truths = tr.open_dataset(tmp_path / "data").pairs
    with h5py.File(tmp_path / "data" / "pairs.h5") as file:
        np.testing.assert_array_equal(simulations, file["simulation_mm"][:])
        np.testing.assert_array_equal(truths, file["truth_mm"][:])
    with h5py.File(tmp_path / "data" / "pairs.h5", "w"):
        pass
    with pytest.raises(FormatError, match=r"pairs\.h5 must hold the pairs of this data set"):
        _ = tr.open_dataset(tmp_path / "data").pairs


def test_spoilt_pairs_are_refused_before_the_card_vouches_for_them(tmp_path):
    recipe = recipe_in(tmp_path, RECIPE.replace("members = 22", "members = 2").replace("members = 0", "members = 2"))
    make_dataset(recipe, tmp_path / "data")
    pairs = tmp_path / "data" / "pairs.h5"
    with h5py.File(pairs) as file:
        field = file["truth_mm"][1].tobytes()
    content = bytearray(pairs.read_bytes())
    content[content.index(field) + 100] ^= 4
    pairs.write_bytes(content)
    with pytest.raises(FormatError, match=r"pairs\.h5 must be a whole HDF5 file"):
        make_dataset(recipe, tmp_path / "data")
    with h5py.File(pairs, "w"):
        pass
    with pytest.raises(FormatError, match=r"pairs\.h5 must hold the pairs of this data set"):
        make_dataset(recipe, tmp_path / "data")


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"schema": "tissuereg.dataset/1"}, "older form"),
        ({"schema": "x/1"}, "tissuereg.dataset/2"),
        ({"chunks": [{"file": "../chunk_0000.h5"}]}, "plain files"),
        ({"mesh": None}, "plain files"),
        ({"split": {"train": [0, 99], "valid": [], "test": []}}, "split"),
        ({"failed": [[1]]}, "failed"),
        ({"failed": [[1, "a"], [1, "b"]]}, "every failed member once"),
        ({"failed": [[23, "a"]]}, "by its number"),
    ],
)
def test_a_spoilt_card_is_refused(spoilable, changed, words):
    card = json.loads((spoilable / "dataset.json").read_text())
    (spoilable / "dataset.json").write_text(json.dumps({**card, **changed}))
    with pytest.raises(FormatError, match=words):
        tr.open_dataset(spoilable)


def test_an_unfinished_data_set_says_how_to_finish_it(spoilable):
    (spoilable / "dataset.json").unlink()
    with pytest.raises(FormatError, match="finishes one that was begun"):
        tr.open_dataset(spoilable)
