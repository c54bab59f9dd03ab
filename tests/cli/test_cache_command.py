"""``tissuereg cache``: what is kept on disk, and its deletion."""

import pytest

from support.files import run, run_json
from tissuereg.io.cache import keep_entry, read_entry


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("TISSUEREG_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def test_it_says_where_and_how_much_and_clears_entries_alone(folder, capsys):
    code, said, _ = run_json(capsys, "cache")
    assert (code, said["schema"], said["entries"], said["bytes"]) == (0, "tissuereg.cache/1", 0, 0)
    for name in ("bank_1", "fine_1"):
        keep_entry(name, b"content" * 100, 3)
    (folder / "notes.txt").write_text("not ours")
    kept = sum(file.stat().st_size for file in folder.glob("*.cached"))
    code, said, _ = run_json(capsys, "cache")
    assert (said["folder"], said["entries"], said["bytes"]) == (str(folder), 2, kept)
    assert {"seconds", "threads", "machine", "versions"} <= set(said)
    assert run(capsys, "cache")[1] == f"{folder}: 2 entries, 0.0 MB\n"
    assert read_entry("bank_1") is not None
    code, said, _ = run_json(capsys, "cache", "--clear")
    assert (code, said["entries"], said["deleted"]) == (0, 0, {"entries": 2, "bytes": kept})
    assert read_entry("bank_1") is None
    assert [file.name for file in folder.iterdir()] == ["notes.txt"]


def test_a_cache_that_is_no_folder_is_named(folder, capsys):
    folder.mkdir()
    (folder / "bank_1.cached").mkdir()  # cannot be deleted as a file
    code, said, err = run_json(capsys, "cache", "--clear")
    assert code == 2
    assert "bank_1.cached" in said["message"]
    assert "Traceback" not in err


def test_a_user_without_home_is_told_what_to_set(no_home, capsys):
    code, said, _ = run_json(capsys, "cache")
    assert (code, said["where"]) == (2, "TISSUEREG_CACHE")
