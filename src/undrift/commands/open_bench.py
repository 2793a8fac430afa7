"""``undrift bench``: open the guided page in a browser."""

import secrets
import sys
import webbrowser
from contextlib import suppress
from pathlib import Path

from undrift.base.options import Flag
from undrift.errors import InputError
from undrift.files import data_folder
from undrift.report import Report

LEAST_TOKEN = 16  # characters


def bench(
    *,
    folder: Path | None = None,
    port: int = 8765,
    token: str = "",
    upload_mb: float = 500.0,
    no_browser: Flag = False,
) -> Report:
    """Calibrate a device step by step in a browser: six faces, turns by hand, recordings. Then correct and orient.

    Parameters
    ----------
    folder : Path or None
        Folder for everything that the bench writes. Default: undrift/bench in the user's data folder.
    port : int
        Port on this computer. 0 selects a free port.
    token : str
        Access token, at least 16 characters. Default: generated and included in the printed address. "none" disables it.
    upload_mb : float
        Largest total size of files that are sent together, MB.
    no_browser : bool
        Do not open a browser.
    """
    try:
        from undrift.web import app
        from undrift.web.bench import ServerSettings
    except ImportError as error:
        raise InputError(
            f"bench: the package nicegui is missing ({error.name}). Run pip install 'undrift[bench]'."
        ) from error
    if token not in ("", "none") and len(token) < LEAST_TOKEN:
        raise InputError(
            f"--token: expected {LEAST_TOKEN} characters or more, got {len(token)}. Omit --token to create a new token."
        )
    if not 0 <= port <= 65535:
        raise InputError(f"--port: expected 0 to 65535, got {port}. Use 0 for a free port.")
    if not upload_mb > 0.0:
        raise InputError(
            f"--upload-mb: expected more than 0, got {upload_mb:g}. Enter the largest total size of files that are sent together."
        )
    place = (folder or data_folder() / "bench").absolute()
    secret = None if token == "none" else token or secrets.token_urlsafe(24)

    def ready(address: str) -> None:
        sys.stdout.write(f"undrift bench: {address} (files in {place}, Ctrl-C ends it)\n")
        sys.stdout.flush()
        if not no_browser:
            webbrowser.open(address)

    with suppress(KeyboardInterrupt):
        app.serve(ServerSettings(folder=place, port=port, token=secret, upload_mb=upload_mb), ready)
    return Report(title="Bench", answer="The bench has ended.", data={"folder": str(place)})
