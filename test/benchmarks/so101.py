"""What an SO-101 that only records goals and positions, 30 times a second as LeRobot does, says about what it holds.

MuJoCo moves the arm of ``--robot so101``; each servo runs its own position law (P gain 16) on its encoder's counts, with a torque
constant, friction, a rotor and a supply drawn at random about the robot file's numbers. The arm goes from pose to pose, as somebody
teleoperates it. Recorded are ``/joint_command`` and ``/joint_states``, positions alone, no voltage. Two empty recordings and one
with a known weight calibrate; others, empty and with 50, 100 and 200 g, are asked. Backlash and the firmware's dead band are not in
it: what real gears add, it does not say. These arms repeat but for 5 % of friction, which nobody tells; with ``--differ`` torque,
friction, offsets and zeros of each recording differ as far as was published of real ones (`recording_variability.PUBLISHED`).

    python test/benchmarks/so101.py [--arms 10] [--first 0] [--rate 30] [--seconds 60] [--differ]
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from results import Results, each_answer, parser_of

from proprio_ros.errors import ProprioError, RecordingError
from proprio_ros.identification.estimate import Estimate, Value, Verdict
from proprio_ros.identification.regression.recording_variability import PUBLISHED
from proprio_ros.inputs.resources import share_directory
from proprio_ros.pipeline.calibrate import calibrate_from_bags
from proprio_ros.pipeline.replay import replay
from proprio_ros.pipeline.request import Options
from proprio_ros.recordings.messages import RawMessage, message_types
from proprio_ros.recordings.topics import JOINT_STATE
from proprio_ros.recordings.writer import write_messages

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
MIDDLE = np.array([0.0, -0.3, 0.3, 0.4, 0.0, 0.2])
REACH = np.array([0.8, 0.7, 0.7, 0.7, 0.8, 0.0])
ASKED_KG = (0.0, 0.05, 0.1, 0.2)
KNOWN_KG = 0.15
STEP_S = 0.001
COUNT_RAD = 2.0 * np.pi / 4096.0
GAIN = 2.656
RESISTANCE_OHM = 2.68
GOAL_STEP_RAD = 5.215 * STEP_S
"""How far the servo's own goal moves in a step."""
SETTINGS: dict[str, Any] = {"payload.com": [0.0, 0.0, 0.0]}


