"""The part of ``undrift bench`` without pages: the connected device, and the data captured from it.

The input is the address of a device, with live readings. The output is recordings, and the session of captured faces
and turns. The pages (web/) show this state. NiceGUI is not imported here.

    source.py       the connected device: readings, recording to a file, automatic reconnection
    capture.py      the readings of a guided session: rests, the face that is up, the session's folder
    guides.py       instructions, step by step: six faces, then whole turns about each axis

Frames: readings are in the device's axes. Faces and directions of turns refer to these axes (``+z`` is up, ``+x`` is a
turn about x, counter-clockwise seen with x up). Units: readings keep the device's units. Temperatures are in degC and
times in s. Readings use the device's clock. Silence and progress use the host's clock.

Open ``source.py`` first, then ``capture.py``. web/guided.py shows how to use them.
"""
