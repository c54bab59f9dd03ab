"""Run the command line of tissuereg: ``python -m tissuereg`` does the same as the command ``tissuereg``."""

import sys

from tissuereg.cli import main

if __name__ == "__main__":
    sys.exit(main())
