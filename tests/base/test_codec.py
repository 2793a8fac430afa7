"""A class is its own file: what it writes it reads, and what is damaged is refused by the key."""

import json
import math
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import pytest
from annotated_types import Gt
from pydantic import Field

from undrift.arrays import BoolArray, FloatArray, Shape, freeze
from undrift.base.codec import (
    LATER,
    AnyNumber,
    FileTable,
    Gap,
    Pairs,
    json_text,
    read_json,
    read_toml,
    schema_of,
    stored,
    toml_block,
    toml_text,
    tree_of,
    value_of,
)
from undrift.errors import FileFormatError, InputError


class Sensor(FileTable):
    """One of several."""

    name: str
    gain: Annotated[float, Gt(0.0)] = 1.0


class Table(FileTable):
    """A table in the file."""

    rate_dps: float = 90.0
    order: Literal["up", "down"] = "up"


@stored(kind="undrift.loop", whole=True)
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Loop:
    """A loop over temperature."""

    temp_c: Annotated[FloatArray, Shape("n", rising=True)]
    width: Annotated[FloatArray | None, Shape("n", 3), LATER] = None
    marks: Annotated[BoolArray | None, Shape("n"), LATER] = None
    table: Table = Table()  # noqa: RUF009  frozen
    rms: AnyNumber = math.inf
    reference_c: Annotated[Gap, Field(alias="reference")] = math.nan
    settings: Annotated[Pairs | None, LATER] = None
    sensors: Annotated[tuple[Sensor, ...] | None, Field(alias="sensor"), LATER] = None

    def __post_init__(self) -> None:
        freeze(self)


def example(**changes: object) -> Loop:
    wide = np.array([[0.1, np.nan, 1.0 / 3.0], [1e-300, -0.0, 3.0]])
    values = {"temp_c": [20.0, 30.0], "width": wide, "marks": [True, False], **changes}
    return Loop(**values)


def full() -> Loop:
    return example(
        table=Table(rate_dps=0.1),
        settings=(("mode", 'a "b"\\\x7f é'),),
        sensors=(Sensor(name="x"), Sensor(name="y", gain=2.0)),
    )


@pytest.mark.parametrize("ending", ["json", "toml"])
def test_what_is_written_reads_back_to_the_last_bit(ending: str, tmp_path: Path) -> None:
    value = full() if ending == "json" else example(width=[[1.0, 2.0, 3.0]] * 2, reference_c=1.0)  # TOML has no null
    path = tmp_path / "loop"
    path.write_text(json_text(value, "loop") if ending == "json" else toml_text(tree_of(value)))
    again = read_json(Loop, path) if ending == "json" else read_toml(Loop, path)[0]
    assert tree_of(again) == tree_of(value)
    np.testing.assert_array_equal(again.width, value.width)
    assert not again.width.flags.writeable
    assert (again.rms, again.marks.dtype, again.table) == (math.inf, bool, value.table)


def test_a_file_has_kind_format_and_no_later_key_that_states_nothing() -> None:
    text = json_text(example(width=None, marks=None), "loop.json")
    assert json.loads(text) == {
        "kind": "undrift.loop",
        "format": 1,
        "temp_c": [20.0, 30.0],
        "table": {"rate_dps": 90.0, "order": "up"},
        "rms": "inf",
        "reference": None,
    }
    assert '"temp_c": [20.0, 30.0]' in text, "a list of numbers stands on one line"


