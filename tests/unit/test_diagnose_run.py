"""A whole diagnosis gives the same answer every time, on any number of threads."""

import tissuereg as tr
from support.rigs import rig


def test_the_answer_depends_on_neither_threads_nor_the_call():
    # Its markers do not move with its pads: nothing explains that, and everything is tried.
    one, again, two = (tr.diagnose(rig(), threads=threads, keep=False).to_json() for threads in (1, 1, 2))
    assert one["verdict"] == "unexplained"
    assert len(one["candidates"]) > 20
    assert one == again == two
