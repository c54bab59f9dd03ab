r"""Decoders as tables of weights (``decoder_weights.npz`` of a model), and the same decoders reduced to a few points.

A point is a weighted sum of mesh nodes, so points are the rows of a sparse matrix P (n_rows, n_nodes). There are two
types of decoders, for latents z and displacement fields u, and their sum.

**Closure**: ``u = mean + sum_j c_j components_j`` with ``c = MLP(z)``, or ``MLP(z) + S z``, where MLP is a multilayer
perceptron and S a matrix. At points it ends in ``P components`` (3 n_rows, n_components) in place of the whole fields.

**Graph network** (Table II): a linear layer, then on every level ``x <- act(sum_m T_m x B_m + b)``, where x are the
features of the nodes, T_m (fine nodes, coarse nodes) combines the unpooling with the coefficients of basis m, B_m is
the matrix of that basis, b a bias and act the activation. At points, the last level's tables become P T_m, and every
earlier level keeps the nodes on which these depend. Linear steps that follow each other are multiplied into one matrix:
the linear layer with the first level, and the last level with P.
"""

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.errors import FormatError, ModelError
from tissuereg.io.fields import Archive, open_npz, read_npy
from tissuereg.registration.learned.batches import together
from tissuereg.registration.learned.digits import table_in
from tissuereg.registration.learned.onnx_bytes import OnnxGraph

#: Activations, by their names in a closure's weights.
_ACTIVATED: dict[str, Callable[[FloatArray], FloatArray]] = {
    "elu": lambda x: np.maximum(x, np.expm1(np.minimum(x, 0.0))),
    "silu": lambda x: x * (0.5 + 0.5 * np.tanh(0.5 * x)),
    "relu": lambda x: np.maximum(x, 0.0),
    "tanh": np.tanh,
}

#: A group of rows is split only if this share of its products is enough afterwards: each group copies its inputs.
_WORTH = 0.7

#: Parts of a field that are summed at the same time, whatever the number of threads, so that bits do not depend on it.
_PARTS = 4

#: Rows of a group where whole fields are wanted.
_TOGETHER = 128


