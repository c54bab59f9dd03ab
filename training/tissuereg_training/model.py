r"""Table II's graph variational autoencoder.

    encoder   x (n0, 3) - conv 32 - pool - conv 64 - pool - conv 128 - pool - (n3 * 128) - two linear heads (q), (q)
    decoder   z (q) - linear (n3 * 128) - unpool - conv 64 - unpool - conv 32 - unpool - conv 3 - x (n0, 3)

ELU after every convolution but the last; none after pooling or the linear layers. Inside, fields are normalised,
`(displacement - mean field) / scale`.
"""

from collections.abc import Sequence
from typing import Any, ClassVar, cast

import torch
from torch import nn
from torch.nn import functional as F

from tissuereg_training.graph import Hierarchy
from tissuereg_training.layers import DensityPool, VertexConv, swapped
from tissuereg_training.network import Network


class GraphVae(Network):
    """The network, encoder and decoder.

    Parameters
    ----------
    levels : Hierarchy
        The mesh's graph and its coarsenings.
    channels : sequence of int
        Channels a level, finest first; one entry a pooling.
    n_bases : int
        Basis matrices a convolution.
    n_latent : int
        Latents.
    """

    kind: ClassVar[str] = "gnn-vae"

    def __init__(self, levels: Hierarchy, channels: Sequence[int], n_bases: int, n_latent: int) -> None:
        super().__init__()
        self.levels, self.channels, self.n_bases, self.n_latent = levels, tuple(channels), n_bases, n_latent
        self.n_nodes = levels.sizes[0]
        sizes, depth = levels.sizes, len(channels)
        widths = [3, *channels]
        self.encoder_convs = nn.ModuleList(
            VertexConv(levels.edges[k], sizes[k], widths[k], widths[k + 1], n_bases) for k in range(depth)
        )
        self.encoder_pools = nn.ModuleList(DensityPool(levels.pools[k], sizes[k + 1], sizes[k]) for k in range(depth))
        n_flat = sizes[-1] * channels[-1]
        self.mean_head = nn.Linear(n_flat, n_latent)
        self.log_variance_head = nn.Linear(n_flat, n_latent)
        nn.init.zeros_(self.log_variance_head.weight)
        nn.init.constant_(self.log_variance_head.bias, -4.0)
        self.fully_connected = nn.Linear(n_latent, n_flat)
        coarse_first = range(depth - 1, -1, -1)
        self.unpools = nn.ModuleList(
            DensityPool(swapped(levels.pools[k]), sizes[k], sizes[k + 1]) for k in coarse_first
        )
        self.decoder_convs = nn.ModuleList(
            VertexConv(levels.edges[k], sizes[k], widths[k + 1], widths[k], n_bases) for k in coarse_first
        )
        self.register_buffer("mean_mm", torch.zeros(sizes[0], 3))
        self.register_buffer("scale_mm", torch.ones(()))

    def facts(self) -> dict[str, Any]:
        """Return the sizes of levels and layers."""
        return {"levels": list(self.levels.sizes), "channels": list(self.channels), "n_bases": self.n_bases}

    def encoder_layers(self) -> list[tuple[VertexConv, DensityPool]]:
        """Return convolution and pooling of every level, finest first."""
        return cast(
            "list[tuple[VertexConv, DensityPool]]", list(zip(self.encoder_convs, self.encoder_pools, strict=True))
        )

    def decoder_layers(self) -> list[tuple[DensityPool, VertexConv]]:
        """Return unpooling and convolution of every level, coarsest first."""
        return cast("list[tuple[DensityPool, VertexConv]]", list(zip(self.unpools, self.decoder_convs, strict=True)))

    def normalised(self, displacement: torch.Tensor) -> torch.Tensor:
        """Return fields in the network's scale, dimensionless; any leading axes, (..., n_nodes, 3) mm."""
        return (displacement - self.mean_mm) / self.scale_mm

    def in_mm(self, x: torch.Tensor) -> torch.Tensor:
        """Return the inverse of `normalised`."""
        return x * self.scale_mm + self.mean_mm

    def encode(self, x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return mean and log-variance of q(z | x).

        Parameters
        ----------
        x : Tensor of float, shape (batch, n_nodes, 3)
            Normalised fields.

        Returns
        -------
        mean, log_variance : Tensor of float, shape (batch, n_latent)
            Dimensionless.
        """
        batch = x.shape[0]
        h = x.transpose(0, 1).reshape(self.n_nodes, batch * 3)
        for conv, pool in self.encoder_layers():
            h = pool(F.elu(conv(h)))
        flat = h.view(-1, batch, self.channels[-1]).transpose(0, 1).reshape(batch, -1)
        return self.mean_head(flat), self.log_variance_head(flat)

    def decode(self, z: torch.Tensor) -> torch.Tensor:
        """Return normalised fields.

        Parameters
        ----------
        z : Tensor of float, shape (batch, n_latent)
            Latents.

        Returns
        -------
        Tensor of float, shape (batch, n_nodes, 3)
            Normalised fields.
        """
        batch = z.shape[0]
        h: torch.Tensor = self.fully_connected(z).view(batch, -1, self.channels[-1]).transpose(0, 1)
        h = h.reshape(-1, batch * self.channels[-1])
        for step, (unpool, conv) in enumerate(self.decoder_layers()):
            h = conv(unpool(h))
            if step < len(self.channels) - 1:
                h = F.elu(h)
        return h.view(self.n_nodes, batch, 3).transpose(0, 1)
