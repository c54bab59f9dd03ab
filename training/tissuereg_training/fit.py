"""The training loop: seeded, resumable, the best validation epoch kept.

All chance of an epoch (order, blends, noise) is drawn from a generator seeded with (seed, epoch), so a resumed run
needs no generator state and repeats an uninterrupted one.
"""

import copy
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch

from tissuereg_training.checkpoint import Checkpoint
from tissuereg_training.data import FieldArray
from tissuereg_training.errors import DivergenceError
from tissuereg_training.evaluate import mean_error
from tissuereg_training.losses import kl_divergence, kl_share, one_cycle, reconstruction
from tissuereg_training.network import Network, sampled_latents
from tissuereg_training.settings import TrainSettings

Report = Callable[[str], None]

#: Batches that are timed before a training.
_TIMED = 3


@dataclass
class FitState:
    """Progress of a training: the content of a checkpoint besides weights and optimiser.

    Attributes
    ----------
    epoch : int
        Epochs done.
    best_epoch : int
        Epoch (1-based) of the kept weights; 0 before the first that may be chosen.
    best_error : float
        Its mean Euclidean validation error in mm.
    best_weights : dict
        The kept weights.
    history : list of dict
        A row an epoch: epoch, reconstruction, kl, valid_mm, seconds.
    """

    epoch: int = 0
    best_epoch: int = 0
    best_error: float = float("inf")
    best_weights: dict[str, Any] = field(default_factory=dict)
    history: list[dict[str, float]] = field(default_factory=list)


def fit(
    model: Network,
    train: Iterable[FieldArray],
    valid: FieldArray,
    settings: TrainSettings,
    *,
    seed: int,
    checkpoint: Checkpoint | None = None,
    report: Report | None = None,
) -> FitState:
    """Train a network; afterwards it holds the weights of the best validation epoch.

    Parameters
    ----------
    model : Network
        Normalised; trained in place, where it lies.
    train : iterable of ndarray of float32, shape (n_part, n_nodes, 3)
        Training split in mm, in parts; what the network makes of it is kept in memory, not the fields.
    valid : ndarray of float32, shape (n_valid, n_nodes, 3)
        Validation split in mm.
    settings : TrainSettings
        How.
    seed : int
        Source of all random numbers.
    checkpoint : Checkpoint, optional
        Continued from where it holds something, written after every epoch.
    report : callable of str, optional
        Hears a line every few seconds.

    Returns
    -------
    FitState
        Its history has a row an epoch.

    Raises
    ------
    DivergenceError
        If the loss is no longer finite.
    CheckpointError
        If the checkpoint belongs to another run.

    Notes
    -----
    Cost a step of the graph network: M n_edges batch min(I, O) multiply-adds a convolution and direction, three
    directions; the README holds times.
    """
    optimiser = torch.optim.Adam(model.parameters(), lr=settings.learning_rate, fused=True)
    state = FitState()
    if checkpoint is not None:
        checkpoint.load_into(model, optimiser, state)
    x = normalised_parts(model, train)
    n_batches = max(1, round(len(x) / settings.batch))
    if report is not None:
        left = settings.epochs - state.epoch
        seconds = _seconds_of_an_epoch(model, x, n_batches, settings)
        report(f"{left} epochs of about {seconds:.1f} s on this machine as it is now: {left * seconds / 3600:.1f} h")
    reported = time.perf_counter()
    while state.epoch < settings.epochs and not stalled(state, settings):
        start = time.perf_counter()
        row = _epoch(model, optimiser, x, n_batches, settings, seed, state.epoch)
        state.epoch += 1
        row["valid_mm"] = mean_error(model, valid)
        row["seconds"] = time.perf_counter() - start
        state.history.append({"epoch": state.epoch, **row})
        may_choose = kl_share(state.epoch - 1, settings.epochs, settings.kl_warmup) == 1.0
        if may_choose and row["valid_mm"] < state.best_error:
            state.best_epoch, state.best_error = state.epoch, row["valid_mm"]
            state.best_weights = copy.deepcopy(model.state_dict())
        if checkpoint is not None:
            checkpoint.save(model, optimiser, state)
        ends = state.epoch == settings.epochs or stalled(state, settings)
        if report is not None and (time.perf_counter() - reported > 5 or ends):
            reported = time.perf_counter()
            report(_line(state, settings))
    model.load_state_dict(state.best_weights)
    model.finish()
    return state


def stalled(state: FitState, settings: TrainSettings) -> bool:
    """Return whether as many epochs as `patience` have passed since the best one; never where it is 0."""
    return bool(state.best_epoch) and 0 < settings.patience <= state.epoch - state.best_epoch


