"""``[[effect]]`` tables: what every id takes, and how each fault is named."""

import numpy as np
import pytest

import tissuereg as tr
from support.files import EXPERIMENT, write_experiment
from tissuereg._base.fields import unit_of
from tissuereg.errors import ExperimentError
from tissuereg.experiment.effects import EFFECTS, Inclusion, MarkerSwap, effect_from_table

#: One good table an id; more where keys exclude each other.
GOOD = {
    "stiffness": ["young_kpa = 12.0"],
    "poisson": ["poisson = 0.3"],
    "stiffening": [
        'law = "yeoh"\nc2_over_c1 = 0.5\nc3_over_c1 = 0.1',
        'law = "fung"\nb = 2.0',
        'law = "veronda-westmann"\nb = 2.0',
    ],
    "mooney": ['law = "mooney-rivlin"\nshare = 0.3'],
    "asymmetry": ['law = "ogden"\nalpha = [-4.0, 2.0]\nweight = [0.5, 0.5]'],
    "fibre": ["k1_over_mu = 0.5\nk2 = 1.0\ndirection = [1, 0, 1]\ntension_only = false"],
    "inclusion": ["centre_mm = [15, 10, 20]\nsemi_axes_mm = [4, 5, 6]\ncontrast = 3.0"],
    "layer": ["thickness_mm = 2.0\ncontrast = 0.5"],
    "relaxation": ['g = [0.2, 0.1]\ntau_s = [1.0, 10.0]\npart = "isochoric"', "g = [0.38]\ntau_s = [1.4]"],
    "rate": ["viscosity_kpa_s = 0.4"],
    "softening": ["r = 1.5\nm_kpa = 0.1\nbeta = 0.2", 'r = 1.5\nm_kpa = 0.1\nform = "damage"'],
    "set": ["fraction = 0.1"],
    "swelling": ["linear_strain = -0.01\nfrom_time_s = 0.0\nto_time_s = 60.0"],
    "drainage": ["share = 0.3\ntau_s = 5.0"],
    "gravity": ["direction = [0, 0.1, -1]", "direction = [0, 0, -1]\ng_mm_per_s2 = 9000.0\nin_reference = false"],
    "reference": ["direction = [0, 0, -1]\nin_reference = true"],
    "sliding": ['boundary = "base"\nspring_kpa_per_mm = 2.0', 'boundary = "base"\nfriction = 0.3\ncohesion_kpa = 0.2'],
    "detachment": [
        'boundary = "base"\ncentre_mm = [0, 0, 0]\nradius_mm = 12.0',
        'boundary = "base"\nazimuth_deg = 90.0\nshare = 0.2',
    ],
    "actuator_gain": ['actuator = "push"\ngain = 1.05'],
    "actuator_direction": ['actuator = "push"\nrotation_deg = [0, 0, 3]'],
    "actuator_offset": ['actuator = "push"\noffset_mm = [0, 0.5, 0]', 'actuator = "push"\nshift_mm = [0, 5, -5]'],
    "frame": ["rotation_deg = [0, 0, 0.5]\nshift_mm = [0.1, 0, 0]", "shift_mm = [0.1, 0, 0]"],
    "scale": ["scale = 1.01\norigin_mm = [15, 10, 20]", "scale = 1.01"],
    "latency": ["latency_s = 0.1"],
    "marker_slip": ['marker = "P1"\noffset_mm = [1, 0, 0]\nfrom_time_s = 10.5'],
    "marker_swap": ['markers = ["P1", "P2"]\nfrom_time_s = 10.5'],
}
EACH = [(identity, keys) for identity, several in GOOD.items() for keys in several]


def tables(*effects: tuple[str, str]) -> str:
    """Return an experiment file with effects behind it."""
    return EXPERIMENT + "".join(f'[[effect]]\nid = "{identity}"\n{keys}\n' for identity, keys in effects)


def read(folder, *effects):
    return tr.read_experiment(write_experiment(folder / "rig", toml=tables(*effects)))


def test_every_effect_is_public():
    assert {type_.__name__ for type_ in EFFECTS.values()} <= set(tr.effects.__all__)


