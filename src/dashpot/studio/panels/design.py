"""Gains from the designer, for the chosen joint or for all: asked for, looked at, taken, and given back."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from dashpot.arm.robot import Robot
from dashpot.control.controller import ControllerConfig
from dashpot.design.design import Design
from dashpot.design.quantities import QUANTITIES, predicted_text
from dashpot.errors import DashpotError
from dashpot.studio.designer import PRESETS, Designer, specification, taken_over
from dashpot.studio.markup import block, escaped
from dashpot.studio.panels.shared import Beside, NumberField

if TYPE_CHECKING:
    from dashpot.studio.page import Page

BEGIN, END = "Design", "End the search"
SHOWN = ("stop_time", "error_ratio")  # of what is predicted
WHY_NO_BRAKE = (
    "As in dashpot design, with this payload. Its brake has no kp and kd, by which the arm moves here"
)


class DesignFolder:
    """See the module.

    Attributes:
        designer: Runs it.
    """

    def __init__(self, page: Page, chosen: Callable[[], tuple[str, ...]]) -> None:
        """Adds the folder; `chosen` says which joints are meant."""
        gui, self._page, self._chosen, self.designer = page.server.gui, page, chosen, Designer()
        self._begun = 0.0
        self._asked: tuple[str, ...] = ()
        self._found: tuple[Robot, Design] | None = None
        self._before: tuple[Robot, ControllerConfig] | None = None
        with gui.add_folder("Design", expand_by_default=False):
            self._preset: Any = gui.add_dropdown(
                "wishes", PRESETS, initial_value=PRESETS[0], hint=WHY_NO_BRAKE
            )
            self._beside = Beside(gui, put=False)
            self._limits = {
                name: NumberField(
                    gui, label, 0.0, lambda _: None, self._beside, low=0.0, hint="0: as wished for"
                )
                for name, label in (("error_ratio", "error ratio [-]"), ("stop_time", "stop time [s]"))
            }
            self._button = gui.add_button(BEGIN)
            self._said = gui.add_html("")
            self._take = gui.add_button("Take", visible=False, hint="The arm goes on with these gains")
            self._undo = gui.add_button("Undo", visible=False, hint="Back to the gains before")
            self._beside.put()
        self._button.on_click(lambda _: self._pressed())
        self._take.on_click(lambda _: self.take())
        self._undo.on_click(lambda _: self.undo())

    def refresh(self) -> None:
        """Shows for how long it has been looking."""
        if self.designer.busy and self._button.label == END:
            passed = time.monotonic() - self._begun
            self._say(f"looks for gains of {', '.join(self._asked)}: {passed:.0f} s", END)

    def take(self) -> None:
        """The arm goes on with the gains that were found."""
        session = self._page.session
        with self._beside.explained():
            if self._found is None or self._found[0] is not session.robot:
                raise DashpotError("the arm was exchanged meanwhile")
            before, found = session.config, self._found[1]
            session.use(taken_over(before, found))
            self._before = session.robot, before
            self._show(take=False, undo=True)
            self._say(f"taken: {', '.join(joint.name for joint in found.joints)}", BEGIN)
        self._page.redraw()

    def undo(self) -> None:
        """Back to the controller before the last `take`."""
        session = self._page.session
        with self._beside.explained():
            if self._before is None or self._before[0] is not session.robot:
                raise DashpotError("the arm was exchanged meanwhile")
            session.use(self._before[1])
            self._show(take=self._found is not None, undo=False)
            self._say("", BEGIN)
        self._page.redraw()

    def _pressed(self) -> None:
        if self.designer.busy:
            self.designer.end()
            return
        session = self._page.session
        with self._beside.explained():
            self._asked, robot = self._chosen(), session.robot
            limits = {name: field.read() for name, field in self._limits.items()}
            spec = specification(session.config, self._asked, session.payload, self._preset.value, **limits)
            self._begun, self._found = time.monotonic(), None
            self.designer.begin(robot, spec, lambda found, why: self._done(robot, found, why))
            self._show(take=False, undo=False)
            self._say(f"looks for gains of {', '.join(self._asked)}", END)

    def _done(self, robot: Robot, found: Design | None, why: str) -> None:
        said = ""
        with self._beside.explained():
            if why:
                raise DashpotError(why)
            if found is not None:
                if self._page.session.robot is not robot:
                    raise DashpotError("the arm was exchanged meanwhile")
                taken_over(self._page.session.config, found)  # conflicts of wishes are said, and end it
                self._found, said = (robot, found), predictions(found)
        self._show(take=self._found is not None, undo=False)
        self._button.label = BEGIN
        self._said.content = block(said) if said else ""

    def _show(self, *, take: bool, undo: bool) -> None:
        self._take.visible, self._undo.visible = take, undo

    def _say(self, words: str, button: str) -> None:
        content = block(escaped(words)) if words else ""
        if self._said.content != content:
            self._said.content = content
        self._button.label = button


def predictions(found: Design) -> str:
    """What the gains of a design will do, as a table of HTML."""
    names = [name for name in SHOWN if all(name in joint.predicted for joint in found.joints)]
    head = "".join(
        f'<td style="color:#666;padding-right:10px">{escaped(quantity.label)} [{quantity.unit or "-"}]</td>'
        for quantity in (QUANTITIES[name] for name in names)
    )
    rows = "".join(
        f'<tr><td style="padding-right:10px">{escaped(joint.name)}</td>'
        + "".join(f"<td>{escaped(predicted_text(joint, name))}</td>" for name in names)
        + "</tr>"
        for joint in found.joints
    )
    return f'<table style="border-collapse:collapse"><tr><td></td>{head}</tr>{rows}</table>'
