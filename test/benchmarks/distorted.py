"""What is said of a real recording once something in it is wrong: what is accepted, and how far off that is.

    python test/benchmarks/distorted.py [--recordings ../shared/recordings_real]

The UR10e with 2.805 kg, and without, is weighed in six ways (against a baseline or with a calibration; the distortion in what is
weighed, or in both recordings), each with one thing changed that sensors, drivers and users get wrong: units, signs, clocks, zeros,
filters, lost samples. An answer need not come; one that comes has to hold. One row for each distortion.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from real import UR10E_KG, ur10e_file
from results import Results, parser_of
from scipy.signal import butter, lfilter
from support.machines import REAL

from proprio_ros.errors import ProprioError
from proprio_ros.identification.regression.motion_equations import once_each
from proprio_ros.identification.regression.motion_fit import fit_empty
from proprio_ros.pipeline.loading import bag_motion
from proprio_ros.pipeline.request import Options, Request
from proprio_ros.probes.payload.moving import identify_in_motion
from proprio_ros.quantity import Z95
from proprio_ros.recordings.motions import Motion
from proprio_ros.robot import Robot, load_robot
from proprio_ros.sim.payload import PayloadFacts

Distortion = Callable[[Motion, np.random.Generator], Motion]
LIFT = 1
ELBOW = 2


def currents(change: Callable[[np.ndarray, np.random.Generator], np.ndarray]) -> Distortion:
    """A distortion of the currents, shape (T, n)."""
    return lambda motion, rng: replace(motion, current_A=change(motion.current_A.copy(), rng))


def positions(change: Callable[[np.ndarray, np.random.Generator], np.ndarray]) -> Distortion:
    """A distortion of the positions, shape (T, n)."""
    return lambda motion, rng: replace(motion, position=change(motion.position.copy(), rng))


def times(change: Callable[[np.ndarray, np.random.Generator], np.ndarray]) -> Distortion:
    """A distortion of the stamps [s], shape (T,)."""
    return lambda motion, rng: replace(motion, times_s=change(motion.times_s.copy(), rng))


def of_joint(joint: int, change: Callable[[np.ndarray], np.ndarray]) -> Callable[..., np.ndarray]:
    """A change of one column."""

    def changed(columns: np.ndarray, _: np.random.Generator) -> np.ndarray:
        columns[:, joint] = change(columns[:, joint])
        return columns

    return changed


def every(step: int) -> Distortion:
    """Only some samples are left."""
    return lambda motion, _: replace(
        motion,
        times_s=motion.times_s[::step],
        position=motion.position[::step],
        current_A=motion.current_A[::step],
    )


def held(columns: np.ndarray, step: int) -> np.ndarray:
    """A register that is read less often than it is published."""
    return columns[np.arange(len(columns)) // step * step]


def smoothed(columns: np.ndarray, cutoff_Hz: float) -> np.ndarray:
    """As a driver that filters at 100 Hz."""
    result: np.ndarray = lfilter(*butter(1, cutoff_Hz / 50.0), columns, axis=0)
    return result


def jittered(stamps_s: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Later by up to some milliseconds, and still in order."""
    return np.maximum.accumulate(
        stamps_s + rng.normal(0.0, 5e-3, len(stamps_s))
    ) + 1e-9 * np.arange(len(stamps_s))


