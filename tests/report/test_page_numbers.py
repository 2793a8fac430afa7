"""Each number of a command's JSON stands in full in every rendering: terminals, pages on two screens, and paper.

A command is called once. What its JSON states must be in its text and on its page, in the digits that are shown there; and what is
there must be whole at every width. A new command is one line in the table of calls (``cli/test_app_envelope.py``).
"""

import re
import shlex
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import pytest

from cli.test_app_envelope import GOOD, LEAVES, WARM
from report.test_page_browser import rig_run
from testkit.bench_and_commands import make_bench
from testkit.command_line import at_rest
from testkit.data import data_path
from testkit.pages import PRINTED_PX, WIDTHS, browser
from testkit.pdf_text import text_of
from testkit.remembered import folder_made_once, run_folder
from testkit.terminal import Widths
from undrift.base.summary import Section, Summary, plain
from undrift.cli import common
from undrift.cli.app import run
from undrift.io.formats import write_record
from undrift.io.session import read_session
from undrift.io.store import read_calibration, write_calibration
from undrift.report.page import write_page
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

pytestmark = pytest.mark.usefixtures("computed_once")
SERIAL = "SIM-3371AC5390A5"  # of the bench's device
LONG = {  # calls of commands that take longer than those of the table; later ones read what earlier ones wrote
    "registry show": "registry show 1",
    "registry find": f"registry find --serial {SERIAL}",
    "registry trend": f"registry trend --serial {SERIAL}",
    "twin": "twin {broad} --gravity-m-s2 9.813",
    "study": "study {here}/study.toml -o {here}/study --workers 1 --no-rivals --seed 3",
}
WITHOUT = {
    "demo": "a page of the commands above, tests/commands/test_demo.py",
    "bench": "an address",
    "registry prior": "of many devices",
    **dict.fromkeys(("rig emulate", "rig stop", "rig status", "rig check"), "addresses and states of a table"),
}
EXCEPT = {  # numbers of JSON that no reader needs as figures, and why
    "*covariance*": "the matrix is for programs: standard uncertainties stand in brackets",
    "*.budget.*": "variances of single parameters by their source, for programs: the certificate has their sums",
    "registry show: document.*": "the calibration itself, as its own command shows it",
    "*.values.*": "of findings, whose sentences have those that matter",
    "drift: file_map.*": "how the file was read, as it was stated",
    "noise: adev.*": "the curve that is drawn",
    "noise: taus_s": "the curve that is drawn",
    "*.uncertainty_parts_*": "parts that round to nothing beside the others",
    "noise: *.interval": "from zero: the table says under",
    "noise: angle_after_60_s_deg.*_*": "the answer has the terms of the worst axis, the table the angle of each",
    "registry [ai]*: *valid_temp_c": "of what was added, which list and show state",
    "sync: *.next_best_leaves_times": "a finding has it where it is small",
    "drift: gyro.matrix": "the unit of the readings: rests show no scale",
    "drift: reference_temp_c": "where the tables are zero, in the middle of what was seen",
    "drift: *.gyro_visit": "a part of the uncertainties of the table",
    "calibrate: *.g_sensitivity": "a matrix, of which the text has the greatest",
    "registry list: devices.days_left": "the due date is shown",
    "session new: recordings": "a count of files, which are named",
    "registry trend: *.entry": "the date of the calibration is shown",
}
STUDY = """
[study]
name = "small"
subjects = 4
[[task]]
name = "step"
[task.space]
cutoff_hz = [5.0, 11.1]
turn_rate_step_dps = [10.0]
turn_rate_min_dps = [10.0]
turn_rate_max_dps = [50.0, 90.0]
[task.protocol]
dwell_s = 1.0
"""
CURVE = 12  # values: a longer list is drawn, and is in the file
NUMBER = re.compile(r"(?<![\w.])(\d+(?:\.\d+)?)(?:e([-+]?\d+))?")
FIGURE = r"(?<![\w/.])(?<!\w-)\d+(?:\.\d+)?(?![\w/]|\.\d)"  # no part of an address; of one that is broken, two
FACTORS = {  # from the unit of a key to those that are shown
    "rad(_s)?": (1.0, 1.0 / RADIAN_PER_DEGREE),
    "m_s2": (1.0, 1e3 / STANDARD_GRAVITY, 1e6 / STANDARD_GRAVITY),
    "_s": (1.0, 1e3, 1.0 / 60.0, 1.0 / 3600.0),
}
_WHOLE = """figure => {
  const whole = (box, e) => {
    for (; e.parentElement; e = e.parentElement) {
      const flow = getComputedStyle(e).overflowX, r = e.getBoundingClientRect();
      if (flow === 'visible') continue;
      const scrolls = flow === 'auto' || flow === 'scroll', left = r.left - (scrolls ? e.scrollLeft : 0);
      if (box.left < left - 1 || box.right > left + (scrolls ? e.scrollWidth : r.width) + 1) return false;
      box = r;
    }
    return box.width > 0 && box.height > 0 && box.left >= 0 && box.right <= document.documentElement.clientWidth + 1;
  };
  for (const folded of document.querySelectorAll('details')) folded.open = true;
  const walk = document.createTreeWalker(document.querySelector('main'), NodeFilter.SHOW_TEXT), seen = [];
  while (walk.nextNode()) {
    const node = walk.currentNode;
    if (node.parentElement.closest('svg, caption')) continue;
    const head = node.parentElement.closest('.cards thead th');
    if (head && getComputedStyle(head.closest('thead')).display === 'none') {  // a card names its head before each cell
      const cells = [...head.closest('table').tBodies[0].rows].map((row) => row.cells[head.cellIndex]);
      const named = cells.filter((cell) => getComputedStyle(cell, '::before').content.includes(node.data));
      const there = named.some((cell) => whole(cell.getBoundingClientRect(), cell.parentElement));
      if (there) seen.push(...node.data.match(new RegExp(figure, 'g')) || []);
      continue;
    }
    for (const one of node.data.matchAll(new RegExp(figure, 'g'))) {
      const range = document.createRange();
      range.setStart(node, one.index); range.setEnd(node, one.index + one[0].length);
      const boxes = range.getClientRects();
      if (boxes.length === 1 && whole(boxes[0], node.parentElement)) seen.push(one[0]);
    }
  }
  return seen;
}"""


