"""What is said of a good recording in which one known mistake was made: is the cause named, another one, or nothing at all?

    python test/benchmarks/mistakes.py [--recordings ../shared] [--arms pushes motions swings] [--only PATTERN] [--all] [--jobs N]

Pushes of the two simulated OpenManipulator-X, motions of simulated arms of six and seven joints (in N m and in A, from a robot
file and from a URDF alone), the real UR10e, and a real servo that is let go. Each is weighed by the command line as a user would,
with a baseline, a calibration, a reference or with none of these; then again with one mistake in what is weighed, or in all
recordings. ``--all`` prints every answer.
"""

from __future__ import annotations

import argparse
import contextlib
import fnmatch
import functools
import io
import json
import re
import tempfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from real import STS_OBJECT, UR10E_KG, cut, parser_of, pendulum, ur10e_file
from results import Results
from support.bends.messages import Bend, bent
from support.moved_arm import record_arm
from support.simulated import bag_in, stated, truth_of

from proprio_ros.cli import main as proprio
from proprio_ros.robot import load_robot

URDFS = Path(__file__).resolve().parents[2] / "urdf"


@dataclass(frozen=True)
class Question:
    """What is asked of which recordings; a mistake is made in ``loaded`` alone or in all of them."""

    arm: str
    way: str
    loaded: Path
    empty: tuple[Path, ...]
    truth_kg: float
    robot: str | None = None
    words: tuple[str, ...] = ()
    settings: dict[str, Any] = field(default_factory=dict)
    references: tuple[tuple[Path, float], ...] = ()
    # settings of the calibration, where they are others
    calibrated_with: tuple[str, ...] | None = None
    joint: str = ""  # that is bent where one is


@dataclass(frozen=True)
class Mistake:
    """One mistake, and the words by which its cause is named."""

    name: str
    cause: str
    bend: Callable[[Question], Bend] | None = None
    asked: Callable[[Question, Path], Question | None] | None = None
    everywhere: tuple[bool, ...] = (False, True)


def columns(
    quantity: str,
    factor: float,
    only: bool = False,
) -> Callable[[Question], Bend]:
    """Of joint states; commands are effort, too."""

    def of(question: Question) -> Bend:
        def bend(
            topic: str,
            time_ns: int,
            message: Any,
        ) -> tuple[int, Any]:
            if hasattr(message, "name") and len(getattr(message, quantity)):
                column = np.array([not only or name == question.joint for name in message.name])
                setattr(
                    message, quantity, np.where(column, factor, 1.0) * getattr(message, quantity)
                )
            elif quantity == "effort" and hasattr(message, "layout"):
                labels = [label for dim in message.layout.dim for label in dim.label.split(",")]
                if len(labels) != len(message.data):
                    labels = list(load_robot(question.robot or "open_manipulator_x").drive_trains)
                column = np.array([not only or name == question.joint for name in labels])
                message.data = np.where(column, factor, 1.0) * message.data
            return time_ns, message

        return bend

    return of


def renamed(_: Question) -> Bend:
    def bend(
        topic: str,
        time_ns: int,
        message: Any,
    ) -> tuple[int, Any]:
        if hasattr(message, "name"):
            message.name = [f"left_{name}" for name in message.name]
        for dim in getattr(getattr(message, "layout", None), "dim", ()):
            dim.label = (
                ",".join(f"left_{name}" for name in dim.label.split(",")) if dim.label else ""
            )
        return time_ns, message

    return bend


def stamped(
    factor: float,
    recorder: bool = False,
) -> Callable[[Question], Bend]:
    def of(_: Question) -> Bend:
        first: list[int] = []

        def bend(
            topic: str,
            time_ns: int,
            message: Any,
        ) -> tuple[int, Any]:
            first.append(time_ns)
            if hasattr(message, "header"):
                stamp = message.header.stamp
                whole = stamp.sec * 10**9 + stamp.nanosec
                stamp.sec, stamp.nanosec = divmod(
                    first[0] + round((whole - first[0]) * factor), 10**9
                )
            return first[0] + round((time_ns - first[0]) * factor) if recorder else time_ns, message

        return bend

    return of


