from typing import Final, TypeAlias, final

import numpy as np
import numpy.typing as npt

_Floats: TypeAlias = npt.NDArray[np.float64]
_Integers: TypeAlias = npt.NDArray[np.int64]

__all__ = ["AdmmBody", "Pbd", "__version__"]

__version__: Final[str]

@final
class AdmmBody:
    def __new__(
        cls,
        nodes: _Floats,
        tets: _Integers,
        held_nodes: _Integers,
        young: _Floats,
        poisson: _Floats,
        *,
        density: float,
    ) -> AdmmBody: ...
    def step(
        self,
        dt: float,
        n_iterations: int,
        *,
        forces: _Floats | None = None,
        prescribed: _Floats | None = None,
        threads: int = 0,
    ) -> tuple[float, float]: ...
    def set_state(self, displacement: _Floats, velocity: _Floats) -> None: ...
    @property
    def displacement(self) -> _Floats: ...
    @property
    def velocity(self) -> _Floats: ...
    @property
    def masses(self) -> _Floats: ...
    @property
    def n_nodes(self) -> int: ...

@final
class Pbd:
    def __new__(
        cls,
        inverse_masses: _Floats,
        places: _Floats,
        edges: _Integers,
        edge_compliance: _Floats,
        tets: _Integers,
        tet_compliance: _Floats,
    ) -> Pbd: ...
    def set_rest(self, places: _Floats) -> None: ...
    def project(
        self,
        places: _Floats,
        particles: _Integers,
        weights: _Floats,
        observed: _Floats,
        compliance: _Floats,
        dt: float,
        n_iterations: int,
    ) -> _Floats: ...
    @property
    def n_particles(self) -> int: ...
