"""Kills a writer before every operation on files, one after another; run as a script: SCENARIO FOLDER.

A process is forked for each operation; it counts what Python reports to audit hooks and kills itself before the
operation of that number. After it the folder must hold the old content or the new one, and at most one draft; then the
writer runs again, and the folder must hold the new content and nothing else. Prints how many operations there were.
"""

import itertools
import os
import shutil
import signal
import sys
from pathlib import Path

from tissuereg.io.atomic import atomic_file, atomic_folder
from tissuereg.io.cache import keep_entry, read_entry
from tissuereg.io.drafts import DRAFT_PREFIX

_COUNTED = ("open", "os.", "fcntl.", "shutil.")


def file(place: Path, text: str) -> None:
    with atomic_file(place / "deep" / "note.txt") as temporary:
        temporary.write_text(text)


def folder(place: Path, text: str) -> None:
    with atomic_folder(place / "deep" / "out") as draft:
        (draft / "a.txt").write_text(text)
        with atomic_file(draft / "b.txt") as temporary:
            temporary.write_text(text)


def entry(place: Path, text: str) -> None:
    os.environ["TISSUEREG_CACHE"] = str(place / "cache")
    keep_entry("kind_name", text.encode(), 3)


WRITERS = {"file": file, "folder": folder, "entry": entry}


def content(place: Path) -> dict[str, bytes]:
    """Return the content of all files but drafts, by path."""
    files = [one for one in place.rglob("*") if one.is_file() and DRAFT_PREFIX not in str(one)]
    return {str(one.relative_to(place)): one.read_bytes() for one in files}


def drafts(place: Path) -> list[Path]:
    found = [one for one in place.rglob(f"{DRAFT_PREFIX}*") if DRAFT_PREFIX not in str(one.parent)]
    return sorted(found)


def killed(write, place: Path, step: int) -> bool:
    """Run `write` in another process; return whether that was killed before file operation number `step`."""
    pid = os.fork()
    if pid == 0:
        counter = itertools.count(1)

        def hook(event: str, _) -> None:
            if event.startswith(_COUNTED) and next(counter) == step:
                os.kill(os.getpid(), signal.SIGKILL)

        sys.addaudithook(hook)
        write(place, "new")
        os._exit(0)
    _, status = os.waitpid(pid, 0)
    assert os.WIFSIGNALED(status) or os.WEXITSTATUS(status) == 0, status
    return os.WIFSIGNALED(status)


def main(scenario: str, workplace: str) -> None:
    kind, _, before = scenario.partition("-")
    write = WRITERS[kind]
    place, keep = Path(workplace) / "place", Path(workplace) / "kept"
    keep.mkdir()
    if before == "replaced":
        write(keep, "old")
    old = content(keep)
    shutil.copytree(keep, place)
    write(place, "new")
    new = content(place)
    assert new != old
    for step in itertools.count(1):
        shutil.rmtree(place)
        shutil.copytree(keep, place)
        was_killed = killed(write, place, step)
        found = content(place)
        assert found in (old, new) or (kind == "folder" and old and all(found[n] in (old[n], new[n]) for n in new)), (
            step,
            found,
        )
        assert len(drafts(place)) <= 1, (step, drafts(place))
        if kind == "entry":
            assert read_entry("kind_name") in (b"old" if old else None, b"new"), step
        write(place, "new")
        assert content(place) == new, step
        assert drafts(place) == [], step
        if not was_killed:
            print(step - 1)
            return


if __name__ == "__main__":
    main(*sys.argv[1:])
