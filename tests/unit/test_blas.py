"""The number of threads of BLAS, which is one of the whole process, while calls run beside each other."""

import threading

import numpy as np
import pytest
from threadpoolctl import ThreadpoolController

import tissuereg as tr
from support.rigs import rig
from tissuereg._base.blas import BlasThreads


def now():
    return [library["num_threads"] for library in ThreadpoolController().select(user_api="blas").info()]


@pytest.fixture(autouse=True)
def two_threads():
    with ThreadpoolController().select(user_api="blas").limit(limits=2):
        if not np.all(np.array(now()) == 2):
            pytest.skip("this BLAS has one thread")
        yield


def held_in_another_thread(blas, begun, end):
    """Return a running thread that is in a block until `end`, and what it sees there."""
    seen = []

    def block():
        with blas.one():
            seen.append(set(now()))
            begun.set()
            end.wait(10.0)

    thread = threading.Thread(target=block)
    thread.start()
    assert begun.wait(10.0)
    return thread, seen


@pytest.mark.parametrize("first", ["here", "there"])
def test_calls_in_two_threads_have_one_thread_of_blas_until_the_last_one_ends(first):
    begun, end = threading.Event(), threading.Event()
    here = BlasThreads().one()
    if first == "here":
        here.__enter__()
    thread, seen = held_in_another_thread(BlasThreads(), begun, end)
    if first == "there":
        here.__enter__()
        end.set()
        thread.join()
        assert set(now()) == {1}
        here.__exit__(None, None, None)
    else:
        here.__exit__(None, None, None)
        assert set(now()) == {1}
        end.set()
        thread.join()
    assert seen == [{1}]
    assert set(now()) == {2}


def test_blocks_that_overlap_have_one_thread_until_the_last_one_ends():
    first, second = BlasThreads(), BlasThreads()
    one, other = first.one(), second.one()
    one.__enter__()
    other.__enter__()
    one.__exit__(None, None, None)
    assert set(now()) == {1}
    with first.one(), first.one():
        assert set(now()) == {1}
    assert set(now()) == {1}
    other.__exit__(None, None, None)
    assert set(now()) == {2}


def test_an_error_and_another_thread_leave_the_number_as_it_was():
    def spoilt():
        with BlasThreads().one():
            assert set(now()) == {1}
            message = "in the block"
            raise ValueError(message)

    def failing():
        with pytest.raises(ValueError, match="in the block"):
            spoilt()

    with BlasThreads().one():
        thread = threading.Thread(target=failing)
        thread.start()
        thread.join()
        assert set(now()) == {1}
    assert set(now()) == {2}


def test_a_diagnosis_has_one_thread_of_blas():
    seen = set()
    tr.diagnose(rig(), keep=False, progress=lambda step: seen.update(now()))
    assert seen == {1}
    assert set(now()) == {2}
