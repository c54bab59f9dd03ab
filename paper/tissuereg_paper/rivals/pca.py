"""Principal components of training fields in place of the network, with the same ES-MDA."""

from typing import Any, ClassVar

import numpy as np

from tissuereg._base.arguments import whole
from tissuereg._base.arrays import FloatArray
from tissuereg.body.observe import MarkerObservation
from tissuereg.errors import ArgumentError
from tissuereg.registration.learned.model import Gaussian
from tissuereg.registration.learned.pca import PcaModel
from tissuereg.registration.linear_prior import LinearPrior
from tissuereg_paper.latents import error_covariance
from tissuereg_paper.rivals.assimilation import AssimilationSettings, assimilate
from tissuereg_paper.rivals.rival import Estimate, Rival, Setting

#: One field of so many is held out to measure what the components leave.
_HELD_OUT = 10


class PcaEsMda(Rival):
    r"""Fields that are combinations of principal components, found by ES-MDA as the paper's latents are.

    Without a simulation a field is ``mean + G z`` with ``z ~ N(0, I)``, as the training fields are. With one it is
    ``simulation + G z`` with ``z ~ N(0, s I)``: what the simulation lacks is a field of the same kinds but of another
    size, and s is the scale of the highest evidence. What the components leave of held-out fields, scaled by s too, is
    part of the noise.

    Parameters
    ----------
    setting : Setting
        Body, markers, beliefs, with training fields, at least twenty. One in ten is held out.
    n_latent : int
        Number of components; 26 as the paper has latents.
    n_members, n_steps : int
        Ensemble size and number of assimilations of ES-MDA, as in the paper. The model is linear, so that neither
        changes the answer where draws can be balanced (`tissuereg.registration.learned.draws.balanced_draws`).

    Raises
    ------
    ArgumentError
        If there are fewer than twenty training fields, or an argument is out of its range.

    Notes
    -----
    Cost: one eigenvalue problem of the size of the number of fields, once. The spread is that of the ensemble and of
    what the components leave.
    """

    name: ClassVar[str] = "PCA-26 + ES-MDA"
    needs: ClassVar[frozenset[str]] = frozenset({"fields"})

    def __init__(self, setting: Setting, *, n_latent: int = 26, n_members: int = 100, n_steps: int = 5) -> None:
        super().__init__(setting)
        fields = setting.fields
        assert fields is not None  # `Rival` has seen it
        if len(fields) < 2 * _HELD_OUT:
            message = f"`fields` must hold at least {2 * _HELD_OUT} training fields, got {len(fields)}"
            raise ArgumentError(message, where="fields")
        held_out = np.arange(len(fields)) % _HELD_OUT == 0
        trained = fields[~held_out]
        self._model = PcaModel.fit(
            trained,
            fields[held_out],
            centre=trained.mean(axis=0),
            n_latent=whole("n_latent", n_latent, least=1),
            card={},
        )
        self._n_members = whole("n_members", n_members, least=2)
        self._n_steps = whole("n_steps", n_steps, least=1)
        names = setting.markers(np.full_like(setting.reference_mm, np.nan)).names
        self._observed = MarkerObservation(setting.mesh, setting.reference_mm, names)
        left = self._model.error_fields
        self._left = error_covariance(self._observed.predict(left[:, self._observed.nodes]).reshape(len(left), -1))
        self._left_at_nodes = np.mean(left**2, axis=0)
        slopes = self._observed.jacobian(np.zeros((len(self._observed.nodes), 3)))
        seen = np.einsum("mxky,lky->lmx", slopes, self._model.components[:, self._observed.nodes], optimize=True)
        rows = seen.reshape(len(seen), -1)
        to_nodes = np.einsum("lnx,lo->nxo", self._model.components, rows, optimize=True)
        self.prior = LinearPrior(rows.T @ rows + self._left, to_nodes, setting.std_mm)

    def register(self, measured_mm: Any, simulation_mm: Any = None) -> Estimate:
        """Return the field of the posterior mean; see `Rival.register`. What is kept: ``scale``, the variance s."""
        moment = self.moment(measured_mm, simulation_mm)
        model, nodes = self._model, self._observed.nodes
        base, scale = model.centre, 1.0
        if moment.simulation_mm is not None:
            base = moment.simulation_mm
            lacks = moment.displacement_mm - self._observed.predict(base[nodes])[moment.seen]
            scale = self.prior.scaled(lacks, moment.seen)[0]
        if scale == 0.0:
            return Estimate(base, np.zeros_like(base), {"scale": scale})
        rows = (3 * moment.seen[:, None] + np.arange(3)).ravel()

        def predict(latents: FloatArray) -> FloatArray:
            moved = self._observed.predict(base[nodes] + model.decode(latents, nodes) - model.centre[nodes])
            return np.ascontiguousarray(moved.reshape(len(moved), -1)[:, rows].T)

        tracker = np.diag(np.repeat(self.setting.std_mm[moment.seen] ** 2, 3))
        found = assimilate(
            predict,
            moment.displacement_mm.ravel(),
            tracker + scale * self._left[np.ix_(rows, rows)],
            Gaussian(np.zeros(model.n_latent), scale * np.eye(model.n_latent)),
            rng=np.random.default_rng([self.setting.seed, 17]),
            settings=AssimilationSettings(self._n_members, self._n_steps, min_members=2, threads=self.setting.threads),
        )
        change = model.decode(found.mean[:, None])[0] - model.centre
        spread = found.spread_factor * np.cov(found.latents)
        variance = np.einsum("lnx,lk,knx->nx", model.components, np.atleast_2d(spread), model.components, optimize=True)
        std = np.sqrt(np.maximum(variance, 0.0) + scale * self._left_at_nodes)
        return Estimate(base + change, std, {"scale": scale})
