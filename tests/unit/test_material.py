"""Materials of every law, through the solver."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

import tissuereg as tr
from tissuereg.body.laws import DECLARED, shape_of
from tissuereg.body.material import LAWS
from tissuereg.errors import MaterialError

#: Where a fit of a law begins; Ogden's begins nowhere.
SHAPES = {name: shape_of(name, *said.starts[0]) for name, said in DECLARED.items() if said.starts}
SHAPES["ogden"] = {"alpha": [4.0, -7.0], "weight": [0.75, 0.25]}


def material(law="neo-hookean", **more):
    return tr.Material(10.0, 0.4, law=law, shape=SHAPES[law], **more)


def pulled(mesh, mN):
    """A load that lifts the far face of the block."""
    top = mesh.nodes[:, 2] > 39.9
    forces = np.zeros((mesh.n_nodes, 3))
    forces[top, 2] = mN / top.sum()
    return tr.Load(forces=forces)


@pytest.mark.parametrize("law", [law for law in LAWS if law != "bimodular"])
def test_every_law_starts_alike_and_parts_at_large_strain(block_mesh, law):
    simulator = tr.Simulator(block_mesh)
    for force, alike in ((1e-3, True), (2500.0, False)):
        load = pulled(block_mesh, force)
        base = simulator.solve(load, material(), tolerance=1e-10).displacement
        own = simulator.solve(load, material(law), tolerance=1e-10).displacement
        # The first force strains the block by 1e-7, and laws differ by the strain's square.
        same = np.abs(own - base).max() < 1e-5 * np.abs(base).max()
        assert same == (alike or law == "neo-hookean")


def test_a_field_of_one_value_is_that_value(block_mesh):
    load = pulled(block_mesh, 500.0)
    for element, n_points in (("tet4", 1), ("tet10", 4)):
        simulator = tr.Simulator(block_mesh, element=element)
        base = simulator.solve(load, material("yeoh"), tolerance=1e-11).displacement
        for shape in ((block_mesh.n_tets,), (block_mesh.n_tets, 1), (block_mesh.n_tets, n_points)):
            for young, poisson in ((np.full(shape, 10.0), 0.4), (10.0, np.full(shape, 0.4))):
                field = replace(material("yeoh"), young=young, poisson=poisson)
                own = simulator.solve(load, field, tolerance=1e-11).displacement
                assert np.abs(own - base).max() < 1e-7 * np.abs(base).max()


def test_moduli_of_points_matter_one_by_one(block_mesh):
    simulator = tr.Simulator(block_mesh, element="tet10")
    load = pulled(block_mesh, 100.0)
    rng = np.random.default_rng(3)
    points = 10.0 * np.exp(rng.uniform(-1, 1, (block_mesh.n_tets, 4)))
    fine = simulator.solve(load, tr.Material(points, 0.4)).displacement
    coarse = simulator.solve(load, tr.Material(points.mean(axis=1), 0.4)).displacement
    assert 1e-3 < np.abs(fine - coarse).max() / np.abs(fine).max() < 0.5
    doubled = simulator.solve(load, tr.Material(points, 0.4).scaled(2.0), tolerance=1e-11).displacement
    each = tr.Material(points, 0.4).scaled(np.full(block_mesh.n_tets, 2.0))
    assert np.abs(simulator.solve(load, each, tolerance=1e-11).displacement - doubled).max() < 1e-8


def test_members_may_have_laws_and_fields_of_their_own(block_mesh):
    simulator = tr.Simulator(block_mesh)
    fibre = tr.Fibre(2.0, 1.0, np.tile([0.0, 0.0, 1.0], (block_mesh.n_tets, 1)))
    members = [material(law) for law in LAWS]
    members += [material(fibre=fibre), tr.Material(np.full(block_mesh.n_tets, 9.0), 0.3)]
    load = pulled(block_mesh, 300.0)
    together = simulator.solve_many([load] * len(members), members)
    assert not together.failed
    for row, member in zip(together.displacement, members, strict=True):
        alone = simulator.solve(load, member).displacement
        assert np.abs(row - alone).max() < 1e-7 * np.abs(alone).max()


def test_fibres_hold_along_themselves_only(block_mesh):
    simulator = tr.Simulator(block_mesh)
    load = pulled(block_mesh, 500.0)

    def lift(**fibre):
        stretched = simulator.solve(load, material(fibre=tr.Fibre(**fibre) if fibre else None))
        return stretched.displacement[:, 2].max()

    plain = lift()
    assert lift(k1_over_mu=5.0, k2=1.0, direction=[0, 0, 2]) < 0.8 * plain
    # Fibres across are shortened, and slack; those that bear pressure are not.
    across = lift(k1_over_mu=5.0, k2=1.0, direction=[1, 0, 0])
    assert across == pytest.approx(plain, rel=0.02)
    assert lift(k1_over_mu=5.0, k2=1.0, direction=[1, 0, 0], tension_only=False) < across


def test_a_material_survives_pickling():
    for law in LAWS:
        own = material(law, fibre=tr.Fibre(1.0, 2.0, (1, 0, 0)))
        assert pickle.loads(pickle.dumps(own)).digest() == own.digest()


def test_the_digest_sees_everything_but_density():
    base = material("yeoh", fibre=tr.Fibre())
    others = [
        replace(base, young=11.0),
        replace(base, poisson=0.41),
        replace(base, young=np.full(2, 10.0)),
        replace(base, volumetric="quadratic"),
        replace(base, fibre=None),
        replace(base, shape={"c2_over_c1": 0.3, "c3_over_c1": 0.06}),
        *(replace(base, fibre=tr.Fibre(*f)) for f in ((2.0,), (1.0, 2.0), (1, 1, (1, 0, 0)), (1, 1, (0, 0, 1), False))),
        material("fung", fibre=tr.Fibre()),
    ]
    assert len({m.digest() for m in [base, *others]}) == 1 + len(others)
    assert replace(base, density=2.0).digest() == base.digest()


BAD = {
    "shape missing": ({"law": "yeoh", "shape": {"c2_over_c1": 0.1}}, "`c3_over_c1` must be given for the law `yeoh`"),
    "shape of another law": ({"law": "fung", "shape": {"b": 1.0, "share": 0.1}}, "`fung` has no parameter `share`"),
    "shape for a law without": ({"shape": {"b": 1.0}}, "`neo-hookean` has no parameter `b`"),
    "a list for a number": ({"law": "fung", "shape": {"b": [1.0, 2.0]}}, "`b` must be one number, got 2 numbers"),
    "a text": ({"law": "fung", "shape": {"b": "stiff"}}, "`b` must be a number or a list"),
    "negative rate": ({"law": "veronda-westmann", "shape": {"b": -1.0}}, "`b` .* not negative; found -1"),
    "NaN share": ({"law": "mooney-rivlin", "shape": {"share": np.nan}}, "`share` .* finite; found NaN"),
    "no terms": ({"law": "ogden", "shape": {"alpha": [], "weight": []}}, "`alpha` .* one to three exponents"),
    "four terms": ({"law": "ogden", "shape": {"alpha": [1.0] * 4, "weight": [1.0] * 4}}, "`alpha` .* found 4"),
    "a weight short": ({"law": "ogden", "shape": {"alpha": [1.0, 2.0], "weight": [1.0]}}, "`weight` .* as long as"),
    "weights that cancel": (
        {"law": "ogden", "shape": {"alpha": [1, 2], "weight": [1, -1]}},
        "`weight` .* positive sum",
    ),
    "unknown volumetric energy": (
        {"volumetric": "cubic"},
        "`volumetric` must be `log`, `quadratic` or `coupled`, got cubic",
    ),
    "no volumetric energy": ({"law": "hooke", "volumetric": "quadratic"}, "`volumetric` .* left out"),
    "negative fibres": ({"fibre": tr.Fibre(k1_over_mu=-1.0)}, "`k1_over_mu` .* found -1"),
    "infinite fibres": ({"fibre": tr.Fibre(k2=np.inf)}, "`k2` .* found inf"),
    "fibres without direction": ({"fibre": tr.Fibre(direction=[[0, 0, 1], [0, 0, 0]])}, "`direction` .* at entry 1"),
    "a modulus of one point": ({"young": [[1.0, 2.0], [3.0, -4.0]]}, "`young` must be positive.* at tet 1"),
}


@pytest.mark.parametrize(("values", "words"), BAD.values(), ids=BAD)
def test_a_bad_parameter_is_named(values, words):
    with pytest.raises(MaterialError, match=words) as caught:
        tr.Material(**values)
    assert caught.value.where is not None


def test_fields_of_another_element_are_refused(block_mesh):
    load = pulled(block_mesh, 1.0)
    n = block_mesh.n_tets
    for element, shape in (("tet4", (n, 4)), ("tet10", (n, 3)), ("tet10", (n - 1, 4))):
        simulator = tr.Simulator(block_mesh, element=element)
        with pytest.raises(MaterialError, match="`young` must hold one value or one per tet"):
            simulator.solve(load, tr.Material(np.ones(shape)))
    with pytest.raises(tr.errors.ShapeError, match="fibre directions"):
        tr.Simulator(block_mesh).solve(load, tr.Material(fibre=tr.Fibre(direction=np.ones((n + 1, 3)))))
