"""What ``undrift info`` says of a folder that is neither a session nor a recording: one line for each file in it."""

from collections import Counter
from pathlib import Path

from undrift.errors import InputError


def is_plain_folder(path: Path) -> bool:
    """Tell a folder of files from one that is a session or a recording.

    Parameters
    ----------
    path : Path
        File or folder.

    Returns
    -------
    bool
        True for a folder without session.toml or the files of a known device.
    """
    from undrift.io.detect import detect

    if not path.is_dir():
        return False
    try:
        detect(path)
    except InputError:
        return True
    return False


def list_folder(path: Path) -> list[tuple[str, str, str]]:
    """Describe what lies directly in a folder.

    Parameters
    ----------
    path : Path
        The folder.

    Returns
    -------
    list of (str, str, str)
        Name, kind and summary of each file or folder; kind "damaged" where it cannot be read, with the reason.

    Raises
    ------
    InputError
        An empty folder.
    """
    held = sorted(entry for entry in path.iterdir() if not entry.name.startswith("."))
    if not held:
        raise InputError(f"{path}: wanted a recording or a folder of recordings, got an empty folder; check the path")
    return [(entry.name, *_described(entry)) for entry in held]


def _described(path: Path) -> tuple[str, str]:
    from undrift.io.describe import describe

    if is_plain_folder(path):
        return "folder", "not looked into"
    try:
        found = describe(path)
    except InputError as error:
        return "damaged", str(error)
    return found.kind, found.summary


def show_folder(path: Path, *, json: bool) -> None:
    """Say what lies in a folder, for a person or as JSON.

    Parameters
    ----------
    path : Path
        The folder.
    json : bool
        One JSON object with the keys of ``undrift info``, and files.
    """
    from undrift.cli.output import console, write_json

    found = list_folder(path)
    kinds = Counter(kind for _, kind, _ in found)
    summary = f"{len(found)} entries: " + ", ".join(f"{count} {kind}" for kind, count in sorted(kinds.items()))
    if json:
        head = {"kind": "folder", "format": "folder", "rows": None, "sample_rate_hz": None, "duration_s": None}
        rest = {"columns": [], "units": {}, "gaps": 0, "temp_c": None, "stills": []}
        problems = [text for _, kind, text in found if kind == "damaged"]
        files = [{"name": name, "kind": kind, "summary": text} for name, kind, text in found]
        write_json(head | rest | {"problems": problems, "summary": summary, "files": files})
        return
    out = console()
    out.print(f"{path}: folder, {summary}", markup=False)
    for name, kind, text in found:
        out.print(f"  {name}: {kind}, {text}", markup=False)
    out.print("  name one of them to see more", markup=False)
