r"""A closure and a graph network that decode the same latents: the first the body as a whole, the second its parts.

    encoder   the closure's: mean and log-variance (q) of the coefficients of the field
    decoder   displacement = mean field + components y(z) + scale * graph network(z)

The closure is that of `closure.py` with few components. What these leave out is small and local: the graph network adds
it with few numbers, since a node is reached by the coarse nodes beside it alone.

    graph network   z (q) - linear (nL * CL) - strided conv C(L-1) - .. - strided conv C1 - strided conv 3 (n0)

A strided convolution is a `VertexConv` over the edges of an unpooling, from a level straight to the next finer one: on
the mesh, a quarter of the edges of a convolution within the level, and of its time. The activation stands after each
but the last, which starts near zero, so that training starts at the closure.

A graph network in the encoder, its features beside the closure's before the two heads, changed nothing: with 96
components on 20,000 fields, 0.1691 mm after 8 epochs against 0.1687 mm without, and half as long again an epoch.
Without either graph network it was 0.1812 mm.
"""

import contextlib
from collections.abc import Iterator, Sequence
from typing import Any, ClassVar, cast

import torch
from torch import nn

from tissuereg_training.closure import ACTIVATIONS, SMALL, Closure
from tissuereg_training.graph import Hierarchy
from tissuereg_training.layers import VertexConv, swapped


class GraphClosure(Closure):
    """The network, encoder and decoder; `x` is the normalised field, as for Table II's network.

    Parameters
    ----------
    levels : Hierarchy
        The mesh's graph and its coarsenings.
    channels : sequence of int
        Channels a level, finest first; one entry a strided convolution.
    n_bases : int
        Basis matrices a convolution.
    n_components, n_latent, hidden, encoder_hidden, activation
        Of the closure; the activation is the graph network's as well.
    """

    kind: ClassVar[str] = "graph-closure"

    def __init__(
        self,
        levels: Hierarchy,
        channels: Sequence[int],
        n_bases: int,
        n_components: int,
        n_latent: int,
        hidden: Sequence[int],
        encoder_hidden: Sequence[int],
        activation: str,
    ) -> None:
        super().__init__(levels.sizes[0], n_components, n_latent, hidden, encoder_hidden, activation)
        self.levels, self.channels, self.n_bases = levels, tuple(channels), n_bases
        sizes, widths = levels.sizes, [3, *channels]
        self._whole = True
        self.graph_activation = ACTIVATIONS[activation]()
        self.fully_connected = nn.Linear(n_latent, sizes[-1] * channels[-1])
        self.graph_convs = nn.ModuleList(
            VertexConv(swapped(levels.pools[k]), sizes[k], widths[k + 1], widths[k], n_bases, sizes[k + 1])
            for k in reversed(range(len(channels)))
        )
        with torch.no_grad():
            self.graph_layers()[-1].bases.mul_(SMALL * SMALL)

    def facts(self) -> dict[str, Any]:
        """Return the sizes of closure and graph network."""
        graph = {"levels": list(self.levels.sizes), "channels": list(self.channels), "n_bases": self.n_bases}
        return {**super().facts(), **graph}

    def graph_layers(self) -> list[VertexConv]:
        """Return the strided convolutions, from the coarsest level to the mesh."""
        return cast("list[VertexConv]", list(self.graph_convs))

    def normalised(self, displacement: torch.Tensor) -> torch.Tensor:
        """Return fields in the network's scale, dimensionless; (batch, n_nodes, 3) mm."""
        return (displacement - self.mean_mm) / self.scale_mm

    def in_mm(self, x: torch.Tensor) -> torch.Tensor:
        """Return the inverse of `normalised`."""
        return x * self.scale_mm + self.mean_mm

    def encode(self, x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return mean and log-variance of q(z | x), each (batch, n_latent), of normalised fields."""
        share = self.scale_mm / self.coefficient_scale_mm.square()
        return super().encode(share * (x.flatten(1) @ self.components_mm.flatten(1).t()))

    def decode(self, z: torch.Tensor) -> torch.Tensor:
        """Return normalised fields (batch, n_nodes, 3) of latents (batch, n_latent)."""
        field = ((super().decode(z) / self.scale_mm) @ self.components_mm.flatten(1)).view(-1, self.n_nodes, 3)
        return field + self.graph_field(z) if self._whole else field

    @contextlib.contextmanager
    def graph_switched_off(self) -> Iterator[None]:
        """Decode the closure alone for a while."""
        self._whole = False
        try:
            yield
        finally:
            self._whole = True

    def graph_field(self, z: torch.Tensor) -> torch.Tensor:
        """Return what the graph network adds to the normalised field (batch, n_nodes, 3), of latents."""
        batch = z.shape[0]
        h: torch.Tensor = self.fully_connected(z).view(batch, -1, self.channels[-1]).transpose(0, 1)
        h = h.reshape(-1, batch * self.channels[-1])
        for step, conv in enumerate(self.graph_layers()):
            h = conv(self.graph_activation(h) if step else h)
        return h.view(self.n_nodes, batch, 3).transpose(0, 1)
