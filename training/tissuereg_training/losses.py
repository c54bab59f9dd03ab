r"""What training minimises, and its schedules.

    loss = reconstruction(decode(z), x) + weight(epoch) * mean over fields of KL(q(z | x) || N(0, 1))
    KL   = 1/2 sum_q (mean_q^2 + variance_q - log variance_q - 1)

A squared reconstruction term with weight w is the usual evidence bound for observation noise of standard deviation
`sqrt(3 n_nodes w / 2)` in units of the scale.
"""

import math

import torch


def reconstruction(found: torch.Tensor, wanted: torch.Tensor, kind: str) -> torch.Tensor:
    """Return the reconstruction term of normalised fields, or of coefficients that stand for them.

    Parameters
    ----------
    found, wanted : Tensor of float, shape (batch, n_nodes, 3) or (batch, n_components)
        Normalised fields, or coefficients of orthogonal components whose mean square is that of the fields.
    kind : {"distance", "rms", "squared"}
        Mean Euclidean node error (of fields alone), mean over fields of the root mean square node error, or mean
        squared component; the first two are smooth below 1e-3.

    Returns
    -------
    Tensor
        Scalar.
    """
    squared = (found - wanted).square()
    if kind == "squared":
        return squared.mean()
    if kind == "rms":
        return (3.0 * squared.flatten(1).mean(dim=1) + 1e-6).sqrt().mean()
    return (squared.sum(dim=2) + 1e-6).sqrt().mean()


def kl_divergence(mean: torch.Tensor, log_variance: torch.Tensor) -> torch.Tensor:
    """Return KL(q || N(0, 1)) a latent, averaged over fields: (batch, n_latent) gives (n_latent,), nats."""
    return 0.5 * (mean.square() + log_variance.exp() - log_variance - 1.0).mean(dim=0)


def one_cycle(step: int, n_steps: int, peak: float, rise: float) -> float:
    """Return the learning rate of a step: cosine from peak / 25 up to the peak, then down to peak / 25,000.

    Parameters
    ----------
    step : int
        0 to n_steps - 1.
    n_steps : int
        Steps of the whole training.
    peak : float
        Largest rate.
    rise : float
        Share of the steps before the peak.

    Returns
    -------
    float
        Positive.

    Examples
    --------
    >>> [round(one_cycle(s, 101, 1.0, 0.5), 3) for s in (0, 25, 50, 75, 100)]
    [0.04, 0.52, 1.0, 0.5, 0.0]
    """
    top = rise * (n_steps - 1)
    if step <= top:
        start, end, share = peak / 25, peak, step / max(top, 1.0)
    else:
        start, end, share = peak, peak / 25_000, (step - top) / (n_steps - 1 - top)
    return end + (start - end) * 0.5 * (1.0 + math.cos(math.pi * share))


def kl_share(epoch: int, n_epochs: int, warmup: float) -> float:
    """Return the share of the KL weight in force in an epoch, 0-based: linear over the warm-up, then one."""
    n_warm = int(warmup * n_epochs)
    return 1.0 if epoch >= n_warm else epoch / n_warm
