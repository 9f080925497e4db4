"""Recordings that rows bend: what they are, how they are asked, and what is true of them."""

from __future__ import annotations

import contextlib
import io
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from proprio_ros.cli import main as proprio
from support.known import simulated
from support.machines import REAL, pendulum_urdf

BAGS = Path(__file__).resolve().parents[3] / "bags"
Files = Mapping[str, Path]
"""Of each word in braces of a command the path that stands there."""
MOTION = "motion"  # of several joints
PUSH = "push"  # of one joint from rest
GOALS = "goals"  # servos that a voltage drives, of which goals and positions are known
SWING = "swing"  # a pendulum that is let go


@dataclass(frozen=True)
class Base:
    """Recordings whose truth is known.

    Attributes:
        name: Of it in rows.
        about: What it is, for the page.
        kind: `MOTION`, `PUSH`, `GOALS` or `SWING`.
        command: Words of the command line; those in braces are of `files`.
        files: Makes or finds the files; those it makes go into the folder, and are found there again.
        truth: Of the estimate, SI.
        estimate: Name of the value that is asked for.
        real: A recording that does not ship with this package: rows that need it are skipped without.
    """

    name: str
    about: str
    kind: str
    command: tuple[str, ...]
    files: Callable[[Path], Files]
    truth: float
    estimate: str = "payload_mass"
    real: bool = False

    @property
    def missing(self) -> bool:
        """Whether its recordings are not at hand."""
        return self.real and not REAL.is_dir()


# --- real machines ------------------------------------------------------------------------------------------------------

_PAYLOAD = ("--probe", "payload")
_BY_BASELINE = ("replay", "{loaded}", "--baseline", "{empty}", *_PAYLOAD)
_BY_CALIBRATION = ("replay", "{loaded}", "--calibration", "{calibration}", *_PAYLOAD)
_UR10E = ("--robot", "ur10e", "--driver", "ur_current")


def found(**bags: str) -> Callable[[Path], Files]:
    """Real recordings by their names."""
    return partial(_found, bags=bags)


def _found(
    folder: Path,
    bags: Mapping[str, str],
) -> Files:
    return {name: REAL / bag for name, bag in bags.items()}


def ur10e(
    name: str,
    loaded: str,
    empty: str,
    truth: float,
) -> Base:
    """The real UR10e, by another recording with an empty hand."""
    held = f"{truth:g} kg" if truth else "nothing"
    return Base(
        name=name,
        about=f"a real UR10e with {held} in motion, 50 s, against its empty hand; currents in A ({loaded}, {empty})",
        kind=MOTION,
        command=(*_BY_BASELINE, *_UR10E),
        files=found(loaded=f"ur10e_{loaded}", empty=f"ur10e_{empty}"),
        truth=truth,
        real=True,
    )


def _calibrate(file: Path, words: Sequence[str]) -> Path:
    """A calibration, made once."""
    if not file.exists():
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            proprio(["calibrate", *words, "--output", str(file)])
    return file


def _ur10e_calibrated(folder: Path) -> Files:
    folder.mkdir(parents=True, exist_ok=True)
    words = [str(REAL / "ur10e_empty_14"), *_UR10E]
    calibration = _calibrate(folder / "ur10e_by_14.yaml", words)
    return {"loaded": REAL / "ur10e_loaded_14", "calibration": calibration}


def _kuka(folder: Path) -> Files:
    """Recordings and a robot file of the URDF that goes with them."""
    folder.mkdir(parents=True, exist_ok=True)
    robot = folder / "kuka.yaml"
    if not robot.exists():
        urdf = str(REAL / "models" / "kuka_lwr4.urdf")
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            proprio(["robot", "new", urdf, "--effort-unit", "N.m", "--output", str(robot)])
    bags = {"loaded": REAL / "kuka_lwr4_empty_3", "empty": REAL / "kuka_lwr4_empty_1"}
    return {**bags, "robot": robot}


_DISC = (
    "--set",
    "payload.com=[0,0,0]",
    "--set",
    "payload.inertia_per_mass=[0.00255,0.00255,0.00255,0,0,0]",
)
"""Discs at the end of a rod, as those who recorded the servos state them."""
_SERVO_KG = (0.535, 0.741, 0.969, 1.168)
_STS_DRIVE = "{kind: position_servo, gain_per_rad: 2.656, limit: 0.97, goal_speed_rad_s: 5.215}"


