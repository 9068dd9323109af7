"""Taking things home: the controller, the log of the last minute, a 3D replay."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from dashpot.studio.arms import REMEMBERED
from dashpot.studio.files import as_bytes, recording, replay_html, saved_controller, written_log
from dashpot.studio.markup import block, escaped
from dashpot.studio.panels.shared import Beside, NumberField

if TYPE_CHECKING:
    from dashpot.studio.page import Page

FORMATS = ("csv", "mcap", "parquet")


class RecordPanel:
    """See the module."""

    def __init__(self, page: Page) -> None:
        gui, self._page = page.server.gui, page
        gui.add_html(block("The last minute is always remembered, at every tick.", "4px 12px"))
        self._pause = gui.add_button_group("time", ("run", "pause", "one tick"))
        self._beside = Beside(gui, put=False)
        self._seconds = NumberField(
            gui, "length of the 3D file [s]", 10.0, lambda _: None, self._beside,
            low=1.0, high=REMEMBERED, hint="So much of the last minute",
        )  # fmt: skip
        self._replay = gui.add_button("3D replay as one HTML file", hint="Opens offline, in any browser")
        self._controller = gui.add_button("Controller as TOML")
        self._recording = gui.add_button("Recording (.npz), as dashpot simulate writes it")
        self._format = gui.add_dropdown(
            "log as",
            FORMATS,
            initial_value=FORMATS[0],
            hint="As dashpot identify reads it; csv with its --sampling",
        )
        self._log = gui.add_button("Log")
        self._beside.put()
        self._hint = gui.add_html("")
        self._pause.on_click(self._paused)
        self._replay.on_click(
            lambda event: self._send(
                event, "replay.html", lambda: replay_html(page.session, self._seconds.read()).encode()
            )
        )
        self._controller.on_click(
            lambda event: self._send(
                event, "controller.toml", lambda: saved_controller(page.session).encode()
            )
        )
        self._recording.on_click(
            lambda event: self._send(
                event, "recording.npz", lambda: as_bytes(recording(page.session).save, "recording.npz")
            )
        )
        self._log.on_click(self._logged)

    def _paused(self, event: Any) -> None:
        session, choice = self._page.session, event.target.value
        if choice == "run":
            session.start()
            return
        session.pause()
        if choice == "one tick":
            session.step(session.config.period)

    def _logged(self, event: Any) -> None:
        name = f"log.{self._format.value}"
        self._send(event, name, lambda: as_bytes(lambda path: written_log(self._page.session, path), name))

    def _send(self, event: Any, name: str, make: Any) -> None:
        with self._beside.explained():
            event.client.send_file_download(name, make(), save_immediately=True)
        words = "" if self._beside.failed else self._next(name)
        self._hint.content = block(words, "4px 12px") if words else ""

    def _next(self, name: str) -> str:
        """What to do with a file."""
        robot = escaped(self._page.robot_name)
        words = {
            "controller.toml": f"dashpot certify {robot} {name}",
            "recording.npz": f"dashpot.simulation.recording.Recording.load('{name}')",
            "replay.html": "",
        }.get(name, f"dashpot plot {name}")
        return f"{name}: <code>{words}</code>" if words else f"{name}: open it in any browser, offline too"
