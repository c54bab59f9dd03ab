"""Layer: an outer layer of the body is stiffer or softer than the core."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.causes.base import Cause, FreeParameters, Values, Variant, free_parameters
from tissuereg.experiment.effects import Layer
from tissuereg.experiment.effects.regions import OuterLayer, share_inside


@dataclass(frozen=True)
class LayerCause(Cause, id="layer", family="region"):
    """A layer of constant thickness below the free surface, with another modulus."""

    #: Thicknesses of the hypotheses, over the extent of the body.
    thicknesses: tuple[float, ...] = (0.01, 0.02, 0.04, 0.08)
    #: Prior deviation of contrast - 1.
    spread: float = 1.5

    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return one hypothesis for each of several thicknesses of the layer, linear in the contrast."""
        mesh = bench.experiment.mesh
        sizes = [share * bench.extent for share in self.thicknesses]
        if bench.is_elastic:
            shares = np.stack([share_inside(OuterLayer(mesh, size), mesh) for size in sizes], axis=1)
            columns = bench.by_fields(sparse.csr_array(shares))
        else:
            changes = bench.changes([[Layer(thickness_mm=size, contrast=1.5)] for size in sizes])
            columns = np.array([np.zeros(bench.layout.size) if c is None else 2.0 * c for c in changes])
        for size, column in zip(sizes, columns, strict=True):
            yield Variant(f"{size:.1f} mm", self.spread * column[None], {"thickness": size})

    def free_parameters(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> FreeParameters:
        """Return two free parameters: logarithms of the thickness in mm and of the modulus ratio of layer and core."""
        contrast = 1.0 + float(np.clip(self.spread * amplitudes[0], -0.85, 20.0))
        thickness = float(variant.settings["thickness"])
        return free_parameters(
            [(np.log(thickness), np.log(0.025 * bench.extent), 0.7, 0.1), (np.log(contrast), 0.0, 1.2, 0.05)],
            lambda x, young: (Layer(thickness_mm=float(np.exp(x[0])), contrast=float(np.exp(x[1]))),),
        )

    def sentence(self, values: Values) -> str:
        """Return the finding as a sentence; `values` has the fitted `thickness_mm` and modulus ratio `contrast`."""
        contrast, thickness = values["contrast"], values["thickness_mm"]
        kind = "stiffer" if contrast > 1 else "softer"
        return f"An outer layer of {thickness:.2g} mm is {kind} than the core: {contrast:.2g} times its modulus."
