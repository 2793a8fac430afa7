"""Column maps as TOML: the keys of a ``[[recording]]`` without its file, and the same in a file of their own.

sample_rate_hz = 102.4
columns = { time = "t", gyro = ["gx", "gy", "gz"], accel = ["ax", "ay", "az"], temp = "T" }     # names, or positions from 0
units = { time = "s", gyro = "dps", accel = "m/s2", temp = "degC" }
scale = { temp = { gain = 0.00294117647, offset = 36.53 } }     # value = gain * cell + offset
temp_trim = { reads_c = 26.1, true_c = 25.0 }     # of an LM335, units.temp = "lm335_v"
delimiter = ","      # " " for any number of blanks          header = true     skip_rows = 0     decimal = "."
gaps = "raise"       # or "keep"         repair_time = false     drop_bad_rows = false     frame = "s"     device = ""
"""

from pathlib import Path
from typing import Literal

from undrift.errors import InputError
from undrift.io.columns import Column, ColumnMap, Gaps, Scale, TextLayout, Trim
from undrift.io.recording import ReadSettings
from undrift.io.toml import Entry, read_toml

BESIDE_OWN_NAMES = {"sample_rate_hz", "gaps", "repair_time", "drop_bad_rows"}


class ColumnsEntry(Entry):
    """Which column is which channel: a name in the header, or a position from 0.

    Parameters
    ----------
    time : str, int or None
        Time column.
    gyro, accel : list of three, str or None
        Columns x, y, z, or one array name (npz, mat).
    temp : str, int or None
        Temperature column.
    mag : list of three, str or None
        Columns x, y, z.
    """

    time: str | int | None = None
    gyro: list[str | int] | str | None = None
    accel: list[str | int] | str | None = None
    temp: str | int | None = None
    mag: list[str | int] | str | None = None


class UnitsEntry(Entry):
    """The unit of each mapped channel; needed for each that is mapped.

    Parameters
    ----------
    time, gyro, accel, temp, mag : str
        Any spelling of :mod:`undrift.units`.
    """

    time: str = ""
    gyro: str = ""
    accel: str = ""
    temp: str = ""
    mag: str = ""


class LinearEntry(Entry):
    """A linear conversion: value = gain * cell + offset.

    Parameters
    ----------
    gain : float or list of three
        Unit of the channel per unit of the file.
    offset : float or list of three
        In the unit of the channel.
    """

    gain: float | list[float] = 1.0
    offset: float | list[float] = 0.0


class ScaleEntry(Entry):
    """Conversions by channel.

    Parameters
    ----------
    gyro, accel, temp, mag : LinearEntry or None
        From the file's numbers to the unit stated.
    """

    gyro: LinearEntry | None = None
    accel: LinearEntry | None = None
    temp: LinearEntry | None = None
    mag: LinearEntry | None = None


class TrimEntry(Entry):
    """One-point trim of an LM335.

    Parameters
    ----------
    reads_c : float
        What its voltage says, degC.
    true_c : float
        What was true, degC.
    """

    reads_c: float
    true_c: float


