"""The same answers as before? Every recording's answer, bit for bit, before and after a change of the code.

``python test/benchmarks/answers.py write FILE.json [FOLDER ...]`` has the command line answer for every recording below the folders
(default: ``bags`` and ``../shared/recordings``) and keeps what it prints; run it in the old checkout and in the new one.
``... compare OLD.json NEW.json`` lists every difference, or prints "identical"; with ``--numbers`` sentences may differ. Times
are not compared, and neither are keys that only one of the two has: those are listed once, by name.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import re
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

for library in ("OPENBLAS", "OMP", "MKL"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")

REPOSITORY = Path(__file__).resolve().parents[2]
FOLDERS = (REPOSITORY / "bags", REPOSITORY.parent / "shared" / "recordings")
# the fingerprint is of a file that names the date and a folder of this run
NOT_COMPARED = {"timing_s", "elapsed_s", "version", "schema", "output", "fingerprint"}
SENTENCES = {"reasons", "reason", "notes", "assumptions"}


def answer(arguments: list[str]) -> dict[str, Any]:
    """What the command line prints for ``arguments``, its exit code, and its last word where it refuses."""
    from proprio_ros.cli import main

    out = io.StringIO()
    err = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main([*arguments, "--json"])
    text = out.getvalue()
    return {
        "code": code,
        "said": json.loads(text) if text else None,
        "error": err.getvalue() if code == 2 else "",
    }


def bag_of(folder: Path) -> str:
    return str(sorted(folder.glob("bag_*"))[0])


def setting(**facts: Any) -> list[str]:
    """``--set`` words."""
    return [
        word
        for key, value in facts.items()
        for word in ("--set", f"{key.replace('__', '.')}={json.dumps(value)}")
    ]


def facts_of(folder: Path) -> list[str]:
    """Where the object of a recording sits and what shape it has, never its mass."""
    truth = json.loads((folder / "truth.json").read_text())
    if truth["container"]:
        box = truth["container"]
        return setting(
            container__inner_size=[2.0 * half for half in box["inner_half"]],
            container__centre=box["centre"],
            sphere__radius=box["sphere_radius"],
        )
    if truth["cube"]:
        return setting(block__size=[truth["cube"]["side"]] * 3)
    payload = truth["payload"]
    if not payload or payload["mass"] == 0.0:
        return setting(payload__shape="point")
    return setting(
        payload__com=payload["offset"],
        payload__inertia_per_mass=[value / payload["mass"] for value in payload["inertia"]],
    )


def robots(root: Path) -> Iterator[tuple[str, list[Path]]]:
    """Each simulated robot below a folder, with its recordings."""
    found: dict[str, list[Path]] = {}
    for truth in sorted(root.rglob("truth.json")):
        folder = truth.parent
        # a container and what is in it: contents.py asks
        if session := json.loads(truth.read_text()).get("session"):
            found.setdefault(session, []).append(folder)
    yield from found.items()


KINDS = (
    "empty_",
    "squeeze_empty_",
    "fixed_",
    "container_no_sphere",
    "container_sphere",
    "squeeze_",
)
"""What names of recordings begin with, after their session's."""
Named = tuple[str, dict[str, Any]]


class Session:
    """The recordings of one simulated robot.

    Attributes:
        here: What names of its answers begin with.
        stem: A folder's name without the session's.
        pick: Folders by kind.
        calibrated: Words that name its calibration, once there is one.
    """

    def __init__(self, here: str, session: str, folders: list[Path]) -> None:
        self.here = here
        self.stem = {folder: folder.name.removeprefix(f"{session}_") for folder in folders}
        self.pick = {
            kind: [folder for folder in folders if self.stem[folder].startswith(kind)]
            for kind in KINDS
        }
        self.calibrated: list[str] = []

    def calibrate(self, scratch: str) -> Iterator[Named]:
        """The calibration, and its file without the date and without the folder that it lies in."""
        calibration = Path(scratch) / "calibration.yaml"
        empty = [bag_of(folder) for folder in (*self.pick["empty_"], *self.pick["squeeze_empty_"])]
        if len(empty) <= 3:
            return
        yield (
            f"{self.here}/calibrate",
            answer(["calibrate", *empty, "--output", str(calibration)]),
        )
        if calibration.exists():
            self.calibrated = ["--calibration", str(calibration)]
            # its first lines name the date
            text = re.sub(r"^#.*\n", "", calibration.read_text(), flags=re.MULTILINE)
            yield f"{self.here}/calibration file", {"text": text.replace(scratch, "")}

    def payloads(self) -> Iterator[Named]:
        """Fixed objects and empty hands, without and with the calibration; heavy balls together, too."""
        for folder in (*self.pick["fixed_"], *self.pick["empty_"]):
            words = replay_words([folder], "payload")
            yield f"{self.here}/{self.stem[folder]}", answer(words)
            if self.calibrated:
                yield (
                    f"{self.here}/{self.stem[folder]} calibrated",
                    answer([*words, *self.calibrated]),
                )
        pooled = [folder for folder in self.pick["fixed_"] if "heavy_ball" in folder.name]
        if len(pooled) > 1:
            words = replay_words(pooled, "payload")
            yield f"{self.here}/heavy balls together", answer([*words, *self.calibrated])

    def containers(self) -> Iterator[Named]:
        """Spheres in a container, with the empty one beside them."""
        baseline = [bag_of(folder) for folder in self.pick["container_no_sphere"]]
        for folder in self.pick["container_sphere"]:
            words = [*replay_words([folder], "container"), *self.calibrated]
            yield f"{self.here}/{self.stem[folder]}", answer([*words, "--baseline", *baseline])

    def blocks(self) -> Iterator[Named]:
        """Blocks that were squeezed."""
        for folder in self.pick["squeeze_"]:
            if folder not in self.pick["squeeze_empty_"] and self.stem[folder] != "squeeze_empty":
                words = [*replay_words([folder], "softness"), *self.calibrated]
                yield f"{self.here}/{self.stem[folder]}", answer(words)


