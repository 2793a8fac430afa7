"""Location of the bench: gravity is computed from a town or a latitude, or entered directly."""

import csv
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from undrift.base.options import asked, stated
from undrift.errors import InputError
from undrift.units import STANDARD_GRAVITY, gravity_at
from undrift.web import parts

if TYPE_CHECKING:
    from undrift.web.bench import Bench


@dataclass(frozen=True, slots=True, kw_only=True)
class Site:
    """Location of the bench. Gravity is computed with WGS 84 unless it is given."""

    latitude_deg: float | None = None
    height_m: float = 0.0
    stated_m_s2: float | None = None  # local gravity, which overrides the value from the latitude

    def __post_init__(self) -> None:
        if self.latitude_deg is not None and not -90.0 <= self.latitude_deg <= 90.0:
            raise InputError(f"latitude: expected -90 to 90 deg, got {self.latitude_deg:g}. North is positive.")
        if not -500.0 <= self.height_m <= 9000.0:
            raise InputError(f"height: expected -500 to 9000 m, got {self.height_m:g}. Enter metres above sea level.")
        if self.stated_m_s2 is not None and not 9.7 < self.stated_m_s2 < 9.9:
            raise InputError(
                f"gravity: expected 9.7 to 9.9 m/s2, got {self.stated_m_s2:g}. Enter gravity in m/s2, or a town."
            )

    @property
    def gravity_m_s2(self) -> float:
        """Return local gravity, m/s2, or standard gravity if the location is unknown."""
        if self.stated_m_s2 is not None or self.latitude_deg is None:
            return self.stated_m_s2 or STANDARD_GRAVITY
        return gravity_at(self.latitude_deg, self.height_m)

    def words(self) -> tuple[object, ...]:
        """Return the options of ``calibrate`` for recordings that state no gravity."""
        if self.stated_m_s2 is not None:
            return stated(gravity_m_s2=self.stated_m_s2)
        return () if self.latitude_deg is None else stated(latitude_deg=self.latitude_deg, height_m=self.height_m)


@cache
def towns() -> dict[str, tuple[float, float]]:
    """Return latitude, deg, and height, m, of some towns by name."""
    rows = csv.reader(Path(__file__).with_name("towns.csv").read_text(encoding="utf-8").splitlines())
    return {town.casefold(): (float(latitude), float(height)) for town, latitude, height in rows}


@dataclass(slots=True, kw_only=True)
class PlaceForm:
    """Input of the location form."""

    town: str = asked("--latitude-deg", hint="north is positive", kind="list", options=lambda: list(towns()))
    height: str = asked("--height-m", hint="empty: height of the town")
    gravity: str = asked("--gravity-m-s2", hint="in place of the town")


def place_of(town: str, height: str = "", gravity: str = "") -> Site:
    """Return the location entered in the form: a town from the list or a latitude in deg, height in m, gravity in m/s2."""
    latitude_deg, height_m = towns().get(town.strip().casefold(), (None, 0.0))
    if latitude_deg is None and town.strip():
        latitude_deg = _number("town", town, "a town of the list, or its latitude in deg")
    height_m = _number("height", height, "metres above the sea") if height.strip() else height_m
    stated_m_s2 = _number("gravity", gravity, "m/s2") if gravity.strip() else None
    return Site(latitude_deg=latitude_deg, height_m=height_m, stated_m_s2=stated_m_s2)


def _number(name: str, entry: str, wanted: str) -> float:
    try:
        return float(entry.replace(",", "."))
    except ValueError as error:
        raise InputError(f"{name}: expected {wanted}, got '{entry.strip()}'. Correct the entry.") from error


def place_form(bench: "Bench", label: str, then: Callable[[], Any] = bool) -> None:
    """Ask for the location of the bench. The accelerometer scale cannot be more accurate than local gravity."""
    place = bench.place
    values = place.latitude_deg, place.height_m, place.stated_m_s2
    latitude, height, gravity = ("" if value is None else f"{value:g}" for value in values)
    typed = PlaceForm(town=latitude, height=height if latitude else "", gravity=gravity)
    parts.form(typed, "town", "height", "gravity")

    def keep() -> Any:
        bench.set_place(place_of(typed.town, typed.height, typed.gravity))
        return then()

    parts.button(label, keep)
