"""A session of 114 dwells, a file each: processor time of reading it, in a box and with ``--trust``.

Of the library alone in this process, and of ``undrift info`` and ``undrift calibrate``, each a fresh process, their boxes
included.
"""

import resource
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

import undrift
from benchmarks.figure import Figure
from undrift.files import LIMITS
from undrift.sim.device.presets import preset
from undrift.sim.device.simulate import simulate_device
from undrift.sim.motion.bench import BenchSettings, bench_motion

RATES = np.radians(np.arange(5, 91, 5))  # both ways about three axes, and three rests in halves: 114 dwells
DWELL_S = 20.0
ROUNDS = 3


def run() -> list[Figure]:
    """Measure.

    Returns
    -------
    list of Figure
        Seconds of processor time, and the ratio of a box to a trusted session.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "session"
        dwells = _write(folder)
        figures = []
        for what, once in (
            (f"read_session, {dwells} dwells", lambda trust: _read(folder, trust)),
            ("undrift info", lambda trust: _command("info", folder, trust)),
            ("undrift calibrate", lambda trust: _command("calibrate", folder, trust)),
        ):
            boxed, trusted = (_seconds(once, trust) for trust in (False, True))
            figures += [Figure(f"{what}: in a box", boxed, "s", ""), Figure(f"{what}: trusted", trusted, "s", "")]
            gate = "<= 1.2" if what.startswith("undrift") else ""  # alone, a fork and a copy of the arrays show
            figures.append(Figure(f"{what}: ratio", boxed / trusted, "x", gate))
    return figures


def _write(folder: Path) -> int:
    """Write the session, and return the number of its recordings."""
    rng = np.random.default_rng(0)
    settings = BenchSettings(turn_rates=tuple(RATES), dwell_s=DWELL_S, still_s=DWELL_S)
    motion = bench_motion("rate_table", rng=rng, settings=settings)
    record = simulate_device(preset("mpu6050"), motion, rng=rng, temp_c=25.0, power_on_s=3600.0).record
    halves = [
        replace(p, start=a, stop=b)
        for p in motion.stills
        for a, b in pairwise((p.start, (p.start + p.stop) // 2, p.stop))
    ]
    stills, turns = tuple(halves), motion.turns
    records = [record.part(piece.start, piece.stop) for piece in (*stills, *turns)]
    stills = tuple(replace(p, start=0, stop=len(records[k]), recording=k) for k, p in enumerate(stills))
    turns = tuple(
        replace(p, start=0, stop=len(records[k]), recording=k) for k, p in enumerate(turns, start=len(stills))
    )
    undrift.write_session(
        undrift.Session(
            kind="calibration",
            serial="simulated",
            gravity_m_s2=9.81,
            records=tuple(records),
            stills=stills,
            turns=turns,
        ),
        folder,
    )
    return len(records)


def _seconds(once: Callable[[bool], None], trust: bool) -> float:
    """Return the processor time of one run, its children's included."""

    def used() -> float:
        held = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
        return sum(usage.ru_utime + usage.ru_stime for usage in held)

    seconds = []
    for _ in range(ROUNDS):
        start = used()
        once(trust)
        seconds.append(used() - start)
    return statistics.median(seconds)


def _read(folder: Path, trust: bool) -> None:
    LIMITS.trust = trust
    try:
        undrift.read_session(folder)
    finally:
        LIMITS.trust = False


def _command(name: str, folder: Path, trust: bool) -> None:
    words = [name, str(folder), *(["-o", str(folder.parent / "calibration.json")] if name == "calibrate" else [])]
    command = [sys.executable, "-m", "undrift", *words, *(["--trust"] if trust else [])]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
