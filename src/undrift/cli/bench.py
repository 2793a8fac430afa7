"""``undrift bench``: the guided bench in a browser."""

import secrets
import socket
import sys
from contextlib import suppress
from importlib import import_module
from io import StringIO
from pathlib import Path
from urllib.parse import urlsplit

from undrift.base.options import Flag, Json
from undrift.cli.common import say, write_json
from undrift.errors import InputError


def bench(
    *,
    folder: Path | None = None,
    host: str = "127.0.0.1",
    port: int = 8765,
    network: Flag = False,
    token: str = "",
    registry: str | None = None,
    upload_mb: float = 500.0,
    quota_gb: float = 20.0,
    practice_seed: int | None = None,
    practice_speed: float = 1.0,
    no_browser: Flag = False,
    json: Json = False,
) -> int:
    """Calibrate a device step by step in a browser: six faces, turns, rate table, temperature, live readings.

    Parameters
    ----------
    folder : Path or None
        Where the bench writes; undrift/bench in the user's data folder where not given.
    host : str
        Address to listen at; this computer alone by default.
    port : int
        0 takes a free one.
    network : bool
        Allow an address that other computers reach.
    token : str
        What every browser must know, 16 characters or more; a fresh one is in the address that is printed and opened where not
        given. none, on a computer without other users, asks for none.
    registry : str or None
        File or URL of the registry; the user's own where not given.
    upload_mb : float
        Largest file that is taken, MB.
    quota_gb : float
        Largest folder that the bench fills, GB; what is larger is refused.
    practice_seed : int or None
        Draws the same practice device each time.
    practice_speed : float
        How much faster than real time the practice device is, for a quick look.
    no_browser : bool
        Do not open a browser.
    """
    try:
        from undrift.web.app import serve
    except ImportError as error:
        raise InputError(f"bench: wanted nicegui, got none ({error.name}); pip install undrift[bench]") from error
    from undrift.files import data_folder
    from undrift.web.bench import ServerSettings

    _check_access(host, network, token)
    if not 0 <= port <= 65535:
        raise InputError(f"--port: wanted 0 to 65535, got {port}; 0 takes a free one")
    for name, value, what in (("upload-mb", upload_mb, "file in MB"), ("quota-gb", quota_gb, "folder in GB")):
        if not value > 0.0:
            raise InputError(f"--{name}: wanted more than 0, got {value:g}; state the largest {what}")
    held = folder or data_folder() / "bench"
    settings = ServerSettings(
        folder=held.absolute(),
        host=host,
        port=port,
        token=None if token == "none" else token or secrets.token_urlsafe(24),
        registry=registry if registry is None or "://" in registry else str(Path(registry).absolute()),
        upload_mb=upload_mb,
        quota_gb=quota_gb,
        practice_seed=practice_seed,
        practice_speed=practice_speed,
    )

    def ready(address: str) -> None:
        if json:
            write_json({"address": address, "folder": str(settings.folder)}, "bench")
        else:
            opened = addresses_of(address) if network else [address]
            say(*(f"undrift bench: {one}" for one in opened), f"It writes to {settings.folder}. Ctrl-C ends it.")
            if network and (code := code_of(opened[0])):
                say(code)
        sys.stdout.flush()
        if not no_browser:
            import webbrowser

            webbrowser.open(address)

    serve(settings, ready)
    return 0


def _check_access(host: str, network: bool, token: str) -> None:
    """Refuse what would let other computers in by mistake."""
    from undrift.web.access import LOOPBACK

    if host not in LOOPBACK and not network:
        raise InputError(
            f"--host: wanted this computer (127.0.0.1), got {host}; add --network to let others in by a token"
        )
    if token and (network or token != "none") and len(token) < 16:
        raise InputError(f"--token: wanted 16 characters or more, got {len(token)}; leave it out for a fresh one")


def addresses_of(address: str) -> list[str]:
    """Return addresses that other computers can open, where the bench listens at every one of this computer."""
    host = urlsplit(address).hostname or ""
    if host not in ("0.0.0.0", "::"):
        return [address]
    family, outside = (socket.AF_INET6, "2001:db8::1") if host == "::" else (socket.AF_INET, "192.0.2.1")
    known = {str(one[4][0]).partition("%")[0]: None for one in socket.getaddrinfo(socket.gethostname(), None, family)}
    with suppress(OSError), socket.socket(family, socket.SOCK_DGRAM) as way:
        way.connect((outside, 9))  # nothing is sent: the system says which address it would take
        known = {str(way.getsockname()[0]): None, **known}
    others = [f"[{one}]" if ":" in one else one for one in known if not one.startswith(("127.", "::1", "fe80"))]
    return [address.replace(f"[{host}]" if ":" in host else host, one) for one in others] or [address]


def code_of(address: str) -> str:
    """Return an address as a QR code of blocks; "" where the package that draws it is not there."""
    try:
        segno = import_module("segno")
    except ImportError:
        return ""
    text = StringIO()
    segno.make(address, error="l").terminal(text, compact=True, border=2)
    return text.getvalue()
