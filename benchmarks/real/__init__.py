"""Every public set with a truth: undrift with its defaults beside plain rivals. The readers are those of the tests."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))
