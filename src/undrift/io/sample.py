"""The sample recordings of the package, all simulated: six faces, rate table, soaks, a rest, and a sit-to-stand task
with optics.
"""

import shutil
from importlib.resources import as_file, files
from pathlib import Path

from undrift.errors import InputError
from undrift.files import hidden_folder, no_folder


def write_sample(folder: Path) -> None:
    """Copy the sample into a new folder, all of it or nothing."""
    if folder.exists():
        raise InputError(f"{folder}: the folder exists already. Choose another name.")
    if not folder.parent.is_dir():
        raise InputError(f"{folder}: the folder {folder.parent} does not exist. Create it first.")
    try:
        with as_file(files("undrift").joinpath("sample_data")) as source, hidden_folder(folder.parent) as hidden:
            copy = hidden / folder.name
            shutil.copytree(
                source, copy, ignore=shutil.ignore_patterns("*.pyc", "__pycache__"), copy_function=shutil.copyfile
            )
            copy.rename(folder)
    except OSError as error:
        raise no_folder(folder, error) from error
