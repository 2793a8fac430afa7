"""Every available recording, from its file to a result at the first attempt: ``python -m benchmarks.door``.

No TOML is edited by hand, except for keys of a map that only the owner of a file knows (KEYS).

A recording is calibrated and corrected if its poses are sufficient. Otherwise it is corrected with the calibration of
another device in physical units, made with the same commands. Optics count as references if ``info`` reads them. Prints
the commands, and exits with 1 if a file failed.
"""

import contextlib
import io
import json
import os
import shlex
import sys
import tempfile
import time
from pathlib import Path

from undrift.cli.app import run

DATA = Path(os.environ.get("UNDRIFT_DATA", Path(__file__).parents[1] / ".." / "shared" / "data")).resolve()
# keys that only the owner of a file knows, from SOURCE.md; a missing rate is assumed and printed as assumed.
RATES = {"multipos_mpu9150": 100, "ferraris_nilspod": 102.4, "ximu": 256, "worn_lowback": 100, "static_mpu6050": 100}
RATES |= {"thermal_bmi270": 50}
ASSUMED = 100
MORE = {"BMI_270": "--gyro-unit count --accel-unit count", "Tempdata": "--gyro-unit dps --accel-unit g"}
KEYS = {
    "BMI_270": "drop_bad_rows = true",  # torn lines
    "Tempdata": "scale = { gyro = { gain = 0.06097560976 }, accel = { gain = 6.103515625e-05 } }",
}
FOLDERS = ("ngimu", "ximu", "ximu3")
NO_RECORDING = ("settings", "text", "table", "binary")


def call(*words: object) -> tuple[int, str, str]:
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = run([str(word) for word in words])
    return code, out.getvalue(), err.getvalue()


def described(path: Path, options: list[object]) -> dict:
    return json.loads(call("info", path, *options, "--json")[1])


def options_of(path: Path, description: dict, steps: list[list[object]]) -> list[object]:
    """Return the options that info asks for, with a map written where it proposes one."""
    missing = [
        item["values"].get("missing") for item in description["findings"] if item["code"] == "recording.not_read"
    ]
    rate = next((value for name, value in RATES.items() if name in str(path)), ASSUMED)
    if "sensor" in missing:
        # readings of the sensor itself in an autopilot's log, because sensor_combined is already corrected
        options: list[object] = ["--sensor", next(name for name in description["columns"] if name != "sensor_combined")]
        return options + options_of(path, described(path, options), steps)
    if "sample_rate_hz" in missing:
        return ["--sample-rate-hz", rate]
    if "needs a map" not in description["summary"]:
        return []
    command: list[object] = ["info", path, "--write-map", f"{path.name}.toml"]
    command += next((shlex.split(extra) for name, extra in MORE.items() if name in path.name), [])
    code, _, err = call(*command)
    if code and "--sample-rate-hz" in err:
        command += ["--sample-rate-hz", rate]
        call(*command)
    steps.append(command)
    with Path(f"{path.name}.toml").open("a") as written:
        written.writelines(f"{key}\n" for name, key in KEYS.items() if name in path.name)
    return ["--map", f"{path.name}.toml"]


def outcome(path: Path, device: Path) -> tuple[str, list[list[object]]]:
    """Return the result for a file, and the commands after info."""
    first: list[object] = []
    code, out, err = call("info", path, "--json")
    if code and "drop_bad_rows" in err:  # the message recommends it
        Path("rows.toml").write_text("drop_bad_rows = true\n")
        first = ["--map", "rows.toml"]
        code, out, err = call("info", path, *first, "--json")
    if code:
        return f"refused: {err.strip()}", []
    description, steps = json.loads(out), list[list[object]]()
    if description["kind"] in ("markers", "reference"):
        return "reference", steps
    options = [*first, *options_of(path, description, steps)]
    if description["kind"] != "recording" and not options:
        return f"no recording ({description['summary'][:60]})", steps
    name, wide = f"{path.name}.json", any(word == "--map" for word in options)
    command: list[object] = ["calibrate", path, *options, "-o", name]
    if call(*command)[0] != 2:
        steps += [command, ["correct", path, *([] if wide else options), "--calibration", name, "-o", "out.csv"]]
        code, _, err = call(*steps[-1])
        return ("calibrated and corrected" if code == 0 else f"refused: {err.strip()}"), steps
    last = ["correct", path, *options, "--calibration", device, "-o", "out.csv"]
    code, _, err = call(*last)
    if code == 0:
        return "corrected", [*steps, last]
    command = ["drift", path, *options, "-o", name]
    if call(*command)[0] != 2:
        steps += [command, ["correct", path, "--calibration", name, "-o", "out.csv"]]
        code, _, err = call(*steps[-1])
        return ("tables over temperature and corrected" if code == 0 else f"refused: {err.strip()}"), steps
    steps.append(["noise", path, *options, "--report", "noise.html"])
    return ("noise" if call(*steps[-1])[0] == 0 else f"refused: {err.strip()}"), steps


def main() -> int:
    if not DATA.is_dir():
        print("the public recordings are not there: set UNDRIFT_DATA")
        return 0
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        board = DATA / "multipos_mpu9150" / "imu0.log.gz"
        call("info", board, "--write-map", "board.toml", "--sample-rate-hz", 100)
        call("calibrate", board, "--map", "board.toml", "-o", "board.json")
        device = Path(folder) / "board.json"
        paths = [path for path in sorted(DATA.rglob("*")) if path.is_file() and path.name != "SOURCE.md"]
        paths = [path for path in paths if path.parent.name not in FOLDERS and path.suffix != ".py"]
        paths += [DATA / "wearable_formats" / name for name in FOLDERS]
        failed = 0
        for path in paths:  # one after the other
            start = time.perf_counter()
            what, steps = outcome(path, device)
            failed += what.startswith("refused")
            has_rate = any(name in str(path) for name in RATES)
            rated = any("--sample-rate-hz" in step for step in steps)
            what += ", rate assumed" if rated and not has_rate else ""
            print(f"{path.relative_to(DATA)}: {what} ({time.perf_counter() - start:.1f} s)", flush=True)
            for step in steps:
                printable = [Path(str(word)).name if isinstance(word, Path) else word for word in step]
                print(f"    undrift {shlex.join(map(str, printable))}", flush=True)
        print(f"{len(paths)} files, {failed} refused; one attempt each")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
