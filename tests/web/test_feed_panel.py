"""Panel: it shows plots that there are; what it draws with is here, with its licence."""

import re

import pytest

from undrift.errors import InputError
from undrift.web.feed import STATIC, Panel


@pytest.mark.parametrize(("plots", "span_s"), [(("secrets",), 10), ((), 10), (("rate", "rate"), 10), (("rate",), 11)])
def test_plots_and_spans_that_there_are_not_are_refused(plots: tuple[str, ...], span_s: int) -> None:
    with pytest.raises(InputError, match="panel: wanted plots out of rate, accel, pitch, temp, each once, over 10, 30"):
        Panel(plots, span_s=span_s)


def test_the_plotting_library_is_here_with_its_licence_and_version() -> None:
    named = dict(re.findall(r"^\| (\w+) \| .* \| ([\d.]+) \| MIT", (STATIC / "README.md").read_text(), re.M))
    folders = {path.name for path in STATIC.iterdir() if path.is_dir()}
    assert set(named) == folders
    assert f"(v{named['uplot']})" in (STATIC / "uplot" / "uPlot.iife.min.js").read_text()[:100]
    assert (STATIC / "uplot" / "LICENSE").read_text().startswith("The MIT License (MIT)")


def test_nothing_in_the_folder_asks_elsewhere() -> None:
    for path in [*STATIC.glob("*.js"), *STATIC.glob("*.css"), *(STATIC / "uplot").glob("*.min.*")]:
        asked = re.findall(r"""(?:src|href|import|fetch\(|url\()\s*[=(]?\s*["']?https?://""", path.read_text())
        assert asked == [], path


def test_the_page_reads_the_frames_that_the_feed_writes() -> None:
    """The header's places in panel.js are those of feed.py: a change of one without the other fails here."""
    from undrift.web.feed import HEADER, MAGIC

    script = (STATIC / "panel.js").read_text()
    assert f"getUint32(0) !== 0x{int.from_bytes(MAGIC, 'big'):x}" in script
    read = dict(re.findall(r"(\w+) = view\.get(?:Uint8|Uint16|Uint32|Float64)\((\d+)", script))
    assert {"number": "8", "rows": "12", "start": "16"}.items() <= read.items()
    assert f"new Float32Array(buffer, {HEADER.size})" in script
