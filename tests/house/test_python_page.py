"""The page and the notebook for Python: their code runs, and prints what they show."""

import contextlib
import io
import json
import re
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"
NOTEBOOK = DOCS / "first_calibration.ipynb"
MOST_BYTES = 300_000


def test_the_blocks_of_the_page_run_in_order_and_print_what_it_says(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```(python|text)\n(.*?)```", (DOCS / "python.md").read_text(), re.S)
    names, printed = {}, ""
    for kind, text in blocks:
        if kind == "text":
            assert printed == text
            continue
        out = io.StringIO()
        with contextlib.redirect_stdout(out):
            exec(compile(text, "docs/python.md", "exec"), names)
        printed = out.getvalue()
    assert (tmp_path / "calibration.svg").read_text().startswith("<?xml")
    assert (tmp_path / "walk.png").read_bytes().startswith(b"\x89PNG")


def test_arrays_are_calibrated_and_corrected_in_ten_lines():
    text = re.findall(r"```python\n(.*?)```", (DOCS / "python.md").read_text(), re.S)[1]
    lines = [line for line in text.splitlines() if line.strip()]
    assert len(lines) <= 10
    assert "from_arrays" in text
    assert "calibrate(" in text
    assert "correct(" in text


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
