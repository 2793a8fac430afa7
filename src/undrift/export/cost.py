"""What a build costs on a small controller, estimated: bytes of flash, and cycles of one sample.

Tables are counted byte by byte. Instructions are estimates for a Cortex-M4F at -O2 with tables in flash without wait states:
float uses its floating-point unit, double is done in software, fixed point uses the 32 by 32 bit multiplier. A sample costs the
sum of its steps, each step being so many loads, products, comparisons and so on, counted by hand from the generated source.
"""

from dataclasses import dataclass
from typing import Literal

from undrift.export.firmware import Axis, Triad

Arithmetic = Literal["float", "double", "fixed"]
ASSUMPTION = "Cortex-M4F, -O2, no wait states, double in software"


@dataclass(frozen=True, slots=True, kw_only=True)
class Steps:
    """Cycles and bytes of one step of the correction in one arithmetic.

    Parameters
    ----------
    call : int
        Entering, copying in and out.
    place : int
        A cell and a position on an even grid.
    stride : int
        One comparison of a bisection.
    between : int
        A value between two nodes.
    both : int
        A value between four nodes, without its place on the rate axis.
    row : int
        Three products of a matrix with a vector, summed.
    less : int
        Half a step and offset of one axis.
    lead : int
        One call of the function that takes the thermometer's lag off, with a step of time of at most half the smoothing.
    code_base, code_triad, code_table, code_warm_up, code_lead : int
        Bytes of code: once, for each triad, for each table over temperature; for the warm-up with its second entry; for the lead.
    """

    call: int
    place: int
    stride: int
    between: int
    both: int
    row: int
    less: int
    lead: int
    code_base: int
    code_triad: int
    code_table: int
    code_warm_up: int
    code_lead: int


FLOAT = Steps(
    call=40, place=24, stride=9, between=12, both=36, row=17, less=8, lead=320,
    code_base=300, code_triad=140, code_table=120, code_warm_up=200, code_lead=260,
)  # fmt: skip
DOUBLE = Steps(
    call=55, place=290, stride=40, between=190, both=560, row=330, less=90, lead=4900,
    code_base=520, code_triad=260, code_table=260, code_warm_up=400, code_lead=520,
)  # fmt: skip
FIXED = Steps(
    call=40, place=20, stride=8, between=24, both=52, row=44, less=16, lead=1700,
    code_base=430, code_triad=170, code_table=150, code_warm_up=250, code_lead=460,
)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Cost:
    """What one build costs.

    Parameters
    ----------
    arithmetic : str
        float, double or fixed.
    table_bytes : int
        Constants, exact.
    code_bytes : int
        Instructions, estimated.
    cycles : int
        One call of the correction, with the warm-up where there is one, estimated.
    lead_cycles : int
        One call that takes the thermometer's lag off, estimated; 0 where there is none.
    """

    arithmetic: Arithmetic
    table_bytes: int
    code_bytes: int
    cycles: int
    lead_cycles: int = 0

    @property
    def flash_bytes(self) -> int:
        """Constants and instructions."""
        return self.table_bytes + self.code_bytes


def cost_of(triads: tuple[Triad, ...], arithmetic: Arithmetic, table_bytes: int, *, lead: bool = False) -> Cost:
    """Return what a build costs.

    Parameters
    ----------
    triads : tuple of Triad
        Those with a model.
    arithmetic : str
        float, double or fixed.
    table_bytes : int
        Bytes of its constants.
    lead : bool
        Whether it takes a thermometer's lag off.

    Returns
    -------
    Cost
        Flash and cycles.
    """
    steps = FLOAT if arithmetic == "float" else DOUBLE if arithmetic == "double" else FIXED
    cycles, code = steps.call, steps.code_base
    for triad in triads:
        code += steps.code_triad + steps.code_table * len(triad.tables)
        cycles += 3 * (steps.less + steps.row)
        if triad.g_sensitivity is not None:
            cycles += 3 * (steps.row + 2)
        for table in triad.tables:
            cycles += _place(table.temp, steps)
            if table.turn_rate is None:
                cycles += table.values.shape[-1] * steps.between
            else:
                cycles += 3 * (_place(table.turn_rate, steps) + steps.both)
        if triad.warm_up_table is not None:
            code += steps.code_warm_up
            cycles += _place(triad.warm_up_table.temp, steps) + 3 * (steps.between + steps.less)
    return Cost(
        arithmetic=arithmetic,
        table_bytes=table_bytes,
        code_bytes=code + steps.code_lead * lead,
        cycles=cycles,
        lead_cycles=steps.lead * lead,
    )


def _place(axis: Axis, steps: Steps) -> int:
    return steps.place if axis.even else steps.place + axis.stride.bit_length() * steps.stride
