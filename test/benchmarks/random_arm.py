"""An OpenManipulator-X with a hidden, randomly drawn drive train, simulated in MuJoCo: how often do our intervals hold?

Nothing here uses the package's own robot model or simulator; the URDF is all that both share. Dry friction is MuJoCo's
constraint, so that a joint sticks, and joints that are held yield as their servos do. The gripper stays as it is.
Run it to see what a run costs and how exact it is.
"""

from __future__ import annotations

import math
import time
from collections.abc import Collection, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from proprio_ros.records import FloatArray, InputRecord, JointRecord, Recording

URDF = Path(__file__).resolve().parents[2] / "urdf" / "open_manipulator_x.urdf"
JOINTS = ("joint1", "joint2", "joint3", "joint4")
FINGERS = {"gripper_left": 1.0, "gripper_right": -1.0}
"""The fingers and the direction along y in which each opens."""
GRIPPER = "gripper_left_joint"
LINKS = ("link2", "link3", "link4", "link5", "gripper_left_link", "gripper_right_link")

EFFECTS = (
    "torque_constant",
    "armature",
    "coulomb",
    "viscous",
    "load_friction",
    "delay",
    "link_mass",
    "link_shape",
    "run_torque",
    "onset",
    "zero",
    "quantised",
    "encoder_noise",
    "once_per_turn",
    "jitter",
    "compliance",
    "back_emf",
    "stribeck",
)
"""What can be wrong with a robot. "quantised": 12-bit encoders and whole current counts, also of the command. "jitter": of the
sampling instants, which the stamps tell, and of the stamps, which nobody tells. "compliance": held joints yield. "back_emf":
the supply limits the current at speed. "link_shape": centres of mass and inertias. "run_torque": a torque that differs from run
to run. "onset": so does the delay."""
EFFECTS_DEFAULT = tuple(effect for effect in EFFECTS if effect != "stribeck")

NOMINAL_TORQUE_CONSTANT = 4.1 / 2.3  # N m/A, stall
NOMINAL_ARMATURE = 0.012  # kg m^2
COUNT_A = 0.00269
COUNT_RAD = 2.0 * math.pi / 4096
GRIPPER_M_PER_RAD = 0.01149
SUPPLY_V = 12.0
BACK_EMF_V_S = 2.49
RESISTANCE_OHM = 5.22

RATE_HZ = 40.0
PERIOD_S = 1.0 / RATE_HZ
BEFORE_S = 0.25
BRAKED_S = 0.15
STEP_S = 0.0005

HOLD_A_PER_RAD, HOLD_A_S_PER_RAD = 10.6, 0.48
"""The holding servo. The motor's own position loop at its factory gain and 12 V: 0.7 % of the voltage per count; its
damping is the back-EMF."""
RIGID = 1e4
"""Armature that holds a joint still when it must not yield: 0.3 N m moves it by 5 urad in 0.6 s [kg m^2]."""
STICKING = {"solref_friction": (0.001, 1.0), "solimp_friction": (0.9999, 0.9999, 0.001, 0.5, 2.0)}
"""MuJoCo's dry friction is a soft constraint: a stuck joint creeps at 1e-4 of its acceleration times half a millisecond."""


@dataclass(frozen=True)
class Spread:
    """How robots differ. Pairs named "common, own" are standard deviations of a factor that all share and of one of its own;
    other pairs are the ends of a uniform distribution. Gaussians end at `CLIP` standard deviations."""

    torque_constant: tuple[float, float] = (0.05, 0.01)  # relative: common, own
    link_mass: tuple[float, float] = (0.015, 0.005)  # relative: common, own
    link_com: float = 0.001  # m, standard deviation of each coordinate
    link_inertia: float = 0.05  # relative, about the centre of mass
    run_torque: float = 0.001  # N m, standard deviation
    onset_s: float = 0.0003  # standard deviation
    zero: float = 0.005  # rad, standard deviation
    armature: tuple[float, float] = (0.008, 0.030)  # kg m^2
    coulomb: tuple[float, float] = (0.01, 0.08)  # N m
    viscous: tuple[float, float] = (0.0, 0.02)  # N m s/rad
    load_friction: tuple[float, float] = (0.0, 0.03)
    delay_s: tuple[float, float] = (0.002, 0.008)
    once_per_turn: tuple[float, float] = (0.0, 0.002)  # rad
    stribeck: tuple[float, float] = (0.2, 0.45)
    stribeck_velocity: tuple[float, float] = (0.05, 0.25)  # rad/s
    encoder_noise: float = 0.0005  # rad, standard deviation
    sampling_jitter_s: float = 0.001  # standard deviation
    stamp_jitter_s: float = 0.0003  # standard deviation


