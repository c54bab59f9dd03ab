"""The command ``tissuereg warp``: moves points, surfaces and images with a registered body, or writes its transform."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tissuereg._base.choices import DIRECTIONS, FRAMES, UNITS, Frame
from tissuereg._base.fields import choice, number
from tissuereg.cli.common import UNTRUSTED, Outcome, Stopwatch, seconds_line
from tissuereg.cli.options import Help, Parser, add_option, refuse, refuse_overwriting

if TYPE_CHECKING:
    from tissuereg._base.arrays import FloatArray
    from tissuereg.body.mesh import Mesh
    from tissuereg.registration.field import RegisteredField

HELP = Help(
    "REGISTERED is the folder that 'tissuereg register --out' wrote. Points (a table with x_mm,y_mm,z_mm, or points of "
    "3D Slicer) and the vertices of a surface go from before the deformation to after it; so do the voxels of a label "
    "map (each takes one label, they are never mixed) and of a volume (linear). Around the body the displacement "
    "fades, harmonically, to nothing at half the body's extent. --grid writes the field itself: .nrrd as 3D Slicer "
    "reads it, .h5 or .tfm for ITK. REGISTERED may be the folder of 'tissuereg track --fields', of which --grid writes "
    "all moments: .seq.nrrd. An IMAGE may be the folder of a DICOM series. Images: pip install 'tissuereg[images]'.",
    example="tissuereg warp out --labels tumour.seg.nrrd --out moved.seg.nrrd\n"
    "tissuereg warp out --grid field.nrrd --like ct.nrrd --std sigma.nrrd",
)

#: What may be moved.
KINDS = ("points", "surface", "labels", "volume", "grid")


def options(parser: Parser) -> None:
    """Add the arguments of ``tissuereg warp`` to its parser."""
    parser.add_argument("registered", metavar="REGISTERED", help="folder of a registration")
    kinds = parser.add_argument_group("what is moved, one of")
    kinds.add_argument("--points", metavar="FILE", help="points of the undeformed body -> a table, or .mrk.json")
    kinds.add_argument("--surface", metavar="FILE", help="surface in the undeformed body -> .stl, .ply or .obj")
    kinds.add_argument("--labels", metavar="IMAGE", help="label map of the undeformed body -> an image")
    kinds.add_argument("--volume", metavar="IMAGE", help="image of the undeformed body -> an image")
    kinds.add_argument("--grid", metavar="FIELD", help="write the field: .nrrd, .h5 or .tfm; takes no --out")
    parser.add_argument("--out", metavar="FILE", help="file for what was moved")
    more = parser.add_argument_group("images and fields")
    more.add_argument("--like", metavar="IMAGE", help="image whose grid is taken (default of images: their own)")
    text = "spacing of a grid over the body and around it, for --grid"
    add_option(more, "--spacing", number(text, unit="mm", above=0.0, default=None, otherwise="that of --like"), "MM")
    text = "modeling: from before the deformation to after it; resampling: back, as images are warped"
    usual = "modeling in a .nrrd file, else resampling"
    way = choice(DIRECTIONS, text, default=None, otherwise=usual)
    add_option(more, "--direction", way)
    more.add_argument("--std", metavar="FILE", help="also write the standard deviation of every voxel, .nrrd")
    text = "LPS or RAS: patient frame of the body's coordinates, where its mesh states none"
    usual = "that of the mesh, or else LPS"
    add_option(parser, "--frame", choice(FRAMES, text, default=None, otherwise=usual))
    text = "unit of the coordinates of --surface"
    add_option(parser, "--unit", choice(UNITS, text, default=None, otherwise="that stated, or else mm"))


def run(args: argparse.Namespace) -> Outcome:
    """Run ``tissuereg warp``; JSON schema ``tissuereg.warp/1``."""
    from tissuereg.imaging.sequences import ENDING
    from tissuereg.io.atomic import check_file_target
    from tissuereg.registration.stored import read_registration

    kind, source, out = _asked(args)
    written = [Path(one) for one in (out, args.std) if one is not None]
    refuse_overwriting(written, [one for one in (None if kind == "grid" else source, args.like) if one is not None])
    for one in written:
        check_file_target(one)
    clock = Stopwatch()
    if kind == "grid" and out.lower().endswith(ENDING):
        return _sequence(out, args, clock)
    stored = read_registration(args.registered)
    field = _in_frame(stored.field, args.frame)
    clock.lap("read")
    if kind not in ("points", "surface"):
        _warn_without_frame(field.mesh)
    moved, outside, residual = _warped(kind, source, out, field, args)
    clock.lap("warp")
    trusted = stored.trust.ok
    content: dict[str, Any] = {
        "schema": "tissuereg.warp/1",
        "kind": kind,
        "written": [str(one) for one in written],
        "moved": {"mean_mm": moved[0], "max_mm": moved[1]},
        "outside": outside,
        "trusted": trusted,
        "frame": field.mesh.frame,
        "seconds": clock.seconds,
        **({} if residual is None else {"inverse_residual_mm": residual}),
    }
    what = {"points": "points", "surface": "vertices"}.get(kind, "voxels")
    lines = [
        *([] if trusted else ["do not trust this registration: " + "; ".join(stored.trust.reasons)]),
        f"moved by {moved[0]:.3g} mm on average, {moved[1]:.3g} mm at most",
        f"{outside} {what} around the body, where the displacement fades to nothing",
        *(
            []
            if residual is None
            else [f"forward and back differ by {residual:.2g} mm at most at 999 of 1,000 voxels in the body"]
        ),
        seconds_line(clock.seconds, verbose=args.verbose),
        *(f"written: {one}" for one in written),
    ]
    return Outcome(content, "\n".join(lines), args.threads, 0 if trusted else UNTRUSTED)


def _sequence(out: str, args: argparse.Namespace, clock: Stopwatch) -> Outcome:
    """Write the transform with time of a track."""
    from dataclasses import replace

    from tissuereg.tracking import read_track

    for name, value in {"--std": args.std, "--direction": args.direction}.items():
        if value not in (None, "modeling"):
            refuse(f"{name} must be left out with a .seq.nrrd, which leads from before to after", name)
    stored = read_track(args.registered)
    track = replace(stored, mesh=_framed(stored.mesh, args.frame))
    _warn_without_frame(track.mesh)
    clock.lap("read")
    made = track.transform(out, like=args.like, spacing=args.spacing, threads=args.threads)
    clock.lap("warp")
    content = {
        "schema": "tissuereg.warp/1",
        "kind": "grid",
        "written": [out],
        "moments": len(track.times),
        "moved": {"mean_mm": made.moved_mm[0], "max_mm": made.moved_mm[1]},
        "outside": made.outside,
        "frame": track.mesh.frame,
        "seconds": clock.seconds,
    }
    lines = [
        f"{len(track.times)} moments, moved by {made.moved_mm[0]:.3g} mm on average, {made.moved_mm[1]:.3g} mm at most",
        seconds_line(clock.seconds, verbose=args.verbose),
        f"written: {out}",
    ]
    return Outcome(content, "\n".join(lines), args.threads)


def _asked(args: argparse.Namespace) -> tuple[str, str, str]:
    """Return what is moved, its file, and the file that is written; raise UsageError where options clash."""
    given = [kind for kind in KINDS if getattr(args, kind) is not None]
    if len(given) != 1:
        found = ", ".join(f"--{kind}" for kind in given) or "none"
        refuse(f"one of {', '.join(f'--{kind}' for kind in KINDS)} must be given, got {found}", "--points")
    kind = given[0]
    source = str(getattr(args, kind))
    if (args.out is None) != (kind == "grid"):
        refuse("--out must be given, except with --grid, which names the file itself", "--out")
    of_grid = {"--spacing": args.spacing, "--direction": args.direction, "--std": args.std}
    for name, value in of_grid.items():
        if value is not None and kind != "grid":
            refuse(f"{name} must come with --grid", name)
    if args.like is not None and kind in ("points", "surface"):
        refuse("--like must come with an image or --grid", "--like")
    if kind == "points" and not str(args.out).lower().endswith((".csv", ".mrk.json")):
        refuse(f"--out must end in .csv or .mrk.json for points, got '{args.out}'", "--out")
    if args.unit is not None and kind != "surface":
        refuse("--unit must come with --surface", "--unit")
    return kind, source, source if kind == "grid" else str(args.out)


def _in_frame(field: "RegisteredField", frame: Frame | None) -> "RegisteredField":
    from dataclasses import replace

    return replace(field, mesh=_framed(field.mesh, frame))


def _warn_without_frame(mesh: "Mesh") -> None:
    from tissuereg._base.provenance import warn

    if mesh.frame is None:
        warn("the mesh states no patient frame; it is taken for LPS, as images are: --frame says otherwise")


def _framed(mesh: "Mesh", frame: Frame | None) -> "Mesh":
    """Return a mesh in the frame that --frame states; images are taken to be in LPS where nothing does."""
    if frame is None or mesh.frame == frame:
        return mesh
    if mesh.frame is not None:
        refuse(f"--frame must be left out or {mesh.frame}: the mesh states it; got {frame}", "--frame")
    return mesh.in_frame(frame)


def _warped(
    kind: str, source: str, out: str, field: "RegisteredField", args: argparse.Namespace
) -> tuple[tuple[float, float], int, float | None]:
    """Return mean and largest displacement, mm, the number of points or voxels outside, and the residual, mm."""
    from tissuereg.imaging.warp import warp_image, warp_points, warp_surface

    if kind == "grid":
        options = {name: getattr(args, name) for name in ("like", "spacing", "direction", "std", "threads")}
        made = field.transform(out, **options)
        return made.moved_mm, made.outside, made.residual_mm
    if kind == "points":
        found = warp_points(field, _points(source, field.mesh.frame), Path(out))
    elif kind == "surface":
        found = warp_surface(field, source, Path(out), unit=args.unit)
    else:
        found = warp_image(field, source, Path(out), labels=kind == "labels", like=args.like, threads=args.threads)
    return found.moved_mm, found.outside, found.residual_mm


def _points(source: str, frame: Frame | None) -> "dict[str, FloatArray]":
    """Return the points of a file by name, (3,), mm, in a patient frame."""
    from tissuereg.io.point_files import frame_of_files
    from tissuereg.io.tables import read_named_points

    stated = frame_of_files([Path(source)])
    if frame is None and stated is not None:
        refuse(f"--frame must be given: {stated[1]} is in {stated[0]}, and the mesh states no frame", "--frame")
    return read_named_points(source, frame=frame)
