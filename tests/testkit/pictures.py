"""Faults of pictures: text beyond the edge or under a legend."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text

from undrift.report import figures

if TYPE_CHECKING:
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

EDGE_PT = 0.5  # of rounding


def cut_texts(figure: "Figure") -> list[str]:
    """Return every text of a figure that lies beyond its edge, in the sizes that a page has, and every legend on a title."""
    for text in figure.findobj(Text):
        text.set_fontsize(max(text.get_fontsize(), figures.LEAST_SIZE))
        text.set_parse_math(False)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    reach, edge, hidden = figure.bbox, EDGE_PT / 72.0 * figure.dpi, set()
    for axes in figure.axes:
        hidden |= {id(label) for axis in (axes.xaxis, axes.yaxis) for label in _outside(axis)}
        hidden |= set() if axes.axison else {id(text) for text in axes.findobj(Text) if text not in axes.texts}
    results = []
    for text in figure.findobj(Text):
        if id(text) in hidden or not text.get_visible() or not text.get_text().strip():
            continue
        box = text.get_window_extent(canvas.get_renderer())
        over = max(reach.x0 - box.x0, box.x1 - reach.x1, reach.y0 - box.y0, box.y1 - reach.y1)
        if box.width > 0.0 and over > edge:
            results.append(
                f"{text.get_text()!r} by {over / figure.dpi * 72.0:.1f} pt in {figures._describe_figure(figure)[:60]}"
            )
    legends = [*figure.legends, *(axes.get_legend() for axes in figure.axes if axes.get_legend() is not None)]
    titles = [
        figure._suptitle,
        *(part for axes in figure.axes for part in (axes.title, axes._left_title, axes._right_title)),
    ]
    for title in (legend for legend in titles if legend is not None and legend.get_text()):
        box = title.get_window_extent(canvas.get_renderer()).shrunk(0.9, 0.9)
        results += [f"legend on {title.get_text()!r}" for legend in legends if legend.get_window_extent().overlaps(box)]
    return results


def _outside(axis: "Axis") -> Iterator[Any]:
    """Yield the labels of ticks that are not drawn: those outside the limits."""
    low, high = sorted(axis.get_view_interval())
    for tick in (*axis.get_major_ticks(), *axis.get_minor_ticks()):
        if not low - 1e-9 * (high - low) <= tick.get_loc() <= high + 1e-9 * (high - low):
            yield from (tick.label1, tick.label2)


@contextmanager
def pictures_looked_at() -> Iterator[list[str]]:
    """Collect the faults of all pictures drawn in the meantime, on pages and in files."""
    result: list[str] = []
    saved = figures._saved

    def looked_at(figure: "Figure", *words: Any, **how: Any) -> bytes:
        data = saved(figure, *words, **how)
        result.extend(cut_texts(figure))
        return data

    with pytest.MonkeyPatch.context() as values:
        values.setattr(figures, "_saved", looked_at)
        yield result
