r"""What a trained network is worth: errors, the spread of its codes, the prior that a registration starts from.

The prior that `register` needs is measured, not assumed:

    wide prior      mean and covariance of the training set's codes, plus the mean variance of q
    mismatch        mean over pairs of d d',   d = encoder(truth) - encoder(simulation)

A pair is one event simulated by the believed model and by another one. q(z | simulation) alone says how exactly
a field is coded, not how far the truth lies from the simulation.
"""

from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from tissuereg_training.data import FieldArray
from tissuereg_training.losses import kl_divergence
from tissuereg_training.network import Network, sampled_latents

Float64Array = npt.NDArray[np.float64]

#: Fields pushed through the network at once.
_BATCH = 50
#: Nats a latent must carry to count as used.
_ACTIVE_NATS = 0.1


@torch.no_grad()
def codes(model: Network, fields: FieldArray) -> tuple[torch.Tensor, torch.Tensor]:
    """Return mean and log-variance of q for fields in mm, each (n_fields, n_latent), in the processor's memory."""
    given = (torch.from_numpy(part).to(model.device) for part in _parts(fields))
    found = [tuple(answer.cpu() for answer in model.encode(model.normalised(part))) for part in given]
    if not found:
        return torch.empty(0, model.n_latent), torch.empty(0, model.n_latent)
    return torch.cat([mean for mean, _ in found]), torch.cat([log_variance for _, log_variance in found])


@torch.no_grad()
def decoded(model: Network, z: torch.Tensor) -> FieldArray:
    """Return fields in mm, (n_fields, n_nodes, 3), of latents (n_fields, n_latent)."""
    parts = torch.split(z.to(model.device), _BATCH)
    return np.concatenate([model.in_mm(model.decode(part)).cpu().numpy() for part in parts])


def error_fields(model: Network, fields: FieldArray) -> FieldArray:
    """Return truth minus decode(encoder mean), mm, same shape as `fields`."""
    missed = [part - decoded(model, codes(model, part)[0]) for part in _parts(fields)]
    return np.concatenate([np.empty((0, *fields.shape[1:]), np.float32), *missed])


def change_error_fields(model: Network, simulations: FieldArray, truths: FieldArray) -> FieldArray:
    """Return what the network misses of the change from a simulation to the truth.

    Parameters
    ----------
    model : Network
        Trained.
    simulations, truths : ndarray of float32, shape (n_pairs, n_nodes, 3)
        Pairs in mm.

    Returns
    -------
    ndarray of float32, shape (n_pairs, n_nodes, 3)
        ``(truth - simulation) - (decode(encode truth) - decode(encode simulation))``, mm: the error left when the part
        of the simulation that the code loses is added to the decoder's output.
    """
    return error_fields(model, truths) - error_fields(model, simulations)


def root_mean_square(fields: FieldArray) -> FieldArray:
    """Return the root mean square node displacement (n_fields,) of fields (n_fields, n_nodes, 3)."""
    sizes: FieldArray = np.sqrt(np.mean(np.sum(fields.astype(np.float64) ** 2, axis=2), axis=1))
    return sizes


def mean_error(model: Network, fields: FieldArray) -> float:
    """Return the mean Euclidean node error of reconstructed fields, mm."""
    return float(np.linalg.norm(error_fields(model, fields), axis=2).mean(dtype=np.float64))


def code_spread(model: Network, test: FieldArray, seed: int) -> dict[str, Any]:
    """Compare the spread that the model claims with the spread of unseen fields' codes.

    Parameters
    ----------
    model : Network
        Trained.
    test : ndarray of float32, shape (n_test, n_nodes, 3)
        Fields in mm that it never saw.
    seed : int
        Of the draws.

    Returns
    -------
    dict
        A list with an entry per latent for each of ``codes_std`` (of the means), ``q_std`` (root of the mean variance),
        ``aggregate_std`` (both together; 1 under the prior N(0, 1)), ``kl_nats``, and ``round_trip_std``: how far
        encoder(decoder(z)) lies from z for draws of q, an independent measure of how exactly a field is coded.
        Numbers for all: ``active`` (latents that carry more than 0.1 nats), ``aggregate_std_mean``.
    """
    mean, log_variance = codes(model, test)
    noise = torch.from_numpy(np.random.default_rng([seed, 12]).standard_normal(mean.shape, dtype=np.float32))
    z = sampled_latents(mean, log_variance, noise)
    back, _ = codes(model, decoded(model, z))
    kl = kl_divergence(mean, log_variance)
    variance = log_variance.exp().mean(dim=0)
    aggregate = (mean.var(dim=0, correction=0) + variance).sqrt()
    return {
        "codes_std": _rounded(mean.std(dim=0, correction=0)),
        "q_std": _rounded(variance.sqrt()),
        "aggregate_std": _rounded(aggregate),
        "round_trip_std": _rounded((back - z).square().mean(dim=0).sqrt()),
        "kl_nats": _rounded(kl),
        "active": int((kl > _ACTIVE_NATS).sum()),
        "aggregate_std_mean": round(float(aggregate.mean()), 5),
    }


def measured_prior(model: Network, train: FieldArray, simulations: FieldArray, truths: FieldArray) -> dict[str, Any]:
    """Return what a registration needs to know of the codes.

    Parameters
    ----------
    model : Network
        Trained.
    train : ndarray of float32, shape (n_train, n_nodes, 3)
        Training fields in mm.
    simulations, truths : ndarray of float32, shape (n_pairs, n_nodes, 3)
        Pairs in mm; may be empty.

    Returns
    -------
    dict
        ``mean`` (q), ``covariance`` (q, q), ``mismatch_covariance`` (q, q), ``mismatch_pairs``, and
        ``relative_mismatch_covariance`` (q, q), 1/mm^2: the same of differences over the root mean square displacement
        of the simulation, because a larger event is wrong by more. Without pairs nothing is known of the mismatch,
        the covariance of the codes is used instead (a truth anywhere in the family), and the last is None.
    """
    mean, log_variance = (t.numpy().astype(np.float64) for t in codes(model, train))
    covariance = np.cov(mean, rowvar=False, ddof=1).reshape(model.n_latent, model.n_latent)
    covariance = covariance + np.diag(np.exp(log_variance).mean(axis=0))
    mismatch, relative = covariance, None
    if len(truths):
        apart = (codes(model, truths)[0] - codes(model, simulations)[0]).numpy().astype(np.float64)
        mismatch = apart.T @ apart / len(apart)
        apart /= root_mean_square(simulations)[:, None]
        relative = (apart.T @ apart / len(apart)).tolist()
    return {
        "mean": mean.mean(axis=0).tolist(),
        "covariance": covariance.tolist(),
        "mismatch_covariance": mismatch.tolist(),
        "relative_mismatch_covariance": relative,
        "mismatch_pairs": len(truths),
    }


def _parts(fields: FieldArray) -> list[FieldArray]:
    return [fields[i : i + _BATCH] for i in range(0, len(fields), _BATCH)]


def _rounded(values: torch.Tensor) -> list[float]:
    return [round(float(v), 5) for v in values]
