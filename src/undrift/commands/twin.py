"""``undrift twin``: the device model fitted to a real device, and its errors on recordings held out."""

from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

from undrift.base.options import Files, OptionalOutput, verb
from undrift.base.summary import Result, Section, Summary, figure_of, number
from undrift.commands import Progress, part_of, silent
from undrift.commands.files import Opening, Optics, check_output
from undrift.findings import Finding
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

if TYPE_CHECKING:
    from undrift.arrays import FloatArray
    from undrift.twin.fit import Twin
    from undrift.twin.heldout import Ending, ErrorSource, HeldOutTrial
    from undrift.twin.witness import OpticsSplit

HELD_OUT, END_ERRORS = (0.34, 0.55), (0.55, 0.85)  # shares of the time, of three recordings of two minutes


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Twinned(Result):
    """A device model fitted to a real device, with its errors on recordings held out."""

    names: tuple[str, ...]  # Of the recordings
    fitted: "Twin"
    held_out: "tuple[HeldOutTrial, ...]"
    endings: "tuple[Ending, ...]"
    parts: "tuple[ErrorSource, ...]"
    split: "OpticsSplit | Finding"
    unseen: "tuple[Finding, ...]"  # Axes about which it was never turned
    output: Path | None

    def summary(self) -> Summary:
        """Return the parameters, the residual against the reference, and how well the model predicts."""
        import numpy as np

        from undrift.io.store import findings_json

        fitted, held_out, count = self.fitted, self.held_out, len(self.names)
        known = sum(p.identifiable for p in fitted.parameters)
        answer = f"{known} of {len(fitted.parameters)} parameters of the device are identifiable"
        if held_out:
            differences = np.concatenate([one.errors.pitch for one in held_out]) / RADIAN_PER_DEGREE
            median, most, _ = _spread(differences).values()
            answer += (
                f"; held out, its pitch differs from the real device's by at most {most:.2f} deg in 95 % of windows of "
            )
            answer += f"{held_out[0].window_s:g} s (median {median:.2f} deg)"
        alone = "one recording: none could be held out; add a second one to see how well the twin predicts"
        drawing = figure_of("figures:draw_held_out", held_out)
        beyond = (item for one in held_out if (item := one.excitation.finding(one.recording)) is not None)
        findings = tuple({one.text: one for one in (*self.unseen, *beyond)}.values())
        return Summary(
            title=f"Twin of a real device, from {count} recording{'s' if count > 1 else ''}",
            answer=answer + ".",
            data=_twin_json(fitted, held_out, self.endings, self.parts, self.split)
            | {"findings": findings_json(findings)},
            pictures=(drawing,) if held_out else (),
            sections=(
                _parameters(fitted),
                _residuals(fitted, self.names, self.split),
                *(_held_out(self) if held_out else ()),
            ),
            findings=findings,
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
    from undrift.twin.heldout import compare_held_out, contributions, device_of, end_errors, not_excited
    from undrift.twin.witness import split_twin

    check_output(output, endings=("",), reads=(*records, *optics.reference))
    settings, rng = TwinSettings(gravity_m_s2=gravity_m_s2), np.random.default_rng(seed)
    pairs = optics.pairs(records, opening, command="twin")
    names = [record.name.split(".")[0] for record in records]
    progress("aligning", 0.01)
    prepared = prepare_twin([p[0] for p in pairs], [p[1] for p in pairs], settings=settings, names=names)
    progress("fitting", 0.13)
    fitted = fit_prepared(prepared, settings=settings)
    split = split_twin(prepared, fitted)
    held_out: tuple[HeldOutTrial, ...] = ()
    endings: tuple[Ending, ...] = ()
    parts: tuple[ErrorSource, ...] = ()
    if len(records) > 1:
        held_out = compare_held_out(prepared, rng=rng, progress=part_of(progress, *HELD_OUT))
        endings = end_errors(prepared, rng=rng, progress=part_of(progress, *END_ERRORS))
        progress("contributions", END_ERRORS[1])
        parts = contributions(prepared, 0, rng=rng)
    if output is not None:
        first = prepared.records[0]
        write_device(device_of(fitted, sample_rate_hz=first.sample_rate_hz, serial=first.device), output)
    missing = not_excited(prepared, fitted)
    return Twinned(
        names=tuple(names), fitted=fitted, held_out=held_out, endings=endings, parts=parts, split=split, output=output,
        unseen=() if missing is None else (missing,),
    )  # fmt: skip


def _twin_json(
    fitted: "Twin",
    held: "tuple[HeldOutTrial, ...]",
    endings: "tuple[Ending, ...]",
    parts: "tuple[ErrorSource, ...]",
    split: "OpticsSplit | Finding",
) -> dict[str, object]:
    deg = 1.0 / RADIAN_PER_DEGREE
    accel = fitted.accel
    keys = ("name", "value", "standard_error", "unit", "identifiable", "reason")
    return {
        "parameters": [{key: getattr(p, key) for key in keys} for p in fitted.parameters],
        "heldout": [
            {
                "recording": h.recording,
                "window_s": h.window_s,
                "windows": len(h.errors.pitch),
                "max_abs_pitch_difference_deg": _spread(h.errors.pitch * deg),
                "max_tilt_difference_deg": _spread(h.errors.tilt * deg),
                "end_difference_deg": [_spread(axis * deg) for axis in h.errors.end.T],
                "excitation": {
                    "beyond_training": h.excitation.beyond,
                    "leverage": h.excitation.leverage,
                    "predicted_deg": h.excitation.predicted * deg,
                    "trained_deg": h.excitation.trained * deg,
                    "axis_share": h.excitation.axis_share,
                },
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
        "end_errors": [
            {key: getattr(e, key) for key in ("recording", "row", "covered")}
            | {"real_deg": e.real * deg, "simulated_95_deg": e.interval * deg}
            for e in endings
        ],
        "split": {"finding": split.text} if isinstance(split, Finding) else split.row(),
        "contributions": [
            {"name": p.name, "pitch_median_deg": p.pitch * deg, "tilt_median_deg": p.tilt * deg} for p in parts
        ],
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


def _residuals(fitted: "Twin", names: tuple[str, ...], split: "OpticsSplit | Finding") -> Section:
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
        text=(cutoffs, split.text),
    )


def _held_out(twinned: Twinned) -> tuple[Section, ...]:
    """Return how well devices fitted to the other recordings predict each one."""
    deg = 1.0 / RADIAN_PER_DEGREE
    windows = (
        (one.recording, f"{one.window_s:g}", str(len(one.errors.pitch)), *(f"{v:.2f}" for v in spread.values()))
        for one in twinned.held_out
        for spread in [_spread(one.errors.pitch * deg)]
    )
    limits = ((part.name, f"{part.pitch * deg:.3f}", f"{part.tilt * deg:.3f}") for part in twinned.parts)
    ends = []
    for e in twinned.endings:
        pairs = zip(e.real, e.interval, strict=True)
        cells = ((f"{real * deg:.1f}", f"{low * deg:.1f}-{high * deg:.1f}") for real, (low, high) in pairs)
        ends.append((e.recording, "none" if e.row == "raw" else "rest", *chain.from_iterable(cells)))
    title = "held out: largest pitch difference between simulated and real device in a window, deg"
    tables = (
        (title, ("recording", "window s", "windows", "median", "95 %", "max"), windows),
        (f"its contributions, {twinned.names[0]}, 5 s windows, median", ("part", "pitch deg", "tilt deg"), limits),
        (
            "end error, deg: real, and 95 % of simulated devices",
            ("recording", "offset", "total", "", "incl.", ""),
            ends,
        ),
    )
    return tuple(Section(title=title, columns=columns, rows=tuple(rows)) for title, columns, rows in tables)
