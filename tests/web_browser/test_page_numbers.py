"""Each number of the JSON that a page of the bench rests on stands on it, whole, on a wide screen and on a narrow one."""

import json
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Page, expect

import undrift
from report import test_page_numbers as numbers
from testkit.bench import BenchServer
from undrift.cli.app import run
from undrift.io.parquet import write_parquet
from undrift.registry.documents import Stated, of_calibration
from undrift.registry.registry import open_registry
from undrift.web.commands import remarks_of
from undrift.web.parts import texts
from web_browser.conftest import shoot, state_serial, step

COMMAND_MS = 60_000
WIDTHS = {1280: 800, 390: 844}
FIGURE = r"(?<![\w/.])(?<!\w-)\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w/]|\.\d)"
WHOLE = numbers._WHOLE.replace("'main'", "'.bench-main'")
# numbers that stand on a page, by the elements that a person sees
ALL = """figure => {
  for (const folded of document.querySelectorAll('.bench-main details')) folded.open = true;
  const walk = document.createTreeWalker(document.querySelector('.bench-main'), NodeFilter.SHOW_TEXT), seen = [];
  while (walk.nextNode()) {
    const shown = walk.currentNode.parentElement;
    if (!shown.closest('svg, caption, datalist, select') && shown.checkVisibility())
      seen.push(...[...walk.currentNode.data.matchAll(new RegExp(figure, 'g'))].map(one => one[0]));
  }
  return seen;
}"""


@pytest.fixture
def filled(bench_server: BenchServer, tmp_path: Path) -> BenchServer:
    """Fill the registry of a bench: a device with three calibrations, of which the last differs."""
    rng, now = np.random.default_rng(7), datetime.now(UTC)
    device = undrift.random_device(rng)
    known = undrift.calibrate(undrift.simulate_session("bench", device, rng=rng))
    with open_registry(str(tmp_path / "registry.sqlite"), station="bench") as registry:
        for days_ago, gain in ((400, 1.0), (200, 1.0), (20, 1.004)):
            made = replace(
                known.provenance,
                created=(now - timedelta(days=days_ago)).isoformat(),
                inputs=((f"{days_ago}", f"{days_ago}"),),
            )
            triad = replace(known.gyro, matrix=gain * known.gyro.matrix)
            model = replace(known, device="A17", provenance=made, gyro=triad)
            registry.add(of_calibration(model, Stated(note="each year"), source="test"))
    return bench_server


def whole_on(page: Page, name: str) -> dict[int, list[tuple[float, float]]]:
    """Assert that each number is whole at each width; return those that stand there."""
    shown, lost = dict[int, list[tuple[float, float]]](), dict[int, Counter[str]]()
    for width, height in WIDTHS.items():
        page.set_viewport_size({"width": width, "height": height})
        page.wait_for_timeout(100)
        every, whole = page.evaluate(ALL, FIGURE), page.evaluate(WHOLE, FIGURE)
        shown[width], lost[width] = numbers.figures_in("\n".join(whole)), Counter(every) - Counter(whole)
        shoot(page, f"numbers-{name}-{width}")
    print(f"{name}: {len(shown[1280])} numbers")
    assert not any(lost.values()), f"{name}: {lost}"
    return shown


def missing_of(data: object, shown: dict[int, list[tuple[float, float]]]) -> set[str]:
    """Return what JSON has and a page has not, at some width."""
    return {
        f"{path} = {value:.6g} at {width} px"
        for path, value in numbers.leaves_of(data)
        for width, figures in shown.items()
        if not any(is_shown_as(value, *figure) for figure in figures)
    }


def is_shown_as(value: float, figure: float, last: float) -> bool:
    """Whether a figure is a number as it is, or rounded to two digits or hundredths; last is the unit of its last digit."""
    return bool(np.isclose(figure, value, atol=0.0)) or (
        abs(figure - value) <= 0.5001 * last <= 0.5001 * max(0.1 * value, 0.01)
    )


