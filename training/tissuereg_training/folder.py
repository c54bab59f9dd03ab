"""The model folder: its files are there all together or not at all."""

import hashlib
import json
import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import onnx

from tissuereg_training.errors import OutputError
from tissuereg_training.shared import write_shared

CARD = "model.json"


def check_out(out: Path) -> None:
    """Refuse early a place where no model folder can be put.

    Parameters
    ----------
    out : Path
        Where the model shall stand.

    Raises
    ------
    OutputError
        If it is a file, a folder that holds something else, or lies where nothing may be written.
    """
    if out.is_file():
        message = f"the model must be written to a folder, {out} is a file"
        raise OutputError(message, where=str(out))
    if out.is_dir() and any(out.iterdir()) and not (out / CARD).is_file():
        message = f"{out} must be new, empty or a model folder, which is replaced; it holds other files"
        raise OutputError(message, where=str(out))
    standing = next(folder for folder in out.absolute().parents if folder.exists())
    if not standing.is_dir() or not os.access(standing, os.W_OK | os.X_OK):
        message = f"{out} must lie in a folder that can be written; {standing} cannot"
        raise OutputError(message, where=str(out))


def write_model(
    out: Path,
    scratch: Path,
    encoder: onnx.ModelProto,
    decoder: onnx.ModelProto,
    weights: dict[str, npt.NDArray[Any]],
    card: dict[str, Any],
    pages: Mapping[str, bytes] | None = None,
) -> dict[str, Any]:
    """Write the model folder.

    Parameters
    ----------
    out : Path
        Where it shall stand; an older model there is replaced.
    scratch : Path
        Folder next to `out`, used by this run alone, made where absent. What a killed run left in it is replaced; of a
        run that ends nothing of this stays in it.
    encoder, decoder : onnx.ModelProto
        The networks; tables that they share with `weights` become references to a file of their own.
    weights : dict of str to ndarray
        Content of ``decoder_weights.npz``.
    card : dict
        Content of ``model.json``; the files' SHA-256 and sizes in bytes are added.
    pages : mapping of str to bytes, optional
        Further files by their names, for people.

    Returns
    -------
    dict
        The card as written.

    Raises
    ------
    OutputError
        If the operating system refuses; nothing is left behind then.
    """
    out = out.absolute()
    try:
        scratch.mkdir(parents=True, exist_ok=True)
        new = scratch / "model"
        remove_unfinished(scratch)
        new.mkdir(mode=0o700)
        try:
            rest = write_shared(new, (encoder, decoder), weights)
            (new / "encoder.onnx").write_bytes(encoder.SerializeToString(deterministic=True))
            (new / "decoder.onnx").write_bytes(decoder.SerializeToString(deterministic=True))
            with (new / "decoder_weights.npz").open("wb") as stream:
                np.savez_compressed(stream, **rest)  # type: ignore[arg-type]
            for name, content in (pages or {}).items():
                (new / name).write_bytes(content)
            files = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(new.iterdir())}
            card = {**card, "files": files, "sizes": {name: (new / name).stat().st_size for name in files}}
            (new / CARD).write_text(json.dumps(card, indent=1, allow_nan=False) + "\n", encoding="utf-8")
            new.chmod(0o755)
            _put_in_place(new, out)
        finally:
            remove_unfinished(scratch)
    except OSError as error:
        message = f"the model folder {out} must be writable: {error.strerror or error}"
        raise OutputError(message, where=str(out)) from error
    return card


def put_back(out: Path, scratch: Path) -> None:
    """Put an old model back that a killed run had taken away to replace it.

    Parameters
    ----------
    out, scratch : Path
        As for `write_model`.
    """
    if not out.exists() and (scratch / "replaced").is_dir():
        (scratch / "replaced").rename(out)


def remove_unfinished(scratch: Path) -> None:
    """Remove what `write_model` had in hand when it was killed: a new model, an old one that was being replaced."""
    for name in ("model", "replaced"):
        shutil.rmtree(scratch / name, ignore_errors=True)


def _put_in_place(new: Path, out: Path) -> None:
    if not out.exists():
        new.rename(out)
        return
    old = new.with_name("replaced")
    out.rename(old)
    try:
        new.rename(out)
    except OSError:
        old.rename(out)
        raise
