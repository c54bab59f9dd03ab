"""The keys of `[train]`: what is trained and for how long, a class a kind of network."""

import dataclasses
import math
from dataclasses import dataclass
from typing import Any, ClassVar

from tissuereg_training.graph import COARSE_HOPS

ACTIVATIONS = ("elu", "silu")

#: Keys newer than the first trainings: left out of a checkpoint's fingerprint while they have these values.
_LATER: dict[str, Any] = {"kind": "graph", "patience": 0}
#: Keys of what comes after the first stage, which no checkpoint of it depends on.
_AFTER = ("spread_weight", "spread_epochs", "error_fields")


@dataclass(frozen=True, kw_only=True)
class TrainSettings:
    """The keys that every kind of network has.

    Parameters
    ----------
    epochs : int
        Passes over the training split.
    batch : int
        Fields a step.
    learning_rate : float
        Peak of the one-cycle schedule.
    rise : float
        Share of all steps in which the learning rate rises to its peak; it falls to zero after.
    loss : {"distance", "rms", "squared"}
        Reconstruction term, in units of the scale: mean Euclidean node error (not of a closure), mean over fields of
        the root mean square node error (not of a graph network), or mean squared component.
    kl_weight : float
        Weight of the Kullback-Leibler divergence of q(z | x) from N(0, 1), summed over latents. Positive: a network
        without it has no prior.
    kl_warmup : float
        Share of the epochs in which that weight rises from zero; no epoch before its end can be chosen as the best.
    mixing : float
        Share of a batch's fields that are replaced by weighted sums with another training field, both weights uniform
        in [-1, 1]: fields that no load makes, but near enough to teach. For a few hundred members.
    n_latent : int
        Latents.
    gradient_limit : float
        Largest norm of the whole gradient; longer ones are shortened.
    patience : int
        Stop after so many epochs without a smaller validation error; 0 never stops early. The learning rate does not
        follow: the schedule is that of all `epochs`.
    spread_weight : float
        Weight of the divergence in the second stage, which fits the encoder's log-variances alone (`spread.py`); 0
        leaves those of the first stage.
    spread_epochs : int
        Passes over the training split in the second stage.
    error_fields : int
        Reconstruction errors of unseen fields that are kept in the model folder, at most.
    """

    #: Name of the kind in a recipe.
    kind: ClassVar[str]
    #: Reconstruction terms that the kind can use.
    LOSSES: ClassVar[tuple[str, ...]]

    epochs: int = 300
    batch: int = 16
    learning_rate: float = 2e-3
    rise: float = 0.3
    loss: str = "distance"
    kl_weight: float = 1e-3
    kl_warmup: float = 0.3
    mixing: float = 0.0
    n_latent: int = 26
    gradient_limit: float = 1.0
    patience: int = 0
    spread_weight: float = 1.0
    spread_epochs: int = 5
    error_fields: int = 64

    def rules(self) -> tuple[tuple[bool, str, str], ...]:
        """Return what must hold: (holds, key, sentence)."""
        return (
            (self.epochs >= 1, "epochs", "at least 1"),
            (self.batch >= 1, "batch", "at least 1"),
            (0 < self.learning_rate < 1, "learning_rate", "in (0, 1)"),
            (0 < self.rise < 1, "rise", "in (0, 1)"),
            (self.loss in self.LOSSES, "loss", f"one of {', '.join(self.LOSSES)}"),
            (0 < self.kl_weight < math.inf, "kl_weight", "positive: without it the codes have no prior"),
            (0 <= self.kl_warmup < 1, "kl_warmup", "in [0, 1)"),
            (0 <= self.mixing <= 1, "mixing", "in [0, 1]"),
            (self.n_latent >= 1, "n_latent", "at least 1"),
            (self.gradient_limit > 0, "gradient_limit", "positive"),
            (self.patience >= 0, "patience", "at least 0"),
            (0 <= self.spread_weight < math.inf, "spread_weight", "at least 0"),
            (self.spread_epochs >= 1, "spread_epochs", "at least 1"),
            (self.error_fields >= 1, "error_fields", "at least 1"),
        )

    def as_dict(self) -> dict[str, Any]:
        """Return the settings as plain data, `kind` included."""
        values = {k: list(v) if isinstance(v, tuple) else v for k, v in dataclasses.asdict(self).items()}
        return {"kind": self.kind, **values}

    def identity(self) -> dict[str, Any]:
        """Return what a checkpoint is compared by: `as_dict` without newer keys that have no effect.

        A training that an earlier version began can then be continued by a later one.
        """
        values = self.as_dict().items()
        return {key: value for key, value in values if key not in _AFTER and value != _LATER.get(key)}