class Arm:
    """One arm.

    Args:
        random: what its servos are drawn from.
        differ: whether its recordings do as far as was published.
    """

    def __init__(self, random: np.random.Generator, differ: bool = False) -> None:
        n = len(JOINTS)
        self.differ = differ
        self.share, self.offset, self.zero_rad = np.ones(n), np.zeros(n), np.zeros(n)
        """Of the recording at hand: its torque over the arm's, a torque that is always there [N m], and how far zeros are off."""
        self.torque_constant = 1.21 * random.normal(1.0, 0.1) * random.normal(1.0, 0.03, n)
        self.coulomb = np.clip(
            random.normal(0.052, 0.015, n),
            0.02,
            None,
        )
        self.lost = random.uniform(0.0, 0.15, n)
        self.viscous = random.uniform(0.0, 0.03, n)
        self.armature = random.uniform(0.02, 0.036, n)
        self.delay_s = random.uniform(0.01, 0.035)
        self.supply_V = random.normal(7.4, 0.2)
        self.sticks, self.dead_band_rad, self.gain = 0.0, 0.0, GAIN
        """By how much of itself dry friction is greater at rest, where it holds a joint; of the firmware; duty cycle per rad."""

    def moved(
        self,
        load_kg: float,
        random: np.random.Generator,
        rate_hz: float,
        seconds: float,
    ) -> dict[str, np.ndarray]:
        """As it goes from pose to pose, see `followed`."""
        friction = PUBLISHED["friction"] if self.differ else 0.05
        dry = self.coulomb * random.normal(1.0, friction, len(JOINTS))
        if self.differ:
            self.differs(random)
        goals_at = [0.0]
        goals = [MIDDLE]
        while goals_at[-1] < seconds:
            goals_at.append(goals_at[-1] + random.uniform(0.8, 2.0))
            goals.append(MIDDLE + REACH * random.uniform(-1.0, 1.0, len(JOINTS)))
        return self.followed(
            load_kg,
            random,
            rate_hz,
            seconds,
            dry,
            goals_at,
            goals,
        )

    def differs(self, random: np.random.Generator) -> None:
        """Draw what another recording has of its own."""
        n = len(JOINTS)
        own = random.normal(0.0, PUBLISHED["own_scale"], n)
        self.share = 1.0 + random.normal(0.0, PUBLISHED["common_scale"]) + own
        self.offset = self.coulomb * random.normal(0.0, PUBLISHED["offset"], n)
        self.zero_rad = random.normal(0.0, PUBLISHED["zero"], n)

    def followed(
        self,
        load_kg: float,
        random: np.random.Generator,
        rate_hz: float,
        seconds: float,
        dry: np.ndarray,
        goals_at: Sequence[float],
        goals: Sequence[np.ndarray],
    ) -> dict[str, np.ndarray]:
        """Times, goals and positions, shapes (N,), (N, 6), (N, 6), under friction ``dry``."""
        import mujoco

        model = self._model(load_kg)
        data = mujoco.MjData(model)
        dofs = np.array([model.joint(name).dofadr[0] for name in JOINTS])
        model.dof_armature[dofs] = self.armature
        model.dof_damping[dofs] = self.viscous
        data.qpos[dofs] = goals[0]
        way = Way(goals_at, goals)
        goal = goals[0].copy()
        rows: dict[str, list[Any]] = {"t": [], "goal": [], "position": []}
        every = round(1.0 / (rate_hz * STEP_S))
        for step in range(round(seconds / STEP_S)):
            t = step * STEP_S
            # goals are sent as often as they are recorded, and the servo hears them late
            heard = way.at(max(np.floor((t - self.delay_s) * rate_hz + 1e-9) / rate_hz, 0.0))
            goal = goal + np.clip(heard - goal, -GOAL_STEP_RAD, GOAL_STEP_RAD)
            read = data.qpos[dofs] + self.zero_rad
            speed = data.qvel[dofs]
            if step % every == 0:
                rows["t"].append(t)
                rows["goal"].append(way.at(t))
                rows["position"].append(_counted(read + random.normal(0.0, 3e-4, 6)))
            model.dof_frictionloss[dofs] = self._friction(dry, speed, data.qfrc_bias[dofs])
            data.qfrc_applied[dofs] = self._torque(goal - _counted(read), speed)
            mujoco.mj_step(model, data)
        return {name: np.array(values) for name, values in rows.items()}

    def _model(self, load_kg: float) -> Any:
        """The arm with a load; without drive trains."""
        import mujoco

        spec = mujoco.MjSpec.from_file(str(share_directory() / "urdf" / "so101.urdf"))
        spec.compiler.fusestatic = False
        spec.option.timestep = STEP_S
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        spec.option.disableflags = int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        if load_kg:
            payload = spec.body("grasp_link").add_body(name="payload")
            payload.explicitinertial = True
            payload.mass = load_kg
            payload.inertia = [load_kg * 0.03**2 / 6.0] * 3
        # else MuJoCo's dry friction is soft, and a joint creeps until it carries nothing
        if self.sticks:
            spec.option.tolerance = 1e-14
            for name in JOINTS:
                joint = spec.joint(name)
                joint.solref_friction = (0.002, 1.0)
                joint.solimp_friction = (0.9999, 0.9999, 0.001, 0.5, 2.0)
        return spec.compile()

    def _torque(self, distance: np.ndarray, speed: np.ndarray) -> np.ndarray:
        """What the motors give [N m], at that distance from their goals [rad] and that speed [rad/s], (6,) each."""
        if self.dead_band_rad:
            beyond = np.maximum(np.abs(distance) - self.dead_band_rad, 0.0)
            distance = np.sign(distance) * beyond
        duty = np.clip(self.gain * distance, -0.97, 0.97)
        current = (self.supply_V * duty - self.torque_constant * speed) / RESISTANCE_OHM
        torque: np.ndarray = self.share * self.torque_constant * current + self.offset
        return torque

    def _friction(
        self,
        dry: np.ndarray,
        speed: np.ndarray,
        carried: np.ndarray,
    ) -> np.ndarray:
        """Dry friction [N m], (6,).

        Args:
            dry: Without load [N m], (6,).
            speed: Of the joints [rad/s], (6,).
            carried: Torque of gravity and motion [N m], (6,).
        """
        friction = dry + self.lost * np.abs(carried)
        result: np.ndarray = friction * (1.0 + self.sticks * np.exp(-((speed / 0.05) ** 2)))
        return result


