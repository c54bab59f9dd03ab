from collections.abc import Callable, Sequence
from typing import Any, Final, Literal, final

import numpy as np
from numpy.typing import NDArray

_Floats = NDArray[np.float64]
_Integers = NDArray[np.int64]
_Singles = NDArray[np.float32]
_Bytes = NDArray[np.uint8]
_Element = Literal["tet4", "tet4-averaged", "tet10"]

__all__ = [
    "Adjoints",
    "Behaviour",
    "Body",
    "Cause",
    "Compliance",
    "Contacts",
    "GroupScores",
    "Law",
    "Linearised",
    "ManySolutions",
    "Noise",
    "Rig",
    "RigFrame",
    "Solution",
    "Step",
    "__version__",
    "check_mesh",
    "check_schedule",
    "closest_rotations",
    "laws",
    "rasterise",
    "schedule_geometric",
    "score_components",
    "screen_members",
    "surface_triangles",
    "tet_volumes",
]

__version__: Final[str]

def check_mesh(nodes: _Floats, tets: _Integers) -> None: ...
def surface_triangles(nodes: _Floats, tets: _Integers) -> _Integers: ...
def tet_volumes(nodes: _Floats, tets: _Integers) -> _Floats: ...
def closest_rotations(matrices: _Floats) -> _Floats: ...
def rasterise(
    nodes: _Floats, tets: _Integers, values: _Floats, inner: int, shape: Sequence[int], threads: int
) -> tuple[_Singles, _Bytes]: ...
def laws() -> list[tuple[str, list[tuple[str, bool, float, float]], list[list[float]]]]: ...
def schedule_geometric(n_steps: int, decrease: float) -> _Floats: ...
def check_schedule(alphas: _Floats, *, total: float = 1.0) -> _Floats: ...
def score_components(
    covariances: _Floats,
    innovations: _Floats,
    component: _Integers,
    scale: _Floats,
    noise: _Floats,
    *,
    group: int = 0,
    last: bool = False,
    threads: int = 0,
) -> tuple[_Floats, _Floats, _Floats, _Floats]: ...
def screen_members(predicted: _Floats, limit: float) -> tuple[_Integers, list[tuple[int, str]]]: ...

@final
class Adjoints:
    @property
    def young(self) -> _Floats: ...
    @property
    def poisson(self) -> _Floats: ...
    @property
    def forces(self) -> _Floats: ...
    @property
    def body_force(self) -> _Floats: ...
    @property
    def prescribed(self) -> _Floats: ...
    @property
    def springs(self) -> _Floats: ...

@final
class Behaviour:
    def __new__(
        cls,
        *,
        relaxation: tuple[list[float], list[float], str] | None = None,
        viscosity_kpa_s: float = 0.0,
        softening: tuple[str, float, float, float] | None = None,
        set: float | None = None,
        drainage: tuple[float, float] | None = None,
        swelling: tuple[float, float, float] | None = None,
    ) -> Behaviour: ...