@torch.no_grad()
def normalised_parts(model: Network, parts: Iterable[FieldArray]) -> torch.Tensor:
    """Return what a network makes of fields in mm, given in parts: (n_fields, ...), dimensionless."""
    return torch.cat([model.normalised(torch.from_numpy(part).to(model.device)) for part in parts])


def batch_terms(
    model: Network, x: torch.Tensor, loss: str, rng: np.random.Generator
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the reconstruction error of `x` (batch, ...) with drawn latents, and the KL divergence of q in nats."""
    mean, log_variance = model.encode(x)
    noise = torch.from_numpy(rng.standard_normal(mean.shape, dtype=np.float32)).to(mean.device)
    found = model.decode(sampled_latents(mean, log_variance, noise))
    return reconstruction(found, x, loss), kl_divergence(mean, log_variance).sum()


def _epoch(
    model: Network,
    optimiser: torch.optim.Adam,
    train: torch.Tensor,
    n_batches: int,
    settings: TrainSettings,
    seed: int,
    epoch: int,
) -> dict[str, float]:
    """Run one epoch; return its mean reconstruction term and KL."""
    rng = np.random.default_rng([seed, 11, epoch])
    weight = settings.kl_weight * kl_share(epoch, settings.epochs, settings.kl_warmup)
    sums = np.zeros(2)
    for number, rows in enumerate(np.array_split(rng.permutation(len(train)), n_batches)):
        step = epoch * n_batches + number
        for group in optimiser.param_groups:
            group["lr"] = one_cycle(step, settings.epochs * n_batches, settings.learning_rate, settings.rise)
        x = _blended(train, rows, settings.mixing, rng)
        missed, kl = batch_terms(model, x, settings.loss, rng)
        loss = missed + weight * kl
        if not bool(torch.isfinite(loss)):
            message = (
                f"the loss must stay finite, got {loss.item()} in epoch {epoch + 1}, step {number + 1}; "
                "lower [train] learning_rate"
            )
            raise DivergenceError(message, where=f"epoch {epoch + 1}")
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(model.parameters(), settings.gradient_limit)
        optimiser.step()
        sums += (missed.item(), kl.item())
    return {"reconstruction": float(sums[0] / n_batches), "kl": float(sums[1] / n_batches)}


def _seconds_of_an_epoch(model: Network, train: torch.Tensor, n_batches: int, settings: TrainSettings) -> float:
    """Return what an epoch will take, from a few batches; weights and random numbers stay as they are."""
    rows, spent = np.arange(min(settings.batch, len(train))), []
    for _ in range(_TIMED):
        start = time.perf_counter()
        rng = np.random.default_rng(0)
        missed, kl = batch_terms(model, _blended(train, rows, settings.mixing, rng), settings.loss, rng)
        (missed + kl).backward()  # type: ignore[no-untyped-call]
        model.zero_grad()
        spent.append(time.perf_counter() - start)
    return n_batches * float(np.median(spent))


def _blended(train: torch.Tensor, rows: Any, share: float, rng: np.random.Generator) -> torch.Tensor:
    """Return the rows, a share of them replaced by weighted sums with others of the training split."""
    x = train[torch.from_numpy(rows).to(train.device)]
    if share == 0.0:
        return x
    partners = rng.integers(len(train), size=len(rows))
    own, other = rng.uniform(-1.0, 1.0, (2, len(rows)))
    chosen = rng.random(len(rows)) < share
    weights = np.where(chosen, (own, other), ((1.0,), (0.0,))).astype(np.float32)
    w = torch.from_numpy(weights).to(train.device).view(2, -1, *[1] * (x.dim() - 1))
    return w[0] * x + w[1] * train[torch.from_numpy(partners).to(train.device)]


def _line(state: FitState, settings: TrainSettings) -> str:
    row = state.history[-1]
    best = f"best {state.best_error:.4f} mm in {state.best_epoch}" if state.best_epoch else "KL warming up"
    left = np.mean([r["seconds"] for r in state.history[-20:]]) * (settings.epochs - state.epoch)
    return (
        f"epoch {state.epoch}/{settings.epochs}: loss {row['reconstruction']:.4f}, KL {row['kl']:.1f} nats, "
        f"valid {row['valid_mm']:.4f} mm ({best}), {row['seconds']:.2f} s an epoch, {left:.0f} s left"
    )


def to_stderr(line: str) -> None:
    """Print a line of progress."""
    print(line, file=sys.stderr, flush=True)
