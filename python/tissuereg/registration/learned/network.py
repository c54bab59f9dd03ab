"""A trained encoder and decoder of displacement fields, run by onnxruntime."""

import hashlib
import os
import threading
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray, float_array
from tissuereg._base.machine import n_cores
from tissuereg._base.provenance import reads
from tissuereg.body.mesh import Mesh
from tissuereg.errors import ModelError
from tissuereg.io.fields import open_npz
from tissuereg.registration.learned.batches import in_batches
from tissuereg.registration.learned.calibration import Calibration
from tissuereg.registration.learned.calibration_file import read_calibration
from tissuereg.registration.learned.card import check_files, read_card
from tissuereg.registration.learned.cut import CutDecoder, session
from tissuereg.registration.learned.decoders import ClosureDecoder, GraphDecoder, read_decoder
from tissuereg.registration.learned.digits import table_in
from tissuereg.registration.learned.model import Gaussian
from tissuereg.registration.learned.stated import stated

#: Members decoded in one call; bounds the memory of the gathered neighbourhoods.
_BATCH = 25

#: Up to so many whole fields come from the tables: faster than the file, whose products are laid out for many.
_FEW = 4

#: The last models that were read, with their files' times and sizes.
_NETWORKS: "dict[tuple[Any, ...], NetworkModel]" = {}
_KEEPING = threading.Lock()

#: Sets of points whose cut decoders a model keeps.
_KEPT = 8