@dataclass(frozen=True)
class Way:
    """Poses that an arm goes to, one after the other.

    Attributes:
        at_s: When it is in each [s].
        poses: [rad], (6,) each.
    """

    at_s: Sequence[float]
    poses: Sequence[np.ndarray]

    def at(self, t: float) -> np.ndarray:
        """The goal at a time [s], on a smooth way from pose to pose, (6,)."""
        begun = int(np.searchsorted(self.at_s, t, side="right")) - 1
        k = min(begun, len(self.poses) - 2)
        share = np.clip((t - self.at_s[k]) / (self.at_s[k + 1] - self.at_s[k]), 0.0, 1.0)
        smooth = 10 * share**3 - 15 * share**4 + 6 * share**5
        return self.poses[k] + (self.poses[k + 1] - self.poses[k]) * smooth


def _counted(angle: np.ndarray) -> np.ndarray:
    """In whole counts of the encoder [rad]."""
    result: np.ndarray = np.round(angle / COUNT_RAD) * COUNT_RAD
    return result


def write(
    folder: Path,
    rows: dict[str, np.ndarray],
) -> Path:
    """A bag of goals and positions."""
    types: Any = message_types()
    time, header, state = (
        types.types[name]
        for name in ("builtin_interfaces/msg/Time", "std_msgs/msg/Header", JOINT_STATE)
    )
    nothing = np.zeros(0)
    messages = []
    for row, t in enumerate(rows["t"]):
        time_ns = 10**9 + round(1e9 * t)
        stamp = header(
            stamp=time(
                sec=time_ns // 10**9,
                nanosec=time_ns % 10**9,
            ),
            frame_id="",
        )
        for topic, name in (("/joint_states", "position"), ("/joint_command", "goal")):
            message = state(
                stamp,
                list(JOINTS),
                rows[name][row],
                nothing,
                nothing,
            )
            messages.append(
                RawMessage(
                    topic, JOINT_STATE, time_ns, bytes(types.serialize_cdr(message, JOINT_STATE))
                )
            )
    write_messages(folder, messages)
    return folder


def weighed(
    seed: int,
    rate_hz: float,
    seconds: float,
    asked_kg: Sequence[float] = ASKED_KG,
    differ: bool = False,
) -> list[tuple[float, Estimate]]:
    """Truths [kg] and answers of one arm.

    Raises:
        ProprioError: it cannot be calibrated.
    """
    random = np.random.default_rng(seed)
    arm = Arm(random, differ)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)

        def bag(label: str, kg: float) -> Path:
            return write(
                folder / label,
                arm.moved(kg, random, rate_hz, seconds),
            )

        output = folder / "calibrated.yaml"
        options = Options(robot="so101", settings=SETTINGS)
        learnt = calibrate_from_bags(
            [
                bag("a", 0.0),
                bag("b", 0.0),
            ],
            {bag("known", KNOWN_KG): KNOWN_KG},
            options,
            output,
        )
        if learnt.verdict is not Verdict.ACCEPTED:
            raise RecordingError(f"{learnt.verdict.value}: {'; '.join(learnt.reasons)}")
        options = Options(calibration=output, settings=SETTINGS)
        return [
            (kg, replay(bag(f"asked{number}", kg), options)) for number, kg in enumerate(asked_kg)
        ]


