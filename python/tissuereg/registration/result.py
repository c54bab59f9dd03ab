"""The result of a registration: the displaced body, its uncertainty, targets with regions, and whether to trust it.

Results of one method alone are in `tissuereg.registration.contacts.result` and `tissuereg.registration.learned.result`.
"""

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from tissuereg._base.arguments import flag, found, named, place
from tissuereg._base.arrays import FloatArray
from tissuereg._base.choices import TrackerKind
from tissuereg._base.provenance import Provenance
from tissuereg._base.shown import notebook, short_repr
from tissuereg.body.markers import Markers
from tissuereg.body.mesh import Mesh
from tissuereg.errors import ModelError
from tissuereg.registration.body import Body
from tissuereg.registration.deviations import Deviations
from tissuereg.registration.field import FieldAnswers, RegisteredField
from tissuereg.registration.settings import RegisterSettings
from tissuereg.registration.target import Target, target_named
from tissuereg.registration.trust import Trust

#: On which bodies the regions were checked: with a trained model, and without.
CHECKED = (
    "The regions were checked on bodies of other solvers, never against a measurement inside a body.",
    "The regions were checked against beads inside two gels and on bodies of other solvers, never against a "
    "measurement inside an organ.",
)


@dataclass(frozen=True, eq=False)
class MarkerFit:
    """Agreement of a registration with the measured markers.

    Attributes
    ----------
    used : tuple of str
        Names of the markers that entered the fit.
    dropped : tuple of (str, str)
        Names of the markers that did not enter the fit, each with the reason, ``"wrong"`` or ``"not seen"``.
    before_rms_mm, after_rms_mm : float
        Root mean square over the used markers of the distance from the measured place to the place by the simulation
        (or at rest), and to the registered place, mm.
    residual_mm : dict of str to ndarray of float64, shape (3,)
        Measured minus registered place of each used marker, by name, mm; NaN = not seen.
    inner : tuple of str
        Names of the markers inside the body, which move with the tissue around them; the others are attached to the
        skin.
    """

    used: tuple[str, ...]
    dropped: tuple[tuple[str, str], ...]
    before_rms_mm: float
    after_rms_mm: float
    residual_mm: dict[str, FloatArray]
    inner: tuple[str, ...] = ()

    __repr__ = short_repr


@dataclass(frozen=True, eq=False)
class Fallback:
    """Estimate of the deformed body by linear elasticity alone; it has no uncertainty.

    Attributes
    ----------
    displacement : ndarray of float64, shape (n_nodes, 3)
        Displacement of each node, mm.
        mm.
    targets : dict of str to ndarray of float64, shape (3,)
        Estimated place of each inner point in the deformed body, by name, mm.
    """

    displacement: FloatArray
    targets: dict[str, FloatArray]

    __repr__ = short_repr

    def to_json(self) -> dict[str, Any]:
        """Return the entry ``fallback`` of ``registration.json``: a dict of method and target places in mm."""
        return {"method": "linear elastic", "targets_mm": {name: at.tolist() for name, at in self.targets.items()}}


