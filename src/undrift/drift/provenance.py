"""Where tuning tables came from: files, choices, versions; those of an earlier thermal fit go with its tables."""

from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import version

from undrift.calibration.model import Calibration, Provenance
from undrift.drift.verdict import mark_before
from undrift.session import Session

_INPUTS = "drift_inputs_before"


def drift_provenance(
    device: Calibration, sessions: Sequence[Session], *, spline: str, lag_s: float, tables: str
) -> Provenance:
    """Return the provenance of a calibration with tuning tables.

    Parameters
    ----------
    device : Calibration
        Without what an earlier thermal fit said.
    sessions : sequence of Session
        What the tables rest on.
    spline : str
        Kind of curve.
    lag_s : float
        Lag of the thermometer that was taken off, s.
    tables : str
        Which there are beside the static one.

    Returns
    -------
    Provenance
        Of both fits.
    """
    held = device.provenance
    known = dict(held.settings).get(_INPUTS, "")
    before = held.inputs[: int(known)] if known.isdigit() else held.inputs
    inputs = dict.fromkeys((*before, *(entry for session in sessions for entry in session.inputs)))
    return Provenance(
        inputs=tuple(inputs),
        settings=(
            *(entry for entry in held.settings if not entry[0].startswith("drift_")),
            ("drift_spline", spline),
            ("drift_lag_s", f"{lag_s:.4g}"),
            ("drift_tables", "static" if tables == "none" else f"static, {tables}"),
            ("drift_sessions", f"{len(sessions)}"),
            (_INPUTS, f"{len(before)}"),
            mark_before(device.verdict),
        ),
        versions=held.versions or tuple((name, version(name)) for name in ("undrift", "numpy", "scipy")),
        created=datetime.now(UTC).isoformat(timespec="seconds"),
    )
