"""How well models predict what they were not fitted to, block by block, so that the scorer can take all on the same.

Blocks are those of `tissuereg.diagnose.proof`: every load case, and every fourth frame of each.
"""

import numpy as np

from tissuereg.diagnose.proof import Linear, frame_blocks, held_out
from tissuereg.diagnose.signals import Layout


def by_block(base: Linear, final: Linear, layout: Layout) -> dict[str, list[float]]:
    """Return for every block how many numbers were measured, and the error of two models in units of noise.

    Parameters
    ----------
    base, final : Linear
        What is believed, and with what was found.
    layout : Layout
        Order of the data.

    Returns
    -------
    dict of str to list
        Number, root mean square of base and of final.
    """
    cases = {part.name: layout.of_case(part.name) for part in layout.parts}
    # A cause that one case alone shows is proved on frames of it.
    frames = {name: mask for part in layout.parts for name, mask in frame_blocks(layout, part).items()}
    table = {}
    for blocks in (cases, frames):
        left = held_out([base, final], blocks).residuals
        for name, mask in blocks.items():
            seen = mask & layout.seen
            if seen.any():
                table[name] = [int(seen.sum()), *np.sqrt((left[:, seen] ** 2).mean(axis=1)).tolist()]
    return table
