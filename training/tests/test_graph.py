import numpy as np
import pytest

from tissuereg_training.graph import graph_of_tets, hierarchy, independent_centres


def hops(graph, starts):
    """Distance of every node from each start, breadth first, plainly."""
    near = [set(graph.indices[graph.indptr[i] : graph.indptr[i + 1]].tolist()) for i in range(graph.shape[0])]
    table = np.full((len(starts), graph.shape[0]), 99)
    for row, start in zip(table, starts, strict=True):
        front, distance = {int(start)}, 0
        while front:
            row[list(front)] = distance
            front = {n for f in front for n in near[f] if row[n] == 99}
            distance += 1
    return table


def test_the_graph_has_the_edges_of_the_tets_and_a_loop_at_every_node():
    graph = graph_of_tets(5, np.array([[0, 1, 2, 3]])).toarray()
    assert np.array_equal(graph[:4, :4], np.ones((4, 4)))
    assert np.array_equal(graph[4], [0, 0, 0, 0, 1])


@pytest.mark.parametrize(("coarse_edges", "reach"), [("wide", 3), ("reduced", 2)])
def test_centres_cover_every_node_stand_apart_and_are_joined_within_the_reach(block_1331, coarse_edges, reach):
    levels = hierarchy(block_1331.n_nodes, block_1331.tets, 1, coarse_edges)
    graph, centres = graph_of_tets(block_1331.n_nodes, block_1331.tets), levels.centres[0]
    distance = hops(graph, centres)
    assert distance.min(axis=0).max() == 1
    between = distance[:, centres]
    assert between[~np.eye(len(centres), dtype=bool)].min() == 2
    joined = np.zeros_like(between, dtype=bool)
    joined[levels.edges[1][:, 0], levels.edges[1][:, 1]] = True
    assert np.array_equal(joined, between <= reach)
    pooled = np.zeros(distance.shape, dtype=bool)
    pooled[levels.pools[0][:, 0], levels.pools[0][:, 1]] = True
    assert np.array_equal(pooled, distance <= 1)


def test_sizes_fall_as_in_table_ii(levels_1331):
    n0, n1, n2, n3 = levels_1331.sizes
    # Table II: 4223 > 811 > 82 > 6, ratios 5.2, 9.9 and 13.7; the last level of a small mesh is smaller still.
    assert 4 <= n0 / n1 <= 8
    assert 5 <= n1 / n2 <= 14
    assert 1 <= n3 <= 8
    assert "1,331" in levels_1331.summary()


def test_edges_are_sorted_symmetric_and_hold_every_loop(levels_1331):
    for edges, n in zip(levels_1331.edges, levels_1331.sizes, strict=True):
        pairs = set(map(tuple, edges.tolist()))
        assert edges.tolist() == sorted(edges.tolist())
        assert {(j, i) for i, j in pairs} == pairs
        assert {(i, i) for i in range(n)} <= pairs


def test_loose_parts_and_lone_nodes_are_covered_too():
    graph = graph_of_tets(9, np.array([[0, 1, 2, 3], [4, 5, 6, 7]]))
    assert independent_centres(graph).tolist() == [0, 4, 8]
    assert hierarchy(9, np.array([[0, 1, 2, 3], [4, 5, 6, 7]])).sizes == (9, 3, 3, 3)