class MapEntry(Entry):
    """All that a reader needs to know about a foreign file; each key as in :class:`undrift.io.columns.ColumnMap`.

    Parameters
    ----------
    sample_rate_hz : float or None
        Hz; required when there is no time column.
    columns : ColumnsEntry, list of them, or None
        One table; or one for each file of files side by side.
    units : UnitsEntry
        Units of the mapped channels.
    scale : ScaleEntry
        Conversions, where the file's numbers are not in those units.
    temp_trim : TrimEntry or None
        Of an LM335.
    delimiter : str
        One character; " " for any number of blanks or tabs.
    header : bool
        Whether a line names the columns.
    skip_rows : int
        Lines before the header or the first row.
    decimal : str
        "." or ",".
    drop_bad_rows : bool
        Leave out rows that do not parse.
    gaps : str
        "raise" or "keep".
    repair_time : bool
        Leave out rows whose time does not go forward.
    frame : str
        "s" or "b".
    device : str
        Serial number or name.
    """

    sample_rate_hz: float | None = None
    columns: ColumnsEntry | list[ColumnsEntry] | None = None
    units: UnitsEntry = UnitsEntry()
    scale: ScaleEntry = ScaleEntry()
    temp_trim: TrimEntry | None = None
    delimiter: str = ","
    header: bool = True
    skip_rows: int = 0
    decimal: str = "."
    drop_bad_rows: bool = False
    gaps: Gaps = "raise"
    repair_time: bool = False
    frame: Literal["s", "b"] = "s"
    device: str = ""

    def maps(self) -> tuple[ColumnMap, ...]:
        """Return one column map for each table of columns.

        Returns
        -------
        tuple of ColumnMap
            Empty where no columns are named.

        Raises
        ------
        InputError
            A map that is not complete.
        """
        if self.columns is None:
            return ()
        entries = self.columns if isinstance(self.columns, list) else [self.columns]
        return tuple(self._map(entry) for entry in entries)

    def _map(self, columns: ColumnsEntry) -> ColumnMap:
        return ColumnMap(
            time=columns.time,
            gyro=_columns(columns.gyro),
            accel=_columns(columns.accel),
            temp=columns.temp,
            mag=_columns(columns.mag),
            time_unit=self.units.time,
            gyro_unit=self.units.gyro,
            accel_unit=self.units.accel,
            temp_unit=self.units.temp,
            mag_unit=self.units.mag,
            gyro_scale=_scale(self.scale.gyro, "gyro"),
            accel_scale=_scale(self.scale.accel, "accel"),
            temp_scale=_scale(self.scale.temp, "temp"),
            mag_scale=_scale(self.scale.mag, "mag"),
            temp_trim=None
            if self.temp_trim is None
            else Trim(reads_c=self.temp_trim.reads_c, true_c=self.temp_trim.true_c),
            sample_rate_hz=self.sample_rate_hz,
            layout=TextLayout(
                delimiter=self.delimiter,
                header=self.header,
                skip_rows=self.skip_rows,
                decimal=self.decimal,
                drop_bad_rows=self.drop_bad_rows,
            ),
            gaps=self.gaps,
            repair_time=self.repair_time,
            frame=self.frame,
            device=self.device,
        )


def read_column_map(path: str | Path) -> ColumnMap:
    """Read a column map from a TOML file.

    Parameters
    ----------
    path : str or Path
        The file; keys as in the module's first lines.

    Returns
    -------
    ColumnMap
        Ready for :func:`undrift.io.recording.read_record`.

    Raises
    ------
    InputError
        No such file, no columns, or a map that is not complete.
    FileFormatError
        Not TOML, or an unknown key; names the line.
    """
    maps = read_toml(path, MapEntry).maps()
    if len(maps) != 1:
        raise InputError(f"{path}: wanted one table of columns, got {len(maps)}; add columns = {{ ... }}")
    return maps[0]


def read_map_settings(path: str | Path) -> ReadSettings | None:
    """Read a map without columns: what a file with undrift's own names may need beside them.

    Parameters
    ----------
    path : str or Path
        The file, with any of sample_rate_hz, gaps, repair_time and drop_bad_rows.

    Returns
    -------
    ReadSettings or None
        None where the map names columns.

    Raises
    ------
    InputError
        No such file, an empty map, or a key that means nothing without columns.
    FileFormatError
        Not TOML, or an unknown key; names the line.
    """
    entry = read_toml(path, MapEntry)
    if entry.columns is not None:
        return None
    given = entry.model_fields_set
    if not given or given - BESIDE_OWN_NAMES:
        got = ", ".join(sorted(given - BESIDE_OWN_NAMES)) or "no key"
        raise InputError(
            f"{path}: wanted one table of columns, got 0 and {got}; add columns = {{ ... }}, or for a file with undrift's own "
            f"names only {', '.join(sorted(BESIDE_OWN_NAMES))}"
        )
    return ReadSettings(
        sample_rate_hz=entry.sample_rate_hz,
        gaps=entry.gaps if "gaps" in given else None,
        repair_time=entry.repair_time,
        drop_bad_rows=entry.drop_bad_rows,
    )


def _columns(entry: list[str | int] | str | None) -> tuple[Column, ...] | None:
    if entry is None:
        return None
    return (entry,) if isinstance(entry, str) else tuple(entry)


def _scale(entry: LinearEntry | None, channel: str) -> Scale | None:
    if entry is None:
        return None
    return Scale(gain=_one_or_three(entry.gain, channel), offset=_one_or_three(entry.offset, channel))


def _one_or_three(value: float | list[float], channel: str) -> float | tuple[float, float, float]:
    if not isinstance(value, list):
        return float(value)
    if len(value) != 3 or channel == "temp":
        raise InputError(f"scale.{channel}: wanted one number or three for x, y, z, got {len(value)}")
    return (float(value[0]), float(value[1]), float(value[2]))
