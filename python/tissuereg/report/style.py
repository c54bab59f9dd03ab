"""Sizes and other constants of the picture of a registration, in one record."""

from dataclasses import dataclass


@dataclass(frozen=True)
class PageStyle:
    """Constants of the picture of a registration; lengths are in figure heights unless a comment names another unit."""

    reasons: int = 3  # reasons that are written out
    lines: int = 2  # of each reason
    letters: int = 160  # of a line
    line: float = 0.027  # height of a line of text
    columns: int = 5  # of the legend
    panels: int = 8  # targets that are enlarged, the first ones
    # Rows and columns of the panels: the first grid with room for all is used.
    grids: tuple[tuple[int, int], ...] = ((1, 1), (2, 1), (3, 1), (2, 2), (3, 2), (4, 2))
    words_inch: float = 0.44  # height of the words above a panel, inch
    bar_inch: float = 0.24  # height of the strip of the scale bar in a panel, inch
    border: float = 1.25  # side of a panel's window over what it shows
    widest: float = 6.5  # widest panel over the radius of its region: farther places are cut off, so that it is seen
    smallest: float = 1e-4  # half a side of the smallest window over the body's extent, where a region has no size
    # Distances of a label from its place that are tried.
    reaches: tuple[float, ...] = (0.05, 0.08, 0.12, 0.17, 0.23, 0.30, 0.38)
    directions: int = 20  # that are tried for a label
    covered: float = 0.08  # cost of covering a place that should stay clear
    on_body: float = 0.15  # cost of covering the body
    crossed: float = 0.4  # cost of a line across a label
    places: int = 25  # tried for a label along each side of the frame, where none around is free
    font: int = 10  # size of letters, points
    widest_label: float = 0.8  # over the width of a view
    gap: float = 0.008  # room between labels
    elevation: float = 18.0  # of both views, degree
    azimuths: tuple[float, float] = (-60.0, 30.0)  # of the views, degree
    # With contacts the views look at the first of them from so many degrees to its left and right.
    aside: tuple[float, float] = (-40.0, 50.0)
    filled: float = 0.74  # share of a view that the body fills along its longer side
    shown: float = 0.99  # share of the nodes whose spread lies within the scale of colours
    size_inch: tuple[float, float] = (13.0, 7.2)  # width and height of a figure, inch
    left: float = 0.012  # left border of the views, over the width of the figure
    right: float = 0.988  # right border, likewise
    panels_from: float = 0.742  # where panels begin, likewise
    low: float = 0.165  # lower end of the views; below are scale, colours and signs
    arrow: float = 0.22  # longest arrow over the extent of the body
    least_arrow: float = 0.45  # shortest arrow over the longest
    labels: int = 8  # with more targets than this, only the flagged ones are labelled
    far_alpha: float = 0.35  # opacity of signs on the far side of the body


STYLE = PageStyle()