def _pendulum_file(
    folder: Path,
    name: str,
    motor: str,
    drive: str,
) -> Path:
    """The robot file of a servo with a rod of 0.1 m."""
    folder.mkdir(parents=True, exist_ok=True)
    pendulum_urdf(folder, name, 0.001, 0.1)
    encoder = "encoder_resolution_rad: 0.0015, encoder_noise_rad: 0.0005"
    path = folder / f"{name}.yaml"
    lines = [
        f"name: {name}",
        f"urdf: {name}.urdf",
        "payload_frame: tip",
        "gravity: [0.0, 0.0, -9.80496]",
        "delay_s: {value: 0.02, std: 0.02}",
        "joints:",
        "  pendulum:",
        f"    motor: {{{motor}nominal_torque_constant_N_m_per_A: 1.0, {encoder}}}",
        f"    drive_train: {{torque_constant_N_m_per_A: {drive}}}",
    ]
    path.write_text("\n".join(lines) + "\n")
    return path


def _let_go(folder: Path, kg: float) -> Files:
    """One load of the real servo that lets go, by all others."""
    robot = _pendulum_file(folder, "sts3215", "", "{value: 1.0, std: 0.5}")
    others = [each for each in _SERVO_KG if each != kg]
    references = [f"{REAL / f'sts3215_release_{each:.3f}kg'}={each}" for each in others]
    words = ["--reference", *references, "--robot", str(robot), *_DISC]
    calibration = _calibrate(folder / f"sts3215_{kg}.yaml", words)
    return {"loaded": REAL / f"sts3215_release_{kg:.3f}kg", "calibration": calibration}


_DRIVEN = ("sin_sin", "sin_time_square", "up_and_down")


def _driven(folder: Path, motion: str, kg: float) -> Files:
    """One motion of the real servo under its position controller, by the motions with the other load."""
    motor = f"resistance_ohm: 2.68, back_emf_V_s_per_rad: 1.0, driven_by: {_STS_DRIVE}, "
    robot = _pendulum_file(folder, "sts3215_driven", motor, "{value: 1.0, std: 0.4}")
    known = [(each, load) for load in (0.535, 1.168) for each in _DRIVEN if each != motion]
    references = []
    for each, load in known:
        references += ["--reference", f"{REAL / f'sts3215_{each}_{load:.3f}kg'}={load}"]
    words = ["--robot", str(robot), *_DISC, *references]
    calibration = _calibrate(folder / f"sts3215_without_{motion}.yaml", words)
    return {"loaded": REAL / f"sts3215_{motion}_{kg:.3f}kg", "calibration": calibration}


def servo_bases() -> tuple[Base, ...]:
    """Real servos whose current nobody knows."""
    found: list[Base] = []
    for kg in _SERVO_KG:
        found.append(
            Base(
                name=f"let_go_{kg}",
                about=f"a real STS3215 that lets go of a pendulum of {kg} kg, calibrated on the other loads",
                kind=SWING,
                command=(*_BY_CALIBRATION, *_DISC),
                files=partial(_let_go, kg=kg),
                truth=kg,
                real=True,
            )
        )
    for motion in _DRIVEN:
        for kg in (0.535, 1.168):
            found.append(
                Base(
                    name=f"driven_{motion}_{kg}",
                    about=f"a real STS3215 under its position controller with {kg} kg, calibrated on other motions",
                    kind=GOALS,
                    command=(*_BY_CALIBRATION, *_DISC),
                    files=partial(_driven, motion=motion, kg=kg),
                    truth=kg,
                    real=True,
                )
            )
    return tuple(found)


def _real_bases() -> tuple[Base, ...]:
    return (
        ur10e("ur10e", "loaded_14", "empty_14", 2.805),
        ur10e("ur10e_15", "loaded_15", "empty_15", 2.805),
        ur10e("ur10e_14_by_12", "loaded_14", "empty_12", 2.805),
        ur10e("ur10e_nothing", "empty_15", "empty_14", 0.0),
        ur10e("ur10e_nothing_12", "empty_12", "empty_15", 0.0),
        Base(
            name="ur10e_calibrated",
            about="a real UR10e with 2.805 kg in motion, 50 s, calibrated on its empty hand; currents in A",
            kind=MOTION,
            command=(*_BY_CALIBRATION, "--driver", "ur_current"),
            files=_ur10e_calibrated,
            truth=2.805,
            real=True,
        ),
        Base(
            name="kuka",
            about="a real KUKA LWR4+ with nothing in the hand, against a slower recording without; N m by its sensors",
            kind=MOTION,
            command=(*_BY_BASELINE, "--robot", "{robot}", "--effort-unit", "N.m"),
            files=_kuka,
            truth=0.0,
            real=True,
        ),
        *servo_bases(),
    )


# --- pushes that ship ---------------------------------------------------------------------------------------------------


def _bag(name: str) -> Path:
    return sorted((BAGS / f"realistic_s00_{name}").glob("bag_*"))[0]