def nothing(_: Question) -> Bend:
    return lambda topic, time_ns, message: (time_ns, message)


def rolled(question: Question, folder: Path) -> Question:
    """The robot stands on a wall, and nobody says so: the file's gravity is of an arm on the other."""
    return replace(question, words=(*question.words, "--set", "robot.gravity=[0,6.94,-6.94]"))


def other_arm(question: Question, folder: Path) -> Question | None:
    """The file of another arm whose joints are called alike."""
    others = {
        None: "omx_f",
        "ur5e": "ur10e",
        str(URDFS / "ur5e.urdf"): str(URDFS / "ur10e.urdf"),
    }
    return replace(question, robot=others[question.robot]) if question.robot in others else None


def off_centre(question: Question, folder: Path) -> Question:
    centre = np.array(question.settings.get("payload.com", [0.0, 0.0, 0.0])) + np.array(
        [0.1, 0.0, 0.0]
    )
    return replace(
        question,
        settings={**question.settings, "payload.com": centre.tolist()},
    )


def reference_times(factor: float) -> Callable[[Question, Path], Question | None]:
    def asked(question: Question, folder: Path) -> Question | None:
        if not question.references:
            return None
        return replace(
            question, references=tuple((bag, factor * kg) for bag, kg in question.references)
        )

    return asked


def swapped(question: Question, folder: Path) -> Question | None:
    if not question.empty:
        return None
    empty = (question.loaded, *question.empty[1:])
    # one loaded bag among several empty ones contradicts them and is left out: then the hand is as empty as it is
    truth_kg = -question.truth_kg if len(empty) == 1 else 0.0
    return replace(
        question,
        loaded=question.empty[0],
        empty=empty,
        truth_kg=truth_kg,
    )


MISTAKES = (
    Mistake("none", "", nothing, everywhere=(False,)),
    Mistake("effort, sign of all joints", r"\bsign", columns("effort", -1.0)),
    Mistake("effort, sign of one joint", r"\bsign", columns("effort", -1.0, True)),
    Mistake("effort x 1000", r"\bunit", columns("effort", 1000.0)),
    Mistake("effort / 1000", r"\bunit", columns("effort", 0.001)),
    Mistake("effort of one joint x 2", r"\bunit|torque constant", columns("effort", 2.0, True)),
    Mistake("positions in degrees", "degree", columns("position", 180.0 / np.pi)),
    Mistake(
        "position, sign of one joint", r"\bsign|axis|direction", columns("position", -1.0, True)
    ),
    Mistake("velocities in deg/s", "velocit", columns("velocity", 180.0 / np.pi)),
    Mistake("names prefixed", "prefix", renamed),
    Mistake("header stamps x 1000", "stamp|clock", stamped(1000.0)),
    Mistake("header stamps / 1000", "stamp|clock", stamped(0.001)),
    Mistake("all times x 1000", "stamp|clock|Hz|period", stamped(1000.0, True)),
    Mistake("all times / 1000", "stamp|clock|Hz|period", stamped(0.001, True)),
    Mistake("base rolled by 45 degrees", "gravity|base", asked=rolled, everywhere=(True,)),
    Mistake("another arm's file", "URDF|another arm", asked=other_arm, everywhere=(True,)),
    Mistake(
        "payload.com off by 0.1 m", r"payload\.com|centre", asked=off_centre, everywhere=(False,)
    ),
    Mistake(
        "reference stated x 1.2",
        "reference",
        asked=reference_times(1.2),
        everywhere=(False,),
    ),
    Mistake(
        "reference stated x 2",
        "reference",
        asked=reference_times(2.0),
        everywhere=(False,),
    ),
    Mistake(
        "reference stated x 1000", "reference", asked=reference_times(1000.0), everywhere=(False,)
    ),
    Mistake(
        "empty and loaded swapped",
        "mixed up|swapped|lighter|in the hand",
        asked=swapped,
        everywhere=(False,),
    ),
)