def test_every_id_of_the_catalogue_has_a_good_table_here():
    assert list(GOOD) == list(EFFECTS)


@pytest.mark.parametrize(("identity", "keys"), EACH)
def test_every_id_is_read_with_its_keys(tmp_path, identity, keys):
    (effect,) = read(tmp_path, (identity, keys)).effects
    assert type(effect) is EFFECTS[identity]
    assert effect.id == identity
    written = [line.split(" = ")[0] for line in keys.splitlines()]
    assert set(written) <= set(effect.table())
    assert effect_from_table(effect.table()) == effect


@pytest.mark.parametrize(("identity", "keys"), EACH)
def test_a_missing_or_an_unknown_key_is_refused_by_name_and_table(tmp_path, identity, keys):
    lines = keys.splitlines()
    with pytest.raises(ExperimentError, match=r"only the keys .*got 'colour' in \[\[effect\]\] number 2 of .*toml"):
        read(tmp_path, ("stiffness", "young_kpa = 9.0"), (identity, keys + "\ncolour = 1"))
    for left_out in range(len(lines)):
        rest = "\n".join(line for i, line in enumerate(lines) if i != left_out)
        key = lines[left_out].split(" = ")[0]
        if (identity, rest) in EACH or key in OPTIONAL.get(identity, ()):
            continue
        with pytest.raises(ExperimentError, match=rf"`{key}`.* in \[\[effect\]\] number 1"):
            read(tmp_path, (identity, rest))


OPTIONAL = {
    "fibre": ("tension_only",),
    "relaxation": ("part",),
    "softening": ("beta", "form"),
    "sliding": ("cohesion_kpa",),
    "gravity": ("g_mm_per_s2", "in_reference"),
    "frame": ("rotation_deg", "shift_mm"),
    "scale": ("origin_mm",),
}

