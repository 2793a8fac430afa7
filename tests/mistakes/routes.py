"""All mistakes."""

from mistakes import bench, calls, pages, several, worn

WORN, BENCH, CALLS = worn.MISTAKES, bench.MISTAKES, (*calls.MISTAKES, *pages.MISTAKES)
SEVERAL = several.MISTAKES
MISTAKES = (*WORN, *BENCH, *CALLS, *SEVERAL)
