"""How a page looks: one record of its sizes."""

from dataclasses import dataclass


@dataclass(frozen=True)
class PageStyle:
    """Sizes of a page's picture. Lengths are in heights of the figure unless another unit is named.

    Attributes
    ----------
    reasons : int
        Reasons that are written out,
    lines : int
        lines of each,
    letters : int
        and letters of a line.
    line : float
        Height of a line of text.
    columns : int
        Columns of the legend.
    panels : int
        Targets that are enlarged, the first ones.
    grids : tuple
        Rows and columns of the panels; the first grid with room for all is used.
    words_inch : float
        Height of the words above a panel, inch,
    bar_inch : float
        and of the strip of the scale bar in it.
    border : float
        Side of a panel's window over what it shows.
    widest : float
        A panel is at most this wide, over the radius of its region: farther places are cut off, so that it is seen.
    smallest : float
        Half a side of the smallest window over the extent of the body, where a region has no size.
    reaches : tuple of float
        Distances of a label from its place that are tried.
    directions : int
        Directions that are tried.
    covered : float
        Cost of covering a place that should stay clear,
    on_body : float
        of covering the body,
    crossed : float
        and of a line across a label.
    places : int
        Places along each side of the frame that are tried where none around is free.
    font : int
        Size of letters, points.
    widest_label : float
        Widest label, over the width of a view.
    gap : float
        Room between labels.
    elevation : float
        Elevation of both views, degree,
    azimuths : tuple of float
        and their azimuths.
    aside : tuple of float
        With contacts, the views look at the first of them from this many degrees to its left and right.
    filled : float
        Share of a view that the body fills along its longer side.
    shown : float
        Share of the nodes whose spread lies within the scale of colours.
    size_inch : tuple of float
        Width and height of a figure, inch.
    left : float
        Left border of the views, over the width of the figure,
    right : float
        the right one,
    panels_from : float
        and where panels begin.
    low : float
        Lower end of the views; below are scale, colours and signs.
    arrow : float
        Longest arrow over the extent of the body,
    least_arrow : float
        and the shortest over the longest.
    labels : int
        If there are more targets than this, only the flagged ones are labelled.
    far_alpha : float
        Opacity of signs on the far side of the body.
    """

    reasons: int = 3
    lines: int = 2
    letters: int = 160
    line: float = 0.027
    columns: int = 5
    panels: int = 8
    grids: tuple[tuple[int, int], ...] = ((1, 1), (2, 1), (3, 1), (2, 2), (3, 2), (4, 2))
    words_inch: float = 0.44
    bar_inch: float = 0.24
    border: float = 1.25
    widest: float = 6.5
    smallest: float = 1e-4
    reaches: tuple[float, ...] = (0.05, 0.08, 0.12, 0.17, 0.23, 0.30, 0.38)
    directions: int = 20
    covered: float = 0.08
    on_body: float = 0.15
    crossed: float = 0.4
    places: int = 25
    font: int = 10
    widest_label: float = 0.8
    gap: float = 0.008
    elevation: float = 18.0
    azimuths: tuple[float, float] = (-60.0, 30.0)
    aside: tuple[float, float] = (-40.0, 50.0)
    filled: float = 0.74
    shown: float = 0.99
    size_inch: tuple[float, float] = (13.0, 7.2)
    left: float = 0.012
    right: float = 0.988
    panels_from: float = 0.742
    low: float = 0.165
    arrow: float = 0.22
    least_arrow: float = 0.45
    labels: int = 8
    far_alpha: float = 0.35


STYLE = PageStyle()
