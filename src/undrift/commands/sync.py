"""``undrift sync``: recordings of several devices, and poses, on the clock of the first one, by the motion that they share."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from undrift.base.options import Files, OptionalOutput, verb
from undrift.base.summary import Result, Summary, figure_of, rows_section
from undrift.commands import Progress, part_of, reading, silent
from undrift.commands.correct import targets_of
from undrift.commands.files import Opening, Optics, name_of
from undrift.errors import AlignmentError, InputError
from undrift.findings import Finding, Verdict, finding

if TYPE_CHECKING:
    from undrift.record import Record, Reference
    from undrift.sync import SharedMotion

READ = 0.3  # of the work
LEAST_MS = 0.01  # that is shown: copies of one recording agree to the last bit
CERTAIN_S = 1e-3  # a larger expanded uncertainty is a finding
TEXT = "offset: its stamp less that of the first clock, at the middle of what both have seen; within: at most in all of that, 95 %"


@dataclass(frozen=True, kw_only=True, eq=False)
class SyncedFile:
    """A recording on the first one's clock."""

    path: Path
    # On the first one's clock, missing rows as gaps; as it was read where no clock was found
    held: "Record | Reference"
    clock: "SharedMotion | None" = None  # Against the first, or what stands in ``through``; None of the first
    through: str = ""  # Another one, on the first one's clock, with which it shares more
    uncertainty_s: float = 0.0  # Expanded (95 %), largest in what is shared
    output: Path | None = None

    @property
    def found(self) -> bool:
        """Tell whether it is on the first one's clock."""
        return self.clock is None or self.clock.shares

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What speaks against the clock."""
        if self.clock is None or (self.found and self.uncertainty_s <= CERTAIN_S):
            return ()
        numbers: dict[str, Any] = {"recording": self.path.name, "correlation": self.clock.correlation}
        if self.found:
            return (finding("sync.uncertain", "warn", **numbers, most_ms=1e3 * self.uncertainty_s),)
        return (finding("sync.not_shared", "fail", **numbers, times=self.clock.rival),)

    @property
    def row(self) -> dict[str, Any]:
        """The recording as JSON has it; no number of a clock that was not found."""
        from undrift.io.inspect import gaps_of
        from undrift.io.store import findings_json
        from undrift.record import Record

        held, clock, stated = self.held, self.clock, dict[str, Any]()
        if clock is not None:
            stated = {"correlation": clock.correlation, "next_best_leaves_times": clock.rival}
        if clock is not None and clock.shares:
            offset, skew = clock.coverage_factor * clock.covariance.diagonal() ** 0.5
            stated |= {"at_s": clock.middle_s, "offset_s": clock.offset_s, "offset_expanded_uncertainty_s": offset}
            stated |= {"skew_ppm": 1e6 * clock.skew, "skew_expanded_uncertainty_ppm": 1e6 * skew}
            stated |= {"expanded_uncertainty_s": self.uncertainty_s, "through": self.through}
        named = {"recording": str(self.path), "output": self.output and str(self.output), "synced": self.found}
        span = {"start_s": float(held.time[0]), "stop_s": float(held.time[-1]), "rows": len(held)}
        gaps = gaps_of(held) if isinstance(held, Record) else int((~held.valid).sum())
        return named | stated | span | {"gaps": gaps, "findings": findings_json(self.findings)}

    def cells(self) -> dict[str, str]:
        """Return the recording as a table has it."""
        row, first = self.row, self.clock is None
        cells = {"recording": name_of(self.path), "offset (s)": "0" if first else "unknown", "at (s)": "–"}
        cells |= {"skew (ppm)": "–", "within (ms)": "–", "corr.": "–" if first else f"{row['correlation']:.4f}"}
        if self.found and not first:
            cells["offset (s)"] = f"{row['offset_s']:.4f} +- {row['offset_expanded_uncertainty_s']:.4f}"
            cells["at (s)"] = f"{row['at_s']:.2f}"
            cells["skew (ppm)"] = f"{row['skew_ppm']:.0f} +- {row['skew_expanded_uncertainty_ppm']:.0f}"
            cells["within (ms)"] = f"{1e3 * self.uncertainty_s:.2f}"
        cells["from, to (s)"] = f"{row['start_s']:.2f}, {row['stop_s']:.2f}" if self.found else "–"
        return cells | {"rows": str(row["rows"]), "gaps": str(row["gaps"])}


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Synced(Result):
    """Recordings on one clock."""

    files: tuple[SyncedFile, ...]

    @property
    def records(self) -> "tuple[Record | Reference, ...]":
        """Those whose clock was found, on the first one's."""
        return tuple(file.held for file in self.files if file.found)

    def summary(self) -> Summary:
        """Return each clock against the first, with its uncertainty, and what is missing."""
        from undrift.io.store import verdict_json
        from undrift.sync import drawn_rates

        first, *others = self.files
        synced = [file for file in self.files if file.found]
        verdict = Verdict.of(*(item for file in others for item in file.findings))
        most_ms = max(LEAST_MS, 1e3 * max(file.uncertainty_s for file in synced))
        within = f", within {most_ms:.2g} ms (95 %)" if len(synced) > 1 else ""
        through = (f"{file.path.name}: by the motion of {file.through}" for file in synced if file.through)
        return Summary(
            title="Recordings on one clock",
            answer=f"On the clock of {first.path.name}: {len(synced) - 1} of {len(others)} others{within}.",
            data={
                "clock": str(first.path),
                "recordings": [file.row for file in self.files],
                "verdict": verdict_json(verdict),
            },
            pictures=(
                figure_of("figures:draw_synced", [(name_of(file.path), *drawn_rates(file.held)) for file in synced]),
            ),
            sections=(rows_section("Clocks", [file.cells() for file in self.files], text=(TEXT, *through)),),
            verdict=verdict,
            written=tuple(file.output for file in self.files),
            failed=verdict.status == "bad",
            next=("info", synced[-1].output) if synced[-1].output else (),
        )


