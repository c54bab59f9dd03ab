"""Checkpoints: a training's whole state in one file, replaced whole after every epoch."""

import contextlib
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch

from tissuereg_training.errors import CheckpointError, OutputError
from tissuereg_training.folder import remove_unfinished

if TYPE_CHECKING:
    from tissuereg_training.fit import FitState
    from tissuereg_training.network import Network

_STATE = ("epoch", "best_epoch", "best_error", "best_weights", "history")


class Checkpoint:
    """A checkpoint file next to the model folder that it belongs to.

    Parameters
    ----------
    folder : Path
        `MODEL.training`, made when the first epoch is saved.
    fingerprint : str
        Of settings, seed and data; a checkpoint of another fingerprint is refused.
    """

    def __init__(self, folder: Path, fingerprint: str) -> None:
        self.folder, self.fingerprint = folder, fingerprint
        self.path = folder / "last.pt"
        self._part = folder / "last.part"

    def exists(self) -> bool:
        """Return whether there is something to continue from."""
        return self.path.is_file()

    def discard(self) -> None:
        """Delete the checkpoint and what a killed run left next to it, and the folder if nothing else is in it."""
        self.path.unlink(missing_ok=True)
        self._part.unlink(missing_ok=True)
        remove_unfinished(self.folder)
        shutil.rmtree(self.folder / "__pycache__", ignore_errors=True)
        with contextlib.suppress(OSError):
            self.folder.rmdir()

    def save(self, model: "Network", optimiser: torch.optim.Optimizer, state: "FitState") -> None:
        """Write everything; the file before it stays until the new one is whole.

        Parameters
        ----------
        model : Network
            Network.
        optimiser : torch.optim.Optimizer
            Its moments.
        state : FitState
            Progress and best weights.

        Raises
        ------
        OutputError
            If the operating system refuses, for want of room for instance; the file before it stays.
        """
        whole = {
            "fingerprint": self.fingerprint,
            "model": model.state_dict(),
            "optimiser": optimiser.state_dict(),
            **{name: getattr(state, name) for name in _STATE},
        }
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            torch.save(whole, self._part)
            self._part.replace(self.path)
        except (OSError, RuntimeError) as error:  # torch's writer raises the latter where the disk is full
            with contextlib.suppress(OSError):
                self._part.unlink(missing_ok=True)
            message = f"the checkpoint {self.path} must be writable: {str(error).splitlines()[0]}"
            raise OutputError(message, where=str(self.path)) from error

    def load_into(self, model: "Network", optimiser: torch.optim.Optimizer, state: "FitState") -> None:
        """Take everything from the file; do nothing where there is none.

        Parameters
        ----------
        model, optimiser, state
            Changed in place.

        Raises
        ------
        CheckpointError
            If the file is spoilt, or of other settings, seed or data.
        """
        if not self.exists():
            return
        whole = self._read()
        if whole["fingerprint"] != self.fingerprint:
            message = (
                f"{self.path} must be a checkpoint of this recipe, seed and data; it is another run's. "
                "Start anew with --fresh, or train into another folder"
            )
            raise CheckpointError(message, where=str(self.path))
        model.load_state_dict(whole["model"])
        optimiser.load_state_dict(whole["optimiser"])
        for name in _STATE:
            setattr(state, name, whole[name])

    def _read(self) -> dict[str, Any]:
        try:
            whole = torch.load(self.path, map_location="cpu", weights_only=True)
            missing = {"fingerprint", "model", "optimiser", *_STATE} - set(whole)
        except Exception as error:  # torch raises pickle, zip, runtime and type errors for spoilt files
            message = f"{self.path} must be a whole checkpoint: {str(error).splitlines()[0]}. Start anew with --fresh"
            raise CheckpointError(message, where=str(self.path)) from error
        if missing:
            message = f"{self.path} must be a whole checkpoint; it lacks {', '.join(sorted(missing))}. Use --fresh"
            raise CheckpointError(message, where=str(self.path))
        return dict(whole)
