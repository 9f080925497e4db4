"""What an arm of hobby servos says of its load where it stands: two poses, each held for 3 s, and the way between them.

The arms of `so101.py` (30 Hz, goals and positions alone), whose joints stick here: dry friction is up to half greater at rest and
holds a joint, gears lose up to 15 % of what they carry, and the firmware has a dead band of 0 to 2 counts that no file states. Two
empty motions and one with 150 g calibrate; then the arm takes a load, goes to two poses at random, and stands. Asked are a
recording of each pose, from half a second before the arm arrives, both together; and the whole as one recording. In one more pose
the hand is empty at first, and holds the load after 3 s: there the running estimate is asked, 2 s later. The last questions have
something wrong: servos of another gain than was calibrated, asked all three ways.

    python test/benchmarks/at_rest.py [--arms 12] [--first 500] [--jobs 1]
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from results import Results, each_answer, parser_of
from so101 import COUNT_RAD, GAIN, JOINTS, MIDDLE, REACH, SETTINGS, Arm, write

from proprio_ros.errors import ProprioError
from proprio_ros.identification.estimate import Estimate, Verdict
from proprio_ros.identification.regression.online import OnlineEstimate
from proprio_ros.live.online_estimator import OnlineFeed
from proprio_ros.pipeline.calibrate import calibrate_from_bags
from proprio_ros.pipeline.replay import replay
from proprio_ros.pipeline.request import Options, request_of
from proprio_ros.probes import probe_at_work

ASKED_KG = (0.0, 0.1, 0.3, 0.6, 0.9)
KNOWN_KG = 0.15
HELD_S = 3.0
ARRIVES_S = 0.5
RATE_HZ = 30.0
STANDS = "two poses"
WHOLE = "and the way there"
RUNNING = "running estimate"
OTHER_GAINS = (0.5, 0.67, 0.8, 1.25, 1.5, 2.0)
"""Times the gain that was calibrated."""
STILL = "put into a still hand"
OF_GAIN = {"poses": STANDS, "whole": WHOLE, "running": RUNNING}


class Sticky(Arm):
    """An arm whose joints stick."""

    def __init__(self, random: np.random.Generator) -> None:
        super().__init__(random)
        self.sticks = random.uniform(0.05, 0.5)
        self.dead_band_rad = COUNT_RAD * float(random.integers(0, 3))

    def stood(
        self,
        load_kg: float,
        random: np.random.Generator,
        poses: int = 2,
    ) -> tuple[dict[str, np.ndarray], list[dict[str, np.ndarray]]]:
        """On the way to poses at random, and in them; the whole, and what was recorded of each pose."""
        goals_at = [0.0]
        goals = [MIDDLE + REACH * random.uniform(-1.0, 1.0, len(JOINTS))]
        for _ in range(poses):
            there_s = goals_at[-1] + random.uniform(1.0, 2.0)
            goals_at += [there_s, there_s + HELD_S]
            goals += [MIDDLE + REACH * random.uniform(-1.0, 1.0, len(JOINTS))] * 2
        dry = self.coulomb * random.normal(1.0, 0.05, len(JOINTS))
        rows = self.followed(
            load_kg,
            random,
            RATE_HZ,
            goals_at[-1],
            dry,
            goals_at,
            goals,
        )
        of_poses = [
            (rows["t"] >= there_s - ARRIVES_S) & (rows["t"] <= there_s + HELD_S)
            for there_s in goals_at[1::2]
        ]
        return rows, [{name: values[of] for name, values in rows.items()} for of in of_poses]


def new_feed(output: Path) -> OnlineFeed:
    """The running estimate of a calibrated arm."""
    request = request_of(Options(calibration=output, settings=SETTINGS))
    return OnlineFeed(
        probe_at_work(),
        request.robot,
        request.facts,
        request.locked,
    )


def fed(
    feed: OnlineFeed, rows: dict[str, np.ndarray], begins_s: float = 0.0
) -> OnlineEstimate | None:
    """What it says at the end of a recording that begins then; None: nothing."""
    told = None
    for t, goal, position in zip(rows["t"] + begins_s, rows["goal"], rows["position"], strict=True):
        feed.stall.hear_goals(float(t), JOINTS, goal.tolist())
        told = feed.add(float(t), JOINTS, position.tolist(), [], "") or told
    return told


def put_in(
    arm: Sticky,
    kg: float,
    random: np.random.Generator,
    output: Path,
) -> Estimate | OnlineEstimate | str:
    """What the running estimate says of a hand that was empty, and holds something since 2 s, of an arm that stands."""
    feed = new_feed(output)
    pose = MIDDLE + REACH * random.uniform(-1.0, 1.0, len(JOINTS))
    dry = arm.coulomb * random.normal(1.0, 0.05, len(JOINTS))
    told = None
    for begins_s, load_kg in ((0.0, 0.0), (HELD_S, kg)):
        rows = arm.followed(
            load_kg, random, RATE_HZ, HELD_S - begins_s / 3.0, dry, [0.0, HELD_S], [pose, pose]
        )
        told = fed(feed, rows, begins_s) or told
    return told or "nothing is said"


def calibrated(arm: Arm, random: np.random.Generator, folder: Path, seconds: float) -> Path:
    """The calibration of an arm by two empty motions and one with a known load, so long each.

    Raises:
        ProprioError: It cannot be calibrated.
    """
    output = folder / "calibrated.yaml"
    empty = [write(folder / label, arm.moved(0.0, random, RATE_HZ, seconds)) for label in "ab"]
    known = write(folder / "known", arm.moved(KNOWN_KG, random, RATE_HZ, seconds))
    options = Options(robot="so101", settings=SETTINGS)
    learnt = calibrate_from_bags(empty, {known: KNOWN_KG}, options, output)
    if learnt.verdict is not Verdict.ACCEPTED:
        raise ProprioError(f"{learnt.verdict.value}: {'; '.join(learnt.reasons)}")
    return output


def weighed(
    seed: int, asked_kg: Sequence[float] = ASKED_KG, seconds: float = 60.0
) -> list[tuple[str, float, Estimate | OnlineEstimate | str]]:
    """What was asked, truth [kg] and answer, or why there is none, of one arm.

    Raises:
        ProprioError: It cannot be calibrated.
    """
    random = np.random.default_rng(seed)
    arm = Sticky(random)
    found: list[tuple[str, float, Estimate | OnlineEstimate | str]] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        output = calibrated(arm, random, folder, seconds)

        def ask(what: str, kg: float, *recorded: dict[str, np.ndarray]) -> None:
            bags = [
                write(folder / f"{what} {kg} {number}", rows)
                for number, rows in enumerate(recorded)
            ]
            answer: Estimate | str
            try:
                answer = replay(bags, Options(calibration=output, settings=SETTINGS))
            except ProprioError as error:
                answer = str(error)
            found.append((what, kg, answer))

        for kg in asked_kg:
            whole, of_poses = arm.stood(kg, random)
            ask(STANDS, kg, *of_poses)
            ask(WHOLE, kg, whole)
            found.append(
                (
                    STILL,
                    kg,
                    put_in(
                        arm,
                        kg,
                        np.random.default_rng([seed, round(1e3 * kg)]),
                        output,
                    ),
                )
            )
        for factor in OTHER_GAINS:
            arm.gain = factor * GAIN
            for kg in dict.fromkeys((asked_kg[len(asked_kg) // 2], asked_kg[-1])):
                whole, of_poses = arm.stood(kg, random)
                ask(other(factor, STANDS), kg, *of_poses)
                ask(other(factor, WHOLE), kg, whole)
                running = fed(new_feed(output), whole) or "nothing is said"
                found.append((other(factor, RUNNING), kg, running))
    return found


def other(factor: float, what: str) -> str:
    """The name of what is asked of servos of so many times the gain."""
    return f"{factor:g} times the gain, {what}"


def answers_of(
    seed: int, masses: Sequence[float], seconds: float
) -> list[tuple[str, float, Estimate | OnlineEstimate | str]]:
    """As `weighed`; nothing of an arm that cannot be calibrated."""
    try:
        found = weighed(seed, masses, seconds)
    except ProprioError as error:
        print(f"arm {seed}: {error}")
        return []
    for what, kg, answer in found:
        words = (
            f"{answer.verdict.value} {answer.values[0].ci95} {answer.reasons}"
            if isinstance(answer, Estimate)
            else str(answer)
        )
        print(f"arm {seed}, {what}, {1e3 * kg:.0f} g: {words}"[:220], flush=True)
    return found


def main(arguments: Sequence[str] | None = None) -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--arms", type=int, default=12)
    parser.add_argument("--first", type=int, default=500, help="first seed")
    parser.add_argument(
        "--masses",
        type=float,
        nargs="*",
        default=ASKED_KG,
        help="[kg]",
    )
    parser.add_argument(
        "--seconds", type=float, default=60.0, help="of each motion that calibrates"
    )
    parser.add_argument("--jobs", type=int, default=1, help="arms at the same time")
    options = parser.parse_args(arguments)
    results = Results(__file__, options.json, arguments)
    seeds = range(options.first, options.first + options.arms)
    ask = partial(answers_of, masses=options.masses, seconds=options.seconds)
    with ProcessPoolExecutor(options.jobs) as pool:
        found = [answer for of_arm in pool.map(ask, seeds) for answer in of_arm]
    results.table(
        "rest",
        {
            "asked": "{what}",
            "held": "{held}",
            "accepted": "{accepted} of {asked}",
            "too wide": "{wide}",
            "error rms, worst": "{rms:.0f}, {worst:.0f} g",
            "median half interval": "{half:.0f} g",
            "intervals that hold": "{hold} of {given}",
            "farthest, in sd": "{farthest:.1f}",
        },
    )
    for what in (STANDS, WHOLE, STILL):
        mine = [(kg, answer) for of, kg, answer in found if of == what]
        groups = [
            (f"{1e3 * kg:.0f} g" if kg else "nothing", {kg})
            for kg in dict.fromkeys(kg for kg, _ in mine)
        ]
        for held, kgs in (*groups, *([("all", set(options.masses))] if len(groups) > 1 else [])):
            row(
                results,
                what,
                held,
                [(kg, answer) for kg, answer in mine if kg in kgs],
            )
    _other_gains(results, found)
    results.keep()


def _other_gains(
    results: Results, found: Sequence[tuple[str, float, Estimate | OnlineEstimate | str]]
) -> None:
    """The table of servos that have another gain."""
    results.table(
        "gain",
        {
            "times the gain": "{factor:g}",
            **{
                f"{what}: accepted, interval misses, farthest in sd": f"{{{key}_accepted}} of {{{key}_asked}}, {{{key}_missed}}, "
                f"{{{key}_farthest:.1f}}"
                for key, what in OF_GAIN.items()
            },
        },
    )
    for factor in OTHER_GAINS:
        cells: dict[str, Any] = {}
        for key, what in OF_GAIN.items():
            mine = [(kg, answer) for of, kg, answer in found if of == other(factor, what)]
            cells |= {f"{key}_{name}": value for name, value in of_accepted(mine).items()}
        results.row("gain", factor=factor, **cells)


def accepted_numbers(
    answers: Sequence[tuple[float, Estimate | OnlineEstimate | str]],
) -> Iterator[tuple[float, float, float, float, float]]:
    """Truth, value, standard deviation and both ends of the interval of those that were accepted [kg]."""
    for kg, answer in answers:
        if isinstance(answer, OnlineEstimate) and answer.known:
            yield kg, answer.mass_kg, answer.std_kg, *answer.ci95_kg
        elif isinstance(answer, Estimate) and answer.verdict is Verdict.ACCEPTED:
            value: Any = answer.values[0]
            yield kg, value.value, value.std, *value.ci95


def of_accepted(
    answers: Sequence[tuple[float, Estimate | OnlineEstimate | str]],
) -> dict[str, float]:
    """How many were accepted, how many of these intervals miss, and the farthest in standard deviations."""
    numbers = list(accepted_numbers(answers))
    return {
        "asked": len(answers),
        "accepted": len(numbers),
        "missed": sum(not low <= kg <= high for kg, _, _, low, high in numbers),
        "farthest": max((abs(value - kg) / std for kg, value, std, _, _ in numbers), default=0.0),
    }


def row(
    results: Results,
    what: str,
    held: str,
    answers: Sequence[tuple[float, Estimate | OnlineEstimate | str]],
) -> None:
    """Figures of some answers."""
    accepted = 0
    numbers = []
    for kg, answer in answers:
        if isinstance(answer, OnlineEstimate) and answer.resting_since_s is None:
            continue  # it has not come to rest yet
        if isinstance(answer, OnlineEstimate):
            accepted += answer.known
            numbers.append((answer.mass_kg - kg, answer.std_kg, *answer.ci95_kg, kg))
        elif isinstance(answer, Estimate) and isinstance(answer.values[0].value, float):
            value: Any = answer.values[0]
            accepted += answer.verdict is Verdict.ACCEPTED
            numbers.append((value.value - kg, value.std, *value.ci95, kg))
    off, std, low, high, of = np.array(numbers).T if numbers else np.full((5, 1), np.nan)
    half = high - off - of
    holds = (low <= of) & (of <= high)
    results.row(
        "rest",
        what=what,
        held=held,
        asked=len(answers),
        given=len(numbers),
        accepted=accepted,
        wide=len(numbers) - accepted,
        rms=1e3 * np.sqrt(np.mean(off**2)),
        worst=1e3 * np.abs(off).max(),
        half=1e3 * np.median(half),
        hold=int(holds.sum()),
        farthest=np.abs(off / std).max(),
        **(each_answer(1e3 * off, 1e3 * half) if numbers else {}),
    )


if __name__ == "__main__":
    main()