@dataclass(frozen=True, eq=False)
class ClosureDecoder:
    """A decoder with a multilayer perceptron (MLP): ``displacement = mean + components @ (MLP(z) + skip @ z)``.

    `layers` are the weights and biases of the MLP, with an activation after all but the last; `skip` (n_components,
    n_latent) is a linear part, None for none; `activation` is one of elu, silu, relu, tanh; `components` float32
    (n_components, n_nodes, 3) are displacement fields, in mm; `mean` (n_nodes, 3) is a displacement field, in mm.
    """

    layers: tuple[tuple[FloatArray, FloatArray], ...]
    skip: FloatArray | None
    activation: str
    components: npt.NDArray[np.float32]
    mean: FloatArray

    @property
    def n_latent(self) -> int:
        """Number of latents."""
        return int(self.layers[0][0].shape[1])

    def decode(self, latents: FloatArray, nodes: IntArray | None = None, threads: int = 1) -> FloatArray:
        """Return displacement fields (n_members, k, 3), in mm, of latents (n_latent, n_members).

        `nodes` (k,) are the numbers of the nodes, by default all. The computation is in single precision, on `threads`
        threads. Cost: some tenths of a millisecond a member.
        """
        fields = np.asarray(self.mean + self._summed(self._coefficients(latents), threads))
        return fields if nodes is None else fields[:, nodes]

    def change(self, latents: FloatArray, code: FloatArray, threads: int = 1) -> FloatArray:
        """Return the fields of `latents` (n_latent, n_members) minus that of `code` (n_latent,), in mm.

        The result has shape (n_members, n_nodes, 3). Cost: that of `decode` for the members alone.
        """
        x = self._coefficients(np.concatenate([code[:, None], latents], axis=1))
        return np.asarray(self._summed(x[:, 1:] - x[:, :1], threads), np.float64)

    def _coefficients(self, latents: FloatArray) -> Any:
        """Return the coefficients (n_components, n_members) of the components for latents (n_latent, n_members)."""
        z: Any = latents.astype(np.float32)
        x = z
        for number, (weight, bias) in enumerate(self._single):
            x = weight @ x + bias[:, None]
            if number < len(self.layers) - 1:
                x = _ACTIVATED[self.activation](x)
        return x if self.skip is None else x + self.skip.astype(np.float32) @ z

    def _summed(self, coefficients: Any, threads: int) -> Any:
        flat = self.components.reshape(len(self.components), -1)
        members = np.ascontiguousarray(coefficients.T)
        ends = np.linspace(0, flat.shape[1], _PARTS + 1).astype(int)

        def part(first: int, last: int) -> Any:
            # One by one: products with a vector read the components where they lie, products of matrices copy them.
            return np.stack([one @ flat[:, first:last] for one in members])

        found = together([partial(part, *pair) for pair in pairwise(ends)], threads)
        return np.concatenate(found, axis=1).reshape(-1, *self.mean.shape)

    @cached_property
    def _single(self) -> list[Any]:
        return [(weight.astype(np.float32), bias.astype(np.float32)) for weight, bias in self.layers]

    def added_at(self, graph: OnnxGraph, rows: Any, output: str) -> int:
        """Add the decoder at points to an ONNX graph, as `network_at` has them; return the multiply-adds a member."""
        n_rows = rows.shape[0]
        flat = np.moveaxis(self.components, 0, -1).reshape(self.components.shape[1], -1)
        fields = np.asarray(rows @ flat).reshape(3 * n_rows, -1)
        last, bias = self.layers[-1]
        offset = (rows @ self.mean).ravel()
        layers = list(self.layers[:-1])
        # The MLP ends linear: with few points its last layer and the components are one smaller matrix.
        joined = 3 * n_rows * last.shape[1] <= last.size + fields.size
        end, constant = (fields @ last, fields @ bias + offset) if joined else (fields, offset)
        x = "z"
        for weight, shift in layers:
            x = _activated(graph, self.activation, graph.node("Gemm", [x, *_linear(graph, weight, shift)]))
        if not joined:
            x = graph.node("Gemm", [x, *_linear(graph, last, bias)])
            layers.append((last, bias))
        layers.append((end, constant))
        y = graph.node("Gemm", [x, *_linear(graph, end, constant)], output=output if self.skip is None else "")
        if self.skip is not None:
            straight = fields @ self.skip
            layers.append((straight, constant))
            graph.node("Gemm", ["z", graph.table(np.ascontiguousarray(straight.T)), y], output=output)
        return sum(weight.size for weight, _ in layers)


@dataclass(frozen=True, eq=False)
class GraphLevel:
    """One level of a graph network's decoder, unpooling and convolution: ``y = sum_m T_m x B_m + b``.

    x (n_coarse, n_in) and y (n_fine, n_out) are features of the nodes. `tables` are sparse matrices T_m (n_fine,
    n_coarse), one for each basis m, all with the same pattern of non-zeros; `bases` (M, n_in, n_out) are the matrices
    B_m; `bias` (n_out,) is b.
    """

    tables: tuple[Any, ...]
    bases: FloatArray
    bias: FloatArray

    @cached_property
    def joined(self) -> Any:
        """All T_m as one sparse float32 matrix (n_fine, n_coarse M); the M columns of a coarse node are adjacent."""
        from scipy import sparse

        blocks = [sparse.coo_array(table) for table in self.tables]
        n_bases, (n_fine, n_coarse) = len(blocks), blocks[0].shape
        rows = np.concatenate([one.row for one in blocks])
        columns = np.concatenate([one.col.astype(np.int64) * n_bases + m for m, one in enumerate(blocks)])
        values = np.concatenate([one.data for one in blocks]).astype(np.float32)
        return sparse.csr_array((values, (rows, columns)), (n_fine, n_coarse * n_bases))

    @cached_property
    def joined_bases(self) -> Any:
        """All matrices B_m, transposed, on top of each other, as one float32 matrix of shape (M n_out, n_in)."""
        return np.ascontiguousarray(self.bases.transpose(0, 2, 1).reshape(-1, self.bases.shape[1]), np.float32)

    def at(self, rows: IntArray, columns: IntArray) -> FloatArray:
        """Return the T_m at fine nodes `rows` and coarse nodes `columns`, as a dense array (n_rows, n_columns, M)."""
        return _dense([table[rows] for table in self.tables], columns)

    def reached(self, rows: IntArray) -> IntArray:
        """Return the numbers, ascending, of the coarse nodes on which the fine nodes with numbers `rows` depend."""
        return np.unique(self.tables[0][rows].indices).astype(np.int64)


