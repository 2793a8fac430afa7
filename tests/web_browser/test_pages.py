"""Every page of the bench: it opens, asks nothing of elsewhere, is accessible, and reads on a narrow screen."""

from collections.abc import Callable

import pytest
from playwright.sync_api import Page

from undrift.web.parts import PAGES
from web_browser.conftest import faults_of, shoot


@pytest.mark.parametrize("width", [1200, 390])
@pytest.mark.parametrize("dark", [False, True])
def test_every_page_opens_and_is_accessible_wide_and_narrow_light_and_dark(
    open_page: Callable[..., Page], width: int, dark: bool
) -> None:
    page = open_page("/", width=width, color_scheme="dark" if dark else "light")
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    faults: list[str] = []
    for path, name in PAGES.items():
        page.goto(page.url.split("//")[0] + "//" + page.url.split("/")[2] + path)
        page.wait_for_function("window.socket && window.socket.connected")
        page.get_by_role("heading", level=1, name=name).wait_for()
        shoot(page, f"{name.lower().replace(' ', '-')}-{width}{'-dark' if dark else ''}")
        faults += [f"{path}: {fault}" for fault in faults_of(page)]
    here = page.url.split("/")[2]
    faults += [
        f"asked of elsewhere: {url}"
        for url in asked
        if not url.startswith((f"http://{here}/", f"ws://{here}/", "data:", "blob:"))
    ]
    assert faults == []
