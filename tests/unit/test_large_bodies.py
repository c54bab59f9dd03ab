"""How large a body is, is known before anything is factored; what does not fit is refused, and nothing is lost."""

import re
import weakref
from dataclasses import replace

import numpy as np
import pytest

import tissuereg as tr
from support.files import run, write_problem
from support.meshes import block
from tissuereg._base import machine as _machine
from tissuereg.errors import ArgumentError, LargeBodyError, LargeBodyWarning
from tissuereg.io.meshes import write_vtu
from tissuereg.io.tables import write_markers
from tissuereg.registration.contacts import fit, linear, tangent
from tissuereg.registration.contacts.body import forget_bodies
from tissuereg.registration.contacts.size import expected_work
from tissuereg.registration.contacts.tangent import Tangent, forget_rest
from tissuereg.simulation import size
from tissuereg.simulation.sensitivity import Linearised
from tissuereg.simulation.size import SOLVE, BodySize, Estimate


@pytest.fixture(scope="module")
def moved(block_mesh):
    """Markers of a block pulled at its top."""
    middles = block_mesh.nodes[block_mesh.surface].mean(axis=1)
    top = block_mesh.surface[(middles[:, 2] > 39.0) & (middles[:, 0] > 15.0)]
    truth = tr.simulate(block_mesh, tr.Load(traction=(top, (0.5, 0.1, 0.2))), tr.Material(8.0, 0.45)).displacement
    nodes = np.setdiff1d(block_mesh.surface_nodes, block_mesh.fixed_nodes)[::5]
    return tr.Markers(block_mesh.nodes[nodes], block_mesh.nodes[nodes] + truth[nodes], 0.05)


@pytest.fixture
def afresh():
    """Nothing kept from other registrations, before and after."""
    forget_bodies()
    forget_rest()
    yield
    forget_bodies()
    forget_rest()


def of(mesh, element="tet4"):
    return BodySize.of(tr.Simulator(mesh, element=element))


def told(monkeypatch, available, mesh, element="tet4"):
    """The estimate of one solve where so much memory is available."""
    monkeypatch.setattr(size, "available_bytes", lambda: available)
    return Estimate.of(of(mesh, element), SOLVE, 1)


def test_a_factor_is_between_its_matrix_and_a_dense_one(block_mesh):
    found = of(block_mesh)
    n = found.n_unknowns
    assert n == 3 * (block_mesh.n_nodes - len(block_mesh.fixed_nodes))
    pairs = {
        tuple(sorted(pair)) for tet in block_mesh.tets.tolist() for pair in zip(tet, tet[1:] + tet[:1], strict=True)
    }
    assert found.n_entries > 4.5 * len(pairs)
    assert n**2 < found.flops < n**3 / 3 + n**2


def test_ten_node_tets_are_larger(block_mesh):
    linear_one, quadratic = of(block_mesh), of(block_mesh, "tet10")
    assert quadratic.n_unknowns > 6 * linear_one.n_unknowns
    assert quadratic.flops > 30 * linear_one.flops


def test_a_body_that_fits_is_taken_without_a_word(monkeypatch, block_mesh):
    told(monkeypatch, 10**12, block_mesh).check()
    told(monkeypatch, None, block_mesh).check()


def test_more_than_half_of_the_memory_is_warned_of(monkeypatch, block_mesh):
    needed = told(monkeypatch, None, block_mesh).added_bytes
    with pytest.warns(LargeBodyWarning, match=r"needs about .* GB more memory"):
        told(monkeypatch, int(1.5 * needed), block_mesh).check()


def test_more_than_all_of_it_is_refused_with_what_would_fit(monkeypatch):
    """A mesh within what the message suggests is taken."""
    mesh = block(cells=(12, 9, 15))
    needed = told(monkeypatch, None, mesh).added_bytes
    there = needed // 3
    with pytest.raises(LargeBodyError, match="a body must fit into memory") as caught:
        told(monkeypatch, there, mesh).check()
    assert (caught.value.needed_bytes, caught.value.available_bytes) == (needed, there)
    fits = int(re.search(r"at most about ([\d,]+) nodes", str(caught.value))[1].replace(",", ""))
    assert 0.2 * mesh.n_nodes < fits < 0.5 * mesh.n_nodes
    coarser = block(cells=(8, 6, 10))
    assert coarser.n_nodes < fits
    assert told(monkeypatch, there, coarser).added_bytes < there


def test_ten_node_tets_are_sent_to_four_node_tets(monkeypatch, block_mesh):
    needed = told(monkeypatch, None, block_mesh, "tet10").added_bytes
    with pytest.raises(LargeBodyError, match="element 'tet4'"):
        told(monkeypatch, int(0.7 * needed), block_mesh, "tet10").check()


