"""What docs say is what the code says."""

import json
import re
from pathlib import Path

from undrift.io.store import calibration_schema

ROOT = Path(__file__).parents[2]


def test_the_schema_in_docs_is_the_one_of_the_models() -> None:
    shipped = json.loads((ROOT / "docs" / "calibration.schema.json").read_text())
    assert shipped == json.loads(json.dumps(calibration_schema()))


def test_every_source_file_that_docs_name_exists() -> None:
    for page in (ROOT / "docs").glob("*.md"):
        for name in re.findall(r"[\w/]+\.py\b", page.read_text()):
            places = (ROOT / "src" / "undrift" / name, ROOT / "tests" / name, ROOT / name)
            assert any(place.exists() for place in places), f"{page.name} names {name}"
