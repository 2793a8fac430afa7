"""Sound input for each question: a command, a call of Python, or a button of the page."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

import undrift
from mistakes import sound
from mistakes.planting import Case
from testkit.ferraris import ferraris_text
from testkit.trc_text import trc
from testkit.walking import misplaced, walk
from undrift.commands.files import Place
from undrift.frames import rotate
from undrift.io.text import write_rows
from undrift.orientation import OrientSettings
from undrift.validation.trial import TrialSettings
from undrift.web.bench import Bench
from undrift.web.items import Item

GRAVITY = ("--latitude-deg", sound.LATITUDE_DEG, "--height-m", 0)
MARKERS = ("A", "B", "C", "D")


@cache
def case_of(name: str) -> Case:
    """Return sound input by its name; it is simulated once."""
    return CASES[name]()


def _of_trial(route: str, *options: object, task: str = "free") -> Case:
    return Case(route=route, recordings=(sound.recording_of(sound.trial(task).record),), options=options)


def _recordings(route: str, *recordings: sound.Recording, options: tuple[object, ...] = GRAVITY) -> Case:
    return Case(route=route, recordings=recordings, options=options)


# ---- files


def table_log(factor: float) -> Callable[[Path], None]:
    """Return a function that writes the log of the table: its rates times a factor, under the name turn_rate_dps."""

    def edit(folder: Path) -> None:
        session = sound.table_without_faces()
        knots, rates = [0.0], [0.0]
        for turn in session.turns:
            start_s, stop_s = session.records[0].time[[turn.start, turn.stop - 1]]
            knots += [start_s - 0.5, start_s, stop_s, stop_s + 0.5]
            rates += [0.0, turn.turn_rate or 0.0, turn.turn_rate or 0.0, 0.0]
        time = np.arange(0.0, session.records[0].duration_s, 0.02)
        rate = factor * np.degrees(np.interp(time, knots, rates))
        write_rows(folder / "rates.csv", ("time_s", "turn_rate_dps"), (time + 3.0, rate))

    return edit


def _stated_soaks() -> Case:
    """Return rests at five temperatures with their set-points and without a thermometer."""
    session, each = sound.soak(), len(sound.soak().stills) // len(sound.SET_POINTS_C)
    stills = tuple(replace(still, temp_c=sound.SET_POINTS_C[k // each]) for k, still in enumerate(session.stills))
    records = tuple(replace(record, temp_c=None) for record in session.records)
    return replace(case_of("soaks"), session=replace(session, records=records, stills=stills))


def by_imucal(case: Case, seed: int) -> Case:
    """Return a case with the calibration of a phone in imucal's format."""

    def edit(folder: Path) -> None:
        (folder / "imucal.json").write_text(ferraris_text(sound.calibrated(seed)))

    return replace(case, calibration=None, options=("--calibration", "{folder}/imucal.json"), edit=edit)


def _worn_pitch() -> Case:
    """Return a sit-to-stand with a device worn with its x up and its z to the left, and the options for it."""
    case = _of_trial("orient", "--offset", "rest", "--forward", "+y", "--up", "+x", task="sit_to_stand")
    recordings = tuple(sound.remounted(recording) for recording in case.recordings)
    return replace(case, recordings=recordings, calibration=sound.calibrated(remounted_axes=True))


def markers(*, mirrored: bool = False) -> str:
    """Return a cluster of four markers on the device as TRC, in a laboratory whose y points up."""
    reference = sound.trial().reference
    arms = np.array([[0.08, 0.0, 0.0], [-0.05, 0.07, 0.0], [-0.04, -0.06, 0.03], [0.0, 0.02, 0.09]])
    values = np.asarray(reference.q_nb)
    origin = np.zeros((len(values), 3)) if reference.position is None else reference.position
    points = np.stack([origin + rotate(values, arm) for arm in arms], axis=1)
    x, y, z = np.moveaxis(points, -1, 0)
    return trc(np.stack((x, z, y if mirrored else -y), axis=-1), MARKERS)


def _validate_markers() -> Case:
    """Return a recording with markers of a laboratory whose y points up."""
    options = (*case_of("orient").options, "--markers", ",".join(MARKERS), "--reference-up", "y")
    return replace(case_of("validate"), options=options, references=(markers(),))


def _mount() -> Case:
    """Return a person who stands and walks, and where the device is worn."""
    rng = np.random.default_rng(7003)
    record = walk(rng, "lower-back", q_ab=misplaced(rng, 20.0, np.array([1.0, 0.0, 0.0, 0.0])))
    return _recordings("mount", sound.recording_of(record), options=("--worn", "lower-back"))


# ---- Python


def _record(case: Case) -> undrift.Record:
    return case.recordings[0].record()


def _orient(case: Case) -> object:
    corrected = undrift.correct(_record(case), case.calibration)  # type: ignore[arg-type]
    return undrift.orient(corrected, settings=OrientSettings(offset="rest"))


def _calibrate(case: Case) -> object:
    session = undrift.Session(kind="calibration", serial="", gravity_m_s2=sound.GRAVITY, records=(_record(case),))
    return undrift.calibrate(session)


