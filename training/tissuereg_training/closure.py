r"""Mean field, principal components, and a perceptron of the latents that combines them.

    encoder   mean (q) = S_e c + perceptron(c), log-variance (q) from its last hidden layer    c = coefficients (K)
    decoder   y (K) = S_d z + perceptron(z),    displacement = mean field + components y

K is much larger than q: the perceptron knows which of the K coefficients go together, a linear model with q components
has to leave the others out. That linear model is where training starts: S_e and S_d lead from the first q coefficients
to latents of unit spread and back, and both perceptrons start small.

Components are orthogonal and all are divided by one scale, so that the squared distance of two fields is that of their
coefficients (what lies outside of the components is the same for every y).
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, ClassVar

import torch
from torch import nn

from tissuereg_training.digits import COMPONENTS_MM, WEIGHT_STEP, rounded, rounded_rows
from tissuereg_training.network import Network
from tissuereg_training.pca import Moments

#: Log-variance of every latent at the start.
_FIRST_LOG_VARIANCE = -6.0
#: Share of torch's usual start that the perceptrons' last layers have.
SMALL = 0.1

#: By the name in a recipe.
ACTIVATIONS: dict[str, type[nn.Module]] = {"elu": nn.ELU, "silu": nn.SiLU}


class Closure(Network):
    """The network, encoder and decoder.

    Parameters
    ----------
    n_nodes, n_components, n_latent : int
        Sizes.
    hidden, encoder_hidden : sequence of int
        Widths of the hidden layers of decoder and encoder.
    activation : {"elu", "silu"}
        After every hidden layer.
    """

    kind: ClassVar[str] = "closure"

    def __init__(
        self,
        n_nodes: int,
        n_components: int,
        n_latent: int,
        hidden: Sequence[int],
        encoder_hidden: Sequence[int],
        activation: str,
    ) -> None:
        super().__init__()
        self.n_nodes, self.n_components, self.n_latent = n_nodes, n_components, n_latent
        self.activation = activation
        self.encoder = perceptron((n_components, *encoder_hidden), activation, ends_linear=False)
        self.encoder_skip = nn.Linear(n_components, n_latent, bias=False)
        self.mean_head = nn.Linear(encoder_hidden[-1], n_latent)
        self.log_variance_head = nn.Linear(encoder_hidden[-1], n_latent)
        self.decoder = perceptron((n_latent, *hidden, n_components), activation, ends_linear=True)
        self.decoder_skip = nn.Linear(n_latent, n_components, bias=False)
        with torch.no_grad():
            self.log_variance_head.weight.zero_()
            self.log_variance_head.bias.fill_(_FIRST_LOG_VARIANCE)
            for last in (self.mean_head, self.decoder_layers()[-1]):
                last.weight.mul_(SMALL)
                last.bias.zero_()
        self.components_mm: torch.Tensor
        self.coefficient_scale_mm: torch.Tensor
        self.register_buffer("mean_mm", torch.zeros(n_nodes, 3))
        self.register_buffer("scale_mm", torch.ones(()))
        self.register_buffer("components_mm", torch.zeros(n_components, n_nodes, 3))
        self.register_buffer("coefficient_scale_mm", torch.ones(()))

    @torch.no_grad()
    def set_components(self, about: Moments, components: torch.Tensor, std: torch.Tensor) -> None:
        """Take over what was measured on the training split, and start the linear part there.

        Parameters
        ----------
        about : Moments
            Mean field and scale.
        components : Tensor of float, shape (n_components, n_nodes, 3)
            Orthonormal principal components. Kept rounded, as they are stored (`digits`).
        std : Tensor of float, shape (n_components,)
            Standard deviation of the fields' coefficients, mm.
        """
        self.mean_mm.copy_(torch.from_numpy(about.mean))
        self.scale_mm.fill_(about.scale)
        # Coefficients in this unit have mean square one over all components, as normalised fields over all nodes.
        unit = about.scale * (3 * self.n_nodes / self.n_components) ** 0.5
        self.coefficient_scale_mm.fill_(unit)
        share = COMPONENTS_MM * (4.0 / self.n_components) ** 0.5  # of each coordinate; a step's variance is a twelfth
        self.components_mm.copy_(rounded(unit * components, share * unit / std.clamp_min(1e-30)))
        spread = (std[: self.n_latent] / unit).float()
        self.encoder_skip.weight.zero_()
        self.decoder_skip.weight.zero_()
        self.encoder_skip.weight.diagonal().copy_(1.0 / spread)
        self.decoder_skip.weight.diagonal().copy_(spread)

    def normalised(self, displacement: torch.Tensor) -> torch.Tensor:
        """Return coefficients (batch, n_components), dimensionless, of fields (batch, n_nodes, 3) in mm."""
        flat = (displacement - self.mean_mm).flatten(1)
        return flat @ self.components_mm.flatten(1).t() / self.coefficient_scale_mm.square()

    def in_mm(self, x: torch.Tensor) -> torch.Tensor:
        """Return fields (batch, n_nodes, 3) in mm of coefficients."""
        return (x @ self.components_mm.flatten(1)).view(-1, self.n_nodes, 3) + self.mean_mm

    def encode(self, x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return mean and log-variance of q(z | x), each (batch, n_latent), of coefficients (batch, n_components)."""
        h = self.encoder(x)
        return self.encoder_skip(x) + self.mean_head(h), self.log_variance_head(h)

    def decode(self, z: torch.Tensor) -> torch.Tensor:
        """Return coefficients (batch, n_components) of latents (batch, n_latent)."""
        x: torch.Tensor = self.decoder_skip(z) + self.decoder(z)
        return x

    def encoder_layers(self) -> list[nn.Linear]:
        """Return the encoder's hidden layers, in order."""
        return [layer for layer in self.encoder if isinstance(layer, nn.Linear)]

    def decoder_layers(self) -> list[nn.Linear]:
        """Return the decoder's layers, in order; the last is linear."""
        return [layer for layer in self.decoder if isinstance(layer, nn.Linear)]

    def facts(self) -> dict[str, Any]:
        """Return sizes and activation."""
        return {
            "n_components": self.n_components,
            "hidden": [layer.out_features for layer in self.decoder_layers()[:-1]],
            "encoder_hidden": [layer.out_features for layer in self.encoder_layers()],
            "activation": self.activation,
        }

    @torch.no_grad()
    def finish(self) -> None:
        """Round the weights, as they are stored."""
        for parameter in self.parameters():
            parameter.copy_(rounded_rows(parameter, WEIGHT_STEP) if parameter.ndim > 1 else parameter.half())


def perceptron(widths: Sequence[int], activation: str, *, ends_linear: bool) -> nn.Sequential:
    """Return fully connected layers.

    Parameters
    ----------
    widths : sequence of int
        Of input, hidden layers and output.
    activation : {"elu", "silu"}
        After every layer.
    ends_linear : bool
        Leave it out after the last.

    Returns
    -------
    Sequential
        Linear layers and activations in turn.
    """
    layers: list[nn.Module] = []
    for n_in, n_out in pairwise(widths):
        layers += [nn.Linear(n_in, n_out), ACTIVATIONS[activation]()]
    return nn.Sequential(*(layers[:-1] if ends_linear else layers))
