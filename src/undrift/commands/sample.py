"""``undrift sample``: write the sample recordings of the package, for trying undrift."""

import shutil
from importlib.resources import as_file, files
from pathlib import Path

from undrift.files import new_folder
from undrift.report import Report


def sample(folder: Path = Path("sample"), /) -> Report:
    """Write the sample recordings of the package: six faces, rate table, soaks, a rest, a sit-to-stand task with optics.

    Parameters
    ----------
    folder : Path
        A new folder.
    """
    with new_folder(folder) as draft, as_file(files("undrift").joinpath("sample_data")) as source:
        ignored = shutil.ignore_patterns("*.pyc", "__pycache__")
        shutil.copytree(source, draft, ignore=ignored, copy_function=shutil.copyfile)
    return Report(
        title="Recordings to try",
        answer="These recordings of a simulated device are for trying undrift.",
        written=[folder],
        next_command=["info", folder / "bench"],
    )
