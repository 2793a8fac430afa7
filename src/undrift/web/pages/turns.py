"""Turns by hand."""

from undrift.web.bench import Bench
from undrift.web.frame import frame, text


def page(bench: Bench) -> None:
    """Build the page."""
    with frame(bench, "Turns by hand"):
        text("p", "This page is not there yet.")
