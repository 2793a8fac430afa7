"""The page of the device model names every effect."""

import re
from dataclasses import fields
from pathlib import Path

from undrift.sim.device.effects import SensorChain

PAGE = (Path(__file__).parents[2] / "docs" / "device-model.md").read_text()


def test_every_effect_has_a_row() -> None:
    for field in fields(SensorChain):
        if field.name != "unit":
            assert re.search(rf"^\| `{field.name}` \|", PAGE, re.M), f"device-model.md: no row of {field.name}"
