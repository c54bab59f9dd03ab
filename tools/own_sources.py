"""Importing this puts `python/` before an installed package, in this process and those that it starts.

Otherwise a test or a tool would see what was installed before the sources changed. Nothing is done without a compiled
core among them (`make install-dev` puts it there), nor where TISSUEREG_INSTALLED is set: `make test` tests the wheel.
"""

import os
import sys
from pathlib import Path

SOURCES = Path(__file__).resolve().parents[1] / "python"

if "TISSUEREG_INSTALLED" not in os.environ and any((SOURCES / "tissuereg").glob("_core*.so")):
    sys.path.insert(0, str(SOURCES))
    os.environ["PYTHONPATH"] = os.pathsep.join([str(SOURCES), *filter(None, [os.environ.get("PYTHONPATH")])])
