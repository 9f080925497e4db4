"""How long a new computer takes: ``python test/benchmarks/first_time.py``, fresh environments, nothing cached, then a demo.

Each row has the time on the wall and that of processors: others may use the computer. What is downloaded comes from where
pip is told to look; on a slow line that is the longest part, and none of this table's.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from results import REPOSITORY, Results, parser_of

EXTRAS = ("", "[ros]", "[ros,sim,test]")
INSTALL_GOAL_S = 20.0
DEMO_GOAL_S = 30.0
COLUMNS = {
    "what": "{what}",
    "wall, s": "{wall_s:.0f}",
    "of processors, s": "{cpu_s:.0f}",
    "on disk, MB": "{disk_mb:.0f}",
}


def timed(command: list[str], **environment: str) -> dict[str, float]:
    """Seconds on the wall and of all processors."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    began = time.monotonic()
    subprocess.run(
        command,
        cwd=REPOSITORY,
        env={**os.environ, **environment},
        check=True,
        stdout=subprocess.DEVNULL,
    )
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu_s = used.ru_utime + used.ru_stime - before.ru_utime - before.ru_stime
    return {"wall_s": time.monotonic() - began, "cpu_s": cpu_s}


def megabytes(folder: Path) -> float:
    return (
        sum(
            path.stat().st_size
            for path in folder.rglob("*")
            if path.is_file() and not path.is_symlink()
        )
        / 1e6
    )


def main() -> int:
    """Print and keep; 1 when the processors take longer than the goal for the installation."""
    options = parser_of(__doc__).parse_args()
    results = Results(__file__, options.json)
    results.table("first", COLUMNS)
    slow = 0
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        for extra in EXTRAS:
            own = folder / f"venv{extra.count(',') + bool(extra)}"
            pip = [
                str(own / "bin" / "python"),
                "-m",
                "pip",
                "install",
                "--quiet",
                "--no-cache-dir",
                "-e",
                f".{extra}",
            ]
            made = timed([sys.executable, "-m", "venv", str(own)])
            spent = timed(pip, PYTHONPATH="")
            both = {key: made[key] + spent[key] for key in made}
            slow += both["cpu_s"] > INSTALL_GOAL_S
            results.row(
                "first",
                what=f"`python3 -m venv` and `pip install -e '.{extra}'`",
                **both,
                disk_mb=megabytes(own),
            )
        demo = [
            str(own / "bin" / "proprio"),
            "demo",
            "--output",
            str(folder / "demo"),
        ]
        cache = folder / "kernels"
        for words in ("the first `proprio demo`, nothing compiled", "the next one"):
            spent = timed(demo, PYTHONPATH="", WARP_CACHE_PATH=str(cache))
            results.row(
                "first",
                what=words,
                **spent,
                disk_mb=megabytes(cache),
            )
    goals = f"{INSTALL_GOAL_S:g} s for an installation, {DEMO_GOAL_S:g} s for the first demo"
    print(f"\ngoals: {goals}, on two cores that nobody else uses")
    results.keep()
    return 1 if slow else 0


if __name__ == "__main__":
    sys.exit(main())
