"""Panel: live time series in the browser, drawn by uPlot from the binary websocket of feed.py, beside NiceGUI's own socket."""

from collections.abc import Sequence
from pathlib import Path

from nicegui.element import Element

from undrift.errors import InputError
from undrift.web.feed import PLOTS

STATIC = Path(__file__).parent / "static"
SPANS_S = (10, 30, 60)


class Panel(Element, component="static/panel.js"):
    """Plots of what the bench's device sends, below each other: pause, time shown, legend, values in words for screen readers."""

    def __init__(self, plots: Sequence[str] = tuple(PLOTS), *, span_s: int = SPANS_S[0]) -> None:
        unknown = [plot for plot in plots if plot not in PLOTS]
        if unknown or not plots or len(set(plots)) < len(plots) or span_s not in SPANS_S:
            raise InputError(
                f"panel: wanted plots out of {', '.join(PLOTS)}, each once, over {', '.join(map(str, SPANS_S))} s, got "
                f"'{','.join(plots)}' over {span_s} s; name others"
            )
        super().__init__()
        self._props["plots"] = list(plots)
        self._props["span"] = span_s
        self._props["spans"] = list(SPANS_S)
        self.add_resource(STATIC)
