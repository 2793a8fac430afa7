"""``undrift certificate``: a calibration certificate with uncertainty budget, as a PDF."""

from pathlib import Path

from undrift.base.options import Details, Json, Output
from undrift.cli.common import say, show_verdict, write_json
from undrift.cli.register import Register, say_registered
from undrift.commands.files import check_output


def certificate(
    calibration: Path,
    /,
    *,
    output: Output,
    registering: Register = Register(),
    details: Details = False,
    json: Json = False,
) -> int:
    """Write a calibration certificate: results with expanded uncertainty, budget by source, traceability, limits.

    The same calibration gives the same file, byte for byte.

    Parameters
    ----------
    calibration : Path
        calibration.json of the device.
    output : Path
        The file, named *.pdf.
    registering : Register
        Whether the calibration and its certificate are added to the registry of devices.

    Returns
    -------
    int
        0, or 1 when the calibration's own verdict is bad.
    """
    from undrift.io.store import content_hash, read_calibration, verdict_json
    from undrift.report.certificate import certificate_content, write_certificate

    check_output(output, endings=(".pdf",), reads=(calibration,))
    model = read_calibration(calibration)
    registering.check(model.device)
    write_certificate(model, output)
    kept = registering.add(calibration, output)
    if json:
        triads = certificate_content(model)["triads"]
        answer = {"file": str(output), "content_sha256": content_hash(model), "triads": triads}
        answer |= {"registered": kept} if kept else {}
        write_json(answer | {"verdict": verdict_json(model.verdict)}, "certificate")
    else:
        show_verdict(model.verdict, details=details)
        say(f"Wrote {output}")
        say_registered(kept)
    return 1 if model.verdict.status == "bad" else 0
