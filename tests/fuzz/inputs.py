"""What is damaged and what reads it: recordings, sessions and settings."""

import contextlib
import gzip
import io
import os
import random
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

import undrift
from fuzz import oracle
from testkit.data import DATA
from testkit.full_calibration import device, tables
from undrift.cli.app import run
from undrift.errors import UndriftError
from undrift.io.column_map import ColumnMap, read_map
from undrift.io.session import read_session
from undrift.io.store import read_calibration, write_calibration
from undrift.programme import read_protocol
from undrift.rate_log import read_rate_log
from undrift.sim.device.model import read_device, write_device
from undrift.sim.device.presets import preset
from undrift.study.plan import read_study

BAD = ("crash", "hang", "over 1 GB", "unforeseen", "partial file", oracle.KINDS[-1])
ALL_CUTS, SOME_CUTS = (
    1500,
    48,
)  # bytes of a file that is cut at every point; points of a larger one, half of them near its end
LONGEST, LARGEST = (
    30_000,
    1_300_000,
)  # bytes of a text and of any other recording that is damaged: many headers, few rows
FRAMES = 40  # of a packed TRC file


@dataclass(frozen=True, slots=True)
class Outcome:
    kind: str  # one of oracle.KINDS, "read" where no readings are compared, or what must not be
    text: str = ""


@dataclass(frozen=True)
class Seed:
    """A sound input and how it is read."""

    name: str  # Of the file that is damaged
    content: bytes
    read: Callable[[Path], Outcome]
    beside: dict[str, bytes] = field(default_factory=dict)  # Other files of its folder
    simulated: bool = True  # Made here; a public recording otherwise

    @cached_property
    def how(self) -> ColumnMap:
        """The arguments by which it is read."""
        return oracle.how_read(self.content, self.name)

    @cached_property
    def sound(self) -> oracle.Sound | None:
        """What is read of the sound input, None where that is no readings."""
        if self.read is not by_command:
            return None
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / self.name
            path.write_bytes(self.content)
            held = oracle.read(path, self.how)
        return (
            None
            if isinstance(held, str)
            else oracle.Sound(self.content, held, not self.how.columns or bool(self.how.columns_of("time")))
        )


def outcome(seed: Seed, content: bytes, folder: Path, *, commands: bool = True) -> Outcome:
    """Put the content into a fresh folder, read it, and compare what is read with the sound input."""
    folder.mkdir(exist_ok=True)
    for name, held in {**seed.beside, seed.name: content}.items():
        (folder / name).write_bytes(held)
    path = folder / seed.name
    sound = seed.sound
    if sound is None:
        return seed.read(path)
    if commands:
        found = seed.read(path)
        if found.kind in BAD:
            return found
    return by_function(lambda _: Outcome(*oracle.judge(sound, content, oracle.read(path, seed.how))))(path)


# ---- readers


def by_command(path: Path) -> Outcome:
    """Describe a recording, and try to calibrate by it: an answer, or one clear line on stderr and no output."""
    out = path.parent / "out.json"
    shown = _called("info", str(path))
    if shown.kind not in ("read", "refused"):
        return shown
    found = _called("calibrate", str(path), "-o", str(out))
    left = sorted(p.name for p in path.parent.iterdir() if p.name.endswith(".part") or p.name.startswith(".undrift-"))
    if left or (found.kind == "refused" and out.exists()):
        return Outcome("partial file", f"{left or out.name}")
    return shown if found.kind in ("read", "refused") else found


def _called(*words: str) -> Outcome:
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = run(words)
    text = err.getvalue().strip()
    if "internal error" in text:
        return Outcome("over 1 GB" if "MemoryError" in text else "unforeseen", text)
    if code == 2 and (not text.startswith("undrift: ") or "\n" in text):
        return Outcome("unforeseen", f"not one line: {text[:300]}")
    return Outcome("refused" if code == 2 else "read", text)


def by_function(read: Callable[[Path], object]) -> Callable[[Path], Outcome]:
    """Read settings; whatever is not an error of undrift's is unforeseen."""

    def call(path: Path) -> Outcome:
        try:
            found = read(path)
        except UndriftError as error:
            return (
                Outcome("refused", str(error)) if "\n" not in str(error) else Outcome("unforeseen", f"lines: {error}")
            )
        except MemoryError as error:
            return Outcome("over 1 GB", str(error))
        except Exception as error:  # noqa: BLE001 - what the run looks for
            return Outcome("unforeseen", f"{type(error).__name__}: {error}")
        return found if isinstance(found, Outcome) else Outcome("read")

    return call


