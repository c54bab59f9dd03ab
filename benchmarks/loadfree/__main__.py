"""Registration with an unknown load, on events with a known truth -> archive/.

    python -m loadfree [--bench loadfree|supports|reference] [--half dev|test|both] [--methods ...] [--bodies ...]
                       [--limit N] [--jobs N]

``supports``: bodies that are held elsewhere than the user states; ``reference``: the problems of four other solvers in
``../shared/reference``, all of them development. Development uses the even events; the odd ones (``--half test``) are
evaluated at the end. A run that was stopped goes on. ``python -m loadfree.table`` writes ``RESULTS.md``.
"""

import argparse
import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

if __name__ == "__main__":
    from loadfree.bench import LOADFREE
    from loadfree.reference import REFERENCE
    from loadfree.run import main
    from loadfree.supports import SUPPORTS

    benches = {"loadfree": LOADFREE, "supports": SUPPORTS, "reference": REFERENCE}
    parser = argparse.ArgumentParser(add_help=False)
    parser.add_argument("--bench", choices=[*benches], default="loadfree")
    given, words = parser.parse_known_args()
    main(["--half", "both", *words] if given.bench == "reference" else words, bench=benches[given.bench])
