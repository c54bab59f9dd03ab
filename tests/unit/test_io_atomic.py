"""Files are written whole or not at all; JSON holds finite numbers only."""

import contextlib
import json
from pathlib import Path

import numpy as np
import pytest

from tissuereg.errors import FormatError
from tissuereg.io.atomic import OutputError, atomic_file, atomic_folder, check_file_target, check_folder_target
from tissuereg.io.json import dumps, plain, write_json


def half_write(path, error):
    path.write_text("half")
    raise error


def test_a_file_appears_only_when_its_writer_has_finished(tmp_path):
    with atomic_file(tmp_path / "deep" / "er" / "note.txt") as temporary:
        temporary.write_text("all")
        assert not (tmp_path / "deep" / "er" / "note.txt").exists()
    assert (tmp_path / "deep" / "er" / "note.txt").read_text() == "all"


def test_a_writer_that_fails_leaves_the_old_file_and_no_litter(tmp_path):
    (tmp_path / "note.txt").write_text("old")
    with pytest.raises(ZeroDivisionError), atomic_file(tmp_path / "note.txt") as temporary:
        half_write(temporary, ZeroDivisionError)
    assert (tmp_path / "note.txt").read_text() == "old"
    assert [file.name for file in tmp_path.iterdir()] == ["note.txt"]


def test_a_writer_that_fails_takes_the_folders_away_that_it_made(tmp_path):
    with pytest.raises(ZeroDivisionError), atomic_file(tmp_path / "deep" / "er" / "note.txt") as temporary:
        half_write(temporary, ZeroDivisionError)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_in_the_way_of_a_result_leaves_all_old_files(tmp_path):
    (tmp_path / "out" / "b.txt").mkdir(parents=True)
    (tmp_path / "out" / "a.txt").write_text("old")
    written = contextlib.ExitStack()
    temporary = written.enter_context(atomic_folder(tmp_path / "out"))
    for name in ("a.txt", "b.txt"):
        (temporary / name).write_text("new")
    with pytest.raises(OutputError, match=r"b\.txt must be a file"):
        written.close()
    assert (tmp_path / "out" / "a.txt").read_text() == "old"


def test_an_interrupt_leaves_no_litter_either(tmp_path):
    with pytest.raises(KeyboardInterrupt), atomic_folder(tmp_path / "out") as temporary:
        half_write(temporary / "a.txt", KeyboardInterrupt)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_keeps_files_of_other_names(tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_text("mine")
    (tmp_path / "out" / "a.txt").write_text("old")
    with atomic_folder(tmp_path / "out") as temporary:
        (temporary / "a.txt").write_text("new")
        (temporary / "sub").mkdir()
        (temporary / "sub" / "b.txt").write_text("b")
    assert {p.relative_to(tmp_path).as_posix() for p in tmp_path.rglob("*")} == {
        "out",
        "out/a.txt",
        "out/mine.txt",
        "out/sub",
        "out/sub/b.txt",
    }
    assert (tmp_path / "out" / "a.txt").read_text() == "new"


def test_new_files_and_folders_have_the_usual_rights(tmp_path):
    (tmp_path / "usual").mkdir()
    (tmp_path / "usual" / "file").write_text("")
    with atomic_folder(tmp_path / "made") as temporary:
        write_json(temporary / "file", {})
    for made, usual in (("made", "usual"), ("made/file", "usual/file")):
        assert (tmp_path / made).stat().st_mode == (tmp_path / usual).stat().st_mode


def test_an_impossible_place_is_an_output_error_that_names_it(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="must not be a folder"):
        check_file_target(tmp_path)
    with pytest.raises(OutputError, match="must not be a file"):
        check_folder_target(tmp_path / "file")
    with pytest.raises(OSError, match="file") as caught, atomic_file(tmp_path / "file" / "below.txt"):
        pass
    assert isinstance(caught.value, OutputError)
    assert caught.value.exit_code == 2


def test_json_has_no_number_that_is_not_finite():
    value = {"a": np.array([[1.0, np.nan]]), "b": (np.int32(2), np.bool_(True), float("inf")), "c": Path("x")}
    assert plain(value) == {"a": [[1.0, None]], "b": [2, True, None], "c": "x"}
    assert json.loads(dumps(value)) == plain(value)


def test_json_of_a_foreign_object_is_refused():
    with pytest.raises(FormatError, match="got object"):
        dumps({"a": object()})
