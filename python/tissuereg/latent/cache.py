"""Fitted priors kept between calls, by the content of everything they depend on."""

import json
import zipfile

import numpy as np

from tissuereg.io.cache import cache_folder, keep_in_cache
from tissuereg.latent.pca import PcaModel

#: Oldest files go when there are more than this.
MOST_FILES = 40


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
    arrays = {
        "centre": model.centre,
        "components": model.components,
        "error_fields": model.error_fields,
        "error_sizes": model.error_sizes,
        "card": np.array(json.dumps(model.card)),
    }
    keep_in_cache(
        cache_folder() / f"prior_{key}.npz", lambda stream: np.savez(stream, allow_pickle=False, **arrays), MOST_FILES
    )
