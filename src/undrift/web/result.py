"""Results, on the page Calibrate: verdict and findings, the report, the certificate, and the entry in the registry."""

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING

from nicegui import ui

from undrift.base.options import stated
from undrift.commands.certificate import Statement
from undrift.commands.data_sheet import Specification
from undrift.errors import InputError
from undrift.web import entries, parts
from undrift.web.commands import CommandOutcome, remarks_of
from undrift.web.place import place_form

if TYPE_CHECKING:
    from undrift.commands.bench.library import Job
    from undrift.web.bench import Bench, Visit


def page(visit: "Visit") -> None:
    """Build the page."""
    parts.redrawn(lambda: _state(visit), lambda: _shown(visit))
    entries.listing(visit, "Results", lambda: visit.jobs, lambda: visit.job, partial(setattr, visit, "shown"))


def _state(visit: "Visit") -> tuple[object, ...]:
    job = visit.job
    if job is None:
        return ()
    return job.folder, id(job.answer), job.certificate, job.registered, job.error, len(job.later), visit.calibration


def _shown(visit: "Visit") -> None:
    job = visit.job
    if job is None or job.calibration is None:
        parts.text("p", "No calibration of this device yet. Record six faces, run the rate table, or drop a recording.")
        parts.next_step("Get readings", "/readings")
    else:
        _result(visit, job)


def _result(visit: "Visit", job: "Job") -> None:
    bench = visit.bench
    status = (job.answer.get("verdict") or {}).get("status", "")
    with parts.section("Verdict", f"verdict {status}"):
        parts.text("h2", f"Verdict: {status or 'unknown'}")
        parts.text("p", f"Device {job.answer.get('device') or job.serial or 'without a serial number'}")
        if job.lacks:
            why = "their readings stay uncorrected; in counts they are left out."
            parts.text("p", f"It lacks the {' and '.join(job.lacks)}: {why}", "lacks")
        parts.remarks_list(remarks_of({**job.answer, "later": job.later}))
    parts.refused(visit, job, job.error)
    if job.gravity_assumed and job.certificate is None:
        _gravity(visit, job)
    _step(visit, job)
    with parts.row():
        for label, path in (("Calibration", job.calibration), ("Certificate", job.certificate), ("Report", job.report)):
            if path is not None and path.exists():
                ui.link(f"Download {label.lower()}", bench.link(path) + "?download=1")
        if visit.calibration == job.calibration:
            parts.text("p", "Files of this tab are corrected with this calibration.", "soft")
        else:
            without = f", without {' and '.join(job.lacks)}" if job.lacks else ""
            use = partial(setattr, visit, "calibration", job.calibration)
            parts.button(f"Use it for files and live readings{without}", use)
    if job.registered:
        parts.text("p", job.registered, "soft")
    if job.report is not None and job.report.exists():
        parts.text("h2", "Report")
        made = ui.element("iframe").classes("report").props('title="Report of the calibration" tabindex="0"')
        made.props["src"] = bench.link(job.report)


def _step(visit: "Visit", job: "Job") -> None:
    """Add the one next step: register, then the certificate, then recordings."""
    bench = visit.bench
    if not job.registered:
        serial = None if job.answer.get("device") else parts.Field("Serial number of the device", job.serial)
        parts.next_step("Register the calibration", lambda: register(bench, job, serial.value if serial else ""))
    elif job.certificate is None:
        unstated = ", gravity not stated" if job.gravity_assumed else ""
        parts.next_step(f"Make the certificate{unstated}", lambda: certify(bench, job, visit.statement))
    else:
        parts.next_step("Correct recordings", "/use")
    if job.registered:
        with parts.folded("What the certificate states, and its limits"):
            for settings in (Statement, Specification):
                parts.settings_form(settings, visit.statement)
            if job.certificate is not None:
                parts.button("Make the certificate anew", lambda: certify(bench, job, visit.statement))


def _gravity(visit: "Visit", job: "Job") -> None:
    """Ask for gravity before the certificate: the scale of the accelerometers is known no better."""

    async def again() -> None:
        if not visit.bench.place.words():
            raise InputError("gravity: wanted a town, a latitude or gravity itself, got none; fill one in")
        await visit.calibrate(job, *job.words)

    with parts.section("Gravity", "card"):
        parts.text("h2", "Where was it recorded?")
        parts.says("gravity")
        if job.words:
            place_form(visit.bench, "Calibrate with this gravity", again)
        else:
            parts.text("p", "State the place on the first page, then calibrate again.")


async def register(bench: "Bench", job: "Job", serial: str) -> None:
    """Add the calibration to the registry; one that names no device, under a serial number."""
    words = stated(serial=serial.strip(), registry=bench.settings.registry)
    outcome = await bench.command("registry", "add", job.calibration, *words)
    _heard(job, outcome)
    if outcome.done:
        (entry, *_) = outcome.answer["entries"]
        due = f", due {entry['due_at'][:10]}" if entry.get("due_at") else ""
        job.registered = f"Registered as entry {entry['entry']}{due}."
        job.save()


async def certify(bench: "Bench", job: "Job", statement: Mapping[str, str]) -> None:
    """Write the certificate with what the laboratory states, and add it to the registry."""
    path = job.folder / "certificate.pdf"
    words = stated(**{name: text.strip() for name, text in statement.items()}, registry=bench.settings.registry)
    outcome = await bench.command("certificate", job.calibration, "-o", path, "--register", *words)
    _heard(job, outcome)
    if outcome.done:
        job.certificate = path


def _heard(job: "Job", outcome: CommandOutcome) -> None:
    job.error, job.later = outcome.error, [*job.later, outcome.answer]
    job.save()