def test_every_simulator_refuses_where_one_factor_does_not_fit(monkeypatch, block_mesh):
    monkeypatch.setattr(size, "available_bytes", lambda: 1000)
    tr.Simulator(block_mesh)  # small ones are not looked at
    monkeypatch.setattr(size, "SIZE", replace(size.SIZE, large_entries=0))
    with pytest.raises(LargeBodyError):
        tr.Simulator(block_mesh)


@pytest.mark.usefixtures("afresh")
def test_the_size_is_told_after_the_analysis_and_before_any_factor(block_mesh, moved):
    said = []
    tr.register(
        block_mesh,
        moved,
        progress=lambda one: said.append((one.kind, one.words)),
        settings=tr.RegisterSettings(threads=1),
    )
    kinds = [words if kind == "stage" else kind for kind, words in said]
    assert kinds.index("body") < kinds.index("size") < kinds.index("linearise") < kinds.index("sample")
    assert (kinds.count("size"), kinds.count("work")) == (1, 1)
    line, work = dict(said)["size"], dict(said)["work"]
    found = of(block_mesh, "tet4-averaged")
    assert line.startswith(f"{block_mesh.n_nodes:,} nodes, {block_mesh.n_tets:,} tets: ")
    for part in (f"{found.n_unknowns:,} unknowns", "about 2 factorisations", "GFlop"):
        assert part in work
        assert part not in line


@pytest.mark.usefixtures("afresh")
def test_a_registration_that_does_not_fit_is_refused_before_anything_is_factored(monkeypatch, block_mesh, moved):
    monkeypatch.setenv(_machine.LIMIT, "0.001")
    said = []
    with pytest.raises(LargeBodyError, match=_machine.LIMIT):
        tr.register(
            block_mesh,
            moved,
            progress=lambda one: said.append((one.kind, one.words)),
            settings=tr.RegisterSettings(threads=1),
        )
    assert ("stage", "linearise") not in said


@pytest.mark.usefixtures("afresh")
def test_the_command_says_the_size_or_refuses_and_writes_nothing(monkeypatch, block_mesh, moved, tmp_path, capsys):
    write_vtu(tmp_path / "body.vtu", block_mesh)
    write_markers(tmp_path / "markers.csv", moved)
    words = ("register", tmp_path / "body.vtu", tmp_path / "markers.csv", "--threads", "1", "--out", tmp_path / "out")
    monkeypatch.setenv(_machine.LIMIT, "0.001")
    code, _, said = run(capsys, *words)
    assert code == 3
    assert "a body must fit into memory" in " ".join(said.split())
    assert not (tmp_path / "out").exists()
    monkeypatch.delenv(_machine.LIMIT)
    code, _, said = run(capsys, *words)
    assert code in (0, 4)
    assert said.startswith(f"note: {block_mesh.n_nodes:,} nodes, ")
    assert "GFlop" not in said
    assert "GFlop" in run(capsys, *words, "--verbose")[2]
    assert run(capsys, *words, "--quiet")[2] == ""


def test_solve_says_the_size_of_what_is_not_small(monkeypatch, tmp_path, capsys):
    problem = write_problem(tmp_path / "problem.npz")
    words = ("solve", problem, "--out", tmp_path / "out.npz", "--threads", "1")
    assert run(capsys, *words)[2] == ""
    monkeypatch.setattr(Estimate, "is_small", False)
    code, _, said = run(capsys, *words)
    assert (code, said.count("note: "), said.count("GFlop")) == (0, 1, 0)
    _, out, said = run(capsys, *words, "--verbose")
    assert (said.count("note: "), said.count("about 1 factorisation")) == (2, 1)
    assert "iterations" in out
    assert "iterations" not in run(capsys, *words)[1]


def test_a_second_way_of_many_right_hand_sides_has_the_same_bits(monkeypatch, block_mesh):
    simulator = tr.Simulator(block_mesh)
    made = Linearised(simulator, tr.Load(), tr.Material(8.0, 0.45), np.zeros((block_mesh.n_nodes, 3)), threads=1)
    free = np.setdiff1d(np.arange(block_mesh.n_nodes), block_mesh.fixed_nodes)[:14]
    rows = [(np.array([node]), axis[None]) for node in free for axis in np.eye(3)]
    whole = Tangent(made, 1).compliance(rows)[0]
    monkeypatch.setattr(tangent, "EFFORT", replace(tangent.EFFORT, many_unknowns=0))
    seen = []
    parts = Tangent(made, 1).compliance(rows, lambda *done: seen.append(done))[0]
    assert seen == [(16, 42), (32, 42)]
    np.testing.assert_array_equal(parts.forces, whole.forces)
    np.testing.assert_array_equal(parts.prescribed, whole.prescribed)