# ---- sound inputs

MAP = b"""sample_rate_hz = 100.0
columns = { time = "t", gyro = ["gx", "gy", "gz"], accel = ["ax", "ay", "az"], temp = "T" }
units = { time = "s", gyro = "dps", accel = "g", temp = "degC" }
skip_rows = 0
delimiter = ";"
"""
SESSION = b"""[session]
kind = "calibration"
serial = "A1"
gravity_m_s2 = 9.81
[[recording]]
file = "r.csv"
[[still]]
recording = 0
face = "+x"
start_s = 0.0
stop_s = 0.5
[[turn]]
axis = "z"
turn_rate_dps = 90.0
start_s = 0.5
stop_s = 1.5
"""
PROTOCOL = b"""[protocol]
name = "walk"
cutoff_hz = 11.1
[faces]
order = ["+x", "-x", "+y", "-y", "+z", "-z"]
seconds = 6.0
[rates]
turn_rate_min_dps = 5.0
turn_rate_max_dps = 90.0
turn_rate_step_dps = 5.0
[temperatures]
set_points_c = [18.0, 30.0, 45.0]
"""
STUDY = b"""[study]
subjects = 4
seed = 1
[[task]]
name = "sit_to_stand"
[task.tried]
cutoff_hz = [5.0, 11.1]
turn_rate_step_dps = [5.0]
turn_rate_min_dps = [5.0]
turn_rate_max_dps = [45.0]
"""
RATES = b"time_s,angle_deg\n" + b"".join(b"%.2f,%.2f\n" % (k / 20, 3.0 * k) for k in range(200))


def seeds() -> list[Seed]:
    """Return the sound inputs: simulated ones, and the small ones of the public recordings where these are present."""
    made = [Seed(name, content, by_command) for name, content in _simulated()]
    made += [Seed(name, content, by_command, simulated=False) for name, content in _public()]
    row = b"time_s,gyro_x_dps,gyro_y_dps,gyro_z_dps\n" + b"".join(
        b"%.2f,1,2,%d\n" % (k / 100, k % 5) for k in range(200)
    )
    calibrated = device(drift=tables(scale=np.array([18.0, 40.0, 75.0])))
    settings: dict[str, tuple[bytes, Callable[[Path], object]]] = {
        "map.toml": (MAP, read_map),
        "protocol.toml": (PROTOCOL, read_protocol),
        "study.toml": (STUDY, read_study),
        "rates.csv": (RATES, read_rate_log),
        "device.json": (_written(lambda path: write_device(preset("mpu6050"), path)), read_device),
        "calibration.json": (
            _written(lambda path: write_calibration(calibrated, path)),
            read_calibration,
        ),
    }
    made += [Seed(name, content, by_function(read)) for name, (content, read) in settings.items()]
    made.append(Seed("session.toml", SESSION, by_function(lambda path: read_session(path.parent)), {"r.csv": row}))
    return made


def _written(write: Callable[[Path], object], suffix: str = "") -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / f"made{suffix}"
        write(made)
        return made.read_bytes()


def _simulated() -> Iterator[tuple[str, bytes]]:
    rng, count = np.random.default_rng(0), 120
    record = undrift.Record(
        time=np.arange(count) / 100.0,
        gyro=rng.standard_normal((count, 3)),
        accel=rng.standard_normal((count, 3)) + np.array([0.0, 0.0, 9.8]),
        gyro_unit="dps",
        accel_unit="m/s2",
        temp_c=25.0 + rng.standard_normal(count),
    )
    with tempfile.TemporaryDirectory() as folder:
        for name in ("r.parquet", "r.csv", "r.csv.gz"):
            undrift.write_record(record, Path(folder) / name)
            yield name, (Path(folder) / name).read_bytes()
        np.savetxt(Path(folder) / "r.txt", np.column_stack((record.time, record.gyro)), fmt="%.4f")
        yield "r.txt", (Path(folder) / "r.txt").read_bytes()