@dataclass(frozen=True)
class Weighing:
    """An accepted answer.

    Attributes:
        off: Value less truth [kg].
        half: The larger half of its interval [kg].
        holds: Whether the truth is in it.
        pull: Error over standard deviation.
    """

    off: float
    half: float
    holds: bool
    pull: float

    @classmethod
    def of(cls, mass: Value, kg: float) -> Weighing:
        assert mass.value is not None
        low, high = mass.ci95
        off = mass.value - kg
        half = max(high - mass.value, mass.value - low)
        return cls(off, half, low <= kg <= high, off / mass.std)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--arms", type=int, default=10)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--rate", type=float, default=30.0, help="of goals and recordings [Hz]")
    parser.add_argument("--seconds", type=float, default=60.0, help="of each recording")
    parser.add_argument("--differ", action="store_true", help="recordings do, as was published")
    options = parser.parse_args(arguments)
    results = Results(__file__, options.json, arguments)
    answers: dict[float, list[Weighing]] = {kg: [] for kg in ASKED_KG}
    for seed in range(options.first, options.first + options.arms):
        try:
            found = weighed(seed, options.rate, options.seconds, differ=options.differ)
        except ProprioError as error:
            print(f"arm {seed}: {error}")
            continue
        for kg, estimate in found:
            if estimate.verdict is Verdict.ACCEPTED:
                answers[kg].append(Weighing.of(estimate.values[0], kg))
            said = f"{estimate.verdict.value}, {_words(estimate)}"
            print(f"arm {seed}, {kg * 1e3:.0f} g: {said}"[:200])
    _tell(results, answers, options.arms)
    results.keep()


def _words(estimate: Estimate) -> str:
    """The mass, or why it was not accepted."""
    if estimate.verdict is not Verdict.ACCEPTED:
        return "; ".join(map(str, estimate.reasons))
    mass = estimate.values[0]
    low, high = mass.ci95
    return f"{mass.value * 1e3:.1f} g ({low * 1e3:.1f} to {high * 1e3:.1f})"


def _tell(
    results: Results,
    answers: dict[float, list[Weighing]],
    arms: int,
) -> None:
    """A row for each mass [kg] that was asked of so many arms, and one for all of them."""
    results.table(
        "so101",
        {
            "held": "{held}",
            "answered": "{answered} of {asked}",
            "error rms, worst": "{rms:.1f}, {worst:.1f} g",
            "median half interval": "{half:.1f} g",
            "intervals that hold": "{hold}",
            "farthest, in sd": "{farthest:.1f}",
        },
    )
    for kg in ASKED_KG:
        if answers[kg]:
            name = f"{1e3 * kg:.0f} g" if kg else "nothing"
            results.row("so101", held=name, **_figures(answers[kg], arms))
    whole = [answer for kg in ASKED_KG for answer in answers[kg]]
    if whole:
        results.row("so101", held="all", **_figures(whole, arms * len(ASKED_KG)))


def _figures(answers: Sequence[Weighing], asked: int) -> dict[str, Any]:
    """Numbers of a row of so many questions."""
    off_g = 1e3 * np.array([answer.off for answer in answers])
    half_g = 1e3 * np.array([answer.half for answer in answers])
    return {
        "answered": len(answers),
        "asked": asked,
        "rms": np.sqrt(np.mean(off_g**2)),
        "worst": np.abs(off_g).max(),
        "half": np.median(half_g),
        "hold": sum(answer.holds for answer in answers),
        "farthest": max(abs(answer.pull) for answer in answers),
        **each_answer(off_g, half_g),
    }


if __name__ == "__main__":
    main()