@pytest.mark.usefixtures("afresh")
def test_a_large_tangent_at_rest_is_not_kept_and_answers_are_the_same(monkeypatch, block_mesh, moved):
    first = tr.register(block_mesh, moved, settings=tr.RegisterSettings(threads=1))
    again = tr.register(block_mesh, moved, settings=tr.RegisterSettings(threads=1))
    assert again.work["factorisations"] == first.work["factorisations"] - 1
    forget_rest()
    monkeypatch.setattr(tangent, "EFFORT", replace(tangent.EFFORT, kept_entries=0))
    for _ in range(2):
        large = tr.register(block_mesh, moved, settings=tr.RegisterSettings(threads=1))
        assert large.work["factorisations"] == first.work["factorisations"]
        np.testing.assert_array_equal(large.displacement, first.displacement)


@pytest.mark.usefixtures("afresh")
def test_passes_hold_no_more_factors_than_the_estimate_says(monkeypatch, block_mesh, moved):
    """However many passes are made: the closest one and the next."""
    made, alive, inner = [], [], linear.tangent_at

    def counted(*arguments):
        found, factored = inner(*arguments)
        made.append(weakref.ref(found))
        alive.append(sum(one() is not None for one in made))
        return found, factored

    monkeypatch.setattr(linear, "tangent_at", counted)
    monkeypatch.setattr(tangent, "EFFORT", replace(tangent.EFFORT, kept_entries=0))
    monkeypatch.setattr(fit.Passes, "_ended", lambda *_: False)
    settings = tr.RegisterSettings()
    settings = replace(settings, contacts=replace(settings.contacts, max_passes=5))
    tr.register(block_mesh, moved, settings=replace(settings, threads=1))
    assert len(alive) >= 5
    assert max(alive) <= expected_work(60, 3, 64, matched=False).factors_held


def test_groups_of_both_kinds_limit_the_memory(tmp_path):
    own = tmp_path / "cgroup"
    own.write_text("4:memory:/a/b\n2:cpu:/a\n0::/c\n", encoding="utf-8")
    root = tmp_path / "sys"
    first, second = root / "memory" / "a", root / "c"
    first.mkdir(parents=True)
    second.mkdir()
    (first / "memory.limit_in_bytes").write_text("1000\n", encoding="ascii")
    (first / "memory.usage_in_bytes").write_text("600\n", encoding="ascii")
    (first / "memory.stat").write_text("cache 5\ntotal_inactive_file 50\n", encoding="ascii")
    (second / "memory.max").write_text("300\n", encoding="ascii")
    (second / "memory.current").write_text("100\n", encoding="ascii")
    assert sorted(_machine._groups_left(root, own)) == [200, 450]
    (second / "memory.max").write_text("max\n", encoding="ascii")
    assert _machine._groups_left(root, own) == [450]
    assert _machine._groups_left(root, tmp_path / "nothing") == []


def test_the_environment_replaces_what_the_system_states_of_memory(monkeypatch):
    monkeypatch.setattr(_machine, "_system_left", lambda: 7)
    monkeypatch.setattr(_machine, "_groups_left", lambda: [9])
    assert _machine.available_bytes() == 7
    monkeypatch.setenv(_machine.LIMIT, "1e-9")
    assert _machine.available_bytes() == 0
    monkeypatch.setenv(_machine.LIMIT, "1000")
    assert 9e11 < _machine.available_bytes() < 1e12
    for endless in ("inf", "1e400"):
        monkeypatch.setenv(_machine.LIMIT, endless)
        assert _machine.available_bytes() is None
    for wrong in ("no number", "8GB", "-1", "nan", ""):
        monkeypatch.setenv(_machine.LIMIT, wrong)
        with pytest.raises(ArgumentError, match=f"{_machine.LIMIT} in the environment must be a positive number"):
            _machine.available_bytes()


def test_memory_is_that_of_the_factors_held_where_nothing_else_counts():
    """With 1e9 entries everything but factors and working storage is a hundredth."""
    large = BodySize(1_000, 5_000, 3_000, 10**9, 1e12, 10**7, "tet4")
    work = replace(SOLVE, factors_held=2, entry_bytes=4)
    assert Estimate.of(large, work, 1).added_bytes == pytest.approx(2 * 4 * 1e9, rel=0.02)
    assert Estimate.of(large, replace(work, factors_held=3), 1).added_bytes == pytest.approx(3 * 4 * 1e9, rel=0.02)


def test_the_rule_begins_where_all_memory_is_needed(monkeypatch, block_mesh):
    needed = told(monkeypatch, None, block_mesh).added_bytes
    assert told(monkeypatch, needed - 1, block_mesh).is_too_large
    assert not told(monkeypatch, needed, block_mesh).is_too_large
