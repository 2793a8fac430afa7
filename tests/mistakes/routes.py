"""All mistakes."""

from mistakes import bench, calls, pages, worn

WORN, BENCH, CALLS = worn.MISTAKES, bench.MISTAKES, (*calls.MISTAKES, *pages.MISTAKES)
MISTAKES = (*WORN, *BENCH, *CALLS)
