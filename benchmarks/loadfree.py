"""Registration with nothing known of the load, on true events of a foreign solver: writes ``results/loadfree-*.json``.

    python benchmarks/loadfree.py [--half dev|test|both] [--methods ...] [--bodies ...] [--limit N] [--jobs N]

Development looks at the even events; the odd ones (``--half test``) are asked when all is done. A run that was stopped
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
