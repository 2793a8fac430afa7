"""What a command may be told about a recording that does not say it itself."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, TypeAlias

from cyclopts import Parameter

if TYPE_CHECKING:
    from undrift.calibration.model import Calibration
    from undrift.io.columns import ColumnMap
    from undrift.io.recording import ReadSettings
    from undrift.record import Record

Flag: TypeAlias = Annotated[bool, Parameter(show_default=False)]


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Opening:
    """How to read a foreign recording.

    Parameters
    ----------
    column_map : Path or None
        TOML file with columns, units and what else a foreign table needs: the keys of a [[recording]] in session.toml.
        With undrift's own column names only sample_rate_hz, gaps, repair_time or drop_bad_rows, without columns.
    sample_rate_hz : float or None
        Samples per second, for a file without time.
    sensor : str or None
        Which sensor, in a file of several (APDM).
    gaps : str or None
        "keep" takes NaN as a gap, "raise" refuses it; overrules the map. Without either it is refused.
    """

    column_map: Annotated[Path | None, Parameter(name="--map")] = None
    sample_rate_hz: float | None = None
    sensor: str | None = None
    gaps: Literal["raise", "keep"] | None = None

    def columns(self) -> "ColumnMap | None":
        """Return the column map, None where none was named.

        Returns
        -------
        ColumnMap or None
            Read from the file; None too where it names no columns, for a file with undrift's own names.
        """
        from undrift.io.mapping import read_column_map, read_map_settings

        if self.column_map is None or read_map_settings(self.column_map) is not None:
            return None
        return read_column_map(self.column_map)

    def settings(self) -> "ReadSettings":
        """Return what else the reader is told.

        Returns
        -------
        ReadSettings
            Rate, sensor, gaps, and what a map without columns says; options overrule it.
        """
        from dataclasses import replace

        from undrift.io.mapping import read_map_settings
        from undrift.io.recording import ReadSettings

        held = (None if self.column_map is None else read_map_settings(self.column_map)) or ReadSettings()
        return replace(
            held,
            sample_rate_hz=self.sample_rate_hz or held.sample_rate_hz,
            sensor=self.sensor,
            gaps=self.gaps or held.gaps,
        )

    def read(self, path: Path) -> "Record":
        """Read a recording; a session folder gives its only recording.

        Parameters
        ----------
        path : Path
            File or folder.

        Returns
        -------
        Record
            The readings.

        Raises
        ------
        InputError
            As the reader says, or a session of several recordings.
        """
        from undrift.errors import InputError
        from undrift.io.detect import detect
        from undrift.io.recording import read_record
        from undrift.io.session import read_session

        if detect(path) != "session":
            return read_record(path, self.columns(), settings=self.settings())
        records = read_session(path).records
        if len(records) > 1:
            raise InputError(
                f"{path}: wanted one recording, got a session of {len(records)}; name the file of one of them"
            )
        return records[0]


def check_physical(record: "Record", path: Path) -> None:
    """Refuse counts and volts where nothing says what they are worth.

    Parameters
    ----------
    record : Record
        As read, without a calibration.
    path : Path
        Where it was read.

    Raises
    ------
    InputError
        A gyroscope or accelerometer in counts or volts.
    """
    from undrift.errors import InputError
    from undrift.units import is_physical

    held = (("gyro", record.gyro, record.gyro_unit), ("accel", record.accel, record.accel_unit))
    for name, values, unit in held:
        if values is not None and not is_physical(unit):
            raise InputError(
                f"{path}: wanted physical units, or the calibration of the device, got {name} in {unit}; "
                "say --calibration calibration.json"
            )


def calibrated_part(record: "Record", model: "Calibration") -> "tuple[Record, tuple[str, ...]]":
    """Leave out the triad that stays in counts or volts because the calibration has no model of it.

    Parameters
    ----------
    record : Record
        As read.
    model : Calibration
        That it is to be corrected with.

    Returns
    -------
    record : Record
        Unchanged where every triad has a model or a physical unit, or where nothing would be left.
    notes : tuple of str
        What was left out, and why.
    """
    from dataclasses import replace

    from undrift.units import is_physical

    if record.gyro is None or record.accel is None or (model.gyro is None and model.accel is None):
        return record, ()
    if model.accel is None and not is_physical(record.accel_unit):
        return replace(record, accel=None, accel_unit="m/s2"), (_left_out("accelerometers", record.accel_unit),)
    if model.gyro is None and not is_physical(record.gyro_unit):
        return replace(record, gyro=None, gyro_unit="rad/s"), (_left_out("gyroscopes", record.gyro_unit),)
    return record, ()


def _left_out(what: str, unit: str) -> str:
    return (
        f"the {what} are left out of the result: their readings are in {unit}, and the calibration has no model of them"
    )


def check_gravity(record: "Record", path: Path) -> None:
    """Refuse accelerations that cannot be in the unit that is stated: the answer would look like one and be wrong.

    Parameters
    ----------
    record : Record
        Readings of a worn or resting device; counts and volts are passed.
    path : Path
        Where they were read.

    Raises
    ------
    InputError
        A median under half or over twice that of gravity.
    """
    from undrift.errors import InputError
    from undrift.io.symptoms import median_accel_g

    median = median_accel_g(record)
    if median < 0.5 or median > 2.0:
        raise InputError(
            f"{path}: wanted a specific force of about 1 g, got a median of {median:.3g} g; check the unit and the scale of the "
            "accelerometer"
        )
