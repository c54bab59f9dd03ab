"""How well models predict held-out data, block by block, so that the scorer can compare all on the same blocks.

Blocks are those of `tissuereg.diagnosis.proof`: every load case, and every fourth frame of each.
"""

import numpy as np

from tissuereg.diagnosis.proof import LinearModel, frame_blocks, held_out
from tissuereg.diagnosis.signals import SignalLayout


def by_block(base: LinearModel, final: LinearModel, layout: SignalLayout) -> dict[str, list[float]]:
    """Return for every block the number of measured values and the errors of two models in units of noise.

    Parameters
    ----------
    base, final : LinearModel
        The believed model, and the same with the findings.
    layout : SignalLayout
        Order of the data.

    Returns
    -------
    dict of str to list
        Number, root mean square of base and of final.
    """
    cases = {part.name: layout.of_case(part.name) for part in layout.parts}
    # A cause that shows in one case alone is tested on frames of that case.
    frames = {name: mask for part in layout.parts for name, mask in frame_blocks(layout, part).items()}
    table = {}
    for blocks in (cases, frames):
        left = held_out([base, final], blocks).residuals
        for name, mask in blocks.items():
            seen = mask & layout.seen
            if seen.any():
                table[name] = [int(seen.sum()), *np.sqrt((left[:, seen] ** 2).mean(axis=1)).tolist()]
    return table
