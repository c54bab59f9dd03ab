"""Registration of the reference problems with their load untold: writes ``results/loadfree-reference-both.json``.

    python benchmarks/loadfree_reference.py

The problems lie in ``../shared/reference``. Options and page are those of ``benchmarks/loadfree.py``; all of it is
development.
"""

import os
import sys
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

if __name__ == "__main__":
    from loadfree.reference import REFERENCE
    from loadfree.run import main

    main(["--half", "both", *sys.argv[1:]], bench=REFERENCE)