BAD = {
    "unknown id": ("magic", "", "`id` must be one of stiffness, poisson.*got 'magic'"),
    "nuisance": ("drift", "", "must be a cause.*got 'drift'"),
    "negative modulus": (
        "stiffness",
        "young_kpa = -1.0",
        "`young_kpa` must be a finite number greater than 0, got -1.0",
    ),
    "modulus as a text": ("stiffness", 'young_kpa = "soft"', "`young_kpa` must be a finite number.*got 'soft'"),
    "incompressible": ("poisson", "poisson = 0.5", "greater than -1 and less than 0.5, got 0.5"),
    "unknown law": ("stiffening", 'law = "jelly"', "`law` must be one of neo-hookean, .*got 'jelly'"),
    "another law's shape": ("stiffening", 'law = "fung"\nb = 1.0\nshare = 0.1', "`share` must be left out .*'fung'"),
    "shape missing": ("stiffening", 'law = "fung"', "`b` must be given with the law 'fung'"),
    "ogden of two lengths": (
        "asymmetry",
        'law = "ogden"\nalpha = [2.0]\nweight = [0.5, 0.5]',
        r"one length, got \[1, 2\]",
    ),
    "a bimodular law softer than nothing": ("asymmetry", 'law = "bimodular"\nexcess = -1.0', "excess"),
    "no such form of a law": ("mooney", 'law = "mooney-rivlin"\nshare = 0.1\nvolumetric = "mixed"', "volumetric"),
    "ogden of four terms": ("asymmetry", 'law = "ogden"\nalpha = [1, 2, 3, 4]\nweight = [1, 1, 1, 1]', "alpha"),
    "fibre without direction": (
        "fibre",
        "k1_over_mu = 1.0\nk2 = 1.0\ndirection = [0, 0, 0]",
        "`direction` must have a length",
    ),
    "flag as a number": (
        "fibre",
        "k1_over_mu = 1.0\nk2 = 1.0\ndirection = [1, 0, 0]\ntension_only = 1",
        "`tension_only` must be true or false, got 1",
    ),
    "centre of two numbers": (
        "inclusion",
        "centre_mm = [1, 2]\nsemi_axes_mm = [1, 1, 1]\ncontrast = 2.0",
        r"`centre_mm` must be a list of 3 finite numbers, got \[1, 2\]",
    ),
    "flat inclusion": (
        "inclusion",
        "centre_mm = [1, 2, 3]\nsemi_axes_mm = [1, 1, 0]\ncontrast = 2.0",
        "`semi_axes_mm` must be a list of 3 finite numbers greater than 0",
    ),
    "contrast zero": (
        "layer",
        "thickness_mm = 1.0\ncontrast = 0.0",
        "`contrast` must be a finite number greater than 0",
    ),
    "not finite": ("layer", "thickness_mm = inf\ncontrast = 2.0", "`thickness_mm` must be a finite number"),
    "relaxes wholly": ("relaxation", "g = [0.6, 0.4]\ntau_s = [1.0, 2.0]", r"sum of `g` must be less than 1"),
    "g and tau differ": ("relaxation", "g = [0.6]\ntau_s = [1.0, 2.0]", r"one length, got \[1, 2\]"),
    "no term": ("relaxation", "g = []\ntau_s = []", "`g` must be a list of one or more finite numbers"),
    "unknown part": ("relaxation", 'g = [0.1]\ntau_s = [1.0]\npart = "half"', "`part` must be one of whole, isochoric"),
    "beta of damage": ("softening", 'r = 2.0\nm_kpa = 1.0\nbeta = 0.1\nform = "damage"', "`beta` must be 0 for damage"),
    "r below one": ("softening", "r = 0.9\nm_kpa = 1.0", "`r` must be a finite number at least 1"),
    "all stays": ("set", "fraction = 1.0", "greater than 0 and less than 1"),
    "ends before it begins": ("swelling", "linear_strain = 0.1\nfrom_time_s = 5.0\nto_time_s = 5.0", "must lie after"),
    "drains wholly": (
        "drainage",
        "share = 1.0\ntau_s = 1.0",
        "`share` must be a finite number greater than 0 and less than 1",
    ),
    "gravity says nothing": ("gravity", "", "one of `direction`, `g_mm_per_s2`, `in_reference` must be given"),
    "weight without direction": ("reference", "in_reference = true", "`direction` must be given where"),
    "unknown boundary": ("sliding", 'boundary = "wall"\nfriction = 0.1', "`boundary` must be one of base, got 'wall'"),
    "a cohesion of springs": (
        "sliding",
        'boundary = "base"\nspring_kpa_per_mm = 1.0\ncohesion_kpa = 1.0',
        "`cohesion_kpa` must come with `friction`",
    ),
    "spring and friction": (
        "sliding",
        'boundary = "base"\nfriction = 0.1\nspring_kpa_per_mm = 1.0',
        "either `spring_kpa_per_mm` or `friction` must be given, got 'spring_kpa_per_mm, friction'",
    ),
    "neither ball nor rim": (
        "detachment",
        'boundary = "base"\ncentre_mm = [0, 0, 0]\nshare = 0.1',
        "either `centre_mm` and `radius_mm` or `azimuth_deg` and `share` must be given",
    ),
    "ball off the boundary": (
        "detachment",
        'boundary = "base"\ncentre_mm = [0, 0, 40]\nradius_mm = 5.0',
        "the region must hold a node of boundary 'base', which has 20",
    ),
    "nothing left to hold": (
        "detachment",
        'boundary = "base"\ncentre_mm = [0, 0, 0]\nradius_mm = 500.0',
        "must leave a part of 'base', the one boundary, it frees all 20",
    ),
    "unknown actuator": (
        "actuator_gain",
        'actuator = "pull"\ngain = 1.0',
        "`actuator` must be one of push, got 'pull'",
    ),
    "offset and shift": (
        "actuator_offset",
        'actuator = "push"\noffset_mm = [0, 0, 0]\nshift_mm = [0, 0, 0]',
        "either `offset_mm` or `shift_mm` must be given",
    ),
    "patch off the body": (
        "actuator_offset",
        'actuator = "push"\nshift_mm = [90, 0, 0]',
        r"leave the patch of 'push' on the body, got \[90.0, 0.0, 0.0\]",
    ),
    "unknown marker": (
        "marker_slip",
        'marker = "P9"\noffset_mm = [1, 0, 0]\nfrom_time_s = 0.0',
        "`marker` must be among P1, P2, got 'P9'",
    ),
    "swap with itself": ("marker_swap", 'markers = ["P1", "P1"]\nfrom_time_s = 0.0', "a list of 2 different texts"),
    "swap with a stranger": (
        "marker_swap",
        'markers = ["P1", "P9"]\nfrom_time_s = 0.0',
        "`markers` must be among P1, P2",
    ),
    "scale of zero": ("scale", "scale = 0.0", "`scale` must be a finite number greater than 0"),
}


