"""``undrift twin``: the device model fitted to a real device, and its errors on recordings held out."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from undrift.base.options import Files, OptionalOutput, verb
from undrift.base.summary import Result, Section, Summary, figure_of, number
from undrift.commands import Progress, part_of, silent
from undrift.commands.files import Opening, Optics, check_output
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

if TYPE_CHECKING:
    from undrift.arrays import FloatArray
    from undrift.twin.fit import Twin
    from undrift.twin.held_out import HeldOutTrial

HELD_OUT = (0.34, 1.0)  # share of the time, of three recordings of two minutes


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Twinned(Result):
    """A device model fitted to a real device, with its errors on recordings held out."""

    names: tuple[str, ...]  # Of the recordings
    fitted: "Twin"
    held_out: "tuple[HeldOutTrial, ...]"
    output: Path | None

    def summary(self) -> Summary:
        """Return the parameters, the residual against the reference, and how well the model predicts."""
        import numpy as np

        fitted, held_out, count = self.fitted, self.held_out, len(self.names)
        known = sum(p.identifiable for p in fitted.parameters)
        answer = f"{known} of {len(fitted.parameters)} parameters of the device are identifiable"
        if held_out:
            differences = np.concatenate([trial.pitch for trial in held_out]) / RADIAN_PER_DEGREE
            median, most, _ = _spread(differences).values()
            answer += (
                f"; held out, its pitch differs from the real device's by at most {most:.2f} deg in 95 % of windows of "
            )
            answer += f"{held_out[0].window_s:g} s (median {median:.2f} deg)"
        alone = "one recording: none could be held out; add a second one to see how well the twin predicts"
        drawing = figure_of("figures:draw_held_out", held_out)
        return Summary(
            title=f"Twin of a real device, from {count} recording{'s' if count > 1 else ''}",
            answer=answer + ".",
            data=_twin_json(fitted, held_out),
            pictures=(drawing,) if held_out else (),
            sections=(
                _parameters(fitted),
                _residuals(fitted, self.names),
                *(_held_out(self) if held_out else ()),
            ),
            findings=fitted.gyro.triad.verdict.findings,
            notes=() if held_out else (alone,),
            written=(self.output,),
            next=("simulate", "sit_to_stand", "--device", self.output, "-o", "trial.parquet") if self.output else (),
        )


@verb
def twin(
    *records: Files,
    optics: Optics = Optics(),
    gravity_m_s2: float = STANDARD_GRAVITY,
    seed: int = 0,
    output: OptionalOutput = None,
    opening: Opening = Opening(),
    progress: Progress = silent,
) -> Twinned:
    """Fit the device model to a real device from recordings with an optical reference.

    With two recordings or more each is held out in turn: a device fitted to the others is simulated on its motion and compared
    with the real readings.

    Parameters
    ----------
    records : Path
        Raw recordings of one device in one mounting; one without a rest has the device's offset in motion.
    gravity_m_s2 : float
        Local gravity, m/s2; the accelerometer's scale is proportional to it.
    seed : int
        Seed of the noise of simulated devices.
    output : Path or None
        device.json to write.
    """
    import numpy as np

    from undrift.sim.device.model import write_device
    from undrift.twin.fit import TwinSettings, fit_prepared, prepare_twin
    from undrift.twin.held_out import compare_held_out, device_of

    check_output(output, endings=("",), reads=(*records, *optics.reference))
    settings, rng = TwinSettings(gravity_m_s2=gravity_m_s2), np.random.default_rng(seed)
    pairs = optics.pairs(records, opening, command="twin")
    names = [record.name.split(".")[0] for record in records]
    progress("aligning", 0.01)
    prepared = prepare_twin([p[0] for p in pairs], [p[1] for p in pairs], settings=settings, names=names)
    progress("fitting", 0.13)
    fitted = fit_prepared(prepared)
    held_out: tuple[HeldOutTrial, ...] = ()
    if len(records) > 1:
        held_out = compare_held_out(prepared, rng=rng, progress=part_of(progress, *HELD_OUT))
    if output is not None:
        first = prepared.matches[0].record
        write_device(device_of(fitted, sample_rate_hz=first.sample_rate_hz, serial=first.device), output)
    return Twinned(names=tuple(names), fitted=fitted, held_out=held_out, output=output)


def _twin_json(fitted: "Twin", held: "tuple[HeldOutTrial, ...]") -> dict[str, object]:
    deg = 1.0 / RADIAN_PER_DEGREE
    accel = fitted.accel
    keys = ("name", "value", "standard_error", "unit", "identifiable", "reason")
    return {
        "parameters": [{key: getattr(p, key) for key in keys} for p in fitted.parameters],
        "heldout": [
            {
                "recording": h.recording,
                "window_s": h.window_s,
                "windows": len(h.pitch),
                "max_abs_pitch_difference_deg": _spread(h.pitch * deg),
                "end_difference_deg": [_spread(axis * deg) for axis in h.end.T],
            }
            for h in held
        ],
        "residual": {
            "gyro_rms_dps": float((fitted.gyro_residual_rms * deg).mean()),
            "gyro_signal_rms_dps": float((fitted.gyro_signal_rms * deg).mean()),
            "accel_rms_m_s2": None if accel is None else float(accel.residual_rms.mean()),
            "accel_signal_rms_m_s2": None if accel is None else float(accel.signal_rms.mean()),
            "cutoff_hz": {"gyro": fitted.settings.gyro_cutoff_hz, "accel": fitted.settings.accel_cutoff_hz},
        },
    }


def _spread(values: "FloatArray") -> dict[str, float]:
    """Return median, 95th percentile and largest of what is not a gap."""
    import numpy as np

    seen = values[np.isfinite(values)]
    if not len(seen):
        return dict.fromkeys(("median", "p95", "max"), float("nan"))
    return {"median": float(np.median(seen)), "p95": float(np.quantile(seen, 0.95)), "max": float(seen.max())}


def _parameters(fitted: "Twin") -> Section:
    """Return the parameters, in brackets those that are not identifiable, and why not."""
    rows, reasons = [], dict[str, list[str]]()
    for p in fitted.parameters:
        value = p.value if isinstance(p.value, str) else number(p.value, ".6g")
        rows.append((p.name, value if p.identifiable else f"({value})", number(p.standard_error, ".2g"), p.unit))
        if not p.identifiable:
            reasons.setdefault(p.reason, []).append(p.name)
    return Section(
        title="parameters of the device (in brackets: not identifiable)",
        columns=("name", "value", "standard error", "unit"),
        rows=tuple(rows),
        text=tuple(f"not identifiable: {', '.join(lost)}: {reason}" for reason, lost in reasons.items()),
        words=True,
    )


def _residuals(fitted: "Twin", names: tuple[str, ...]) -> Section:
    """Return residual and signal of each recording, and what the low-pass is."""
    deg, accel, rows = 1.0 / RADIAN_PER_DEGREE, fitted.accel, []
    for k, name in enumerate(names):
        forces = ("-", "-") if accel is None else (f"{accel.residual_rms[k]:.3f}", f"{accel.signal_rms[k]:.2f}")
        rates = (f"{fitted.gyro_residual_rms[k] * deg:.2f}", f"{fitted.gyro_signal_rms[k] * deg:.1f}")
        rows.append((name, *rates, *forces))
    cutoffs = f"low-pass: gyro {fitted.settings.gyro_cutoff_hz:g} Hz, accel {fitted.settings.accel_cutoff_hz:g} Hz"
    return Section(
        title="residual against the reference, and signal, rms per axis",
        columns=("recording", "gyro dps", "of", "accel m/s2", "of"),
        rows=tuple(rows),
        text=(cutoffs,),
    )


def _held_out(twinned: Twinned) -> tuple[Section, ...]:
    """Return how well devices fitted to the other recordings predict each one."""
    deg = 1.0 / RADIAN_PER_DEGREE
    windows = (
        (one.recording, f"{one.window_s:g}", str(len(one.pitch)), *(f"{v:.2f}" for v in spread.values()))
        for one in twinned.held_out
        for spread in [_spread(one.pitch * deg)]
    )
    title = "held out: largest pitch difference between simulated and real device in a window, deg"
    columns = ("recording", "window s", "windows", "median", "95 %", "max")
    return (Section(title=title, columns=columns, rows=tuple(windows)),)
