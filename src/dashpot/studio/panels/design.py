"""Gains from the designer, for the chosen joint or for all."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from dashpot.design.design import Design
from dashpot.errors import DashpotError
from dashpot.robot import Robot
from dashpot.studio.designer import PRESETS, Designer, specification, taken_over
from dashpot.studio.markup import block
from dashpot.studio.panels.shared import Beside

if TYPE_CHECKING:
    from dashpot.studio.page import Page

BEGIN, END = "Design", "End the search"


class DesignFolder:
    """See the module.

    Attributes:
        designer: Runs it.
    """

    def __init__(self, page: Page, chosen: Callable[[], tuple[str, ...]]) -> None:
        """Adds the folder; `chosen` says which joints are meant."""
        gui, self._page, self._chosen, self.designer = page.server.gui, page, chosen, Designer()
        with gui.add_folder("Design", expand_by_default=False):
            self._preset: Any = gui.add_dropdown(
                "wishes", PRESETS, initial_value=PRESETS[0], hint="As in dashpot design, with this payload"
            )
            self._limits: dict[str, Any] = {
                name: gui.add_number(label, initial_value=0.0, min=0.0, step=0.05, hint="0: as wished for")
                for name, label in (("error_ratio", "error ratio [-]"), ("stop_time", "stop time [s]"))
            }
            self._button = gui.add_button(BEGIN)
            self._said = gui.add_html("")
            self._beside = Beside(gui)
        self._button.on_click(lambda _: self._pressed())

    def _pressed(self) -> None:
        if self.designer.busy:
            self.designer.end()
            return
        session = self._page.session
        with self._beside.explained():
            joints, robot = self._chosen(), session.robot
            limits = {name: float(handle.value) for name, handle in self._limits.items()}
            spec = specification(session.config, joints, session.payload, self._preset.value, **limits)
            self.designer.begin(robot, spec, lambda found, why: self._done(robot, found, why))
            self._say(f"looks for gains of {', '.join(joints)} …", END)

    def _done(self, robot: Robot, found: Design | None, why: str) -> None:
        session, said = self._page.session, ""
        with self._beside.explained():
            if why:
                raise DashpotError(why)
            if found is not None:
                if session.robot is not robot:
                    raise DashpotError("the arm was exchanged meanwhile")
                session.use(taken_over(session.config, found))
                said = f"taken over: {', '.join(joint.name for joint in found.joints)}"
        self._say(said, BEGIN)
        self._page.redraw()

    def _say(self, words: str, button: str) -> None:
        self._said.content, self._button.label = (block(words) if words else ""), button
