"""The page: viser's server, the panels, and the thread that keeps what is shown up to date."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import viser

from dashpot.arm.payload import Payload
from dashpot.control.controller import ControllerConfig
from dashpot.errors import DashpotError
from dashpot.studio import markup
from dashpot.studio.charts import Charts
from dashpot.studio.panels.arm import ArmPanel
from dashpot.studio.panels.controller import ControllerPanel
from dashpot.studio.panels.faults import FaultPanel
from dashpot.studio.panels.guide import GuidePanel
from dashpot.studio.panels.record import RecordPanel
from dashpot.studio.scene3d import ArmScene, ForceArrow, look_at, stage
from dashpot.studio.server import close_server, open_server
from dashpot.studio.session import Session
from dashpot.studio.style import STYLE

POSES, TEXT, CHARTS, FIELDS = 1 / 25, 1 / 5, 1 / 5, 1 / 2  # [s] between two updates
SMALLEST_PULL = 0.02  # [m] that a hand has to move before a pull is meant


class Page:
    """The studio in a browser.

    Attributes:
        server: viser's.
        session: What it shows.
        robot_name, controller_name: As they were given.
        visitors: Pages that are open.
        wakes: Whether time begins when somebody opens a page.
    """

    def __init__(
        self, session: Session, robot: str, controller: str, *, host: str = "127.0.0.1", port: int = 8080
    ) -> None:
        """Opens the server; nothing runs until somebody looks.

        Raises:
            DashpotError: The address cannot be used.
        """
        self.session, self.robot_name, self.controller_name = session, robot, controller
        self.server = open_server(host, port)
        self._closed = threading.Event()
        self._hand: int | None = None
        self._drawn = -1
        self._stale = threading.Event()
        gui = self.server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, brand_color=(0, 114, 178))
        gui.set_panel_label("dashpot studio")
        stage(self.server)
        self.arm, self.ghost = ArmScene(self.server, "/arm"), ArmScene(self.server, "/rival", ghost=True)
        self.arm.on_drag(self._dragged)
        self.arrow = ForceArrow(self.server)
        self.view = gui.add_panel()
        with self.view.add_tab("Now"):
            gui.add_html(STYLE)
            self.status = gui.add_html("")
            self.charts = Charts(self.server)
        self.view.dock_left()
        self.view.set_width(370)
        tabs = gui.add_tab_group()
        with tabs.add_tab("Guide"):
            self.guide = GuidePanel(self)
        with tabs.add_tab("Arm"):
            self.arm_panel = ArmPanel(self)
        with tabs.add_tab("Controller"):
            self.controller = ControllerPanel(self)
        with tabs.add_tab("Faults"):
            self.faults = FaultPanel(self)
        with tabs.add_tab("Record"):
            self.record = RecordPanel(self)
        gui.main_panel.dock_right()
        gui.main_panel.set_width(370)
        self.visitors, self.wakes, self._asleep = 0, True, True
        self.server.on_client_connect(self._came)
        self.server.on_client_disconnect(self._left)
        self._watch()
        self._thread = threading.Thread(target=self._run, name="dashpot page", daemon=True)
        self._thread.start()

    @property
    def url(self) -> str:
        """Where it is."""
        host = self.server.get_host()
        return f"http://{f'[{host}]' if ':' in host else host}:{self.server.get_port()}"

    def close(self) -> None:
        """Ends the server; the session goes on."""
        self._closed.set()
        self.controller.design.designer.end()
        self._thread.join(5)
        close_server(self.server)

    def load(self, robot: str, controller: str | ControllerConfig, payload: Payload | None = None) -> None:
        """Takes another arm.

        Raises:
            DashpotError: It cannot be used; everything stays as it was.
        """
        self.begin(lambda session: session.load(robot, controller, payload), robot, str(controller))

    def begin(self, what: Callable[[Session], None], robot: str, controller: str) -> None:
        """Has the session begin something, and runs on."""
        what(self.session)
        self.robot_name, self.controller_name = robot, controller
        self.guide.forget()
        self.arm_panel.name()
        self._watch()
        if self.visitors and self.wakes:
            self.session.start()

    def restart(self) -> None:
        """The same arm again, at home."""
        self.begin(lambda session: session.restart(), self.robot_name, self.controller_name)

    def redraw(self) -> None:
        """Has fields and titles shown anew soon."""
        self._stale.set()

    # Visitors.

    def _came(self, client: viser.ClientHandle) -> None:
        self.visitors += 1
        if self._asleep and self.wakes:
            self._asleep = False
            self.session.start()

    def _left(self, client: viser.ClientHandle) -> None:
        self.visitors = max(0, self.visitors - 1)
        if self._hand == client.client_id:
            self._hand = None
            self.session.let_go()
        if self.visitors == 0:  # nobody looks: time stands still
            self.session.let_go()
            self._asleep |= self.session.running
            self.session.pause()

    def _dragged(self, body: int, event: Any) -> None:
        if event.phase == "start":
            if self._hand is None:
                self._hand = event.client_id
                self.session.grasp(body, np.array(event.start_position))
        elif self._hand == event.client_id:
            if event.phase == "update":
                self.session.pull(np.array(event.end_position))
            else:
                self._hand = None
                self.session.let_go()

    # What is shown.

    def _watch(self) -> None:
        certifier = self.session.certifier
        if certifier is not None:
            certifier.changed = self.redraw
        look_at(self.server, self.session.arm.model)
        self.redraw()

    def _run(self) -> None:
        due = dict.fromkeys(("poses", "text", "charts", "fields"), 0.0)
        while not self._closed.is_set():
            now = time.perf_counter()
            if self.session.generation != self._drawn:
                self._drawn = self.session.generation
                self.arm.draw(self.session.arm.model)
                if self.session.rival is not None:
                    self.ghost.draw(self.session.rival.model)
                else:
                    self.ghost.clear()
                self._stale.set()
            if self._stale.is_set():
                self._stale.clear()
                due["fields"] = 0.0
            if now >= due["poses"]:
                due["poses"] = now + POSES
                self._show_poses()
            if now >= due["text"]:
                due["text"] = now + TEXT
                self._show_text()
            if now >= due["charts"] and (self.visitors or due["charts"] == 0.0):
                due["charts"] = now + CHARTS
                self.charts.draw(self.session)
            if now >= due["fields"]:
                due["fields"] = now + FIELDS
                self._show_fields()
            self._closed.wait(max(0.002, min(due.values()) - time.perf_counter()))

    def _show_poses(self) -> None:
        bodies = self.session.bodies()
        with self.server.atomic():
            self.arm.move(*bodies[0])
            if len(bodies) > 1:
                self.ghost.move(*bodies[1])
            self.arrow.show(self.session.snapshot().push)

    def _show_text(self) -> None:
        now = self.session.snapshot()
        runs = f"{self.robot_name} under {self.controller_name}"
        content = markup.status(now, self.session.supervised, runs)
        if self.status.content != content:
            self.status.content = content
        self.faults.tell()

    def _show_fields(self) -> None:
        with suppress(DashpotError):  # what was loaded meanwhile is shown next time
            self.charts.label(self.session)
            self.guide.refresh()
            self.arm_panel.refresh()
            self.controller.refresh()
            self.faults.refresh()


def open_page(
    robot: str | Path,
    controller: str | Path,
    payload: Payload | None,
    *,
    host: str,
    port: int,
    supervise: bool,
    seed: int,
) -> Page:
    """A session and its page.

    Raises:
        DashpotError: Arm, controller or address cannot be used.
    """
    session = Session(robot, controller, payload=payload, supervise=supervise, seed=seed)
    try:
        return Page(session, str(robot), str(controller), host=host, port=port)
    except BaseException:
        session.close()
        raise
