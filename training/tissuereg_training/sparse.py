r"""Products with a learned sparse matrix, and their gradients by hand.

One pattern of edges carries M numbers an edge, `values (M, n_edges)`. Stacked by basis they are the matrix

    K        (M * n_owners, n_others)     K[m * n_owners + i, j] = values[m, edge (i, j)]

and a layer needs two products with it, on dense columns `w = batch * channels`:

    spread   Z = K X        (M * n_owners, w) = (M * n_owners, n_others) (n_others, w)
    collect  Y = K' U       (n_others, w)     = (n_others, M * n_owners) (M * n_owners, w)

The gradient of one is the other; the gradient of the values is the outer product of the two dense sides *sampled* at
the pattern. Both index structures are built once a mesh (K' takes its values through a stored permutation), so a
training step costs sparse-dense products alone: M n_edges w multiply-adds each. Padded neighbourhoods with a batched
product, or gather and index_add, give the same numbers; `training/README.md` holds the times.
"""

import warnings
from typing import Any

import numpy as np
import torch

from tissuereg_training.graph import IntArray

with warnings.catch_warnings():
    # torch warns once per process that its CSR tensors are in beta state, or unchecked; trigger and suppress that here.
    warnings.filterwarnings("ignore", message="Sparse CSR tensor support is in beta state|Sparse invariant checks are")
    torch.sparse_csr_tensor([0, 1], [0], [1.0], check_invariants=False)


#: Columns below which M products are done as one wide product and a transposition; above it the products go straight
#: into place, one a basis (a broadcast product would fold the bases and copy the result).
_NARROW = 16


class EdgePattern:
    """Index structure of K and of its transpose.

    Parameters
    ----------
    edges : ndarray of int64, shape (n_edges, 2)
        Rows (owner, other), sorted.
    n_owners, n_others : int
        Nodes on either side.
    n_values : int
        Numbers an edge, M.
    """

    def __init__(self, edges: IntArray, n_owners: int, n_others: int, n_values: int = 1) -> None:
        self.edges = edges
        self.n_owners, self.n_others, self.n_values = n_owners, n_others, n_values
        n_edges = len(edges)
        owner, other = edges[:, 0], edges[:, 1]
        starts = np.searchsorted(owner, np.arange(n_owners + 1))
        blocks = np.arange(n_values)[:, None]
        self._rows = _int32(np.append((blocks * n_edges + starts[None, :-1]).ravel(), n_values * n_edges))
        self._columns = _int32(np.tile(other, n_values))
        # The transpose: entries by `other`, within it by basis, then by owner.
        row = (blocks * n_owners + owner[None]).ravel()
        order = np.lexsort((row, np.tile(other, n_values)))
        counts = np.bincount(other, minlength=n_others) * n_values
        self._rows_t = _int32(np.concatenate([[0], np.cumsum(counts)]))
        self._columns_t = _int32(row[order])
        self._order_t = torch.from_numpy(order)

    @property
    def n_edges(self) -> int:
        """Number of edges."""
        return len(self.edges)

    def matrix(self, values: torch.Tensor) -> torch.Tensor:
        """Return K, shape (M * n_owners, n_others), from `values` (M, n_edges)."""
        return self._csr(values.reshape(-1))

    def transposed(self, values: torch.Tensor) -> torch.Tensor:
        """Return the transpose of K, shape (n_others, M * n_owners), from `values` (M, n_edges)."""
        shape = (self.n_others, self.n_values * self.n_owners)
        self._follow(values)
        return torch.sparse_csr_tensor(
            self._rows_t, self._columns_t, values.reshape(-1)[self._order_t], shape, check_invariants=False
        )

    def sampled(self, spread_side: torch.Tensor, other_side: torch.Tensor) -> torch.Tensor:
        """Return the product of (M * n_owners, w) and (n_others, w) transposed, at the pattern, (M, n_edges)."""
        zeros = self._csr(spread_side.new_zeros(self.n_values * self.n_edges))
        product = torch.sparse.sampled_addmm(zeros, spread_side, other_side.t(), beta=0.0)
        values: torch.Tensor = product.values()
        return values.view(self.n_values, -1)

    def _csr(self, flat: torch.Tensor) -> torch.Tensor:
        shape = (self.n_values * self.n_owners, self.n_others)
        self._follow(flat)
        return torch.sparse_csr_tensor(self._rows, self._columns, flat, shape, check_invariants=False)

    def _follow(self, values: torch.Tensor) -> None:
        """Move the index structure to where the values lie; once, as a network moves as a whole."""
        if self._rows.device != values.device:
            for name in ("_rows", "_columns", "_rows_t", "_columns_t", "_order_t"):
                setattr(self, name, getattr(self, name).to(values.device))