SPREAD = Spread()
CLIP = 2.5


@dataclass(frozen=True)
class HiddenRobot:
    """What is not stated to the identification. Tuples have one value per joint, joint1 to joint4, at the output shaft.

    Attributes:
        torque_constant: Torque per current [N m/A].
        armature: Inertia of rotor and gears [kg m^2].
        coulomb: Dry friction without load [N m].
        viscous: Viscous friction [N m s/rad].
        load_friction: Part of the motor's torque that adds to the dry friction.
        stribeck: By how much of itself dry friction is greater at rest; it falls as exp(-(v / stribeck_velocity)^2).
        stribeck_velocity: [rad/s].
        zero: True position minus reading [rad].
        once_per_turn: Amplitude a of the reading's error a sin(q + phase) [rad].
        phase: [rad].
        link_mass_scale: Mass and inertia of each of `LINKS` relative to the URDF.
        link_com: Centre of mass of each of `LINKS` less the URDF's [m]; link_inertia_scale: inertia about it, relative.
        run_torque: Standard deviation of a torque on the driven joint that differs from run to run [N m].
        onset_s: Standard deviation of the delay from run to run.
        delay_s: From the command's stamp to the torque.
        quantised: Whether positions and currents are whole counts.
        encoder_noise: Standard deviation before rounding [rad].
        sampling_jitter_s: Standard deviation of the sampling instants about the cycle; the stamps have it, too.
        stamp_jitter_s: Standard deviation of the stamps about the sampling instants.
        compliance: Whether servos hold the joints that are not driven; they stand still otherwise.
        back_emf: Whether the supply limits the current.
    """

    torque_constant: tuple[float, ...] = (NOMINAL_TORQUE_CONSTANT,) * 4
    armature: tuple[float, ...] = (NOMINAL_ARMATURE,) * 4
    coulomb: tuple[float, ...] = (0.0,) * 4
    viscous: tuple[float, ...] = (0.0,) * 4
    load_friction: tuple[float, ...] = (0.0,) * 4
    stribeck: tuple[float, ...] = (0.0,) * 4
    stribeck_velocity: tuple[float, ...] = (0.1,) * 4
    zero: tuple[float, ...] = (0.0,) * 4
    once_per_turn: tuple[float, ...] = (0.0,) * 4
    phase: tuple[float, ...] = (0.0,) * 4
    link_mass_scale: tuple[float, ...] = (1.0,) * len(LINKS)
    link_com: tuple[tuple[float, float, float], ...] = ((0.0, 0.0, 0.0),) * len(LINKS)
    link_inertia_scale: tuple[float, ...] = (1.0,) * len(LINKS)
    run_torque: float = 0.0
    onset_s: float = 0.0
    delay_s: float = 0.0
    quantised: bool = False
    encoder_noise: float = 0.0
    sampling_jitter_s: float = 0.0
    stamp_jitter_s: float = 0.0
    compliance: bool = False
    back_emf: bool = False

    def reading_error(self, positions: FloatArray) -> FloatArray:
        """Reading minus true position, without noise [rad], shape (..., 4)."""
        turning: FloatArray = np.array(self.once_per_turn) * np.sin(
            positions + np.array(self.phase)
        )
        return turning - np.array(self.zero)


