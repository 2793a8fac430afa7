"""``undrift sample``: the recordings that come with the package, to try undrift with."""

from pathlib import Path

from undrift.base.options import verb
from undrift.base.summary import Summary


@verb
def sample(folder: Path = Path("sample"), /) -> Summary:
    """Write the sample recordings of the package: six faces, rate table, soaks, a rest, a sit-to-stand task with
    optics.

    Parameters
    ----------
    folder : Path
        A new folder.
    """
    from undrift.io.sample import write_sample

    write_sample(folder)
    return Summary(
        title="Recordings to try",
        answer="Recordings of a simulated device, to try undrift.",
        data={"folder": str(folder)},
        written=(folder,),
        next=("info", folder / "bench"),
    )
