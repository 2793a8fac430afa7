"""The suite itself: which process runs which tests, and what processes compute once."""

import json
import os
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from testkit.pools import ALONE_S, DURATIONS, LONG, POOL, pool_of
from testkit.remembered import folder_made_once, remembered

TESTS = Path(__file__).parent
SUITE = {  # module -> what stands at its head
    "test_one.py": "",
    "test_two.py": "",
    "test_sleeps.py": "import pytest\npytestmark = pytest.mark.waits\n",
    "web_browser/test_page.py": "",
}
LINE = "    open(__file__ + '.ran', 'a').write(f'{{os.getpid()}} {{os.environ.get(\"TEST_POOL\")}} {}\\n')"
CONFTEST = """
from testkit import pools
def pytest_xdist_make_scheduler(config, log):
    return pools.Pools(config, log)
def pytest_ignore_collect(collection_path):
    return True if pools.of_another_pool(collection_path) else None
"""


def _run(folder: Path, *words: str, code: int = 0) -> str:
    """Run a small suite of four modules of nine tests, or more; each test writes its process and its pool beside it."""
    (folder / "web_browser").mkdir()
    for name, head in SUITE.items():
        text = f"import os\n{head}" + "\n".join(f"def test_{i}():\n{LINE.format(i)}" for i in range(9))
        (folder / name).write_text(text)
    (folder / "conftest.py").write_text(CONFTEST)
    (folder / "pytest.ini").write_text(f"[pytest]\nmarkers = waits\npythonpath = {TESTS}\n")
    called = [sys.executable, "-m", "pytest", "-q", "--dist", "loadscope", *words]
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("PYTEST_", POOL))}
    done = subprocess.run(called, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == code, done.stdout
    return done.stdout


def _ran(folder: Path, name: str) -> list[list[str]]:
    return [line.split() for line in (folder / f"{name}.ran").read_text().splitlines()]


def test_tests_of_one_module_run_in_one_process(tmp_path):
    assert "36 passed" in _run(tmp_path, "-n", "2")
    for name in SUITE:
        assert len({process for process, _, _ in _ran(tmp_path, name)}) == 1


def test_each_pool_runs_its_own_modules_and_all_are_run(tmp_path):
    pools = [f"{number}*popen//env:TEST_POOL={pool}" for number, pool in ((2, "compute"), (1, "wait"), (2, "browser"))]
    shown = _run(tmp_path, *(word for pool in pools for word in ("--tx", pool)))
    assert "36 passed" in shown
    assert "[100%]" in shown
    wanted = dict(zip(SUITE, ("compute", "compute", "wait", "browser"), strict=True))
    for name, pool in wanted.items():
        assert {own for _, own, _ in _ran(tmp_path, name)} == {pool}
        assert sorted(int(number) for _, _, number in _ran(tmp_path, name)) == list(range(9))


def test_a_test_that_ends_its_process_fails_and_one_that_hangs_too_and_all_others_are_run(tmp_path):
    ends = "import os, pytest, time\n@pytest.mark.parametrize('n', range(9))\ndef test_it(n):\n    "
    (tmp_path / "test_ends.py").write_text(f"{ends}n == 3 and os._exit(1)\n")
    (tmp_path / "test_hangs.py").write_text(f"{ends}while n == 8: time.sleep(0.01)\n")
    shown = _run(tmp_path, "--tx", "2*popen", "--timeout", "5", code=1)
    assert "2 failed, 52 passed" in shown
    assert "crashed while running 'test_ends.py::test_it[3]'" in shown
    assert "test_hangs.py::test_it[8] - Failed: Timeout" in shown


def test_what_is_alone_in_the_list_of_durations_takes_long():
    taken = json.loads(DURATIONS.read_text())
    assert min(seconds for name, seconds in taken.items() if "::" in name) >= ALONE_S
    assert pool_of(TESTS / "web_browser" / "test_pages.py") == "browser"


def test_what_is_listed_as_long_is_there():
    for test in json.loads(LONG.read_text()):
        module, _, name = test.partition("::")
        assert f"def {name.partition('[')[0]}(" in (TESTS.parent / module).read_text(), test


def _noted(number: int, path: Path) -> int:
    with path.open("a") as file:
        file.write("computed\n")
    return 2 * number


def _ask(folder: Path) -> int:
    return remembered(_noted, folder)(21, folder / "calls")


def test_several_processes_compute_once(tmp_path):
    with ProcessPoolExecutor(2) as pool:
        assert list(pool.map(_ask, [tmp_path] * 6)) == [42] * 6
    assert (tmp_path / "calls").read_text() == "computed\n"
    assert remembered(_noted, tmp_path)(4, tmp_path / "calls") == 8


def test_a_folder_is_made_once_and_again_where_its_making_failed(tmp_path):
    def fails(path: Path) -> None:
        (path / "half").touch()
        raise ValueError

    made = []
    for make in (fails, made.append, made.append):
        try:
            assert folder_made_once(tmp_path, "demo", make) == tmp_path / "demo"
        except ValueError:
            assert make is fails
    assert made == [tmp_path / "demo"]
    assert [path.name for path in (tmp_path / "demo").iterdir()] == ["made"]
