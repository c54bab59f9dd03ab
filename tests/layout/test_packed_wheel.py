"""A wheel that is packed anew has the same files, in fewer bytes."""

import os
import subprocess
import sys
import zipfile

import numpy as np

from support.scripts import REPOSITORY


def test_packing_anew_keeps_every_file_and_makes_digits_smaller(tmp_path):
    wheel = tmp_path / "a-1-py3-none-any.whl"
    digits = np.random.default_rng(0).normal(0.0, 8.0, 200_000).astype(np.int8).tobytes()
    with zipfile.ZipFile(wheel, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a/digits.npy", digits)
        archive.writestr("a/empty.py", b"")
        entry = zipfile.ZipInfo("a/run", (1980, 1, 1, 0, 0, 0))
        entry.external_attr = 0o755 << 16
        archive.writestr(entry, b"text " * 1000)
    before = wheel.stat().st_size
    subprocess.run([sys.executable, "tools/pack_wheel.py", wheel], cwd=REPOSITORY, check=True, env=os.environ)
    assert wheel.stat().st_size < 0.98 * before
    with zipfile.ZipFile(wheel) as archive:
        assert archive.namelist() == ["a/digits.npy", "a/empty.py", "a/run"]
        assert archive.read("a/digits.npy") == digits
        assert archive.read("a/empty.py") == b""
        assert archive.read("a/run") == b"text " * 1000
        assert archive.getinfo("a/run").external_attr == 0o755 << 16
    assert list(tmp_path.iterdir()) == [wheel]
