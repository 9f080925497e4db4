"""Files."""

from __future__ import annotations

from pathlib import Path

from support.known.bases import Files
from support.machines import REAL

from conformance.table import ACCEPTED, UNREADABLE, Bent, Row

_SECTION = "E. Files"
_PUSH = "push_light_ball_20g_joint3_calibrated"
_LOADED = ("loaded",)


def _edge(name: str):  # type: ignore[no-untyped-def]
    def make(folder: Path, files: Files) -> Files:
        return {**files, "loaded": REAL / "edge_bags" / name}

    make.__doc__ = f"`{name}` of rosbag2's own tests"
    return make


ROWS = (
    *(
        Row(
            name=f"compressed_file_alone_{'cut' if cut else 'whole'}",
            section=_SECTION,
            trouble="the recorder was killed: `.mcap.zstd` alone"
            + (", its end cut" if cut else ""),
            base=_PUSH,
            bends=(Bent("zstd_file_alone", {"cut": cut}, _LOADED),),
            verdicts=(ACCEPTED, UNREADABLE),
            cause=r"zstd",
            unsaid=r"[Nn]ot a bag",
        )
        for cut in (0, 5000)
    ),
    Row(
        name="chunk_of_impossible_length",
        section=_SECTION,
        trouble="a chunk says that it has 2^60 bytes",
        base=_PUSH,
        bends=(Bent("chunk_of_impossible_length", {}, _LOADED),),
        # the index says how long it is
        verdicts=(ACCEPTED, UNREADABLE),
        cause=r"chunk|damaged|bytes|length",
        unsaid=r"MemoryError",
    ),
    Row(
        name="no_indexes_no_summary",
        section=_SECTION,
        trouble="chunks without message indexes, and no summary",
        base=_PUSH,
        bends=(Bent("no_indexes_no_summary", {}, _LOADED),),
        verdicts=(ACCEPTED,),
    ),
    Row(
        name="metadata_missing",
        section=_SECTION,
        trouble="there is no metadata.yaml",
        base=_PUSH,
        bends=(Bent("metadata_missing", {}, _LOADED),),
        verdicts=(ACCEPTED,),
    ),
    Row(
        name="file_copied_alone",
        section=_SECTION,
        trouble="the one file was copied elsewhere under another name",
        base=_PUSH,
        bends=(Bent("renamed_file_alone", {}, _LOADED),),
        verdicts=(ACCEPTED,),
    ),
    *(
        Row(
            name=f"edge_{name}",
            section=_SECTION,
            trouble=trouble,
            base="ur10e",
            make=_edge(name),
            verdicts=(UNREADABLE,),
            cause=cause,
        )
        for name, trouble, cause in (
            ("sqlite_empty", "nothing was recorded", r"no messages|empty|holds no"),
            ("mcap_wrong_rmw", "messages are serialised otherwise", r"cdr"),
            ("mcap_service_events", "services alone were recorded", r"joint states|JointState"),
            ("sqlite_talker", "other topics alone were recorded", r"joint states|JointState"),
        )
    ),
)