_PUSHES = (
    "fixed_light_cube_10g_joint2",
    "fixed_light_cube_10g_joint3",
    "fixed_light_ball_20g_joint3",
    "fixed_heavy_cube_23g_joint3_x0",
    "fixed_heavy_ball_50g_joint3",
    "fixed_reference_100g_joint2_x2",
    "fixed_reference_100g_joint3_x1",
)
"""One robot's recordings in `bags/`, whose empty runs calibrate it."""


def _pushed(folder: Path, name: str, calibrated: bool) -> Files:
    if not calibrated:
        return {"loaded": _bag(name)}
    folder.mkdir(parents=True, exist_ok=True)
    empty = sorted(BAGS.glob("realistic_s00_empty_*"))
    words = [str(sorted(each.glob("bag_*"))[0]) for each in empty]
    calibration = _calibrate(folder / "realistic_s00.yaml", words)
    return {"loaded": _bag(name), "calibration": calibration}


def _stated(name: str) -> tuple[str, ...]:
    """What is said of the object: where it sits and its shape, not its mass."""
    payload = json.loads((BAGS / f"realistic_s00_{name}" / "truth.json").read_text())["payload"]
    per_mass = [value / payload["mass"] for value in payload["inertia"]]
    return (
        "--set",
        f"payload.com={json.dumps(payload['offset'])}",
        "--set",
        f"payload.inertia_per_mass={json.dumps(per_mass)}",
    )


def _mass(name: str) -> float:
    truth = json.loads((BAGS / f"realistic_s00_{name}" / "truth.json").read_text())
    return float(truth["payload"]["mass"])


def push_bases() -> tuple[Base, ...]:
    """Pushes of one joint from rest, with and without a calibration."""
    found = []
    for name in _PUSHES:
        what = name.removeprefix("fixed_")
        for calibrated in (False, True):
            words = _BY_CALIBRATION if calibrated else ("replay", "{loaded}", *_PAYLOAD)
            known = "calibrated" if calibrated else "uncalibrated"
            found.append(
                Base(
                    name=f"push_{what}" + ("_calibrated" if calibrated else ""),
                    about=f"a simulated OpenManipulator-X with {1e3 * _mass(name):.0f} g, one joint pushed from rest; {known}",
                    kind=PUSH,
                    command=(*words, *_stated(name)),
                    files=partial(_pushed, name=name, calibrated=calibrated),
                    truth=_mass(name),
                )
            )
    return tuple(found)


# --- simulated arms in motion -------------------------------------------------------------------------------------------


def twin(build: str, seed: int) -> Base:
    """An arm of `simulated.BUILDS` that a seed draws."""
    mass = simulated.twin_mass(build, seed)
    return Base(
        name=f"{build}_{seed}",
        about=f"a simulated arm of {build} joints with {1e3 * mass:.0f} g in motion, against its empty hand; N m",
        kind=MOTION,
        command=(*_BY_BASELINE, "--robot", "{robot}", "--effort-unit", "N.m"),
        files=partial(simulated.twin, build=build, seed=seed),
        truth=mass,
    )


def ready(arm: str, seed: int) -> Base:
    """An arm with a ready file that a seed draws."""
    mass = simulated.ready_mass(arm, seed)
    return Base(
        name=f"{arm}_{seed}",
        about=f"a simulated arm like {arm} with {1e3 * mass:.0f} g in motion, against its empty hand; N m",
        kind=MOTION,
        command=(*_BY_BASELINE, "--robot", arm, "--effort-unit", "N.m"),
        files=partial(simulated.ready, arm=arm, seed=seed),
        truth=mass,
    )


def so101(seed: int) -> Base:
    """An SO-101 that records goals and positions alone, whose servos a seed draws."""
    mass = simulated.so101_mass(seed)
    return Base(
        name=f"so101_{seed}",
        about=f"a simulated SO-101 with {1e3 * mass:.0f} g that goes from pose to pose, calibrated with 150 g; goals, no currents",
        kind=GOALS,
        command=(*_BY_CALIBRATION, "--set", "payload.com=[0,0,0]"),
        files=partial(simulated.so101, seed=seed),
        truth=mass,
    )


def drawn(first: int) -> tuple[Base, ...]:
    """Simulated recordings that nothing was chosen on, by a seed."""
    seeds = range(100 * first, 100 * first + 100)
    return (
        *(twin("six", seed) for seed in seeds[:4]),
        *(twin("three", seed) for seed in seeds[:2]),
        *(twin("four", seed) for seed in seeds[:3]),
        *(
            ready(arm, seed)
            for arm, seed in zip(
                simulated.READY,
                seeds[1:],
                strict=False,
            )
        ),
        *(so101(seed) for seed in seeds[:2]),
    )


BASES = {
    base.name: base
    for base in (
        *_real_bases(),
        *push_bases(),
        twin("six", 1),
        twin("three", 1),
        twin("four", 1),
        ready("panda", 1),
        so101(1),
    )
}
