"""A registered displacement field, for points thought of later: places, spread, and whether to rely on them."""

import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from tissuereg._base.arguments import flag, whole
from tissuereg._base.arrays import BoolArray, FloatArray, float_array
from tissuereg._base.choices import Direction, Unit
from tissuereg._base.shown import short_repr
from tissuereg.body.locate import held_by
from tissuereg.body.mesh import Mesh
from tissuereg.body.surroundings import SpaceMap
from tissuereg.errors import MarkerError
from tissuereg.imaging.transforms import Written, write_transform
from tissuereg.registration.deviations import Deviations
from tissuereg.registration.target import NO_MARKER, OUTSIDE, Region, region_of


@dataclass(frozen=True, eq=False)
class PointAnswer:
    """Registered places of points that were asked for.

    Attributes
    ----------
    reference, mean : ndarray of float64, shape (n, 3)
        Places in the undeformed body and registered places, mm.
    covariance : ndarray of float64, shape (n, 3, 3), or None
        Of the registered places, mm^2; of points outside the body that of the closest place of the skin; None if it was
        not wanted.
    inside : ndarray of bool, shape (n,)
        Whether each point is inside the undeformed body.
    flag : tuple of (str or None)
        ``"outside the body"``, ``"no marker tells"``, or None for a point on which to rely.
    tail : float or None
        Degrees of freedom of the t law of the true places; None for a Gaussian.
    """

    reference: FloatArray
    mean: FloatArray
    covariance: FloatArray | None
    inside: BoolArray
    flag: tuple[str | None, ...]
    tail: float | None = None

    __repr__ = short_repr

    def __len__(self) -> int:
        return len(self.mean)

    @property
    def std(self) -> FloatArray:
        """Root of the trace of every covariance, (n,), mm."""
        if self.covariance is None:
            message = "`std` needs the covariances: ask with covariance=True"
            raise MarkerError(message, where="covariance")
        return np.asarray(np.sqrt(np.trace(self.covariance, axis1=1, axis2=2)))

    def region(self, number: int, share: float = 0.90) -> Region:
        """Return the ellipsoid that contains the true place of a point with probability `share`.

        Raises
        ------
        MarkerError
            If there is no such point, the covariances were not wanted, or `share` is not in (0, 1).
        """
        point = whole("number", number, most=max(len(self) - 1, 0), error=MarkerError)
        if self.covariance is None:
            message = "`region` needs the covariances: ask with covariance=True"
            raise MarkerError(message, where="covariance")
        return region_of(self.mean[point], self.covariance[point], share, self.tail)


@dataclass(frozen=True, eq=False)
class RegisteredField:
    """A displacement field with its uncertainty.

    Attributes
    ----------
    mesh : Mesh
        The undeformed body.
    displacement : ndarray of float64, shape (n_nodes, 3)
        Of its nodes, mm.
    uncertainty : Deviations
        Of the displacement.
    """

    mesh: Mesh
    displacement: FloatArray
    uncertainty: Deviations

    __repr__ = short_repr

    @cached_property
    def space(self) -> SpaceMap:
        """The field in and around the body."""
        return SpaceMap(self.mesh, self.displacement)

    def at(self, points: Any, covariance: bool = True) -> PointAnswer:
        """Return where points of the undeformed body are now; see `Registration.at`."""
        places = float_array("points", points, (None, 3))
        if not np.isfinite(places).all():
            message = f"`points` must be finite, got row {int(np.argmin(np.isfinite(places).all(axis=1)))}"
            raise MarkerError(message, where="points")
        nodes, weights, inside = held = held_by(self.mesh, places)
        moved = self.space.of(places, held)[0]
        untold = self.uncertainty.untold(nodes, weights)
        flags = tuple(
            OUTSIDE if not within else NO_MARKER if no else None for within, no in zip(inside, untold, strict=True)
        )
        wanted = self.uncertainty.at(nodes, weights) if flag("covariance", covariance) else None
        return PointAnswer(places, places + moved, wanted, inside, flags, self.uncertainty.tail)

    def transform(
        self,
        path: str | os.PathLike[str],
        *,
        like: Any = None,
        spacing: Any = None,
        direction: Any = None,
        std: Any = None,
        threads: int = 0,
    ) -> Written:
        """Write the field as a grid transform; see `Registration.transform`."""
        spread = None if std is None else (std, self.uncertainty.std)
        grid = {"like": like, "spacing": spacing, "direction": direction}
        return write_transform(self.space, path, **grid, std=spread, threads=threads)


