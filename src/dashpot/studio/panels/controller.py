"""The controller of the chosen joint, its certificate and its map."""

from __future__ import annotations

import time
from collections import deque
from typing import TYPE_CHECKING

from dashpot.control.controller import BUNDLED, ControllerConfig, JointGains, load_controller
from dashpot.errors import DashpotError
from dashpot.studio import markup
from dashpot.studio.panels.design import DesignFolder
from dashpot.studio.panels.shared import Beside, LogField, NumberField, by_hand, set_quietly
from dashpot.support.tables import unusual

if TYPE_CHECKING:
    from dashpot.studio.page import Page

FIELDS = (
    ("R", "R [-]", 0.1, 100.0, False, "How many times heavier the virtual rotor is"),
    ("D", "D [N m s/rad]", 0.1, 1000.0, False, "Virtual damping"),
    ("K", "K [N m/rad]", 1e-2, 1e3, True, "Virtual stiffness; 0 holds best"),
    ("kp", "kp [N m/rad]", 1.0, 1e4, True, "Position gain; the law multiplies it"),
    ("kd", "kd [N m s/rad]", 0.1, 1e3, True, "Velocity gain"),
)
ALL = "all joints"
USUAL = 50.0, 1e4  # [Hz], as the period's typical range
MODES = {"on": "active", "off (position loop alone)": "bypass", "motor off": "off"}


