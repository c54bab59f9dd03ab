"""The interpreter lock, Ctrl-C, and threads."""

import signal
import subprocess
import sys
import textwrap
import threading
import time

import numpy as np
import pytest

from support.meshes import block
from tissuereg import _core

NOTHING = np.empty(0, dtype=np.int64), np.empty((0, 3))


@pytest.fixture(scope="module")
def slow_body():
    mesh = block(cells=(8, 6, 10))
    return _core.Body(mesh.nodes, mesh.tets, mesh.fixed_nodes)


def ensemble(n_members):
    """Return arguments of members that bend far and each need a factor of their own."""
    loads = np.zeros((n_members, 3))
    loads[:, 1] = np.linspace(1e-3, 2e-2, n_members)
    return np.full(n_members, 9.0), np.linspace(0.3, 0.45, n_members), {"body_force": loads}


def test_another_thread_runs_while_members_are_solved(slow_body):
    young, poisson, load = ensemble(40)
    worker = threading.Thread(target=lambda: slow_body.solve_many(young, poisson, threads=1, **load))
    worker.start()
    ticks = 0
    begin = time.perf_counter()
    while worker.is_alive():
        time.sleep(1e-3)
        ticks += worker.is_alive()
    seconds = time.perf_counter() - begin
    worker.join()
    # With the lock held there would be one tick at most; a busy machine gives fewer than the thousand a second.
    assert ticks > max(5, 20 * seconds)


def test_two_threads_in_a_solve_both_make_progress(slow_body):
    young, poisson, load = ensemble(30)
    when = {"a": [], "b": []}

    def run(name):
        slow_body.solve_many(
            young, poisson, threads=1, progress=lambda n: when[name].append(time.perf_counter()), **load
        )

    threads = [threading.Thread(target=run, args=(name,)) for name in when]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    # Each is heard of before the other has finished.
    assert when["a"][0] < when["b"][-1]
    assert when["b"][0] < when["a"][-1]


def test_progress_grows_and_ends_with_all_members(slow_body):
    young, poisson, load = ensemble(6)
    counts = []
    slow_body.solve_many(young, poisson, progress=counts.append, **load)
    assert counts == sorted(set(counts))
    assert counts[-1] == 6


def test_an_exception_in_progress_stops_the_members(slow_body):
    young, poisson, load = ensemble(500)

    def stop(_):
        message = "enough"
        raise LookupError(message)

    with pytest.raises(LookupError, match="enough"):
        slow_body.solve_many(young, poisson, progress=stop, **load)


MANY = """
    body = body_of(cells=(8, 6, 10), element="tet4")
    n = 5000
    loads = np.zeros((n, 3))
    loads[:, 1] = np.linspace(1e-3, 2e-2, n)
    started()
    body.solve_many(np.full(n, 9.0), np.linspace(0.3, 0.45, n), body_force=loads, threads={threads})
"""

# One factorisation of this takes about a second.
ONE = """
    body = body_of(cells=(14, 12, 20), element="tet10")
    started()
    load = np.array([0.0, 2e-2, 0.0])
    body.solve(np.array([5.0]), np.array([0.47]), body_force=load, method="newton", threads={threads})
"""

FRAME = """
    mesh = block(cells=(14, 12, 20))
    soft = np.array([5.0]), np.array([0.47])
    body = _core.Body(mesh.nodes, mesh.tets, mesh.fixed_nodes, element="tet10")
    rig = _core.Rig(body, *soft, threads={threads})
    started()
    while True:
        rig.advance(0.0, np.empty((0, 3)), body_force=np.array([0.0, 2e-2, 0.0]))
"""

MANY_CAUSES = """
    body = body_of(cells=(10, 8, 14), element="tet10")
    here = body.linearise(np.zeros_like(body.nodes), np.array([9.0]), np.array([0.4]), threads={threads})
    causes = [_core.Cause.parameter("young")] * 5000
    started()
    here.derivatives(causes)
"""