@final
class Body:
    def __new__(
        cls,
        nodes: _Floats,
        tets: _Integers,
        held_nodes: _Integers,
        *,
        element: str = "tet4",
        springs: list[tuple[_Integers, list[float]]] = ...,
        rests: bool = False,
    ) -> Body: ...
    def __getnewargs_ex__(self) -> tuple[tuple[_Floats, _Integers, _Integers], dict[str, Any]]: ...
    @property
    def nodes(self) -> _Floats: ...
    @property
    def tets(self) -> _Integers: ...
    @property
    def held_nodes(self) -> _Integers: ...
    @property
    def mid_edges(self) -> _Integers: ...
    @property
    def surface_triangles(self) -> _Integers: ...
    @property
    def n_nodes(self) -> int: ...
    @property
    def n_corner_nodes(self) -> int: ...
    @property
    def n_tets(self) -> int: ...
    @property
    def n_unknowns(self) -> int: ...
    @property
    def factor_size(self) -> tuple[int, float, int]: ...
    @property
    def element(self) -> _Element: ...
    @property
    def analyse_seconds(self) -> float: ...
    @property
    def springs(self) -> list[tuple[_Integers, list[float]]]: ...
    def internal_forces(
        self,
        displacement: _Floats,
        young: _Floats,
        poisson: _Floats,
        *,
        law: Law | None = None,
        springs: _Floats | None = None,
    ) -> _Floats: ...
    def spring_forces(self, displacement: _Floats, springs: _Floats | None = None) -> _Floats: ...
    def traction_forces(self, triangles: _Integers, traction: _Floats) -> _Floats: ...
    def solve(
        self,
        young: _Floats,
        poisson: _Floats,
        *,
        law: Law | None = None,
        forces: _Floats | None = None,
        body_force: _Floats | None = None,
        prescribed: _Floats | None = None,
        springs: _Floats | None = None,
        start: _Floats | None = None,
        tolerance: float = 1e-9,
        max_iterations: int = 1000,
        method: str = "auto",
        load_steps: int = 0,
        threads: int = 0,
    ) -> Solution: ...
    def linearise(
        self,
        displacement: _Floats,
        young: _Floats,
        poisson: _Floats,
        *,
        law: Law | None = None,
        forces: _Floats | None = None,
        body_force: _Floats | None = None,
        prescribed: _Floats | None = None,
        springs: _Floats | None = None,
        precision: str = "double",
        threads: int = 0,
    ) -> Linearised: ...
    def solve_many(
        self,
        young: _Floats,
        poisson: _Floats,
        *,
        laws: Sequence[Law] | None = None,
        forces: _Floats | None = None,
        body_force: _Floats | None = None,
        prescribed: _Floats | None = None,
        springs: _Floats | None = None,
        start: _Floats | None = None,
        tolerance: float = 1e-9,
        max_iterations: int = 1000,
        method: str = "auto",
        load_steps: int = 0,
        threads: int = 0,
        progress: Callable[[int], object] | None = None,
    ) -> ManySolutions: ...

@final
class Cause:
    @staticmethod
    def parameter(name: str, term: int = 0) -> Cause: ...
    @staticmethod
    def field(name: str, rates: _Floats) -> Cause: ...
    @staticmethod
    def load(
        *, forces: _Floats | None = None, body_force: _Floats | None = None, prescribed: _Floats | None = None
    ) -> Cause: ...

@final
class Compliance:
    @property
    def forces(self) -> _Floats: ...
    @property
    def body_force(self) -> _Floats: ...
    @property
    def prescribed(self) -> _Floats: ...

@final
class Contacts:
    def __new__(
        cls,
        columns: _Floats,
        *,
        texture: tuple[_Integers, _Integers, _Floats],
        neighbours: tuple[_Integers, _Integers],
        variances: _Floats,
        log_filled: _Floats,
        log_empty: float,
        n_slots: int,
        families: Sequence[tuple[_Floats, _Floats, _Floats]],
        wrong: tuple[Sequence[Sequence[int]], float, float],
        innovation: _Floats,
        noise: _Floats,
    ) -> Contacts: ...
    def run(
        self,
        uniforms: _Floats,
        *,
        powers: Sequence[float],
        n_kept: int,
        sharpness: float,
        n_local: int,
        n_level: int,
        starts: Sequence[_Integers] | None = None,
        threads: int = 0,
    ) -> tuple[tuple[_Integers, _Integers, _Integers], _Floats, dict[str, int]]: ...
    def n_uniforms(self, n_sweeps: int, n_local: int, n_level: int) -> int: ...
    def moments(
        self, samples: Sequence[_Integers], points: _Floats, *, threads: int = 0
    ) -> tuple[_Floats, _Floats, _Floats, _Floats, _Floats, float]: ...
    def draws(self, samples: Sequence[_Integers], normals: _Floats, *, threads: int = 0) -> _Floats: ...

@final
class GroupScores:
    def __new__(
        cls, residual: _Floats, noise: _Floats, absorbed: _Floats, groups: _Integers, n_groups: int
    ) -> GroupScores: ...
    @property
    def chi_square(self) -> _Floats: ...
    @property
    def n_obs(self) -> _Integers: ...
    @property
    def p_value(self) -> _Floats: ...
    @property
    def leverage(self) -> _Floats: ...
    def wrong(self, level: float) -> list[int]: ...

