"""Checks that the exported pair gives the network's output; otherwise the export is refused."""

from typing import Any

import numpy as np
import numpy.typing as npt
import onnx
import torch

from tissuereg_training.data import FieldArray
from tissuereg_training.errors import ParityError
from tissuereg_training.evaluate import codes, decoded
from tissuereg_training.network import Network

#: Largest difference allowed, as a share of the output's root mean square.
LIMIT = 1e-4


def onnx_session(model: onnx.ModelProto, threads: int = 1) -> Any:
    """Return an onnxruntime session on the processor.

    Parameters
    ----------
    model : onnx.ModelProto
        Encoder or decoder.
    threads : int
        Threads of one operator.

    Returns
    -------
    onnxruntime.InferenceSession
        Ready to run.
    """
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.log_severity_level = 3
    return onnxruntime.InferenceSession(model.SerializeToString(), options, providers=["CPUExecutionProvider"])


def checked_parity(
    model: Network, encoder: onnx.ModelProto, decoder: onnx.ModelProto, fields: FieldArray, seed: int
) -> dict[str, float]:
    """Return how far torch and onnxruntime lie apart.

    Parameters
    ----------
    model : Network
        The source.
    encoder, decoder : onnx.ModelProto
        What would be shipped.
    fields : ndarray of float32, shape (n_fields, n_nodes, 3)
        Fields in mm to compare at; latents are their codes and as many draws of N(0, 1).
    seed : int
        Of the draws.

    Returns
    -------
    dict
        ``encoder`` (of q's means and standard deviations), ``decoder``: largest difference over the root mean square.

    Raises
    ------
    ParityError
        If one exceeds `LIMIT` or is not finite, or if the decoder at chosen nodes differs from its full answer.
    """
    rng = np.random.default_rng([seed, 13])
    mean, log_variance = codes(model, fields)
    answers = onnx_session(encoder).run(["mean", "log_variance"], {"displacement": fields})
    # Standard deviations, not their logarithms, which may all be near zero.
    means, stds = answers[0], np.exp(0.5 * answers[1])
    wanted_std = torch.exp(0.5 * log_variance).cpu().numpy()
    apart = {"encoder": max(_apart(means, mean.cpu().numpy()), _apart(stds, wanted_std))}
    z = torch.cat([mean.cpu(), torch.from_numpy(rng.standard_normal(mean.shape, dtype=np.float32))])
    session = onnx_session(decoder)
    full = session.run(["displacement"], {"z": z.numpy()})[0]
    wanted = decoded(model, z)
    nodes = rng.permutation(model.n_nodes)[: max(1, model.n_nodes // 8)].astype(np.int64)
    some = session.run(["displacement"], {"z": z.numpy(), "nodes": nodes})[0]
    apart["decoder"] = max(_apart(full, wanted), _apart(some, wanted[:, nodes]))
    for part, share in apart.items():
        if not share <= LIMIT:
            message = (
                f"torch and onnxruntime must agree to {LIMIT:g} of the output's scale; "
                f"the exported {part} is off by {share:.3g}. Nothing was written"
            )
            raise ParityError(message, where=f"{part}.onnx")
    return apart


def _apart(found: npt.NDArray[Any], wanted: npt.NDArray[Any]) -> float:
    if found.shape != wanted.shape:
        return float("inf")
    scale = max(float(np.sqrt(np.mean(np.square(wanted, dtype=np.float64)))), 1e-12)
    return float(np.abs(found - wanted).max()) / scale
