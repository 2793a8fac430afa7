"""real.toml: real recordings to lay beside a study, read and checked before anything runs, judged after it.

[[trial]]                           # a device worn beside optics: two or more of each device
recording = "02.hdf5"               # BROAD, or any recording in physical units; paths from the folder of the file
reference = "02_poses.csv"          # leave out where the recording holds its own, as BROAD does
map = "02.toml"                     # columns and units of a foreign recording, as for --map; leave out where it needs none
device = "B"                        # which device: each trial is judged by a fit to the others of its device
[[capture]]                         # a captured person
file = "STS1.trc.gz"
task = "sit_to_stand"               # or squat, stairs
body = "pelvis"                     # by its markers, the device at L5; or markers = [...] of one rigid cluster
up = "y"
[[stance]]                          # quiet stance on a force plate
file = "PDS13OF1grf.txt.gz"
mass_kg = 65.35
condition = "open on foam"          # open or closed, on firm or foam
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, TypeVar

from pydantic import Field

from undrift.errors import FileFormatError, InputError, UndriftError
from undrift.io.bodies import BodyName
from undrift.io.toml import Entry, read_toml
from undrift.record import Record, Reference
from undrift.study.case import device_of
from undrift.study.motion import read_poses
from undrift.study.plan import Study
from undrift.study.real import DeviceTrials, RealErrors, real_errors
from undrift.study.real_motion import BesideRow, Capture, Captured, motion_rows
from undrift.study.real_sway import Condition, Stance, read_stance, sway_rows
from undrift.study.real_worn import Worn, worn_in
from undrift.validation.trials import LEAST_FOR_AGREEMENT

Given = TypeVar("Given")


class TrialEntry(Entry):
    """[[trial]].

    Parameters
    ----------
    recording : str
        Readings of the device.
    device : str
        Which.
    map : str or None
        Columns, units and sample rate of a foreign recording, a file as for --map.
    reference : str or None
        Poses; None where the recording is a BROAD file.
    markers : list of str
        Labels of one rigid cluster, for TRC or C3D.
    up : str or None
        Laboratory axis that points up, for markers.
    """

    recording: str
    device: str
    map: str | None = None
    reference: str | None = None
    markers: list[str] = Field(default_factory=list)
    up: Literal["y", "z"] | None = None


class CaptureEntry(Entry):
    """[[capture]].

    Parameters
    ----------
    file : str
        Poses or markers.
    task : str
        sit_to_stand, squat or stairs.
    body : str or None
        pelvis, thorax or trunk, found by its markers.
    markers : list of str
        Or labels of one rigid cluster.
    up : str or None
        Laboratory axis that points up, for markers.
    """

    file: str
    task: Captured
    body: BodyName | None = None
    markers: list[str] = Field(default_factory=list)
    up: Literal["y", "z"] | None = None


class StanceEntry(Entry):
    """[[stance]].

    Parameters
    ----------
    file : str
        Table of a force plate.
    mass_kg : float
        Of the person.
    condition : str
        Eyes and surface.
    """

    file: str
    mass_kg: Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
    condition: Condition


class RealFile(Entry):
    """The whole file.

    Parameters
    ----------
    trial, capture, stance : list
        Any of them may be left out.
    """

    trial: list[TrialEntry] = Field(default_factory=list)
    capture: list[CaptureEntry] = Field(default_factory=list)
    stance: list[StanceEntry] = Field(default_factory=list)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RealData:
    """Real recordings, read.

    Parameters
    ----------
    devices : tuple of DeviceTrials
        Trials by device.
    captures : tuple of Capture
        Captured people.
    stances : tuple of Stance
        On a force plate.
    """

    devices: tuple[DeviceTrials, ...]
    captures: tuple[Capture, ...]
    stances: tuple[Stance, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RealOutcome:
    """Real recordings, judged.

    Parameters
    ----------
    errors : tuple of RealErrors
        Levels none, rest, calibrated, the converter's rounding undone and left in; empty without trials.
    motions, sways : tuple of BesideRow
        Captures and stances beside the cohort.
    worn : Worn or None
        The study's device worn in the captures.
    lacks : tuple of str
        What could not be said, and why.
    """

    errors: tuple[RealErrors, ...]
    motions: tuple[BesideRow, ...]
    sways: tuple[BesideRow, ...]
    worn: Worn | None
    lacks: tuple[str, ...]


def read_real(path: str | Path) -> RealData:
    """Read all recordings that a file names.

    Parameters
    ----------
    path : str or Path
        real.toml.

    Returns
    -------
    RealData
        Trials gathered by device.

    Raises
    ------
    InputError
        No such file.
    FileFormatError
        Unknown or missing entries, a recording that cannot be read, a device with a single trial; names the file.
    """
    held, folder = read_toml(path, RealFile), Path(path).parent
    if not (held.trial or held.capture or held.stance):
        raise FileFormatError(f"{path}: wanted a [[trial]], a [[capture]] or a [[stance]], got none; name a recording")
    try:
        return RealData(
            devices=_devices(held.trial, folder),
            captures=tuple(_capture(entry, folder) for entry in held.capture),
            stances=tuple(
                read_stance(folder / entry.file, mass_kg=entry.mass_kg, condition=entry.condition)
                for entry in held.stance
            ),
        )
    except InputError as error:
        raise FileFormatError(f"{path}: {error}") from error


def _devices(entries: list[TrialEntry], folder: Path) -> tuple[DeviceTrials, ...]:
    by: dict[str, list[TrialEntry]] = {}
    for entry in entries:
        by.setdefault(entry.device, []).append(entry)
    few = [name for name, own in by.items() if len(own) < 2]
    if few:
        raise InputError(
            f"trial: wanted two or more of each device, got one of '{few[0]}'; a fit that judges a trial must come from others"
        )
    return tuple(
        DeviceTrials(
            device=name,
            names=tuple(Path(entry.recording).name.split(".")[0] for entry in own),
            pairs=tuple(_pair(entry, folder) for entry in own),
        )
        for name, own in by.items()
    )


def _pair(entry: TrialEntry, folder: Path) -> tuple[Record, Reference]:
    from undrift.io.detect import detect
    from undrift.io.mapping import read_column_map
    from undrift.io.recording import read_record
    from undrift.io.reference import read_reference

    recording = folder / entry.recording
    if entry.reference is None and detect(recording) != "broad":
        raise InputError(f"{recording}: wanted a reference, got none and no BROAD file, which holds its own; name one")
    poses = recording if entry.reference is None else folder / entry.reference
    columns = None if entry.map is None else read_column_map(folder / entry.map)
    return read_record(recording, columns), read_reference(poses, labels=entry.markers or None, up=entry.up)


def _capture(entry: CaptureEntry, folder: Path) -> Capture:
    poses = read_poses(folder / entry.file, body=entry.body, markers=tuple(entry.markers), up=entry.up)
    if poses.position is None:
        raise InputError(f"{entry.file}: wanted poses with positions, got none; risings are found by the height")
    return Capture(name=Path(entry.file).name.split(".")[0], task=entry.task, device=poses)


def judge_real(data: RealData, study: Study) -> RealOutcome:
    """Judge real recordings as the study judges its own.

    Parameters
    ----------
    data : RealData
        Recordings.
    study : Study
        Gives seed, cohort and the device that is worn in the captures.

    Returns
    -------
    RealOutcome
        What a part could not be judged for is told, and the others stand.
    """
    from undrift.sim.device.presets import preset

    lacks: list[str] = []

    def tried(what: str, judge: Callable[[], Given], given: object, otherwise: Given) -> Given:
        if not given:
            lacks.append(f"{what}: none was given")
            return otherwise
        try:
            return judge()
        except UndriftError as error:
            lacks.append(f"{what}: {error}")
            return otherwise

    device = device_of(study, 0) if study.worn else preset(study.device)
    warmer, count, seed = sum(study.excursion_k) / 2.0, min(study.subjects, 30), study.seed
    no_errors: tuple[RealErrors, ...] = ()
    no_rows: tuple[BesideRow, ...] = ()
    errors = tried("trials beside optics", lambda: real_errors(data.devices), data.devices, no_errors)
    if errors and errors[0].agreement is None:
        lacks.append(
            f"agreement over trials: {LEAST_FOR_AGREEMENT} trials or more are needed, {len(errors[0].trials)} were given"
        )
    motions = tried(
        "captured motions",
        lambda: motion_rows(data.captures, subjects=count, seed=seed, group=study.group),
        data.captures,
        no_rows,
    )
    worn: Worn | None = tried(
        "device worn in captured motions",
        lambda: worn_in(data.captures, device, seed=seed, excursion_k=warmer),
        data.captures,
        None,
    )
    if worn is not None and not worn.agreement:
        lacks.append(
            f"agreement over captures: {LEAST_FOR_AGREEMENT} or more are needed, {len(data.captures)} were given"
        )
    sways = tried("stances", lambda: sway_rows(data.stances, subjects=count, seed=seed), data.stances, no_rows)
    return RealOutcome(errors=errors, motions=motions, sways=sways, worn=worn, lacks=tuple(lacks))