FIELDS_OF = {
    "delay": ("delay_s",),
    "link_mass": ("link_mass_scale",),
    "link_shape": ("link_com", "link_inertia_scale"),
    "onset": ("onset_s",),
    "jitter": ("sampling_jitter_s", "stamp_jitter_s"),
    "once_per_turn": ("once_per_turn", "phase"),
    "stribeck": ("stribeck", "stribeck_velocity"),
}
"""Fields that an effect sets; other effects set the field of their name."""


def draw_robot(
    rng: np.random.Generator,
    effects: Collection[str] = EFFECTS_DEFAULT,
    spread: Spread = SPREAD,
) -> HiddenRobot:
    """Draw a robot; what is not among the effects is nominal. The same seed gives the same numbers for every set of effects.

    Raises:
        ValueError: An effect is not one of `EFFECTS`.
    """
    unknown = set(effects) - set(EFFECTS)
    if unknown:
        raise ValueError(f"unknown effects {sorted(unknown)}; choose from {', '.join(EFFECTS)}")

    def uniform(ends: tuple[float, float]) -> tuple[float, ...]:
        return tuple(rng.uniform(*ends, 4).tolist())

    def scales(
        common_and_own: tuple[float, float],
        count: int,
    ) -> tuple[float, ...]:
        common, own = common_and_own
        return tuple((1.0 + common * _gaussian(rng, 1)[0] + own * _gaussian(rng, count)).tolist())

    drawn = HiddenRobot(
        torque_constant=tuple(
            NOMINAL_TORQUE_CONSTANT * scale for scale in scales(spread.torque_constant, 4)
        ),
        link_mass_scale=scales(spread.link_mass, len(LINKS)),
        zero=tuple((spread.zero * _gaussian(rng, 4)).tolist()),
        armature=uniform(spread.armature),
        coulomb=uniform(spread.coulomb),
        viscous=uniform(spread.viscous),
        load_friction=uniform(spread.load_friction),
        once_per_turn=uniform(spread.once_per_turn),
        phase=uniform((0.0, 2.0 * math.pi)),
        stribeck=uniform(spread.stribeck),
        stribeck_velocity=uniform(spread.stribeck_velocity),
        delay_s=float(rng.uniform(*spread.delay_s)),
        quantised=True,
        encoder_noise=spread.encoder_noise,
        sampling_jitter_s=spread.sampling_jitter_s,
        stamp_jitter_s=spread.stamp_jitter_s,
        compliance=True,
        back_emf=True,
        run_torque=spread.run_torque,
        onset_s=spread.onset_s,
        link_com=tuple(tuple((spread.link_com * _gaussian(rng, 3)).tolist()) for _ in LINKS),
        link_inertia_scale=tuple((1.0 + spread.link_inertia * _gaussian(rng, len(LINKS))).tolist()),
    )
    return _with_effects(drawn, effects)


def _with_effects(drawn: HiddenRobot, effects: Collection[str]) -> HiddenRobot:
    """What belongs to the effects as it was drawn, and all else nominal."""
    kept = {name for effect in effects for name in FIELDS_OF.get(effect, (effect,))}
    return HiddenRobot(
        **{field.name: getattr(drawn, field.name) for field in fields(drawn) if field.name in kept}
    )


def _gaussian(rng: np.random.Generator, count: int) -> FloatArray:
    """Standard normal numbers, those beyond `CLIP` drawn again."""
    values: FloatArray = rng.standard_normal(count)
    while (far := np.abs(values) > CLIP).any():
        values[far] = rng.standard_normal(int(far.sum()))
    return values


