import numpy as np
import pytest
import torch
from conftest import make_block

from tissuereg_training.graph import hierarchy
from tissuereg_training.layers import DensityPool, VertexConv
from tissuereg_training.sparse import EdgePattern, collect, products, spread, sum_of_products

EDGES = np.array([[0, 0], [0, 2], [1, 0], [1, 1], [1, 3], [2, 2], [2, 3]])


def double(*shape):
    return torch.randn(*shape, dtype=torch.float64, requires_grad=True)


@pytest.fixture(autouse=True)
def seed():
    torch.manual_seed(5)


def test_spread_and_collect_are_products_with_the_stacked_matrix_and_its_transpose():
    pattern, values = EdgePattern(EDGES, 3, 4, 2), torch.randn(2, len(EDGES))
    stacked = torch.zeros(2, 3, 4)
    stacked[:, EDGES[:, 0], EDGES[:, 1]] = values
    stacked = stacked.reshape(6, 4)
    x, u = torch.randn(4, 5), torch.randn(6, 5)
    torch.testing.assert_close(spread(values, x, pattern), stacked @ x)
    torch.testing.assert_close(collect(values, u, pattern), stacked.T @ u)


def test_hand_written_gradients_agree_with_finite_differences():
    pattern = EdgePattern(EDGES, 3, 4, 2)
    values = double(2, len(EDGES))
    assert torch.autograd.gradcheck(lambda v, x: spread(v, x, pattern), (values, double(4, 5)))
    assert torch.autograd.gradcheck(lambda v, u: collect(v, u, pattern), (values, double(6, 5)))
    for width in (2, 18):  # narrow and wide take different ways
        assert torch.autograd.gradcheck(products, (double(4, 3), double(2, 3, width)))
        assert torch.autograd.gradcheck(sum_of_products, (double(2, 4, width), double(2, width, 3)))


@pytest.mark.parametrize(("n_in", "n_out"), [(3, 5), (5, 3), (4, 4), (3, 20), (20, 3)])
def test_convolution_and_its_gradients_equal_the_formula_edge_by_edge(n_in, n_out):
    block = make_block(3, 3, 3)
    edges = hierarchy(27, block.tets, 1).edges[0]
    conv, batch = VertexConv(edges, 27, n_in, n_out, 4), 2
    torch.nn.init.normal_(conv.bias)
    x = torch.randn(27, batch * n_in, requires_grad=True)

    table, _ = conv.edge_table()
    key = {(int(i), int(j)): e for e, (i, j) in enumerate(conv.pattern.edges)}
    place = [key[(i, j) if conv.mixes_first else (j, i)] for i, j in table.tolist()]
    kernels = torch.einsum("me,mio->eio", conv.coefficients[:, place], conv.bases)
    per_edge = torch.einsum("ebi,eio->ebo", x.view(27, batch, n_in)[table[:, 1]], kernels)
    y = torch.zeros(27, batch, n_out).index_add(0, torch.tensor(table[:, 0]), per_edge) + conv.bias

    found = conv(x)
    torch.testing.assert_close(found, y.reshape(27, -1), rtol=1e-4, atol=1e-5)
    weight = torch.randn_like(found)
    inputs = [x, conv.coefficients, conv.bases, conv.bias]
    gradients = torch.autograd.grad((found * weight).sum(), inputs)
    wanted = torch.autograd.grad((y.reshape(27, -1) * weight).sum(), inputs)
    for a, b in zip(gradients, wanted, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-4)


def test_edge_table_speaks_of_node_and_neighbour_in_either_order():
    edges = hierarchy(27, make_block(3, 3, 3).tets, 1).edges[0]
    for n_in, n_out in ((1, 2), (2, 1)):
        conv = VertexConv(edges, 27, n_in, n_out, 1)
        with torch.no_grad():
            conv.bases.fill_(1.0)
            one = torch.zeros(27, n_in)
            one[13, 0] = 1.0
            answer = conv(one)[:, 0]
        table, coefficients = conv.edge_table()
        to = table[:, 1] == 13
        assert np.array_equal(table, edges)
        np.testing.assert_allclose(answer[table[to, 0]], coefficients[to, 0], rtol=1e-6)


def test_pooling_is_a_mean_with_weights_that_sum_to_one():
    pool = DensityPool(EDGES, 3, 4)
    assert (pool.weights() >= 0).all()
    torch.testing.assert_close(pool(torch.full((4, 2), 7.0)), torch.full((3, 2), 7.0))
    x = torch.randn(4, 2)
    inside = pool(x)
    for i in range(3):
        near = x[EDGES[EDGES[:, 0] == i, 1]]
        assert (inside[i] <= near.max(dim=0).values + 1e-6).all()
        assert (inside[i] >= near.min(dim=0).values - 1e-6).all()


def test_gradients_of_pooling_equal_those_of_the_formula():
    pool, x = DensityPool(EDGES, 3, 4), torch.randn(4, 2, requires_grad=True)
    size = pool.densities.abs()
    dense = torch.zeros(3, 4).index_put((torch.tensor(EDGES[:, 0]), torch.tensor(EDGES[:, 1])), size)
    wanted = (dense / (dense.sum(dim=1, keepdim=True) + 1e-8)) @ x
    weight = torch.randn(3, 2)
    found = torch.autograd.grad((pool(x) * weight).sum(), [pool.densities, x])
    for a, b in zip(found, torch.autograd.grad((wanted * weight).sum(), [pool.densities, x]), strict=True):
        torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-5)
