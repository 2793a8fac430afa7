"""Column maps written in one line: time="t", time_unit="s", gyro=("gx", "gy", "gz"), gyro_unit="dps"."""

from typing import Any

from undrift.io.column_map import CHANNELS, ChannelColumns, ColumnMap, TextLayout
from undrift.io.reference import PoseColumns, ReferenceMap


def column_map(*, layout: TextLayout | None = None, **keys: Any) -> ColumnMap:
    """Return the map of some channels with their units and scales, and other keys as they are."""
    keys |= {} if layout is None else layout.model_dump()
    columns = ChannelColumns(**{key: keys.pop(key) for key in (*CHANNELS, "counter") if key in keys})
    units = {name: keys.pop(f"{name}_unit") for name in CHANNELS if f"{name}_unit" in keys}
    scale = {name: s for name in CHANNELS if (s := keys.pop(f"{name}_scale", None)) is not None}
    return ColumnMap(columns=columns, units=units, scale=scale, **keys)


def reference_map(**keys: Any) -> ReferenceMap:
    """Return the map of poses: columns, their units, and other keys as they are."""
    columns = {key: keys.pop(key) for key in PoseColumns.model_fields if key in keys}
    units = {
        name: keys.pop(f"{name}_unit") for name in ("time", "position", "markers", "angle") if f"{name}_unit" in keys
    }
    return ReferenceMap(columns=PoseColumns(**columns), units=units, **keys)