MANY_OBSERVATIONS = """
    body = body_of(cells=(10, 8, 14), element="tet10")
    here = body.linearise(np.zeros_like(body.nodes), np.array([9.0]), np.array([0.4]), threads={threads})
    nothing = np.empty(0, dtype=np.int64), np.empty((0, 3))
    seen = [(np.array([30]), np.ones((1, 3)), *nothing)] * 1000
    started()
    while True:
        here.compliance(seen)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="signals of another kind")
@pytest.mark.parametrize("work", [MANY, ONE, FRAME, MANY_CAUSES, MANY_OBSERVATIONS])
@pytest.mark.parametrize("threads", [1, 0])
def test_control_c_stops_a_call_that_would_last_minutes(work, threads):
    code = textwrap.dedent(
        f"""
        import signal, sys, threading
        import numpy as np
        # A run in the background of a shell starts with the interrupt ignored.
        signal.signal(signal.SIGINT, signal.default_int_handler)
        sys.path[:] = {sys.path!r}
        from support.meshes import block
        from tissuereg import _core

        def body_of(cells, element):
            mesh = block(cells=cells)
            return _core.Body(mesh.nodes, mesh.tets, mesh.fixed_nodes, element=element)

        def started():
            # From another thread, once the call below is under way.
            threading.Timer(0.3, print, ["started"], {{"flush": True}}).start()

        try:
{textwrap.indent(textwrap.dedent(work.format(threads=threads)), " " * 12)}
        except KeyboardInterrupt:
            print("interrupted", flush=True)
        else:
            print("finished", flush=True)
        """
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "started\n"
        process.send_signal(signal.SIGINT)
        # Idle machines take a few hundredths of a second; this only distinguishes stopping from finishing.
        timer = threading.Timer(30.0, process.kill)
        timer.start()
        answer = process.stdout.readline()
        process.wait()
        timer.cancel()
    assert answer == "interrupted\n"
    assert process.returncode == 0


def test_many_solves_give_the_same_bits_at_one_and_two_threads(slow_body):
    young, poisson, load = ensemble(8)
    one, two, three = (slow_body.solve_many(young, poisson, threads=n, **load) for n in (1, 2, 3))
    for other in (two, three):
        np.testing.assert_array_equal(one.displacement, other.displacement)
        np.testing.assert_array_equal(one.reactions, other.reactions)


@pytest.mark.parametrize("method", ["auto", "newton", "quasi-newton"])
def test_one_solve_gives_the_same_bits_at_one_and_two_threads(slow_body, method):
    def displacement(threads):
        gravity = np.array([0.0, 9.81e-3, 0.0])
        # A body of its own each time: nothing is kept from the solve before.
        body = _core.Body(slow_body.nodes, slow_body.tets, slow_body.held_nodes, element="tet10")
        return body.solve(
            np.array([20.0]), np.array([0.45]), body_force=gravity, method=method, threads=threads
        ).displacement

    one, two = displacement(1), displacement(2)
    assert np.abs(one).max() > 0.1
    np.testing.assert_array_equal(one, two)


def test_derivatives_give_the_same_bits_at_one_and_two_threads(slow_body):
    load = {"body_force": np.array([0.0, 2e-3, 0.0])}
    moduli = np.array([20.0]), np.array([0.45])
    where = slow_body.solve(*moduli, **load).displacement
    causes = [_core.Cause.parameter("young"), _core.Cause.parameter("poisson")]
    seen = [(np.array([7]), np.ones((1, 3)), np.array([0]), np.ones((1, 3)))]
    found = []
    for threads in (1, 2):
        here = slow_body.linearise(where, *moduli, threads=threads, **load)
        markers = [(np.array([n]), np.ones((1, 3)), *NOTHING) for n in range(7, 40)]
        wide = here.compliance(markers).forces
        found.append([*here.derivatives(causes), here.adjoints(seen).young, wide, here.unbalanced(causes)])
    for one, two in zip(*found, strict=True):
        assert np.abs(one).max() > 0.0
        np.testing.assert_array_equal(one, two)


def test_a_step_gives_the_same_bits_at_one_and_two_threads():
    rng = np.random.default_rng(3)
    for n_obs, n_members in ((45, 100), (300, 200), (2500, 60)):
        predicted, draws = rng.standard_normal((2, n_obs, n_members))
        parameters = rng.standard_normal((1000, n_members))
        for std in (0.3, 1e-5):
            noise = _core.Noise.diagonal(np.full(n_obs, std))
            one, two, every = (
                _core.Step(predicted, np.zeros(n_obs), noise, draws, alpha=4.0, threads=n).apply(parameters)
                for n in (1, 2, 0)
            )
            np.testing.assert_array_equal(one, two)
            np.testing.assert_array_equal(one, every)
