"""The layers of a model, and those of Table II of the paper."""

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Layer:
    """One layer: its name, and the shape of what it puts out."""

    name: str
    output: tuple[int, ...]

    @property
    def size(self) -> str:
        """Output as text, ``811 x 32``."""
        return " x ".join(map(str, self.output))


#: Nodes of the levels, channels and latents of the paper.
PAPER_LEVELS, PAPER_CHANNELS, PAPER_LATENTS = (4223, 811, 82, 6), (32, 64, 128), 26


def graph_layers(levels: tuple[int, ...], channels: tuple[int, ...], n_latent: int) -> tuple[Layer, ...]:
    """Return the layers of Table II for other sizes.

    Parameters
    ----------
    levels : tuple of int
        Nodes of each level, finest first.
    channels : tuple of int
        Of each convolution of the encoder; one fewer than the levels.
    n_latent : int
        Number of latents.

    Returns
    -------
    tuple of Layer
        Encoder, then decoder.
    """
    found: list[Layer] = []
    for k, width in enumerate(channels):
        found += [Layer("Convolution", (levels[k], width)), Layer("Pooling", (levels[k + 1], width))]
    flat = levels[-1] * channels[-1]
    found += [Layer("Reshape", (1, flat)), Layer("Fully connected", (1, n_latent))]
    found += [Layer("Fully connected", (1, flat)), Layer("Reshape", (levels[-1], channels[-1]))]
    for k in reversed(range(len(channels))):
        found.append(Layer("Un-pooling", (levels[k], channels[k])))
        found.append(Layer("Trans-convolution", (levels[k], channels[k - 1] if k else 3)))
    return tuple(found)


#: Table II.
PAPER = graph_layers(PAPER_LEVELS, PAPER_CHANNELS, PAPER_LATENTS)


def layers_of(card: dict[str, Any]) -> tuple[Layer, ...]:
    """Return the layers of a model.

    Parameters
    ----------
    card : dict
        Its card.

    Returns
    -------
    tuple of Layer
        As in Table II where it is a graph network; of other networks the decoder: fully connected layers, the linear
        part, components, and then those of a graph network where it has one; otherwise none.
    """
    levels, channels = card.get("levels"), card.get("channels")
    graph: tuple[Layer, ...] = ()
    if isinstance(levels, list) and isinstance(channels, list) and len(levels) == len(channels) + 1:
        graph = graph_layers(tuple(levels), tuple(channels), card["n_latent"])
    hidden, n_components = card.get("hidden"), card.get("n_components")
    if not isinstance(hidden, list) or not isinstance(n_components, int):
        return graph
    found = [Layer("Fully connected", (1, width)) for width in (*hidden, n_components)]
    found.append(Layer("Linear, from the latents, added", (1, n_components)))
    found.append(Layer("Principal components", (card["n_nodes"], 3)))
    return (*found, *graph[len(graph) // 2 :])
