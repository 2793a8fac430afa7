"""Each command on a disk that is full: ``python -m tests.fuzz.full_disk [--few] [WORD ...]``.

Every call of the system that takes room (a file made, written, brought to the disk or renamed, a folder made) below the
folder of results and the one of temporary files fails once, and then with all after it, until the command succeeds
without; also from libraries in C (testkit/disk.c). Each time it must end with exit code 2 and one line that says to
free disk space, or succeed all the same; every file of the result is the old one, the new one or, where there was none,
not there; files that belong together are all old or all new; no scrap is left; and the same call succeeds when there is
room. Printed is a row for each command. With --few four commands and fewer faults. The exit code is 1 where one ended
otherwise.
"""

import argparse
import contextlib
import io
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

sys.path.extend(str(Path(__file__).parents[k]) for k in (1, 2))  # of the tests and of the benchmarks
from benchmarks.broad_files import broad_file

from testkit.disk import full_after, preloaded
from testkit.talking_device import TalkingDevice

LINE = 200  # bytes: a header and one reading
GROWING = ("summary.csv", "session.toml")  # complete after each step
GOOD, BAD = ("clear", "succeeds"), ("unclear", "crash", "half file", "lost", "apart", "scrap", "not again")


@dataclass(frozen=True)
class Call:
    words: str  # {b} is the folder of what it reads, {o} that of its results
    together: bool = False  # Its files belong together
    fresh: bool = False  # It refuses to write over an older result, or goes on with it
    slow: bool = False  # Fails at some of its calls only
    live: bool = False  # What came until then stays, in a file that it names


STUDY = """[study]
name = "small"
subjects = 3
sessions = ["hand"]
[[task]]
name = "sit_to_stand"
"""
TRIALS = """recording,reference,person,task,device,calibration
trial.parquet,reference.parquet,1,sit_to_stand,A,calibration.json
"""
CORRECT, ORIENT = (
    "correct {b}/trial.parquet --calibration {b}/calibration.json -o {o}/",
    "orient {b}/corrected.parquet -o {o}/",
)
CALLS = {
    "info --write-map": Call(
        "info {b}/foreign.csv --write-map {o}/map.toml --gyro-unit dps --accel-unit g --report {o}/r.html"
    ),
    "calibrate": Call("calibrate {b}/session -o {o}/c.json --report {o}/c.html", slow=True),
    "info --write-session": Call("info {b}/poses.parquet --write-session {o}/session", fresh=True),
    "drift": Call("drift {b}/soak --calibration {b}/mpu6050.json -o {o}/c.json --report {o}/c.html", slow=True),
    "correct .parquet": Call(CORRECT + "x.parquet --report {o}/r.html"),
    "correct .csv": Call(CORRECT + "x.csv", together=True),
    "correct .csv.gz": Call(CORRECT + "x.csv.gz", together=True),
    "correct several": Call(
        "correct {b}/2026-03-01.parquet {b}/2026-03-02.parquet --calibration {b}/calibration.json -o {o}/all"
    ),
    "orient .parquet": Call(ORIENT + "x.parquet"),
    "orient .csv": Call(ORIENT + "x.csv"),
    "orient .sto": Call(ORIENT + "x.sto"),
    "validate": Call("validate {b}/corrected.parquet --reference {b}/reference.parquet -o {o}/v"),
    "twin": Call("twin {b}/broad.parquet -o {o}/device.json", slow=True),
    "export c": Call("export {b}/calibration.json --target c -o {o}/x.h", together=True),
    "export constants": Call("export {b}/calibration.json --target constants -o {o}/x.json"),
    "mount": Call("mount {b}/walk.parquet --worn lower-back --calibration {b}/perfect.json -o {o}/worn.json"),
    "validate --trials": Call("validate {b}/people --trials trials.csv -o {o}/people", fresh=True, slow=True),
    "certificate": Call("certificate {b}/calibration.json -o {o}/c.html"),
    "noise": Call("noise {b}/rest.parquet --report {o}/r.html", slow=True),
    "simulate task": Call(
        "simulate sit_to_stand --device mpu6050 -o {o}/x.parquet --truth {o}/t.csv --save-device {o}/d.json --report {o}/r.html"
    ),
    "simulate .csv": Call("simulate sit_to_stand --device mpu6050 -o {o}/x.csv --truth {o}/t.parquet"),
    "study": Call("study {b}/study.toml -o {o}/study --workers 1", fresh=True, slow=True),
    "sample": Call("sample {o}/sample", fresh=True, together=True),
    "record .csv": Call("record {device} -o {o}/x.csv --duration-s 5", fresh=True, live=True),
    "record .parquet": Call("record {device} -o {o}/x.parquet --duration-s 5", fresh=True, live=True),
    "demo": Call("demo --quick --out {o}/demo", fresh=True, slow=True),
}
FEW = ("info --write-map", "correct .csv", "export c")


