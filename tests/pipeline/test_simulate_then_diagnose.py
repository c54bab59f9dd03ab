"""What a new user tries first: a rig is simulated here, with the noise that it states, and diagnosed."""

from dataclasses import replace

import numpy as np
import pytest

import tissuereg as tr
from support.files import run_json
from support.meshes import block
from tissuereg.effects import Swelling

UP_AND_DOWN = np.concatenate([np.linspace(0.0, 1.0, 4), np.ones(4), np.linspace(1.0, 0.0, 4)])

TOML = """\
name = "pushed block"
[mesh]
file = "mesh.vtu"
[material]
young_kpa = [10.0, 3.0]
poisson = 0.42
[forces]
std_mN = 5.0
[markers]
std_mm = 0.05
rest_case = "rest"
[markers.reference]
{markers}
[[boundary]]
name = "base"
nodes = "fixed"
kind = "fixed"
{pads}
"""


def write_rig(folder, pads):
    """Write a block of 180 nodes with pads on top and at a side, given by balls or by node sets, nothing measured."""
    mesh = block((40.0, 30.0, 30.0), (5, 5, 4))
    places = {"top": (16.0, 12.0, 30.0), "side": (40.0, 18.0, 22.5)}
    motions = {"top": (0.5, 0.0, -3.5), "side": (-3.0, 0.0, 0.5)}
    tables = []
    for name, centre in places.items():
        mesh = mesh.with_node_set(f"{name}_set", mesh.surface_nodes_within(centre, 8.5))
        rule = f"{{ centre_mm = {list(centre)}, radius_mm = 8.5 }}" if pads == "balls" else f'"{name}_set"'
        tables.append(f'[[actuator]]\nname = "{name}"\nnodes = {rule}\nkind = "displacement"')
    free = np.setdiff1d(mesh.surface_nodes, np.concatenate([*mesh.node_sets.values()]))
    markers = mesh.nodes[np.random.default_rng(2).choice(free[mesh.nodes[free, 2] > 5.0], 10, replace=False)]
    lines = "\n".join(f"P{number} = {place.tolist()}" for number, place in enumerate(markers))
    folder.mkdir()
    tr.io.write_vtu(folder / "mesh.vtu", mesh)
    (folder / "experiment.toml").write_text(TOML.format(markers=lines, pads="\n".join(tables)))
    seen = ["case,time_s,marker,x_mm,y_mm,z_mm", *(f"rest,{0.5 * frame},P0,,," for frame in range(10))]
    moved, felt = ["case,time_s,actuator,x_mm,y_mm,z_mm"], ["case,time_s,actuator,x_mN,y_mN,z_mN"]
    for case, (name, motion) in enumerate(motions.items(), start=1):
        for frame, share in enumerate(UP_AND_DOWN):
            head = f"{name},{20.0 * case + 0.5 * frame},{name}"
            moved.append(",".join([head, *map(str, share * np.array(motion))]))
            felt.append(f"{head},,,")
            seen.append(f"{name},{20.0 * case + 0.5 * frame},P0,,,")
    for table, rows in (("markers", seen), ("actuators", moved), ("forces", felt)):
        (folder / f"{table}.csv").write_text("\n".join(rows) + "\n")
    return folder


@pytest.mark.parametrize(("pads", "words"), [("balls", []), ("sets", []), ("balls", ["--plain"])])
def test_what_is_simulated_here_without_an_effect_is_consistent(pads, words, tmp_path, capsys):
    rig = write_rig(tmp_path / "rig", pads)
    made = tmp_path / "made"
    code, _, _ = run_json(capsys, "simulate", rig, *words, "--noise", "--seed", 1, "--out", made, "--quiet")
    assert code == 0
    code, said, _ = run_json(capsys, "diagnose", made, "--no-cache", "--quiet")
    assert code == 0
    assert (said["verdict"], said["causes"], said["left"]) == ("consistent", [], None)


def test_a_simulation_without_noise_is_consistent_too(tmp_path, capsys):
    rig = write_rig(tmp_path / "rig", "sets")
    run_json(capsys, "simulate", rig, "--out", tmp_path / "made", "--quiet")
    code, said, _ = run_json(capsys, "diagnose", tmp_path / "made", "--no-cache", "--quiet")
    assert code == 0
    assert said["verdict"] == "consistent"


def test_a_plain_simulation_is_compared_with_its_own_mesh_and_not_with_a_fine_one(tmp_path, capsys):
    rig = write_rig(tmp_path / "rig", "balls")
    made = tmp_path / "made"
    run_json(capsys, "simulate", rig, "--plain", "--noise", "--seed", 1, "--out", made, "--quiet")
    given = tr.read_experiment(made)
    own = tr.diagnose(given, keep=False)
    assert own.verdict == "consistent"
    assert not any(name.startswith(("size", "tilt", "mesh")) for name in own.details["nuisances"].names)
    assert own.discrepancy["in_sigma"] == pytest.approx(1.0, abs=0.1)


def test_a_swelling_that_pads_follow_is_named_alone(tmp_path, capsys):
    rig = write_rig(tmp_path / "rig", "balls")
    believed = tr.read_experiment(rig)
    grows = Swelling(linear_strain=0.02, from_time_s=0.0, to_time_s=46.0, pads="follow")
    tr.write_experiment(replace(believed, effects=(grows,)), rig / "grows.toml")
    made = tmp_path / "made"
    run_json(capsys, "simulate", rig / "grows.toml", "--noise", "--out", made, "--quiet")
    told = tr.diagnose(replace(tr.read_experiment(made), effects=()), keep=False)
    (finding,) = told.findings
    assert (told.verdict, finding.id, finding.parameters["pads"]) == ("named", "swelling", "follow")
    assert finding.parameters["linear_strain"] == pytest.approx(0.02, rel=0.1)


def test_what_a_named_cause_does_not_explain_is_said(tmp_path, capsys, monkeypatch):
    rig = write_rig(tmp_path / "rig", "sets")
    made = tmp_path / "made"
    run_json(capsys, "simulate", rig, "--plain", "--noise", "--out", made, "--quiet")
    given = tr.read_experiment(made)
    places = {name: case.markers.copy() for name, case in given.cases.items()}
    # One marker slips far; another one jumps in a single frame, which is no cause of the catalogue.
    for case in places.values():
        case[:, 2] += [0.0, 1.2, 0.9]
    places["side"][5, 7] += [0.9, 0.0, 0.0]
    cases = {name: replace(case, markers=places[name]) for name, case in given.cases.items()}
    told = tr.diagnose(replace(given, cases=cases), keep=False)
    assert (told.verdict, [finding.id for finding in told.findings]) == ("named", ["marker_slip"])
    assert told.findings[0].parameters["marker"] == "P2"
    assert told.left["p"] == told.p_misfit < 0.01
    assert told.left["where"][0] == "P7"
    assert f"{cases['side'].times[5]:.4g} s" in told.left["when"]
    assert told.to_json()["left"] == told.left
