"""Segments: where in a record the device stood still, turned at a steady rate, or was moved from one pose to the next.

``find_still`` -> Still, ``find_turns`` -> Turn, ``label_faces`` names the axis that points up. Ranges are [start, stop).
"""

from undrift.segments.faces import faces_of, label_faces, still_means
from undrift.segments.still import StillSearch, StillSettings, StillThreshold, find_still, sliding_moments
from undrift.segments.turns import TurnSearch, TurnSettings, find_turns

__all__ = [
    "find_still",
    "StillSearch",
    "StillSettings",
    "StillThreshold",
    "sliding_moments",
    "find_turns",
    "TurnSearch",
    "TurnSettings",
    "label_faces",
    "faces_of",
    "still_means",
]
