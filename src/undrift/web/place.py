"""Place of the bench: gravity is computed from a town or a latitude, or entered directly."""

import csv
from dataclasses import dataclass
from functools import cache
from pathlib import Path as FilePath

from undrift.commands.files import Place
from undrift.errors import InputError
from undrift.units import STANDARD_GRAVITY, gravity_at


@dataclass(frozen=True, slots=True, kw_only=True)
class Site:
    """Place of the bench. Gravity is computed with WGS 84 unless it is given."""

    latitude_deg: float | None = None
    height_m: float = 0.0
    stated_m_s2: float | None = None  # local gravity, in place of the value from the latitude

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
    def known(self) -> bool:
        """Return whether gravity is known."""
        return self.stated_m_s2 is not None or self.latitude_deg is not None

    @property
    def gravity_m_s2(self) -> float:
        """Return local gravity, m/s2, or standard gravity if the place is unknown."""
        if self.stated_m_s2 is not None or self.latitude_deg is None:
            return self.stated_m_s2 or STANDARD_GRAVITY
        return gravity_at(self.latitude_deg, self.height_m)

    def place(self, serial: str = "") -> Place:
        """Return the place for recordings that state no gravity."""
        if self.stated_m_s2 is not None:
            return Place(gravity_m_s2=self.stated_m_s2, serial=serial)
        height_m = None if self.latitude_deg is None else self.height_m
        return Place(latitude_deg=self.latitude_deg, height_m=height_m, serial=serial)

    @property
    def text(self) -> str:
        """Return gravity in words."""
        return f"gravity {self.gravity_m_s2:.4f} m/s2" if self.known else "not known, so standard gravity is assumed"


@cache
def towns() -> dict[str, tuple[float, float]]:
    """Return latitude, deg, and height, m, of some towns by name."""
    rows = csv.reader(FilePath(__file__).with_name("towns.csv").read_text(encoding="utf-8").splitlines())
    return {town: (float(latitude), float(height)) for town, latitude, height in rows}


def place_of(town: str, height: str = "", gravity: str = "") -> Site:
    """Return the place of a form: a town of the list or a latitude in deg, height in m, gravity in m/s2."""
    names = {name.casefold(): where for name, where in towns().items()}
    latitude_deg, height_m = names.get(town.strip().casefold(), (None, 0.0))
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
