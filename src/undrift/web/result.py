"""Results, on the page Calibrate: verdict and findings, the report and the certificate."""

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING

from nicegui import ui

from undrift.base.options import stated
from undrift.commands.certificate import Statement
from undrift.errors import InputError
from undrift.web import entries, parts
from undrift.web.commands import remarks_of
from undrift.web.place import place_form

if TYPE_CHECKING:
    from undrift.commands.bench.library import Job
    from undrift.web.bench import Bench, Visit


def page(visit: "Visit") -> None:
    """Build the page."""
    parts.redrawn(lambda: _state(visit), lambda: _shown(visit))
    entries.listing("Results", lambda: visit.library.jobs, lambda: visit.job, partial(setattr, visit, "shown"))


def _state(visit: "Visit") -> tuple[object, ...]:
    job = visit.job
    if job is None:
        return ()
    return job.folder, id(job.answer), job.certificate, job.error, len(job.later), visit.calibration


def _shown(visit: "Visit") -> None:
    job = visit.job
    if job is None or job.calibration is None:
        parts.text("p", "No calibration yet. Record six faces, or drop a recording.")
        parts.next_step("Get readings", "/")
    else:
        _result(visit, job)


def _result(visit: "Visit", job: "Job") -> None:
    bench = visit.bench
    status = (job.answer.get("verdict") or {}).get("status", "")
    with parts.section("Verdict", f"verdict {status}"):
        parts.text("h2", f"Verdict: {status or 'unknown'}")
        parts.text("p", f"Device {job.answer.get('device') or job.serial or 'without a serial number'}")
        if job.lacks:
            why = "their readings stay uncorrected. Readings in counts are left out."
            parts.text("p", f"It lacks the {' and '.join(job.lacks)}: {why}", "lacks")
        parts.remarks_list(remarks_of({**job.answer, "later": job.later}))
    parts.refused(visit, job, job.error)
    if job.gravity_assumed:
        _gravity(visit, job)
    parts.next_step("Correct recordings", "/use")
    with parts.row():
        for label, path in (("calibration", job.calibration), ("report", job.report)):
            if path is not None and path.exists():
                ui.link(f"Download {label}", bench.link(path) + "?download=1")
        if job.certificate is not None:
            ui.link("Open the certificate", bench.link(job.certificate), new_tab=True)
        if visit.calibration == job.calibration:
            parts.text("p", "Files are corrected with this calibration.", "soft")
        else:
            without = f", without {' and '.join(job.lacks)}" if job.lacks else ""
            use = partial(setattr, visit, "calibration", job.calibration)
            parts.button(f"Use it for files{without}", use)
    with parts.folded("Certificate"):
        parts.settings_form(Statement, visit.statement)
        parts.button("Make the certificate", lambda: certify(bench, job, visit.statement))
    if job.report is not None and job.report.exists():
        parts.text("h2", "Report")
        frame = ui.element("iframe").classes("report").props('title="Report of the calibration" tabindex="0"')
        frame.props["src"] = bench.link(job.report)


def _gravity(visit: "Visit", job: "Job") -> None:
    """Ask for gravity: the scale of the accelerometers is known no better."""

    async def again() -> None:
        if not visit.bench.place.words():
            raise InputError("gravity: enter a town, a latitude or local gravity.")
        await visit.calibrate(job, *job.words)

    with parts.section("Gravity", "card"):
        parts.text("h2", "Where was it recorded?")
        parts.says("gravity")
        if job.words:
            place_form(visit.bench, "Calibrate with this gravity", again)
        else:
            parts.text("p", "State the place on the first page, then calibrate again.")


async def certify(bench: "Bench", job: "Job", statement: Mapping[str, str]) -> None:
    """Write the certificate with the entries of the laboratory."""
    path = job.folder / "certificate.html"
    options = stated(**{name: text.strip() for name, text in statement.items()})
    outcome = await bench.command("certificate", job.calibration, "-o", path, *options)
    job.error, job.later = outcome.error, [*job.later, outcome.answer]
    if outcome.done:
        job.certificate = path
    job.save()
