"""Access control of the bench. A request needs the token that the command prints, also on this computer, which may have
other users.

The token is in the cookie that ``/?token=...`` sets for the bench's port, or in the query. Without a token, requests
must name a loopback host, so that another site cannot reach the bench with its own host name (DNS rebinding). Requests
that change something, and websockets, must come from a page of the bench. Their Origin must equal the Host. Requests that
send more than the largest upload are refused before their content is read.
"""

import hmac
import re
from collections.abc import Mapping
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs, urlsplit

from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse, RedirectResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

COOKIE = "undrift_token"
LOOPBACK = ("localhost", "127.0.0.1", "::1")
SAFE = ("GET", "HEAD", "OPTIONS")
FORM_BYTES = 65_536  # allowance for the names and lines around uploaded files
HEADERS = {  # headers of every answer: load nothing from other sites, and forbid other sites to embed the page
    "Content-Security-Policy": "default-src 'self' data: blob:; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src 'self' "
    "'unsafe-inline'; connect-src 'self' ws://OWN wss://OWN; frame-ancestors 'self'; form-action 'self'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
}


class Access:
    """ASGI application around the bench that accepts requests, or refuses them with status 403 or 413 and one line."""

    def __init__(self, app: ASGIApp, token: str | None, upload_mb: float) -> None:
        self._app, self._token, self._upload_mb = app, token, upload_mb

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, or pass it on."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        refusal = refused(scope, self._token)
        if refusal and scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008, "reason": refusal[:120]})
            return
        if refusal:
            await PlainTextResponse(refusal + "\n", 403)(scope, receive, send)
            return
        if too_long := too_large(scope, self._upload_mb):
            await PlainTextResponse(too_long + "\n", 413, {"Connection": "close"})(scope, receive, send)
            return
        query = parse_qs(scope.get("query_string", b"").decode("latin-1"))
        if self._token is not None and scope["type"] == "http" and scope["method"] == "GET" and "token" in query:
            response = RedirectResponse(scope["path"] or "/", 303)  # the token does not stay in the address
            response.set_cookie(_cookie_of(Headers(scope=scope)), self._token, httponly=True, samesite="strict")
            await response(scope, receive, send)
            return

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                names = {name.decode("latin-1").lower() for name, _ in message.get("headers", ())}
                new = {k.lower(): _for_host(v, scope) for k, v in HEADERS.items() if k.lower() not in names}
                added = [(k.encode(), v.encode()) for k, v in new.items()]
                message = {**message, "headers": [*message.get("headers", ()), *added]}
            await send(message)

        await self._app(scope, receive, with_headers)


def refused(scope: Scope, token: str | None) -> str:
    """Return the reason to refuse a request, or "" if it is allowed."""
    headers = Headers(scope=scope)
    host = headers.get("host", "")
    if token is None and _name(host) not in LOOPBACK:
        return "bench: this request names another computer. Open the address that undrift bench printed."
    origin = headers.get("origin")
    changes = scope["type"] == "websocket" or scope["method"] not in SAFE
    if changes and origin is not None and urlsplit(origin).netloc != host:
        return "bench: this request comes from another site. Open the bench itself."
    if token is not None and not hmac.compare_digest(_given_token(scope, headers).encode(), token.encode()):
        return "bench: the token is missing or wrong. Open the address that undrift bench printed."
    return ""


def too_large(scope: Scope, upload_mb: float) -> str:
    """Return the reason to reject the content of a request (too large, or unknown length), or "" if it is accepted."""
    headers = Headers(scope=scope)
    length = headers.get("content-length", "0")
    whole = "transfer-encoding" not in headers and length.isascii() and length.isdigit()
    if whole and int(length) <= upload_mb * 1e6 + FORM_BYTES:
        return ""
    return (
        f"upload: files that are sent together may have {upload_mb:g} MB in total. Send fewer, or restart the bench with a "
        "larger --upload-mb."
    )


def _name(host: str) -> str:
    try:
        return urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""


def _for_host(policy: str, scope: Scope) -> str:
    match = re.fullmatch(r"(([\w.-]+|\[[\w:.]+\])(:\d{1,5})?)", Headers(scope=scope).get("host", ""))
    return policy.replace("OWN", match[1] if match else "127.0.0.1")


def _cookie_of(headers: Mapping[str, str]) -> str:
    """Return the name of the cookie. It contains the port, because a browser sends all cookies of a host to every port."""
    return f"{COOKIE}_{match[1]}" if (match := re.search(r":(\d{1,5})$", headers.get("host", ""))) else COOKIE


def _given_token(scope: Scope, headers: Mapping[str, str]) -> str:
    query = parse_qs(scope.get("query_string", b"").decode("latin-1"))
    if "token" in query:
        return str(query["token"][0])
    try:
        cookie = SimpleCookie(headers.get("cookie", "")).get(_cookie_of(headers))
    except CookieError:
        cookie = None
    return str(cookie.value) if cookie is not None else ""