def _validate(case: Case) -> object:
    (reference,) = case.references
    settings = TrialSettings(offset="rest")
    return undrift.validate_trial(_record(case), reference, calibration=case.calibration, settings=settings)  # type: ignore[arg-type]


def _in_python(name: str, script: Callable[[Case], object]) -> Case:
    case = case_of(name)
    return replace(case, route=f"python {case.route}", script=script)


# ---- the page


async def _drop_files(case: Case, bench: Bench) -> Item:
    """Drop the calibration and the file, and confirm the map that is proposed."""
    homes = [bench.folder / "uploads" / name for name in ("calibration", "recording")]
    for home in homes:
        home.mkdir()
    if case.calibration is not None:
        undrift.write_calibration(case.calibration, homes[0] / "device.json")
        await bench.add([homes[0] / "device.json"])
    recording = case.recordings[0].plain()
    await bench.add([recording.write(homes[1] / "recording0.csv")])
    item = bench.items[0]
    if item.draft:
        item.draft["units"] |= {"gyro": recording.units["gyro"], "accel": recording.units["accel"]}
        if "sample_rate_hz" in item.draft:
            item.draft["sample_rate_hz"] = recording.sample_rate_hz
        await bench.read_again(item)
    return item


async def _calibrate_on_page(case: Case, bench: Bench) -> None:
    """Press Calibrate; the options are the latitude and the angle of the turns."""
    latitude_deg, turn_deg = (*case.options, None)[:2]
    bench.set_place(Place(latitude_deg=latitude_deg, height_m=None if latitude_deg is None else 0.0))  # type: ignore[arg-type]
    item = await _drop_files(case, bench)
    item.turn_deg = turn_deg  # type: ignore[assignment]
    await bench.calibrate(item)


async def _correct_on_page(case: Case, bench: Bench) -> None:
    await bench.correct(await _drop_files(case, bench))


async def _orient_on_page(case: Case, bench: Bench) -> None:
    await bench.orient(await _drop_files(case, bench))


CASES: dict[str, Callable[[], Case]] = {
    "free_poses": lambda: _recordings("calibrate", sound.poses()),
    "turns_by_hand": lambda: _recordings("calibrate", sound.faces_and_turns(), options=(*GRAVITY, "--turn-deg", 360)),
    "rate_table": lambda: Case(route="calibrate", session=sound.table_session()),
    "labelled_turns": lambda: Case(route="calibrate", session=sound.hand_session()),
    "from_motion": lambda: _of_trial("calibrate", "--from", "motion"),
    "new_session": lambda: _recordings(
        "info", sound.faces_and_turns(), options=("--turn-deg", 360, "--write-session", "{folder}/made")
    ),
    "table_with_log": lambda: replace(
        _recordings("calibrate", sound.recording_of(sound.table_without_faces().records[0])),
        options=(*GRAVITY, "--rates", "{folder}/rates.csv"),
        edit=table_log(1.0),
    ),
    "soaks": lambda: Case(route="drift", session=sound.soak(), calibration=sound.calibrated()),
    "stated_soaks": _stated_soaks,
    "ramp": lambda: Case(route="drift", recordings=(sound.ramp(),), calibration=sound.calibrated()),
    "at_rest": lambda: _recordings("noise", sound.rest(), options=()),
    "described": lambda: _of_trial("info"),
    "correct": lambda: replace(_of_trial("correct"), calibration=sound.calibrated()),
    "correct_by_table": lambda: replace(
        case_of("correct"), calibration=undrift.fit_drift([sound.soak()], sound.calibrated()).calibration
    ),
    "imucal": lambda: by_imucal(case_of("correct"), 11),
    "folder": lambda: replace(case_of("correct"), recordings=case_of("correct").recordings * 3, together=True),
    "orient": lambda: replace(case_of("correct"), route="orient", options=("--offset", "rest")),
    "worn_pitch": _worn_pitch,
    "validate": lambda: replace(case_of("orient"), route="validate", references=(sound.trial().reference,)),
    "validate_fit": lambda: replace(
        _of_trial("validate", "--calibrate-from", "reference"), references=(sound.trial().reference,)
    ),
    "validate_markers": _validate_markers,
    "mount": _mount,
    "python_correct": lambda: _in_python("correct", lambda case: undrift.correct(_record(case), case.calibration)),  # type: ignore[arg-type]
    "python_orient": lambda: _in_python("orient", _orient),
    "python_calibrate": lambda: _in_python("free_poses", _calibrate),
    "python_validate": lambda: _in_python("validate", _validate),
    "python_noise": lambda: _in_python("at_rest", lambda case: undrift.fit_noise(_record(case))),
    "page_correct": lambda: replace(case_of("correct"), route="bench correct", page=_correct_on_page),
    "page_orient": lambda: replace(case_of("correct"), route="bench orient", page=_orient_on_page),
    "page_calibrate": lambda: replace(
        case_of("free_poses"), route="bench calibrate", page=_calibrate_on_page, options=(sound.LATITUDE_DEG,)
    ),
    "page_calibrate_turns": lambda: replace(
        case_of("page_calibrate"), recordings=(sound.faces_and_turns(),), options=(sound.LATITUDE_DEG, 360.0)
    ),
}
