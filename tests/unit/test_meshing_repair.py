"""Surfaces are repaired before they are filled, and every repair is reported."""

import numpy as np
import pytest

from support.surfaces import box, inverted, sphere, together, volume, without
from tissuereg.body.triangles import Triangles, triangle_areas
from tissuereg.errors import MeshError
from tissuereg.meshing.crossings import crossing_pairs
from tissuereg.meshing.holes import least_area_cap
from tissuereg.meshing.repair import repaired
from tissuereg.meshing.shells import winding_number
from tissuereg.meshing.topology import Edges

BALL = sphere()


def order(surface, least_volume=1.0):
    found, summary = repaired(Triangles(*surface), least_volume)
    return found, summary


def is_closed_and_agreed(surface):
    edges = Edges.of(surface.triangles)
    neighbours, same = edges.pairs()
    return (edges.count == 2).all() and not same.any() and 2 * len(neighbours) == 3 * len(surface.triangles)


def test_a_surface_in_order_is_left_as_it_is_and_nothing_is_reported():
    found, summary = order(BALL)
    assert summary == []
    assert found.volume == pytest.approx(volume(BALL), rel=1e-12)
    assert len(found.triangles) == len(BALL[1])


def test_inverted_normals_are_turned_and_reported():
    found, summary = order(inverted(BALL))
    assert found.volume == pytest.approx(volume(BALL), rel=1e-12)
    assert summary == ["all normals pointed inwards and were turned outwards"]


@pytest.mark.parametrize("every", [2, 3, 7])
def test_triangles_that_face_the_other_way_are_turned_and_counted(every):
    vertices, triangles = BALL
    mixed = triangles.copy()
    mixed[::every] = mixed[::every][:, [0, 2, 1]]
    found, summary = order((vertices, mixed))
    assert found.volume == pytest.approx(volume(BALL), rel=1e-12)
    assert is_closed_and_agreed(found)
    # Where half of them face either way, which half is turned is a matter of areas.
    n = len(mixed[::every])
    assert any(summary[0].startswith(f"{count} triangles facing the other way") for count in (n, len(mixed) - n))


def test_a_soup_of_triangles_is_merged_and_reported():
    vertices, triangles = BALL
    found, summary = order((vertices[triangles].reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3)))
    assert len(found.vertices) == len(vertices)
    assert summary == [
        f"{3 * len(triangles) - len(vertices)} vertices that stood at the place of another were merged with it"
    ]


def test_triangles_without_area_and_repeated_ones_go():
    vertices, triangles = BALL
    more = np.concatenate([triangles, triangles[:2], [[0, 0, 5], [4, 5, 5]]])
    found, summary = order((vertices, more))
    assert len(found.triangles) == len(triangles)
    assert summary == ["2 triangles without an area were left out", "2 triangles given a second time were left out"]


def test_a_missing_face_of_a_box_is_closed_to_its_exact_volume():
    open_box = without(box(), [0, 1])
    found, summary = order(open_box)
    assert found.volume == pytest.approx(20 * 20 * 40, rel=1e-12)
    assert is_closed_and_agreed(found)
    (sentence,) = [text for text in summary if "hole" in text]
    assert sentence.startswith("1 hole was closed: the largest has a rim of 4 edges")


def test_half_a_sphere_becomes_half_a_ball():
    vertices, triangles = sphere(subdivisions=3)
    upper = (vertices[triangles].mean(axis=1)[:, 2] > 0).nonzero()[0]
    found, summary = order((vertices, triangles[upper]))
    assert is_closed_and_agreed(found)
    # The rim is a zigzag of one triangle's height, 2.6 mm, about the equator.
    assert found.volume == pytest.approx(volume((vertices, triangles)) / 2, rel=0.05)
    assert "rim of 48 edges" in summary[0]


