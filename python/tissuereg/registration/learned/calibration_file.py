"""Writes a calibration into the folder of its model, and reads it after a comparison of its checksum."""

from pathlib import Path
from typing import Any

import numpy as np

from tissuereg.io.atomic import atomic_file
from tissuereg.registration.learned.calibration import Calibration
from tissuereg.registration.learned.card import card_text, check_file, list_file, read_card

CALIBRATION_NAME = "calibration.npz"

#: Heading of the section of a model's page that compares it with registration without a model.
_WORTH = "## Beside registration without a model"


def write_calibration(folder: Path, calibration: Calibration, worth: str | None = None) -> None:
    """Write a calibration as ``calibration.npz`` into the folder of its model, and list it in the model's card.

    The card is the file ``model.json``. `worth`: text that becomes the last section of ``MODEL.md``, in the place of an
    older one. Raises `ModelError` if there is no card; `OutputError` if a file cannot be
    written. Each file is written whole or not at all; a calibration that the card does not list is not used.
    """
    card = read_card(folder)
    path = folder / CALIBRATION_NAME
    with atomic_file(path) as draft, draft.open("wb") as stream:
        np.savez_compressed(stream, **calibration.save())  # type: ignore[arg-type]
    list_file(card, path)
    if worth is not None:
        page = folder / "MODEL.md"
        before = page.read_text(encoding="utf-8").split(_WORTH)[0] if page.exists() else ""
        with atomic_file(page) as draft:
            draft.write_text(f"{before.rstrip()}\n\n{_WORTH}\n\n{worth}".lstrip(), encoding="utf-8")
        list_file(card, page)
    with atomic_file(folder / "model.json") as draft:
        draft.write_text(card_text(card), encoding="utf-8")


def read_calibration(folder: Path, card: dict[str, Any]) -> Calibration | None:
    """Return the calibration in the folder of a model, or None if the model's card (``model.json``) lists none.

    `card` is the content of that file. Raises `FormatError` if an array is missing or of another shape; `ModelError` if
    the calibration's file is missing, or differs from its size or SHA-256 in the card.
    """
    if CALIBRATION_NAME not in card["files"]:
        return None
    path = check_file(folder, card, CALIBRATION_NAME)
    return Calibration.read(path, card["n_latent"], card["n_nodes"])
