"""``python -m tissuereg``: the same as the command ``tissuereg``."""

import sys

from tissuereg.cli import main

if __name__ == "__main__":
    sys.exit(main())
