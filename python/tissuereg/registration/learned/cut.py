"""A decoder reduced to the displacement of markers and targets, which is run for a whole ensemble at a time."""

from collections.abc import Callable
from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.errors import ModelError
from tissuereg.registration.learned.batches import in_batches
from tissuereg.registration.learned.decoders import ClosureDecoder, GraphDecoder, network_at

#: Members run in one call: enough that the weights are read for many, few enough that their values stay in a cache.
BATCH = 60

#: The cut decoder and the full one agree to this share of the largest displacement: single precision leaves 1e-6.
TOLERANCE = 1e-4


class CutDecoder:
    """A decoder that computes the displacement of a few points alone, run by onnxruntime.

    `decoder` is the decoder of whole fields; `rows`, a sparse matrix (n_rows, n_nodes), holds the weights of the mesh
    nodes in each point; `threads` is the number of batches of members that run at once. The attribute `multiply_adds`
    is the number of multiply-adds for one member.
    """

    def __init__(self, decoder: ClosureDecoder | GraphDecoder, rows: Any, threads: int) -> None:
        file, self.multiply_adds = network_at(decoder, rows)
        self._session = session(file, "the cut decoder")
        self._threads = threads

    def __call__(self, latents: FloatArray) -> FloatArray:
        """Return the displacement of the points, shape (n_members, n_rows, 3), in mm.

        `latents` (n_latent, n_members) has one column for each ensemble member.
        """
        moved = in_batches(lambda z: self._session.run(["moved"], {"z": z})[0], latents, BATCH, self._threads)
        return np.asarray(moved, np.float64).reshape(latents.shape[1], -1, 3)

    def check(
        self,
        rows: Any,
        decoder: ClosureDecoder | GraphDecoder,
        decode: Callable[[FloatArray], FloatArray],
        latents: FloatArray,
        where: str,
    ) -> None:
        """Check that this decoder and the decoder of whole fields agree with the model's own file.

        `rows`, a sparse matrix (n_rows, n_nodes), holds the weights of the mesh nodes in each point; `decoder` is the
        decoder of whole fields, from tables; `decode` runs the model's file: latents (n_latent, n_members) to fields
        (n_members, n_nodes, 3), in mm; `latents` (n_latent, n_members) are the members to compare; `where` names the
        model in errors. Raises `ModelError` if displacements differ by more than `TOLERANCE` of the largest one.
        """
        whole = decode(latents)
        at_points = np.abs(self(latents) - np.stack([rows @ field for field in whole])).max(initial=0.0)
        off = max(float(at_points), float(np.abs(decoder.decode(latents) - whole).max()))
        scale = max(float(np.abs(whole).max()), float(np.finfo(np.float32).tiny))
        if not off <= TOLERANCE * scale:
            message = (
                f"the weights in {where} must give the field of its decoder.onnx to {TOLERANCE:g} of the largest "
                f"displacement of {scale:.3g} mm; they differ by {off / scale:.2g} of it"
            )
            raise ModelError(message, where=where)


def session(network: str | bytes, what: str) -> Any:
    """Return an onnxruntime session that runs a network on one thread, since several batches run at the same time.

    `network` is the path of an ONNX file, or its content; `what` names it in the error message. Raises `ModelError` if
    onnxruntime cannot load it.
    """
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.log_severity_level = 4  # its errors are raised too
    try:
        return onnxruntime.InferenceSession(network, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime's exceptions share no public base class
        message = f"{what} must be an ONNX network that onnxruntime can load: {error}"
        raise ModelError(message, where=what) from error
