"""Drawings of the guided pages, as SVG made here: a box with a face up, the turn about an axis, the light, the countdown."""

import math
from collections.abc import Sequence

from undrift.commands.bench.capture import Light
from undrift.record import Face

Vector = tuple[float, float, float]
HALF: Vector = (62.0, 44.0, 22.0)  # of the box along x, y and z
FILLS = {"z": "0.06", "x": "0.14", "y": "0.24"}  # of the three sides that are seen, by how they are lit
SHAPES = {  # of the light: the colour is never the only sign
    "no readings": '<path d="M12 12 L36 36 M36 12 L12 36" stroke="{c}" stroke-width="6"/>',
    "moving": '<path d="M6 16 h30 l-8 -8 M42 32 h-30 l8 8" stroke="{c}" stroke-width="5"/>',
    "settling": '<path d="M24 6 a18 18 0 0 1 0 36 z" fill="{c}"/><path d="M24 6 a18 18 0 0 0 0 36" stroke="{c}" stroke-width="4"/>',
    "still": '<circle cx="24" cy="24" r="19" fill="{c}"/>',
    "captured": '<path d="M8 26 l11 11 l21 -26" stroke="{c}" stroke-width="7"/>',
    "wrong face": '<path d="M10 24 a14 14 0 1 1 6 12 M16 44 v-9 h9" stroke="{c}" stroke-width="5"/>',
    "tilted": '<path d="M5 40 h38 M8 38 L40 22" stroke="{c}" stroke-width="5"/>',
    "unknown face": '<path d="M16 16 a8 8 0 1 1 9 9 v6 M25 39 v2" stroke="{c}" stroke-width="5"/>',
}
COLOURS = {"still": "good", "captured": "good", "settling": "marginal", "no readings": "bad"}


def _world(face: Face, v: Vector) -> Vector:
    """Return a vector of the box as it stands with a face up: z up, the other axes follow round."""
    k = "xyz".index(face[1])
    a, b, up = v[(k + 1) % 3], v[(k + 2) % 3], v[k]
    return (a, b, up) if face[0] == "+" else (a, -b, -up)


def _screen(v: Vector) -> tuple[float, float]:
    """Return where a point is drawn: seen from the front, the right and above."""
    x, y, z = v
    return 0.87 * (y - x), 0.38 * (x + y) - 0.9 * z


def _path(points: Sequence[tuple[float, float]]) -> str:
    return "M" + " L".join(f"{x:.1f} {y:.1f}" for x, y in points)


def box(face: Face, turn: str = "") -> str:
    """Return the box with a face up; with ``turn`` (+ or -) the turn about the axis that is up."""
    parts = []
    for axis in FILLS:
        for sign in (1.0, -1.0):
            k = "xyz".index(axis)
            normal = [0.0, 0.0, 0.0]
            normal[k] = sign
            seen = _world(face, (normal[0], normal[1], normal[2]))
            if max(seen) < 0.5:  # on the far side
                continue
            across = [0.0, 0.0, 0.0]
            corners = []
            for one, other in ((1, 1), (1, -1), (-1, -1), (-1, 1)):
                across[k], across[(k + 1) % 3], across[(k + 2) % 3] = sign, one, other
                corners.append(_screen(_world(face, (across[0] * HALF[0], across[1] * HALF[1], across[2] * HALF[2]))))
            top = seen[2] > 0.5
            x, y = (sum(corner[i] for corner in corners) / 4.0 for i in (0, 1))
            name = f"{'+' if sign > 0.0 else '-'}{axis}"
            shade = FILLS["z" if top else "x" if seen[0] > 0.5 else "y"]
            parts.append(f'<path d="{_path(corners)} Z" fill="currentColor" fill-opacity="{shade}"/>')
            place = f'x="{x:.1f}" y="{y + (9 if top else 6):.1f}" class="{"top" if top else "side"}"'
            parts.append(f"<text {place}>{name}</text>")
    height = _screen(_world(face, (0.0, 0.0, 0.0)))[1] - 0.9 * HALF["xyz".index(face[1])]
    if turn:
        parts.append(_round_arrow(turn, height - 34.0))
    else:
        parts.append(f'<path class="act" d="M0 {height - 22:.1f} v-34 m-9 11 l9 -11 l9 11" stroke-width="5"/>')
    words = f"Box with {face} up" + (
        f", turned {'counter-clockwise' if turn == '+' else 'clockwise'} seen from above" if turn else ""
    )
    return (
        f'<svg class="device" viewBox="-115 -125 230 210" role="img" aria-label="{words}"><g fill="none" stroke="currentColor" '
        f'stroke-width="2" stroke-linejoin="round" stroke-linecap="round">{"".join(parts)}</g></svg>'
    )


