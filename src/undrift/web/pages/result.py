"""Result: verdict and findings of a calibration, its report, its certificate, and its entry in the registry."""

from functools import partial
from pathlib import Path
from typing import Any

from nicegui import ui

from undrift.web.bench import Bench, Job
from undrift.web.frame import Field, button, frame, next_step, redrawn, text

LEVELS = ("fail", "warn", "info")


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
        else (job.folder, job.calibration, job.certificate, job.registered, job.error, bench.calibration)
    )


def _result(bench: Bench, job: Job, refresh: Any) -> None:
    verdict = job.answer.get("verdict") or {}
    status = verdict.get("status", "")
    findings = sorted(verdict.get("findings") or [], key=lambda one: LEVELS.index(one.get("level", "info")))
    with ui.element("section").classes(f"verdict {status}").props('aria-label="Verdict"'):
        text("h2", f"Verdict: {status or 'unknown'}")
        text("p", f"Device {job.answer.get('device') or job.serial or 'without a serial number'}")
        _listed(findings[:3])
        if len(findings) > 3:
            with ui.element("details"):
                text("summary", f"{len(findings) - 3} more")
                _listed(findings[3:])
    if job.error:
        text("p", job.error, "bench-error").props('role="alert"')
    _step(bench, job, refresh)
    with ui.element("div").classes("row"):
        for label, path in (("Calibration", job.calibration), ("Certificate", job.certificate), ("Report", job.report)):
            if path is not None and path.exists():
                ui.link(f"Download {label.lower()}", bench.link(path) + "?download=1")
        if bench.calibration == job.calibration:
            text("p", "Live and Recordings use this calibration.", "soft")
        else:
            button("Use it in Live and Recordings", lambda: _use(bench, job, refresh))
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


def _listed(findings: list[dict[str, Any]]) -> None:
    if not findings:
        return
    with ui.element("ul"):
        for one in findings:
            with ui.element("li"):
                action = str(one.get("action") or "")
                text("span", str(one.get("text", "")).removesuffix(action).rstrip("; ") + ".")
                if action:
                    text("p", f"{action[:1].upper()}{action[1:]}.", "soft")


def _step(bench: Bench, job: Job, refresh: Any) -> None:
    """Add the one next step: register, then the certificate, then recordings."""
    if not job.registered:
        serial = None if job.answer.get("device") else Field("Serial number of the device", job.serial)
        next_step(
            "Register the calibration", lambda: register(bench, job, "" if serial is None else serial.value, refresh)
        )
    elif job.certificate is None:
        next_step("Make the certificate", lambda: certify(bench, job, refresh))
    else:
        next_step("Correct recordings", "/recordings")


async def register(bench: Bench, job: Job, serial: str, refresh: Any) -> None:
    """Add the calibration to the registry; one that names no device, under a serial number."""
    words = ("--serial", serial.strip()) if serial.strip() else ()
    outcome = await bench.command("registry", "add", job.calibration, *words, *bench.registry_words())
    job.error = "" if outcome.done else outcome.error
    if outcome.done:
        job.registered = _registered(outcome.answer)
    refresh()


def _registered(answer: dict[str, Any]) -> str:
    (entry, *_) = answer["entries"]
    due = f", due {entry['due_at'][:10]}" if entry.get("due_at") else ""
    return f"Registered as entry {entry['entry']}{due}."


async def certify(bench: Bench, job: Job, refresh: Any) -> None:
    """Write the certificate, and add it to the registry."""
    path = job.folder / "certificate.pdf"
    outcome = await bench.command("certificate", job.calibration, "-o", path, "--register", *bench.registry_words())
    job.error = "" if outcome.done else outcome.error
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
