"""What the pages of times say beside their figures."""

from common import read_archive
from speed import cluster, large_bodies


def test_the_page_of_many_machines_says_what_its_figures_mean():
    answer = read_archive(cluster.ARCHIVE)
    assert "does not keep up with chunks of 16" in cluster.page({**answer, "empty_tasks_per_s": 100.0})
    assert "It keeps up with chunks of 16" in cluster.page({**answer, "empty_tasks_per_s": 1e6})
    assert "busy" not in cluster.page({**answer, "load_before": 0.05})
    assert "busy" in cluster.page({**answer, "load_before": 3.0})


def test_estimates_of_large_bodies_hold():
    rows = read_archive(large_bodies.ARCHIVE)["rows"]
    assert [row["size"]["n_nodes"] // 1000 for row in rows] == [4, 20, 101, 201]
    for row in rows:
        for command in ("register", "solve"):
            # Never much too low, since bodies are refused by it; never twice too high.
            told, found = row["expected"][command]["peak_bytes"], row["measured"][command]["peak_bytes"]
            assert 0.95 * found < told < 2.0 * found, (row["size"]["n_nodes"], command)
