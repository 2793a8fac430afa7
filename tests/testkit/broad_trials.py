"""The eight BROAD trials, read once, and known facts about them.

D. Laidig, M. Caruso, A. Cereatti, T. Seel, "BROAD - A benchmark for robust inertial orientation estimation", Data 2021, CC BY 4.0.
"""

from functools import cache

from benchmarks.broad_files import read_broad

from testkit.data import data_path
from undrift.record import Record, Reference

FILES = {
    2: "02_undisturbed_slow_rotation_B",
    3: "03_undisturbed_slow_rotation_C",
    5: "05_undisturbed_slow_rotation_with_breaks_B",
    7: "07_undisturbed_fast_rotation_B",
    9: "09_undisturbed_fast_rotation_with_breaks_B",
    24: "24_disturbed_tapping_A",
    32: "32_disturbed_attached_magnet_1cm",
    35: "35_disturbed_attached_magnet_4cm",
}
DEVICES = {"B": (2, 5, 7, 9), "C": (3, 24), "D": (32, 35)}  # by their offsets, because the data set has no device id


def of_device(device: str) -> tuple[tuple[tuple[Record, Reference], ...], tuple[str, ...]]:
    return tuple(trial(number) for number in DEVICES[device]), tuple(FILES[number] for number in DEVICES[device])


@cache
def trial(number: int) -> tuple[Record, Reference]:
    return read_broad(data_path("broad", f"{FILES[number]}.hdf5"))