@dataclass(frozen=True, eq=False)
class GraphDecoder:
    """A graph network's decoder, alone (Table II) or added to a closure: a linear layer, then levels up to the mesh.

    `weight` (n_coarsest n_channels, n_latent) and `bias` (n_coarsest n_channels,) are those of the linear layer, in
    which the channels (features) of a node follow each other. `levels` are the levels, coarsest first, with the
    activation `activation` after all but the last. The displacement is `mean` (n_nodes, 3), in mm, plus `scale`, in mm,
    times the last level's output, plus that of `closure`, if there is one.
    """

    weight: FloatArray
    bias: FloatArray
    levels: tuple[GraphLevel, ...]
    mean: FloatArray
    scale: float
    activation: str = "elu"
    closure: ClosureDecoder | None = None

    def added_at(self, graph: OnnxGraph, rows: Any, output: str) -> int:
        """Add the decoder at points to an ONNX graph, as `network_at` has them; return the multiply-adds a member."""
        if self.closure is None:
            return self._levels_at(graph, rows, output)
        work = self._levels_at(graph, rows, "levels") + self.closure.added_at(graph, rows, "closure")
        graph.node("Add", ["closure", "levels"], output=output)
        return work

    def _levels_at(self, graph: OnnxGraph, rows: Any, output: str) -> int:
        """Add all but the closure at points to an ONNX graph; return the number of multiply-adds for one member."""
        last = self.levels[-1]
        at_points = [rows @ table for table in last.tables]
        offset = (rows @ self.mean + self.scale * np.outer(rows.sum(axis=1), last.bias)).ravel()
        needed = [np.unique(np.concatenate([table.indices for table in at_points])).astype(np.int64)]
        for level in self.levels[-2:0:-1]:
            needed.insert(0, level.reached(needed[0]))
        if len(self.levels) == 1:
            expanded = self._expanded(at_points, needed[-1])
            given = _linear(graph, expanded @ self.weight, expanded @ self.bias + offset)
            graph.node("Gemm", ["z", *given], output=output)
            return len(offset) * self.n_latent
        matrix, constant = self._first(needed[0])
        x = _activated(graph, self.activation, graph.node("Gemm", ["z", *_linear(graph, matrix, constant)]))
        work = matrix.size
        for number, level in enumerate(self.levels[1:-1]):
            columns, rows_here = needed[number], needed[number + 1]
            x, added = _summed(graph, level.at(rows_here, columns), level.bases, x)
            x = _activated(graph, self.activation, graph.node("Add", [x, graph.table(level.bias)]))
            x = graph.reshape(x, 0, len(rows_here) * len(level.bias))
            work += added
        return work + self._end(graph, at_points, needed[-1], (x, output), offset)

    def whole(self) -> bytes:
        """Return an ONNX file: ``z`` (members, n_latent) to ``displacement`` (members, n_nodes, 3), without closure."""
        n_nodes = len(self.mean)
        graph, x = OnnxGraph("graph_network"), "z"
        x = graph.reshape(graph.node("Gemm", ["z", *_linear(graph, self.weight, self.bias)]), 0, -1, self._n_in)
        for number, level in enumerate(self.levels):
            given = _based(graph, level.bases, x, level.tables[0].shape[1])
            n_fine = level.tables[0].shape[0]
            parts = []
            # Nodes with near numbers share neighbours, more or less.
            for group in np.array_split(np.arange(n_fine), -(-n_fine // _TOGETHER)):
                near = level.reached(group)
                parts.append(_block(graph, level.at(group, near), near, given, level.bases))
            x = parts[0] if len(parts) == 1 else graph.node("Concat", parts, axis=1)
            x = graph.node("Add", [x, graph.table(level.bias)])
            if number < len(self.levels) - 1:
                x = _activated(graph, self.activation, x)
        x = graph.node("Mul", [x, graph.table(np.array(self.scale))])
        graph.node("Add", [x, graph.table(self.mean)], output="displacement")
        return graph.to_bytes(("z", self.n_latent), ("displacement", n_nodes, 3))

    @property
    def n_latent(self) -> int:
        """Number of latents."""
        return int(self.weight.shape[1])

    @property
    def _n_in(self) -> int:
        """Number of features (channels) of each node after the linear layer."""
        return int(self.levels[0].bases.shape[1])

    def _end(
        self, graph: OnnxGraph, at_points: list[Any], columns: IntArray, ends: tuple[str, str], offset: FloatArray
    ) -> int:
        """Add the last level, evaluated at points, to an ONNX graph; return its number of multiply-adds for one member.

        `at_points` are the sparse products P T_m (n_points, n_coarse) of the points' weights with the tables of the
        last level, `columns` the numbers of the coarse nodes in use, `ends` the names of their features and of the
        result in the graph, and `offset` (3 n_points,) the constant part of the displacement, in mm. The sum of
        (P T_m) x B_m over the bases m, with B_m (n_in, 3), has constant coefficients. For few points these are
        multiplied into one matrix; for many, as around markers off the surface, x is multiplied by the B_m first.
        """
        bases = self.scale * self.levels[-1].bases
        table = _dense(at_points, columns)
        groups = _groups(table.any(axis=2))
        by_groups = len(columns) * int(bases.size) + sum(
            len(group) * int(table[group].any(axis=(0, 2)).sum()) * len(bases) * 3 for group in groups
        )
        whole = len(offset) * len(columns) * int(bases.shape[1])
        if whole <= by_groups:
            graph.node("Gemm", [ends[0], *_linear(graph, self._expanded(at_points, columns), offset)], output=ends[1])
            return whole
        y, added = _summed(graph, table, bases, ends[0], groups)
        y = graph.reshape(y, 0, len(offset))
        graph.node("Add", [y, graph.table(offset)], output=ends[1])
        return added

    def _expanded(self, at_points: list[Any], columns: IntArray) -> FloatArray:
        """Return the last level at points as one matrix (3 n_points, n_columns n_in): features to displacement, mm.

        `at_points` are sparse tables (n_points, n_coarse), one for each basis; `columns` the numbers of coarse nodes.
        """
        found: FloatArray = np.einsum(
            "rkm,mio->roki", _dense(at_points, columns), self.scale * self.levels[-1].bases, optimize=True
        )
        return found.reshape(3 * at_points[0].shape[0], -1)

    def decode(self, latents: FloatArray, nodes: IntArray | None = None, threads: int = 1) -> FloatArray:
        """Return displacement fields (n_members, k, 3), in mm, of latents (n_latent, n_members).

        `nodes` (k,) are the numbers of the nodes, by default all. The computation is in single precision, the levels on
        one thread, a closure on `threads`. Cost: milliseconds a member, since sums take non-zero coefficients alone.
        """
        n_members = latents.shape[1]
        x: Any = (self.weight @ latents + self.bias[:, None]).astype(np.float32)
        for number, level in enumerate(self.levels):
            last = number == len(self.levels) - 1
            _, n_in, n_out = level.bases.shape
            # Coarse nodes and bases are rows; channels and members columns.
            coarse = x.reshape(-1, n_in, n_members)
            products = np.matmul(level.joined_bases, coarse).reshape(-1, n_out * n_members)
            table = level.joined[nodes] if last and nodes is not None else level.joined
            y = (table @ products).reshape(-1, n_out, n_members) + level.bias[:, None].astype(np.float32)
            x = y if last else _ACTIVATED[self.activation](y)
        mean = self.mean if nodes is None else self.mean[nodes]
        found = np.asarray(mean + self.scale * np.moveaxis(x.astype(np.float64), 2, 0))
        return found if self.closure is None else found + self.closure.decode(latents, nodes, threads)

    def change(self, latents: FloatArray, code: FloatArray, threads: int = 1) -> FloatArray:
        """Return fields (n_members, n_nodes, 3), mm: those of latents (n_latent, n_members) minus that of a code."""
        both = self.decode(np.concatenate([code[:, None], latents], axis=1), threads=threads)
        return np.asarray(both[1:] - both[0])

    def _first(self, rows: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return the linear layer and the first level as one matrix and one constant, at some nodes of that level.

        `rows` int64 (n_rows,) are the numbers of these nodes; the matrix has shape (n_rows n_out, n_latent), the
        constant (n_rows n_out,).
        """
        level, n_in = self.levels[0], self.levels[0].bases.shape[1]
        joined = np.concatenate([self.weight, self.bias[:, None]], axis=1).reshape(-1, n_in, self.weight.shape[1] + 1)
        found = sum(
            np.einsum("rkq,ko->roq", np.tensordot(table[rows].toarray(), joined, 1), basis, optimize=True)
            for table, basis in zip(level.tables, level.bases, strict=True)
        )
        flat = np.asarray(found).reshape(-1, joined.shape[2])
        return flat[:, :-1], flat[:, -1] + np.tile(level.bias, len(rows))


def network_at(decoder: ClosureDecoder | GraphDecoder, rows: Any) -> tuple[bytes, int]:
    """Return a decoder at points as the bytes of an ONNX file, and its number of multiply-adds for one member.

    `rows`, a sparse matrix (n_rows, n_nodes), holds the weights of the mesh nodes in each point. The file maps ``z``
    (members, n_latent) to ``moved`` (members, 3 n_rows), displacements in mm; x, y and z of a point follow each other.
    """
    graph = OnnxGraph("decoder_at_points")
    work = decoder.added_at(graph, rows, "moved")
    return graph.to_bytes(("z", decoder.n_latent), ("moved", 3 * rows.shape[0])), work


def read_decoder(path: Path, listed: Collection[str] | None = None) -> ClosureDecoder | GraphDecoder | None:
    """Return the decoder of whole fields in a file of weights, or None if it is neither a closure nor a graph network.

    `path` is that of ``decoder_weights.npz`` of a model; `listed`: names of the files that its card lists, for others
    are not read; None for all. Raises `ModelError` if arrays are missing, not finite, or do
    not fit each other.
    """
    try:
        with open_npz(path) as archive:
            weights = Archive(path, _Beside(Path(path), archive.arrays, listed))
            closure = _closure(weights) if "activation" in weights else None
            decoder = _graph_network(weights, closure) if "fully_connected.bias" in weights else closure
            _check_not_empty(weights)
            return decoder
    except FormatError as error:
        raise ModelError(str(error), where=str(path)) from error


@dataclass(frozen=True)
class _Beside(Mapping[str, Any]):
    """The arrays of ``decoder_weights.npz``, and tables beside it that networks share, if the card lists them.

    `path`: that file; `arrays`: what it holds; `listed`: names of the files that the card lists, None for all.
    """

    path: Path
    arrays: Mapping[str, Any]
    listed: Collection[str] | None

    def __getitem__(self, name: str) -> Any:
        return self.arrays[name] if name in self.arrays else read_npy(self._file(name))

    def __contains__(self, name: object) -> bool:
        return name in self.arrays or self._known(self._file(str(name)))

    def __iter__(self) -> Iterator[str]:
        return iter(self.arrays)

    def __len__(self) -> int:
        return len(self.arrays)

    def _file(self, name: str) -> Path:
        return self.path.with_name(f"{name.replace('/', '.')}.npy")

    def _known(self, file: Path) -> bool:
        return file.exists() if self.listed is None else file.name in self.listed


def _check_not_empty(weights: Archive) -> None:
    """Raise `ModelError` if a table of weights is 0 throughout, as none is that was trained."""
    made, most_layers = ("layer{}/weight", "conv{}.bases", "conv{}.coefficients"), 32
    names = ["components_mm", "fully_connected.weight"]
    names += [one.format(k) for one in made for k in range(most_layers)]
    empty = [name for name in names if name in weights and not weights.raw(name).any()]
    if empty:
        message = f"array '{empty[0]}' in {weights.path} must hold numbers other than 0; it holds none"
        raise ModelError(message, where=f"{weights.path}:{empty[0]}")


def _closure(weights: Archive) -> ClosureDecoder:
    activation = str(weights.raw("activation")).lower()
    if activation not in _ACTIVATED:
        message = f"`activation` in {weights.path} must be one of {', '.join(_ACTIVATED)}, got {activation!r}"
        raise ModelError(message, where=str(weights.path))
    mean = table_in(weights, "mean_mm", None, 3)
    layers: list[tuple[FloatArray, FloatArray]] = []
    while f"layer{len(layers)}/bias" in weights or not layers:
        name = f"layer{len(layers)}"
        weight = table_in(weights, f"{name}/weight", None, len(layers[-1][1]) if layers else None)
        layers.append((weight, table_in(weights, f"{name}/bias", len(weight))))
    n_components, n_latent = len(layers[-1][1]), layers[0][0].shape[1]
    skip = table_in(weights, "skip/weight", n_components, n_latent) if "skip/weight" in weights else None
    components = table_in(weights, "components_mm", n_components, len(mean), 3).astype(np.float32)
    return ClosureDecoder(tuple(layers), skip, activation, components, mean)


def _graph_network(weights: Archive, closure: ClosureDecoder | None) -> GraphDecoder:
    sizes = weights.indices("levels", None)
    weight = table_in(weights, "fully_connected.weight", None, None)
    bias = table_in(weights, "fully_connected.bias", len(weight))
    levels: list[GraphLevel] = []
    n_in = len(weight) // max(1, int(sizes[0]))
    for k in range(1, len(sizes)):
        levels.append(_level(weights, k, int(sizes[k - 1]), int(sizes[k]), n_in))
        n_in = levels[-1].bases.shape[2]
    if not levels or n_in != 3 or len(weight) != sizes[0] * levels[0].bases.shape[1]:
        message = f"the layers in {weights.path} must fit each other and end in 3 channels, they end in {n_in}"
        raise ModelError(message, where=str(weights.path))
    mean, scale = table_in(weights, "mean_mm", int(sizes[-1]), 3), float(weights.floats("scale_mm"))
    if closure is None:
        return GraphDecoder(weight, bias, tuple(levels), mean, scale)
    if closure.n_latent != weight.shape[1]:
        message = f"{weights.path} must have one number of latents, got {weight.shape[1]} and {closure.n_latent}"
        raise ModelError(message, where=str(weights.path))
    return GraphDecoder(weight, bias, tuple(levels), np.zeros_like(mean), scale, closure.activation, closure)


def _level(weights: Archive, k: int, n_coarse: int, n_fine: int, n_in: int) -> GraphLevel:
    from scipy import sparse

    bases = table_in(weights, f"conv{k}.bases", None, n_in, None)
    edges = weights.indices(f"conv{k}.edges", None, 2)
    coefficients = table_in(weights, f"conv{k}.coefficients", len(edges), len(bases))
    if len(edges) == 0 or edges.min() < 0 or (edges.max(axis=0) >= (n_fine, n_coarse)).any():
        message = f"edges of conv{k} in {weights.path} must lie between nodes of {n_fine} and {n_coarse}"
        raise ModelError(message, where=str(weights.path))
    # Coefficients that are zero stay, so that all bases have one pattern.
    tables = tuple(sparse.csr_array((one, (edges[:, 0], edges[:, 1])), (n_fine, n_coarse)) for one in coefficients.T)
    return GraphLevel(tables, bases, table_in(weights, f"conv{k}.bias", bases.shape[2]))


def _dense(tables: list[Any], columns: IntArray) -> FloatArray:
    """Return M sparse tables at the columns with numbers `columns` as one dense array (n_rows, n_columns, M)."""
    return np.stack([table[:, columns].toarray() for table in tables], axis=-1)


def _summed(
    graph: OnnxGraph, table: FloatArray, bases: FloatArray, x: str, groups: list[IntArray] | None = None
) -> tuple[str, int]:
    """Add ``sum_m T_m x B_m`` to an ONNX graph; return the result's name and the multiply-adds for one member.

    `table` (n_rows, n_columns, M) holds the T_m, `bases` (M, n_in, n_out) the B_m, and `x` is the name of the features
    (members, n_columns n_in). They are multiplied by the bases first; the sum over columns is dense within `groups` of
    rows that share their non-zero columns, by default found here. The result has shape (members, n_rows, n_out).
    """
    n_columns = table.shape[1]
    given = _based(graph, bases, x, n_columns)
    work = n_columns * int(bases.size)
    groups = _groups(table.any(axis=2)) if groups is None else groups
    parts = []
    for group in groups:
        near = np.flatnonzero(table[group].any(axis=(0, 2)))
        whole = len(near) == n_columns
        parts.append(_block(graph, table[np.ix_(group, near)], None if whole else near, given, bases))
        work += len(group) * len(near) * bases.shape[0] * bases.shape[2]
    if len(parts) == 1:
        return parts[0], work
    # Back into the order of the rows.
    order = np.argsort(np.concatenate(groups), kind="stable")
    return graph.node("Gather", [graph.node("Concat", parts, axis=1), graph.table(order)], axis=1), work


def _based(graph: OnnxGraph, bases: FloatArray, x: str, n_columns: int) -> str:
    """Add the products of the features of coarse nodes with all bases to an ONNX graph; return the result's name.

    `bases` has shape (M, n_in, n_out), `x` is the name of the features (members, n_columns n_in), and the result has
    shape (members, n_columns, M n_out).
    """
    n_bases, n_in, n_out = bases.shape
    x = graph.reshape(x, -1, n_in)
    x = graph.node("MatMul", [x, graph.table(bases.transpose(1, 0, 2).reshape(n_in, -1))])
    return graph.reshape(x, -1, n_columns, n_bases * n_out)


def _block(graph: OnnxGraph, table: FloatArray, near: IntArray | None, given: str, bases: FloatArray) -> str:
    """Add the sum over coarse nodes and bases for a group of fine nodes to an ONNX graph; return the result's name.

    `table` (n_group, n_near, M) holds the coefficients; `near` (n_near,) are the positions of the coarse nodes in
    `given`, None for all; `given` is the name of the products with the bases, (members, n_columns, M n_out). The result
    has shape (members, n_group, n_out).
    """
    taken = given if near is None else graph.node("Gather", [given, graph.table(near)], axis=1)
    taken = graph.reshape(taken, 0, table.shape[1] * bases.shape[0], bases.shape[2])
    return graph.node("MatMul", [graph.table(table.reshape(len(table), -1)), taken])


def _groups(pattern: Any) -> list[IntArray]:
    """Divide the rows of a 0/1 matrix into groups with few non-zero columns; return the row numbers of each group.

    `pattern` has shape (n_rows, n_columns). Groups are halved as long as that saves products.
    """

    def halved(rows: IntArray) -> list[IntArray]:
        mine = pattern[rows]
        if len(rows) < 16:
            return [rows]
        # The leading variation of the pattern over its rows; neighbours in the body are neighbours along it.
        away = mine - mine.mean(axis=0)
        order = np.argsort(np.linalg.svd(away, full_matrices=False)[0][:, 0], kind="stable")
        halves = [np.sort(rows[order[: len(rows) // 2]]), np.sort(rows[order[len(rows) // 2 :]])]
        after = sum(len(half) * int(pattern[half].any(axis=0).sum()) for half in halves)
        if after > _WORTH * len(rows) * int(mine.any(axis=0).sum()):
            return [rows]
        return [group for half in halves for group in halved(half)]

    return halved(np.arange(len(pattern)))


def _linear(graph: OnnxGraph, matrix: FloatArray, constant: FloatArray) -> tuple[str, str]:
    return graph.table(np.ascontiguousarray(matrix.T)), graph.table(constant)


def _activated(graph: OnnxGraph, activation: str, x: str) -> str:
    if activation == "silu":
        return graph.node("Mul", [x, graph.node("Sigmoid", [x])])
    if activation == "elu":
        # max(x, exp(min(x, 0)) - 1): three times as fast as onnxruntime's own ELU, the same to single precision.
        below = graph.node("Exp", [graph.node("Clip", [x, "", graph.table(np.zeros(()))])])
        return graph.node("Max", [x, graph.node("Sub", [below, graph.table(np.ones(()))])])
    return graph.node(activation.capitalize(), [x])
