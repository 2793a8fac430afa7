"""``undrift data list | fetch``: recordings to try, from the package and from public sets by checksum."""

from pathlib import Path
from typing import TYPE_CHECKING

from undrift.base.options import Json, OptionalOutput
from undrift.cli import examples
from undrift.cli.common import group, say, show_table, write_json

if TYPE_CHECKING:
    from undrift.io.public_data import PublicSet

data = group("data", "Recordings to try: the sample of the package, and public sets by checksum and licence; --json.")


@data.command(name="list", help_epilogue=examples("data list"))
def list_sets(*, json: Json = False) -> int:
    """List the sample and the public sets: size, licence, what for, and whether `fetch` gets it."""
    from undrift.io.public_data import SAMPLE, local_copy, public_sets

    def source(one: "PublicSet") -> str:
        held = "package" if one.name == SAMPLE else "local copy" if local_copy(one.name) else ""
        return held or ("download" if one.files else "no")

    rows = [
        {
            "name": one.name,
            "bytes": one.bytes or None,
            "licence": one.licence,
            "what": one.what,
            "address": one.address,
            "fetch": source(one),
            "why_not": one.why_not,
        }
        for one in public_sets()
    ]  # fmt: skip
    if json:
        write_json({"sets": rows}, "data list")
        return 0
    cells = [
        (str(row["name"]), f"{int(row['bytes']) / 1e6:.1f}" if row["bytes"] else "–", str(row["fetch"]), str(row["what"]))
        for row in rows
    ]  # fmt: skip
    show_table("recordings to try", ("name", "MB", "fetch", "what"), cells)
    say(*(f"{row['name']}: licence {row['licence']}{row['address'] and ', ' + str(row['address'])}" for row in rows))
    say(*(f"{row['name']}: not fetched, {row['why_not']}" for row in rows if row["fetch"] == "no"))
    return 0


@data.command(help_epilogue=examples("data fetch"))
def fetch(name: str, /, *, output: OptionalOutput = None, json: Json = False) -> int:
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
    if json:
        write_json({"name": name, "folder": str(folder), "source": source}, "data fetch")
    else:
        say(f"Wrote {folder}, from {source}")
    return 0
