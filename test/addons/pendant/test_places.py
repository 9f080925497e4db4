"""What the pendant looks into, and what it takes: nothing outside of its folders, no link out of them, no odd file."""

from __future__ import annotations

import asyncio
import shutil
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

pytest.importorskip("nicegui")

from proprio_ros.addons.pendant import places as of_places
from proprio_ros.addons.pendant.pendant import DATA
from proprio_ros.addons.pendant.places import Places
from proprio_ros.errors import ConfigurationError

REPOSITORY = Path(__file__).resolve().parents[3]
BAG = REPOSITORY / "bags" / "realistic_s00_fixed_heavy_cube_23g_joint3" / "bag_mcap"
TABLE = b"time_s,joint1.pos\n0.0,0.1\n0.1,0.2\n"


@pytest.fixture
def places(tmp_path: Path) -> Places:
    begun = tmp_path / "begun"
    shutil.copytree(BAG, begun / "deep" / "bag")
    return Places(begun, tmp_path / "data")


async def _chunks(*parts: bytes) -> AsyncIterator[bytes]:
    for part in parts:
        yield part


def receive(places: Places, name: str, *parts: bytes, length: int | None = None) -> Path:
    whole = sum(map(len, parts)) if length is None else length
    return asyncio.run(places.receive(name, whole, _chunks(*parts)))


def test_the_folder_is_that_of_the_nodes() -> None:
    stated = (REPOSITORY / "config" / "identifier.yaml").read_text()
    assert f" data_directory: {DATA}\n" in stated


def test_it_shows_folders_and_recordings(places: Places) -> None:
    (places.begun / "notes.txt").write_text("nothing to weigh")
    (places.begun / ".hidden").mkdir()
    assert [(each.name, each.kind) for each in places.entries(places.begun)] == [("deep", "folder")]
    assert [(each.name, each.kind) for each in places.entries(places.begun / "deep")] == [
        ("bag", "bag")
    ]


@pytest.mark.parametrize(
    "named",
    [
        "/etc",
        "/",
        "/etc/passwd#1",
        "{begun}/..",
        "{begun}/../other",
        "{begun}x",
        "{begun}/deep/../../..",
        "a\0b",
        "{begun}/" + "x" * 300,
    ],
)
def test_no_other_folder_is_looked_into(places: Places, named: str) -> None:
    text = named.format(begun=places.begun)
    for look in (places.inside, places.recording, lambda path: places.entries(Path(path))):
        with pytest.raises(ConfigurationError) as refused:
            look(text)
        assert "\n" not in str(refused.value)


def test_no_link_leads_out(places: Places, tmp_path: Path) -> None:
    shutil.copytree(BAG, tmp_path / "secret")
    (places.begun / "link").symlink_to(tmp_path / "secret")
    (places.begun / "round").symlink_to(places.begun / "round")
    assert [each.name for each in places.entries(places.begun)] == ["deep"]
    for name in ("link", "link/bag_mcap.mcap", "round"):
        with pytest.raises(ConfigurationError):
            places.recording(places.begun / name)
    inner = places.begun / "deep" / "bag" / "other.mcap"
    inner.symlink_to(tmp_path / "secret" / "bag_mcap.mcap")
    with pytest.raises(ConfigurationError, match="outside of the folders"):
        places.recording(places.begun / "deep" / "bag")


def test_a_table_is_taken(places: Places) -> None:
    kept = receive(places, "log 1.csv", TABLE[:9], TABLE[9:])
    assert kept == places.uploads / "log 1.csv"
    assert kept.read_bytes() == TABLE
    with pytest.raises(ConfigurationError, match="is there already"):
        receive(places, "log 1.csv", b"other")
    assert kept.read_bytes() == TABLE


@pytest.mark.parametrize(
    ("name", "content", "length", "says"),
    [
        ("../evil.csv", TABLE, None, "letters, digits"),
        ("/etc/x.csv", TABLE, None, "letters, digits"),
        (".bashrc.csv", TABLE, None, "letters, digits"),
        ("a\nb.csv", TABLE, None, "letters, digits"),
        ("", TABLE, None, "no recording"),
        ("page.html", TABLE, None, "no recording"),
        ("run.sh", TABLE, None, "no recording"),
        ("x" * 200 + ".csv", TABLE, None, "letters, digits"),
        ("a.csv", TABLE, of_places.MOST_BYTES + 1, "copy it into the folder"),
        ("a.csv", TABLE, -1, "copy it into the folder"),
        ("a.csv", TABLE, 5, "as long as it was announced"),
        ("a.csv", TABLE, 500, "as long as it was announced"),
        ("a.csv", b"", None, "is empty"),
        ("a.csv", b"name,colour\nball,red\n", None, "no columns of times"),
        ("a.csv", bytes(range(256)) * 40, None, "no columns of times"),
    ],
)
def test_odd_files_are_refused_in_a_sentence(
    places: Places, name: str, content: bytes, length: int | None, says: str
) -> None:
    with pytest.raises(ConfigurationError, match=says) as refused:
        receive(places, name, content, length=length)
    assert "\n" not in str(refused.value)
    left = list(places.uploads.iterdir()) if places.uploads.exists() else []
    assert not left


def test_a_full_folder_takes_nothing(places: Places, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(of_places, "MOST_KEPT", 3 * len(TABLE) // 2)
    receive(places, "a.csv", TABLE)
    with pytest.raises(ConfigurationError, match="is full"):
        receive(places, "b.csv", TABLE)


def test_uploads_cannot_be_led_elsewhere(places: Places, tmp_path: Path) -> None:
    places.data.mkdir()
    (tmp_path / "secret").mkdir()
    places.uploads.symlink_to(tmp_path / "secret")
    with pytest.raises(ConfigurationError, match="outside of the folders"):
        receive(places, "a.csv", TABLE)
    assert not list((tmp_path / "secret").iterdir())
