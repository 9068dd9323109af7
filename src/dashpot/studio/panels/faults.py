"""What can fail, and what the supervisor makes of it."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

from dashpot.studio import markup
from dashpot.studio.choices import FAULTS, PanelFault
from dashpot.studio.panels.shared import Beside, NumberField, by_hand, set_quietly

if TYPE_CHECKING:
    from dashpot.studio.page import Page

ALL = "all joints"
LINES = 12  # of news
STATES = "track → torque brake → encoder brake → safe: it only gets worse until you resume"
HEAL_FIRST = "heal the faults first, or it will stop again"


class FaultPanel:
    """See the module."""

    def __init__(self, page: Page) -> None:
        gui, self._page = page.server.gui, page
        self._state = gui.add_html("")
        self._supervised = gui.add_checkbox("supervisor", initial_value=page.session.supervised)
        self._stop = gui.add_button(
            "Stop", color="orange", hint="The operator's stop: brakes by the torque sensors"
        )
        self._resume = gui.add_button("Resume tracking")
        self._warning = gui.add_html("")
        self._restart = gui.add_button("Start again at home")
        self._joint: Any = gui.add_dropdown(
            "joint", (*page.session.arm.controller.joints, ALL), initial_value=page.session.joint
        )
        self._loop = gui.add_checkbox(
            "position loop lost",
            initial_value=False,
            hint="The paper's Fig. 5, live: no encoder value is used",
        )
        self._beside = Beside(gui, put=False)
        self._switches: list[tuple[PanelFault, Any, Any]] = []
        for fault in FAULTS:
            switch = gui.add_checkbox(fault.label, initial_value=False)
            size = None
            if fault.size:
                size = NumberField(
                    gui, fault.size, fault.value, partial(self._resized, fault, switch), self._beside
                )
            self._switches.append((fault, switch, size))
            by_hand(switch, partial(self._switched, fault, size))
        self._lose = gui.add_button("Lose the payload")
        self._heal = gui.add_button("Heal everything")
        self._beside.put()
        self._news = gui.add_html("")
        session = page.session
        by_hand(self._supervised, lambda on: self._do(lambda: session.supervise(bool(on))))
        by_hand(self._loop, self._cut)
        by_hand(self._joint, lambda _: self.refresh())
        self._stop.on_click(lambda _: self._do(session.stop))
        self._resume.on_click(lambda _: self._do(session.resume))
        self._restart.on_click(lambda _: self._do(page.restart))
        self._lose.on_click(lambda _: self._do(lambda: session.set_payload(0.0)))
        self._heal.on_click(lambda _: self._do(session.heal))

    def refresh(self) -> None:
        """Shows what is."""
        session = self._page.session
        options = (*session.arm.controller.joints, ALL)
        if tuple(self._joint.options) != options:
            self._joint.options, self._joint.value = options, session.joint
        set_quietly(self._supervised, session.supervised)
        names = session.arm.controller.joints if self._joint.value == ALL else (self._joint.value,)
        set_quietly(self._loop, not all(session.arm.mode(name)[1] for name in names))
        for fault, switch, _ in self._switches:
            set_quietly(switch, self._name(fault) in {name.partition("=")[0] for name in session.faults})
        self.tell()

    def tell(self) -> None:
        """Shows the supervisor's state and the news."""
        session = self._page.session
        word, colour = markup.STATE[session.arm.state] if session.supervised else ("off", markup.GREY)
        content = markup.block(
            f'<b>Supervisor</b>: <span style="color:{colour};font-weight:600">{word}</span>'
            f'<div style="color:#666">{STATES}</div>',
            "2px 12px 8px",
        )
        if self._state.content != content:
            self._state.content = content
        again = session.faults and session.arm.state != "track"
        content = markup.block(HEAL_FIRST, "0 12px 4px") if again else ""
        if self._warning.content != content:
            self._warning.content = content
        latest = session.latest()[-LINES:][::-1]
        content = markup.news([(line.time, line.text, line.kind) for line in latest])
        if self._news.content != content:
            self._news.content = content

    def _name(self, fault: PanelFault) -> str:
        where = "" if self._joint.value == ALL or not fault.per_joint else f":{self._joint.value}"
        return f"{fault.kind}{where}"

    def _resized(self, fault: PanelFault, switch: Any, value: float) -> None:
        if switch.value:
            self._set(fault, value, True)

    def _switched(self, fault: PanelFault, size: NumberField | None, on: bool) -> None:
        value = None
        with self._beside.explained():
            value = size.read() if size is not None and on else None
        if not self._beside.failed:
            self._set(fault, value, on)
        else:
            self.refresh()

    def _set(self, fault: PanelFault, value: float | None, on: bool) -> None:
        session, name = self._page.session, self._name(fault)
        with self._beside.explained():
            for old in [old for old in session.faults if old.partition("=")[0] == name]:
                session.heal(old)
            if on:
                joint = "all" if self._joint.value == ALL or not fault.per_joint else self._joint.value
                session.fail(fault.kind, joint, value)
        self.refresh()

    def _cut(self, lost: bool) -> None:
        joint = "all" if self._joint.value == ALL else self._joint.value
        self._do(lambda: self._page.session.set_position_loop(joint, not lost))

    def _do(self, act: Any) -> None:
        with self._beside.explained():
            act()
        self.refresh()
