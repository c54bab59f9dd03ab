"""Registration of bodies that are held elsewhere than the user states: writes ``results/loadfree-supports-*.json``.

    python benchmarks/loadfree_supports.py [--half dev|test|both] [--methods ...] [--bodies ...] [--jobs N]

Options, halves and page are those of ``benchmarks/loadfree.py``.
"""

import os
import sys
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

if __name__ == "__main__":
    from loadfree.run import main
    from loadfree.supports import SUPPORTS

    main(bench=SUPPORTS)