@verb
def sync(
    *records: Files,
    optics: Optics = Optics(),
    output: OptionalOutput = None,
    opening: Opening = Opening(),
    progress: Progress = silent,
) -> Synced:
    """Align recordings and poses by the motion that they share: offset and skew of each clock, with uncertainty.

    Parameters
    ----------
    records : Path
        Recordings with gyroscopes of one motion; the clock of the first becomes that of all.
    optics : Optics
        Poses to align too, any number of them.
    output : Path or None
        Folder for all of them on one clock, missing rows as gaps: NAME.parquet.
    """
    from undrift.files import hidden_folder, take_names
    from undrift.io.reference import write_reference
    from undrift.io.write import write_record_as
    from undrift.record import Record
    from undrift.sync import with_gaps

    paths = (*records, *optics.reference)
    if len(paths) < 2:
        raise InputError(f"sync: wanted two recordings or more, got {len(paths)}; name those of one motion")
    targets = None if output is None else targets_of(paths, output, (opening.column_map, optics.reference_map))
    with reading(progress, READ, *paths):
        held: list[Record | Reference] = [*map(opening.read, records), *optics.read(optics.reference)]
    synced = [SyncedFile(path=path, held=one) for path, one in zip(paths, held, strict=True)]
    placed = _placed(synced, part_of(progress, READ, 1.0))
    files = [replace(file, held=with_gaps(file.held)) for file in placed]
    if output is None or targets is None:
        return Synced(files=tuple(files))
    output.mkdir(exist_ok=True)
    files = [replace(file, output=at if file.found else None) for file, at in zip(files, targets, strict=True)]
    with hidden_folder(output) as hidden:
        for file in files:
            part = None if file.output is None else hidden / file.output.name
            if part is not None and isinstance(file.held, Record):
                write_record_as(file.held, part)
            elif part is not None and not isinstance(file.held, Record):
                write_reference(file.held, part)
        take_names({output / part.name: part for part in sorted(hidden.iterdir())})
    return Synced(files=tuple(files))


def _placed(files: list[SyncedFile], progress: Progress) -> list[SyncedFile]:
    """Return the files on the clock of the first, each by its motion or that of one that is there already."""
    from undrift.sync import shared_motion

    placed, tried = {0: files[0]}, dict[int, SyncedFile]()
    queue = [(0, k) for k in range(1, len(files))]
    for j, k in queue:  # grows
        if k in placed:
            continue
        file, by = files[k], placed[j]
        progress(f"aligning {file.path.name}", len(placed) / len(files))
        try:
            clock = shared_motion(by.held, file.held)
        except AlignmentError as error:
            raise InputError(f"{file.path}: {error}", **error.numbers) from error
        uncertainty_s = (clock.uncertainty_s() ** 2 + by.uncertainty_s**2) ** 0.5
        file = replace(file, clock=clock, through=by.path.name if j else "", uncertainty_s=uncertainty_s)
        if clock.shares:
            placed[k] = replace(file, held=replace(file.held, time=clock.happened(file.held.time)))
            queue += [(k, other) for other in range(1, len(files)) if other not in placed]
        else:
            tried.setdefault(k, file)
    return [placed.get(k) or tried[k] for k in range(len(files))]