OUTCOMES = {
    "cause": "refused, its cause named",
    "right": "answered, and right",
    "wide": "too wide",
    "other": "refused for another cause",
    "wrong_said": "answered, wrong, and its cause named",
    "wrong": "answered and wrong",
}


def said(words: list[str]) -> tuple[int, dict[str, Any], str]:
    """Exit code, what --json prints, and what goes to stderr."""
    out = io.StringIO()
    err = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = proprio([*words, "--json"])
    return code, json.loads(out.getvalue() or "{}"), err.getvalue()


@functools.cache
def calibrated(*words: str) -> tuple[int, str, str]:
    """Exit code, what was said, and the file; what was asked before is not asked again."""
    file = Path(tempfile.mkdtemp()) / "calibration.yaml"
    code, told, err = said([*words, "--output", str(file)])
    return code, " | ".join([*told.get("reasons", []), *told.get("notes", []), err]), str(file)


def setting(settings: dict[str, Any]) -> list[str]:
    return [
        word for key, value in settings.items() for word in ("--set", f"{key}={json.dumps(value)}")
    ]


def answer(
    question: Question, folder: Path
) -> tuple[str, float | None, tuple[float, float] | None, str]:
    """Verdict, mass, interval and all that was said."""
    common = [*question.words, *setting(question.settings)]
    robot = ["--robot", question.robot] if question.robot else []
    words = [
        "replay",
        str(question.loaded),
        "--probe",
        "payload",
        *common,
    ]
    text = ""
    if question.way == "baseline":
        words += [*robot, "--baseline", *map(str, question.empty)]
    elif question.way == "alone":
        words += robot
    else:
        references = [f"{bag}={kg}" for bag, kg in question.references]
        own = common if question.calibrated_with is None else list(question.calibrated_with)
        calibrate = [
            "calibrate",
            *map(str, question.empty),
            *robot,
            *own,
        ]
        code, text, file = calibrated(
            *calibrate, *(["--reference", *references] if references else [])
        )
        if code:
            return "refused" if code == 3 else "bad input", None, None, f"calibrate: {text}"
        words += ["--calibration", file]
    code, told, err = said(words)
    text += " || " + " | ".join([*told.get("reasons", []), *told.get("notes", []), err])
    value = next((each for each in told.get("estimates", []) if each["name"] == "payload_mass"), {})
    verdict = {0: "accepted", 2: "bad input"}.get(code, "refused")
    return verdict, value.get("value"), value.get("ci95"), text


def judged(
    mistake: Mistake,
    truth_kg: float,
    verdict: str,
    interval: Any,
    text: str,
) -> str:
    named = bool(mistake.cause) and re.search(mistake.cause, text) is not None
    if verdict == "accepted":
        holds = interval is not None and interval[0] <= truth_kg <= interval[1]
        return "right" if holds else "wrong_said" if named else "wrong"
    if not named and "explains the recording, wider than" in text:
        return "wide"
    return "cause" if named else "other"


def made(
    question: Question,
    mistake: Mistake,
    everywhere: bool,
    folder: Path,
) -> Question | None:
    """The question with the mistake in it."""
    if mistake.asked is not None:
        return mistake.asked(question, folder)
    assert mistake.bend is not None
    kept: dict[Path, Path] = {}

    def changed(bag: Path) -> Path:
        if bag not in kept:
            kept[bag] = bent(
                folder / f"bag_{len(kept)}",
                mistake.bend(question),
                bag,
            )  # type: ignore[misc]
        return kept[bag]

    loaded = changed(question.loaded)
    if not everywhere:
        return replace(question, loaded=loaded)
    if question.way == "alone":
        return None
    references = tuple((changed(bag), kg) for bag, kg in question.references)
    return replace(
        question, loaded=loaded, empty=tuple(map(changed, question.empty)), references=references
    )


