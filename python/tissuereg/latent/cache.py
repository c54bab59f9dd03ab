"""Fitted priors kept between calls, by the content of everything they depend on.

They lie in ``$TISSUEREG_CACHE``, or the user's cache folder; deleting it costs time only. A file that cannot be
read is treated as absent.
"""

import json
import os
import zipfile
from pathlib import Path

import numpy as np

from tissuereg.io.atomic import atomic_file
from tissuereg.latent.pca import PcaModel

#: Oldest files go when there are more than this.
MOST_FILES = 40


def cache_folder() -> Path:
    """Return the folder of cached priors; it may not exist yet."""
    chosen = os.environ.get("TISSUEREG_CACHE")
    if chosen:
        return Path(chosen)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "tissuereg"


def load_cached(key: str) -> PcaModel | None:
    """Return the model kept under a key, or None.

    Parameters
    ----------
    key : str
        Fingerprint of everything the model depends on.

    Returns
    -------
    PcaModel or None
        None where there is none or the file is damaged.
    """
    path = cache_folder() / f"prior_{key}.npz"
    try:
        with np.load(path, allow_pickle=False) as kept:
            card = json.loads(str(kept["card"]))
            return PcaModel(kept["centre"], kept["components"], kept["error_fields"], kept["error_sizes"], card)
    except (OSError, ValueError, KeyError, zipfile.BadZipFile):
        return None


def store_cached(key: str, model: PcaModel) -> None:
    """Keep a model under a key; a cache that cannot be written is no error.

    Parameters
    ----------
    key : str
        Fingerprint of everything the model depends on.
    model : PcaModel
        What to keep.
    """
    folder = cache_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with atomic_file(folder / f"prior_{key}.npz") as path, path.open("wb") as stream:
            np.savez(
                stream,
                centre=model.centre,
                components=model.components,
                error_fields=model.error_fields,
                error_sizes=model.error_sizes,
                card=np.array(json.dumps(model.card)),
            )
        for old in sorted(folder.glob("prior_*.npz"), key=lambda p: p.stat().st_mtime)[:-MOST_FILES]:
            old.unlink(missing_ok=True)
    except OSError:
        return
