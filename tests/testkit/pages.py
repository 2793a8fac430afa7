"""Requirements for every report page, in its text and in a browser."""

import re
from collections.abc import Container, Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

CHROMIUM = ("/usr/bin/chromium", "/usr/bin/chromium-browser", "/usr/bin/google-chrome")
WIDTHS, LEAST_PX = (1280, 390), 9.0  # CSS pixels, and the smallest text of figures on the narrow screen
SCHEMES = ("light", "dark")
CORNERS = tuple(zip(WIDTHS, SCHEMES, strict=True))
PRINTED_PX = 680  # an A4 page less two margins of 15 mm, at 96 px an inch

_MEASURED = """() => {
  for (const folded of document.querySelectorAll('details')) folded.open = true;
  const scale = t => { const m = t.getScreenCTM(); return parseFloat(getComputedStyle(t).fontSize) * Math.hypot(m.a, m.b); };
  return { beyond: document.documentElement.scrollWidth - innerWidth,
           least: Math.min(99, ...[...document.querySelectorAll('svg text, svg tspan')].map(scale)) };
}"""
_CUT = """() => {
  const broken = cell => [...cell.childNodes].filter(n => n.nodeType === 3).some(node =>
    [...node.data.matchAll(/[A-Za-z0-9.]+/g)].some(word => {
      const range = document.createRange();
      range.setStart(node, word.index); range.setEnd(node, word.index + word[0].length);
      return new Set([...range.getClientRects()].map(r => Math.round(r.top))).size > 1; }));
  const wide = document.documentElement.clientWidth + 1, all = q => [...document.querySelectorAll(q)];
  return [...all('svg, table, p, dd').filter(e => e.getBoundingClientRect().right > wide).map(e => e.tagName),
          ...all('th, td').filter(broken).map(e => 'a word of "' + e.textContent + '"'),
          ...all('details').filter(d => d.lastElementChild.getBoundingClientRect().height < 2).map(() => 'folded')];
}"""


def faults_of(text: str) -> list[str]:
    """Return missing parts, labels and captions of a page, and its external resources."""
    bare = re.sub(r"<a [^>]*>", "", text)
    svgs, tables = re.findall(r"<svg\b[^>]*>", text), re.findall(r"<table\b.*?</table>", text, re.S)
    levels = [int(level) for level in re.findall(r"<h([1-6])\b", text)]
    wanted = {
        "language": '<html lang="en">' in text,
        "one h1": levels.count(1) == 1 and levels[:1] == [1],
        "headings in order": all(b <= a + 1 for a, b in pairwise(levels)),
        "answer": re.search(r'<p class="answer">[^<]{20,}</p>', text),
        "provenance": all(
            part in text for part in ("<dt>Command</dt>", "<dt>Date</dt>", "<dt>Versions</dt>", "sha256")
        ),
        "at most three findings open": _open_findings(text) <= 3,
        "labelled pictures": all('role="img"' in svg and re.search(r'aria-label="[^"]{8,}"', svg) for svg in svgs),
        "captions": all("<caption" in table and 'scope="col"' in table and 'scope="row"' in table for table in tables),
        "nothing fetched": not re.search(r"https?:|@import|url\((?!#)|<script|<link|<img|\bsrc=", bare),
        "numbers": ">nan<" not in text,
    }
    return [what for what, there in wanted.items() if not there]


def _open_findings(text: str) -> int:
    """Return the number of findings visible at the verdict without unfolding."""
    result = re.search(r'<section class="verdict.*?</section>', text, re.S)
    return 0 if result is None else result[0].partition("<details>")[0].count("<li>")


_BESIDE = """[...document.querySelectorAll(".cards :is(th, td)")]
    .filter((cell) => cell.getBoundingClientRect().right > innerWidth).length"""


@contextmanager
def browser(playwright: Any) -> Iterator[Any]:
    """Start Debian's chromium, or skip the test if it is missing."""
    path = next((name for name in CHROMIUM if Path(name).exists()), None)
    if path is None:
        pytest.skip("no chromium on this machine: make test installs it on Debian")
    result = playwright.chromium.launch(executable_path=path, args=["--no-sandbox", "--disable-gpu"])
    try:
        yield result
    finally:
        result.close()


def seen_in(held: Any, page: Path, *, judged: Container[tuple[int, str]] = CORNERS) -> list[str]:
    """Return the faults of a page in the browser, at each width and in each scheme, and in print.

    Accessibility takes most of the time and is ``judged`` at two corners. Effects of the width occur in either scheme,
    and contrast is the same at either width.
    """
    from axe_playwright_python.sync_playwright import Axe

    wrong, tab = [], held.new_page()
    tab.goto(page.resolve().as_uri())
    for width in WIDTHS:
        tab.set_viewport_size({"width": width, "height": 900})
        for scheme in SCHEMES:
            tab.emulate_media(color_scheme=scheme)
            result, where = tab.evaluate(_MEASURED), f"{page.name} at {width} px, {scheme}"
            if result["beyond"] > 0:
                wrong.append(f"{where}: {result['beyond']} px beyond the screen")
            if width == min(WIDTHS) and result["least"] < LEAST_PX:
                wrong.append(f"{where}: text of {result['least']:.2f} px in a figure")
            if width == min(WIDTHS) and (count := tab.evaluate(_BESIDE)):
                wrong.append(f"{where}: {count} cells of tables wait beside the screen")
            if (width, scheme) not in judged:
                continue
            violations = Axe().run(tab, options={"resultTypes": ["violations"]}).response["violations"]
            wrong += [
                f"{where}: {violation['id']}, {violation['nodes'][0]['html'][:80]}"
                for violation in violations
                if violation["impact"] in ("serious", "critical")
            ]
    tab.evaluate("for (const folded of document.querySelectorAll('details')) folded.open = false")
    tab.set_viewport_size({"width": PRINTED_PX, "height": 1000})
    tab.emulate_media(media="print", color_scheme="light")
    wrong += [f"{page.name} in print: {name} is cut" for name in tab.evaluate(_CUT)]
    if not tab.pdf(format="A4").startswith(b"%PDF"):
        wrong.append(f"{page.name}: no PDF")
    tab.close()
    return wrong