@pytest.mark.parametrize(("identity", "keys", "words"), BAD.values(), ids=BAD)
def test_a_faulty_table_is_refused_by_number_key_and_file(tmp_path, identity, keys, words):
    with pytest.raises(ExperimentError, match=rf"{words}.* in \[\[effect\]\] number 2.* of .*experiment\.toml"):
        read(tmp_path, ("latency", "latency_s = 0.1"), (identity, keys))


def test_an_effect_without_id_is_refused(tmp_path):
    with pytest.raises(ExperimentError, match=r"`id` must be given in \[\[effect\]\] number 1"):
        tr.read_experiment(write_experiment(tmp_path / "rig", toml=EXPERIMENT + "[[effect]]\nyoung_kpa = 1.0\n"))


def test_only_effects_with_a_place_of_their_own_may_be_repeated(tmp_path):
    ball = GOOD["inclusion"][0]
    assert len(read(tmp_path, ("inclusion", ball), ("inclusion", ball)).effects) == 2
    with pytest.raises(ExperimentError, match=r"one effect 'scale' at most in \[\[effect\]\] number 2 \('scale'\)"):
        read(tmp_path, ("scale", "scale = 1.01"), ("scale", "scale = 1.01"))
    with pytest.raises(ExperimentError, match=r"one other law at most.* number 2 \('mooney'\)"):
        read(tmp_path, ("stiffening", GOOD["stiffening"][1]), ("mooney", GOOD["mooney"][0]))


def test_a_motion_offset_wants_a_displacement_actuator(tmp_path):
    toml = tables(("actuator_offset", GOOD["actuator_offset"][0])).replace('kind = "displacement"', 'kind = "force"')
    applied = "case,time_s,actuator,x_mN,y_mN,z_mN\nlean,10,push,0,0,0\nlean,11,push,50,0,0\n"
    folder = write_experiment(tmp_path / "rig", toml=toml, actuators=None, forces_applied=applied)
    with pytest.raises(ExperimentError, match="must belong to a displacement actuator, got 'force actuator'"):
        tr.read_experiment(folder)


def test_effects_made_in_python_obey_the_same_checks():
    ball = Inclusion(centre_mm=np.array([1, 2, 3]), semi_axes_mm=(4, 4, 4), contrast=2)
    assert ball == Inclusion(centre_mm=(1.0, 2.0, 3.0), semi_axes_mm=[4.0, 4.0, 4.0], contrast=np.float64(2.0))
    assert ball.table() == {
        "id": "inclusion",
        "centre_mm": [1.0, 2.0, 3.0],
        "semi_axes_mm": [4.0, 4.0, 4.0],
        "contrast": 2.0,
    }
    with pytest.raises(ExperimentError, match="`contrast` must be a finite number greater than 0, got -1"):
        Inclusion(centre_mm=(1, 2, 3), semi_axes_mm=(4, 4, 4), contrast=-1)
    with pytest.raises(ExperimentError, match="2 different texts"):
        MarkerSwap(markers=("P1", "P2", "P3"), from_time_s=0.0)


def test_a_unit_is_that_of_the_whole_ending():
    assert [unit_of(name) for name in ("slope_per_mm", "k_kpa_per_mm", "g_mm_per_s2", "r_mm", "share")] == [
        "1/mm", "kPa/mm", "mm/s^2", "mm", "",
    ]  # fmt: skip
