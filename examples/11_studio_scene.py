"""A scene of one's own in the studio: the hand lets go of its payload, then an encoder freezes.

Here it is told in text; with ``--watch`` in the browser (extra `studio`).
"""

import sys
import time

from dashpot import Payload
from dashpot.studio.session import Session


def scene(session: Session) -> None:
    """Sets up the arm and what will happen to it; the session runs on from there."""
    session.load("fr3", "fr3", Payload(2.0, (0.0, 0.0, 0.1)))
    session.supervise(True)
    session.move(0.2)
    session.show("joint4")
    session.tell("2 kg on the hand, which lets go at 1 s; joint 4's encoder freezes at 2 s")
    session.at(1.0, lambda: session.set_payload(0.0))
    session.at(2.0, lambda: session.fail("encoder_frozen", "joint4"))


if __name__ == "__main__":
    if "--watch" in sys.argv:
        from dashpot.studio.page import open_page

        page = open_page("fr3", "fr3", None, host="127.0.0.1", port=8080, supervise=True, seed=0)
        page.begin(scene, "fr3", "fr3")
        print(f"open {page.url}; Ctrl-C ends")
        while True:
            time.sleep(1)
    session = Session("fr3", "fr3")
    scene(session)
    session.step(3.0)
    for news in session.latest():
        print(f"{news.time:6.3f} s  {news.text}")
    session.close()
