"""Are the nuisances' priors right on the rigs of a half? ``python -m rigs.sizes HALF``, into its archive."""

import argparse
import os

from blind.materialise import folder_of
from blind.scored import of_kind
from blind.sizes import found_on
from common import commit
from rigs.materialise import materialise
from rigs.page import ARCHIVE, HALVES, archives
from rigs.run import BUILD
from rigs.scored import scored
from tissuereg.io.json import write_json


def main() -> None:
    """Find the factors for the nulls among the archived verdicts of a half and keep them beside these."""
    parser = argparse.ArgumentParser(prog="python -m rigs.sizes", description=__doc__)
    parser.add_argument("half", choices=HALVES)
    parser.add_argument("--threads", type=int, default=1)
    options = parser.parse_args()
    os.environ.setdefault("TISSUEREG_CACHE", str((BUILD / "cache").resolve()))
    nulls = of_kind(scored(archives()[options.half]["rows"]), "null")
    folders = [folder_of(null.case, BUILD, materialise) for null in nulls]
    write_json(ARCHIVE / options.half / "sizes.json", found_on(folders, options.threads) | commit())


if __name__ == "__main__":
    main()
