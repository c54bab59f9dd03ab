"""A decoder at some nodes alone."""

from collections.abc import Callable

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg_paper.studies.subject import StudyModel


def decoder_at(model: StudyModel, nodes: IntArray) -> Callable[[FloatArray], FloatArray]:
    """Return a decoder at nodes: latents (n_latent, n_members) to displacements (n_members, n_nodes, 3) in mm.

    A model that can be cut down to points (``cut``, of rows of weights on the nodes) is.
    """
    cut = getattr(model, "cut", None)
    if cut is not None:
        from scipy import sparse

        shape = (len(nodes), model.n_nodes)
        made = cut(sparse.csr_array((np.ones(len(nodes)), (np.arange(len(nodes)), nodes)), shape))
        if made is not None:
            return made  # type: ignore[no-any-return]
    return lambda latents: model.decode(latents, nodes)
