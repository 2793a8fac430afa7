"""``undrift twin``: the device model fitted to a real device, and how far it can be trusted."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from undrift.cli.common import Opening
from undrift.errors import InputError
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

if TYPE_CHECKING:
    from undrift.arrays import FloatArray
    from undrift.twin.fit import Prepared, Twin
    from undrift.twin.heldout import Ending, HeldOutTrial, Part


def twin(
    *records: Path,
    reference: tuple[Path, ...] = (),
    gravity_m_s2: float = STANDARD_GRAVITY,
    seed: int = 0,
    markers: str | None = None,
    reference_up: Literal["y", "z"] | None = None,
    output: Annotated[Path | None, Parameter(name=["--output", "-o"])] = None,
    opening: Opening = Opening(),
    json: bool = False,
) -> int:
    """Fit the device model to a real device from recordings with an optical reference.

    With two recordings or more each is held out in turn: a device fitted to the others is simulated on its motion and compared
    with what the real one said.

    Parameters
    ----------
    records : Path
        Raw recordings of one device in one mounting; each begins with a rest.
    reference : Path
        The reference of each recording, in the same order; a BROAD file holds its own.
    gravity_m_s2 : float
        Local gravity: the accelerometer's scale stands and falls with it.
    seed : int
        Of the noise of simulated devices.
    markers : str or None
        Labels of one rigid cluster, with commas between, for C3D and TRC.
    reference_up : str or None
        Laboratory axis that points up, for C3D and TRC.
    output : Path or None
        device.json to write.
    opening : Opening
        How to read foreign recordings.
    json : bool
        One JSON object on stdout.

    Returns
    -------
    int
        Exit code.
    """
    import numpy as np

    from undrift.cli.common import read_pairs, waiting, write_json
    from undrift.twin.fit import TwinSettings, fit_prepared, prepare_twin
    from undrift.twin.heldout import compare_held_out, contributions, end_errors

    if not records:
        raise InputError("twin: wanted one recording or more, got none; name them first")
    settings = TwinSettings(gravity_m_s2=gravity_m_s2)
    labels = tuple(markers.split(",")) if markers else None
    rng = np.random.default_rng(seed)
    held: tuple[HeldOutTrial, ...] = ()
    endings: tuple[Ending, ...] = ()
    parts: tuple[Part, ...] = ()
    with waiting("reading, fitting and simulating"):
        pairs = read_pairs(records, reference, labels, reference_up, opening, command="twin")
        names = [record.name.split(".")[0] for record in records]
        prepared = prepare_twin([p[0] for p in pairs], [p[1] for p in pairs], settings=settings, names=names)
        fitted = fit_prepared(prepared, settings=settings)
        if len(records) > 1:
            held = compare_held_out(prepared, rng=rng)
            endings = end_errors(prepared, rng=rng)
            parts = contributions(prepared, 0, rng=rng)
    if output is not None:
        _write(fitted, prepared, output)
    if json:
        write_json(twin_json(fitted, held, endings, parts))
    else:
        _show(fitted, held, endings, parts, names)
        if output is not None:
            _say(f"Wrote {output}")
    return 0


def twin_json(
    fitted: "Twin", held: "tuple[HeldOutTrial, ...]", endings: "tuple[Ending, ...]", parts: "tuple[Part, ...]"
) -> dict[str, object]:
    """Return a twin under the names that other programs rely on.

    Parameters
    ----------
    fitted : Twin
        Parameters and residuals.
    held : tuple of HeldOutTrial
        Windows of held-out recordings.
    endings : tuple of Ending
        End errors of simulated devices beside the real one.
    parts : tuple of Part
        What limits the twin on the first recording.

    Returns
    -------
    dict
        parameters, heldout, residual; and end_errors, contributions.
    """
    deg = 1.0 / RADIAN_PER_DEGREE
    accel = fitted.accel
    return {
        "parameters": [
            {
                "name": p.name,
                "value": p.value,
                "standard_error": p.standard_error,
                "unit": p.unit,
                "identifiable": p.identifiable,
                "reason": p.reason,
            }
            for p in fitted.parameters
        ],
        "heldout": [
            {
                "recording": h.recording,
                "window_s": h.window_s,
                "windows": len(h.errors.pitch),
                "max_abs_pitch_difference_deg": spread(h.errors.pitch * deg),
                "max_tilt_difference_deg": spread(h.errors.tilt * deg),
                "end_difference_deg": [spread(axis * deg) for axis in h.errors.end.T],
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
            {
                "recording": e.recording,
                "row": e.row,
                "real_deg": e.real * deg,
                "simulated_95_deg": e.interval * deg,
                "covered": e.covered,
            }
            for e in endings
        ],
        "contributions": [
            {"name": p.name, "pitch_median_deg": p.pitch * deg, "tilt_median_deg": p.tilt * deg} for p in parts
        ],
    }


def spread(values: "FloatArray") -> dict[str, float]:
    """Return median, 95th percentile and largest of what is not a gap.

    Parameters
    ----------
    values : array, shape (W,)
        Any unit.

    Returns
    -------
    dict
        median, p95, max.
    """
    import numpy as np

    seen = values[np.isfinite(values)]
    if not len(seen):
        return dict.fromkeys(("median", "p95", "max"), float("nan"))
    return {"median": float(np.median(seen)), "p95": float(np.quantile(seen, 0.95)), "max": float(seen.max())}


def _write(fitted: "Twin", prepared: "Prepared", path: Path) -> None:
    from undrift.sim.device.model import write_device
    from undrift.twin.heldout import device_of

    record = prepared.records[0]
    write_device(device_of(fitted, sample_rate_hz=record.sample_rate_hz, serial=record.device), path)


def _say(text: str) -> None:
    from undrift.cli.common import console

    console().print(text, markup=False)


def _show(
    fitted: "Twin",
    held: "tuple[HeldOutTrial, ...]",
    endings: "tuple[Ending, ...]",
    parts: "tuple[Part, ...]",
    names: list[str],
) -> None:
    from undrift.cli.common import console, table

    out, deg = console(), 1.0 / RADIAN_PER_DEGREE
    shown = table("parameters of the device", "name", "value", "standard error", "unit")
    reasons: dict[str, list[str]] = {}
    for p in fitted.parameters:
        value = p.value if isinstance(p.value, str) else f"{p.value:.6g}"
        shown.add_row(p.name, value if p.identifiable else f"({value})", f"{p.standard_error:.2g}", p.unit)
        if not p.identifiable:
            reasons.setdefault(p.reason, []).append(p.name)
    out.print(shown, markup=False)
    for reason, lost in reasons.items():
        out.print(f"not identifiable: {', '.join(lost)}: {reason}", markup=False)
    shown = table("against the poses, rms per axis", "recording", "gyro dps", "of", "accel m/s2", "of")
    for k, name in enumerate(names):
        accel = ("-", "-") if fitted.accel is None else (
            f"{fitted.accel.residual_rms[k]:.3f}", f"{fitted.accel.signal_rms[k]:.2f}"
        )  # fmt: skip
        gyro = fitted.gyro_residual_rms[k] * deg, fitted.gyro_signal_rms[k] * deg
        shown.add_row(name, f"{gyro[0]:.2f}", f"{gyro[1]:.1f}", *accel)
    out.print(shown, markup=False)
    out.print(
        f"low-pass: gyro {fitted.settings.gyro_cutoff_hz:g} Hz, accel {fitted.settings.accel_cutoff_hz:g} Hz",
        markup=False,
    )
    if not held:
        out.print(
            "one recording: none could be held out; add a second one to see how far the twin carries", markup=False
        )
        return
    _show_held(held, endings, parts, names)


def _show_held(
    held: "tuple[HeldOutTrial, ...]", endings: "tuple[Ending, ...]", parts: "tuple[Part, ...]", names: list[str]
) -> None:
    from undrift.cli.common import console, table

    out, deg = console(), 1.0 / RADIAN_PER_DEGREE
    title = "held out: largest pitch difference between simulated and real device in a window, deg"
    shown = table(title, "recording", "window s", "windows", "median", "95 %", "max")
    for h in held:
        three = spread(h.errors.pitch * deg).values()
        shown.add_row(h.recording, f"{h.window_s:g}", str(len(h.errors.pitch)), *(f"{v:.2f}" for v in three))
    out.print(shown, markup=False)
    shown = table(f"what makes it, {names[0]}, 5 s windows, median", "part", "pitch deg", "tilt deg")
    for p in parts:
        shown.add_row(p.name, f"{p.pitch * deg:.3f}", f"{p.tilt * deg:.3f}")
    out.print(shown, markup=False)
    shown = table(
        "end error, deg: real, and 95 % of simulated devices", "recording", "offset", "total", "", "incl.", ""
    )
    for e in endings:
        cells = [
            (f"{r * deg:.1f}", f"{low * deg:.1f}-{high * deg:.1f}")
            for r, (low, high) in zip(e.real, e.interval, strict=True)
        ]
        shown.add_row(e.recording, "none" if e.row == "raw" else "rest", *cells[0], *cells[1])
    out.print(shown, markup=False)
