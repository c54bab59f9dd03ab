"""Energies per shear modulus of the matrix, own code: W(I1, I2, J, I4) as a formula, or W(principal stretches).

Invariants of C = F^T F: I1 = tr C, I2 = (I1^2 - tr C^2) / 2, J = det F, I4 = a.C a. ``ratio`` is Lame's first constant
over the shear modulus. All are neo-Hookean of the believed form, (I1 - 3)/2 - ln J + ratio/2 (ln J)^2, where their
shape parameter vanishes; laws whose name ends in ``_split`` depend on the isochoric invariants instead and have the
bulk modulus in place of Lame's constant.
"""

from dataclasses import dataclass, field

import numpy as np

from blind.generator.jets import Jet


def neo_hookean(I1, I2, J, I4, ratio):
    """As believed."""
    return 0.5 * (I1 - 3.0) - J.log() + 0.5 * ratio * J.log() ** 2


def fung(I1, I2, J, I4, ratio, b):
    """Exponential in I1 - 3 - 2 ln J, not split."""
    return ((b * (I1 - 3.0 - 2.0 * J.log())).exp() - 1.0) / (2.0 * b) + 0.5 * ratio * J.log() ** 2


def yeoh_split(I1, I2, J, I4, ratio, c2, c3=0.0):
    """Polynomial in I1bar."""
    a = I1 * J ** (-2 / 3) - 3.0
    return 0.5 * (a + c2 * a**2 + c3 * a**3) + _bulk(J, ratio)


def fung_split(I1, I2, J, I4, ratio, b):
    """Exponential in I1bar."""
    return ((b * (I1 * J ** (-2 / 3) - 3.0)).exp() - 1.0) / (2.0 * b) + _bulk(J, ratio)


def gent(I1, I2, J, I4, ratio, limit):
    """Limited chain stretch; no law of the fit."""
    return -0.5 * limit * (1.0 - (I1 - 3.0 - 2.0 * J.log()) / limit).log() + 0.5 * ratio * J.log() ** 2


def veronda_split(I1, I2, J, I4, ratio, b):
    """Veronda and Westmann."""
    first = I1 * J ** (-2 / 3) - 3.0
    return ((b * first).exp() - 1.0) / b - 0.5 * (I2 * J ** (-4 / 3) - 3.0) + _bulk(J, ratio)


def mooney(I1, I2, J, I4, ratio, share):
    """Second invariant, not split: share/2 (I2 - 3) and the logarithm that makes it free of stress."""
    matrix = 0.5 * ((1 - share) * (I1 - 3.0) + share * (I2 - 3.0)) - (1 + share) * J.log()
    return matrix + 0.5 * (ratio - 2 * share) * J.log() ** 2


def mooney_split(I1, I2, J, I4, ratio, share):
    """Second isochoric invariant."""
    return 0.5 * ((1 - share) * (I1 * J ** (-2 / 3) - 3.0) + share * (I2 * J ** (-4 / 3) - 3.0)) + _bulk(J, ratio)


def fibre(I1, I2, J, I4, ratio, k1, k2, dispersion=0.0, tension_only=True):
    """Neo-Hookean with one family of fibres; dispersed ones as Gasser, Ogden and Holzapfel 2006."""
    scale = J ** (-2 / 3)
    e = dispersion * (I1 * scale) + (1 - 3 * dispersion) * (I4 * scale) - 1.0
    if tension_only:
        e = e.positive()
    return neo_hookean(I1, I2, J, I4, ratio) + ((k2 * e**2).exp() - 1.0) * (k1 / (2 * k2))


def _bulk(J, ratio):
    return 0.5 * (ratio + 2 / 3) * J.log() ** 2


def ogden(stretches, ratio, alpha):
    """First and second derivatives by the stretches of 2/alpha^2 (sum l^alpha - 3 - alpha ln J) + ratio/2 (ln J)^2."""
    log_j = np.log(stretches).sum(axis=-1, keepdims=True)
    first = 2 / alpha * (stretches ** (alpha - 1) - 1 / stretches) + ratio * log_j / stretches
    diagonal = 2 / alpha * ((alpha - 1) * stretches ** (alpha - 2) + 1 / stretches**2) - ratio * log_j / stretches**2
    second = diagonal[..., None] * np.eye(3) + ratio / (stretches[..., :, None] * stretches[..., None, :])
    return first, second


def one_sided(stretches, ratio, extra):
    """Return the same of neo-Hookean plus extra (<ln l_1>^2 + ...): stiffer in tension than in compression."""
    first, second = ogden(stretches, ratio, 2.0)
    pulled = np.log(stretches)
    on = pulled > 0
    first = first + np.where(on, 2 * extra * pulled / stretches, 0.0)
    return first, second + np.where(on, 2 * extra * (1 - pulled) / stretches**2, 0.0)[..., None] * np.eye(3)


