"""The page of the device model names every effect, and its table of presets holds the figures of the sheets."""

import re
from dataclasses import fields
from pathlib import Path

from undrift.sim.device.effects import SensorChain
from undrift.sim.device.presets import PRESETS, SHEETS

PAGE = (Path(__file__).parents[2] / "docs" / "device-model.md").read_text()


def row(name: str, sheet: tuple[float | str, ...]) -> str:
    """Return a row of the table, figures as they stand in the sheet."""
    *figures, tag = sheet
    return f"| {name} | " + " | ".join(f"{figure:.4g}" for figure in figures) + f" | {tag} |"


def test_every_effect_has_a_row() -> None:
    for field in fields(SensorChain):
        if field.name != "unit":
            assert re.search(rf"^\| `{field.name}` \|", PAGE, re.M), f"device-model.md: no row of {field.name}"


def test_the_table_of_presets_holds_the_figures_of_the_sheets() -> None:
    for sheet, sides in SHEETS.items():
        for side in sides.values():
            assert row(sheet, side) in PAGE, f"device-model.md wants the row: {row(sheet, side)}"
    for name in PRESETS:
        assert name in PAGE
