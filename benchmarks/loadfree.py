"""Registration with an unknown load, on events simulated by another solver: writes ``results/loadfree-*.json``.

    python benchmarks/loadfree.py [--half dev|test|both] [--methods ...] [--bodies ...] [--limit N] [--jobs N]

Development uses the even events; the odd ones (``--half test``) are evaluated at the end. A run that was stopped
goes on. ``python -m loadfree.table`` (with ``tests`` on the path) writes ``docs/loadfree.md`` from the results.
"""

import os
import sys
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

if __name__ == "__main__":
    from loadfree.run import main

    main()
