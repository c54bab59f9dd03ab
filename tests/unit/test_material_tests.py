"""Homogeneous material tests and laws fitted to them."""

import numpy as np
import pytest

import tissuereg as tr
from tissuereg.errors import MaterialError
from tissuereg.experiment.material_tests import MaterialTest, equibiaxial_stress, fit_law, shear_stress, uniaxial_stress

STRETCH = np.linspace(0.6, 1.8, 13)
SHAPES = {
    "neo-hookean": {},
    "mooney-rivlin": {"share": 0.3},
    "yeoh": {"c2_over_c1": -0.2, "c3_over_c1": 0.15},
    "fung": {"b": 0.8},
    "veronda-westmann": {"b": 0.6},
    "ogden": {"alpha": [-11.0], "weight": [1.0]},
}


def test_an_incompressible_bar_obeys_its_closed_form():
    material = tr.Material(3.0, 0.495)
    mu = 3.0 / (2 * 1.495)
    assert np.allclose(
        uniaxial_stress(material, STRETCH, incompressible=True), mu * (STRETCH - STRETCH**-2), rtol=1e-12
    )
    assert np.allclose(
        equibiaxial_stress(material, STRETCH, incompressible=True), mu * (STRETCH - STRETCH**-5), rtol=1e-12
    )
    assert np.allclose(shear_stress(material, [0.0, 0.5]), [0.0, mu * 0.5], rtol=1e-12)


def test_poissons_ratio_counts_where_volume_may_change():
    # Without Poisson's ratio the coupled neo-Hookean bar keeps its width: mu (l - 1/l).
    stress = uniaxial_stress(tr.Material(3.0, 0.0), STRETCH)
    assert np.allclose(stress, 1.5 * (STRETCH - 1 / STRETCH), rtol=1e-10)
    for poisson in (-0.3, 0.2, 0.4995):
        assert uniaxial_stress(tr.Material(10.0, poisson), [1 + 1e-7])[0] == pytest.approx(1e-6, rel=1e-5)
        expected = 1e-6 / (1 - poisson)
        assert equibiaxial_stress(tr.Material(10.0, poisson), [1 + 1e-7])[0] == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("law", SHAPES)
def test_a_fit_finds_the_law_that_made_the_data(law):
    truth = tr.Material(4.0, 0.495, law=law, shape=SHAPES[law])
    shear = np.linspace(-0.4, 0.4, 9)
    tests = [
        MaterialTest("tension", STRETCH, uniaxial_stress(truth, STRETCH, incompressible=True)),
        MaterialTest("equibiaxial", STRETCH, equibiaxial_stress(truth, STRETCH, incompressible=True)),
        MaterialTest("simple-shear", shear, shear_stress(truth, shear)),
    ]
    for weighting in ("mode", "plain"):
        fit = fit_law(tests, law, weighting=weighting)
        assert fit.material.young == pytest.approx(4.0, rel=1e-6)
        for key, value in SHAPES[law].items():
            assert fit.material.shape[key] == pytest.approx(value, rel=1e-4)
        assert fit.standard_error < 1e-6
        assert min(test.r_squared(fit.material) for test in tests) > 1 - 1e-10


def test_two_terms_are_found_where_two_made_the_data():
    truth = tr.Material(4.0, 0.495, law="ogden", shape={"alpha": [-6.0, 5.0], "weight": [0.7, 0.3]})
    test = MaterialTest("tension", STRETCH, uniaxial_stress(truth, STRETCH, incompressible=True))
    one, two = (fit_law([test], "ogden", terms=terms, weighting="plain") for terms in (1, 2))
    assert two.standard_error < 1e-4 < one.standard_error
    assert sorted(two.material.shape["alpha"]) == pytest.approx([-6.0, 5.0], rel=1e-3)


def test_a_compressible_fit_uses_poissons_ratio():
    truth = tr.Material(4.0, 0.3)
    test = MaterialTest("compression", STRETCH, uniaxial_stress(truth, STRETCH))
    assert fit_law([test], "neo-hookean", incompressible=False, poisson=0.3).material.young == pytest.approx(4.0)
    hooke = fit_law([test], "st-venant-kirchhoff", incompressible=False, poisson=0.3)
    assert hooke.standard_error > 0.05


def test_weights_let_small_tests_count():
    small = MaterialTest("tension", STRETCH, 0.01 * (STRETCH - STRETCH**-2))
    large = MaterialTest("compression", STRETCH, 1.0 * (STRETCH - STRETCH**-2))
    plain, by_mode = (fit_law([small, large], "neo-hookean", weighting=w).material for w in ("plain", "mode"))
    mu = [m.young / (2 * (1 + m.poisson)) for m in (plain, by_mode)]
    # Divided by their largest stress, the small test counts 100^2 times as much as the large one.
    assert mu == pytest.approx([0.505, (1e4 * 0.01 + 1) / (1e4 + 1)])


BAD = {
    "a field": (lambda: uniaxial_stress(tr.Material(np.ones(2)), [1.1]), "needs one Young's modulus"),
    "no limit": (
        lambda: uniaxial_stress(tr.Material(law="hooke"), [1.1], incompressible=True),
        "no incompressible limit",
    ),
    "unknown mode": (lambda: MaterialTest("torsion", [1.0], [0.0]), "`mode` must be one of tension"),
    "columns of two lengths": (lambda: MaterialTest("tension", [1.0, 1.1], [0.0]), "equally long.*got 2 and 1 rows"),
    "not finite": (lambda: MaterialTest("tension", [1.0], [np.nan]), "must be finite"),
    "no tests": (lambda: fit_law([], "yeoh"), "at least one test"),
    "unknown law": (lambda: fit_law([MaterialTest("tension", [1.1], [1.0])], "jelly"), "`law` must be one of"),
    "unknown weighting": (
        lambda: fit_law([MaterialTest("tension", [1.1], [1.0])], "yeoh", weighting="none"),
        "`weighting` must be mode or plain",
    ),
    "too many terms": (lambda: fit_law([MaterialTest("tension", [1.1], [1.0])], "ogden", terms=4), "1, 2 or 3"),
    "no stress at all": (lambda: fit_law([MaterialTest("tension", [1.1], [0.0])], "yeoh"), "not zero"),
    "the wrong sign": (
        lambda: fit_law([MaterialTest("tension", [1.1, 1.2], [-1.0, -2.0])], "neo-hookean"),
        "no finite stress of the sign",
    ),
}


@pytest.mark.parametrize(("made", "words"), BAD.values(), ids=BAD)
def test_what_cannot_be_tested_or_fitted_is_refused(made, words):
    with pytest.raises(MaterialError, match=words):
        made()


def test_a_stretch_that_cannot_be_has_no_stress():
    assert np.isnan(uniaxial_stress(tr.Material(), [0.0, -1.0])).all()
