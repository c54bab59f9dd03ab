r"""The second stage of training: how wide the encoder's distribution is, with everything else left as it is.

One weight of the Kullback-Leibler divergence cannot serve both: small enough for an accurate decoder (1e-4 to 3e-4),
it makes q(z | x) a few hundredths as wide as the codes of all fields, and an ensemble drawn from q cannot leave x. Here
the decoder and the encoder's means are fixed, and the head of log-variances alone is fitted anew with a larger weight.
Of a decoder that is linear at the code the minimum is

    s_k^2 = 1 / (1 + J_k^2 / (w L)),    L^2 = L_0^2 + sum_k s_k^2 J_k^2,

with J_k the root mean square change of the field by latent k and L_0 the error at the code itself.
"""

import time
from collections.abc import Callable, Iterable

import numpy as np
import torch

from tissuereg_training.data import FieldArray
from tissuereg_training.errors import DivergenceError
from tissuereg_training.fit import batch_terms, normalised_parts
from tissuereg_training.losses import one_cycle
from tissuereg_training.network import Network
from tissuereg_training.settings import TrainSettings

#: Peak of the learning rate: one layer, whose loss is smooth.
_RATE = 1e-2

#: Fields from which the head's first bias is taken.
_FIRST = 500


def fit_spread(
    model: Network,
    train: Iterable[FieldArray],
    settings: TrainSettings,
    *,
    seed: int,
    report: Callable[[str], None] | None = None,
) -> list[dict[str, float]]:
    """Fit the log-variances of a trained network; its means and its decoder stay bit for bit.

    Parameters
    ----------
    model : Network
        Trained; changed in place.
    train : iterable of ndarray of float32, shape (n_part, n_nodes, 3)
        Training split in mm, in parts.
    settings : TrainSettings
        `spread_weight`, `spread_epochs`, `batch` and `loss` count.
    seed : int
        Source of all random numbers.
    report : callable of str, optional
        Hears a line an epoch.

    Returns
    -------
    list of dict
        A row an epoch: epoch, reconstruction, kl, seconds.

    Raises
    ------
    DivergenceError
        If the loss is no longer finite.

    Notes
    -----
    Cost an epoch: a pass forwards through the network, and one backwards through its decoder.
    """
    head = model.log_variance_head
    wanted = {id(parameter) for parameter in head.parameters()}
    frozen = [one for one in model.parameters() if one.requires_grad and id(one) not in wanted]
    for one in frozen:
        one.requires_grad_(False)
    try:
        return _fitted(model, head, normalised_parts(model, train), settings, seed, report)
    finally:
        for one in frozen:
            one.requires_grad_(True)


def _fitted(
    model: Network,
    head: torch.nn.Linear,
    x: torch.Tensor,
    settings: TrainSettings,
    seed: int,
    report: Callable[[str], None] | None,
) -> list[dict[str, float]]:
    """Run the epochs of the second stage on normalised fields; return a row for each."""
    # From one variance a latent: weights of the first stage, for other variances, would only have to shrink.
    with torch.no_grad():
        head.bias.copy_(model.encode(x[:_FIRST])[1].mean(dim=0))
        head.weight.zero_()
    optimiser = torch.optim.Adam(head.parameters(), lr=_RATE)
    n_batches = max(1, round(len(x) / settings.batch))
    n_steps, history = settings.spread_epochs * n_batches, list[dict[str, float]]()
    for epoch in range(settings.spread_epochs):
        start, sums = time.perf_counter(), np.zeros(2)
        rng = np.random.default_rng([seed, 12, epoch])
        for number, rows in enumerate(np.array_split(rng.permutation(len(x)), n_batches)):
            for group in optimiser.param_groups:
                group["lr"] = one_cycle(epoch * n_batches + number, n_steps, _RATE, settings.rise)
            some = x[torch.from_numpy(rows).to(x.device)]
            missed, kl = batch_terms(model, some, settings.loss, rng)
            loss = missed + settings.spread_weight * kl
            if not bool(torch.isfinite(loss)):
                message = f"the loss of the second stage must stay finite, got {loss.item()} in epoch {epoch + 1}"
                raise DivergenceError(message, where=f"spread, epoch {epoch + 1}")
            optimiser.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            optimiser.step()
            sums += (missed.item(), kl.item())
        missed_mean, kl_mean = (float(one) for one in sums / n_batches)
        seconds = time.perf_counter() - start
        history.append({"epoch": epoch + 1, "reconstruction": missed_mean, "kl": kl_mean, "seconds": seconds})
        if report is not None:
            report(f"spread {epoch + 1}/{settings.spread_epochs}: loss {missed_mean:.4f}, KL {kl_mean:.1f} nats")
    model.finish()
    return history