class _Spread(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, values: torch.Tensor, x: torch.Tensor, pattern: EdgePattern) -> torch.Tensor:
        ctx.save_for_backward(values, x)
        ctx.pattern = pattern
        return _product(pattern.matrix(values), x)

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor | None, torch.Tensor | None, None]:
        values, x = ctx.saved_tensors
        gradient = gradients[0].contiguous()
        wanted = ctx.needs_input_grad
        of_values = ctx.pattern.sampled(gradient, x) if wanted[0] else None
        of_x = _product(ctx.pattern.transposed(values), gradient) if wanted[1] else None
        return of_values, of_x, None


class _Collect(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, values: torch.Tensor, u: torch.Tensor, pattern: EdgePattern) -> torch.Tensor:
        ctx.save_for_backward(values, u)
        ctx.pattern = pattern
        return _product(pattern.transposed(values), u)

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor | None, torch.Tensor | None, None]:
        values, u = ctx.saved_tensors
        gradient = gradients[0].contiguous()
        wanted = ctx.needs_input_grad
        of_values = ctx.pattern.sampled(u, gradient) if wanted[0] else None
        of_u = _product(ctx.pattern.matrix(values), gradient) if wanted[1] else None
        return of_values, of_u, None


class _Products(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: torch.Tensor, bases: torch.Tensor) -> torch.Tensor:
        ctx.save_for_backward(x, bases)
        return _split_product(x, bases)

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor | None, torch.Tensor]:
        x, bases = ctx.saved_tensors
        gradient = gradients[0].contiguous()
        of_x = _joined_product(gradient, bases.transpose(1, 2)) if ctx.needs_input_grad[0] else None
        return of_x, _split_product(x.t(), gradient)


class _SumOfProducts(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, z: torch.Tensor, bases: torch.Tensor) -> torch.Tensor:
        ctx.save_for_backward(z, bases)
        return _joined_product(z, bases)

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        z, bases = ctx.saved_tensors
        gradient = gradients[0].contiguous()
        of_bases = _split_product(gradient.t(), z).transpose(1, 2)
        return _split_product(gradient, bases.transpose(1, 2)), of_bases


def spread(values: torch.Tensor, x: torch.Tensor, pattern: EdgePattern) -> torch.Tensor:
    """Return K X.

    Parameters
    ----------
    values : Tensor of float, shape (M, n_edges)
        Learned numbers.
    x : Tensor of float, shape (n_others, w)
        Dense columns.
    pattern : EdgePattern
        Where the numbers stand.

    Returns
    -------
    Tensor of float, shape (M * n_owners, w)
        Differentiable in `values` and `x`.
    """
    result: torch.Tensor = _Spread.apply(values, x, pattern)
    return result


def collect(values: torch.Tensor, u: torch.Tensor, pattern: EdgePattern) -> torch.Tensor:
    """Return K' U.

    Parameters
    ----------
    values : Tensor of float, shape (M, n_edges)
        Learned numbers.
    u : Tensor of float, shape (M * n_owners, w)
        Dense columns.
    pattern : EdgePattern
        Where the numbers stand.

    Returns
    -------
    Tensor of float, shape (n_others, w)
        Differentiable in `values` and `u`.
    """
    result: torch.Tensor = _Collect.apply(values, u, pattern)
    return result


def products(x: torch.Tensor, bases: torch.Tensor) -> torch.Tensor:
    """Return `x B_m` for every m: (rows, I) and (M, I, O) give (M, rows, O)."""
    result: torch.Tensor = _Products.apply(x, bases)
    return result


def sum_of_products(z: torch.Tensor, bases: torch.Tensor) -> torch.Tensor:
    """Return the sum over m of `z_m B_m`: (M, rows, I) and (M, I, O) give (rows, O)."""
    result: torch.Tensor = _SumOfProducts.apply(z, bases)
    return result


def _split_product(left: torch.Tensor, right: torch.Tensor) -> torch.Tensor:
    """Return `left right_m` for every m: (a, k) and (M, k, b) give (M, a, b)."""
    n_bases, _, n_columns = right.shape
    if n_columns < _NARROW:
        joined = left @ right.transpose(0, 1).reshape(left.shape[1], -1)
        return joined.view(-1, n_bases, n_columns).transpose(0, 1).contiguous()
    result = left.new_empty(n_bases, left.shape[0], n_columns)
    for factor, out in zip(right, result, strict=True):
        torch.mm(left, factor, out=out)
    return result


def _joined_product(left: torch.Tensor, right: torch.Tensor) -> torch.Tensor:
    """Return the sum over m of `left_m right_m`: (M, a, k) and (M, k, b) give (a, b)."""
    if left.shape[2] < _NARROW:
        return left.transpose(0, 1).reshape(left.shape[1], -1) @ right.reshape(-1, right.shape[2])
    result = left[0] @ right[0]
    for a, b in zip(left[1:], right[1:], strict=True):
        result.addmm_(a, b)
    return result


def _product(matrix: torch.Tensor, dense: torch.Tensor) -> torch.Tensor:
    # `matrix @ dense` would fill, copy and fill again before the product is written.
    result = dense.new_empty(matrix.shape[0], dense.shape[1])
    return torch.addmm(result, matrix, dense, beta=0.0, out=result)


def _int32(array: Any) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(array, dtype=np.int32))
