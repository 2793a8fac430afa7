"""``undrift data list | fetch``: recordings to try, from the package and from public sets by checksum."""

from pathlib import Path
from typing import TYPE_CHECKING

from undrift.base.options import OptionalOutput, verb
from undrift.base.summary import Section, Summary, table_section

if TYPE_CHECKING:
    from undrift.io.public_data import PublicSet


@verb
def list_sets() -> Summary:
    """List the sample and the public sets: size, licence, what for, and whether `fetch` gets it."""
    from undrift.io.public_data import SAMPLE, local_copy, public_sets

    def source(one: "PublicSet") -> str:
        kept = "package" if one.name == SAMPLE else "local copy" if local_copy(one.name) else ""
        return kept or ("download" if one.files else "no")

    sets = public_sets()
    text = [f"{one.name}: licence {one.licence}{one.address and ', ' + one.address}" for one in sets]
    text += [f"{one.name}: not fetched, {one.why_not}" for one in sets if source(one) == "no"]
    cells = (
        ("name", lambda one: one.name),
        ("MB", lambda one: f"{one.bytes / 1e6:.1f}" if one.bytes else "–"),
        ("fetch", source),
        ("what", lambda one: one.what),
    )
    keys = ("name", "licence", "what", "address", "why_not")
    more = ({"bytes": one.bytes or None, "fetch": source(one)} for one in sets)
    rows = [{key: getattr(one, key) for key in keys} | row for one, row in zip(sets, more, strict=True)]
    return Summary(
        title="Recordings to try",
        answer=f"{len(sets)} sets of recordings to try.",
        data={"sets": rows},
        sections=(
            table_section("recordings to try", sets, cells, words=True),
            Section(title="Sources", text=tuple(text)),
        ),
    )


@verb
def fetch(name: str, /, *, output: OptionalOutput = None) -> Summary:
    """Copy the sample, or a local copy of a public set, or download the set and check it.

    Parameters
    ----------
    name : str
        As `undrift data list` shows it; sample comes with the package and needs no network.
    output : Path or None
        A new folder; one of that name in the working folder where not given.
    """
    from undrift.io import public_data

    folder = Path(name) if output is None else output
    source = public_data.fetch(name, folder)
    return Summary(
        title=f"Recordings: {name}",
        answer=f"{name} comes from {source}.",
        data={"name": name, "folder": str(folder), "source": source},
        written=(folder,),
    )