@dataclass(frozen=True)
class Load:
    """A rigid object in the hand.

    Attributes:
        mass: [kg].
        offset: Its centre of mass in the frame of end_effector_link [m].
        inertia: About that centre, in those axes: xx, yy, zz, xy, xz, yz [kg m^2].
    """

    mass: float
    offset: tuple[float, float, float]
    inertia: tuple[float, float, float, float, float, float]
    step_s: ClassVar[float] = STEP_S
    """What it is simulated with."""

    def add_to(self, spec: Any) -> Any:
        """The body, fixed to the hand of an ``MjSpec``."""
        body = spec.body("end_effector_link").add_body(name="load", explicitinertial=True)
        body.mass, body.ipos, body.fullinertia = self.mass, self.offset, self.inertia
        return body

    def settle(self, model: Any, data: Any) -> FloatArray:
        """Let come to rest what moves in it while the arm stands; the torque that holds its weight, shape (4,) [N m]."""
        return np.zeros(4)

    def couple(self, model: Any, data: Any) -> None:
        """Before each step: what acts on the hand beside the body's own weight and inertia."""


def ball(
    mass: float,
    diameter: float,
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Load:
    """A solid ball [kg, m]."""
    inertia = 0.1 * mass * diameter**2
    return Load(
        mass,
        offset,
        (inertia, inertia, inertia, 0.0, 0.0, 0.0),
    )


def cube(
    mass: float,
    edge: float,
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Load:
    """A solid cube [kg, m]."""
    inertia = mass * edge**2 / 6.0
    return Load(
        mass,
        offset,
        (inertia, inertia, inertia, 0.0, 0.0, 0.0),
    )


@dataclass(frozen=True)
class Motion:
    """The true motion. Times count from the onset of the torque.

    Attributes:
        times_s: shape (N,), starting at 0 with the arm at rest.
        position: Of joint1 to joint4 [rad], shape (N, 4).
        current_A: Of the driven joint's motor, zero once it is braked, shape (N,).
        hit: Names of the joints that touched the ends of their ranges before that.
    """

    times_s: FloatArray
    position: FloatArray
    current_A: FloatArray
    hit: tuple[str, ...]


def _model(
    robot: HiddenRobot,
    driven: int,
    opening: float,
    load: Load | None,
    step_s: float,
) -> Any:
    """Compiled model; a servo on every joint, so that a motor's torque is the actuator's force."""
    import mujoco

    spec = mujoco.MjSpec.from_file(str(URDF))
    spec.compiler.fusestatic = False  # fingers and load stay bodies of their own
    spec.option.timestep = step_s
    # RK4: a first-order method would need a tenth of the step
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    spec.option.gravity = (0.0, 0.0, -9.81)
    spec.option.disableflags = int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    for equality in list(spec.equalities):
        spec.delete(equality)
    for finger, direction in FINGERS.items():
        spec.delete(spec.joint(f"{finger}_joint"))
        body = spec.body(f"{finger}_link")
        body.pos[1] += direction * opening
    shapes = zip(
        LINKS, robot.link_mass_scale, robot.link_com, robot.link_inertia_scale, strict=True
    )
    for name, scale, shift, inertia in shapes:
        body = spec.body(name)
        body.mass *= scale
        body.ipos = np.array(body.ipos) + shift
        body.fullinertia = np.array(body.fullinertia) * scale * inertia
    if load is not None:
        load.add_to(spec)
    for index, name in enumerate(JOINTS):
        joint = spec.joint(name)
        joint.armature = robot.armature[index] if robot.compliance or index == driven else RIGID
        joint.damping[0] = robot.viscous[index]
        joint.solref_limit = (0.004, 1.0)
        for attribute, value in STICKING.items():
            setattr(joint, attribute, value)
        servo = spec.add_actuator(
            name=name,
            target=name,
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
        )
        servo.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        servo.gainprm[0], servo.biasprm[:3] = _servo(robot, index)
    return spec.compile()


def _servo(
    robot: HiddenRobot,
    index: int,
) -> tuple[float, tuple[float, float, float]]:
    """Gain and bias of the holding servo: torque = gain * target + bias . (1, q, v)."""
    stiffness = robot.torque_constant[index] * HOLD_A_PER_RAD
    return stiffness, (
        0.0,
        -stiffness,
        -robot.torque_constant[index] * HOLD_A_S_PER_RAD,
    )


def simulate(
    robot: HiddenRobot,
    joint: str,
    start: Mapping[str, float],
    current_A: float,
    duration_s: float,
    load: Load | None = None,
    step_s: float = STEP_S,
    extra_torque: float = 0.0,
    shake: tuple[float, float] = (0.0, 1.0),
    braked_s: float = BRAKED_S,
) -> Motion:
    """Move one joint from rest by a current and brake it; see `record` for the arguments.

    While it is driven, ``extra_torque`` [N m] acts on the driven joint as well.
    """
    import mujoco

    driven = JOINTS.index(joint)
    model = _model(robot, driven, start.get(GRIPPER, 0.0), load, step_s)
    data = mujoco.MjData(model)
    _hold(robot, model, data, start, load)
    model.actuator_gainprm[driven, 0] = 1.0
    model.actuator_biasprm[driven] = 0.0
    constant = robot.torque_constant[driven]
    data.ctrl[driven] = constant * current_A
    mujoco.mj_forward(model, data)
    data.qfrc_applied[driven] = extra_torque
    drive = _Drive(current_A, *shake, SUPPLY_V if robot.back_emf else math.inf)
    friction = _DryFriction(robot, driven, model, data)
    driven_steps = round(duration_s / step_s)
    steps = driven_steps + math.ceil(braked_s / step_s)
    positions = np.empty((steps + 1, 4))
    currents = np.zeros(steps + 1)
    # views, looked up once: the loop is all that takes time
    qpos = data.qpos[:4]
    qvel = data.qvel[:4]
    ctrl = data.ctrl
    before = np.zeros(4)
    for k in range(steps):
        positions[k] = qpos
        if k < driven_steps:
            # the speed amid the step, or a constant over it would make the method first order
            speed = 1.5 * qvel[driven] - 0.5 * before[driven]
            currents[k] = drive.current_A(k * step_s, speed)
            ctrl[driven] = constant * currents[k]
        elif k == driven_steps:
            _brake(robot, driven, model, data)
        friction.update(qvel, before)
        before[:] = qvel
        if load is not None:
            load.couple(model, data)
        mujoco.mj_step(model, data)
    positions[steps] = qpos
    hit = _ends_touched(model, positions[: driven_steps + 1])
    return Motion(step_s * np.arange(steps + 1, dtype=np.float64), positions, currents, hit)


def _hold(
    robot: HiddenRobot,
    model: Any,
    data: Any,
    start: Mapping[str, float],
    load: Load | None,
) -> None:
    """Every servo holds its joint at rest where its reading is that of the start.

    Args:
        robot: The robot.
        model: Of the arm with its load.
        data: State, which is set.
        start: Readings [rad]; 0 where none is given.
        load: What is in the hand, and settles.
    """
    import mujoco

    # the controller brings the readings to the start, and has found the torques that keep them there
    reading = np.array([start.get(name, 0.0) for name in JOINTS])
    data.qpos[:4] = reading
    for _ in range(3):
        data.qpos[:4] = reading - robot.reading_error(data.qpos[:4])
    mujoco.mj_forward(model, data)
    held = data.qfrc_bias[:4] + (np.zeros(4) if load is None else load.settle(model, data))
    data.ctrl[:] = data.qpos[:4] + held / model.actuator_gainprm[:, 0]


def _brake(
    robot: HiddenRobot,
    driven: int,
    model: Any,
    data: Any,
) -> None:
    """The servo of the driven joint holds it from now on, where it is."""
    data.qfrc_applied[driven] = 0.0
    gain, bias = _servo(robot, driven)
    model.actuator_gainprm[driven, 0] = gain
    model.actuator_biasprm[driven, :3] = bias
    data.ctrl[driven] = data.qpos[driven] + data.qfrc_bias[driven] / gain


def _ends_touched(model: Any, positions: FloatArray) -> tuple[str, ...]:
    """Names of the joints that leave their ranges, of positions (N, 4)."""
    low, high = model.jnt_range[:4].T
    touched = ((positions < low) | (positions > high)).any(axis=0)
    return tuple(name for name, touches in zip(JOINTS, touched, strict=True) if touches)


@dataclass(frozen=True)
class _Drive:
    """What flows in the motor of the driven joint.

    Attributes:
        commanded_A: By the command.
        shake_A, period_s: Amplitude and period of a square wave about it.
        reach_V: Of the supply; without end where it limits nothing.
    """

    commanded_A: float
    shake_A: float
    period_s: float
    reach_V: float

    def current_A(self, time_s: float, speed: float) -> float:
        """At a time since the onset, and a speed of the joint [rad/s]."""
        induced_V = BACK_EMF_V_S * speed
        most = (self.reach_V - induced_V) / RESISTANCE_OHM
        least = (-self.reach_V - induced_V) / RESISTANCE_OHM
        first_half = (time_s + 1e-9) % self.period_s < 0.5 * self.period_s
        wanted_A = self.commanded_A + (self.shake_A if first_half else -self.shake_A)
        return min(max(wanted_A, least), most)


class _DryFriction:
    """Dry friction of the joints that may move, written to where MuJoCo reads it."""

    def __init__(
        self,
        robot: HiddenRobot,
        driven: int,
        model: Any,
        data: Any,
    ) -> None:
        free = np.full(4, robot.compliance)
        free[driven] = True
        self._coulomb = free * robot.coulomb
        self._part = free * robot.load_friction
        self._rise = np.array(robot.stribeck)
        self._width = np.array(robot.stribeck_velocity)
        self._rubs = bool((self._coulomb + self._part).any())
        self._rises = bool(self._rise.any())
        self._torque = data.actuator_force
        self._friction = model.dof_frictionloss[:4]

    def update(self, speed: FloatArray, before: FloatArray) -> None:
        """For the next step, from the speeds now and a step ago [rad/s], (4,) each."""
        if not self._rubs:
            return
        friction = self._friction
        np.abs(self._torque, out=friction)
        friction *= self._part
        friction += self._coulomb
        if self._rises:
            amid = 1.5 * speed - 0.5 * before
            friction *= 1.0 + self._rise * np.exp(-((amid / self._width) ** 2))


def record(
    robot: HiddenRobot,
    joint: str,
    start: Mapping[str, float],
    current_A: float,
    duration_s: float,
    load: Load | None,
    rng: np.random.Generator,
    shake: tuple[float, float] = (0.0, 1.0),
    braked_s: float = BRAKED_S,
) -> Recording:
    """Probe once and record it: held 0.25 s, driven, braked 0.15 s or longer; states and commands at 40 Hz, the onset at time 0.

    Efforts are what the driven motor reports while it is driven, times the nominal torque constant; other motors tell none.

    Args:
        robot: The robot.
        joint: Which of `JOINTS` is driven.
        start: Readings at rest [rad], and opening of the gripper [m]; 0 where none is given.
        current_A: Commanded current.
        duration_s: How long it flows.
        load: What is in the hand.
        rng: For jitter and encoder noise.
        shake: Amplitude [A] and period [s] of a square wave about that current.
        braked_s: How long it is held and recorded afterwards.
    """
    if robot.quantised:
        current_A = COUNT_A * round(current_A / COUNT_A)
        shake = COUNT_A * round(shake[0] / COUNT_A), shake[1]
    extra = robot.run_torque * float(rng.standard_normal())
    late_s = robot.onset_s * float(rng.standard_normal())
    step_s = STEP_S if load is None else load.step_s
    motion = simulate(
        robot, joint, start, current_A, duration_s, load, step_s, extra, shake, braked_s
    )
    first = -round(BEFORE_S / PERIOD_S)
    last = round((duration_s + braked_s) / PERIOD_S)
    cycles_s = PERIOD_S * np.arange(first, last + 1, dtype=np.float64)
    instants_s = cycles_s + robot.sampling_jitter_s * _gaussian(rng, len(cycles_s))
    stamps_s = instants_s + robot.stamp_jitter_s * _gaussian(rng, len(cycles_s))
    since_torque_s = instants_s - robot.delay_s - late_s
    column = JOINTS.index(joint)
    shafts = _shafts(robot, motion, since_torque_s, start.get(GRIPPER, 0.0), rng)
    currents = _currents(robot, motion, since_torque_s, column)
    commands = np.zeros_like(currents)
    commands[:, column] = _commands(cycles_s, current_A, duration_s, shake)
    efforts = NOMINAL_TORQUE_CONSTANT * currents
    names = (*JOINTS, GRIPPER)
    return Recording(
        name=f"{joint} {1e3 * current_A:+.0f} mA",
        joints=JointRecord(
            _ns(stamps_s),
            names,
            shafts * (1.0, 1.0, 1.0, 1.0, GRIPPER_M_PER_RAD),
            effort=efforts,
            current=currents,
            reported_effort=efforts,
        ),
        inputs=InputRecord(_ns(cycles_s), names, commands, source="/current_command"),
        notes=tuple(f"{name} touched the end of its range" for name in motion.hit),
    )


def _shafts(
    robot: HiddenRobot,
    motion: Motion,
    times_s: np.ndarray,
    opening_m: float,
    rng: np.random.Generator,
) -> np.ndarray:
    """What the encoders of the joints and of the gripper, which is open so wide, say at those times [rad], (n, 5)."""
    true = np.stack(
        [
            np.interp(
                times_s,
                motion.times_s,
                column,
            )
            for column in motion.position.T
        ],
        axis=1,
    )
    shafts = np.column_stack(
        [
            true + robot.reading_error(true),
            np.full(len(times_s), opening_m / GRIPPER_M_PER_RAD),
        ]
    )
    shafts += robot.encoder_noise * rng.standard_normal(shafts.shape)
    return COUNT_RAD * np.round(shafts / COUNT_RAD) if robot.quantised else shafts


def _currents(
    robot: HiddenRobot,
    motion: Motion,
    times_s: np.ndarray,
    column: int,
) -> np.ndarray:
    """What the driven motor reports at those times [A], in its column of (n, 5)."""
    currents = np.zeros((len(times_s), len(JOINTS) + 1))
    currents[:, column] = np.interp(
        times_s,
        motion.times_s,
        motion.current_A,
        left=0.0,
    )
    return COUNT_A * np.round(currents / COUNT_A) if robot.quantised else currents


def _commands(
    cycles_s: np.ndarray,
    current_A: float,
    duration_s: float,
    shake: tuple[float, float],
) -> np.ndarray:
    """The current that is commanded in each cycle [A], (n,): about the push's, while it lasts."""
    amplitude_A, shake_s = shake
    on = (cycles_s > -0.5 * PERIOD_S) & (cycles_s < duration_s - 0.5 * PERIOD_S)
    first_half = (cycles_s + 0.25 * PERIOD_S) % shake_s < 0.5 * shake_s
    pushed = current_A + np.where(first_half, amplitude_A, -amplitude_A)
    return np.where(on, pushed, 0.0)


def _ns(times_s: FloatArray) -> Any:
    """Whole nanoseconds, as the records want them."""
    return np.round(1e9 * times_s).astype(np.int64)


@dataclass(frozen=True)
class Probe:
    """One run's joint, start [rad], current [A] and duration [s]."""

    joint: str
    start: Mapping[str, float]
    current_A: float
    duration_s: float = 0.6


def _probe(
    joint: str,
    joint2: float,
    joint3: float,
    joint4: float,
    current_A: float,
) -> Probe:
    return Probe(
        joint,
        {
            "joint1": 0.0,
            "joint2": joint2,
            "joint3": joint3,
            "joint4": joint4,
            GRIPPER: 0.0,
        },
        current_A,
    )


# Starts that are recommended for this arm. Some currents are higher than recommended, or many robots would stick.
EMPTY_PROBES = (
    _probe("joint3", -1.4, 0.6, 0.0, -0.30),  # lifts
    _probe("joint3", -1.4, 0.2, 0.0, -0.18),  # lifts
    _probe("joint3", -0.6, -0.4, 0.0, -0.08),  # lowers
    _probe("joint3", -0.6, -0.6, 0.0, -0.03),  # lowers
    _probe("joint3", -0.8, -0.6, 0.0, 0.03),  # is driven down
    _probe("joint2", 0.0, -1.0, 0.0, -0.32),  # lifts
    _probe("joint2", 0.0, -1.2, 0.0, -0.26),  # lifts
    _probe("joint2", 0.0, -1.0, 0.0, -0.12),  # lowers
    _probe("joint2", -0.2, -1.2, 0.0, 0.08),  # is driven down
    _probe("joint4", -0.6, -1.0, 0.4, -0.10),  # lifts
    _probe("joint4", -0.6, -0.6, 0.8, -0.15),  # lifts
    _probe("joint4", -1.0, -0.6, 0.4, 0.04),  # is driven down
)
LOADED_PROBES = (
    _probe("joint3", -1.4, 0.6, 0.0, -0.30),  # lifts up to 50 g
    _probe("joint3", -1.4, 0.8, 0.0, -0.40),  # lifts up to 100 g, half of the robots
    _probe("joint3", -0.6, -0.6, 0.0, -0.04),  # lowers
    _probe("joint2", 0.1, -1.0, 0.0, -0.40),  # lifts up to 50 g
    # lifts up to 100 g; some robots reach the joint's end with 20 g or less
    _probe("joint2", 0.0, -1.0, 0.0, -0.36),
    _probe("joint2", 0.0, -1.0, 0.0, -0.12),  # lowers
)


def main(robots: int = 5) -> None:
    """Print what a run costs, how far it moves, and how exact the step is; then how far a stuck joint creeps."""
    rng = np.random.default_rng(1)
    cases = [(probe, None) for probe in EMPTY_PROBES[::3]] + [
        (probe, ball(0.05, 0.043)) for probe in LOADED_PROBES[::2]
    ]
    simulate(HiddenRobot(), "joint3", {}, 0.0, 0.01)  # importing MuJoCo is none of the costs
    print(
        f"steps of {1e3 * STEP_S:g} ms against a fifth of it: rms over the driven time of the joint that differs most"
    )
    worst = 0.0
    costs = []
    for number in range(robots):
        effects = EFFECTS if number == 4 else EFFECTS_DEFAULT
        robot = draw_robot(rng, effects)
        for probe, load in cases:
            arguments = (robot, probe.joint, probe.start, probe.current_A, probe.duration_s, load)
            started = time.process_time()
            record(*arguments, rng)
            costs.append(1e3 * (time.process_time() - started))
            coarse = simulate(*arguments)
            fine = simulate(*arguments, step_s=STEP_S / 5)
            rows = coarse.times_s <= probe.duration_s
            apart = coarse.position[rows] - fine.position[::5][: len(coarse.times_s)][rows]
            rms = 1e3 * float(np.sqrt((apart**2).mean(axis=0)).max())
            worst = max(worst, rms)
            moved = (
                coarse.position[rows][-1, JOINTS.index(probe.joint)]
                - coarse.position[0, JOINTS.index(probe.joint)]
            )
            print(
                f"robot {number}{' (Stribeck)' if 'stribeck' in effects else ''}, {probe.joint} {probe.current_A:+.2f} A,"
                f" {'empty' if load is None else f'{1e3 * load.mass:.0f} g'}: {costs[-1]:.0f} ms of CPU,"
                f" travel {moved:+.3f} rad, {rms:.4f} mrad apart{', at the end of a range' if coarse.hit else ''}"
            )
    print(
        f"median {np.median(costs):.0f} ms, slowest {max(costs):.0f} ms; at most {worst:.4f} mrad apart"
    )
    sticky = HiddenRobot(coulomb=(0.5,) * 4, compliance=True)  # holds the arm without current
    stuck = simulate(
        sticky,
        "joint3",
        LOADED_PROBES[0].start,
        0.0,
        0.6,
        ball(0.05, 0.043),
    )
    print(f"a stuck joint creeps {1e3 * np.ptp(stuck.position, axis=0).max():.4f} mrad")


if __name__ == "__main__":
    main()
