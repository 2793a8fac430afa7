"""``undrift certificate``: a calibration certificate with uncertainty budget, as a PDF."""

from pathlib import Path

from undrift.cli.common import Details, Json, Output, check_output, say, show_verdict, write_json


def certificate(calibration: Path, /, *, output: Output, details: Details = False, json: Json = False) -> int:
    """Write a calibration certificate: results with expanded uncertainty, budget by source, traceability, limits.

    The same calibration gives the same file, byte for byte.

    Parameters
    ----------
    calibration : Path
        calibration.json of the device.
    output : Path
        The file, named *.pdf.

    Returns
    -------
    int
        0, or 1 when the calibration's own verdict is bad.
    """
    from undrift.io.store import read_calibration, verdict_json
    from undrift.report.certificate import certificate_content, content_hash, write_certificate

    check_output(output, endings=(".pdf",), reads=(calibration,))
    model = read_calibration(calibration)
    write_certificate(model, output)
    if json:
        triads = certificate_content(model)["triads"]
        answer = {"file": str(output), "content_sha256": content_hash(model), "triads": triads}
        write_json(answer | {"verdict": verdict_json(model.verdict)}, "certificate")
    else:
        show_verdict(model.verdict, details=details)
        say(f"Wrote {output}")
    return 1 if model.verdict.status == "bad" else 0
