"""``undrift twin``: the device model fitted to a real device, and its errors on recordings held out."""

from itertools import chain
from typing import TYPE_CHECKING

from undrift.cli.common import (
    Files,
    Json,
    Opening,
    Optics,
    OptionalOutput,
    Report,
    Steps,
    check_report,
    origin_of,
    say,
    show_table,
    write_json,
)
from undrift.findings import Finding
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

if TYPE_CHECKING:
    from undrift.arrays import FloatArray
    from undrift.twin.fit import Twin
    from undrift.twin.heldout import Ending, HeldOutTrial, Part
    from undrift.twin.witness import Split

HELD_OUT, END_ERRORS = (0.34, 0.55), (0.55, 0.85)  # shares of the time, of three recordings of two minutes


def twin(
    *records: Files,
    optics: Optics = Optics(),
    gravity_m_s2: float = STANDARD_GRAVITY,
    seed: int = 0,
    output: OptionalOutput = None,
    opening: Opening = Opening(),
    report: Report = None,
    json: Json = False,
) -> int:
    """Fit the device model to a real device from recordings with an optical reference.

    With two recordings or more each is held out in turn: a device fitted to the others is simulated on its motion and compared
    with the real readings.

    Parameters
    ----------
    records : Path
        Raw recordings of one device in one mounting; each begins with a rest.
    optics : Optics
        The reference of each recording.
    gravity_m_s2 : float
        Local gravity, m/s2; the accelerometer's scale is proportional to it.
    seed : int
        Seed of the noise of simulated devices.
    output : Path or None
        device.json to write.
    opening : Opening
        How to read foreign recordings.
    report : Path or None
        Report page to write: .html.
    """
    import numpy as np

    from undrift.report.commands import write_twin_report
    from undrift.sim.device.model import write_device
    from undrift.twin.fit import TwinSettings, fit_prepared, prepare_twin
    from undrift.twin.heldout import compare_held_out, contributions, device_of, end_errors
    from undrift.twin.witness import split_twin

    check_report(report, reads=(*records, *optics.reference))
    settings = TwinSettings(gravity_m_s2=gravity_m_s2)
    rng = np.random.default_rng(seed)
    held: tuple[HeldOutTrial, ...] = ()
    endings: tuple[Ending, ...] = ()
    parts: tuple[Part, ...] = ()
    with Steps("twin") as shown:
        pairs = optics.pairs(records, opening, command="twin")
        names = [record.name.split(".")[0] for record in records]
        shown("aligning", 0.01)
        prepared = prepare_twin([p[0] for p in pairs], [p[1] for p in pairs], settings=settings, names=names)
        shown("fitting", 0.13)
        fitted = fit_prepared(prepared, settings=settings)
        split = split_twin(prepared, fitted)
        if len(records) > 1:
            held = compare_held_out(prepared, rng=rng, progress=shown.part(*HELD_OUT))
            endings = end_errors(prepared, rng=rng, progress=shown.part(*END_ERRORS))
            shown("contributions", END_ERRORS[1])
            parts = contributions(prepared, 0, rng=rng)
    if output is not None:
        record = prepared.records[0]
        device = device_of(fitted, sample_rate_hz=record.sample_rate_hz, serial=record.device)
        write_device(device, output)
    if report is not None:
        write_twin_report(report, fitted, held, endings, origin=origin_of(*records, *optics.reference))
    if json:
        write_json(_twin_json(fitted, held, endings, parts, split), "twin")
    else:
        _show(fitted, names, held, endings, parts, split)
        say(*(f"Wrote {path}" for path in (report, output) if path is not None))
    return 0


def _twin_json(
    fitted: "Twin",
    held: "tuple[HeldOutTrial, ...]",
    endings: "tuple[Ending, ...]",
    parts: "tuple[Part, ...]",
    split: "Split | Finding",
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


def _show(
    fitted: "Twin",
    names: list[str],
    held: "tuple[HeldOutTrial, ...]",
    endings: "tuple[Ending, ...]",
    parts: "tuple[Part, ...]",
    split: "Split | Finding",
) -> None:
    deg = 1.0 / RADIAN_PER_DEGREE
    rows, reasons = [], dict[str, list[str]]()
    for p in fitted.parameters:
        value = p.value if isinstance(p.value, str) else f"{p.value:.6g}"
        rows.append((p.name, value if p.identifiable else f"({value})", f"{p.standard_error:.2g}", p.unit))
        if not p.identifiable:
            reasons.setdefault(p.reason, []).append(p.name)
    show_table("parameters of the device", ("name", "value", "standard error", "unit"), rows)
    say(*(f"not identifiable: {', '.join(lost)}: {reason}" for reason, lost in reasons.items()))
    residuals, accel = [], fitted.accel
    for k, name in enumerate(names):
        forces = ("-", "-") if accel is None else (f"{accel.residual_rms[k]:.3f}", f"{accel.signal_rms[k]:.2f}")
        gyro = (f"{fitted.gyro_residual_rms[k] * deg:.2f}", f"{fitted.gyro_signal_rms[k] * deg:.1f}")
        residuals.append((name, *gyro, *forces))
    heads = ("recording", "gyro dps", "of", "accel m/s2", "of")
    show_table("residual against the reference, and signal, rms per axis", heads, residuals)
    say(f"low-pass: gyro {fitted.settings.gyro_cutoff_hz:g} Hz, accel {fitted.settings.accel_cutoff_hz:g} Hz")
    say(split.text)
    if not held:
        say("one recording: none could be held out; add a second one to see how well the twin predicts")
        return
    windows = [
        (
            h.recording,
            f"{h.window_s:g}",
            str(len(h.errors.pitch)),
            *(f"{v:.2f}" for v in _spread(h.errors.pitch * deg).values()),
        )
        for h in held
    ]
    title = "held out: largest pitch difference between simulated and real device in a window, deg"
    show_table(title, ("recording", "window s", "windows", "median", "95 %", "max"), windows)
    say(*{h.recording: found.text for h in held if (found := h.excitation.finding(h.recording)) is not None}.values())
    limits = [(p.name, f"{p.pitch * deg:.3f}", f"{p.tilt * deg:.3f}") for p in parts]
    show_table(f"its contributions, {names[0]}, 5 s windows, median", ("part", "pitch deg", "tilt deg"), limits)
    ends = []
    for e in endings:
        cells = [
            (f"{r * deg:.1f}", f"{low * deg:.1f}-{high * deg:.1f}")
            for r, (low, high) in zip(e.real, e.interval, strict=True)
        ]
        ends.append((e.recording, "none" if e.row == "raw" else "rest", *chain.from_iterable(cells)))
    title = "end error, deg: real, and 95 % of simulated devices"
    show_table(title, ("recording", "offset", "total", "", "incl.", ""), ends)