DISTORTIONS: dict[str, Distortion] = {
    "nothing": lambda motion, _: motion,
    **{
        f"currents x {k:g}": currents(lambda c, _, k=k: k * c)
        for k in (0.5, 0.8, 0.9, 1.1, 1.2, 2.0)
    },
    **{
        f"currents of {name} x {k:g}": currents(of_joint(j, lambda c, k=k: k * c))
        for j, name in ((LIFT, "the shoulder"), (ELBOW, "the elbow"), (3, "wrist 1"))
        for k in (0.7, 1.3, -1.0)
    },
    "currents of opposite sign": currents(lambda c, _: -c),
    "currents without sign": currents(lambda c, _: np.abs(c)),
    "currents of shoulder and elbow exchanged": currents(lambda c, _: c[:, [0, 2, 1, 3, 4, 5]]),
    "currents 50 ms late": currents(lambda c, _: np.roll(c, 5, axis=0)),
    "currents 50 ms early": currents(lambda c, _: np.roll(c, -5, axis=0)),
    "currents 150 ms late": currents(lambda c, _: np.roll(c, 15, axis=0)),
    "currents smoothed to 2 Hz": currents(lambda c, _: smoothed(c, 2.0)),
    "currents smoothed to 0.5 Hz": currents(lambda c, _: smoothed(c, 0.5)),
    "currents in steps of 1 A": currents(lambda c, _: np.round(c)),
    "currents of 8 A at most": currents(lambda c, _: np.clip(c, -8.0, 8.0)),
    "currents 1 A noisy": currents(lambda c, rng: c + rng.normal(0.0, 1.0, c.shape)),
    "currents read ten times a second": currents(lambda c, _: held(c, 10)),
    "shoulder drifts by 1 A": currents(
        of_joint(LIFT, lambda c: c + np.linspace(-1.0, 1.0, len(c)))
    ),
    "shoulder drifts by 3 A": currents(
        of_joint(LIFT, lambda c: c + np.linspace(-3.0, 3.0, len(c)))
    ),
    "shoulder's zero 0.1 rad off": positions(of_joint(LIFT, lambda p: p + 0.1)),
    "elbow's zero 0.3 rad off": positions(of_joint(ELBOW, lambda p: p + 0.3)),
    "positions x 1.05": positions(lambda p, _: 1.05 * p),
    "positions 5 mrad noisy": positions(lambda p, rng: p + rng.normal(0.0, 5e-3, p.shape)),
    "positions read 20 times a second": positions(lambda p, _: held(p, 5)),
    "clock 10 % fast": times(lambda t, _: 0.9 * t),
    "clock at half speed": times(lambda t, _: 2.0 * t),
    "clock at twice the speed": times(lambda t, _: 0.5 * t),
    "stamps 5 ms jittered": times(jittered),
    "every fourth sample": every(4),
}


def main(arguments: Sequence[str] | None = None) -> None:
    """One row for each distortion."""
    parser = parser_of((__doc__ or "").splitlines()[0])
    parser.add_argument("--recordings", type=Path, default=REAL)
    parser.add_argument(
        "--only",
        nargs="+",
        default=list(DISTORTIONS),
        choices=list(DISTORTIONS),
        help="default: all",
    )
    options = parser.parse_args(arguments)
    results = Results(__file__, options.json, arguments)
    with tempfile.TemporaryDirectory() as folder:
        path = ur10e_file(options.recordings, Path(folder))
        robot = load_robot(path)
        loaded, empty, other = (
            bag_motion(
                options.recordings / bag, Request(robot, Options(robot=str(path), effort_unit="A"))
            )
            for bag in ("ur10e_loaded_14", "ur10e_empty_14", "ur10e_empty_15")
        )
    calibrated = replace(robot, motion_calibration=fit_empty(robot, [empty]))
    results.table(
        "distorted",
        {
            "distortion": "{distortion}",
            "answers": "{answered} of {asked}",
            "hold": "{hold}",
            "farthest, in sd": "{farthest:.1f}",
            "refused because": "{codes}",
        },
    )
    given = 0
    kept = 0
    farthest = 0.0
    for name in options.only:
        distortion = DISTORTIONS[name]
        rng = np.random.default_rng(1)
        wrong, wrong_empty, wrong_other = (
            distortion(motion, rng) for motion in (loaded, empty, other)
        )
        questions = [
            (UR10E_KG, robot, wrong, [empty]),
            (UR10E_KG, calibrated, wrong, []),
            (UR10E_KG, robot, wrong, [wrong_empty]),
            (0.0, robot, wrong_other, [empty]),
            (0.0, calibrated, wrong_other, []),
            (0.0, robot, wrong_other, [wrong_empty]),
        ]
        sigmas = []
        codes = []
        with once_each():
            for truth, arm, motion, baseline in questions:
                said = answer(arm, motion, baseline, truth)
                (codes if isinstance(said, str) else sigmas).append(said)
        holding = sum(sigma <= Z95 for sigma in sigmas)
        results.row(
            "distorted", distortion=name, answered=len(sigmas), asked=len(questions), hold=holding,
            farthest=max(sigmas, default=None), codes=", ".join(sorted(set(codes))),
        )  # fmt: skip
        given = given + len(sigmas)
        kept = kept + holding
        farthest = max([farthest, *sigmas])
    results.row(
        "distorted",
        distortion="all",
        answered=given,
        asked=6 * len(options.only),
        hold=kept,
        farthest=farthest,
        codes="",
    )
    results.keep()


def answer(robot: Robot, motion: Motion, baseline: list[Motion], truth: float) -> float | str:
    """By how many standard deviations of its interval it is off, or why there is none."""
    try:
        estimate = identify_in_motion(robot, [motion], baseline, PayloadFacts())
    except ProprioError as error:
        return type(error).__name__
    mass = estimate.values[0]
    if mass.value is None:
        return estimate.reasons[0].code
    low, high = mass.ci95
    half = max(high - mass.value, mass.value - low)
    return float(Z95 * abs(mass.value - truth) / half)


if __name__ == "__main__":
    main()
