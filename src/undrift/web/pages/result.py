"""Result: verdict and findings of a calibration, its report, its certificate, and its entry in the registry."""

from functools import partial
from pathlib import Path
from typing import Any

from nicegui import ui

from undrift.web.bench import Bench, Job
from undrift.web.commands import Outcome, remarks_of
from undrift.web.frame import Field, button, frame, next_step, place_form, redrawn, refused, remarks_list, text


def page(bench: Bench) -> None:
    """Build the page."""
    with frame(bench, "Result"):
        redrawn(lambda: _state(bench), lambda refresh: _shown(bench, refresh))


def _shown(bench: Bench, refresh: Any) -> None:
    if bench.job is None or bench.job.calibration is None:
        text("p", "No calibration yet. Record six faces, run the rate table, or open a recording.")
        next_step("Choose what to record", "/")
    else:
        _result(bench, bench.job, refresh)
    _earlier(bench, refresh)


def _state(bench: Bench) -> tuple[object, ...]:
    job = bench.job
    return (
        ()
        if job is None
        else (job.folder, id(job.answer), job.certificate, job.registered, job.error, len(job.later), bench.calibration)
    )


def _result(bench: Bench, job: Job, refresh: Any) -> None:
    verdict = job.answer.get("verdict") or {}
    status = verdict.get("status", "")
    with ui.element("section").classes(f"verdict {status}").props('aria-label="Verdict"'):
        text("h2", f"Verdict: {status or 'unknown'}")
        text("p", f"Device {job.answer.get('device') or job.serial or 'without a serial number'}")
        if job.lacks:
            words = (
                f"It lacks the {' and '.join(job.lacks)}: their readings stay uncorrected; in counts they are left out."
            )
            text("p", words, "lacks")
        remarks_list(remarks_of({**job.answer, "later": job.later}))
    refused(bench, job, job.error)
    if job.gravity_assumed and job.certificate is None:
        _gravity(bench, job, refresh)
    _step(bench, job, refresh)
    with ui.element("div").classes("row"):
        for label, path in (("Calibration", job.calibration), ("Certificate", job.certificate), ("Report", job.report)):
            if path is not None and path.exists():
                ui.link(f"Download {label.lower()}", bench.link(path) + "?download=1")
        if bench.calibration == job.calibration:
            text("p", "Live and Recordings use this calibration.", "soft")
        else:
            without = f", without {' and '.join(job.lacks)}" if job.lacks else ""
            button(f"Use it in Live and Recordings{without}", lambda: _use(bench, job, refresh))
    if job.registered:
        text("p", job.registered, "soft")
    if job.report is not None and job.report.exists():
        text("h2", "Report")
        made = (
            ui.element("iframe")
            .classes("report")
            .props(f'src="{bench.link(job.report)}" title="Report of the calibration"')
        )
        made.props('tabindex="0"')


def _step(bench: Bench, job: Job, refresh: Any) -> None:
    """Add the one next step: register, then the certificate, then recordings."""
    if not job.registered:
        serial = None if job.answer.get("device") else Field("Serial number of the device", job.serial)
        next_step(
            "Register the calibration", lambda: register(bench, job, "" if serial is None else serial.value, refresh)
        )
    elif job.certificate is None:
        unstated = ", gravity not stated" if job.gravity_assumed else ""
        next_step(f"Make the certificate{unstated}", lambda: certify(bench, job, refresh))
    else:
        next_step("Correct recordings", "/recordings")


def _gravity(bench: Bench, job: Job, refresh: Any) -> None:
    """Ask for gravity before the certificate: the scale of the accelerometers is known no better."""

    async def again() -> None:
        if bench.place.words():
            await bench.calibrate(job, *job.words)
        else:
            job.error = "gravity: wanted a town, a latitude or gravity itself, got none; fill one in"
        refresh()

    with ui.element("section").classes("card").props('aria-label="Gravity"'):
        text("h2", "Where was it recorded?")
        text("p", "Nobody stated local gravity: the certificate carries 0.15 % for it, in the accelerometers' scale.")
        if job.words:
            place_form(bench, "Calibrate with this gravity", again)
        else:
            text("p", "State the place on the page Start, then calibrate again.")


async def register(bench: Bench, job: Job, serial: str, refresh: Any) -> None:
    """Add the calibration to the registry; one that names no device, under a serial number."""
    words = ("--serial", serial.strip()) if serial.strip() else ()
    outcome = await bench.command("registry", "add", job.calibration, *words, *bench.registry_words())
    _heard(job, outcome)
    if outcome.done:
        job.registered = _registered(outcome.answer)
    refresh()


def _heard(job: Job, outcome: Outcome) -> None:
    job.error = "" if outcome.done else outcome.error
    job.later = [*job.later, outcome.answer]


def _registered(answer: dict[str, Any]) -> str:
    (entry, *_) = answer["entries"]
    due = f", due {entry['due_at'][:10]}" if entry.get("due_at") else ""
    return f"Registered as entry {entry['entry']}{due}."


async def certify(bench: Bench, job: Job, refresh: Any) -> None:
    """Write the certificate, and add it to the registry."""
    path = job.folder / "certificate.pdf"
    outcome = await bench.command("certificate", job.calibration, "-o", path, "--register", *bench.registry_words())
    _heard(job, outcome)
    if outcome.done:
        job.certificate = path
    refresh()


def _use(bench: Bench, job: Job, refresh: Any) -> None:
    bench.calibration = job.calibration
    refresh()


def _earlier(bench: Bench, refresh: Any) -> None:
    """List what was calibrated before."""
    now = None if bench.job is None else bench.job.folder
    held = [path for path in sorted(bench.folder.glob("jobs/*/calibration.json"), reverse=True) if path.parent != now]
    if not held:
        return
    text("h2", "Earlier results")
    with ui.element("ul"):
        for path in held[:20]:
            with ui.element("li"):
                button(f"Open {path.parent.name}", partial(_open, bench, path, refresh))


async def _open(bench: Bench, path: Path, refresh: Any) -> None:
    await bench.open_job(path.parent)
    refresh()
