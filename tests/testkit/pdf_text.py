"""Text of a PDF as typst and chromium write it: compressed streams, glyphs of two bytes, and the letters that each font states."""

import re
import zlib
from pathlib import Path

_OBJECT = re.compile(rb"(\d+) 0 obj\n?(.*?)(?:stream\r?\n(.*?)\r?\nendstream\s*)?endobj", re.S)
_SHOWN = re.compile(rb"/(\w+) [\d.]+ Tf|(\((?:\\.|[^()\\])*\)|<[0-9A-F]+>(?= Tj))|\bET\b", re.S)
_ESCAPES = {b"n": b"\n", b"r": b"\r", b"t": b"\t", b"b": b"\b", b"f": b"\f"}


def pages_of(path: Path) -> int:
    """Return how many pages a PDF has."""
    return sum(len(re.findall(rb"/Type\s*/Page\b", body)) for body, _ in _objects(path).values())


def text_of(path: Path) -> str:
    """Return the text of a PDF in the order in which it is set, a blank where it goes on elsewhere."""
    objects = _objects(path)
    letters = {number: _letters(stream) for number, (_, stream) in objects.items() if b"begincmap" in stream}
    fonts = dict[bytes, dict[bytes, str]]()
    for name, number in re.findall(rb"/(\w+) (\d+) 0 R", b" ".join(body for body, _ in objects.values())):
        if (found := re.search(rb"/ToUnicode (\d+) 0 R", objects.get(int(number), (b"", b""))[0])) is not None:
            fonts[name] = letters[int(found[1])]
    text = ""
    for _, stream in objects.values():
        font = dict[bytes, str]()
        if b"begincmap" in stream or b" Tf" not in stream:
            continue
        for name, string in _SHOWN.findall(stream):
            if name:
                font = fonts[name]
            if string.startswith(b"<"):
                glyphs = bytes.fromhex(string[1:-1].decode())
            else:
                glyphs = re.sub(rb"\\([0-7]{1,3}|.)", _escaped, string[1:-1], flags=re.S)
            shown = "".join(font.get(glyphs[k : k + 2], "") for k in range(0, len(glyphs), 2))
            text += shown if string else " "
    return " ".join(text.split())


def _escaped(found: re.Match[bytes]) -> bytes:
    return bytes([int(found[1], 8)]) if found[1].isdigit() else _ESCAPES.get(found[1], found[1])


def _objects(path: Path) -> dict[int, tuple[bytes, bytes]]:
    """Return dictionary and stream of each object, those in streams of objects too."""
    made = dict[int, tuple[bytes, bytes]]()
    for number, body, stream in _OBJECT.findall(path.read_bytes()):
        # a checksum may end with the byte of a line's end, which counts as none of the stream
        data = zlib.decompressobj().decompress(stream) if b"/FlateDecode" in body else stream
        made[int(number)] = body, data
        if b"/ObjStm" in body:
            first = int(re.search(rb"/First (\d+)", body)[1])  # type: ignore[index]
            marks = [int(word) for word in data[:first].split()]
            ends = [*marks[3::2], len(data) - first]
            for key, start, stop in zip(marks[::2], marks[1::2], ends, strict=True):
                made[key] = data[first + start : first + stop], b""
    return made


def _letters(stream: bytes) -> dict[bytes, str]:
    """Return the letters of each glyph of a font."""
    made = dict[bytes, str]()
    for block in re.findall(rb"beginbfchar(.*?)endbfchar", stream, re.S):
        for glyph, letters in re.findall(rb"<([0-9a-fA-F]+)>\s*<([0-9a-fA-F]+)>", block):
            made[bytes.fromhex(glyph.decode())] = bytes.fromhex(letters.decode()).decode("utf-16-be")
    for block in re.findall(rb"beginbfrange(.*?)endbfrange", stream, re.S):
        for low, high, to in re.findall(rb"<(\w+)>\s*<(\w+)>\s*<(\w+)>", block):
            for k in range(int(low, 16), int(high, 16) + 1):
                made[k.to_bytes(2, "big")] = chr(int(to, 16) + k - int(low, 16))
    return made