def test_several_holes_that_share_a_vertex_are_all_closed():
    triangles = BALL[1]
    around = np.flatnonzero((triangles == 0).any(axis=1))
    found, _ = order(without(BALL, [around[0], around[2], 200]))
    assert is_closed_and_agreed(found)
    assert found.volume == pytest.approx(volume(BALL), rel=1e-12)


@pytest.mark.parametrize("seed", range(6))
def test_ragged_holes_are_closed_without_new_walls(seed):
    ball = sphere(subdivisions=3)
    gone = np.random.default_rng(seed).choice(len(ball[1]), 200, replace=False)
    found, summary = order(without(ball, gone))
    assert is_closed_and_agreed(found)
    assert not any("more than two" in sentence for sentence in summary)
    # Caps over two or three missing triangles cut off little of a ball.
    assert found.volume == pytest.approx(volume(ball), rel=0.03)


def test_a_triangle_without_neighbours_is_left_out():
    vertices = np.concatenate([BALL[0], [[30.0, 0, 0], [34, 0, 0], [30, 4, 0]]])
    loose = np.array([[len(vertices) - 3, len(vertices) - 2, len(vertices) - 1]])
    found, summary = order((vertices, np.concatenate([BALL[1], loose])))
    assert len(found.triangles) == len(BALL[1])
    assert summary == ["1 triangle that shared no edge with another was left out"]


def test_a_long_rim_is_closed_by_a_fan():
    angle = np.linspace(0, 2 * np.pi, 401)[:-1]
    rim = np.stack([30 * np.cos(angle), 30 * np.sin(angle), 0 * angle], axis=1)
    k = np.arange(400)
    cone = np.concatenate([rim, [[0, 0, 40.0]]]), np.stack([k, (k + 1) % 400, np.full(400, 400)], axis=1)
    found, summary = order(cone)
    assert is_closed_and_agreed(found)
    assert found.volume == pytest.approx(np.pi * 30**2 * 40 / 3, rel=1e-4)
    assert "rim of 400 edges" in summary[0]


def test_the_cap_of_least_area_is_that_of_all_caps():
    rng = np.random.default_rng(3)

    def every_cap(i, j):
        if j - i < 2:
            yield []
            return
        for k in range(i + 1, j):
            for left in every_cap(i, k):
                for right in every_cap(k, j):
                    yield [(i, k, j), *left, *right]

    for _ in range(5):
        corners = rng.normal(size=(7, 3))
        least = min(triangle_areas(corners[np.array(cap)]).sum() for cap in every_cap(0, 6))
        found = least_area_cap(corners)
        assert len(found) == 5
        assert triangle_areas(corners[found]).sum() == pytest.approx(least, rel=1e-12)


# --- several shells ---


def test_a_wall_that_faces_inwards_is_a_cavity_and_one_that_faces_outwards_is_solid():
    inner = sphere(8.0, subdivisions=1)
    hollow, summary = order(together(BALL, inverted(inner)))
    assert hollow.volume == pytest.approx(volume(BALL) - volume(inner), rel=1e-12)
    assert "kept as a cavity" in summary[0]
    _, summary = order(together(BALL, inner))
    assert "what it encloses was filled as well" in summary[0]
    turned, summary = order(inverted(together(BALL, inverted(inner))))
    assert turned.volume == pytest.approx(hollow.volume, rel=1e-12)
    assert summary[0] == "all normals pointed inwards and were turned outwards"


def test_separate_shells_are_reported_and_each_is_turned_outwards():
    found, summary = order(together(BALL, inverted(sphere(10.0, centre=(50.0, 0.0, 0.0)))))
    assert found.volume == pytest.approx(volume(BALL) + volume(sphere(10.0)), rel=1e-12)
    assert summary[0] == "the normals of 1 of 2 shells pointed inwards and were turned outwards"
    assert summary[1].startswith("2 separate shells (")


def test_a_crumb_less_than_a_tetrahedron_is_left_out():
    crumb = sphere(1.0, centre=(40.0, 0.0, 0.0), subdivisions=0)
    found, summary = order(together(BALL, crumb), least_volume=5.0)
    assert found.volume == pytest.approx(volume(BALL), rel=1e-12)
    assert summary == ["1 shell of at most 2.54 mm^3, less than a tetrahedron, was left out"]


