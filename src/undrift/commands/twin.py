"""``undrift twin``: fit the device model to a real device, and determine its errors on held-out recordings."""

from collections.abc import Sequence

import numpy as np

from undrift.base.options import Files, OptionalOutput
from undrift.commands.files import Opening, Optics, Reader
from undrift.commands.outputs import check_output
from undrift.report import Report, Table
from undrift.report.figures import draw_held_out
from undrift.screen import part, progress
from undrift.sim.device.model import write_device
from undrift.twin.fit import Twin, fit_twin
from undrift.twin.held_out import WINDOWS_S, HeldOutTrial, compare_held_out, device_of
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY


def twin(
    *records: Files,
    optics: Optics = Optics(),
    gravity_m_s2: float = STANDARD_GRAVITY,
    output: OptionalOutput = None,
    opening: Opening = Opening(),
) -> Report:
    """Fit the device model to a real device from recordings with an optical reference.

    With two recordings or more, each is held out in turn: a device fitted to the others is simulated on its motion and compared
    with the real readings.

    Parameters
    ----------
    records : Path
        Raw recordings of one device in one mounting. A recording without a rest gets the offset of the device in motion.
    gravity_m_s2 : float
        Local gravity, m/s2: the accelerometer's scale is proportional to it.
    output : Path or None
        device.json to write.
    """
    check_output(output, endings=("",), reads=(*records, *optics.reference))
    reader = Reader(opening)
    pairs = optics.pairs(records, reader, command="twin")
    names = [record.name.split(".")[0] for record in records]
    progress("aligning and fitting", 0.01)
    fitted = fit_twin([p[0] for p in pairs], [p[1] for p in pairs], gravity_m_s2=gravity_m_s2, names=names)
    held_out: tuple[HeldOutTrial, ...] = ()
    if len(records) > 1:
        with part(0.34, 1.0):
            held_out = compare_held_out(fitted, rng=np.random.default_rng(0), progress=progress)
    if output is not None:
        first = fitted.prepared.matches[0].record
        write_device(device_of(fitted, sample_rate_hz=first.sample_rate_hz, serial=first.device), output)
    note = "A single recording cannot be held out. Add a second recording to measure the accuracy of the twin."
    return Report(
        title=f"Twin of a real device, from {', '.join(names)}",
        answer=_answer(fitted, held_out),
        tables=[_parameters(fitted), _windows(held_out)],
        details=[_unidentified(fitted)],
        notes=reader.notes if held_out else [*reader.notes, note],
        findings=fitted.gyro.triad.verdict.findings,
        figures=[lambda: draw_held_out(held_out)] if held_out else [],
        written=[output] if output else [],
        next_command=["simulate", "sit_to_stand", "--device", output, "-o", "trial.parquet"] if output else [],
    )


def _answer(fitted: Twin, held_out: Sequence[HeldOutTrial]) -> str:
    count = sum(parameter.identifiable for parameter in fitted.parameters)
    text = f"The recordings identify {count} of {len(fitted.parameters)} parameters of the device."
    short = [trial.pitch for trial in held_out if trial.window_s == WINDOWS_S[0]]
    if not short:
        return text
    median, most = np.nanquantile(np.concatenate(short), (0.5, 0.95)) / RADIAN_PER_DEGREE
    return (
        f"{text} On held-out recordings, its pitch differs from that of the real device by at most {most:.2f} deg in 95 % of "
        f"windows of {WINDOWS_S[0]:g} s (median {median:.2f} deg)."
    )


def _parameters(fitted: Twin) -> Table:
    rows = [(p.name, p.value, p.standard_error, p.unit) for p in fitted.parameters if p.identifiable]
    columns = ("parameter", "value", "standard error", "unit")
    form = {"value": ".6g", "standard error": ".2g"}
    return Table(title="Parameters of the device", columns=columns, rows=rows, form=form)


def _unidentified(fitted: Twin) -> Table:
    rows = [(p.name, p.reason) for p in fitted.parameters if not p.identifiable]
    return Table(title="Not identified", columns=("parameter", "reason"), rows=rows)


def _windows(held_out: Sequence[HeldOutTrial]) -> Table:
    """Return the largest pitch difference in a window: median, 95th percentile and largest of the windows."""
    rows = []
    for trial in held_out:
        pitch_deg = trial.pitch[np.isfinite(trial.pitch)] / RADIAN_PER_DEGREE
        spread = np.quantile(pitch_deg, (0.5, 0.95, 1.0)).tolist() if len(pitch_deg) else [np.nan] * 3
        rows.append((trial.recording, trial.window_s, len(trial.pitch), *spread))
    columns = ("recording", "window (s)", "windows", "median (deg)", "95 % (deg)", "largest (deg)")
    form = dict.fromkeys(columns[3:], ".2f")
    note = "Each value is the largest difference of pitch between the simulated and the real device in a window."
    return Table(title="Held-out recordings", columns=columns, rows=rows, form=form, note=note if rows else "")
