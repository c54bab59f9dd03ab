"""Print the requirements of an extra, one per line, so that pip installs them without building the package."""

import sys
import tomllib
from pathlib import Path

PROJECT = Path(__file__).resolve().parent.parent / "pyproject.toml"

print(*tomllib.loads(PROJECT.read_text(encoding="utf-8"))["project"]["optional-dependencies"][sys.argv[1]], sep="\n")