class NetworkModel:
    """The trained model in a folder: ``encoder.onnx``, ``decoder.onnx``, ``decoder_weights.npz`` and ``model.json``.

    `folder` is the folder of these files and of tables that they share (``NAME.npy``); `mesh` is the mesh to register
    on, which must be the one that the model was trained for; `threads` is the number of batches decoded at once, where
    0 takes all cores (each batch runs on one thread, so the bits do not depend on it); `source` is the origin of the
    model as a result states it, by default the folder; `calibrated` says whether the folder's calibration is read, if
    there is one. Raises `ModelError` if a file is missing or corrupt, or the model was trained for another mesh;
    `FormatError` if the weights lack an array.
    """

    def __init__(
        self,
        folder: str | os.PathLike[str],
        mesh: Mesh,
        *,
        threads: int = 0,
        source: str | None = None,
        calibrated: bool = True,
    ) -> None:
        self.folder = Path(folder)
        card = read_card(self.folder)
        check_files(self.folder, card)
        if card["mesh_digest"] != mesh.digest():
            message = (
                f"the model in {self.folder} must have been trained for this mesh: it knows a mesh of "
                f"{card['n_nodes']} nodes ({card['mesh_digest'][:12]}), got one of {mesh.n_nodes} nodes "
                f"({mesh.digest()[:12]}); "
                "train one (`tissuereg train`) or leave the model out: contacts are then the prior"
            )
            raise ModelError(message, where=str(self.folder))
        self._card = card
        self._threads = threads or n_cores()
        self._encoder = _session(self.folder / "encoder.onnx")
        self._cut: dict[str, CutDecoder] = {}
        known = card["prior"]
        self._family = Gaussian(np.asarray(known["mean"], np.float64), np.asarray(known["covariance"], np.float64))
        measured = read_calibration(self.folder, card) if calibrated else None
        self.calibration: Calibration = measured or self._stated(known)
        errors = card["errors_mm"]
        self.card = {
            "kind": card["kind"],
            "source": source or str(folder),
            "members": card["members"],
            "test_error_mm": errors["test"],
            "pca26_test_error_mm": errors["pca"],
        }

    @property
    def n_latent(self) -> int:
        """Number of latents."""
        return int(self._card["n_latent"])

    @property
    def n_nodes(self) -> int:
        """Number of mesh nodes."""
        return int(self._card["n_nodes"])

    def errors(self) -> FloatArray:
        """Return reconstruction errors (n_fields, n_nodes, 3), mm, of fields not used in training."""
        return self._errors_in("error_fields_mm")

    def _errors_in(self, name: str) -> FloatArray:
        with open_npz(self.folder / "decoder_weights.npz") as weights:
            return table_in(weights, name, None, self.n_nodes, 3)

    def _stated(self, known: dict[str, Any]) -> Calibration:
        """Return the calibration that the table `prior` of the card and the errors beside the weights state."""
        relative = known.get("relative_mismatch_covariance")
        if relative is None:
            return stated(self._family, self.errors())
        off, absolute = (np.asarray(one, np.float64) for one in (relative, known["mismatch_covariance"]))
        # Both are moments of the same differences, over the simulation's size and not: their ratio is that size.
        per_size = np.sqrt(np.trace(off) / max(float(np.trace(absolute)), 1e-300))
        return stated(self._family, self.errors(), off, per_size * self._errors_in("change_error_fields_mm"))

    def around(self, simulation: FloatArray) -> "AnchoredModel":
        """Return a latent model of differences from a simulation, a displacement (n_nodes, 3) in mm.

        It decodes to the simulation itself at the latents that the encoder gives the simulation.
        """
        return AnchoredModel(self, simulation)

    def encode(self, field: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the mean and variance of the encoder's Gaussian q(z | field) of latents z, given a displacement field.

        `field` (n_nodes, 3) is in mm. The results `mean` and `variance` (n_latent,) are dimensionless.
        """
        given = float_array("field", field, (self.n_nodes, 3))
        mean, log_variance = self._encoder.run(
            ["mean", "log_variance"], {"displacement": given[None].astype(np.float32)}
        )
        return np.asarray(mean[0], np.float64), np.exp(np.asarray(log_variance[0], np.float64))

    def codes(self, fields: FloatArray) -> FloatArray:
        """Return the encoder's means (n_fields, n_latent), dimensionless, for fields (n_fields, n_nodes, 3) in mm."""
        parts = [np.asarray(fields[i : i + _BATCH], np.float32) for i in range(0, len(fields), _BATCH)]
        found = [self._encoder.run(["mean"], {"displacement": part})[0] for part in parts]
        return np.concatenate([np.empty((0, self.n_latent)), *found])

    def decode(self, latents: FloatArray, nodes: IntArray | None = None) -> FloatArray:
        """Return displacement fields (n_members, k, 3), mm, of latents (n_latent, n_members), at nodes (k,) or all."""
        if nodes is None and latents.shape[1] <= _FEW and self.tables is not None:
            return self.tables.decode(latents, threads=self._threads)
        return self._by_file(latents, nodes)

    def change(self, latents: FloatArray, code: FloatArray) -> FloatArray:
        """Return fields (n_members, n_nodes, 3), mm: those of latents (n_latent, n_members) minus that of a code."""
        if latents.shape[1] <= _FEW and self.tables is not None:
            return self.tables.change(latents, code, self._threads)
        both = self._by_file(np.concatenate([code[:, None], latents], axis=1))
        return np.asarray(both[1:] - both[0])

    def _by_file(self, latents: FloatArray, nodes: IntArray | None = None) -> FloatArray:
        """Return fields (n_members, k, 3), mm, of latents (n_latent, n_members) at `nodes` or all, by the ONNX file."""
        has_nodes = "nodes" in {i.name for i in self._decoder.get_overridable_initializers()}
        extra = {} if nodes is None or not has_nodes else {"nodes": np.asarray(nodes, np.int64)}

        def run(batch: Any) -> Any:
            return self._decoder.run(["displacement"], {"z": batch, **extra})[0]

        fields = in_batches(run, latents, _BATCH, self._threads)
        if nodes is not None and not extra:
            fields = fields[:, nodes]
        return np.asarray(fields, dtype=np.float64)

    @cached_property
    def _decoder(self) -> Any:
        """Session of ``decoder.onnx``, read when it is first needed, because that of a graph network is large."""
        return _session(self.folder / "decoder.onnx")

    @cached_property
    def tables(self) -> ClosureDecoder | GraphDecoder | None:
        """The decoder's weights; None if it is of no type that can be reduced to a few points."""
        return read_decoder(self.folder / "decoder_weights.npz", self._card["files"].keys())

    def cut(self, rows: Any) -> CutDecoder | None:
        """Return the decoder reduced to given points, made once for them and checked against ``decoder.onnx``.

        `rows`, a sparse matrix (n_rows, n_nodes), holds the weights of the mesh nodes in each point. The result is None
        if the weights are of no type that can be reduced. Cost: some tenths of a second at first. Raises `ModelError`
        if the weights and ``decoder.onnx`` are not the same decoder.
        """
        digest = hashlib.sha256(rows.indptr.tobytes() + rows.indices.tobytes() + rows.data.tobytes()).hexdigest()
        if digest not in self._cut and self.tables is not None:
            made = CutDecoder(self.tables, rows, self._threads)
            codes = self.prior()
            spread = np.linalg.cholesky(codes.covariance + 1e-12 * np.trace(codes.covariance) * np.eye(self.n_latent))
            draws = np.random.default_rng(0).standard_normal((self.n_latent, 3))
            made.check(rows, self.tables, self._by_file, codes.mean[:, None] + spread @ draws, str(self.folder))
            while len(self._cut) >= _KEPT:
                self._cut.pop(next(iter(self._cut)))
            self._cut[digest] = made
        return self._cut.get(digest)

    def prior(self) -> Gaussian:
        """Return the distribution of the latents of the training set."""
        return self._family


class AnchoredModel:
    """A latent model centred on a simulation: ``field = simulation + decoder(z) - decoder(encoder(simulation))``.

    The error of encoding and decoding the simulation cancels: a truth is met more closely as a difference from its
    simulation than as a whole field. `network` is the encoder and decoder; `simulation` (n_nodes, 3) is the
    displacement, in mm. The attribute `code` (n_latent,) are the simulation's latents.
    """

    def __init__(self, network: NetworkModel, simulation: FloatArray) -> None:
        self._network = network
        self._simulation = simulation
        self.code: FloatArray = network.encode(simulation)[0]
        self.calibration = network.calibration
        self.card = network.card

    @property
    def n_latent(self) -> int:
        """Number of latents."""
        return self._network.n_latent

    @property
    def n_nodes(self) -> int:
        """Number of mesh nodes."""
        return self._network.n_nodes

    def decode(self, latents: FloatArray, nodes: IntArray | None = None) -> FloatArray:
        """Return displacement fields (n_members, k, 3), mm, of latents (n_latent, n_members), at nodes (k,) or all."""
        if nodes is None:
            return self._simulation + self._network.change(latents, self.code)
        # Beside the simulation's code in one call: the bits depend on nothing that was decoded before.
        both = self._network.decode(np.concatenate([self.code[:, None], latents], axis=1), nodes)
        return np.asarray(both[1:] + (self._simulation[nodes] - both[0]))

    def errors(self) -> FloatArray:
        """Return reconstruction errors (n_fields, n_nodes, 3), mm, of fields not used in training."""
        return self._network.errors()

    def prior(self) -> Gaussian:
        """Return the distribution of the latents of the training set."""
        return self._network.prior()


def kept_network(folder: Path, mesh: Mesh, threads: int, source: str | None = None) -> NetworkModel:
    """Return the trained model of a folder for a mesh; the last two are kept while their files do not change.

    `threads` is the number of batches decoded at once, 0 for all cores; `source` is the origin that a result states.
    """
    try:
        stats = [one.stat() for one in sorted(folder.iterdir())]
    except OSError:
        return NetworkModel(folder, mesh, threads=threads, source=source)  # says what is missing
    key = (str(folder.resolve()), mesh.digest(), threads, source, *((one.st_mtime_ns, one.st_size) for one in stats))
    with _KEEPING:
        made = _NETWORKS.pop(key, None) or reads(NetworkModel)(folder, mesh, threads=threads, source=source)
        while len(_NETWORKS) > 1:
            _NETWORKS.pop(next(iter(_NETWORKS)))
        _NETWORKS[key] = made
    return made


def _session(path: Path) -> Any:
    return session(str(path), str(path))
