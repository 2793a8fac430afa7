"""Five minutes: a fresh virtual environment, ``pip install``, an unknown CSV, to a corrected file and a picture.

``python -m benchmarks.five_minutes`` prints every command and its seconds. The CSV is the foot sensor's of ferraris_nilspod, whose
rate of 102.4 Hz and turns of 360 deg its owner knows.
"""

import os
import shlex
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
DATA = Path(os.environ.get("UNDRIFT_DATA", ROOT / ".." / "shared" / "data")).resolve()
RECORDING = DATA / "ferraris_nilspod" / "example_ferraris_session.csv"
COMMANDS = (
    f"{sys.executable} -m venv fresh",
    f"fresh/bin/python -m pip install --quiet --disable-pip-version-check -c {ROOT / 'constraints.txt'} {ROOT}",
    "fresh/bin/undrift info unknown.csv --write-map map.toml --sample-rate-hz 102.4",
    "fresh/bin/undrift info unknown.csv --map map.toml --figure recording.svg",
    "fresh/bin/undrift calibrate unknown.csv --map map.toml --turn-deg 360 --figure used.svg -o calibration.json",
    "fresh/bin/undrift correct unknown.csv --calibration calibration.json -o corrected.csv",
)


def main() -> int:
    environment = {key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "VIRTUAL"))}
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "unknown.csv").symlink_to(RECORDING)
        started = time.perf_counter()
        for command in COMMANDS:
            start = time.perf_counter()
            done = subprocess.run(
                shlex.split(command), cwd=folder, env=environment, capture_output=True, text=True, check=False
            )
            print(f"{time.perf_counter() - start:6.1f} s  {command}")
            if done.returncode:
                print(done.stdout, done.stderr)
                return 1
        outputs = [
            name for name in ("corrected.csv", "recording.svg", "used.svg") if (Path(folder) / name).stat().st_size
        ]
        print(f"{time.perf_counter() - started:6.1f} s in all: {', '.join(outputs)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
