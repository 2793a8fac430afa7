"""The sample recordings of the package, all simulated: six faces, rate table, soaks, a rest, and a sit-to-stand task
with optics.
"""

import shutil
from importlib.resources import as_file, files
from pathlib import Path

from undrift.files import new_folder


def write_sample(folder: Path) -> None:
    """Copy the sample into a new folder, all of it or nothing."""
    with new_folder(folder) as draft, as_file(files("undrift").joinpath("sample_data")) as source:
        ignored = shutil.ignore_patterns("*.pyc", "__pycache__")
        shutil.copytree(source, draft, ignore=ignored, copy_function=shutil.copyfile)
