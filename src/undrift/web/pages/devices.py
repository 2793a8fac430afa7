"""Devices."""

from undrift.web.bench import Bench
from undrift.web.frame import frame, text


def page(bench: Bench) -> None:
    """Build the page."""
    with frame(bench, "Devices"):
        text("p", "This page is not there yet.")
