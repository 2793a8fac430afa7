"""What a command may write to: looked at before the work begins, so that a wrong name costs nothing and loses nothing."""

from collections.abc import Iterable
from pathlib import Path

from undrift.errors import InputError


def checked_output(path: Path, *, endings: tuple[str, ...], reads: Iterable[Path | None]) -> Path:
    """Return the path of a file that may be written.

    Parameters
    ----------
    path : Path
        The file to write; it may exist.
    endings : tuple of str
        How its name may end.
    reads : iterable of Path or None
        What the command reads: none of these files, nor a recording in these folders, is written over.

    Returns
    -------
    Path
        The same.

    Raises
    ------
    InputError
        Another ending, a folder of that name, no folder to write into, or a file that is read.
    """
    if not path.name.lower().endswith(endings):
        raise InputError(f"{path}: wanted a name ending in {_either(endings)}, got another; name the format so")
    if path.is_dir():
        raise InputError(f"{path}: wanted the name of a file to write, got a folder; name a file in it")
    if not path.parent.is_dir():
        raise InputError(f"{path}: wanted a folder that exists, got none named {path.parent}; make it first")
    if path.exists() and any(_holds(read, path) for read in reads if read is not None):
        raise InputError(f"{path}: wanted another file to write than those that are read; name another")
    return path


def checked_folder(path: Path) -> Path:
    """Return the path of a folder that may be written to or made.

    Parameters
    ----------
    path : Path
        The folder; the one that holds it must exist.

    Returns
    -------
    Path
        The same.

    Raises
    ------
    InputError
        A file of that name, or nothing that could hold it.
    """
    if path.exists() and not path.is_dir():
        raise InputError(f"{path}: wanted a folder to write to, got a file of that name; name another")
    if not path.exists() and not path.parent.is_dir():
        raise InputError(f"{path}: wanted a folder that exists, got none named {path.parent}; make it first")
    return path


def name_of(path: Path) -> str:
    """Return a recording's name without its endings: walk.v2 of walk.v2.csv.gz.

    Parameters
    ----------
    path : Path
        File or folder.

    Returns
    -------
    str
        To name rows and files by.
    """
    name = path.resolve().name if path.name in ("", "..") else path.name
    for ending in (".gz", ".csv", ".txt", ".log", ".parquet", ".npz", ".mat", ".hdf5", ".h5", ".tsv"):
        if len(name) > len(ending):
            name = name.removesuffix(ending)
    return name


def _holds(read: Path, target: Path) -> bool:
    from undrift.io.session import NAME, read_session

    if not read.is_dir():
        return read.exists() and target.samefile(read)
    if (read / NAME).is_file():
        names = [NAME, *(name for name, _ in read_session(read).inputs)]
    else:
        names = [file.name for file in read.iterdir()]  # of a device that records into a folder
    return any(target.samefile(read / name) for name in names)


def _either(endings: tuple[str, ...]) -> str:
    return endings[0] if len(endings) == 1 else ", ".join(endings[:-1]) + " or " + endings[-1]
