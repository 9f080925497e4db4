"""Draws docs/pages/pendant_arm.png and pendant_arm_dark.png: `PYTHONPATH=test python docs/pendant_picture.py [CALIBRATED]`.

It needs the extras ros, sim and pendant, and Chromium. A virtual arm is calibrated and weighs 50 g by clicks, a minute;
CALIBRATED is a home folder in which it was before.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

from support.live import UP_S, wait_for
from support.pendant import ELBOW, Shown, answered, pendant
from support.tab import Tab, browser

PAGES = Path(__file__).resolve().parent / "pages"
WIDTH_PX, HEIGHT_PX = 1200, 810
DRAWN_S = 5.0


def draw(shown: Shown, tab: Tab, calibrated: bool) -> None:
    """Weigh, and take the picture."""
    assert wait_for(lambda: "[identifier]: ready" in shown.told, UP_S)
    tab.look(WIDTH_PX, HEIGHT_PX)
    tab.open(shown.address.replace("/?", "/wizard?"))
    if not calibrated:
        answered(tab, "Calibrate the arm", ELBOW)
    answer = answered(tab, "Weigh an object", ELBOW)
    assert "accepted" in answer, answer
    tab.click("Arm")
    tab.until("!!document.querySelector('.scene canvas')")
    for name in ("pendant_arm", "pendant_arm_dark"):
        tab.look(WIDTH_PX, HEIGHT_PX, "dark" in name)
        wait_for(lambda: False, DRAWN_S)
        tab.picture(PAGES / f"{name}.png")


def main() -> None:
    cache = os.environ.get("WARP_CACHE_PATH") or str(Path("~/.cache/warp").expanduser())
    with tempfile.TemporaryDirectory() as folder:
        home = sys.argv[1] if len(sys.argv) > 1 else folder
        around = {"HOME": home, "WARP_CACHE_PATH": cache}
        with pendant(Path(folder), "--virtual", **around) as shown, browser(Path(folder)) as window:
            draw(shown, window.tab(), len(sys.argv) > 1)


if __name__ == "__main__":
    main()
