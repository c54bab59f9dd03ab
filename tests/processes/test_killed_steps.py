"""Writers that are killed before each of their operations on files, and writers that are alive."""

import os
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

import pytest

from tissuereg.io import drafts
from tissuereg.io.atomic import atomic_file
from tissuereg.io.bounds import FILES
from tissuereg.io.drafts import DRAFT_PREFIX, draft, remove_stale_drafts

SCRIPT = Path(__file__).parents[1] / "support" / "killed_steps.py"
MEMORY = Path("/dev/shm")
TIDY = """\
import sys
from pathlib import Path
from tissuereg.io.drafts import remove_stale_drafts
remove_stale_drafts(Path(sys.argv[1]))
"""


@pytest.mark.parametrize("scenario", ["file-new", "file-replaced", "folder-new", "folder-replaced", "entry-new"])
def test_a_kill_before_any_operation_loses_nothing_and_the_next_writer_tidies(scenario, tmp_path):
    # In memory, where there is such a place: hundreds of writes need not wait for a disk.
    with tempfile.TemporaryDirectory(dir=MEMORY if os.access(MEMORY, os.W_OK) else tmp_path) as place:
        done = subprocess.run([sys.executable, SCRIPT, scenario, place], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) >= 10  # a writer makes, locks, writes, renames, removes


def test_a_draft_that_is_being_written_stays(tmp_path):
    with draft(tmp_path) as mine:
        (mine / "half").write_text("half")
        with atomic_file(tmp_path / "other.txt") as temporary:
            temporary.write_text("whole")
        subprocess.run([sys.executable, "-c", TIDY, tmp_path], check=True)
        assert (mine / "half").read_text() == "half"
    assert [file.name for file in tmp_path.iterdir()] == ["other.txt"]


def test_many_writers_of_one_file_take_nothing_from_each_other(tmp_path):
    failed = []

    def write(number):
        try:
            for _ in range(10):
                with atomic_file(tmp_path / "note.txt") as temporary:
                    temporary.write_text(f"{number}" * 1000)
                assert len(set((tmp_path / "note.txt").read_text())) == 1
        except BaseException as error:
            failed.append(error)

    writers = [threading.Thread(target=write, args=(number,)) for number in range(4)]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
    assert failed == []
    assert [file.name for file in tmp_path.iterdir()] == ["note.txt"]


def test_a_draft_of_another_machine_goes_after_a_day_without_change(tmp_path, monkeypatch):
    with monkeypatch.context() as patched:
        patched.setattr(drafts, "_machine", lambda: "elsewhere")
        made, lock = drafts._make(tmp_path)
        os.close(lock)
    (made / "content" / "growing").write_text("half")
    remove_stale_drafts(tmp_path)
    assert made.name.startswith(f"{DRAFT_PREFIX}elsewhere-")
    assert made.exists()
    long_ago = made.stat().st_mtime - FILES.stale_draft_s - 1
    for old in (made / "lock", made / "content", made):
        os.utime(old, (long_ago, long_ago))
    remove_stale_drafts(tmp_path)
    assert made.exists(), "a file in it still grows"
    os.utime(made / "content" / "growing", (long_ago, long_ago))
    remove_stale_drafts(tmp_path)
    assert not made.exists()


def test_machines_of_like_names_have_words_of_their_own(monkeypatch):
    names = ("node-1.a", "node-11a", "worker-deployment-of-registrations-1", "worker-deployment-of-registrations-2")
    words = set()
    for name in names:
        monkeypatch.setattr(drafts.socket, "gethostname", lambda name=name: name)
        drafts._machine.cache_clear()
        words.add(drafts._machine())
    monkeypatch.undo()
    drafts._machine.cache_clear()
    assert len(words) == len(names)


@pytest.mark.parametrize("name", ["backup", "elsewhere-0123456", f"{'a' * 12}-0123456z"])
def test_a_folder_of_a_like_name_is_no_draft(tmp_path, name):
    (tmp_path / f"{DRAFT_PREFIX}{name}" / "keep").mkdir(parents=True)
    long_ago = 1.0
    os.utime(tmp_path / f"{DRAFT_PREFIX}{name}", (long_ago, long_ago))
    remove_stale_drafts(tmp_path)
    assert (tmp_path / f"{DRAFT_PREFIX}{name}" / "keep").is_dir()


def test_a_folder_with_other_files_is_no_draft(tmp_path):
    made = tmp_path / f"{DRAFT_PREFIX}{drafts._machine()}-01234567"
    made.mkdir()
    (made / "mine").write_text("mine")
    remove_stale_drafts(tmp_path)
    assert (made / "mine").exists()
    (made / "mine").unlink()
    (made / "content").mkdir()  # of a draft whose removal was interrupted
    remove_stale_drafts(tmp_path)
    assert not made.exists()


def test_nothing_but_drafts_is_removed(tmp_path):
    (tmp_path / f"{DRAFT_PREFIX}file").write_text("no folder")
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "mine").write_text("mine")
    (tmp_path / f"{DRAFT_PREFIX}link").symlink_to(tmp_path / "elsewhere")
    remove_stale_drafts(tmp_path)
    assert len(list(tmp_path.iterdir())) == 3
    assert (tmp_path / "elsewhere" / "mine").exists()