def pushes(shared: Path) -> Iterator[Question]:
    for level in ("realistic_s00",):
        root = shared / "recordings" / level
        empty = tuple(bag_in(folder) for folder in sorted(root.glob("empty_*")))
        weights = [
            root / f"fixed_reference_100g_{name}"
            for name in ("joint3_x1", "joint2_x2", "joint2_x3")
        ]
        weights = [folder for folder in weights if folder.is_dir()]
        known = tuple((bag_in(folder), 0.1) for folder in weights)
        for name in ("fixed_heavy_cube_23g_joint3_x0", "fixed_heavy_ball_50g_joint3_x1"):
            if not (root / name).is_dir():
                continue
            truth = truth_of(root / name)
            mass = truth["payload"]["mass"]
            facts = stated(truth)
            joint = "joint3" if "joint3" in name else "joint2"
            asked = Question(
                f"push {level}", "alone", bag_in(root / name), (), mass, settings=facts, joint=joint
            )
            yield asked
            own: tuple[str, ...] = ()
            yield replace(asked, way="calibrated", empty=empty, calibrated_with=own)
            facts = stated(truth_of(weights[0])) if weights else {}
            own = tuple(setting(facts))
            if known:
                yield replace(
                    asked, way="referenced", empty=empty, references=known, calibrated_with=own
                )


@dataclass(frozen=True)
class Moved:
    """A simulated arm that moves, and how: what it holds, what is known to be held for reference [kg], and its drive trains."""

    name: str
    hand: str
    kg: float
    reference_kg: float
    middle: Sequence[float] | None
    friction_N_m: float
    rotor_kg_m2: float
    units: tuple[str, ...]


MOVED = (
    Moved("ur5e", "tool0", 2.0, 1.0, (0.0, -1.2, 1.4, -0.5, 0.5, 0.0), 0.5, 0.05, ("N.m", "A")),
    Moved("openarm", "", 0.6, 0.3, None, 0.1, 0.01, ("N.m",)),
)


def motions(shared: Path, folder: Path) -> Iterator[Question]:
    """Simulated arms of six and seven joints, and the UR10e."""
    for arm in MOVED:
        for unit in arm.units:
            yield from _moved(arm, unit, folder)
    real = shared / "recordings_real"
    bags = {
        name: cut(real / f"ur10e_{name}_14", folder / f"ur10e_{name}", 0.0, 25.0)
        for name in ("loaded", "empty")
    }
    yield Question(
        "UR10e",
        "baseline",
        bags["loaded"],
        (bags["empty"],),
        UR10E_KG,
        str(ur10e_file(real, folder)),
        ("--effort-unit", "A"),
        joint="shoulder_lift_joint",
    )


def _moved(
    arm: Moved,
    unit: str,
    folder: Path,
) -> Iterator[Question]:
    """By an empty recording, and by a known load as well; the UR5e with efforts in N m by its URDF."""
    robot = load_robot(arm.name)
    urdf = URDFS / f"{arm.name}.urdf"
    hand = arm.hand or robot.payload_frame
    constants = {
        joint: 1.0 if unit == "N.m" else drive.torque_constant.value
        for joint, drive in robot.drive_trains.items()
        if robot.model.joint(joint).kind != "prismatic"
    }
    bags = {}
    for number, (what, load) in enumerate(
        (("empty", 0.0), ("loaded", arm.kg), ("reference", arm.reference_kg))
    ):
        bags[what] = record_arm(
            folder / f"{arm.name}_{unit}_{what}",
            urdf,
            constants,
            hand,
            load,
            number,
            robot_seed=3,
            middle=arm.middle,
            friction_N_m=arm.friction_N_m,
            rotor_kg_m2=arm.rotor_kg_m2,
        )
    by_urdf = unit == "N.m" and arm.name == "ur5e"
    asked = Question(
        f"{arm.name} {unit}{' (URDF)' if by_urdf else ''}",
        "baseline",
        bags["loaded"],
        (bags["empty"],),
        arm.kg,
        str(urdf) if by_urdf else arm.name,
        ("--effort-unit", unit, "--set", f"payload.frame={hand}"),
        joint=list(constants)[1],
    )
    yield asked
    yield replace(asked, way="referenced", references=((bags["reference"], arm.reference_kg),))


