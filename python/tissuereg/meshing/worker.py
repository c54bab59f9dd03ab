"""The mesher in a separate process: it holds the interpreter lock, writes into its folder, and may end its process.

Run as a script with two file names: an .npz with the surface and the settings, and the .npz to be written. It imports
nothing from tissuereg, so that it starts from any folder.
"""

import sys
from importlib import metadata
from typing import Any

import numpy as np

#: Path of this script.
SCRIPT = __file__

#: Exit codes other than 0: the mesher cannot be imported, out of memory, the mesher failed.
NO_MESHER, NO_MEMORY, REFUSED = 65, 66, 67


def main(given: str, made: str) -> int:
    """Fill the surface of the .npz `given`, write the .npz `made`, and return the exit code.

    `given` has ``vertices (n, 3)`` in mm, ``triangles (m, 3)``, ``edge_share`` and ``deviation_share`` (target edge
    length and largest deviation as shares of the diagonal of the bounding box), ``threads``; `made` gets ``nodes`` in
    mm, ``tets`` and ``mesher``, its name and version.
    """
    try:
        import pytetwild
    except ImportError as error:
        print(error, file=sys.stderr)
        return NO_MESHER
    with np.load(given) as wanted:
        vertices, triangles = np.array(wanted["vertices"]), np.array(wanted["triangles"], np.int32)
        settings = {
            "edge_length_fac": float(wanted["edge_share"]),
            "epsilon": float(wanted["deviation_share"]),
            "num_threads": int(wanted["threads"]),
        }
    try:
        fill: Any = pytetwild.tetrahedralize  # type: ignore[attr-defined]
        nodes, tets = fill(vertices, triangles, quiet=True, **settings)[:2]
    except MemoryError:
        return NO_MEMORY
    except (RuntimeError, ValueError, IndexError) as error:
        print(error, file=sys.stderr)
        return REFUSED
    np.savez(made, nodes=nodes, tets=tets, mesher=f"pytetwild {metadata.version('pytetwild')}")
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
