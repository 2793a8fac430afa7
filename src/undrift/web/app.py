"""Server of the bench: serve the page and its files to this computer only."""

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator, Callable
from functools import partial
from pathlib import Path
from typing import IO, Any

import uvicorn
from fastapi import FastAPI
from nicegui import app as pages_app
from nicegui import ui
from starlette.responses import FileResponse, PlainTextResponse, Response

from undrift.errors import InputError
from undrift.web import page
from undrift.web.access import Access
from undrift.web.bench import Bench, ServerSettings
from undrift.web.items import lock_folder

STATIC = Path(__file__).parent / "static"
HOST = "127.0.0.1"  # pages are served to this computer only


def serve(settings: ServerSettings, ready: Callable[[str], None]) -> None:
    """Serve the bench until Ctrl-C. ``ready`` receives the address as soon as the server listens."""
    with lock_folder(settings.folder) as lock:
        _serve(settings, ready, lock)


def _serve(settings: ServerSettings, ready: Callable[[str], None], lock: IO[str]) -> None:
    bench, listener = Bench(settings), listen(HOST, settings.port)
    address = f"http://{HOST}:{listener.getsockname()[1]}/"
    lock.write(f"{address}\n")
    lock.flush()
    address += f"?token={settings.token}" if settings.token else ""
    config = uvicorn.Config(
        Access(application(bench, partial(ready, address)), settings.token, settings.upload_mb),
        log_level="warning", access_log=False, timeout_graceful_shutdown=2, server_header=False,
        ws_max_size=1 << 20, ws_per_message_deflate=False,  # noise is not compressible, and compression takes time
    )  # fmt: skip
    try:
        uvicorn.Server(config).run(sockets=[listener])
    finally:
        bench.close()
        listener.close()


def listen(host: str, port: int) -> socket.socket:
    """Return a listening socket."""
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((host, port))
        listener.listen(128)
    except OSError as error:
        listener.close()
        raise InputError(
            f"bench: cannot listen at {host}:{port} ({error.strerror or error}). Choose another `port`, or 0 for a free port."
        ) from error
    return listener


def application(bench: Bench, ready: Callable[[], None]) -> FastAPI:
    """Return the bench as an ASGI application."""

    @contextlib.asynccontextmanager
    async def life(_: FastAPI) -> AsyncIterator[None]:
        ready()
        opening = asyncio.create_task(bench.open_newest())
        yield
        opening.cancel()
        if bench.work is not None:
            bench.work.cancelled = True

    api = FastAPI(openapi_url=None, docs_url=None, redoc_url=None, lifespan=life)

    @api.get("/files/{name:path}")
    def get_file(name: str, download: str = "") -> Response:
        try:
            path = bench.inside(name)
        except InputError as error:
            return PlainTextResponse(f"{error}\n", 404)
        answer = FileResponse(path, filename=path.name if download else None)
        if path.suffix.lower() in (".html", ".svg"):
            answer.headers["Content-Security-Policy"] = (
                "sandbox allow-same-origin allow-popups; default-src 'self' data: 'unsafe-inline'"
            )
        return answer

    pages_app.add_static_files("/static", STATIC)
    ui.page("/", title="undrift bench")(partial(page.build, bench))
    look: dict[str, Any] = {"title": "undrift bench", "dark": None, "language": "en-US", "tailwind": False}
    ui.run_with(api, reconnect_timeout=10.0, show_welcome_message=False, **look)
    return api