def test_shells_that_cross_are_reported_and_not_taken_for_nested():
    _, summary = order(together(BALL, sphere(20.0, centre=(15.0, 0.3, 0.1))))
    assert summary[0].startswith("2 separate shells")
    assert "pairs of triangles cross each other" in summary[1]


def test_crossings_are_those_that_a_test_of_every_pair_finds():
    rng = np.random.default_rng(0)
    corners = rng.uniform(0, 20, (120, 1, 3)) + rng.normal(0, 3, (120, 3, 3))
    surface = Triangles(corners.reshape(-1, 3), np.arange(360).reshape(-1, 3))

    def passes(p, q, a, b, c):
        matrix = np.stack([q - p, a - b, a - c], axis=1)
        along, s, t = np.linalg.solve(matrix, a - p)
        return 0 < along < 1 and s > 0 and t > 0 and s + t < 1

    expected = [
        (i, j)
        for i in range(120)
        for j in range(i + 1, 120)
        if any(
            passes(u[k], u[(k + 1) % 3], *v)
            for u, v in ((corners[i], corners[j]), (corners[j], corners[i]))
            for k in (0, 1, 2)
        )
    ]
    assert len(expected) > 50
    assert [tuple(pair) for pair in crossing_pairs(surface).tolist()] == expected


def test_the_winding_number_is_one_inside_and_nought_outside():
    corners = BALL[0][BALL[1]]
    assert winding_number(np.array([3.0, -2.0, 9.0]), corners) == pytest.approx(1.0, abs=1e-12)
    assert winding_number(np.array([0.0, 25.0, 0.0]), corners) == pytest.approx(0.0, abs=1e-12)


# --- what is no body ---

SHEET = np.array([[0, 0, 0], [50, 0, 0], [50, 50, 0], [0, 50, 0.0]]), np.array([[0, 1, 2], [0, 2, 3]])


def moebius():
    angle = np.linspace(0, 2 * np.pi, 31)[:-1]
    rim = [
        np.stack([(30 + w * np.cos(angle / 2)) * np.cos(angle), (30 + w * np.cos(angle / 2)) * np.sin(angle)], axis=1)
        for w in (-5, 5)
    ]
    height = [w * np.sin(angle / 2) for w in (-5, 5)]
    vertices = np.concatenate([np.column_stack([xy, z]) for xy, z in zip(rim, height, strict=True)])
    triangles = []
    for k in range(30):
        a, b, c, d = k, (k + 1) % 30, k + 30, (k + 1) % 30 + 30
        if k == 29:
            b, d = d, b
        triangles += [[a, b, d], [a, d, c]]
    return vertices, np.array(triangles)


@pytest.mark.parametrize(
    ("surface", "words"),
    [
        (moebius(), "one side only"),
        (SHEET, "must enclose a body.*it is a sheet"),
        ((box()[0], np.array([[0, 0, 1]])), "triangles with an area; none of 1 has one"),
    ],
    ids=["moebius", "sheet", "no area"],
)
def test_what_encloses_nothing_is_refused(surface, words):
    with pytest.raises(MeshError, match=words):
        order(surface)


@pytest.mark.parametrize(
    ("vertices", "triangles", "words"),
    [
        ([[0, 0, 0], [9, 0, np.nan], [0, 9, 0]], [[0, 1, 2]], "must be finite.*row 1"),
        ([[0, 0, 0], [9, 0, 0], [0, 9, 0]], [[0, 1, 3]], "vertices 0 to 2, got 3"),
        ([[0, 0, 0]], np.empty((0, 3), int), "at least one triangle"),
    ],
)
def test_triangles_are_checked_where_they_are_made(vertices, triangles, words):
    with pytest.raises(MeshError, match=words):
        Triangles(vertices, triangles)
