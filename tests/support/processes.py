"""The command as a process: started, killed, and its remains compared with the output of a whole run."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

from tissuereg.io.drafts import DRAFT_PREFIX

#: Time limit in s: more than any of these commands takes on a busy machine.
PATIENCE = 300


@dataclass
class Command:
    """One command in a place of its own: its output, cache and temporary files lie below `place`.

    Attributes
    ----------
    words : sequence of str
        After ``tissuereg``; ``{out}`` stands for the output folder.
    place : Path
        Made where absent.
    environment : dict
        Further variables.
    """

    words: tuple
    place: Path
    environment: dict = field(default_factory=dict)

    def __post_init__(self):
        self.temporary.mkdir(parents=True, exist_ok=True)

    @property
    def out(self) -> Path:
        return self.place / "out"

    @property
    def cache(self) -> Path:
        return self.place / "cache"

    @property
    def temporary(self) -> Path:
        return self.place / "tmp"

    def start(self, **settings) -> subprocess.Popen:
        words = [str(word).replace("{out}", str(self.out)) for word in self.words]
        places = {"TISSUEREG_CACHE": str(self.cache), "TMPDIR": str(self.temporary), "OMP_NUM_THREADS": "1"}
        return subprocess.Popen(
            [sys.executable, "-m", "tissuereg", *words],
            env={**os.environ, **places, **self.environment},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            **settings,
        )

    def run(self, **settings) -> tuple[int, str]:
        """Run to the end; return exit code and standard error."""
        process = self.start(**settings)
        _, said = process.communicate(timeout=PATIENCE)
        return process.returncode, " ".join(said.split())

    def kill_after(self, seconds: float, number: int = signal.SIGKILL, **settings) -> tuple[int, str]:
        """Run, and send a signal after so many seconds; return exit code and standard error."""
        process = self.start(**settings)
        time.sleep(seconds)
        process.send_signal(number)
        _, said = process.communicate(timeout=PATIENCE)
        return process.returncode, said

    def left(self) -> set[str]:
        """Names in the place, in its folder of temporary files and in the cache, drafts by their prefix alone."""
        found = [
            *self.place.iterdir(),
            *self.temporary.iterdir(),
            *(self.cache.glob(".*") if self.cache.exists() else ()),
        ]
        return {DRAFT_PREFIX if one.name.startswith(DRAFT_PREFIX) else one.name for one in found}


def content(folder: Path) -> dict[str, object]:
    """Return the comparable content of a result's files by name, without times, rates, pictures and drafts."""
    files = [one for one in sorted(folder.rglob("*")) if one.is_file() and DRAFT_PREFIX not in str(one)]
    return {str(one.relative_to(folder)): comparable(one) for one in files}


def comparable(file: Path) -> object:
    """Return the comparable content of a file; fail if it is not whole."""
    if file.suffix == ".json":
        return without_times(json.loads(file.read_text(encoding="utf-8")))
    if file.suffix == ".html":
        text = file.read_text(encoding="utf-8")
        assert text.rstrip().endswith("</html>"), file
        return len(re.sub(r"[0-9.e-]+", "", text))
    if file.suffix == ".png":
        assert file.read_bytes()[-8:-4] == b"IEND", file
        return "a picture"
    return file.read_bytes()


def without_times(value: object) -> object:
    if isinstance(value, dict):
        return {
            key: without_times(one) for key, one in value.items() if key not in ("seconds", "date", "members_per_s")
        }
    return [without_times(one) for one in value] if isinstance(value, list) else value
