"""``undrift sample``: the recordings that come with the package, to try undrift with."""

from pathlib import Path

from undrift.io.sample import write_sample
from undrift.report import Report


def sample(folder: Path = Path("sample"), /) -> Report:
    """Write the sample recordings of the package: six faces, rate table, soaks, a rest, a sit-to-stand task with
    optics.

    Parameters
    ----------
    folder : Path
        A new folder.
    """
    write_sample(folder)
    return Report(
        title="Recordings to try",
        answer="These recordings of a simulated device are for trying undrift.",
        written=[folder],
        next_command=["info", folder / "bench"],
    )