def test_toml_has_lists_on_one_line_and_a_block_for_each_of_several_tables() -> None:
    text = toml_text(tree_of(example(sensors=full().sensors, width=None, marks=None)))
    assert "temp_c = [20.0, 30.0]\n" in text
    assert "[table]\n" in text
    assert text.count("[[sensor]]\n") == 2
    assert tomllib.loads(text)["sensor"][1] == {"name": "y", "gain": 2.0}
    block = toml_block("recording", {"file": "a\n[[b]]", "columns": {"gyro": ["x", 1]}, "gaps": None})
    assert tomllib.loads(block) == {"recording": [{"file": "a\n[[b]]", "columns": {"gyro": ["x", 1]}}]}


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"kind": "undrift.map"}, "a.json: expected kind 'undrift.loop', got 'undrift.map'"),
        ({"format": 4}, "a.json: expected format 1, got 4"),
        ({"widht": 1}, r"at widht: this key is unknown. Check its spelling \(nearest known key: width\)"),
        ({"table": {"rate": 1.0}}, r"at table.rate: this key is unknown"),
        ({"temp_c": None}, "a.json: at temp_c: expected a valid array, got None"),
        ({"temp_c": [2.0, 1.0]}, "a.json: Loop.temp_c: expected two or more increasing nodes, got 2"),
        ({"width": [[1.0, 2.0, 3.0]]}, r"Loop.width: expected shape \(2, 3\), got \(1, 3\)"),
        ({"marks": [1, 0]}, "at marks.0: expected a valid boolean"),
        ({"rms": "wide"}, "at rms: expected"),
        ({"table": {"rate_dps": 10**400}}, "at table.rate_dps: expected a finite number"),
        ({"sensor": [{"name": "x", "gain": 0.0}]}, "at sensor.0.gain: expected greater than 0"),
        ({"sensor": [{"gain": 1.0}]}, "at sensor.0.name: this key is missing"),
        ({"settings": {"mode": 1}}, "at settings.mode: expected a valid string"),
    ],
)
def test_a_damaged_file_is_refused_by_its_key(change: dict, text: str) -> None:
    with pytest.raises(FileFormatError, match=text) as caught:
        value_of(Loop, tree_of(example()) | change, "a.json")
    assert "\n" not in str(caught.value)


def test_a_missing_key_of_a_whole_class_is_refused() -> None:
    for name in ("temp_c", "table", "rms", "reference"):
        tree = tree_of(example())
        del tree[name]
        with pytest.raises(FileFormatError, match=f"at {name}: this key is missing"):
            value_of(Loop, tree, "a.json")


@pytest.mark.parametrize(
    ("line", "text"),
    [
        (
            "widht = 1",
            r"line 8: widht: this key is unknown. Check its spelling \(nearest known key: width\)",
        ),
        ("sensor = [{ gain = 2.0 }]", r"line 8: \[\[sensor\]\] 1, name: this key is missing"),
        ("table = { order = 'left' }", r"line 8: \[table\], order: expected 'up' or 'down', got 'left'"),
        ("width = 2026-01-01", "line 8: width: expected .*got '2026-01-01'"),
        ("table = 1 2", "loop.toml: expected TOML, got "),
    ],
)
def test_a_damaged_file_of_toml_is_refused_by_line_and_entry(line: str, text: str, tmp_path: Path) -> None:
    path = tmp_path / "loop.toml"
    table = "" if line.startswith("table") else "\n[table]"
    path.write_text(
        f"# by hand\nkind = 'undrift.loop'\nformat = 1\n\ntemp_c = [20.0, 30.0]\nrms = 1\nreference = 1\n{line}\n{table}"
    )
    with pytest.raises(FileFormatError, match=text):
        read_toml(Loop, path)


def test_a_value_that_would_not_read_back_is_not_written() -> None:
    with pytest.raises(InputError, match="must read back, got the file: at table"):
        json_text(example(table=Table().but(rate_dps=math.nan)), "loop.json")


def test_the_schema_says_what_the_reader_wants() -> None:
    schema = schema_of(Loop)
    assert schema["required"] == ["kind", "format", "temp_c", "table", "rms", "reference"]
    assert schema["additionalProperties"] is False
    assert schema["properties"]["format"] == {"const": 1, "title": "Format", "type": "integer"}
    assert schema["properties"]["temp_c"]["minItems"] == 2
    assert schema["$defs"]["Table"]["properties"]["rate_dps"]["default"] == 90.0
