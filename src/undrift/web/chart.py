"""Chart of a recording: turn rate above specific force. Bands behind the lines mark rests and turns."""

from collections.abc import Mapping
from typing import Any

QUANTITIES = {"gyro": "Turn rate", "accel": "Specific force"}  # from above
LINES = (("x", "#1a73b8", "solid"), ("y", "#d2601a", "dashed"), ("z", "#1d8a63", "dotted"))  # name, colour, dash
BANDS = {"still": "#1d8a6330", "turn": "#d2601a20"}  # colours behind rests and turns
GREY = {"color": "#808080"}  # of words: seen on light and on dark pages
AXIS = {"type": "value", "axisLabel": GREY, "nameTextStyle": GREY, "splitLine": {"lineStyle": {"color": "#80808040"}}}


def chart_of(trace: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of the chart, as ECharts takes them."""
    quantities = [name for name in QUANTITIES if name in trace["readings"]]
    both, length, height = {"xAxisIndex": "all"}, trace["time"][-1], 78 // len(quantities)
    grids, times, values, series = list[Any](), list[Any](), list[Any](), list[Any]()
    for k, name in enumerate(quantities):
        title = {"name": f"{QUANTITIES[name]} ({trace['units'][name]})", "nameTextStyle": GREY | {"align": "left"}}
        grids.append({"left": 64, "right": 16, "top": f"{9 + k * height}%", "height": f"{height - 11}%"})
        times.append(AXIS | {"gridIndex": k, "min": 0, "max": length, "name": "s", "nameGap": 4})
        values.append(AXIS | {"gridIndex": k, "scale": True} | title)
        for (axis, colour, dash), readings in zip(LINES, trace["readings"][name], strict=True):
            line = {"lineStyle": {"width": 1, "type": dash}, "itemStyle": {"color": colour}, "showSymbol": False}
            points = [list(point) for point in zip(trace["time"], readings, strict=True)]
            series.append({"type": "line", "name": axis, "xAxisIndex": k, "yAxisIndex": k, "data": points} | line)
        series[-1]["markArea"] = {"silent": True, "label": GREY | {"position": "insideTop"}, "data": _bands(trace)}
    return {
        "animation": False,
        "tooltip": {"trigger": "axis"},
        "legend": {"data": [axis for axis, *_ in LINES], "textStyle": GREY, "top": 0, "right": 16},
        "axisPointer": {"link": [both]},
        "dataZoom": [both | {"type": "slider", "bottom": 8}],
        "grid": grids,
        "xAxis": times,
        "yAxis": values,
        "series": series,
    }


def _bands(trace: Mapping[str, Any]) -> list[Any]:
    """Return where a rest or turn begins and ends, with its name: the face that is up, or the axis."""
    return [
        [{"name": label.split(" ")[0], "xAxis": start, "itemStyle": {"color": BANDS[kind]}}, {"xAxis": stop}]
        for kind, label, start, stop in trace["stretches"]
    ]
