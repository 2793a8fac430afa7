"""``undrift certificate``: write a calibration certificate as one HTML page that prints on A4."""

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from undrift.base.options import Output, options
from undrift.commands.outputs import check_output
from undrift.errors import InputError
from undrift.files import checked_file
from undrift.io.store import read_calibration
from undrift.report import Report
from undrift.report.certificate import BY_HAND, certificate_report, write_certificate

LONGEST = 200  # largest number of characters of an entry
LIMITS = tuple(  # keys of a file of limits
    f"{name}_{key}"
    for name, offset in (("gyro", "offset_dps"), ("accel", "offset_mg"))
    for key in ("scale_percent", "cross_percent", offset)
)


@options
@dataclass(frozen=True, kw_only=True)
class Statement:
    """Entries of the laboratory that ISO/IEC 17025 requires. For missing entries, the certificate has lines to fill in by hand.

    Parameters
    ----------
    number : str
        Number of the certificate.
    laboratory : str
        Name and address of the laboratory.
    operator : str
        Name of the person who calibrated.
    """

    number: str = ""
    laboratory: str = ""
    operator: str = ""

    def entries(self) -> Mapping[str, str]:
        """Return the entries by their labels on the page. Missing entries are empty."""
        labels = {"number": "Certificate number", "laboratory": "Laboratory", "operator": "Calibrated by"}
        for name in labels:
            if not (text := getattr(self, name)).isprintable() or len(text) > LONGEST:
                raise InputError(
                    f"`{name}`: expected one line of at most {LONGEST} characters, got {text[:20]!r}.... Shorten it."
                )
        return {label: getattr(self, name).strip() for name, label in labels.items()}


def certificate(
    calibration: Path, /, *, output: Output, statement: Statement = Statement(), limits: Path | None = None
) -> Report:
    """Write a calibration certificate with results, expanded uncertainty, budget by source, reference values and limits.

    The page prints on A4. The same calibration and statements give the same file, byte for byte.

    Parameters
    ----------
    calibration : Path
        calibration.json of the device.
    output : Path
        The page, named *.html.
    limits : Path or None
        Limits of the readings before correction, .toml, such as gyro_offset_dps = 20 or accel_scale_percent = 3.
    """
    check_output(output, endings=(".html",), reads=(calibration, limits))
    model, entries = read_calibration(calibration), statement.entries()
    report = certificate_report(model, {} if limits is None else read_limits(limits))
    write_certificate(model, output, report, entries)
    blank_entries = [*(label for label, text in entries.items() if not text), *BY_HAND]
    return replace(
        report,
        notes=[f"Lines to fill in by hand: {', '.join(blank_entries).lower()}."],
        written=[output],
        data={**report.data, "statement": entries},
    )


def read_limits(path: Path) -> dict[str, float]:
    """Return the limits in a file, by their keys in ``LIMITS``."""
    try:
        limits = tomllib.loads(checked_file(path).read_text(encoding="utf-8"))
    except ValueError as error:
        raise InputError(
            f"{path}: expected limits as TOML, got {error}. For example, write accel_offset_mg = 50."
        ) from error
    for key, limit in limits.items():
        if key not in LIMITS or not isinstance(limit, int | float) or not 0.0 < limit < math.inf:
            raise InputError(f"{path}: expected one of {', '.join(LIMITS)} above 0, got {key} = {limit}. Correct it.")
    return {key: float(limit) for key, limit in limits.items()}