def replay_words(folders: list[Path], probe: str) -> list[str]:
    """``replay`` of recordings of one object, with what is known of it."""
    return [
        "replay",
        *map(bag_of, folders),
        "--probe",
        probe,
        *facts_of(folders[0]),
    ]


def answers(roots: list[Path]) -> Iterator[Named]:
    """A name and an answer for each recording, and for each robot's calibration."""
    for root in roots:
        for name, folders in robots(root):
            session = Session(f"{root.name}/{name}", name, folders)
            with tempfile.TemporaryDirectory() as scratch:
                yield from session.calibrate(scratch)
                yield from session.payloads()
                yield from session.containers()
                yield from session.blocks()
        text = root / "paper_heavy_ball"
        for profile in ("default", "paper") if text.is_dir() else ():
            yield (
                f"{root.name}/{text.name} {profile}",
                answer(["replay", str(text), "--probe", "payload", "--profile", profile]),
            )


def write(path: Path, roots: list[Path]) -> None:
    """Answer everything and keep it."""
    kept = {}
    for number, (name, said) in enumerate(answers(roots), start=1):
        kept[name] = said
        if sys.stderr.isatty() or number % 50 == 0:
            print(f"{number}: {name}", file=sys.stderr)
    path.write_text(json.dumps(kept, indent=1))
    print(f"{len(kept)} answers in {path}")


def differences(
    old: Any,
    new: Any,
    where: str,
    unshared: set[str],
    left_out: set[str],
) -> Iterator[str]:
    """Where two answers differ; keys that only one of them has go to ``unshared``."""
    if isinstance(old, dict) and isinstance(new, dict):
        unshared |= {
            f"{where.split('/')[-1].split(' ')[-1]}.{key}" for key in old.keys() ^ new.keys()
        }
        for key in sorted(old.keys() & new.keys() - left_out):
            yield from differences(old[key], new[key], f"{where}: {key}", unshared, left_out)
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for row, pair in enumerate(zip(old, new, strict=True)):
            yield from differences(*pair, f"{where}[{row}]", unshared, left_out)
    elif old != new:
        yield f"{where}\n    was {str(old)[:400]!r}\n    is  {str(new)[:400]!r}"


def compare(old: Path, new: Path, numbers: bool) -> int:
    """Print every difference; 1 if there is any."""
    before = json.loads(old.read_text())
    after = json.loads(new.read_text())
    unshared: set[str] = set()
    found = [
        line
        for name in sorted(before.keys() & after.keys())
        for line in differences(
            before[name],
            after[name],
            name,
            unshared,
            NOT_COMPARED | (SENTENCES if numbers else set()),
        )
    ]
    found += [f"{name}: only in one of them" for name in sorted(before.keys() ^ after.keys())]
    print("\n".join(found) if found else f"identical: {len(before)} answers")
    if unshared:
        print("keys that only one of them has:", ", ".join(sorted(unshared)))
    return int(bool(found))


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(required=True, dest="command")
    writing = commands.add_parser("write")
    writing.add_argument("file", type=Path)
    writing.add_argument(
        "folders", type=Path, nargs="*", default=[folder for folder in FOLDERS if folder.is_dir()]
    )
    comparing = commands.add_parser("compare")
    comparing.add_argument("files", type=Path, nargs=2)
    comparing.add_argument("--numbers", action="store_true", help="sentences may differ")
    options = parser.parse_args()
    if options.command == "write":
        write(options.file, options.folders)
        return 0
    return compare(*options.files, numbers=options.numbers)


if __name__ == "__main__":
    raise SystemExit(main())
