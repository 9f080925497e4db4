"""Recordings and History in a real browser, without ROS: by keys alone, narrow and wide; and what strangers ask for."""

from __future__ import annotations

import http.client
import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import quote, urlsplit

import pytest

pytest.importorskip("nicegui")

from support.pendant import Shown, pendant
from support.tab import Browser, Tab

from proprio_ros.addons.pendant.places import MOST_BYTES
from proprio_ros.robot import load_robot

REPOSITORY = Path(__file__).resolve().parents[3]
BAGS = REPOSITORY / "bags"
CUBE = "realistic_s00_fixed_heavy_cube_23g_joint3"
NO_ROS = "import sys\nsys.modules['rclpy'] = None\n"
TABLE = b"time_s,joint1.pos,joint2.pos\n" + b"".join(
    b"%.2f,0.%d,0.2\n" % (0.01 * row, row) for row in range(300)
)
LEAVES_ALL = "document.querySelectorAll('.chosen .head button').forEach((it) => it.click())"
NUMBERS = "[...document.querySelectorAll('.page input[type=number]')].map((it) => it.ariaLabel)"


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With two answers of the nodes, and a folder of recordings."""
    home = tmp_path_factory.mktemp("home")
    shutil.copytree(BAGS / CUBE, home / "work" / CUBE)
    for stamp, mass in (("20260102_030405_000", 0.0499), ("20260103_030405_000", 0.0612)):
        folder = home / ".ros" / "proprio_ros" / f"{stamp}_payload"
        folder.mkdir(parents=True)
        value = {"name": "payload_mass", "value": mass, "std": 0.001, "unit": "kg"}
        interval = [mass - 0.002, mass + 0.002]
        answer = {"verdict": "accepted", "estimates": [{**value, "ci95": interval}]}
        (folder / "estimate.json").write_text(json.dumps(answer))
    return home


@pytest.fixture(scope="module")
def shown(home: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shown]:
    """A pendant where there is no ROS, started in the folder of recordings."""
    blocks = tmp_path_factory.mktemp("blocks")
    (blocks / "sitecustomize.py").write_text(NO_ROS)
    path = os.pathsep.join([str(blocks), str(REPOSITORY), os.environ.get("PYTHONPATH", "")])
    began = Path.cwd()
    os.chdir(home / "work")
    try:
        with pendant(blocks, HOME=str(home), PYTHONPATH=path) as shown:
            yield shown
    finally:
        os.chdir(began)


def enter(tab: Tab, words: str) -> None:
    tab.focus(words)
    tab.press("Enter", "Enter", "\r")


def wide_and_narrow(tab: Tab, folder: Path, name: str) -> None:
    """Nothing is wider than the window; in both schemes."""
    for width in (400, 1400):
        for dark in (False, True):
            tab.look(width, 1000, dark)
            tab.until("document.documentElement.scrollWidth <= innerWidth")
            tab.picture(folder / f"{name}_{width}_{'dark' if dark else 'bright'}.png")


def test_keys_alone_lead_to_an_answer(
    shown: Shown, window: Browser, home: Path, tmp_path: Path
) -> None:
    tab = window.tab()
    tab.open(shown.address)
    tab.shows("No arm can be seen")
    enter(tab, "Recordings")
    tab.shows(CUBE)
    enter(tab, CUBE)
    tab.shows("bag_mcap")
    enter(tab, "bag_mcap")
    tab.shows("1 usable")
    enter(tab, "What is in it")
    tab.until("document.querySelectorAll('.looked canvas').length == 3")
    tab.shows("usable; alone")
    tab.focus("In the hand")
    for _ in range(2):
        tab.press("ArrowDown")
    tab.until("document.querySelector('[aria-label=\"Mass [g]\"]').offsetHeight > 0")
    tab.press("Home")
    tab.until("document.querySelector('[aria-label=\"In the hand\"]').value == 'asked'")
    wide_and_narrow(tab, tmp_path, "looked")
    enter(tab, "Answer")
    tab.shows("Report")
    tab.shows("95 % interval")
    tab.shows("What to do: ")
    tab.shows(f"proprio replay {CUBE}/bag_mcap --probe payload")
    wide_and_narrow(tab, tmp_path, "answered")
    page = tab.does("document.querySelector('.hand a').getAttribute('href')")
    status, text = shown.page(page)
    assert status == 200 and "<svg" in text
    assert not tab.said
    assert {
        urlsplit(url).netloc for url in tab.requests if not url.startswith(("data:", "blob:"))
    } == {urlsplit(shown.base).netloc}
    tab.close()


def test_history_compares(shown: Shown, window: Browser, tmp_path: Path) -> None:
    tab = window.tab()
    tab.open(shown.address)
    enter(tab, "History")
    tab.shows("2026-01-02 03:04")
    tab.shows("49.9 g")
    tab.focus("One")
    tab.press("End")
    tab.focus("The other")
    tab.press("End")
    tab.shows("0.0 g apart; their intervals overlap")
    tab.does("document.activeElement.focus()")
    tab.press("ArrowUp")
    tab.shows("11.3 g apart; their intervals do not overlap")
    wide_and_narrow(tab, tmp_path, "history")
    assert not tab.said
    tab.close()


def test_a_file_of_this_computer_is_sent(
    shown: Shown, window: Browser, home: Path, tmp_path: Path
) -> None:
    good = tmp_path / "sent.csv"
    good.write_bytes(TABLE)
    odd = tmp_path / "odd.csv"
    odd.write_text("name,colour\nball,red\n")
    tab = window.tab()
    tab.open(shown.address)
    tab.click("Recordings")
    tab.shows("Drop a recording")
    choose_file(tab, odd, good)
    tab.shows("odd.csv: no columns of times and joint positions in it")
    tab.shows("uploads/sent.csv")
    tab.click("Leave out")
    assert (home / ".ros/proprio_ros/uploads/sent.csv").read_bytes() == TABLE
    assert not tab.said
    tab.close()


def choose_file(tab: Tab, *files: Path) -> None:
    """As by the file box of the page."""
    picked = tab.call("Runtime.evaluate", expression="document.querySelector('.drop input')")
    place = picked["result"]["objectId"]
    tab.call("DOM.setFileInputFiles", files=[str(file) for file in files], objectId=place)


def test_a_role_is_given_by_drag_and_drop(shown: Shown, window: Browser) -> None:
    tab = window.tab()
    tab.open(shown.address)
    tab.click("Recordings")
    tab.shows(CUBE)
    # what other tests chose is drawn a moment later than the folder
    tab.until(f"({LEAVES_ALL}, document.body.innerText.includes('None is chosen yet'))")
    tab.click(CUBE)
    tab.shows("bag_mcap")
    tab.click("bag_mcap")
    tab.shows("1 usable")
    tab.drag(".chosen", ".row .drop:nth-child(2)")
    tab.until("document.querySelector('[aria-label=\"In the hand\"]').value == 'empty'")
    tab.drag(".chosen", ".row .drop:nth-child(3)")
    tab.until("document.querySelector('[aria-label=\"Mass [g]\"]').offsetHeight > 0")
    tab.click("Leave out")
    tab.shows("None is chosen yet")
    assert not tab.said
    tab.close()


def test_a_urdf_is_asked_for_what_it_lacks(
    shown: Shown, window: Browser, home: Path, tmp_path: Path
) -> None:
    urdf = tmp_path / "my_arm.urdf"
    shutil.copy(REPOSITORY / "urdf" / "pendulum.urdf", urdf)
    other = tmp_path / "other.urdf"
    other.write_text("<robot")
    tab = window.tab()
    tab.open(shown.address)
    tab.click("Wizard")
    tab.click("Which arm")
    tab.shows("an arm that no node names")
    choose_file(tab, other)
    tab.shows("other.urdf")
    choose_file(tab, urdf)
    tab.shows("what its URDF does not say")
    tab.shows("by which the driver makes an effort of a current")
    tab.click("Write the robot file")
    tab.shows("nominal_torque_constant")
    file = home / ".ros/proprio_ros/robots/my_arm.yaml"
    for number, _ in enumerate(boxes := tab.does(NUMBERS)):
        tab.does(f"document.querySelectorAll('.page input[type=number]')[{number}].focus()")
        tab.call("Input.insertText", text=f"{0.25 + number}")
    assert boxes
    tab.click("Write the robot file")
    tab.shows(f"proprio live --robot {file}")
    robot = load_robot(file)
    stated = [drive.nominal_torque_constant for drive in robot.drive_trains.values()]
    assert 0.25 in stated
    assert not tab.said
    tab.close()


def test_names_for_a_screen_reader(shown: Shown, window: Browser) -> None:
    tab = window.tab()
    tab.open(shown.address)
    for page in ("Wizard", "Recordings", "History"):
        tab.click(page)
        tab.until("document.querySelectorAll('.page button, .page select').length > 0")
        nameless = (
            "[...document.querySelectorAll('.page button, .page a, .page select, .page input')].filter((it) => "
            "!(it.getAttribute('aria-label') || it.innerText.trim())).map((it) => it.outerHTML)"
        )
        assert tab.does(nameless) == [], page
    tab.close()


def ask(
    shown: Shown,
    method: str,
    path: str,
    body: bytes = b"",
    **headers: str,
) -> tuple[int, str]:
    """A request as a page of the pendant makes it, with other headers where they are given."""
    place = urlsplit(shown.base)
    door = http.client.HTTPConnection(place.hostname or "", place.port)
    usual = {"Cookie": shown.cookie, "Origin": shown.base, "Content-Length": str(len(body))}
    door.request(method, path, body, {**usual, **headers})
    answer = door.getresponse()
    text = answer.read().decode()
    door.close()
    return answer.status, text


def test_a_file_is_taken_once(shown: Shown, home: Path) -> None:
    path = f"/upload?name={quote('log 1.csv')}"
    assert ask(shown, "POST", path, TABLE) == (200, "")
    assert (home / ".ros/proprio_ros/uploads/log 1.csv").read_bytes() == TABLE
    status, text = ask(shown, "POST", path, TABLE)
    assert status == 403 and "is there already" in text


def test_strangers_and_odd_files_are_refused(shown: Shown, home: Path) -> None:
    before = sorted(home.rglob("*"))
    named = "/upload?name=b.csv"
    for path, headers in (
        (named, {"Cookie": "proprio_pendant=wrong"}),
        (named, {"Origin": "http://example.org"}),
        (named, {"Content-Length": str(MOST_BYTES + 1)}),
        (f"/upload?name={quote('../b.csv', safe='')}", {}),
        (f"/upload?name={quote('/tmp/b.csv', safe='')}", {}),
        ("/upload?name=b.exe", {}),
        ("/upload", {}),
    ):
        status, text = ask(shown, "POST", path, TABLE, **headers)
        assert status == 403 and len(text.splitlines()) == 1, (path, headers, text)
    assert sorted(home.rglob("*")) == before


def test_only_pages_of_answers_are_shown(shown: Shown, home: Path) -> None:
    (home / "work" / "other.html").write_text("<script>alert(1)</script>")
    (home / "secret.html").write_text("secret")
    (home / "work" / "link.html").symlink_to(home / "secret.html")
    for path in (
        "0/other.html",
        "0/link.html",
        "0/..%2fsecret.html",
        "0/%2e%2e/secret.html",
        "0//etc/passwd",
        "0/%2fetc%2fpasswd",
        f"0/{CUBE}/bag_mcap/metadata.yaml",
        "0/a%00b",
        "9/other.html",
        "-1/other.html",
    ):
        status, text = ask(shown, "GET", f"/kept/{path}")
        assert status in (403, 404), (path, text)
        assert "secret\n" not in text and "root:" not in text and "alert" not in text
