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


def answers(roots: list[Path]) -> Iterator[tuple[str, dict[str, Any]]]:
    """A name and an answer for each recording, and for each robot's calibration."""
    for root in roots:
        for session, folders in robots(root):
            here = f"{root.name}/{session}"
            stem = {folder: folder.name.removeprefix(f"{session}_") for folder in folders}
            pick = {
                kind: [folder for folder in folders if stem[folder].startswith(kind)]
                for kind in (
                    "empty_",
                    "squeeze_empty_",
                    "fixed_",
                    "container_no_sphere",
                    "container_sphere",
                    "squeeze_",
                )
            }
            with tempfile.TemporaryDirectory() as scratch:
                calibration = str(Path(scratch) / "calibration.yaml")
                empty = [bag_of(folder) for folder in (*pick["empty_"], *pick["squeeze_empty_"])]
                calibrated: list[str] = []
                if len(empty) > 3:
                    yield (
                        f"{here}/calibrate",
                        answer(["calibrate", *empty, "--output", calibration]),
                    )
                    if Path(calibration).exists():
                        calibrated = ["--calibration", calibration]
                        # its first lines name the date
                        text = re.sub(
                            r"^#.*\n", "", Path(calibration).read_text(), flags=re.MULTILINE
                        )
                        yield f"{here}/calibration file", {"text": text.replace(scratch, "")}
                for folder in (*pick["fixed_"], *pick["empty_"]):
                    words = [
                        "replay",
                        bag_of(folder),
                        "--probe",
                        "payload",
                        *facts_of(folder),
                    ]
                    yield f"{here}/{stem[folder]}", answer(words)
                    if calibrated:
                        yield f"{here}/{stem[folder]} calibrated", answer([*words, *calibrated])
                pooled = [folder for folder in pick["fixed_"] if "heavy_ball" in folder.name]
                if len(pooled) > 1:
                    words = [
                        "replay",
                        *map(bag_of, pooled),
                        "--probe",
                        "payload",
                        *facts_of(pooled[0]),
                        *calibrated,
                    ]
                    yield f"{here}/heavy balls together", answer(words)
                baseline = [bag_of(folder) for folder in pick["container_no_sphere"]]
                for folder in pick["container_sphere"]:
                    words = [
                        "replay",
                        bag_of(folder),
                        "--probe",
                        "container",
                        *facts_of(folder),
                        *calibrated,
                    ]
                    yield f"{here}/{stem[folder]}", answer([*words, "--baseline", *baseline])
                for folder in pick["squeeze_"]:
                    if folder not in pick["squeeze_empty_"] and stem[folder] != "squeeze_empty":
                        words = [
                            "replay",
                            bag_of(folder),
                            "--probe",
                            "softness",
                            *facts_of(folder),
                            *calibrated,
                        ]
                        yield f"{here}/{stem[folder]}", answer(words)
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