@pytest.fixture(scope="module")
def summaries(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Summary]:
    """Return what each command has to say."""
    here, made = tmp_path_factory.mktemp("here"), dict[str, Summary]()
    bench = folder_made_once(run_folder(tmp_path_factory), "bench", make_bench)
    (here / "warm.toml").write_text(WARM)
    (here / "study.toml").write_text(STUDY)
    at_rest(here, "rest.csv")
    write_record(read_session(bench / "session").records[0], here / "bare.parquet")
    places = {"bench": bench, "here": here, "warm": data_path("thermal_mpu6050_warmup", "Tempdata01-02-14.csv.gz")}
    places["broad"] = data_path("broad", "35_disturbed_attached_magnet_4cm.hdf5")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("UNDRIFT_REGISTRY", str(here / "registry.sqlite"))
        patch.chdir(here)
        first = read_calibration(bench / "calibration.json")
        write_calibration(
            replace(first, gyro=replace(first.gyro, offset=1.01 * first.gyro.offset)), here / "second.json"
        )
        assert run(["registry", "add", "second.json"]) == 0
        for name, call in ({name: call for name, (call, _) in GOOD.items()} | LONG).items():
            patch.setattr(common, "show", lambda summary, name=name, **_: made.setdefault(name, summary))
            assert run(shlex.split(call.format(**places))) in (0, 1), name
    return made | {"rig run": rig_run().summary()}


def test_every_command_is_looked_at() -> None:
    assert {*GOOD, *LONG, *WITHOUT, "rig run"} == set(LEAVES)


def sections_of(summary: Summary) -> list[Section]:
    return [
        one
        for one in (*summary.sections, *summary.page())
        if one.on != "terminal" and (one.text or one.findings or one.rows)
    ]


def page_text(summary: Summary) -> str:
    """Return all that a page says, generically: each text of a summary, whatever a page makes of it."""
    findings = [*(summary.verdict.findings if summary.verdict else ()), *summary.findings]
    texts = [summary.answer, *summary.notes]
    for section in sections_of(summary):
        findings += section.findings
        heads = section.columns if section.rows else ()
        texts += (section.title, *section.text, *heads, *(cell for row in section.rows for cell in row))
    return "\n".join((*texts, *(f"{one.headline} {one.detail} {one.action}" for one in findings)))


