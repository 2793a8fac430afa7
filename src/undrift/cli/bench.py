"""``undrift bench``: the guided bench in a browser."""

import secrets
import sys
from pathlib import Path

from undrift.base.options import Flag, Json
from undrift.cli.common import say, write_json
from undrift.errors import InputError


def bench(
    *,
    folder: Path | None = None,
    port: int = 8765,
    token: str = "",
    upload_mb: float = 500.0,
    practice_seed: int | None = None,
    practice_speed: float = 1.0,
    no_browser: Flag = False,
    json: Json = False,
) -> int:
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
        Largest file that is accepted, MB.
    practice_seed : int or None
        Seed of the practice device. The same seed gives the same device.
    practice_speed : float
        Speed of the practice device, times real time.
    no_browser : bool
        Do not open a browser.
    """
    try:
        from undrift.web.app import serve
    except ImportError as error:
        raise InputError(
            f"bench: the package nicegui is missing ({error.name}). Run pip install 'undrift[bench]'."
        ) from error
    from undrift.files import data_folder
    from undrift.web.bench import ServerSettings

    if token not in ("", "none") and len(token) < 16:
        raise InputError(
            f"--token: expected 16 characters or more, got {len(token)}. Omit --token to create a new token."
        )
    if not 0 <= port <= 65535:
        raise InputError(f"--port: expected 0 to 65535, got {port}. Use 0 for a free port.")
    if not upload_mb > 0.0:
        raise InputError(
            f"--upload-mb: expected more than 0, got {upload_mb:g}. Enter the size of the largest file in MB."
        )
    settings = ServerSettings(
        folder=(folder or data_folder() / "bench").absolute(),
        port=port,
        token=None if token == "none" else token or secrets.token_urlsafe(24),
        upload_mb=upload_mb,
        practice_seed=practice_seed,
        practice_speed=practice_speed,
    )

    def ready(address: str) -> None:
        if json:
            write_json({"address": address, "folder": str(settings.folder)}, "bench")
        else:
            say(f"undrift bench: {address}", f"It writes to {settings.folder}. Ctrl-C ends it.")
        sys.stdout.flush()
        if not no_browser:
            import webbrowser

            webbrowser.open(address)

    serve(settings, ready)
    return 0
