"""``undrift demo``: the whole flow on a small simulated session, from raw counts to degrees.

The device is simulated, the rest is not: the session is written to disk and read back, and nothing that fits or corrects
knows the truth. The truth serves the checks at the end alone.
"""

import json as text_json
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from undrift.cli.opening import Flag
from undrift.errors import InputError

if TYPE_CHECKING:
    from undrift.calibration.model import Calibration
    from undrift.sim import Demo
    from undrift.validation import Trial

SEED = 2007


class Check(NamedTuple):
    """A figure, the limit it is held to, and whether it keeps it."""

    name: str
    value: float
    limit: float

    @property
    def passed(self) -> bool:
        """True where the value does not exceed the limit."""
        return bool(self.value <= self.limit)


def demo(*, out: Path = Path("demo"), quick: Flag = False, json: Flag = False) -> int:
    """Calibrate a simulated device, correct a sit-to-stand, and compare it with the optics.

    Parameters
    ----------
    out : Path
        Folder for the session, the corrected trial, report.html and summary.json.
    quick : bool
        Fewer rates on the table: seconds instead of more seconds.
    json : bool
        summary.json on stdout too.

    Returns
    -------
    int
        0, or 1 when a check fails.
    """
    import numpy as np

    from undrift.calibration.procedure import calibrate
    from undrift.calibration.store import calibration_json, read_calibration, write_calibration
    from undrift.cli.output import console, plain, waiting, write_json
    from undrift.correct import correct_checked
    from undrift.files import write_whole
    from undrift.io.recording import read_record, write_record
    from undrift.io.reference import read_reference, write_reference
    from undrift.io.session import read_session, write_session
    from undrift.sim import demo_session
    from undrift.validation import TrialSettings, validate_trial

    _check_fresh(out)
    with waiting("simulating, calibrating, validating"):
        made = demo_session(np.random.default_rng(SEED), quick=quick)
        write_session(made.session, out / "session")
        write_record(made.trial.record, out / "trial.parquet")
        write_reference(made.trial.reference, out / "reference.parquet")
        write_calibration(calibrate(read_session(out / "session")), out / "calibration.json")
        calibration = read_calibration(out / "calibration.json")
        record, reference = read_record(out / "trial.parquet"), read_reference(out / "reference.parquet")
        write_record(correct_checked(record, calibration).record, out / "corrected.parquet")
        before = validate_trial(
            record,
            reference,
            calibration=made.nominal,
            settings=TrialSettings(offset="rest"),
            name="nominal, rest offset",
        )
        after = validate_trial(record, reference, calibration=calibration, name="calibrated")
    checks = _checks(made, calibration, before, after)
    summary = {
        "calibration": calibration_json(calibration),
        "study": None,
        "checks": [{"name": c.name, "value": c.value, "limit": c.limit, "pass": c.passed} for c in checks],
    }
    write_whole(out / "summary.json", text_json.dumps(plain(summary), indent=1, allow_nan=False) + "\n")
    _report(out / "report.html", calibration, (before, after), checks)
    if json:
        write_json(summary)
    else:
        shown = console()
        for check in checks:
            shown.print(
                f"{'pass' if check.passed else 'FAIL'}  {check.name}: {check.value:.3g} (at most {check.limit:.3g})"
            )
        for key, name in (("rmse_pitch_deg", "rms"), ("max_abs_pitch_deg", "largest")):
            shown.print(
                f"      pitch error, {name}: {getattr(before.figures, key):.2f} deg with the data sheet's scale and the rest "
                f"offset, {getattr(after.figures, key):.2f} deg calibrated",
                markup=False,
            )
        shown.print(f"Wrote {out}: look at {out / 'report.html'}", markup=False)
    return 0 if all(check.passed for check in checks) else 1


def _check_fresh(out: Path) -> None:
    """Refuse a folder that holds somebody's own files."""
    from undrift.cli.writing import checked_folder

    checked_folder(out)
    if out.is_dir() and any(out.iterdir()) and not (out / "summary.json").is_file():
        raise InputError(
            f"{out}: wanted a new folder, or that of an earlier demo, got one with other files; name another"
        )


def _checks(made: "Demo", calibration: "Calibration", before: "Trial", after: "Trial") -> list[Check]:
    """Return the figures of the demo.

    Limits: of the 18 elements of a fitted matrix and its g-sensitivity, none departs from the truth by more than 4 standard
    uncertainties (chance: 1 in 1,000); the calibrated trial errs at most by a quarter of the data sheet's.
    """
    from undrift.sim import largest_departure, true_calibration

    truth = true_calibration(made.device, temp_c=calibration.reference_temp_c)
    checks = [
        Check(
            f"{name}: largest departure from the truth (standard uncertainties)", largest_departure(fitted, true), 4.0
        )
        for name, fitted, true in (
            ("accelerometers", calibration.accel, truth.accel),
            ("gyroscopes", calibration.gyro, truth.gyro),
        )
        if fitted is not None and true is not None
    ]
    for name, key in (("largest", "max_abs_pitch_deg"), ("rms", "rmse_pitch_deg")):
        value, limit = getattr(after.figures, key), 0.25 * getattr(before.figures, key)
        checks.append(Check(f"sit-to-stand pitch against the optics, {name} error (deg)", value, limit))
    return checks


def _report(path: Path, calibration: "Calibration", trials: tuple["Trial", ...], checks: list[Check]) -> None:
    from undrift.report.calibration import calibration_sections
    from undrift.report.page import Section, write_page
    from undrift.report.validation import trial_section, trials_section

    rows = tuple((c.name, f"{c.value:.3g}", f"{c.limit:.3g}", "yes" if c.passed else "NO") for c in checks)
    held = Section(title="Checks", columns=("figure", "value", "at most", "kept"), rows=rows)
    write_page(
        path,
        title="undrift demo: a simulated device, from raw counts to degrees",
        lead="Six faces and a rate table calibrate the device; a sit-to-stand is corrected and held against the optics.",
        verdict=calibration.verdict,
        sections=(held, *calibration_sections(calibration), trials_section(trials), *map(trial_section, trials)),
    )
