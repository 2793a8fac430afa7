"""The command line called in process, and the content of a folder, for the tests of commands."""

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from undrift.cli.app import run
from undrift.cli.call import app
from undrift.io.formats import read_record, write_record
from undrift.io.store import read_calibration, write_calibration
from undrift.model import DriftTables, StaticDrift
from undrift.record import Record

PROGRESS = re.compile(r"^undrift \w+(?: \w+)?: .+, \d+ s so far.*\n", re.MULTILINE)  # of a slow machine


@dataclass(frozen=True)
class Answer:
    code: int
    out: str
    err: str

    def json(self) -> dict[str, Any]:
        """Return the one object on stdout."""
        assert self.out.count("\n") == 1
        assert self.out.endswith("}\n")
        values = json.loads(self.out)
        assert isinstance(values, dict)
        return values

    def data(self) -> dict[str, Any]:
        data = self.json()["data"]
        assert isinstance(data, dict)
        return data


class Undrift:
    """Caller of undrift that captures the output."""

    def __init__(self, capsys):
        self.capsys = capsys

    def __call__(self, *words) -> Answer:
        self.capsys.readouterr()
        code = run([str(word) for word in words])
        out, err = self.capsys.readouterr()
        return Answer(code, out, PROGRESS.sub("", err))

    def good(self, *words) -> Answer:
        """Return the answer to a call that must succeed without a word on stderr."""
        answer = self(*words)
        assert (answer.code, answer.err) == (0, ""), answer
        return answer

    def refused(self, *words) -> str:
        """Return the one line of a call that must be refused."""
        answer = self(*words)
        if "--json" in words:
            assert answer.err == f"undrift: {answer.json()['error']['text']}\n"
        assert (answer.code, "" if "--json" in words else answer.out) == (2, ""), answer
        assert answer.err.startswith("undrift: ")
        assert answer.err.endswith("\n")
        assert answer.err.count("\n") == 1, answer.err
        assert len(answer.err) < 1200
        assert "Traceback" not in answer.err
        return answer.err


def contents(folder: Path) -> dict[str, bytes | None]:
    """Return every file and folder with its bytes."""
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None
        for path in sorted(folder.rglob("*"))
    }


def lines_of(path: Path) -> list[list[str]]:
    """Return the cells of a CSV, head first, without undrift's mark."""
    return [line.split(",") for line in path.read_text().splitlines() if not line.startswith("#")]


def write_lines(path: Path, lines: list[list[str]]) -> None:
    path.write_text("\n".join(",".join(cells) for cells in lines) + "\n")


def at_rest(folder: Path, path: Path, *, seconds: float = 120.0, seed: int = 1) -> Record:
    """Write a device at rest with white noise only, as a CSV in rad/s and m/s2."""
    rng = np.random.default_rng(seed)
    n = int(100 * seconds)
    record = Record(
        time=np.arange(n) / 100.0,
        gyro=rng.normal(0.0, 1e-3, (n, 3)),
        accel=rng.normal(0.0, 1e-2, (n, 3)) + np.array([0.0, 0.0, 9.80665]),
    )
    write_record(record, folder / path)
    return record


def warm_between(bench, folder, start_s, stop_s):
    """The trial with a stretch beyond a table of the gyroscopes, and its calibration: gaps under nan."""
    c, raw = read_calibration(bench / "calibration.json"), read_record(bench / "trial.parquet")
    static = StaticDrift(temp_c=[20.0, 30.0], gyro_offset=np.tile(c.gyro.offset, (2, 1)))
    write_calibration(replace(c, drift=DriftTables(static=static)), folder / "c.json")
    warm = (raw.time >= start_s) & (raw.time < stop_s)
    write_record(replace(raw, temp_c=np.where(warm, 31.0, 25.0)), folder / "warm.parquet")
    return [folder / "warm.parquet", "--calibration", folder / "c.json"]


def row_of(answer: dict[str, Any], table: str, name: str) -> dict[str, Any]:
    """Return the row of a table in JSON whose first cell is a name."""
    (row,) = (row for row in answer["tables"][table] if next(iter(row.values())) == name)
    return dict(row)


def check_call(arguments: Sequence[str]) -> None:
    """Raise a CycloptsError if the arguments are not a call of a command."""
    words, display = list(arguments), {"--json": 1, "--details": 1, "--report": 2}
    for option, count in display.items():
        if option in words:
            del words[words.index(option) : words.index(option) + count]
    app().parse_args(words, exit_on_error=False, print_error=False)