@pytest.fixture
def answer(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[..., Any]:
    """Return what a command answers as JSON."""
    monkeypatch.setenv("UNDRIFT_REGISTRY", str(tmp_path / "registry.sqlite"))

    def answered(*words: object) -> Any:
        capsys.readouterr()
        assert run([*map(str, words), "--json"]) == 0
        made = json.loads(capsys.readouterr().out)
        return {key: value for key, value in made.items() if key not in numbers.common.ENVELOPE}

    return answered


@pytest.mark.slow
def test_the_registry_shows_each_number_whole_on_both_screens(
    filled: BenchServer, open_page: Callable[..., Page], answer: Callable[..., Any]
) -> None:
    page = open_page("/registry")
    page.set_default_timeout(COMMAND_MS)
    page.get_by_role("button", name="A17", exact=True).click()
    expect(page.locator(".bench-main")).to_contain_text("sigma since", timeout=COMMAND_MS)
    shown = whole_on(page, "registry")
    listed, trend = answer("registry", "list"), answer("registry", "trend", "--serial", "A17")
    entries = answer("registry", "list", "--serial", "A17")
    changes = [{key: one[key] for key in ("change", "uncertainty", "sigmas")} for one in trend["steps"][-1]["changes"]]
    changes = [one for one in changes if abs(one["change"]) > 1e-12]  # less is what rounding leaves
    assert changes
    data = {
        "list": listed,
        "entries": entries,
        "trend": trend,
        "changes": {"row": {str(k): one for k, one in enumerate(changes)}},
    }
    missing = missing_of(data, shown)
    assert not missing, "\n".join(sorted(missing))


@pytest.mark.slow
def test_what_is_said_of_a_recording_stands_whole_on_check_calibrate_and_use(
    bench_server: BenchServer, open_page: Callable[..., Page], answer: Callable[..., Any], tmp_path: Path
) -> None:
    rng = np.random.default_rng(7)
    device = undrift.random_device(rng)
    (record,) = undrift.simulate_session("ferraris", device, rng=rng, labelled=False).records
    write_parquet(record, tmp_path / "turns.parquet")
    page = open_page("/check")
    page.set_default_timeout(COMMAND_MS)
    page.get_by_label("Choose files").set_input_files(tmp_path / "turns.parquet")
    page.get_by_role("heading", name="turns.parquet").wait_for()
    page.locator(".panel-plot canvas").first.wait_for()
    (about,) = (json.loads(path.read_text())["about"] for path in bench_server.folder.glob("uploads/*/.bench.json"))
    said = {"samples": about["rows"], "sample_rate_hz": about["sample_rate_hz"], "at_rest": about["trace"]["at_rest"]}
    missing = missing_of(said | {"duration_s": about["duration_s"]}, whole_on(page, "check"))
    step(page, "Calibrate")
    state_serial(page)
    page.get_by_label("Angle of its turns, deg").fill("360")
    page.get_by_role("button", name="Calibrate", exact=True).click()
    page.get_by_role("heading", name="Verdict:").wait_for()
    (job,) = bench_server.folder.glob("jobs/*/calibration.json")
    noticed = [f"{one.text} {one.action}" for one in remarks_of(json.loads(job.read_text()))]
    figures = {str(k): value for k, (value, _) in enumerate(numbers.figures_in("\n".join(noticed)))}
    missing |= missing_of({"remarks": figures}, whole_on(page, "calibrate"))
    step(page, "Use")
    page.get_by_role("button", name="What does each give here?").click()
    expect(page.get_by_text("motion: ")).to_be_visible(timeout=COMMAND_MS)
    page.get_by_role("button", name="Correct", exact=True).click()
    expect(page.get_by_role("heading", name="Results")).to_be_visible(timeout=COMMAND_MS)
    shown = whole_on(page, "use")
    words = "correct", tmp_path / "turns.parquet", "--calibration", job, "-o", tmp_path / "made.parquet", "--offset"
    for offset in ("rest", "motion"):
        with_offset = answer(*words, offset)["recordings"][0]["rest"]
        missing |= missing_of({offset: {"offset_dps": with_offset["offset_dps"]}}, shown)
    assert not missing, "\n".join(sorted(missing))


@pytest.mark.slow
def test_no_other_page_cuts_a_number(open_page: Callable[..., Page]) -> None:
    page = open_page("/")
    start = page.url.rstrip("/")
    for path, name in texts()["pages"].items():
        page.goto(start + path)
        page.get_by_role("heading", level=1, name=name).wait_for()
        page.wait_for_timeout(300)
        whole_on(page, f"empty {name.lower()}".replace(" ", "-"))