def _public() -> Iterator[tuple[str, bytes]]:
    for path in sorted(DATA.rglob("*")) if DATA.is_dir() else ():
        if path.is_file() and path.suffix not in (".md", ".json", ".svg", ".png") and "_motion" not in path.name:
            with path.open("rb") as held:
                content = held.read(LARGEST)
            if path.name.endswith(".gz") and not path.name.endswith(".c3d.gz"):
                content = _shorter(path)
            elif b"\0" not in content:
                content = content[: content.rfind(b"\n", 0, LONGEST) + 1]
            elif path.suffix == ".cwa":
                content = content[: 1024 + 512 * 100]
            if path.name == "read_test_data.csv":  # without the stamps that its reader leaves out: a line is a row
                rows = {line.split(b";", 1)[0]: line for line in content.split(b"\n")[::-1]}
                content = b"\n".join([*rows.values()][::-1])
            if len(content) < LARGEST:
                yield path.name, content


def _shorter(path: Path) -> bytes:
    """Return the first lines of a packed text, packed."""
    text = gzip.decompress(path.read_bytes())
    if text.startswith(b"PathFileType"):  # it states its frames
        lines = text.split(b"\n")[: FRAMES + 5]
        values = lines[2].split(b"\t")
        place = lines[1].split(b"\t").index(b"NumFrames")
        values[place] = b"%d" % sum(bool(line.strip()) for line in lines[5:])
        text = b"\n".join([*lines[:2], b"\t".join(values), *lines[3:], b""])
    else:
        text = text[: text.rfind(b"\n", 0, LONGEST) + 1]
    return gzip.compress(text, 1, mtime=0)


# ---- damage

TOKENS = b"\0|\xff|nan|inf|-1|1e999|\n|\r\n|,|\"|[|{|999999999999999999999999999999|$|'|  ".split(b"|")


def damaged(content: bytes, rng: random.Random) -> bytes:
    """Return the content with one to eight faults: bytes, bits, words, pieces left out, repeated, or the end cut off.

    Of a packed text mostly what it holds is damaged.
    """
    if content[:2] == b"\x1f\x8b" and rng.random() < 0.8:
        return gzip.compress(damaged(gzip.decompress(content), rng), 1, mtime=0)
    held = bytearray(content)
    for _ in range(rng.choice((1, 1, 1, 2, 4, 8))):
        if not held:
            break
        at = int(len(held) * rng.random() ** rng.choice((1, 3)))  # headers more often
        length = 1 + int(rng.expovariate(0.1))
        match rng.randrange(12):
            case 0 | 1:
                held[at] = rng.randrange(256)
            case 2:
                held[at] ^= 1 << rng.randrange(8)
            case 3:
                held[at : at + rng.randrange(3)] = rng.choice(TOKENS)
            case 4:
                del held[at : at + length]
            case 5:
                held[at:at] = held[at : at + length]
            case 6:
                other = rng.randrange(len(held))
                held[at : at + length] = held[other : other + length]
            case 7 | 8 | 9:  # of whole lines, or of blocks as a disk has them
                begin, end = _piece(held, at, rng.choice((1, 1, 2, 10)))
                piece = held[begin:end]
                held[begin:end] = rng.choice(
                    (b"", piece + piece, piece[::-1] if rng.random() < 0.1 else bytes(len(piece)))
                )
            case _:
                if rng.random() < 0.3:
                    del held[at:]
    return bytes(held)


def _piece(held: bytearray, at: int, count: int) -> tuple[int, int]:
    """Return the ends of a few lines of text, or of a block of 512 bytes."""
    if b"\0" in held[:4096]:
        return at // 512 * 512, at // 512 * 512 + 512
    begin = end = held.rfind(b"\n", 0, at) + 1
    for _ in range(count):
        end = held.find(b"\n", end) + 1 or len(held)
    return begin, end


def cut_points(content: bytes) -> list[int]:
    """Return where a file, or what a packed text holds, is cut: everywhere in a small one."""
    size = len(gzip.decompress(content)) if content[:2] == b"\x1f\x8b" else len(content)
    if size <= ALL_CUTS:
        return list(range(size))
    rng = random.Random(size)
    return sorted(
        {*(rng.randrange(size) for _ in range(SOME_CUTS // 2)), *(size - 1 - k for k in range(SOME_CUTS // 2))}
    )


def cut(content: bytes, at: int) -> bytes:
    """Return the content, or what a packed text holds, up to a point."""
    return gzip.compress(gzip.decompress(content)[:at], 1, mtime=0) if content[:2] == b"\x1f\x8b" else content[:at]


def limit_memory(gigabytes: float) -> None:
    """Limit what this process may take beyond what it holds."""
    import resource

    held = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmData"))
    most = 1024 * int(held.split()[1]) + int(gigabytes * 1e9)
    resource.setrlimit(resource.RLIMIT_DATA, (most, most))
    os.environ.pop("UNDRIFT_TRACEBACK", None)
