"""Other packages add a rig by an entry point; nothing is imported before it is asked for."""

import subprocess
import sys

import pytest

from undrift.errors import InputError
from undrift.rig.rig import CONTROLLERS, open_rig

LATHE = """
from undrift.rig.manual import ManualRig

class Lathe(ManualRig):
    def identify(self):
        return "a lathe in " + self.place

def open_lathe(url, settings):
    rig = Lathe(lambda line: "", settings.limits)
    rig.place = url
    return rig
"""
POINTS = """
[undrift.rigs]
lathe = lathe:open_lathe
broken = lathe:not_there
galil = lathe:open_lathe
"""


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """Install a package with entry points, as far as Python can tell."""
    (tmp_path / "lathe.py").write_text(LATHE)
    information = tmp_path / "lathe-1.0.dist-info"
    information.mkdir()
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: lathe\nVersion: 1.0\n")
    (information / "entry_points.txt").write_text(POINTS)
    monkeypatch.syspath_prepend(tmp_path)
    yield
    sys.modules.pop("lathe", None)


def test_a_rig_of_another_package_is_opened_by_its_address(installed):
    assert open_rig("lathe:shed").identify() == "a lathe in shed"
    assert CONTROLLERS.keys() == {"galil", "grbl", "manual", "simulated"}


def test_an_unknown_kind_names_those_of_other_packages_too(installed):
    with pytest.raises(InputError, match=r"lathe:.*got 'press:'"):
        open_rig("press:")


def test_package_without_its_object_is_refused(installed):
    with pytest.raises(InputError, match="lathe:not_there"):
        open_rig("broken:")


def test_the_own_rows_of_a_table_cannot_be_replaced(installed):
    with pytest.raises(InputError, match="tcp://host:port"):
        open_rig("galil:shed")


def test_address_imports_no_controller():
    code = (
        "import sys; from undrift.rig.rig import parse_address; from undrift.live.transports import source_at;"
        "parse_address('galil:tcp://a:1'); source_at('serial:///dev/x?rate=1'); "
        "source_at('lsl:a?rate=1&channels=gyro_x,gyro_y,gyro_z');"
        "print(sorted({'serial', 'pylsl', 'undrift.rig.galil', 'undrift.rig.grbl'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