class ControllerPanel:
    """See the module.

    Attributes:
        design: Asks the designer.
        judged: What the last moves of a slider took until their margins were there [s], newest last.
    """

    def __init__(self, page: Page) -> None:
        gui, self._page = page.server.gui, page
        self.judged: deque[float] = deque(maxlen=200)
        session = page.session
        self._joint = gui.add_dropdown(
            "joint", (*session.arm.controller.joints, ALL), initial_value=session.joint
        )
        self._margins = gui.add_html("")
        self._mode = gui.add_dropdown(
            "law", tuple(MODES), initial_value="on", hint="Virtual passive control of this joint"
        )
        self._beside, self._fields = Beside(gui, put=False), dict[str, LogField]()
        for key, label, low, high, zero, hint in FIELDS:

            def changed(value: float, key: str = key) -> bool:
                return self._edit(key, value)

            self._fields[key] = LogField(
                gui, label, low, high, 1.0, changed, self._beside, zero=zero, hint=hint
            )
        self._beside.put()
        self._plane = gui.add_html("")
        with gui.add_folder("Sampling"):
            self._form = gui.add_dropdown("form", ("implicit", "explicit"), initial_value=session.config.form)
            self._sampling = gui.add_dropdown(
                "sampling", ("average", "point"), initial_value=session.config.sampling
            )
            self._beside_sampling = Beside(gui, put=False)
            self._rate = NumberField(
                gui, "rate [Hz]", _rate(session.config), self._at_rate, self._beside_sampling,
                low=1.0, high=1e5,
            )  # fmt: skip
            self._latency = NumberField(
                gui, "latency [samples]", session.config.latency, self._at_latency, self._beside_sampling
            )
            self._beside_sampling.put()
        self.design = DesignFolder(page, self._names)
        with gui.add_folder("Take gains from", expand_by_default=False):
            self._preset = gui.add_button_group("bundled", BUNDLED)
            self._file = gui.add_text(
                "file", initial_value="out/design/controller.toml", hint="As dashpot design writes it"
            )
            self._take = gui.add_button("Take from file")
            self._beside_preset = Beside(gui)
        by_hand(self._joint, self._chosen)
        by_hand(self._mode, self._switched)
        for handle, key in ((self._form, "form"), (self._sampling, "sampling")):
            by_hand(handle, lambda value, key=key: self._configure(key, value))  # type: ignore[misc]
        self._preset.on_click(lambda event: self._use(event.target.value))
        self._take.on_click(lambda _: self._use(self._file.value.strip()))
        self.refresh()

    @property
    def joint(self) -> str:
        """The chosen joint; the last one where all are chosen."""
        return self._page.session.joint

    def refresh(self) -> None:
        """Shows what is."""
        session = self._page.session
        options = (*session.arm.controller.joints, ALL)
        if tuple(self._joint.options) != options:
            self._joint.options = options
        if self._joint.value != ALL:
            set_quietly(self._joint, session.joint)
        law = session.config.joints[session.arm.controller.index(session.joint)]
        for key, field in self._fields.items():
            field.enable(hasattr(law, key))
            if hasattr(law, key):
                field.show(getattr(law, key), session.joint)
        mode = session.arm.mode(session.joint)[0]
        set_quietly(self._mode, next(label for label, name in MODES.items() if name == mode))
        set_quietly(self._form, session.config.form)
        set_quietly(self._sampling, session.config.sampling)
        self._rate.show(_rate(session.config))
        self._latency.show(session.config.latency)
        self.design.refresh()
        self.judge()

    def judge(self) -> None:
        """Shows margins and map."""
        session = self._page.session
        certifier = session.certifier
        if certifier is None:
            return
        modes = {}
        for name in session.arm.controller.joints:
            mode, loop = session.arm.mode(name)
            modes[name] = {"bypass": "bypassed", "off": "off"}.get(mode, "" if loop else "brake")
        content = markup.margins(certifier.margins(), session.joint, modes)
        if self._margins.content != content:
            self._margins.content = content
        law = session.config.joints[session.arm.controller.index(session.joint)]
        shown = certifier.plane(law, session.config)
        picture = markup.plane(shown, session.joint, now=session.inertia(session.joint))
        if self._plane.content != picture:
            self._plane.content = picture

    def _edit(self, key: str, value: float) -> bool:
        begun = time.perf_counter()
        with self._beside.explained():
            self._page.session.edit("all" if self._joint.value == ALL else self.joint, **{key: value})
            self.judge()
        if not self._beside.failed:
            laws = {law.name: law for law in self._page.session.config.joints}
            said = unusual(laws[self.joint], joint=self.joint)
            self._beside.remark("; ".join(words for words in said if f"{key} [" in words))
        self.judged.append(time.perf_counter() - begun)
        return not self._beside.failed

    def _chosen(self, name: str) -> None:
        session = self._page.session
        self._beside.say("")
        session.show(session.arm.controller.joints[-1] if name == ALL else name)
        self.refresh()
        self._page.redraw()

    def _switched(self, label: str) -> None:
        session = self._page.session
        with self._beside.explained():
            for name in self._names():
                session.set_mode(name, MODES[label])  # type: ignore[arg-type]
        self.refresh()

    def _names(self) -> tuple[str, ...]:
        return self._page.session.arm.controller.joints if self._joint.value == ALL else (self.joint,)

    def _configure(self, key: str, value: object) -> None:
        with self._beside_sampling.explained():
            self._page.session.configure(**{key: value})
        self.judge()

    def _at_rate(self, rate: float) -> None:
        self._configure("period", 1 / rate)
        low, high = USUAL
        if not self._beside_sampling.failed and not low <= rate <= high:
            self._beside_sampling.remark(
                f"rate [Hz] = {rate:g}: is unusual (typical: {low:g} to {high:g} Hz)"
            )

    def _at_latency(self, samples: float) -> None:
        if samples != int(samples):
            self._beside_sampling.say(f"latency [samples] = {samples:g}: must be a whole number")
            return
        self._configure("latency", int(samples))

    def _use(self, source: str) -> None:
        session = self._page.session
        with self._beside_preset.explained():
            config = load_controller(source)
            unknown = [law.name for law in config.joints if law.name not in session.robot.joints]
            if unknown:
                raise DashpotError(f"{source}: {session.robot.name} has no {unknown[0]}; load its arm first")
            session.use(config)
            self._page.controller_name = source
        self.refresh()

    def has_gains(self) -> bool:
        """Whether the joint on show is under the virtual passive law."""
        session = self._page.session
        return isinstance(session.config.joints[session.arm.controller.index(session.joint)], JointGains)


def _rate(config: ControllerConfig) -> float:
    return float(f"{1 / config.period:.6g}")  # [Hz], without the dust of the division
