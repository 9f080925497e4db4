"""Arms of six and of four joints in MuJoCo under a computed-torque controller: the data of tests and of `benchmarks/motions.py`.

The arm that moves differs from the one in the robot file: links, friction, rotors, torque constants and delays are drawn at random.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from proprio_ros.recordings.motions import Motion


@dataclass(frozen=True)
class Build:
    """How an arm is built, and how it moves.

    Attributes:
        axes, origins: Of the joints, as a URDF has them.
        masses_kg, coms_m, sizes_m: Of the links.
        grip: Origin of the hand in the last link.
        constants: N m/A.
        middle: Positions that the motion goes about [rad].
        speed, size: Lowest and highest of each of the four sines of a joint [rad/s, rad].
        armature, viscous, coulomb: Lowest and highest in SI units; friction of each joint times `wrist`.
        current_noise_A, shift_m: Of the sensor; of the links' centres from those of the URDF.
        stated: Lines of the robot file about the links.
        payload_kg: Lightest and heaviest; `held_m`: how far its centre lies from the hand.
    """

    axes: tuple[str, ...]
    origins: tuple[str, ...]
    masses_kg: tuple[float, ...]
    coms_m: tuple[tuple[float, float, float], ...]
    sizes_m: tuple[float, ...]
    grip: str
    constants: tuple[float, ...]
    middle: tuple[float, ...]
    wrist: tuple[float, ...]
    speed: tuple[float, float] = (0.3, 2.2)
    size: tuple[float, float] = (0.1, 0.35)
    armature: tuple[float, float] = (0.05, 0.3)
    viscous: tuple[float, float] = (0.1, 1.0)
    coulomb: tuple[float, float] = (0.2, 1.5)
    current_noise_A: float = 0.02
    link_share: float = 0.08
    shift_m: float = 0.005
    stated: str = ""
    payload_kg: tuple[float, float] = (0.1, 2.0)
    held_m: float = 0.05

    @property
    def joints(self) -> tuple[str, ...]:
        return tuple(f"j{n + 1}" for n in range(len(self.axes)))


SIX = Build(
    axes=("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0"),
    origins=("0 0 0.1", "0 0.05 0.1", "0 0 0.35", "0.1 -0.05 0", "0.2 0 0", "0.08 0 0"),
    masses_kg=(3.0, 4.0, 2.5, 1.0, 0.8, 0.3),
    coms_m=(
        (0, 0, 0.05),
        (0, 0, 0.17),
        (0.05, 0, 0.02),
        (0.1, 0, 0),
        (0.04, 0, 0),
        (0.02, 0, 0),
    ),
    sizes_m=(0.1, 0.2, 0.12, 0.1, 0.08, 0.05),
    grip="0.05 0 0",
    constants=(10.0, 10.0, 10.0, 5.0, 5.0, 5.0),
    middle=(0.0, 0.3, 0.8, 0.0, 0.5, 0.0),
    wrist=(1, 1, 1, 0.3, 0.3, 0.3),
)
"""An industrial arm of 12 kg."""
_FIRST = ("axes", "origins", "masses_kg", "coms_m", "sizes_m", "constants", "middle", "wrist")
THREE = replace(
    SIX,
    **{name: getattr(SIX, name)[:3] for name in _FIRST},
)
"""Its first three joints, with the hand at the third link."""
FOUR = Build(
    axes=("0 0 1", "0 1 0", "0 1 0", "0 1 0"),
    origins=("0.012 0 0.017", "0 0 0.06", "0.024 0 0.128", "0.124 0 0"),
    masses_kg=(0.1, 0.14, 0.13, 0.2),
    coms_m=(
        (0, 0, 0.047),
        (0.01, 0, 0.1),
        (0.09, 0, 0),
        (0.055, 0, 0.005),
    ),
    sizes_m=(0.05, 0.1, 0.09, 0.06),
    grip="0.126 0 0",
    constants=(1.78, 1.78, 1.78, 1.78),
    middle=(0.0, -0.3, 0.0, 0.0),
    wrist=(1, 1, 1, 1),
    speed=(0.2, 1.0),
    size=(0.1, 0.35),
    armature=(0.008, 0.02),
    viscous=(0.0, 0.02),
    coulomb=(0.04, 0.12),
    current_noise_A=0.008,
    link_share=0.02,
    shift_m=0.001,
    stated="arm_scale: {value: 1.0, std: 0.02}\nlink_mass_std: 0.01\nlink_com_std_m: 0.001\nlink_inertia_std: 0.05",
    payload_kg=(0.02, 0.2),
    held_m=0.015,
)
"""A small arm with servos that moves slowly, like an OpenManipulator-X: three parallel axes and much friction."""
RATE_HZ = 100.0
STEP_S = 0.001
EVERY = round(1.0 / RATE_HZ / STEP_S)
"""Steps from sample to sample."""
STEPS_TOGETHER = 10_000


def urdf(
    masses: np.ndarray,
    coms: np.ndarray,
    inertias: np.ndarray,
    payload: tuple[float, np.ndarray] | None = None,
    build: Build = SIX,
    moments: Sequence[float] | None = None,
) -> str:
    """The arm's URDF; a payload (mass [kg], centre in the hand [m]) is a ball, or has these moments [kg m^2]."""
    lines = ['<robot name="twin"><link name="base"/>']
    parent = "base"
    for n, joint in enumerate(build.joints):
        c = coms[n]
        i = inertias[n]
        lines.append(
            f'<link name="l{n + 1}"><inertial><origin xyz="{c[0]} {c[1]} {c[2]}"/><mass value="{masses[n]}"/>'
            f'<inertia ixx="{i[0]}" iyy="{i[1]}" izz="{i[2]}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="{joint}" type="revolute"><parent link="{parent}"/><child link="l{n + 1}"/>'
            f'<origin xyz="{build.origins[n]}"/><axis xyz="{build.axes[n]}"/>'
            '<limit lower="-3.1" upper="3.1" effort="500" velocity="10"/></joint>'
        )
        parent = f"l{n + 1}"
    inertial = ""
    if payload is not None and payload[0] > 0.0:
        mass, c = payload
        xx, yy, zz = moments or [0.4 * mass * 0.05**2] * 3
        inertial = (
            f'<inertial><origin xyz="{c[0]} {c[1]} {c[2]}"/><mass value="{mass}"/>'
            f'<inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="0" ixz="0" iyz="0"/></inertial>'
        )
    lines.append(
        f'<link name="hand">{inertial}</link><joint name="grip" type="fixed"><parent link="{parent}"/><child link="hand"/>'
        f'<origin xyz="{build.grip}"/></joint></robot>'
    )
    return "".join(lines)


