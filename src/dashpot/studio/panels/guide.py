"""Where to begin: the paper's experiments, told while they happen, and a rival beside the arm."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dashpot.studio.choices import RIVALS
from dashpot.studio.markup import BLUE, block, escaped
from dashpot.studio.panels.shared import Beside, by_hand, set_quietly
from dashpot.studio.scenes import SCENES, GuidedScene, play

if TYPE_CHECKING:
    from dashpot.studio.page import Page

NONE = "none"
UNSUPERVISED = "No supervisor runs in a scene; what you load next has yours again."
WELCOME = (
    "A motor under <b>virtual passive control</b> imitates a mass, a spring and a dashpot, from its torque "
    "sensor alone: it brakes without an encoder, and under a position loop the error hardly depends on the "
    "load. Begin with a scene; then take over: everything stays live."
)


class GuidePanel:
    """See the module."""

    def __init__(self, page: Page) -> None:
        gui, self._page = page.server.gui, page
        gui.add_html(block(WELCOME, "4px 12px 8px"))
        self._buttons = []
        for scene in SCENES:
            button = gui.add_button(scene.title)
            button.on_click(lambda _, scene=scene: self._begin(scene))  # type: ignore[misc]
            self._buttons.append(button)
        self._words = gui.add_html("")
        self._beside = Beside(gui)
        gui.add_divider()
        self._rival = gui.add_dropdown(
            "beside it", (NONE, *RIVALS), initial_value=NONE, hint="The same arm under another controller"
        )
        self._beside_rival = Beside(gui)
        by_hand(self._rival, self._chosen)

    def forget(self) -> None:
        """Another arm runs: takes the scene's words away."""
        self._words.content = ""

    def refresh(self) -> None:
        """Shows the rival's name."""
        name = self._page.session.rival_name or NONE
        if name not in self._rival.options:
            self._rival.options = (NONE, *RIVALS, name)
        set_quietly(self._rival, name)

    def _begin(self, scene: GuidedScene) -> None:
        with self._beside.explained():
            self._page.begin(lambda session: play(scene, session), "k807", "k807-wrist")
            self._words.content = block(
                f'<div style="border-left:3px solid {BLUE};padding:2px 8px">{escaped(scene.words)}'
                f'<div style="color:#666">{UNSUPERVISED}</div></div>',
                "6px 12px",
            )

    def _chosen(self, name: str) -> None:
        with self._beside_rival.explained():
            self._page.session.set_rival("" if name == NONE else name)
