r"""The layers of Zhou et al. 2020: convolution with vertex-wise kernels, pooling with learned densities.

    vcConv      y_i = sum_j (sum_m a_ijm B_m)' x_j + b        B_m (I, O), m = 1..M, one free a_ijm an edge and basis
    vdPool      y_i = sum_j rho'_ij x_j                       rho' = |rho| / (sum_j |rho| + 1e-8)

Fields travel node first, `(n_nodes, batch * channels)`, so that a neighbourhood sum is one sparse product. The order of
the two sums in vcConv is free, and the narrower side is mixed: coefficients first where I < O, bases first otherwise.
The sparse part then costs M n_edges batch min(I, O) multiply-adds.

Notes
-----
Y. Zhou et al., "Fully convolutional mesh autoencoder using efficient spatially varying kernels", NeurIPS 2020.
"""

import numpy as np
import numpy.typing as npt
import torch
from torch import nn

from tissuereg_training.graph import IntArray
from tissuereg_training.sparse import EdgePattern, collect, products, spread, sum_of_products

FloatArray = npt.NDArray[np.float32]


class VertexConv(nn.Module):
    """Convolution whose kernel varies from vertex to vertex within the span of M bases.

    Parameters
    ----------
    edges : ndarray of int64, shape (n_edges, 2)
        Rows (node, neighbour) sorted by node. Within a level symmetric, self included; between two levels (a
        convolution with stride) those of a pooling or of an unpooling.
    n_nodes : int
        Nodes after it.
    n_in, n_out : int
        Channels.
    n_bases : int
        M.
    n_sources : int, optional
        Nodes before it, where they are another level's.
    """

    def __init__(
        self, edges: IntArray, n_nodes: int, n_in: int, n_out: int, n_bases: int, n_sources: int | None = None
    ) -> None:
        super().__init__()
        n_sources = n_nodes if n_sources is None else n_sources
        self.n_nodes, self.n_sources, self.n_in, self.n_out, self.n_bases = n_nodes, n_sources, n_in, n_out, n_bases
        #: Coefficients first: owner of an edge is its target. Bases first: its source.
        self.mixes_first = n_in < n_out
        if self.mixes_first:
            self.pattern = EdgePattern(edges, n_nodes, n_sources, n_bases)
        else:
            self.pattern = EdgePattern(swapped(edges), n_sources, n_nodes, n_bases)
        degree = len(edges) / n_nodes
        # Small coefficients with bases of size one: equal steps of Adam then change the coefficients most.
        # Starts of the same product but other shares (a / sqrt(degree M), B / sqrt(I)) learned far more slowly.
        self.coefficients = nn.Parameter(torch.randn(n_bases, len(edges)) / (degree * n_bases))
        self.bases = nn.Parameter(torch.randn(n_bases, n_in, n_out))
        self.bias = nn.Parameter(torch.zeros(n_out))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return the layer's output before activation.

        Parameters
        ----------
        x : Tensor of float, shape (n_sources, batch * n_in)
            Input.

        Returns
        -------
        Tensor of float, shape (n_nodes, batch * n_out)
            Output.
        """
        batch = x.shape[1] // self.n_in
        if self.mixes_first:
            z = spread(self.coefficients, x, self.pattern).view(self.n_bases, -1, self.n_in)
            y = sum_of_products(z, self.bases)
        else:
            u = products(x.reshape(-1, self.n_in), self.bases)
            y = collect(self.coefficients, u.view(self.n_bases * self.n_sources, -1), self.pattern).view(-1, self.n_out)
        return (y + self.bias).view(self.n_nodes, batch * self.n_out)

    def edge_table(self) -> tuple[IntArray, FloatArray]:
        """Return edges (node, neighbour), sorted, and their coefficients (n_edges, M), whatever the order inside."""
        edges = self.pattern.edges if self.mixes_first else self.pattern.edges[:, ::-1]
        order = np.lexsort((edges[:, 1], edges[:, 0]))
        return edges[order].copy(), self.coefficients.detach().cpu().numpy().T[order].copy()


class DensityPool(nn.Module):
    """Weighted mean over a neighbourhood, weights learned; pools or unpools.

    Parameters
    ----------
    edges : ndarray of int64, shape (n_edges, 2)
        Rows (target, source) sorted by target.
    n_targets, n_sources : int
        Nodes after and before.
    """

    def __init__(self, edges: IntArray, n_targets: int, n_sources: int) -> None:
        super().__init__()
        self.pattern = EdgePattern(edges, n_targets, n_sources)
        self.densities = nn.Parameter(torch.randn(len(edges)) * (n_targets / len(edges)))
        self._target: torch.Tensor
        self.register_buffer("_target", torch.from_numpy(edges[:, 0].copy()), persistent=False)

    def weights(self) -> torch.Tensor:
        """Return rho', shape (n_edges,): not negative, summing to one over a target's edges."""
        size = self.densities.abs()
        total = size.new_zeros(self.pattern.n_owners).index_add(0, self._target, size) + 1e-8
        return size / total[self._target]

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return the means: (n_sources, w) gives (n_targets, w)."""
        return spread(self.weights()[None], x, self.pattern)


def swapped(edges: IntArray) -> IntArray:
    """Return edges (n_edges, 2) with both ends exchanged, sorted again."""
    turned = edges[:, ::-1]
    return np.ascontiguousarray(turned[np.lexsort((turned[:, 1], turned[:, 0]))])