@dataclass(frozen=True, eq=False, kw_only=True)
class Registration(FieldAnswers):
    """Result of a registration: the displaced body, its uncertainty, and whether it can be trusted.

    Both methods fill these fields; `ContactRegistration` (without a trained model) and `LearnedRegistration` (with one)
    have more.

    Attributes
    ----------
    body : Body
        Assumptions about the undeformed body: mesh, material, elements, supports.
    displacement : ndarray of float64, shape (n_nodes, 3)
        Displacement of each node in mm. Without a model it is that of the equilibrium under the mean of the posterior
        load, with one that decoded from the mean of the posterior latents.
    deviations : callable
        Takes no argument and returns the uncertainty of the displacement field; see `uncertainty`.
    targets : dict of str to Target
        Inner points after registration, by name.
    unseen : dict of str to Target
        Predicted measurements, by name, of the markers that were not seen or are wrong; the covariance includes tracker
        noise.
    markers : MarkerFit
        Residuals in mm, and names of used and dropped markers.
    all_markers : Markers
        All markers as given, with reference and measured places.
    start_markers : ndarray of float64, shape (n_markers, 3)
        Places of the markers before registration: by the simulation, or at rest, mm.
    min_det_f : float
        Smallest volume ratio of a tet, the determinant of its deformation gradient F.
    inverted_tets : int
        Number of tets with det F <= 0.
    trust : Trust
        Whether the result can be trusted, and the reasons if not.
    model : dict
        Kind and source of the model; for a trained one also numbers of members and test errors, and, if variants of the
        simulation were given, their number as ``variants``.
    settings : RegisterSettings
        All settings of the registration.
    seconds : dict of str to float
        Wall time per stage, by name, s.
    seed : int
        Seed of all random numbers.
    provenance : Provenance
        Date, version, call or command, hashes of the input files, warnings.
    linear : callable, optional
        Takes no argument and returns the estimate of the body by linear elasticity alone, or None; see `fallback`.
    tracker : {"fixed", "drifts"}
        Whether the tracker was taken to be fixed relative to the body, or may have drifted.
    """

    body: Body
    displacement: FloatArray
    deviations: Callable[[], Deviations]
    targets: dict[str, Target]
    unseen: dict[str, Target]
    markers: MarkerFit
    all_markers: Markers
    start_markers: FloatArray
    min_det_f: float
    inverted_tets: int
    trust: Trust
    model: dict[str, Any]
    settings: RegisterSettings
    seconds: dict[str, float]
    seed: int
    provenance: Provenance = field(default_factory=Provenance)
    linear: Callable[[], Fallback | None] | None = None
    tracker: TrackerKind = "fixed"

    @property
    def mesh(self) -> Mesh:
        """Mesh of the undeformed body."""
        return self.body.mesh

    @cached_property
    def fallback(self) -> Fallback | None:
        """Linear elastic estimate of the body, about the simulation or the body at rest; it has no confidence regions.

        It is None where the registration can be trusted, where no marker was used, where the body can move freely, and
        where it has more than 50,000 nodes.

        Cost: computed when it is first read; the body is linearised for the first such estimate of a registrar.
        """
        return None if self.trust.ok or self.linear is None else self.linear()

    @cached_property
    def uncertainty(self) -> Deviations:
        """Uncertainty of the displacement field, `Deviations`.

        Cost: computed when it, `std` or `node_covariance` is first read, or points are first asked for: without a model
        one right-hand side for each of 128 draws, with one 64 decoded fields.
        """
        return self.deviations()

    @cached_property
    def std(self) -> FloatArray:
        """Root of the trace of the covariance of each node, ndarray of float64, shape (n_nodes,), in mm."""
        return self.uncertainty.std

    @cached_property
    def field(self) -> RegisteredField:
        """The displacement field with its uncertainty, for points that are thought of later."""
        return RegisteredField(self.mesh, self.displacement, self.uncertainty)

    @property
    def node_covariance(self) -> FloatArray:
        """Covariance of every node, ndarray of float64, shape (n_nodes, 3, 3), mm^2."""
        return self.uncertainty.covariance

    def draws(self, count: int) -> FloatArray:
        """Return `count` displacement fields drawn from the posterior, each in equilibrium, (count, n_nodes, 3), mm.

        Only a registration without a trained model has them, by `ContactRegistration.draws`.

        Raises
        ------
        ModelError
            If the registration used a trained model, whose ensemble is not in equilibrium.
        """
        message = f"draws need a registration by contacts; this one used a trained model, got `count` {found(count)}"
        raise ModelError(message, where="draws")

    def __repr__(self) -> str:
        used, trusted = len(self.markers.used), "trusted" if self.trust.ok else "not to be trusted"
        return (
            f"{type(self).__name__}({self.mesh.n_nodes} nodes, {used} marker{'' if used == 1 else 's'}, "
            f"{len(self.targets)} target{'' if len(self.targets) == 1 else 's'}, {self._found_words()}{trusted})"
        )

    def _repr_html_(self) -> str:
        """Return what a notebook shows."""
        return notebook("registration", self)

    @property
    def given(self) -> dict[str, Any]:
        """All settings and beliefs, those of the body as ``body``: plain numbers, lists and strings."""
        return {**self.settings.to_json(), "body": self.body.to_json()}

    @property
    def checked(self) -> str:
        """On which bodies the regions of such a registration were checked, and on which never: a sentence."""
        return CHECKED[self.model["kind"] == "contacts"]

    @property
    def starts_simulated(self) -> bool:
        """Whether the markers' places before registration are those of a simulation, and not of the body at rest."""
        return not np.allclose(self.start_markers, self.all_markers.reference, rtol=0.0, atol=1e-6)

    def target(self, name: str) -> Target:
        """Return the registered inner point (target) of this name.

        Raises
        ------
        MarkerError
            If there is no target of that name.
        """
        return target_named(self.targets, name)

    def _found_words(self) -> str:
        """Return a phrase for `repr` on results of one method alone, such as the number of contacts; empty here."""
        return ""

    def _found_json(self) -> dict[str, Any]:
        """Return the entries of ``registration.json`` that one method alone fills in, each empty here."""
        return {"surface": None, "contacts": [], "explained_mm": {}, "work": {}, "dropped_members": []}

    def to_json(self) -> dict[str, Any]:
        """Return the content of ``registration.json``: plain numbers, lists and strings."""
        fit, own = self.markers, self._found_json()
        return {
            "schema": "tissuereg.registration/1",
            "seed": self.seed,
            "frame": self.mesh.frame,
            "tracker": self.tracker,
            "markers": {
                "used": list(fit.used),
                "dropped": [{"marker": name, "reason": reason} for name, reason in fit.dropped],
                "before_rms_mm": fit.before_rms_mm,
                "after_rms_mm": fit.after_rms_mm,
                "residual_mm": {name: _row_json(row) for name, row in fit.residual_mm.items()},
                "inner": list(fit.inner),
            },
            "surface": own["surface"],
            "targets": {name: target.to_json() for name, target in self.targets.items()},
            "unseen_markers": {name: target.to_json() for name, target in self.unseen.items()},
            "body": {
                "min_det_f": self.min_det_f,
                "inverted_tets": self.inverted_tets,
                "mean_std_mm": float(self.std.mean()),
                "largest_mm": float(np.linalg.norm(self.displacement, axis=1).max()),
            },
            "trust": {
                "ok": self.trust.ok,
                "p_value": self.trust.p_value,
                "reasons": list(self.trust.reasons),
                "chi_square": self.trust.chi_square,
                "residual_chi_square": self.trust.residual_chi_square,
                "n_obs": self.trust.n_obs,
                "regions_checked": self.checked,
            },
            "fallback": None if self.fallback is None else self.fallback.to_json(),
            "model": dict(self.model),
            "contacts": own["contacts"],
            "explained_mm": own["explained_mm"],
            "work": own["work"],
            "dropped_members": own["dropped_members"],
            "seconds": dict(self.seconds),
            "provenance": self.provenance.to_json(self.given),
        }

    def save(
        self,
        folder: str | os.PathLike[str],
        extra: dict[str, Any] | None = None,
        *,
        deformed: bool = False,
        picture: bool = True,
        image: str | os.PathLike[str] | None = None,
    ) -> Path:
        """Write the result as files into a folder, all of them or none.

        The files are ``registered.vtu``, ``field.npz`` (what `tissuereg.read_registration` needs to answer later),
        ``targets.csv``, ``targets.mrk.json`` (registered places for 3D Slicer, in the frame of the mesh; LPS, Slicer's
        default, if the mesh declares none), ``registration.json`` and ``registered.png``.

        Parameters
        ----------
        folder : path-like
            Folder to write into, created if absent.
        extra : dict, optional
            Entries added to the JSON; they override its own.
        deformed : bool
            Whether to write ``registered_deformed.vtu`` too: the body with displaced nodes and the same point data.
        picture : bool
            Whether to draw ``registered.png``, which takes most of the time of this call.
        image : path-like, optional
            An image of the undeformed body: ``report.html`` is written too, with sections of it; see `report`.

        Returns
        -------
        Path
            The folder.

        Raises
        ------
        OutputError
            If the folder cannot be written; nothing is changed then.
        ArgumentError, FormatError, ImportError
            If the image cannot be used, as by `report`.
        """
        from tissuereg.io.atomic import OutputError
        from tissuereg.report.files import save_registration

        target, added = place("folder", folder, error=OutputError), dict(named("extra", extra))
        drawn = flag("picture", picture)
        more = flag("deformed", deformed)
        return save_registration(self, target, added, deformed=more, picture=drawn, image=image)

    def plot(self) -> Any:
        """Return a matplotlib figure of the body before and after, with markers, targets and the nodes' deviations."""
        from tissuereg.report.picture import registration_figure

        return registration_figure(self)

    @cached_property
    def picture(self) -> bytes:
        """The figure of `plot` as the bytes of a PNG file, drawn when it is first read."""
        from tissuereg.report.picture import png_bytes

        return png_bytes(self.plot())

    def report(
        self,
        path: str | os.PathLike[str],
        *,
        picture: bool = True,
        image: str | os.PathLike[str] | None = None,
    ) -> Path:
        """Write one self-contained HTML page: the body to turn, sections, markers, targets with regions, trust, model.

        Parameters
        ----------
        path : path-like
            File to write, whole or not at all.
        picture : bool
            Whether to draw the body.
        image : path-like, optional
            An image of the undeformed body (CT, MR), of which sections through the targets show what is there now. It
            is in the frame of the mesh; a mesh that states none is taken to be in LPS.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        ArgumentError, FormatError
            If the image cannot be read, does not show the body or has several values a voxel.
        ImportError
            If an image is given and SimpleITK is not installed (``pip install 'tissuereg[images]'``).
        """
        from tissuereg.io.atomic import OutputError
        from tissuereg.report.page import write_page

        target, drawn = place("path", path, error=OutputError), flag("picture", picture)
        return write_page(self, target, picture=drawn, image=None if image is None else place("image", image))


def _row_json(row: FloatArray) -> list[float | None]:
    """Return the three numbers of `row` (3,) as a list, with None in place of NaN (a component that was not seen)."""
    return [float(value) if np.isfinite(value) else None for value in row]