INVARIANT = {
    f.__name__: f for f in (neo_hookean, fung, yeoh_split, fung_split, gent, veronda_split, mooney, mooney_split, fibre)
}
PRINCIPAL = {f.__name__: f for f in (ogden, one_sided)}


TURNED = "an element is turned inside out"


@dataclass
class Law:
    """A law by name, with shape parameters and a fibre direction."""

    name: str = "neo_hookean"
    shape: dict = field(default_factory=dict)
    direction: tuple = (1.0, 0.0, 0.0)

    def response(self, F, ratio, tangent=True, volume_only=False):
        """Return energy (...,), stress P (..., 3, 3) and tangent (..., 9, 9) or None, per shear modulus.

        ``volume_only`` leaves the part of ``ratio`` alone, which drainage relaxes.
        """
        if self.name in PRINCIPAL and not volume_only:
            return self._principal(F, ratio, tangent)
        C = np.swapaxes(F, -1, -2) @ F
        a = np.asarray(self.direction) / np.linalg.norm(self.direction)
        I1 = np.trace(C, axis1=-2, axis2=-1)
        J = np.linalg.det(F)
        if np.any(J <= 0):
            raise FloatingPointError(TURNED)
        variables = Jet.variables(I1, 0.5 * (I1**2 - (C * C).sum(axis=(-1, -2))), J, C @ a @ a)
        if volume_only:
            W = 0.5 * ratio * variables[2].log() ** 2
        else:
            W = INVARIANT[self.name](*variables, ratio, **self.shape)
        eye = np.eye(3)
        inverse = np.swapaxes(np.linalg.inv(F), -1, -2)
        slopes = np.stack(
            [2 * F, 2 * (I1[..., None, None] * F - F @ C), J[..., None, None] * inverse, 2 * (F @ a)[..., :, None] * a],
            axis=-3,
        )
        w1 = W.gradient
        P = np.einsum("...k,...kiI->...iI", w1, slopes)
        if not tangent:
            return W.value, P, None
        G = slopes.reshape(*slopes.shape[:-2], 9)
        A = (np.swapaxes(G, -1, -2) @ (W.second @ G)).reshape(*F.shape, 3, 3)
        one, two, three, four = (w1[..., k, None, None, None, None] for k in range(4))
        FF, AA = F @ np.swapaxes(F, -1, -2), np.outer(a, a)
        straight = np.einsum("ij,IJ->iIjJ", eye, eye)
        A += 2 * one * straight + 2 * four * np.einsum("ij,IJ->iIjJ", eye, AA)
        if np.any(w1[..., 1]):
            A += (
                2
                * two
                * (
                    2 * np.einsum("...iI,...jJ->...iIjJ", F, F)
                    + I1[..., None, None, None, None] * straight
                    - np.einsum("ij,...JI->...iIjJ", eye, C)
                    - np.einsum("...iJ,...jI->...iIjJ", F, F)
                    - np.einsum("...ij,IJ->...iIjJ", FF, eye)
                )
            )
        A += (
            three
            * J[..., None, None, None, None]
            * (
                np.einsum("...iI,...jJ->...iIjJ", inverse, inverse)
                - np.einsum("...iJ,...jI->...iIjJ", inverse, inverse)
            )
        )
        return W.value, P, A.reshape(*F.shape[:-2], 9, 9)

    def _principal(self, F, ratio, tangent):
        C = np.swapaxes(F, -1, -2) @ F
        squares, N = np.linalg.eigh(C)
        if np.any(np.linalg.det(F) <= 0):
            raise FloatingPointError(TURNED)
        # Equal stretches are parted by a hair: the difference quotients below need it.
        stretch = np.sqrt(squares) * (1 + 1e-6 * np.array([-1.0, 0.0, 1.0]))
        first, second = PRINCIPAL[self.name](stretch, ratio, **self.shape)
        s = first / stretch
        S = np.einsum("...a,...Ia,...Ja->...IJ", s, N, N)
        P = F @ S
        if not tangent:
            return None, P, None
        lift = np.einsum("...Ia,...Jb->...abIJ", N, N)
        slope = second / (stretch[..., :, None] * stretch[..., None, :]) - np.eye(3) * (first / stretch**3)[..., None]
        diagonal = np.einsum("...aaIJ->...aIJ", lift)
        CC = np.einsum("...ab,...aIJ,...bKL->...IJKL", slope, diagonal, diagonal, optimize=True)
        for a, b in ((0, 1), (0, 2), (1, 2)):
            quotient = (s[..., b] - s[..., a]) / (stretch[..., b] ** 2 - stretch[..., a] ** 2)
            both = lift[..., a, b, :, :] + lift[..., b, a, :, :]
            CC += quotient[..., None, None, None, None] * both[..., :, :, None, None] * both[..., None, None, :, :]
        A = np.einsum("...iI,...IJKL,...jK->...iJjL", F, CC, F, optimize=True)
        A += np.einsum("ij,...IJ->...iIjJ", np.eye(3), S)
        return None, P, A.reshape(*F.shape[:-2], 9, 9)
