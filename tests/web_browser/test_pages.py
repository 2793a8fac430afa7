"""Every page of the bench: it opens, asks nothing of elsewhere, is accessible, and reads on a narrow screen."""

from collections.abc import Callable
from itertools import product

import pytest
from playwright.sync_api import Page

from undrift.web.parts import texts
from web_browser.conftest import faults_of, measured_faults_of, shoot


@pytest.mark.parametrize("every", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_every_page_opens_and_is_accessible_wide_and_narrow_light_and_dark(
    open_page: Callable[..., Page], every: bool
) -> None:
    """Accessibility takes most of the time: it is judged wide and light, narrow and dark; ``every`` judges all four."""
    page = open_page("/")
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    faults: list[str] = []
    start, here = page.url.rstrip("/"), page.url.split("/")[2]
    for path, name in texts()["pages"].items():
        page.goto(start + path)
        page.wait_for_function("window.socket && window.socket.connected")
        page.get_by_role("heading", level=1, name=name).wait_for()
        for width, scheme in product((1200, 390), ("light", "dark")):
            page.set_viewport_size({"width": width, "height": 900})
            page.emulate_media(color_scheme=scheme)
            shoot(page, f"{name.lower().replace(' ', '-')}-{width}-{scheme}")
            judged = every or (width == 1200) == (scheme == "light")
            found = faults_of(page) if judged else measured_faults_of(page)
            faults += [f"{path} at {width} px, {scheme}: {fault}" for fault in found]
    faults += [
        f"asked of elsewhere: {url}"
        for url in asked
        if not url.startswith((f"http://{here}/", f"ws://{here}/", "data:", "blob:"))
    ]
    assert faults == []