def terminal_of(summary: Summary) -> Widths:
    widths = Widths()
    with widths.watching():
        common.show(summary, details=True)
    return widths


def leaves_of(value: object, path: str = "") -> Iterator[tuple[str, float]]:
    """Yield the numbers of JSON with their paths; curves and matrices are drawn, and stand in files."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield from leaves_of(item, f"{path}.{key}".strip("."))
    elif isinstance(value, list):
        if len(value) <= CURVE:
            for item in value:
                yield from leaves_of(item, path)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield path, abs(value)


def stands_in(path: str, value: float, shown: list[tuple[float, float]]) -> bool:
    """Whether a number is shown as it is, or to a decimal place or two digits; as a zero to two places."""
    factors = next((f for unit, f in FACTORS.items() if re.search(rf"{unit}(\.|$)", path)), (1.0, 100.0))
    return any(
        abs(factor * value - figure) <= 0.5001 * last
        and (figure == value or ((last < 1.0 or figure >= 10.0 or factor == 100.0) and (figure > 0.0 or last <= 0.01)))
        for factor in factors
        for figure, last in shown
    )


def figures_in(text: str) -> list[tuple[float, float]]:
    """Return each number of a text with the unit of its last digit."""
    found = ((one[1], int(one[2] or 0)) for one in NUMBER.finditer(text))
    return [(float(f"{d}e{e}"), 10.0 ** (e - len(d.partition(".")[2]))) for d, e in found if abs(e) < 300]


def missing_of(summary: Summary) -> dict[str, str]:
    """Return the numbers of JSON that a terminal or a page does not state, by their paths."""
    data: Any = plain({key: value for key, value in summary.data.items() if key not in common.ENVELOPE})
    made, missing = {"terminal": terminal_of(summary).whole.getvalue(), "page": page_text(summary)}, {}
    for where, text in made.items():
        shown = figures_in(text)
        for path, value in leaves_of(data):
            if not stands_in(path, value, shown):
                missing.setdefault(path, f" {where}: {value:.6g}")
    return missing


def test_each_number_of_json_is_on_the_terminal_and_on_the_page(summaries: dict[str, Summary]) -> None:
    missing = {f"{name}: {path}": text for name, one in summaries.items() for path, text in missing_of(one).items()}
    unused = [name for name in EXCEPT if not any(fnmatch(path, name) for path in missing)]
    lost = [f"{path}{text}" for path, text in missing.items() if not any(fnmatch(path, name) for name in EXCEPT)]
    assert not lost, "\n".join(lost)
    assert not unused


def test_no_terminal_cuts_what_the_details_state(summaries: dict[str, Summary]) -> None:
    cut = [f"{name}: {text}" for name, summary in summaries.items() for text in terminal_of(summary).differences()]
    assert not cut, "\n".join(cut)


@pytest.mark.slow
def test_every_screen_and_paper_show_each_number_whole(summaries: dict[str, Summary], tmp_path: Path) -> None:
    cut, page, paper = [], tmp_path / "page.html", tmp_path / "page.pdf"
    with browser() as held:
        tab = held.new_page()
        for name, summary in summaries.items():
            write_page(page, summary)
            wanted = Counter(re.findall(FIGURE, page_text(summary)))
            tab.goto(page.as_uri())
            for width, media in (*((width, "screen") for width in WIDTHS), (PRINTED_PX, "print")):
                tab.set_viewport_size({"width": width, "height": 900})
                tab.emulate_media(media=media)
                lost = wanted - Counter(tab.evaluate(_WHOLE, FIGURE))
                cut += [f"{name} at {width} px, {media}: {dict(lost)}"] if lost else []
            tab.goto(page.as_uri())
            tab.pdf(path=paper, format="A4")
            lost = wanted - Counter(re.findall(FIGURE, text_of(paper)))
            cut += [f"{name} on A4: {dict(lost)}"] if lost else []
    assert not cut, "\n".join(cut)