def _round_arrow(turn: str, height: float) -> str:
    """Return an arrow round the axis that is up; counter-clockwise, seen from above, for +."""
    way = 1.0 if turn == "+" else -1.0
    points = [(58.0 * math.sin(way * a), height + 19.0 * math.cos(way * a)) for a in (0.1 * k for k in range(-24, 25))]
    (x0, y0), (x1, y1) = points[-4], points[-1]
    angle = math.atan2(y1 - y0, x1 - x0)
    tips = [(x1 - 15.0 * math.cos(angle + s), y1 - 15.0 * math.sin(angle + s)) for s in (0.55, -0.55)]
    drawn = (_path(points), _path([tips[0], points[-1], tips[1]]))
    return "".join(f'<path class="act" d="{path}" stroke-width="5"/>' for path in drawn)


STANDING = (  # a person who stands and faces right, seen from the right; the device is at the low back
    '<circle cx="-62" cy="-88" r="13"/><path d="M-62 -75 C-74 -50 -66 -30 -72 -8 L-60 38 L-66 88 h22 M-62 -70 q14 26 8 48 l14 16"/>'
    '<path d="M-50 -90 l6 3" /><rect x="-83" y="-28" width="9" height="18" fill="currentColor"/>'
    '<path d="M-70 -19 L22 -8" stroke-dasharray="3 5"/>'
)
BODY = {"forward": (1.0, 0.0), "left": (0.5, -0.5), "up": (0.0, -1.0)}  # on the screen; left is away from the viewer


def worn(forward: str, up: str) -> str:
    """Return a standing person with the device, and where its axes point by the sides that point forward and up."""
    parts, words = [STANDING], []
    x0, y0 = 34.0, 5.0
    box_ = "".join(f"L{x0 + x:.0f} {y0 + y:.0f} " for x, y in ((-9, -20), (9, -20), (9, 20), (-9, 20)))[1:]
    parts.append(f'<path d="M{box_}Z" fill="currentColor" fill-opacity="0.14"/>')
    for axis, (way, sign) in _ways(forward, up).items():
        along = tuple(sign * 52.0 * part for part in BODY[way])
        x1, y1, angle = x0 + along[0], y0 + along[1], math.atan2(along[1], along[0])
        tips = [(x1 - 11.0 * math.cos(angle + s), y1 - 11.0 * math.sin(angle + s)) for s in (0.5, -0.5)]
        parts.append(f'<path class="act" d="{_path([(x0, y0), (x1, y1)])} {_path([tips[0], (x1, y1), tips[1]])}"/>')
        parts.append(f'<text x="{x0 + 1.28 * along[0]:.0f}" y="{y0 + 1.28 * along[1] + 6.0:.0f}">{axis}</text>')
        words.append(f"{axis} points {way if sign > 0.0 else {'forward': 'back', 'left': 'right', 'up': 'down'}[way]}")
    label = "Device at the low back of a standing person" + (f": {', '.join(words)}" if words else "")
    return (
        f'<svg class="device" viewBox="-115 -108 230 205" role="img" aria-label="{label}"><g fill="none" stroke="currentColor" '
        f'stroke-width="2.5" stroke-linejoin="round" stroke-linecap="round">{"".join(parts)}</g></svg>'
    )


def _ways(forward: str, up: str) -> dict[str, tuple[str, float]]:
    """Return where each axis of a right-handed device points; none where the two sides do not show it."""
    if not (forward and up) or forward[1] == up[1]:
        return {}
    k, m = "xyz".index(up[1]), "xyz".index(forward[1])
    sign = (1.0 if up[0] == forward[0] else -1.0) * (1.0 if (m - k) % 3 == 1 else -1.0)  # left = up x forward
    sides = {forward[1]: ("forward", 1.0 if forward[0] == "+" else -1.0), up[1]: ("up", 1.0 if up[0] == "+" else -1.0)}
    return dict(sorted((sides | {"xyz"[3 - k - m]: ("left", sign)}).items()))


def lamp(light: Light) -> str:
    """Return the shape of the light; its words stand beside it."""
    shape = SHAPES[light.state].format(c=f"var(--{COLOURS.get(light.state, 'ink')})")
    return f'<svg class="lamp" viewBox="0 0 48 48" aria-hidden="true">{shape}</svg>'


def ring(left_s: float | None, whole_s: float) -> str:
    """Return the countdown as a ring that closes, with the seconds left; nothing in its place where nothing counts down."""
    if left_s is None:
        return '<svg class="ring" viewBox="0 0 100 100" aria-hidden="true"></svg>'
    share = min(max(1.0 - left_s / whole_s, 0.0), 1.0)
    around = 2.0 * math.pi * 40.0
    circle = '<circle cx="50" cy="50" r="40"'
    return (
        f'<svg class="ring" viewBox="0 0 100 100" aria-hidden="true">{circle}/>{circle} class="gone" '
        f'stroke-dasharray="{around * share:.1f} {around:.1f}"/><text x="50" y="63">{math.ceil(left_s)}</text></svg>'
    )
