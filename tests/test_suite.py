"""The suite itself: which tests run in one process."""

import subprocess
import sys
from pathlib import Path

from conftest import SHARING, Modules

TESTS = Path(__file__).parent


def test_a_module_is_not_split_and_modules_that_share_stay_together():
    groups = {Modules._split_scope(None, f"{module}::test_a[x::y]") for module in SHARING}
    assert groups == {SHARING[0]}
    assert Modules._split_scope(None, "tests/io/test_text.py::test_b") == "tests/io/test_text.py"
    assert [module for module in SHARING if not (TESTS.parent / module).is_file()] == []


def test_tests_of_one_module_run_in_one_process(tmp_path):
    names = ("test_one.py", "test_two.py")
    for name in names:
        lines = [
            f"def test_{i}():\n    open({str(tmp_path / name)!r} + '.pid', 'a').write(f'{{os.getpid()}}\\n')"
            for i in range(9)
        ]
        (tmp_path / name).write_text("import os\n" + "\n".join(lines))
    (tmp_path / "conftest.py").write_text((TESTS / "conftest.py").read_text())
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-n", "2", "--dist", "loadscope", "--no-loadscope-reorder", *names],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout
    assert [len(set((tmp_path / f"{name}.pid").read_text().split())) for name in names] == [1, 1]
