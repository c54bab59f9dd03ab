"""Processes of this machine: they end with the one that made them, and no task is lost."""

import os
import signal
import subprocess
import sys
import time

import pytest

from support.cluster_tasks import square
from tissuereg.errors import ClusterError
from tissuereg.parallel import Failed, Finished, Processes, in_order

POOL = """
import os, time
from tissuereg.parallel import Processes

def number(task):
    if task:
        time.sleep(600.0)
    return os.getpid()

if __name__ == "__main__":
    with Processes(1) as executor:
        for outcome in executor.run(number, range(2)):
            print(outcome.result, flush=True)
"""


def test_workers_end_with_the_process_that_made_them(tmp_path):
    script = tmp_path / "pool.py"
    script.write_text(POOL, encoding="utf-8")
    path = os.pathsep.join(sys.path)
    made = subprocess.Popen(
        [sys.executable, str(script)], stdout=subprocess.PIPE, text=True, env=os.environ | {"PYTHONPATH": path}
    )
    with made.stdout as output:
        worker = int(output.readline())
    os.kill(worker, 0)  # it is there
    made.kill()
    made.wait()
    for _ in range(200):
        try:
            os.kill(worker, 0)
        except ProcessLookupError:
            return
        time.sleep(0.1)
    os.kill(worker, signal.SIGKILL)
    pytest.fail("the worker lives on")


def test_a_process_that_dies_ends_the_run_with_an_error_that_says_what_to_do(tmp_path):
    tasks = [(str(tmp_path), number, "always" if number == 3 else None) for number in range(8)]
    with Processes(2) as executor, pytest.raises(ClusterError, match="Run the same command again"):
        list(executor.run(square, tasks))


def test_outcomes_are_given_in_order_as_soon_as_all_before_are_there():
    given = []

    def outcomes():
        for index in (1, 0, 3, 2):
            given.append(index)
            yield Failed(index, ValueError()) if index == 3 else Finished(index, str(index))

    counted = []
    run = in_order(outcomes(), counted.append)
    assert next(run).index == 0
    assert given == [1, 0]
    assert [one.index for one in run] == [1, 2, 3]
    assert counted == [1, 2, 3, 4]