class HasField(Protocol):
    """A registered body."""

    @property
    def field(self) -> RegisteredField:
        """The displacement field with its uncertainty."""
        ...


class FieldAnswers:
    """What a registered body answers by its field, in memory as from its folder."""

    def at(self: HasField, points: Any, covariance: bool = True) -> PointAnswer:
        """Return where points of the undeformed body are now.

        Parameters
        ----------
        points : array_like of float, shape (n, 3)
            Places in the undeformed body, mm. Outside the body the displacement fades, harmonically, to nothing at a
            distance of half the body's extent; such points are flagged.
        covariance : bool
            Whether the covariances are wanted.

        Returns
        -------
        PointAnswer
            Places, covariances, whether each point is inside, and flags.

        Raises
        ------
        ShapeError, MarkerError
            If the points are no finite places.

        Notes
        -----
        Cost: that of `uncertainty`, once; then some microseconds a point. Covariances are those of draws, within some
        per cent of a target's.
        """
        return self.field.at(points, covariance)

    def transform(
        self: HasField,
        path: str | os.PathLike[str],
        *,
        like: Any = None,
        spacing: Any = None,
        direction: Direction | None = None,
        std: str | os.PathLike[str] | None = None,
    ) -> Path:
        """Write the displacement field as a grid transform, for 3D Slicer, ITK and others.

        Parameters
        ----------
        path : path-like
            A ``.nrrd`` file: displacements in mm, LPS. Or an ``.h5`` or ``.tfm`` file, an ITK transform, which always
            holds the direction that warps images.
        like : path-like, optional
            An image whose grid is taken, oblique and anisotropic ones included; or the folder of a DICOM series.
        spacing : float, optional
            Spacing of a grid over the body and its surroundings, mm, given instead.
        direction : {"modeling", "resampling"}, optional
            From places before the deformation to those after it, or the other way, as images are warped. By default
            ``"modeling"`` in a ``.nrrd`` file.
        std : path-like, optional
            A ``.nrrd`` file for the standard deviation of every voxel, mm, NaN outside the body.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        ArgumentError, FormatError, OutputError
            If neither or both of `like` and `spacing` are given, the image cannot be read, or a file cannot be written.
        ImportError
            If SimpleITK is not installed (``pip install 'tissuereg[images]'``).
        """
        return self.field.transform(path, like=like, spacing=spacing, direction=direction, std=std).path

    def warp_image(
        self: HasField,
        image: str | os.PathLike[str],
        path: str | os.PathLike[str],
        *,
        labels: bool,
        like: str | os.PathLike[str] | None = None,
    ) -> Path:
        """Write an image of the undeformed body as it is now.

        Parameters
        ----------
        image : path-like
            An image, or the folder of a DICOM series; LPS, as images are, for which a mesh without a frame is taken.
        path : path-like
            File to write: .nrrd, .nii, .nii.gz or .mha.
        labels : bool
            Whether voxels are labels: each takes the one with the largest linear weight, none is mixed, and the names
            of segments are kept. If not, values are interpolated linearly; those from outside are the smallest.
        like : path-like, optional
            An image whose grid is taken in place of its own.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        ArgumentError, FormatError, OutputError
            If the image cannot be read, holds no labels where it should, or does not show the body; or the file cannot
            be written or is one of the images.
        ImportError
            If SimpleITK is not installed (``pip install 'tissuereg[images]'``).
        """
        from tissuereg.imaging.warp import warp_image

        warp_image(self.field, image, path, labels=labels, like=like)
        return Path(path)

    def warp_surface(self: HasField, surface: Any, path: str | os.PathLike[str], *, unit: Unit | None = None) -> Path:
        """Write a surface of the undeformed body with its vertices moved; triangles stay.

        Parameters
        ----------
        surface : path-like, pair of arrays, or Triangles
            As of `tetrahedralize`, in the frame of the body.
        path : path-like
            File to write: .stl, .ply or .obj.
        unit : {"mm", "cm", "m"}, optional
            Unit of the surface's coordinates; by default that stated in the file, or else mm. Written are mm.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        ArgumentError, FormatError, MeshError, OutputError
            If the surface cannot be read or lies in another frame, or the file cannot be written.
        """
        from tissuereg.imaging.warp import warp_surface

        warp_surface(self.field, surface, path, unit=unit)
        return Path(path)


__all__ = ["FieldAnswers", "PointAnswer", "RegisteredField"]