@final
class Law:
    def __new__(
        cls,
        name: str,
        shape: dict[str, list[float]],
        *,
        volumetric: str = "log",
        direction: _Floats | None = None,
        k1_over_mu: float = 0.0,
        k2: float = 0.0,
        tension_only: bool = True,
    ) -> Law: ...
    def nominal_stress(
        self, mode: str, amounts: _Floats, young: float, poisson: float, *, incompressible: bool = False
    ) -> _Floats: ...
    def stress_history(
        self, mode: str, amounts: _Floats, times: _Floats, young: float, poisson: float, behaviour: Behaviour
    ) -> _Floats: ...

@final
class Linearised:
    def derivatives(self, causes: list[Cause]) -> tuple[_Floats, _Floats]: ...
    def adjoints(self, observations: list[tuple[_Integers, _Floats, _Integers, _Floats]]) -> Adjoints: ...
    def compliance(self, observations: list[tuple[_Integers, _Floats, _Integers, _Floats]]) -> Compliance: ...
    def responses(self, forces: _Floats) -> _Floats: ...
    def unbalanced(self, causes: list[Cause]) -> _Floats: ...
    def solve_near(
        self,
        *,
        forces: _Floats | None = None,
        body_force: _Floats | None = None,
        prescribed: _Floats | None = None,
        springs: _Floats | None = None,
        tolerance: float = 1e-9,
        max_iterations: int = 1000,
        threads: int | None = None,
    ) -> Solution: ...
    @property
    def report(self) -> dict[str, Any]: ...

@final
class Rig:
    def __new__(
        cls,
        body: Body,
        young: _Floats,
        poisson: _Floats,
        *,
        law: Law | None = None,
        pads: list[_Integers] = ...,
        behaviour: Behaviour | None = None,
        hangs_in: _Floats | None = None,
        tolerance: float = 1e-9,
        max_iterations: int = 1000,
        threads: int = 0,
    ) -> Rig: ...
    def advance(
        self,
        time: float,
        motions: _Floats,
        *,
        forces: _Floats | None = None,
        body_force: _Floats | None = None,
        prescribed: _Floats | None = None,
        change: _Floats | None = None,
    ) -> RigFrame: ...
    def again(
        self,
        young: _Floats,
        poisson: _Floats,
        *,
        law: Law | None = None,
        behaviour: Behaviour | None = None,
    ) -> Rig: ...
    @property
    def rest_nodes(self) -> _Floats: ...

@final
class RigFrame:
    @property
    def displacement(self) -> _Floats: ...
    @property
    def reactions(self) -> _Floats: ...
    @property
    def pad_forces(self) -> _Floats: ...
    @property
    def pad_moments(self) -> _Floats: ...
    @property
    def spring_forces(self) -> _Floats: ...
    @property
    def report(self) -> dict[str, Any]: ...

@final
class Solution:
    @property
    def displacement(self) -> _Floats: ...
    @property
    def reactions(self) -> _Floats: ...
    @property
    def report(self) -> dict[str, Any]: ...

@final
class ManySolutions:
    @property
    def displacement(self) -> _Floats: ...
    @property
    def reactions(self) -> _Floats: ...
    @property
    def failed(self) -> list[tuple[int, str]]: ...
    @property
    def reports(self) -> list[dict[str, Any]]: ...

@final
class Noise:
    @staticmethod
    def diagonal(std: _Floats) -> Noise: ...
    @staticmethod
    def dense(covariance: _Floats) -> Noise: ...
    @property
    def n_obs(self) -> int: ...

@final
class Step:
    def __new__(
        cls,
        predicted: _Floats,
        observed: _Floats,
        noise: Noise,
        draws: _Floats,
        *,
        alpha: float,
        threads: int = 0,
        factorisation: str = "auto",
    ) -> Step: ...
    @staticmethod
    def square_root(
        predicted: _Floats,
        observed: _Floats,
        noise: Noise,
        *,
        alpha: float,
        threads: int = 0,
    ) -> Step: ...
    def apply(self, parameters: _Floats) -> _Floats: ...
    @property
    def log_evidence(self) -> float | None: ...
    @property
    def n_members(self) -> int: ...
    @property
    def factorisation(self) -> str: ...
