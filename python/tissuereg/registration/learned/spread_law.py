"""The distribution of a registered point about its mean: a Gaussian, or a t law with heavier tails.

The covariance of a point is known only as well as the type and the size of its event are, so that true places lie about
the mean by a multivariate t law rather than by a Gaussian (S. Kotz and S. Nadarajah, Multivariate t Distributions and
Their Applications, 2004). Both are stated by the covariance of the Gaussian that has the same 90 % region.
"""

#: Share of the region that a Gaussian and a t law of the same stated covariance have in common.
COMMON = 0.9


def squared_radius(share: float, dof: float | None) -> float:
    """Return the squared Mahalanobis radius of the region that holds a given share of a point's distribution.

    `share` is the probability inside, in (0, 1). `dof` is the number of degrees of freedom of the t law in three
    dimensions, None for a Gaussian. The distance is in the covariance of the Gaussian with the same 90 % region, by
    which both laws are stated.
    """
    from scipy.stats import chi2, f

    if dof is None:
        return float(chi2.ppf(share, 3))
    return float(chi2.ppf(COMMON, 3) * f.ppf(share, 3, dof) / f.ppf(COMMON, 3, dof))
