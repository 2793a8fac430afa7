"""The suite itself: what its processes compute once."""

from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from testkit.remembered import folder_made_once, remembered


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

    results = []
    for make in (fails, results.append, results.append):
        try:
            assert folder_made_once(tmp_path, "demo", make) == tmp_path / "demo"
        except ValueError:
            assert make is fails
    assert results == [tmp_path / "demo"]
    assert [path.name for path in (tmp_path / "demo").iterdir()] == ["made"]
