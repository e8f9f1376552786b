"""One plot style for everything: sober, legible in print, safe for colour-blind readers.

Figures are made without pyplot, so nothing is global and nothing leaks between reports. Series differ by line style as
well as by colour; measured points are open circles and nothing else is.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's set without its yellow, which vanishes on white; in the order in which series take them.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00")
LINES = ("-", "--", "-.", (0, (1, 1.2)), (0, (5, 1, 1, 1, 1, 1)), (0, (8, 2)))
INK, FAINT, SHADE = "#222222", "#8A8A8A", "#EFEFEF"
MEASURED: dict[str, Any] = {"color": INK, "marker": "o", "markerfacecolor": "white", "linestyle": "none", "zorder": 5}
WIDTH_IN, HEIGHT_IN = 6.4, 3.9
DPI = 150

_RC: Any = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.titlelocation": "left",
    "axes.labelcolor": INK,
    "axes.edgecolor": FAINT,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.formatter.useoffset": False,
    "grid.color": "#DDDDDD",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.5,
    "lines.markersize": 5.5,
    "legend.edgecolor": "none",
    "legend.framealpha": 0.9,
    "legend.fontsize": 8.5,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
}


def _picture(**layout: Any) -> Figure:
    """An empty figure that shows itself in a notebook, without pyplot."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    class Picture(Figure):
        def _repr_png_(self) -> bytes:
            return png(self)

    figure = Picture(**layout)
    FigureCanvasAgg(figure)
    return figure


@contextlib.contextmanager
def drawing(
    rows: int = 1, columns: int = 1, height_in: float = HEIGHT_IN, **layout: Any
) -> Iterator[tuple[Figure, Any]]:
    """An empty figure; what is drawn inside the ``with`` has the style.

    `height_in`: height [in]; the width is the same for all.
    Yields `figure`: the figure, for `png`; `axes`: its panels.
    """
    import matplotlib

    with matplotlib.rc_context(_RC):
        figure = _picture(figsize=(WIDTH_IN, height_in), layout="constrained")
        yield figure, figure.subplots(rows, columns, **layout)


def label(quantity: str, unit: str) -> str:
    """The label of an axis: a quantity is never without its unit.

    `quantity`, `unit`: ``"speed"`` and ``"rpm"``; the unit ``"1"`` is left out.
    """
    return quantity if unit == "1" else f"{quantity} ({unit})"


def plain(text: str) -> str:
    """Text of a file or a person, of which nothing is mathematics."""
    return text.replace("$", r"\$")


def name_axes(axes: Axes, x: tuple[str, str], y: tuple[str, str]) -> None:
    """Label both axes."""
    axes.set_xlabel(label(*x))
    axes.set_ylabel(label(*y))


def series(index: int) -> dict[str, Any]:
    """Colour and line style of the n-th series."""
    return {"color": COLOURS[index % len(COLOURS)], "linestyle": LINES[index % len(LINES)]}


def png(figure: Figure) -> bytes:
    """The figure as a PNG file, the same bytes every time."""
    import matplotlib

    stream = io.BytesIO()
    with matplotlib.rc_context(_RC):
        figure.savefig(stream, format="png", dpi=DPI, metadata={"Software": None})
    return stream.getvalue()