@dataclass(frozen=True, kw_only=True)
class GraphSettings(TrainSettings):
    """Table II's network, `kind = "graph"`.

    Parameters
    ----------
    channels : tuple of int
        Channels a level, finest first; as many poolings as entries.
    n_bases : int
        Basis matrices a convolution, M.
    coarse_edges : {"wide", "reduced"}
        Coarse nodes are neighbours within 3 hops of the finer graph, or within 2.
    """

    kind: ClassVar[str] = "graph"
    LOSSES: ClassVar[tuple[str, ...]] = ("distance", "squared")

    channels: tuple[int, ...] = (32, 64, 128)
    n_bases: int = 9
    coarse_edges: str = "wide"

    def rules(self) -> tuple[tuple[bool, str, str], ...]:
        """Return what must hold: (holds, key, sentence)."""
        return (*super().rules(), *_graph_rules(self))


@dataclass(frozen=True, kw_only=True)
class ClosureSettings(TrainSettings):
    """Mean field plus principal components times a perceptron of the latents, `kind = "closure"`.

    Parameters
    ----------
    n_components : int
        Principal components of the training split that the perceptron combines; at least as many as latents.
    hidden : tuple of int
        Widths of the decoder's hidden layers.
    encoder_hidden : tuple of int
        Widths of the encoder's.
    activation : {"elu", "silu"}
        After every hidden layer.
    """

    kind: ClassVar[str] = "closure"
    LOSSES: ClassVar[tuple[str, ...]] = ("rms", "squared")

    batch: int = 256
    rise: float = 0.1
    loss: str = "rms"
    kl_weight: float = 1e-4
    n_components: int = 200
    hidden: tuple[int, ...] = (512, 512, 512)
    encoder_hidden: tuple[int, ...] = (512, 512, 512)
    activation: str = "silu"

    def rules(self) -> tuple[tuple[bool, str, str], ...]:
        """Return what must hold: (holds, key, sentence)."""
        return (
            *super().rules(),
            (self.n_components >= self.n_latent, "n_components", f"at least n_latent, {self.n_latent}"),
            (_widths(self.hidden), "hidden", "positive whole numbers"),
            (_widths(self.encoder_hidden), "encoder_hidden", "positive whole numbers"),
            (self.activation in ACTIVATIONS, "activation", f"one of {', '.join(ACTIVATIONS)}"),
        )


@dataclass(frozen=True, kw_only=True)
class GraphClosureSettings(ClosureSettings):
    """A closure and a graph network that adds what its components leave out, `kind = "graph-closure"`.

    Parameters
    ----------
    channels : tuple of int
        Channels a level of the graph network, finest first; as many strided convolutions as entries.
    n_bases : int
        Basis matrices a convolution, M.
    coarse_edges : {"wide", "reduced"}
        As for the graph network.
    """

    kind: ClassVar[str] = "graph-closure"
    LOSSES: ClassVar[tuple[str, ...]] = ("distance", "rms", "squared")

    batch: int = 64
    loss: str = "distance"
    n_components: int = 96
    hidden: tuple[int, ...] = (256, 256, 256)
    encoder_hidden: tuple[int, ...] = (256, 256)
    channels: tuple[int, ...] = (16, 32, 64)
    n_bases: int = 8
    coarse_edges: str = "reduced"

    def rules(self) -> tuple[tuple[bool, str, str], ...]:
        """Return what must hold: (holds, key, sentence)."""
        return (*super().rules(), *_graph_rules(self))


#: By the name in a recipe.
SETTINGS: dict[str, type[TrainSettings]] = {
    each.kind: each for each in (GraphSettings, ClosureSettings, GraphClosureSettings)
}


def _graph_rules(settings: GraphSettings | GraphClosureSettings) -> tuple[tuple[bool, str, str], ...]:
    return (
        (_widths(settings.channels), "channels", "positive whole numbers"),
        (settings.n_bases >= 1, "n_bases", "at least 1"),
        (settings.coarse_edges in COARSE_HOPS, "coarse_edges", f"one of {', '.join(COARSE_HOPS)}"),
    )


def _widths(values: tuple[int, ...]) -> bool:
    return len(values) >= 1 and min(values) >= 1
