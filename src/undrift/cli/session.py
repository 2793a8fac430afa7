"""``undrift session new``: a session.toml of bare recordings, with what was found in them, ready to edit."""

from cyclopts import App, Parameter

from undrift.cli.common import (
    Files,
    Json,
    Opening,
    Output,
    Place,
    check_folder,
    say,
    say_next,
    session_of,
    waiting,
    write_json,
)
from undrift.cli.examples import examples
from undrift.errors import InputError

session = App(
    name="session",
    help="Write a session.toml of bare recordings, with the rests, faces and turns found in them; --json.",
    help_format="plaintext",
    default_parameter=Parameter(negative=()),
    result_action="return_value",
    help_epilogue=examples("session"),
)


@session.command(help_epilogue=examples("session new"))
def new(
    *files: Files,
    output: Output,
    place: Place = Place(),
    opening: Opening = Opening(),
    turn_deg: float | None = None,
    json: Json = False,
) -> int:
    """Write a session.toml with the rests, faces and turns found in bare recordings, ready to edit.

    Parameters
    ----------
    files : Path
        One or several recordings of one device; they stay where they are.
    output : Path
        Folder for session.toml, made where it is missing.
    place : Place
        Local gravity, and the device.
    opening : Opening
        How to read foreign recordings.
    turn_deg : float or None
        Angle of the turns between rests, deg: 360 for full turns.
    """
    from undrift.calibration.calibrate import find_pieces
    from undrift.calibration.observe import CalibrateSettings
    from undrift.files import write_whole
    from undrift.io.proposal import session_text
    from undrift.io.session import NAME

    check_folder(output)
    if (output / NAME).exists():
        raise InputError(f"{output / NAME}: wanted a new session, got one that exists; edit it, or name another folder")
    with waiting("reading and looking for rests and turns"):
        if any((file / NAME).is_file() or file.name == NAME for file in files):
            raise InputError(f"{files[0]}: wanted bare recordings, got a session; edit its session.toml")
        bare = session_of(files, place, opening)
        found, steady = find_pieces(bare, CalibrateSettings(turn_angle_deg=turn_deg))
    text = session_text(found, files, output, file_map=opening.file_map(), steady=steady)
    output.mkdir(exist_ok=True)
    write_whole(output / NAME, text)
    faces = list(dict.fromkeys(still.face for still in found.stills if still.face is not None))
    counts = {"stills": len(found.stills), "turns": len(found.turns), "steady_turns": len(steady)}
    if json:
        gravity = {"gravity_m_s2": found.gravity_m_s2, "gravity_source": found.gravity_source}
        made = {"output": str(output / NAME), "recordings": len(found.records), "faces": faces}
        write_json(made | counts | gravity, "session new")
        return 0
    say(
        f"Wrote {output / NAME}",
        f"  still phases: {counts['stills']}; faces: {', '.join(faces) or 'not all six, free poses'}; turns by a known angle: "
        f"{counts['turns']}; steady turns, their rate to be stated: {counts['steady_turns']}",
        f"  gravity {found.gravity_m_s2:.5f} m/s2 ({found.gravity_source})",
    )
    say_next("calibrate", output, "-o", "calibration.json")
    return 0
