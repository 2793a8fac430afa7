"""Connections on which nothing is asked are closed; those that ask, and sockets of pages, stay."""

import asyncio

import uvicorn

from undrift.web import app

SHORT_S = 0.2


async def answer(scope, receive, send):
    """Answer a request, or echo what a WebSocket says."""
    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.accept"})
        await send({"type": "websocket.send", "text": (await receive())["text"]})
    elif scope["type"] == "http":
        await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", b"2")]})
        await send({"type": "http.response.body", "body": b"ok"})


async def tried(port):
    """Return how many of 40 silent connections are closed, and whether one that asked and a socket still answer."""
    silent = [await asyncio.open_connection("127.0.0.1", port) for _ in range(40)]
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(b"GET / HTTP/1.1\r\nHost: x\r\n\r\n")
    await reader.readuntil(b"ok")
    socket_reader, socket_writer = await asyncio.open_connection("127.0.0.1", port)
    key = b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
    socket_writer.write(b"GET / HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n" + key)
    await socket_reader.readuntil(b"\r\n\r\n")
    ends = await asyncio.gather(*(asyncio.wait_for(end.read(), 10.0) for end, _ in silent))
    await asyncio.sleep(SHORT_S)
    writer.write(b"GET / HTTP/1.1\r\nHost: x\r\n\r\n")
    again = (await reader.readuntil(b"ok")).endswith(b"ok")
    socket_writer.write(bytes([0x81, 0x82, 0, 0, 0, 0]) + b"hi")  # a frame of text with a mask of zeros
    echo = await socket_reader.readexactly(4)
    for _, each in (*silent, (reader, writer), (socket_reader, socket_writer)):
        each.close()
    return ends.count(b""), again, echo[2:]


def test_a_connection_that_asks_for_nothing_is_closed(monkeypatch):
    monkeypatch.setattr(app, "FIRST_S", SHORT_S)
    listener = app.listen("127.0.0.1", 0)
    server = uvicorn.Server(uvicorn.Config(answer, log_level="error", lifespan="off", http=app.Prompt))

    async def served():
        serving = asyncio.create_task(server.serve(sockets=[listener]))
        try:
            return await tried(listener.getsockname()[1])
        finally:
            server.should_exit = True
            await serving

    try:
        assert asyncio.run(served()) == (40, True, b"hi")
    finally:
        listener.close()
