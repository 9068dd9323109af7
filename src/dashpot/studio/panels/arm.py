"""Which arm, what it carries, and where it goes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from dashpot.arm.payload import Payload
from dashpot.arm.robot import BUNDLED
from dashpot.control.controller import BUNDLED as CONTROLLERS
from dashpot.errors import DashpotError
from dashpot.studio.choices import CONTROLLER_OF, HEAVIEST, POUND
from dashpot.studio.markup import block
from dashpot.studio.panels.shared import Beside, NumberField, Settled, by_hand, in_hand, set_quietly
from dashpot.studio.told import MOST_AMPLITUDE
from dashpot.support.tables import unusual

if TYPE_CHECKING:
    from dashpot.studio.page import Page

TAP = 5.0  # [N m]
SLIDER = 10.0  # [kg], end of the slider; more can be typed


class ArmPanel:
    """See the module."""

    def __init__(self, page: Page) -> None:
        gui, self._page = page.server.gui, page
        session = page.session
        with gui.add_folder("Arm and controller"):
            self._robot: Any = gui.add_text(
                "robot", initial_value=page.robot_name, hint="k807, fr3, iiwa14 or a robot TOML"
            )
            self._controller: Any = gui.add_text(
                "controller",
                initial_value=page.controller_name,
                hint=f"{', '.join(CONTROLLERS)} or a controller TOML",
            )
            self._pick = gui.add_button_group("bundled", BUNDLED)
            self._load = gui.add_button("Load")
            self._beside = Beside(gui)
        with gui.add_folder("Payload"):
            mass = session.payload.mass
            self._beside_load = Beside(gui, put=False)
            self._kilograms = NumberField(
                gui, "mass [kg]", round(mass, 4), self._weigh, self._beside_load, low=0.0, high=HEAVIEST
            )
            self._pounds = NumberField(
                gui,
                "mass [lb]",
                _pounds(mass),
                lambda lb: self._weigh(lb * POUND),
                self._beside_load,
                low=0.0,
                high=HEAVIEST / POUND,
            )
            self._mass: Any = gui.add_slider(
                "",
                min=0.0,
                max=SLIDER,
                step=0.05,
                initial_value=min(mass, SLIDER),
                marks=tuple((v, f"{v:g}") for v in (0.0, SLIDER / 2, SLIDER)),
            )
            self._offset: Any = gui.add_text(
                "offset [m]",
                initial_value=_triple(session.payload),
                hint="Of its centre in the flange frame: x y z, or x alone",
            )
            self._shown = _triple(session.payload)
            self._beside_load.put()
            self._carried: Any = gui.add_checkbox(
                "robot carries its own weight",
                initial_value=session.carried,
                hint="Its gravity compensation, below the controller; off: the controller carries the arm",
                visible=session.robot.gravity_compensation,
            )
        with gui.add_folder("Motion"):
            self._pose = gui.add_button_group("go to", tuple(session.poses))
            self._beside_motion = Beside(gui, put=False)
            self._amplitude = NumberField(
                gui,
                "amplitude [rad]",
                0.3,
                lambda _: None,
                self._beside_motion,
                low=0.01,
                high=MOST_AMPLITUDE,
            )
            self._move = gui.add_button("Move about home")
            self._hold = gui.add_button("Hold")
            gui.add_html(
                block("<b>Push</b>: Ctrl (or ⌘) and drag a link. Or tap the chosen joint:", "4px 12px")
            )
            self._tap = gui.add_button_group(f"tap {TAP:g} N m", ("−", "+"))
            self._beside_motion.put()
        self._pick.on_click(self._picked)
        self._load.on_click(lambda _: self._loaded())
        by_hand(self._mass, lambda kg: self._weigh(float(kg)))
        by_hand(self._offset, Settled(lambda _: self._weigh(page.session.payload.mass)))
        by_hand(self._carried, self._compensated)
        self._pose.on_click(lambda _: self._do(lambda: page.session.go(self._pose.value)))
        self._move.on_click(lambda _: self._do(lambda: page.session.move(self._amplitude.read())))
        self._hold.on_click(lambda _: self._do(page.session.hold))
        self._tap.on_click(lambda _: self._tapped())

    def refresh(self) -> None:
        """Shows what is."""
        session = self._page.session
        mass = session.payload.mass
        if abs(float(self._mass.value) - mass) > 0.026:
            set_quietly(self._mass, min(round(mass, 2), SLIDER))
        self._kilograms.show(round(mass, 4))
        self._pounds.show(_pounds(mass))
        offset = _triple(session.payload)
        if offset != self._shown:  # else what is typed, and may have been refused, stays
            self._shown = offset
            if not in_hand(self._offset):
                self._offset.value = offset
        if tuple(self._pose.options) != tuple(session.poses):
            self._pose.options = tuple(session.poses)

        if self._carried.visible != session.robot.gravity_compensation:
            self._carried.visible = session.robot.gravity_compensation
        set_quietly(self._carried, session.carried)

    def name(self) -> None:
        """Shows the names of what was loaded elsewhere."""
        set_quietly(self._robot, self._page.robot_name)
        set_quietly(self._controller, self._page.controller_name)

    def _picked(self, event: Any) -> None:
        name = event.target.value
        self._robot.value, self._controller.value = name, CONTROLLER_OF[name]
        self._loaded()

    def _loaded(self) -> None:
        page, robot, controller = self._page, self._robot.value.strip(), self._controller.value.strip()
        if robot != page.robot_name and controller == page.controller_name:  # that of the arm before
            controller = CONTROLLER_OF.get(robot, controller)
        with self._beside.explained():
            try:
                page.load(robot, controller, Payload(0.0))
            except (DashpotError, OSError) as error:
                raise DashpotError(f"{robot} under {controller}: {error}") from None
        if self._beside.failed:  # the fields say what runs
            self._robot.value, self._controller.value = page.robot_name, page.controller_name

    def _weigh(self, mass: float) -> None:
        with self._beside_load.explained():
            self._page.session.set_payload(mass, _read_triple(self._offset.value))
        if not self._beside_load.failed:
            self._beside_load.remark("; ".join(unusual(self._page.session.payload)))

    def _compensated(self, on: bool) -> None:
        with self._beside_load.explained():
            self._page.session.compensate(bool(on))
        if self._beside_load.failed:
            self._carried.value = self._page.session.carried

    def _do(self, act: Any) -> None:
        with self._beside_motion.explained():
            act()

    def _tapped(self) -> None:
        sign = 1.0 if self._tap.value == "+" else -1.0
        self._do(lambda: self._page.session.tap(self._page.session.joint, sign * TAP))


def _triple(payload: Payload) -> str:
    return " ".join(f"{float(part):.6g}" for part in payload.position)


def _read_triple(text: str) -> tuple[float, float, float]:
    """Offset [m] as it was typed.

    Raises:
        DashpotError: It is not one number or three.
    """
    try:
        parts = [float(part) for part in text.replace(",", " ").split()]
    except ValueError:
        parts = []
    if len(parts) not in (1, 3):
        raise DashpotError(f"offset [m] = {text.strip()}: must be three numbers, x y z, or x alone")
    x, y, z = parts if len(parts) == 3 else (parts[0], 0.0, 0.0)
    return x, y, z


def _pounds(mass: float) -> float:
    return round(mass / POUND, 2)
