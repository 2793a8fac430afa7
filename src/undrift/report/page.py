"""A report page: one self-contained HTML file with tables and pictures, nothing to download."""

from dataclasses import dataclass
from pathlib import Path

from undrift import __version__
from undrift.calibration.model import Verdict
from undrift.files import write_whole


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """A heading, what is said under it, a table and pictures.

    Parameters
    ----------
    title : str
        Heading.
    text : tuple of str
        Paragraphs.
    columns : tuple of str
        Heads of the table, with units.
    rows : tuple of tuple of str
        Cells.
    pictures : tuple of str
        SVG elements.
    words : bool
        Cells hold words rather than figures: aligned at the left.
    """

    title: str
    text: tuple[str, ...] = ()
    columns: tuple[str, ...] = ()
    rows: tuple[tuple[str, ...], ...] = ()
    pictures: tuple[str, ...] = ()
    words: bool = False


def write_page(
    path: Path, *, title: str, lead: str, sections: tuple[Section, ...], verdict: Verdict | None = None
) -> None:
    """Write a report page.

    Parameters
    ----------
    path : Path
        The .html file.
    title, lead : str
        Heading and the sentence under it.
    sections : tuple of Section
        In order.
    verdict : Verdict or None
        Shown first where there is one.
    """
    from jinja2 import Environment, PackageLoader

    template = Environment(loader=PackageLoader("undrift", "report"), autoescape=True).get_template("page.html.j2")
    text = template.render(title=title, lead=lead, sections=sections, verdict=verdict, version=__version__)
    write_whole(path, text)