def swings(shared: Path, folder: Path) -> Iterator[Question]:
    real = shared / "recordings_real"
    for servo, known in (("sts3215", (0.741, 1.168)), ("sts3250", (0.741, 1.168))):
        robot = str(
            pendulum(folder, servo, 0.001, 0.1, "torque_constant_N_m_per_A: {value: 1.0, std: 0.5}")
        )
        loads = tuple((real / f"{servo}_release_{kg:.3f}kg", kg) for kg in known)
        facts = {
            key: json.loads(value) for key, value in (word.split("=") for word in STS_OBJECT[1::2])
        }
        loaded = real / f"{servo}_release_0.969kg"
        yield Question(
            servo, "referenced", loaded, (), 0.969, robot, (), facts, loads, joint="pendulum"
        )


def asked_of(
    arms: str,
    options: argparse.Namespace,
) -> list[tuple[str, str]]:
    """What each mistake came to, on all recordings of some kind."""
    found = []
    with tempfile.TemporaryDirectory() as made_in:
        root = Path(made_in)
        shared = options.recordings
        kinds: dict[str, Callable[[], Iterator[Question]]] = {
            "pushes": lambda: pushes(shared),
            "motions": lambda: motions(shared, root),
            "swings": lambda: swings(shared, root),
        }
        for question, mistake in product(kinds[arms](), MISTAKES):
            for everywhere in mistake.everywhere:
                where = "all" if everywhere else "one"
                name = f"{question.arm}, {question.way}{'' if question.empty else ' only'}, {mistake.name}, {where}"
                if not fnmatch.fnmatch(name, options.only):
                    continue
                with tempfile.TemporaryDirectory() as scratch:
                    asked = made(question, mistake, everywhere, Path(scratch))
                    if asked is None:
                        continue
                    verdict, value, interval, text = answer(asked, Path(scratch))
                outcome = judged(mistake, asked.truth_kg, verdict, interval, text)
                found.append((mistake.name, outcome))
                if options.all or outcome.startswith("wrong"):
                    grams = (
                        ""
                        if value is None
                        else f" {1e3 * value:.1f} for {1e3 * asked.truth_kg:.1f} g"
                    )
                    print(
                        f"{outcome:12s} {name}: {verdict}{grams}; {text.replace(scratch, '')[:1200]}",
                        flush=True,
                    )
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    parser = parser_of(__doc__)
    parser.add_argument(
        "--arms",
        nargs="+",
        choices=("pushes", "motions", "swings"),
        default=["pushes", "motions", "swings"],
    )
    parser.add_argument(
        "--recordings", type=Path, default=Path(__file__).resolve().parents[3] / "shared"
    )
    parser.add_argument("--only", default="*", help="arm, way and mistake, as a pattern")
    parser.add_argument("--all", action="store_true", help="print every answer")
    parser.add_argument("--jobs", type=int, default=2, help="processes: one for each kind of arm")
    options = parser.parse_args(arguments)
    results = Results(__file__, options.json, arguments)
    results.table(
        "mistakes",
        {
            "mistake": "{mistake}",
            **{title: f"{{{key}}}" for key, title in OUTCOMES.items()},
        },
    )
    counts = {mistake.name: dict.fromkeys(OUTCOMES, 0) for mistake in MISTAKES}
    with ProcessPoolExecutor(min(options.jobs, len(options.arms))) as pool:
        for found in pool.map(partial(asked_of, options=options), options.arms):
            for mistake, outcome in found:
                counts[mistake][outcome] += 1
    for name, outcomes in counts.items():
        if any(outcomes.values()):
            results.row("mistakes", mistake=name, **outcomes)
    total = {key: sum(outcomes[key] for outcomes in counts.values()) for key in OUTCOMES}
    results.row("mistakes", mistake="all", **total)
    results.keep()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
