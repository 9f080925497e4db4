"""Bytes of bags that went wrong: of the path of a written bag the path of another one."""

from __future__ import annotations

import shutil
from pathlib import Path

from support.bends.bend import Right, Rng, bend, between, one_of

_MAGIC = 8  # bytes of an MCAP file before its first record
_CHUNK = 6
_INDEX = 7
_DATA_END = 15


def _file(bag: Path) -> Path:
    return next(bag.glob("*.mcap"))


def _records(content: bytes) -> list[tuple[int, int, int]]:
    """Of each record its opcode, where it begins and where it ends."""
    found = []
    at = _MAGIC
    while at + 9 <= len(content) - _MAGIC:
        length = int.from_bytes(
            content[at + 1 : at + 9],
            "little",
        )
        found.append((content[at], at, at + 9 + length))
        at += 9 + length
    return found


@bend(
    "files",
    Right(cause="zstd|compressed"),
    needs="",
    cut=one_of((0, 100, 5000)),
)
def zstd_file_alone(bag: Path, rng: Rng, cut: int) -> Path:
    """The recorder was killed: the file, compressed as a whole, is all there is, and its end is cut off."""
    import sys

    if sys.version_info >= (3, 14):
        from compression import zstd
    else:
        from backports import zstd
    file = _file(bag)
    packed = zstd.compress(file.read_bytes())
    folder = bag.with_name(f"{bag.name}_killed")
    folder.mkdir()
    (folder / f"{file.name}.zstd").write_bytes(packed[: len(packed) - cut])
    return folder


@bend(
    "files",
    Right(told=False, cause="chunk|damaged|length|readable"),
    needs="",
)
def chunk_of_impossible_length(bag: Path, rng: Rng) -> Path:
    """A chunk says that it has 2^60 bytes."""
    file = _file(bag)
    content = bytearray(file.read_bytes())
    chunk = next(each for each in _records(bytes(content)) if each[0] == _CHUNK)
    # times of 8 bytes each, then the size of what is in it
    at = chunk[1] + 9 + 16
    content[at : at + 8] = (2**60).to_bytes(8, "little")
    file.write_bytes(bytes(content))
    return bag


@bend(
    "files",
    Right(told=True, cause="readable|summary|index"),
    needs="",
)
def no_indexes_no_summary(bag: Path, rng: Rng) -> Path:
    """Chunks without message indexes, and no summary."""
    file = _file(bag)
    content = file.read_bytes()
    kept = [content[:_MAGIC]]
    for opcode, begin, end in _records(content):
        if opcode == _INDEX:
            continue
        kept.append(content[begin:end])
        if opcode == _DATA_END:
            break
    footer = bytes([2]) + (20).to_bytes(8, "little") + bytes(20)
    file.write_bytes(b"".join([*kept, footer, content[:_MAGIC]]))
    (bag / "metadata.yaml").unlink()
    return bag


@bend(
    "files",
    Right(cause="readable|killed|cut|reindex|recover"),
    needs="",
    share=between(0.3, 0.95),
)
def file_cut(bag: Path, rng: Rng, share: float) -> Path:
    """The recorder was killed: the file ends in the middle, and metadata are missing."""
    file = _file(bag)
    content = file.read_bytes()
    file.write_bytes(content[: int(share * len(content))])
    (bag / "metadata.yaml").unlink()
    return bag


@bend(
    "files",
    Right(told=True, cause="readable"),
    needs="",
)
def metadata_missing(bag: Path, rng: Rng) -> Path:
    """There is no metadata.yaml."""
    (bag / "metadata.yaml").unlink()
    return bag


@bend(
    "files",
    Right(told=True, cause="readable"),
    needs="",
)
def renamed_file_alone(bag: Path, rng: Rng) -> Path:
    """The one file was copied elsewhere under another name."""
    other = bag.with_name(f"{bag.name}_copied.mcap")
    shutil.copy(_file(bag), other)
    return other
