"""Writer: a thread that takes blocks from a bounded queue and puts them on the disk as pieces.

A full queue makes the reader wait, never lose: the sender's socket then fills, and TCP makes the sender wait too.
"""

import contextlib
import queue
import threading
from pathlib import Path

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import LinkError, RigTimeout, UndriftError
from undrift.live.description import StreamDescription
from undrift.live.pieces import next_connection, piece_path, write_synced
from undrift.live.timeline import Block

QUEUE_BLOCKS = 4096
KEPT_ROWS = 2  # stay behind for the next piece, so that the last one is a record of two rows at least


class PieceWriter:
    """Writes blocks until stopped.

    Parameters
    ----------
    folder : Path
        Where the pieces go; made where it is not there.
    description : StreamDescription
        What the columns are.
    rows : int
        Readings in a piece.
    """

    def __init__(self, folder: Path, description: StreamDescription, rows: int) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self.connection = folder, next_connection(folder)
        self.pieces = self.rows = 0
        self.failure: UndriftError | None = None
        self._description = description
        self._wanted = max(rows, 2 * KEPT_ROWS)
        self._queue: queue.Queue[Block | None] = queue.Queue(QUEUE_BLOCKS)
        self._held: list[Block] = []
        self._count = 0
        self._thread = threading.Thread(target=self._run, name="piece-writer", daemon=True)
        self._thread.start()

    def put(self, block: Block, deadline_s: float) -> None:
        """Hand over a block.

        Parameters
        ----------
        block : Block
            Later than the one before.
        deadline_s : float
            Longest wait for a place in the queue, s.

        Raises
        ------
        RigTimeout
            The disk did not keep up.
        UndriftError
            What kept the writer from writing.
        """
        if self.failure is not None:
            raise self.failure
        try:
            self._queue.put(block, timeout=deadline_s)
        except queue.Full as error:
            raise RigTimeout(
                f"{self.folder}: wanted room for readings within {deadline_s:g} s, got a disk that does not keep up; "
                "use a faster one",
                deadline_s=deadline_s,
            ) from error

    def stop(self, deadline_s: float) -> None:
        """Write what is left and end the thread; harmless when called again.

        Parameters
        ----------
        deadline_s : float
            Longest wait, s.

        Raises
        ------
        LinkError
            The disk hangs.
        """
        if self._thread.is_alive():
            with contextlib.suppress(queue.Full):  # told below
                self._queue.put(None, timeout=deadline_s)
            self._thread.join(deadline_s)
        if self._thread.is_alive():
            raise LinkError(
                f"{self.folder}: wanted the last readings written in {deadline_s:g} s, got no end; check the disk"
            )

    def _run(self) -> None:
        while (block := self._queue.get()) is not None:
            if self.failure is not None:
                continue  # the queue must not fill up
            self._held.append(block)
            self._count += len(block.time)
            if self._count >= self._wanted:
                self._attempt(keep=KEPT_ROWS)
        if self.failure is None:
            self._attempt(keep=0)

    def _attempt(self, keep: int) -> None:
        try:
            self._write(keep)
        except UndriftError as error:
            self.failure = error

    def _write(self, keep: int) -> None:
        if self._count < KEPT_ROWS:
            return
        time: FloatArray = np.concatenate([block.time for block in self._held])
        values: FloatArray = np.concatenate([block.values for block in self._held])
        cut = len(time) - keep
        path = piece_path(self.folder, self.connection, self.pieces + 1)
        write_synced(self._description.record(time[:cut], values[:cut]), path)
        self.pieces, self.rows = self.pieces + 1, self.rows + cut
        self._held = [Block(time[cut:], values[cut:])]
        self._count = keep