def nominal(build: Build = SIX) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Masses [kg], centres [m] and inertias [kg m^2] of the robot file's arm."""
    masses = np.array(build.masses_kg)
    of_a_cube = masses * np.array(build.sizes_m) ** 2 / 6.0
    inertias = of_a_cube[:, None] * np.array([1.0, 1.1, 0.9])
    return masses, np.array(build.coms_m, dtype=float), inertias


def sines(times_s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A smooth motion of six joints: position, velocity, acceleration."""
    rng = np.random.default_rng(3)
    size = rng.uniform(0.2, 0.6, 6)
    speed = rng.uniform(1.0, 3.0, 6)
    phase = rng.uniform(0.0, 6.0, 6)
    angle = speed * times_s[:, None] + phase
    position = size * np.sin(angle)
    velocity = size * speed * np.cos(angle)
    return position, velocity, -size * speed**2 * np.sin(angle)


def inertia_matrix(
    model: Any,
    data: Any,
    out: np.ndarray,
) -> None:
    """MuJoCo changed the order of the arguments."""
    import mujoco

    if hasattr(data, "qM"):
        mujoco.mj_fullM(model, out, data.qM)
    else:
        mujoco.mj_fullM(model, data, out)


def write_robot(
    folder: Path,
    torque_std: float = 0.01,
    build: Build = SIX,
) -> Path:
    """URDF and robot file of the arm as its maker states it; returns the robot file."""
    (folder / "twin.urdf").write_text(urdf(*nominal(build), build=build))
    lines = ["name: twin", "urdf: twin.urdf", "payload_frame: hand", build.stated, "joints:"]
    for joint, constant in zip(build.joints, build.constants, strict=True):
        lines += [
            f"  {joint}:",
            f"    motor: {{nominal_torque_constant_N_m_per_A: {constant}, encoder_resolution_rad: 1.0e-4, encoder_noise_rad: "
            "1.0e-4, current_limit_A: 50.0, supply_voltage_V: 0.0, back_emf_V_s_per_rad: 1.0, resistance_ohm: 1.0}",
            f"    drive_train: {{torque_constant_N_m_per_A: {{value: {constant}, std: {torque_std * constant}}},"
            " coulomb_N_m: {value: 0.0, std: 2.0}, viscous_N_m_s_per_rad: {value: 0.0, std: 2.0},"
            " load_friction: {value: 0.0, std: 0.05}, armature_kg_m2: {value: 0.1, std: 0.2}}",
            "    usable_velocity_rad_s: 10.0",
        ]
    path = folder / "twin.yaml"
    path.write_text("\n".join(lines) + "\n")
    return path


@dataclass(frozen=True)
class Truth:
    """What a motion really was at its samples; all of shape (T, n).

    Attributes:
        position, velocity, acceleration: Of the joints in SI units.
        torque: Of the motors [N m], which the currents say.
        warm: Coulomb friction of this motion over that of the arm, shape (n,).
    """

    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    torque: np.ndarray
    warm: np.ndarray


@dataclass(frozen=True)
class Differs:
    """What one recording of an arm has of its own, each of shape (n,).

    Attributes:
        scale: Of the torque that its currents say over the motors' own.
        friction: Over that of the arm.
        offset: Torque that is read beside the motors' [N m].
        zero: True position less reading [rad].
        elsewhere: By how much the middle of the motion is another one [rad].
        speed: Of the motion, over the usual one, a number.
    """

    scale: np.ndarray
    friction: np.ndarray
    offset: np.ndarray
    zero: np.ndarray
    elsewhere: np.ndarray
    speed: float = 1.0


@dataclass(frozen=True)
class Way:
    """Four sines for each joint, shape (n, 4), about a middle (n,): what a controller is asked for."""

    phase: np.ndarray
    speed: np.ndarray
    size: np.ndarray
    middle: np.ndarray

    @classmethod
    def draw(cls, rng: np.random.Generator, build: Build) -> Way:
        shape = (len(build.axes), 4)
        phase = rng.uniform(0, 2 * np.pi, shape)
        speed = rng.uniform(*build.speed, shape)
        size = rng.uniform(*build.size, shape)
        return cls(phase, speed, size, np.array(build.middle))

    def of(self, own: Differs) -> Way:
        """The same, about another middle and at another speed."""
        return replace(
            self,
            speed=own.speed * self.speed,
            middle=self.middle + own.elsewhere,
        )

    def at(self, times_s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions, velocities and accelerations, (T, n) each."""
        angle = self.speed * times_s[:, None, None] + self.phase
        sine = np.sin(angle)
        rates = self.size * self.speed * np.cos(angle)
        bends = self.size * self.speed**2 * sine
        return (
            self.middle + (self.size * sine).sum(-1),
            rates.sum(-1),
            -bends.sum(-1),
        )

    def steps(self, count: int) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """The same at each of so many steps, one by one: those of an hour together would not fit into memory."""
        for first in range(0, count, STEPS_TOGETHER):
            numbers = np.arange(first, min(first + STEPS_TOGETHER, count))
            yield from zip(*self.at(numbers * STEP_S), strict=True)


@dataclass
class Heard:
    """What an arm reports of a motion, and what is true of it.

    Attributes:
        own: What the motion has of its own.
        per_A: Torque of the motors [N m/A], (n,).
        true: Angle, speed, acceleration and torque, sample by sample.
    """

    own: Differs
    per_A: np.ndarray
    times_s: list[float] = field(default_factory=list)
    positions: list[np.ndarray] = field(default_factory=list)
    currents_A: list[np.ndarray] = field(default_factory=list)
    true: list[list[np.ndarray]] = field(default_factory=list)

    def add(
        self,
        time_s: float,
        position: np.ndarray,
        torque: np.ndarray,
        rng: np.random.Generator,
        noise_A: float,
    ) -> None:
        """A sample, with the noise of its stamp, its encoders and its currents.

        Args:
            time_s: When it is taken [s].
            position: True angles [rad], (n,).
            torque: Of the motors [N m], (n,).
            rng: Draws the noise.
            noise_A: Of currents [A].
        """
        count = len(position)
        self.times_s.append(time_s + 2e-4 * rng.standard_normal())
        self.positions.append(position - self.own.zero + 1e-4 * rng.standard_normal(count))
        said = self.own.scale * (torque + self.own.offset) / self.per_A
        self.currents_A.append(said + noise_A * rng.standard_normal(count))

    def motion(self, name: str, joints: tuple[str, ...]) -> Motion:
        """As it is recorded."""
        times_s = np.array(self.times_s)
        return Motion(
            name,
            joints,
            times_s - times_s[0],
            np.array(self.positions),
            np.array(self.currents_A),
            {},
            "measured current",
        )


class _Motors:
    """Motors that follow goals by computed torque, late.

    Args:
        model: Of the arm.
        data: Its state.
        viscous: Friction that they make up for [N m s/rad], (n,).
        delay: From a goal to the torque [steps].
    """

    def __init__(
        self,
        model: Any,
        data: Any,
        viscous: np.ndarray,
        delay: int,
    ) -> None:
        count = len(viscous)
        self._model = model
        self._data = data
        self._viscous = viscous
        self._inertia = np.zeros((count, count))
        self._on_the_way = [np.zeros(count)] * (delay + 1)

    def torque(
        self, goal: tuple[np.ndarray, np.ndarray, np.ndarray], measured: np.ndarray
    ) -> np.ndarray:
        """What they give in the next step [N m], (n,), for angles, speeds and accelerations, of the angles that are measured."""
        data = self._data
        angles, speeds, accelerations = goal
        inertia_matrix(self._model, data, self._inertia)
        slower = speeds - data.qvel
        pushed = accelerations + 225.0 * (angles - measured) + 30.0 * slower
        wanted = self._inertia @ pushed + data.qfrc_bias + self._viscous * speeds
        self._on_the_way.append(wanted)
        return self._on_the_way.pop(0)


@dataclass
class Twin:
    """One arm as it really is, drawn at random; `truths` keeps what its motions really were, by name.

    With ``teeth`` friction goes with the place as once and three times a turn and as the teeth of a gear, else as twice a turn.
    """

    seed: int
    build: Build = SIX
    truths: dict[str, Truth] = field(default_factory=dict)
    teeth: bool = False

    def __post_init__(self) -> None:
        rng = np.random.default_rng(self.seed)
        build = self.build
        count = len(self.build.axes)
        masses, coms, inertias = nominal(build)
        self.masses = masses * (1.0 + build.link_share * rng.standard_normal(count))
        self.coms = coms + build.shift_m * rng.standard_normal((count, 3))
        self.inertias = inertias * (1.0 + 0.1 * rng.standard_normal((count, 1)))
        self.torque = 1.0 + 0.01 * rng.standard_normal(count)
        self.armature = rng.uniform(*build.armature, count)
        self.viscous = rng.uniform(*build.viscous, count)
        self.coulomb = rng.uniform(*build.coulomb, count) * np.array(build.wrist)
        self.gears = rng.uniform(0.0, 0.06, count)
        # part of Coulomb friction that goes with the angle
        self.place = rng.uniform(0.1, 0.3, count)
        self.delay = int(rng.integers(0, 10))
        self.rng = rng
        own = np.random.default_rng([self.seed, 1])  # all else is the same with and without teeth
        self.phase = own.uniform(0.0, 2.0 * np.pi, (3, count))
        self.number = own.integers(4, 13, count)

    def wave(self, position: np.ndarray) -> np.ndarray:
        """How friction goes with the place, per unit of `place`; its rms over a turn is that of a sine, shape as ``position``."""
        if not self.teeth:
            return np.sin(2.0 * position)
        once = np.sin(position + self.phase[0])
        thrice = np.sin(3.0 * position + self.phase[1])
        tooth = (self.number * position + self.phase[2]) / np.pi % 2.0 - 1.0
        result: np.ndarray = np.sqrt(3.0 / 8.0) * (once + thrice + tooth)
        return result

    def payload(
        self,
        rng: np.random.Generator,
    ) -> tuple[float, np.ndarray]:
        """Mass [kg] and centre in the hand [m] of something that such an arm may hold; each fourth arm holds nothing."""
        mass = 0.0
        if self.seed % 4 != 0:
            mass = float(np.exp(rng.uniform(*np.log(self.build.payload_kg))))
        middle = np.array([self.build.held_m, 0.0, 0.0])
        return mass, middle + self.build.held_m * rng.standard_normal(3)

    def _model(
        self,
        payload: tuple[float, np.ndarray] | None,
        moments: Sequence[float] | None,
    ) -> Any:
        """The arm with something in its hand, as `urdf` has it."""
        import mujoco

        spec = mujoco.MjSpec.from_string(
            urdf(self.masses, self.coms, self.inertias, payload, self.build, moments)
        )
        spec.compiler.fusestatic = True
        spec.compiler.balanceinertia = True
        model = spec.compile()
        model.opt.timestep = STEP_S
        model.opt.disableflags |= (
            mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
        )
        model.dof_armature[:] = self.armature
        return model

    def _arrives(
        self,
        torque: np.ndarray,
        position: np.ndarray,
        velocity: np.ndarray,
        viscous: np.ndarray,
        friction: np.ndarray,
    ) -> np.ndarray:
        """What friction leaves of the motors' torques [N m].

        Args:
            torque: Of the motors [N m].
            position: Of the joints [rad].
            velocity: Of the joints [rad/s].
            viscous: [N m s/rad].
            friction: Dry friction over that of the arm.
        """
        transmitted = torque - viscous * velocity
        coulomb = self.coulomb * friction * (1.0 + self.place * self.wave(position))
        lost = coulomb + self.gears * np.abs(transmitted)
        return transmitted - lost * np.tanh(velocity / 0.01)

    def record(
        self,
        name: str,
        seconds: float,
        payload: tuple[float, np.ndarray] | None = None,
        moments: Sequence[float] | None = None,
        differs: Differs | None = None,
    ) -> Motion:
        """A motion along random sines, with the payload in the hand, and what it has of its own; else it is friction to 5 %.

        Args:
            name: Of the motion.
            seconds: How long it lasts [s].
            payload: Mass [kg] and its centre [m].
            moments: Of inertia about that centre [kg m2].
            differs: What this motion has of its own.
        """
        import mujoco

        model = self._model(payload, moments)
        data = mujoco.MjData(model)
        rng = self.rng
        way = Way.draw(rng, self.build)
        usual = self._usual()
        own = differs or usual
        viscous = self.viscous * (1.0 if differs is None else own.friction)
        way = way.of(own)
        data.qpos[:], data.qvel[:], _ = next(way.steps(1))
        motors = _Motors(model, data, viscous, self.delay)
        heard = Heard(own, np.array(self.build.constants) * self.torque)
        mujoco.mj_forward(model, data)
        for step, goal in enumerate(way.steps(round((seconds + 1.0) / STEP_S))):
            measured = data.qpos + 1e-4 * rng.standard_normal(len(data.qpos))
            torque = motors.torque(goal, measured)
            data.qfrc_applied[:] = self._arrives(
                torque, data.qpos, data.qvel, viscous, own.friction
            )
            if step * STEP_S < 1.0 or step % EVERY != 0:
                mujoco.mj_step(model, data)
                continue
            heard.add(step * STEP_S, data.qpos, torque, rng, self.build.current_noise_A)
            begun = (data.qpos.copy(), data.qvel.copy())
            mujoco.mj_step(model, data)
            heard.true.append([*begun, data.qacc.copy(), torque])
        self.truths[name] = Truth(*np.swapaxes(heard.true, 0, 1), own.friction)
        return heard.motion(name, self.build.joints)

    def _usual(self) -> Differs:
        """What a motion has of its own where nothing is said: friction is not the same twice."""
        count = len(self.build.axes)
        warm = 1.0 + 0.05 * self.rng.standard_normal(count)
        none = np.zeros(count)
        return Differs(none + 1.0, warm, none, none, none)
