"""``undrift registry``: devices and their sessions, calibrations, certificates and runs, in a database that only grows."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from undrift.base.options import Files, OptionalOutput, Picture, options, verb
from undrift.base.summary import Cells, Result, Section, Summary, figure_of, table_section
from undrift.commands.files import check_figure, check_output, ends_of, save_json, stated_date
from undrift.commands.register import ValidMonths, Where, entry_json, open_place, registered_lines
from undrift.errors import InputError, UndriftError

if TYPE_CHECKING:
    from undrift.registry.documents import Stated
    from undrift.registry.registry import Entry, Known
    from undrift.registry.trend import Change, TrendStep

HEADS = ("entry", "kind", "serial", "made", "due", "valid (degC)", "verdict", "by", "note")


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class RegistryListing(Result):
    """What is in the registry, or was added: entries, devices or steps from calibration to calibration."""

    values: tuple[Any, ...]
    shown: Summary

    def summary(self) -> Summary:
        """Return what the registry has."""
        return self.shown


@options
@dataclass(frozen=True, kw_only=True)
class About:
    """What is stated of the files.

    Parameters
    ----------
    serial : str or None
        Serial number of the device, where a file states none.
    station : str or None
        Name of this station; UNDRIFT_STATION, else the name of the computer, by default.
    """

    serial: str | None = None
    valid_months: ValidMonths = 12
    station: str | None = None


@verb
def add(
    *files: Files,
    about: About = About(),
    valid_temp_c: Annotated[str | None, Parameter(allow_leading_hyphen=True)] = None,
    date: str | None = None,
    supersedes: int | None = None,
    note: str = "",
    where: Where = None,
) -> RegistryListing:
    """Add calibrations, certificates, and folders of sessions or runs: all of them, or none. The same content is added once.

    Parameters
    ----------
    files : Path
        calibration.json, the certificate of a calibration that is known or named too, or the folder of a session or run.
    valid_temp_c : str or None
        Where a calibration is valid, LOW:HIGH in degC; by default its table of offsets, else 5 K about its reference temperature.
    date : str or None
        When it was made, as in 2026-03-01T08:30 (UTC); what the file states by default, of recordings their last change.
    supersedes : int or None
        Entry of the same kind that this one corrects; the old one stays, and counts no more. Wants --note.
    note : str
        Why, or what else should be known.
    """
    from undrift.registry.documents import new_entries

    if supersedes is not None and (len(files) > 1 or not note):
        raise InputError("`supersedes`: wanted one file, and `note` with the reason, got others; correct one at a time")
    stated = replace(
        _stated(about),
        temp_c=None if valid_temp_c is None else ends_of("`valid_temp_c`", valid_temp_c),
        made_at=None if date is None else stated_date(date),
        supersedes=supersedes,
        note=note,
    )
    with open_place(where, station=about.station) as held:
        added = held.add(*new_entries(list(files), stated, held))
    return _added([one.entry for one in added], [entry_json(one.entry) | {"new": one.new} for one in added], where)


@verb
def list_held(
    *,
    serial: str | None = None,
    kind: Literal["session", "calibration", "certificate", "run"] | None = None,
    where: Where = None,
) -> RegistryListing:
    """List the devices with the calibration that counts, or the entries of one device or kind.

    Parameters
    ----------
    serial : str or None
        Entries of this device.
    kind : str or None
        Entries of this kind.
    """
    with open_place(where, there=True) as held:
        if serial is None and kind is None:
            return _devices(f"devices in {held.place}", held.devices(), {"registry": held.place})
        rows, place = held.entries(serial, kind), held.place
    data = {"registry": place, "entries": [entry_json(*row) for row in rows]}
    return _entries(f"{len(rows)} entries in {place}", rows, data)


@verb
def show(entry: int, /, *, output: OptionalOutput = None, where: Where = None) -> RegistryListing:
    """Show an entry, and write what it holds; a hash shows that it is as it was added.

    Parameters
    ----------
    entry : int
        Number of the entry.
    output : Path or None
        File to write: .json, of a certificate .pdf.
    """
    with open_place(where, there=True) as held:
        found = held.entry(entry)
        later = {one.id: corrected for one, corrected in held.entries(found.device.serial)}[found.id]
    check_output(output, endings=(".pdf",) if found.kind == "certificate" else (".json",))
    _write(found, output)
    document = {key: value for key, value in found.document.items() if key != "pdf_base64"}
    values = entry_json(found, later)
    lines = (f"{name.replace('_', ' '):14} {value}" for name, value in values.items() if value not in (None, ""))
    shown = Summary(
        title=f"Entry {entry} of the registry",
        answer=f"Entry {entry} is a {found.kind} of {found.device.serial}.",
        data=values | {"document": document, "output": output},
        sections=(Section(title="Entry", text=tuple(lines)),),
        written=(output,) if output else (),
    )
    return RegistryListing(values=(found,), shown=shown)


@verb
def find(
    *,
    serial: str,
    date: str | None = None,
    temp_c: Annotated[float | None, Parameter(allow_leading_hyphen=True)] = None,
    output: OptionalOutput = None,
    where: Where = None,
) -> RegistryListing:
    """Find the calibration of a device that is valid at a date and a temperature: the newest, neither due, superseded nor bad.

    Parameters
    ----------
    serial : str
        Serial number of the device.
    date : str or None
        Date, as in 2026-03-01 (UTC); now by default.
    temp_c : float or None
        Temperature, degC; any by default.
    output : Path or None
        calibration.json to write.
    """
    check_output(output, endings=(".json",))
    with open_place(where, there=True) as held:
        found = held.find(serial, on=None if date is None else stated_date(date), temp_c=temp_c)
    _write(found, output)
    rows = [(found, None)]
    return _entries(f"valid calibration of {serial}", rows, entry_json(found) | {"output": output}, output)


@verb
def due(*, within_days: int = 30, where: Where = None) -> RegistryListing:
    """List the devices to calibrate again soon, and those that are overdue or never were calibrated.

    Parameters
    ----------
    within_days : int
        Due in so many days from now; 0 lists what is overdue.
    """
    if not 0 <= within_days <= 36500:
        raise InputError(f"`within_days`: wanted 0 to 36500 days, got {within_days}; 30 is the default")
    with open_place(where, there=True) as held:
        known, place = held.due(datetime.now(UTC) + timedelta(days=within_days)), held.place
    title = f"{'' if known else 'nothing is '}due within {within_days} days in {place}"
    return _devices(title, known, {"registry": place, "within_days": within_days})


@verb
def trend(*, serial: str, figure: Picture = None, where: Where = None) -> RegistryListing:
    """Show how a device changed from each calibration to the next, with the standard uncertainty of each change.

    Parameters
    ----------
    serial : str
        Serial number of the device.
    figure : Path or None
        Picture to write of scale factors and offsets over time: .svg, .png or .pdf.
    """
    from undrift.io.store import calibration_of
    from undrift.registry.trend import Dated, course, headline
    from undrift.registry.trend import trend as steps_of

    check_figure(figure, reads=())
    with open_place(where, there=True) as held:
        entries = [held.entry(one.id) for one in held.calibrations(serial)]
    if len(entries) < 2:
        raise InputError(
            f"{serial}: wanted two calibrations to compare, got {len(entries)}; add another: undrift registry add FILE"
        )
    models = [
        Dated(entry=one.id, made_at=one.made_at, model=calibration_of(one.document, f"entry {one.id}"))
        for one in entries
    ]
    steps, from_first = steps_of(models), course(models)
    drawing = figure_of("drift:draw_trend", serial, models[0], from_first)
    if figure is not None:
        drawing.save(figure)
    first = [f"since the first: {text}" for text in from_first[-1].sentences] if len(steps) > 1 else []
    answer = headline(steps, from_first)
    shown = Summary(
        title=f"Trend of {serial}",
        answer=f"{serial}: {answer}.",
        data={"serial": serial, "headline": answer, "since_first": _step_json(from_first[-1])}
        | {"steps": [_step_json(step) for step in steps]},
        pictures=(drawing,),
        sections=(
            *(replace(step_section(step), columns=(), rows=()) for step in steps[:-1]),
            step_section(steps[-1]),
            Section(title=f"Since {models[0].made_at:%Y-%m-%d}", text=tuple(first)),
            *(step_section(step, every=True) for step in steps),
        ),
        written=(figure,) if figure else (),
    )
    return RegistryListing(values=tuple(steps), shown=shown)


@verb
def prior(*serials: str, output: OptionalOutput = None, where: Where = None) -> RegistryListing:
    """Learn what devices of one part deviate by, as a prior for calibrating by motion alone.

    Parameters
    ----------
    serials : str
        Serial numbers of devices of the part; all devices by default.
    output : Path or None
        File of the prior to write: .json.
    """
    from undrift.base.codec import tree_of, write
    from undrift.calibration.element_prior import KINDS, deviation_of, learn_prior
    from undrift.io.store import calibration_of

    check_output(output, endings=(".json",), reads=())
    taken, others = list[Any](), list[dict[str, str]]()
    with open_place(where, there=True) as held:
        place = held.place
        for serial in serials or [one.serial for one in held.devices()]:
            why = "wanted a calibration that counts, got none"
            for one in reversed(held.calibrations(serial)):  # the newest that can be counted
                model = calibration_of(held.entry(one.id).document, f"entry {one.id}")
                try:
                    deviation_of(model)
                except InputError as error:
                    why = str(error)
                else:
                    taken.append(model)
                    break
            else:
                others.append({"serial": serial, "why": why})
    reasons = tuple(f"{one['serial']}: {one['why']}" for one in others)
    if not taken:
        raise InputError(
            f"registry prior: wanted calibrated devices of a part, got none ({'; '.join(reasons) or 'it is empty'}); "
            "register calibrations by faces, turns, a rate table or optics"
        )
    made = learn_prior(taken, f"registry, {len(taken)} devices")
    if output is not None:
        write(made, output)
    kinds = zip(KINDS, made.kinds, strict=True)
    shown = Summary(
        title="Prior of a part",
        answer=f"Prior of a part, from {len(taken)} devices of {place}.",
        data=tree_of(made) | {"left_out": others},
        sections=(
            Section(
                title="What devices deviate by: shares, rad, and m/s2 for the offset of accelerometers",
                columns=("kind", "mean 1", "mean 2", "mean 3", "standard deviation"),
                rows=tuple(
                    (name.replace("_", " "), *(f"{axis:+.2g}" for axis in kind.mean), f"{kind.size:.2g}")
                    for name, kind in kinds
                ),
            ),
            Section(title="Left out", text=reasons),
        ),
        written=(output,) if output else (),
        next=("calibrate", "--from", "motion", "A.csv", "--prior", output) if output else (),
    )
    return RegistryListing(values=(made,), shown=shown)


def step_section(step: "TrendStep", *, every: bool = False) -> Section:
    """Return what changed from one calibration to the next: in words, with all but the cross-axis terms; or every one, folded."""
    cells: Cells[Change] = (
        ("parameter", lambda one: f"{one.sensor} {one.parameter}"),
        ("change", lambda one: f"{one.change:+.3g}"),
        ("standard uncertainty", lambda one: f"{one.uncertainty:.2g}"),
        ("unit", lambda one: one.unit),
        ("change / uncertainty", lambda one: f"{one.sigmas:.1f}"),
    )
    since, until = f"{step.since.made_at:%Y-%m-%d}", f"{step.until.made_at:%Y-%m-%d}"
    words = (*step.sentences, *(f"not compared: {one}" for one in step.not_compared))
    changes = [one for one in step.changes if every or "cross" not in one.parameter]
    text = () if every else tuple(f"{until}: {one}" for one in words)
    title = f"{since} to {until}{', every parameter' * every}"
    return table_section(title, changes, cells, text=text, folded=every)


@verb
def import_folder(folder: Path, /, *, about: About = About(), where: Where = None) -> RegistryListing:
    """Add all sessions, runs, calibrations and certificates in a folder and those below; what is refused is listed.

    Parameters
    ----------
    folder : Path
        Where to look.
    """
    from undrift.registry.documents import candidates, new_entries
    from undrift.registry.registry import Entry

    if not folder.is_dir():
        raise InputError(
            f"{folder}: wanted a folder, got none of that name; name one, or add a file: undrift registry add FILE"
        )
    stated, rows, refused, entries = _stated(about), list[dict[str, Any]](), list[dict[str, str]](), list[Entry]()
    with open_place(where, station=about.station) as held:
        paths = list(candidates(folder))
        for path in sorted(paths, key=lambda one: one.suffix == ".pdf"):  # a certificate after its calibration
            try:
                added = held.add(*new_entries([path], stated, held))
            except UndriftError as error:
                refused.append({"file": str(path), "why": str(error)})
            else:
                rows += [entry_json(one.entry) | {"new": one.new} for one in added]
                entries += [one.entry for one in added]
    if not paths:
        raise InputError(
            f"{folder}: wanted sessions, runs, calibrations or certificates in it, got none; name another folder"
        )
    return _added(entries, rows, where, refused)


def _stated(about: About) -> "Stated":
    from undrift.registry.documents import Stated

    if not 1 <= (months := about.valid_months or 0) <= 1200:
        raise InputError(f"`valid_months`: wanted 1 to 1200 months, got {about.valid_months}; 12 is the default")
    return Stated(serial=about.serial, valid_months=months)


def _write(entry: "Entry", output: Path | None) -> None:
    """Write what an entry holds."""
    if output is None:
        return
    from undrift.files import write_whole
    from undrift.io.store import calibration_of, write_calibration
    from undrift.registry.documents import pdf_of

    if entry.kind == "calibration":
        write_calibration(calibration_of(entry.document, f"entry {entry.id}"), output)
    elif entry.kind == "certificate":
        write_whole(output, pdf_of(entry.document))
    else:
        save_json(output, entry.document)


def _cells(entry: "Entry", later: int | None = None) -> tuple[str, ...]:
    span = "–" if entry.low_c is None else f"{entry.low_c:.1f} to {entry.high_c:.1f}"
    note = "; ".join(filter(None, (f"superseded by {later}" if later else "", entry.note)))
    due_on = f"{entry.due_at:%Y-%m-%d}" if entry.due_at else "–"
    made_on, verdict = f"{entry.made_at:%Y-%m-%d}", entry.verdict or "–"
    return str(entry.id), entry.kind, entry.device.serial, made_on, due_on, span, verdict, entry.added_by, note


def _device_json(known: "Known") -> dict[str, Any]:
    held, now = known.calibration, datetime.now(UTC)
    days = None if held is None or held.due_at is None else (held.due_at - now).days
    state = "no calibration" if held is None else "overdue" if days is not None and days < 0 else "valid"
    return {
        "serial": known.serial,
        "entries": known.entries,
        "state": state,
        "days_left": days,
        "calibration": None if held is None else entry_json(held),
    }


def _devices(title: str, known: "list[Known]", data: dict[str, Any]) -> RegistryListing:
    """Return devices with the calibration that counts."""
    stated, rows = [_device_json(one) for one in known], list[tuple[str, ...]]()
    for one, values in zip(known, stated, strict=True):
        cells = _cells(one.calibration) if one.calibration else ("–",) * len(HEADS)
        rows.append((one.serial, str(values["state"]), cells[0], *cells[3:6], str(one.entries)))
    heads = ("serial", "state", "calibration", "made", "due", "valid (degC)", "entries")
    table = Section(title="Devices", columns=heads, rows=tuple(rows))
    return _table(title, table, data | {"devices": stated}, tuple(known))


def _entries(
    title: str, rows: "Sequence[tuple[Entry, int | None]]", data: dict[str, Any], output: Path | None = None
) -> RegistryListing:
    table = Section(title="Entries", columns=HEADS, rows=tuple(_cells(*row) for row in rows))
    return _table(title, table, data, tuple(entry for entry, _ in rows), output)


def _table(
    answer: str, table: Section, data: dict[str, Any], values: tuple[Any, ...], output: Path | None = None
) -> RegistryListing:
    written = (output,) if output else ()
    shown = Summary(title="Registry", answer=answer, data=data, sections=(table,), written=written)
    return RegistryListing(values=values, shown=shown)


def _added(
    entries: "list[Entry]", rows: list[dict[str, Any]], where: str | None, refused: list[dict[str, str]] | None = None
) -> RegistryListing:
    """Return what was added, and what was refused."""
    lines = (*registered_lines(rows), *(f"Refused: {one['why']}" for one in refused or ()))
    shown = Summary(
        title="Added to the registry",
        answer=lines[0],
        data={"entries": rows} | ({} if refused is None else {"refused": refused}),
        sections=(Section(title="Others", text=lines[1:]),),
        next=("registry", "list", f"--serial={rows[0]['serial']}", *(["--registry", where] if where else []))
        if rows
        else (),
    )
    return RegistryListing(values=tuple(entries), shown=shown)


def _step_json(step: "TrendStep") -> dict[str, Any]:
    ends = {
        name: {"entry": end.entry, "made_at": end.made_at.isoformat()}
        for name, end in (("since", step.since), ("until", step.until))
    }
    changes = [
        {key: getattr(one, key) for key in ("sensor", "parameter", "change", "uncertainty", "unit", "sigmas")}
        for one in step.changes
    ]
    return ends | {"changes": changes, "not_compared": step.not_compared, "sentences": step.sentences}
