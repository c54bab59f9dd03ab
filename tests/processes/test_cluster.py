"""A Dask cluster of real processes: workers die and hang, the scheduler restarts, the client goes away."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

import tissuereg as tr
from support.cluster_tasks import Harming, square
from support.meshes import block
from support.processes import PATIENCE, Command, content
from tissuereg.errors import ArgumentError, ClusterError, FormatError, MarkerError, MaterialError, MissingPackageError
from tissuereg.io.meshes import write_vtu
from tissuereg.parallel import Failed, Finished, InProcess, Processes, one_result, open_executor
from tissuereg.parallel.jobs import read_jobs
from tissuereg.registration.contacts.settings import ContactSettings
from tissuereg.simulation.dataset import make_dataset
from tissuereg.simulation.recipe import read_recipe

pytest.importorskip("distributed")

RECIPE = '[mesh]\nfile = "mesh.vtu"\n[data]\nmembers = 96\nchunk = 8\n[pairs]\nmembers = 0\n'

#: Signals that end and stop a worker.
KILL, STOP = int(signal.SIGKILL), int(getattr(signal, "SIGSTOP", 0))


#: As it was before anything was started here.
ENVIRONMENT = dict(os.environ)


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    """A recipe, and the data set that one process makes of it."""
    folder = tmp_path_factory.mktemp("inputs")
    write_vtu(folder / "mesh.vtu", block())
    (folder / "recipe.toml").write_text(RECIPE)
    make_dataset(read_recipe(folder / "recipe.toml"), folder / "whole", threads=1)
    return folder


def outcomes_of(executor, folder, what, n=40):
    """Run n tasks, some of which do harm; return results and errors by number."""
    tasks = ((str(folder), number, what.get(number)) for number in range(n))
    outcomes = list(executor.run(square, tasks))
    assert sorted(one.index for one in outcomes) == list(range(n))
    results = {one.index: one.result for one in outcomes if isinstance(one, Finished)}
    errors = {one.index: one.error for one in outcomes if isinstance(one, Failed)}
    assert all(result == number**2 for number, result in results.items())
    return results, errors


def made(folder):
    """How often each task ran to its end."""
    return Counter(int(line) for line in (folder / "made").read_text().split())


class Dask:
    """A scheduler with its own port and workers, as processes that can be killed."""

    def __init__(self, folder):
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.address = f"tcp://127.0.0.1:{probe.getsockname()[1]}"
        self.folder, self.processes = folder, []

    def _start(self, *words):
        settings = {
            "DASK_DISTRIBUTED__SCHEDULER__WORKER_TTL": "20s",
            "OMP_NUM_THREADS": "1",
            "PYTHONPATH": os.pathsep.join([str(Path(__file__).parents[1]), *filter(None, sys.path)]),
        }
        with (self.folder / "dask.log").open("a") as log:
            process = subprocess.Popen(
                [sys.executable, "-m", "dask", *words, "--host", "127.0.0.1", "--no-dashboard"],
                env={**os.environ, **settings},
                cwd=self.folder,
                stdout=log,
                stderr=log,
                start_new_session=True,
            )
        self.processes.append(process)

    def start(self, n_workers=2):
        port = self.address.rpartition(":")[2]
        self._start("scheduler", "--port", port)
        for _ in range(n_workers):
            self._start("worker", self.address, "--nthreads", "1")
        until = time.monotonic() + PATIENCE
        while time.monotonic() < until:
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", int(port))) == 0:
                    return
            time.sleep(0.1)

    def kill(self):
        """Kill the scheduler, then the workers, which would not come back of themselves."""
        for process in self.processes:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        self.processes = []


@pytest.fixture
def dask(tmp_path):
    made = Dask(tmp_path)
    made.start()
    yield made
    made.kill()


@pytest.fixture(scope="module")
def cluster():
    with open_executor("local:2", task_limit=2.0) as executor:
        yield executor


def test_a_result_comes_for_every_task_as_in_this_process(cluster, tmp_path):
    with InProcess() as here, Processes(2) as processes:
        for executor in (here, processes, cluster):
            results, errors = outcomes_of(executor, tmp_path, {})
            assert len(results) == 40
            assert errors == {}
            assert executor.worker_seconds > 0
    assert made(tmp_path) == dict.fromkeys(range(40), 3)


def test_a_task_that_raises_is_alone_in_failing_and_a_passing_error_is_tried_again(cluster, tmp_path):
    results, errors = outcomes_of(cluster, tmp_path, {3: "ours", 5: "other", 7: "flaky"})
    assert set(errors) == {3, 5}
    assert len(results) == 38
    assert isinstance(errors[3], MaterialError)
    assert errors[3].where == "here"
    assert isinstance(errors[5], OSError)
    with pytest.raises(MaterialError, match="task 1 must"):
        one_result(cluster, square, (str(tmp_path), 1, "ours"))


def test_registrations_of_a_cluster_are_those_of_register(cluster, block_mesh):
    top = block_mesh.nodes[block_mesh.nodes[:, 2] == block_mesh.nodes[:, 2].max()][::4]
    measured = top + np.array([[[0.5, 0.0, 0.0]], [[np.nan] * 3], [[0.0, 0.4, 0.1]]])
    few = ContactSettings(n_chains=2, n_chains_first=2, max_passes=1, n_kept=1, powers=(1.0,), n_draws=2)
    settings = tr.RegisterSettings(threads=1, contacts=few)
    found = list(tr.register_many(block_mesh, (top, top), measured, executor=cluster, settings=settings))
    assert isinstance(found[1], Failed)
    assert isinstance(found[1].error, MarkerError)
    for number in (0, 2):
        alone = tr.register(block_mesh, (top, measured[number]), settings=settings)
        assert np.array_equal(found[number].displacement, alone.displacement)
        assert np.array_equal(found[number].node_covariance, alone.node_covariance)


def test_workers_started_here_keep_freed_memory_and_have_one_thread(cluster):
    wanted = {"MALLOC_MMAP_THRESHOLD_": str(2**25), "MALLOC_TRIM_THRESHOLD_": str(2**26), "RAYON_NUM_THREADS": "1"}
    found = {one.index: one.result for one in cluster.run(os.getenv, wanted)}
    # What the environment of the command says goes before.
    assert [found[k] for k in range(3)] == [ENVIRONMENT.get(name, value) for name, value in wanted.items()]


def test_tasks_are_taken_as_workers_become_free(cluster, tmp_path):
    taken = []

    def tasks():
        for number in range(2000):
            taken.append(number)
            yield (str(tmp_path), number, None)

    run = cluster.run(square, tasks())
    next(run)
    # 256 are in flight, and what finished between two looks is replaced.
    assert len(taken) < 600
    run.close()


def test_a_worker_that_is_killed_marks_no_task_as_failed(cluster, tmp_path):
    results, errors = outcomes_of(cluster, tmp_path, {4: KILL, 11: KILL})
    assert errors == {}
    assert len(results) == 40


@pytest.mark.slow
def test_a_task_that_kills_every_worker_fails_and_its_neighbours_do_not(cluster, tmp_path):
    results, errors = outcomes_of(cluster, tmp_path, {6: "always"}, n=30)
    assert set(errors) == {6}
    assert isinstance(errors[6], ClusterError)
    assert "died" in str(errors[6])
    assert len(results) == 29


@pytest.mark.slow
@pytest.mark.skipif(not STOP, reason="processes cannot be stopped here")
@pytest.mark.parametrize("what", [STOP, "loop"])
def test_a_worker_that_hangs_marks_no_task_as_failed(cluster, tmp_path, what):
    results, errors = outcomes_of(cluster, tmp_path, {4: what})
    assert errors == {}
    assert len(results) == 40


@pytest.mark.slow
def test_workers_that_dask_gives_up_are_started_again(tmp_path):
    import dask

    # Dask gives up a worker of this machine that is not back in time: here at once, else after 15 s.
    with dask.config.set({"distributed.deploy.lost-worker-timeout": "10ms"}), open_executor("local:2") as executor:
        results, errors = outcomes_of(executor, tmp_path, {0: KILL, 1: KILL})
    assert (len(results), errors) == (40, {})


@pytest.mark.slow
def test_the_start_of_a_worker_is_no_time_of_the_task_that_waits_for_it(tmp_path):
    # A fresh process takes longer than the limit until it runs a task; this one kills all of them.
    with open_executor("local:1", task_limit=0.8) as executor:
        results, errors = outcomes_of(executor, tmp_path, {1: "always"}, n=3)
    assert set(results) == {0, 2}
    assert "died" in str(errors[1])


@pytest.mark.slow
@pytest.mark.parametrize("number", [KILL, STOP])
def test_a_chunk_whose_worker_is_lost_in_its_middle_is_made_again_with_the_same_bits(cluster, inputs, tmp_path, number):
    (tmp_path / "flags").mkdir()
    recipe = read_recipe(inputs / "recipe.toml")
    done = make_dataset(recipe, tmp_path / "out", threads=1, executor=Harming(cluster, tmp_path / "flags", number))
    assert (tmp_path / "flags" / "flag").exists()
    assert done["members"] == 96
    assert 0.0 < done["overhead"] < 1.0
    assert content(tmp_path / "out") == content(inputs / "whole")


@pytest.mark.slow
def test_after_a_restart_of_the_scheduler_nothing_is_lost(dask, tmp_path):
    with open_executor(dask.address, patience=60.0) as executor:
        run = executor.run(square, ((str(tmp_path), number, None) for number in range(400)))
        found = [next(run) for _ in range(20)]
        dask.kill()
        dask.start()
        found += run
    assert sorted(one.index for one in found) == list(range(400))
    assert all(isinstance(one, Finished) for one in found)


@pytest.mark.slow
def test_a_scheduler_that_stays_away_is_an_error_and_the_next_run_goes_on(dask, inputs, tmp_path):
    recipe, out = read_recipe(inputs / "recipe.toml"), tmp_path / "out"
    with open_executor(dask.address, patience=2.0) as executor:

        def leave(done, in_all):
            if dask.processes:
                dask.kill()

        with pytest.raises(ClusterError, match="must answer"):
            make_dataset(recipe, out, threads=1, executor=executor, progress=leave)
    assert 1 <= len(list(out.glob("chunk_*"))) < 12
    dask.start()
    with open_executor(dask.address, patience=60.0) as executor:
        assert make_dataset(recipe, out, threads=1, executor=executor)["members"] == 96
    assert content(out) == content(inputs / "whole")


@pytest.mark.slow
@pytest.mark.parametrize("where", ["tcp", "local:2"])
def test_a_client_that_is_killed_is_gone_on_with_by_the_same_command(where, dask, inputs, tmp_path):
    where = dask.address if where == "tcp" else where
    words = (
        "simulate",
        inputs / "recipe.toml",
        "--quiet",
        "--out",
        "{out}",
        "--cluster",
        where,
        "--json",
        "{out}.json",
    )
    command = Command(words, tmp_path / "run")
    process = command.start()
    until = time.monotonic() + PATIENCE
    while not list(command.out.glob("chunk_*")) and time.monotonic() < until:
        time.sleep(0.01)
    process.kill()
    process.communicate()
    assert not (command.out / "dataset.json").exists()
    code, said = command.run()
    assert code == 0, said
    assert content(command.out) == content(inputs / "whole")
    answer = json.loads((command.place / "out.json").read_text())
    assert answer["members"] == 96
    assert answer["failed"] == []
    assert 0.0 < answer["overhead"] < 1.0


@pytest.mark.parametrize(
    "address", ["tcp://127.0.0.1", "local:0", "local:", "here", "tcp://a b:1", "http://127.0.0.1:1"]
)
def test_an_address_of_no_known_form_is_refused(address):
    with pytest.raises(ArgumentError, match="a cluster must be"):
        open_executor(address)


def test_an_address_at_which_nothing_answers_is_an_error_of_its_own():
    with pytest.raises(ClusterError, match=r"must answer at tcp://127\.0\.0\.1:9"):
        open_executor("tcp://127.0.0.1:9", patience=1.0)


def test_without_the_package_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingPackageError, match=r"tissuereg\[cluster\]"):
        open_executor("local:2")


GOOD = "kind: slurm\nworkers: {maximum: 100}\njob: {cores: 8, memory: 16GB, walltime: '1-00:30:00'}\n"


def test_workers_of_a_batch_system_leave_before_their_walltime(tmp_path):
    (tmp_path / "jobs.yaml").write_text(GOOD)
    kind, job, minimum, maximum = read_jobs(str(tmp_path / "jobs.yaml"))
    assert (kind, minimum, maximum) == ("slurm", 0, 100)
    _, leave, _, stagger = job["worker_extra_args"]
    assert int(leave[:-1]) + int(stagger[:-1]) < 24 * 3600 + 1800


@pytest.mark.parametrize(
    ("old", "new", "where"),
    [
        ("slurm", "cloud", "kind"),
        ("maximum: 100", "most: 100", "workers"),
        ("maximum: 100", "maximum: 0", "workers"),
        ("'1-00:30:00'", "90", "walltime"),
        ("job:", "jobs:", "kind, workers and job"),
        ("{cores", "{{cores", "readable YAML"),
    ],
)
def test_a_file_of_jobs_with_a_wrong_entry_is_refused_by_its_name(tmp_path, old, new, where):
    (tmp_path / "jobs.yaml").write_text(GOOD.replace(old, new, 1))
    with pytest.raises(FormatError, match=where):
        open_executor(str(tmp_path / "jobs.yaml"))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # dask-jobqueue waits for no local job
def test_a_file_of_jobs_starts_workers_that_run_tasks(tmp_path, monkeypatch):
    pytest.importorskip("dask_jobqueue")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(Path(__file__).parents[1]), *filter(None, sys.path)]))
    file = tmp_path / "jobs.yaml"
    job = "{cores: 1, processes: 1, memory: 1GB, interface: lo, scheduler_options: {dashboard: false}}"
    file.write_text(f"kind: local\nworkers: {{minimum: 1, maximum: 2}}\njob: {job}\n")
    with open_executor(str(file)) as executor:
        results, errors = outcomes_of(executor, tmp_path, {})
    assert (len(results), errors) == (40, {})
