"""What fitting, measuring and exporting expect of a network, whatever its kind."""

from abc import ABC, abstractmethod
from typing import Any, ClassVar

import torch
from torch import nn


class Network(nn.Module, ABC):
    """A variational autoencoder of displacement fields.

    Encoder and decoder work on `x`, a form of the field in which the reconstruction error is measured, in units of a
    scale: the normalised field itself, or coefficients of it. `normalised` and `in_mm` lead there and back. Mean field
    and scale are those of the training split, one fixed frame for all: no shape is ever centred on itself. They belong
    to the model (buffers) and travel into the exported files.

    Attributes
    ----------
    kind : str
        As model cards name it.
    n_nodes, n_latent : int
        Sizes.
    mean_mm : Tensor of float, shape (n_nodes, 3)
        Mean field.
    scale_mm : Tensor of float, shape ()
        Root mean square of a component of the displacement about the mean field.
    log_variance_head : Linear
        Last layer of the encoder's log-variances; nothing else depends on it.
    """

    kind: ClassVar[str]
    n_nodes: int
    n_latent: int
    mean_mm: torch.Tensor
    scale_mm: torch.Tensor
    log_variance_head: nn.Linear

    @abstractmethod
    def normalised(self, displacement: torch.Tensor) -> torch.Tensor:
        """Return `x` (batch, ...), dimensionless, of fields (batch, n_nodes, 3) in mm."""

    @abstractmethod
    def in_mm(self, x: torch.Tensor) -> torch.Tensor:
        """Return fields (batch, n_nodes, 3) in mm of `x`."""

    @abstractmethod
    def encode(self, x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return mean and log-variance of q(z | x), each (batch, n_latent)."""

    @abstractmethod
    def decode(self, z: torch.Tensor) -> torch.Tensor:
        """Return `x` of latents (batch, n_latent)."""

    @abstractmethod
    def facts(self) -> dict[str, Any]:
        """Return the sizes that the model card states besides nodes and latents."""

    def finish(self) -> None:
        """Bring trained weights into the precision in which they are stored; called before errors are measured."""

    @property
    def device(self) -> torch.device:
        """Where the network computes."""
        return self.scale_mm.device


def sampled_latents(mean: torch.Tensor, log_variance: torch.Tensor, noise: torch.Tensor) -> torch.Tensor:
    """Return draws of q: mean + standard deviation * noise, all of shape (batch, n_latent)."""
    return mean + torch.exp(0.5 * log_variance) * noise
