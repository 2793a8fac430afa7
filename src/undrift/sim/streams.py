"""Streams: one independent source of random numbers per effect, named, so that adding an effect changes no other's noise.

A stream is a numpy generator seeded by (root, crc32 of the effect's name). The root is drawn from the caller's
generator, 128 bits at a time: each call of a simulator gets fresh noise, and the same generator gives the same noise again.
"""

import zlib
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True)
class Streams:
    """Named random streams of one simulation.

    Parameters
    ----------
    root : tuple of int
        Entropy shared by the streams, four words of 32 bits.
    """

    root: tuple[int, ...]

    def of(self, effect: str) -> np.random.Generator:
        """Return the stream of one effect.

        Parameters
        ----------
        effect : str
            Name of the effect: "gyro_white", "pose", ...

        Returns
        -------
        Generator
            The same numbers for the same root and name, whatever other effects drew.
        """
        key = zlib.crc32(effect.encode())
        return np.random.default_rng(np.random.SeedSequence(self.root, spawn_key=(key,)))


def draw_streams(rng: np.random.Generator) -> Streams:
    """Return fresh streams; the caller's generator moves on by one draw of 128 bits.

    Parameters
    ----------
    rng : Generator
        Source of the root.

    Returns
    -------
    Streams
        Independent of those of the next call.
    """
    return Streams(tuple(int(word) for word in rng.integers(0, 2**32, 4, dtype=np.uint64)))