def make_inputs(folder: Path, *, soak: bool) -> None:
    import numpy as np

    from testkit.bench_and_commands import make_bench
    from testkit.command_line import at_rest
    from testkit.daily_use import DailyUseSettings, draw_day, simulate_daily_use
    from testkit.walking import perfect_calibration, walk
    from undrift.io.formats import read_record, write_record
    from undrift.io.session import write_session
    from undrift.io.store import write_calibration
    from undrift.sim.device.presets import preset, random_device
    from undrift.sim.device.truth import true_calibration
    from undrift.sim.thermal import ThermalSettings, simulate_thermal_session

    make_bench(folder)
    rng = np.random.default_rng(8)
    use = DailyUseSettings(days=2, rest_s=15.0, worn_s=20.0, sample_rate_hz=12.5)
    device = random_device(rng, grade="mpu6050")
    for day in simulate_daily_use(device, rng=rng, settings=use, motions=[draw_day(rng, use)]):
        write_record(day.session.records[0], folder / f"2026-03-0{day.number + 1}.parquet")
    write_calibration(true_calibration(preset("mpu6050")), folder / "mpu6050.json")
    at_rest(folder, Path("rest.parquet"))
    write_record(read_record(next(folder.glob("session/*.parquet"))), folder / "poses.parquet")
    trial = read_record(folder / "trial.parquet")
    rows = np.column_stack((trial.time, trial.gyro, trial.accel))[:500]
    np.savetxt(folder / "foreign.csv", rows, "%.6f", ",", header="t,gx,gy,gz,ax,ay,az", comments="")
    (folder / "study.toml").write_text(STUDY)
    shutil.copyfile(broad_file("32_disturbed_attached_magnet_1cm"), folder / "broad.parquet")
    if soak:
        bench = replace(ThermalSettings().bench, sample_rate_hz=5.0)
        settings = ThermalSettings(bench=bench)
        session = simulate_thermal_session("soak", preset("mpu6050"), rng=np.random.default_rng(0), settings=settings)
        write_session(session, folder / "soak")
    (folder / "people").mkdir()
    for name in ("trial.parquet", "reference.parquet", "calibration.json"):
        shutil.copy(folder / name, folder / "people")
    (folder / "people" / "trials.csv").write_text(TRIALS)
    write_record(walk(rng, q_ab=np.array([1.0, 0.0, 0.0, 0.0]), bouts=3), folder / "walk.parquet")
    write_calibration(perfect_calibration(), folder / "perfect.json")


def called(words: list[str]) -> tuple[int, str]:
    """Return the exit code of a call, -1 for one that raises, and what it said on stderr."""
    from undrift.cli.app import run

    err = io.StringIO()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(err):
        try:
            return run(words), err.getvalue()
        except BaseException as error:  # noqa: BLE001 - what it is told of
            return -1, repr(error)


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def same(one: bytes | None, other: bytes) -> bool:
    """Tell whether two contents are alike to their ends but for a date, or the time that something took."""
    return one is not None and (one == other or (abs(len(one) - len(other)) <= 64 and one[-4:] == other[-4:]))


def judge(
    call: Call, before: dict[str, bytes], after: dict[str, bytes], sound: dict[str, bytes], answer: tuple[int, str]
) -> str:
    code, err = answer
    lines = [line for line in err.splitlines() if not re.match(r"undrift \w+(?: \w+)?: ", line)]
    if code == -1 or "Traceback" in err:
        return "crash"
    if any(name not in after for name in before):
        return "lost"
    if any(name not in sound and name not in before for name in after):
        return "scrap"
    new = {name for name, content in after.items() if content != before.get(name)}
    if any(not same(after[name], sound[name]) for name in new if Path(name).name not in GROWING):
        return "half file"
    if call.together and 0 < len(new) < len(sound):
        return "apart"
    if code == 0:
        return "succeeds" if all(name in after for name in sound) else "unclear"
    clear = code == 2 and len(lines) == 1 and "free disk space" in lines[0].lower() and "internal" not in lines[0]
    clear |= code == 1 and b"free disk space" in after.get("all/summary.csv", b"")  # one of several recordings
    return "clear" if clear else "unclear"


