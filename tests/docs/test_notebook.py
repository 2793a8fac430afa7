"""The notebook for Python gives again what it shows."""

import json
from pathlib import Path

import pytest

NOTEBOOK = Path(__file__).parents[2] / "docs" / "first_calibration.ipynb"
MOST_BYTES = 300_000


def outputs_of(notebook):
    """Return the printed lines and tables of each cell; pictures by their kind, since another font draws other bytes."""
    found = []
    for cell in notebook["cells"]:
        held = []
        for output in cell.get("outputs", []):
            assert output["output_type"] != "error", output
            data = output.get("data", {})
            held.append(output.get("text") or data.get("text/html") or sorted(data))
        found.append(["".join(item) for item in held])
    return found


def test_the_notebook_is_small_and_gives_again_what_it_shows(tmp_path):
    nbformat, nbclient = pytest.importorskip("nbformat"), pytest.importorskip("nbclient")
    assert NOTEBOOK.stat().st_size < MOST_BYTES
    stored = json.loads(NOTEBOOK.read_text())
    made = nbformat.read(NOTEBOOK, as_version=4)
    nbclient.NotebookClient(made, timeout=120, resources={"metadata": {"path": str(tmp_path)}}).execute()
    assert outputs_of(made) == outputs_of(stored)
    shown = [key for cell in stored["cells"] for output in cell.get("outputs", []) for key in output.get("data", {})]
    assert shown.count("image/png") >= 3
    assert "text/html" in shown
