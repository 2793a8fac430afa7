"""The part of a page that connects a device: by address, or the practice device."""

from nicegui import ui

from undrift.web.bench import PRACTICE, Bench
from undrift.web.frame import REFRESH_S, Field, button, error_line, set_text, text

EXAMPLES = "serial:///dev/ttyUSB0?baud=115200&..., tcp://host:port?..., udp://:port, lsl:name, ble:id"


def connect_form(bench: Bench) -> None:
    """Add the form, and say what is connected."""
    with ui.element("section").props('aria-label="Device"'):
        text("h2", "Device")
        state = text("p", "")
        with ui.element("div").classes("row"):
            address = Field("Address of the device", hint=EXAMPLES)
            button("Connect", lambda: bench.connect(address.value))
            button("Use the practice device", lambda: bench.connect(PRACTICE))
            button("Disconnect", bench.disconnect)
        error_line(lambda: bench.source_error)

    def refresh() -> None:
        if bench.connecting:
            words = f"Connecting {bench.connecting} ..."
        elif bench.source is None:
            words = "None. Connect yours, or try the practice device: a simulated sensor that you turn on the page."
        else:
            words = f"Connected: {bench.source.name}"
        set_text(state, words)

    refresh()
    ui.timer(REFRESH_S, refresh)