def judge_recording(out: Path, answer: tuple[int, str]) -> str:
    """Name what became of a recording: what is left must be whole up to its end, and be named."""
    from undrift.io.formats import read_record

    (code, err), left = answer, [path for path in out.iterdir() if path.suffix != ".json"]
    last = (err.strip().splitlines() or [""])[-1]
    if code == -1 or "Traceback" in err:
        return "crash"
    if len(left) > 1:
        return "scrap"
    try:
        rows = [len(read_record(path)) for path in left if path.stat().st_size > LINE]
    except ValueError:
        return "half file"
    if code == 0:
        return "succeeds" if rows else "unclear"
    return (
        "clear"
        if code == 2 and "free disk space" in last.lower() and all(str(path) in last for path in left[: len(rows)])
        else "unclear"
    )


def swept(name: str, folder: Path, words_of: dict[str, str], *, few: bool) -> tuple[int, Counter[str], float]:
    """Return how many faults a command has room for, what became of it, and the seconds that it took."""
    call, disk = CALLS[name], folder / "disk"
    out = disk / "out"
    words = [word.format(b=folder / "in", o=out, **words_of) for word in call.words.split()]

    def begin(held: dict[str, bytes]) -> None:
        shutil.rmtree(disk, ignore_errors=True)
        for path in (out, disk / "tmp"):
            path.mkdir(parents=True)
        for file, content in held.items():
            (out / file).parent.mkdir(parents=True, exist_ok=True)
            (out / file).write_bytes(content)

    begin({})
    answer = called(words)
    if answer[0] not in (0, 1):
        print(f"{name}: does not run: {answer}", flush=True)
        return 0, Counter({"unclear": 1}), 0.0
    begun = time.monotonic()
    sound, found, faults = contents(out), Counter[str](), 0
    shown = set[str]()
    for stays in (True,) if call.slow or few else (True, False):
        older = dict.fromkeys(sound, b"old\n")
        for held in ({},) if call.fresh or call.slow else (older,) if few else ({}, older):
            n = 0
            while True:
                begin(held)
                with full_after(disk, n, stays=stays) as counted:
                    answer = called(words)
                if counted[0] <= n:
                    break
                faults, n = faults + 1, n + (5 if few and n > 12 else 1 + n // 3 if call.slow else 1)
                kind = judge_recording(out, answer) if call.live else judge(call, held, contents(out), sound, answer)
                if kind == "clear" and call.fresh and not (call.slow or call.live) and called(words)[0] not in (0, 1):
                    kind = "not again"
                found[kind] += 1
                if kind in BAD and (kind, answer[1]) not in shown:
                    shown.add((kind, answer[1]))
                    how = f"fault before {n}, {'stays' if stays else 'once'}, {'over' if held else 'new'}"
                    print(f"{name}: {how}: {kind}: {answer[1].strip()[-400:]}", flush=True)
    return faults, found, time.monotonic() - begun


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("words", nargs="*")
    parser.add_argument("--few", action="store_true")
    given = parser.parse_args()
    if "LD_PRELOAD" not in os.environ:
        with tempfile.TemporaryDirectory() as folder:
            words = [sys.executable, "-m", "fuzz.full_disk", *sys.argv[1:]]
            return subprocess.run(words, env=preloaded(UNDRIFT_FULL_DISK=folder), check=False).returncode
    folder = Path(os.environ["UNDRIFT_FULL_DISK"])
    (folder / "in").mkdir()
    names = [name for name in CALLS if (not given.words or any(word in name for word in given.words))]
    names = [name for name in names if not given.few or name in FEW]
    make_inputs(folder / "in", soak="drift" in names)
    tempfile.tempdir = str(folder / "disk" / "tmp")
    total, rows = Counter[str](), []
    with TalkingDevice(1000.0) as device:  # ten times as fast as it says
        words = {"device": device.address.replace("rate=1000", "rate=100") + "&clock_speed=10"}
        for name in names:
            faults, found, seconds = swept(name, folder, words, few=given.few)
            total += found
            rows.append((name, faults, found, seconds))
            print(f"{name}: {faults} faults, {dict(found)}, {seconds:.1f} s", flush=True)
    kinds = (*GOOD, *BAD)
    print(f"{'command':20}{'faults':>8}" + "".join(f"{kind:>10}" for kind in kinds))
    for name, faults, found, _ in rows:
        print(f"{name:20}{faults:8}" + "".join(f"{found[kind]:10}" for kind in kinds))
    print(f"{'all':20}{sum(row[1] for row in rows):8}" + "".join(f"{total[kind]:10}" for kind in kinds))
    return int(any(total[kind] for kind in BAD))


if __name__ == "__main__":
    sys.exit(main())
