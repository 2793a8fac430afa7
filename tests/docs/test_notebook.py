"""The notebook for Python gives again what it shows."""

import json
import re
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"
PICTURES = {"first_calibration": 3, "laboratory": 2, "firmware": 0, "developer": 1, "physiotherapist": 1}  # at least
MOST_BYTES = 300_000
VARYING = re.compile(
    r"SIM-[0-9A-F]+|\d+e-\d+ deg/s"
)  # a serial of the package's version, and a rounding of the compiler's


def outputs_of(notebook):
    """Return the printed lines and tables of each cell; pictures by their kind, since another font draws other bytes."""
    found = []
    for cell in notebook["cells"]:
        held = []
        for output in cell.get("outputs", []):
            assert output["output_type"] != "error", output
            data = output.get("data", {})
            held.append(output.get("text") or data.get("text/html") or sorted(data))
        found.append([VARYING.sub("", "".join(item)) for item in held])
    return found


def test_each_notebook_is_tried():
    assert {path.stem for path in DOCS.glob("*.ipynb")} == set(PICTURES)


@pytest.mark.slow
@pytest.mark.parametrize("name", PICTURES)
def test_a_notebook_is_small_and_gives_again_what_it_shows(name, tmp_path):
    nbformat, nbclient = pytest.importorskip("nbformat"), pytest.importorskip("nbclient")
    path = DOCS / f"{name}.ipynb"
    assert path.stat().st_size < MOST_BYTES
    stored = json.loads(path.read_text())
    made = nbformat.read(path, as_version=4)
    nbclient.NotebookClient(made, timeout=120, resources={"metadata": {"path": str(tmp_path)}}).execute()
    assert outputs_of(made) == outputs_of(stored)
    shown = [key for cell in stored["cells"] for output in cell.get("outputs", []) for key in output.get("data", {})]
    assert shown.count("image/png") >= PICTURES[name]
