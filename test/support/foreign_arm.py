"""Somebody else's three-joint arm behind an effort or position controller, on a computer that is busy elsewhere.

It shares nothing with the package: links, friction, drives, delays and stalls are its own, in MuJoCo. One thread takes commands,
another publishes joint states (500 Hz, alphabetical, no velocities, no efforts, two joints of others), and either is held up by
other programs for 20 to 200 ms now and then. A command comes into effect after 1 to 80 ms, which differ from one to the next; the
last one stays. As a process
of its own, over DDS: test/benchmarks/foreign_process.py.
"""

from __future__ import annotations

import math
import re
from collections import deque
from dataclasses import dataclass
from pathlib import Path

import numpy as np

JOINTS = ("shoulder", "elbow", "wrist")  # from the base on
ORDER = ("elbow", "shoulder", "wrist")  # of the controller, as of the broadcaster
BROADCAST = ("conveyor", "elbow", "lift", "shoulder", "wrist")
LENGTH_M = {"shoulder": 0.28, "elbow": 0.24, "wrist": 0.1}
MASS_KG = {"shoulder": 1.6, "elbow": 1.0, "wrist": 0.4}
EFFORT_N_M = {"shoulder": 40.0, "elbow": 20.0, "wrist": 8.0}
SHARE = {"shoulder": 1.0, "elbow": 0.5, "wrist": 0.2}
LIMIT_RAD = 2.6
HEIGHT_M = 0.7
STEP_S = 1e-3
START = {"shoulder": -0.9, "elbow": 0.8, "wrist": 0.2}
LOADING_S = 1.5  # a person lets go of what is put into the hand that slowly
# of the position controller, as shares of the largest torque
STIFFNESS_PER_RAD = 4.0
SUPPLY_V = 12.0  # any: torque goes with the share of it
COUNT_RAD = 2.0 * math.pi / 2**15


def damping_s_per_rad(stiffness_per_rad: float) -> float:
    """Of a position controller that is about as well damped whatever its stiffness, as a share of the largest torque."""
    return 0.175 * math.sqrt(stiffness_per_rad)


def urdf() -> str:
    """What its maker says."""
    parts = ['<link name="base"/>']
    parent = "base"
    reach = f"0 0 {HEIGHT_M}"
    for name in JOINTS:
        length = LENGTH_M[name]
        mass = MASS_KG[name]
        across = mass * length**2 / 12.0
        parts += [
            f'<link name="{name}_link"><inertial><origin xyz="{0.5 * length} 0 0"/><mass value="{mass}"/>'
            f'<inertia ixx="{0.02 * across}" iyy="{across}" izz="{across}" ixy="0" ixz="0" iyz="0"/></inertial></link>',
            f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{name}_link"/><origin xyz="{reach}"/>'
            f'<axis xyz="0 1 0"/><limit lower="-{LIMIT_RAD}" upper="{LIMIT_RAD}" effort="{EFFORT_N_M[name]}" velocity="6"/>'
            "</joint>",
        ]
        parent = f"{name}_link"
        reach = f"{length} 0 0"
    parts += [
        '<link name="tool0"/><joint name="mount" type="fixed"><parent link="wrist_link"/><child link="tool0"/>'
        f'<origin xyz="{LENGTH_M["wrist"]} 0 0"/></joint>'
    ]
    return f'<robot name="foreign">{"".join(parts)}</robot>'


@dataclass(frozen=True)
class Busy:
    """What a seed says of the computer: delay of commands, how much it differs, how often something stalls [s]."""

    delay_s: float
    jitter_s: float
    every_s: float

    @classmethod
    def draw(cls, seed: int) -> Busy:
        random = np.random.default_rng([seed, 1])
        delay_s = math.exp(random.uniform(math.log(1e-3), math.log(80e-3)))
        return cls(
            delay_s,
            random.uniform(0.0, 1e-3 + 0.2 * delay_s),
            random.uniform(3.0, 8.0),
        )


class ForeignArm:
    """Arm, controller and computer; times are those of whoever asks [s].

    Args:
        seed: Says what the arm is really like, and what the computer does.
        goals: Whether it takes goals [rad] instead of torques [N m].
        busy: Of the computer; None: as the seed says.
        stiffness_per_rad: Of the position controller, as a share of the largest torque.
    """

    def __init__(
        self,
        seed: int,
        goals: bool = False,
        busy: Busy | None = None,
        stiffness_per_rad: float = STIFFNESS_PER_RAD,
    ) -> None:
        import mujoco

        self.stiffness_per_rad = stiffness_per_rad

        self.mujoco = mujoco
        self.goals = goals
        self.busy = busy or Busy.draw(seed)
        self._random = np.random.default_rng([seed, 2])
        truth = np.random.default_rng([seed, 3])
        self.model = mujoco.MjModel.from_xml_string(self._xml(truth))
        self.data = mujoco.MjData(self.model)
        self.data.qpos[:] = [START[name] for name in JOINTS]
        self.scale = 1.0 + truth.normal(0.0, 0.03, 3)  # torque over that which was commanded
        self._columns = [JOINTS.index(name) for name in ORDER]
        self._limits = np.array([EFFORT_N_M[name] for name in JOINTS])
        self._coming: deque[tuple[float, np.ndarray]] = deque()
        self._last_s, self._now_s = -math.inf, math.nan
        self._wanted: np.ndarray | None = None
        self._held_kg = self._to_hold_kg = 0.0
        self._hand, self._empty_kg = (
            mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_BODY, "held"),
            1e-6,
        )
        self._stalls: dict[str, tuple[float, float]] = {}

    def _xml(self, truth: np.random.Generator) -> str:
        bodies = ""
        ends = ""
        for number, name in enumerate(JOINTS):
            length = LENGTH_M[name]
            mass = MASS_KG[name] * (1.0 + truth.normal(0.0, 0.02))
            across = mass * length**2 / 12.0
            place = f"0 0 {HEIGHT_M}" if not number else f"{LENGTH_M[JOINTS[number - 1]]} 0 0"
            share = SHARE[name]
            bodies += (
                f'<body name="{name}" pos="{place}"><joint name="{name}" type="hinge" axis="0 1 0" limited="true" '
                f'range="-{LIMIT_RAD} {LIMIT_RAD}" frictionloss="{share * truth.uniform(0.2, 0.6)}" '
                f'damping="{share * truth.uniform(0.1, 0.4)}" armature="{0.1 * share * truth.uniform(0.5, 1.5)}"/>'
                f'<inertial pos="{0.5 * length + truth.normal(0.0, 0.003)} 0 0" mass="{mass}" '
                f'diaginertia="{0.02 * across} {across} {across}"/>'
            )
            ends += "</body>"
        held = (
            f'<body name="held" pos="{LENGTH_M["wrist"]} 0 0"><inertial pos="0 0 0" mass="1e-6" '
            'diaginertia="1e-9 1e-9 1e-9"/></body>'
        )
        return (
            f'<mujoco><compiler angle="radian"/><option timestep="{STEP_S}" integrator="implicitfast"/>'
            f"<worldbody>{bodies}{held}{ends}</worldbody></mujoco>"
        )

    def hold(self, mass_kg: float) -> None:
        """A person puts something into the hand, or takes it out."""
        self._to_hold_kg = mass_kg

    def command(
        self,
        now_s: float,
        values: list[float],
    ) -> None:
        """As a forward controller: all joints in its order, in effect after a while, and until the next."""
        self.advance(now_s)
        if len(values) != len(ORDER) or not all(map(math.isfinite, values)):
            return
        wanted = np.zeros(len(JOINTS))
        wanted[self._columns] = values
        jitter_s = self.busy.jitter_s * self._random.uniform(-0.5, 0.5)
        arrives_s = now_s + self.busy.delay_s + jitter_s
        self._last_s = max(self._last_s, arrives_s)
        self._coming.append((self._last_s, wanted))

    def stalled(self, now_s: float, thread: str) -> float:
        """Until when a thread gets no time, where it gets none now; else 0."""
        begins_s, ends_s = self._stalls.get(
            thread,
            (math.nan, -math.inf),
        )
        if not now_s < ends_s + 1.0 or math.isnan(begins_s):
            begins_s = max(now_s, ends_s) + self._random.exponential(self.busy.every_s)
            self._stalls[thread] = begins_s, begins_s + self._random.uniform(0.02, 0.2)
            return 0.0
        return ends_s if begins_s <= now_s < ends_s else 0.0

    def advance(self, now_s: float) -> None:
        if math.isnan(self._now_s) or now_s - self._now_s > 1.0:
            self._now_s = now_s - STEP_S
        while self._now_s + STEP_S <= now_s:
            self._now_s += STEP_S
            while self._coming and self._coming[0][0] <= self._now_s:
                self._wanted = self._coming.popleft()[1]
            if self._wanted is None:
                continue  # its brakes are on
            step_kg = STEP_S / LOADING_S
            self._held_kg += min(
                max(self._to_hold_kg - self._held_kg, -step_kg),
                step_kg,
            )
            self.model.body_mass[self._hand] = self._empty_kg + self._held_kg
            limits = self._limits
            torque = self._wanted
            if self.goals:
                torque = limits * (
                    self.stiffness_per_rad * (self._wanted - self.data.qpos)
                    - damping_s_per_rad(self.stiffness_per_rad) * self.data.qvel
                )
            possible = np.minimum(np.maximum(torque, -limits), limits)
            self.data.qfrc_applied[:] = self.scale * possible
            self.mujoco.mj_step(self.model, self.data)

    def positions(self) -> list[float]:
        """In the order of `BROADCAST` [rad], as encoders count."""
        read = dict(
            zip(
                JOINTS,
                np.rint(self.data.qpos / COUNT_RAD) * COUNT_RAD,
                strict=True,
            )
        )
        return [float(read.get(name, 0.25)) for name in BROADCAST]


def write_urdf(folder: Path) -> Path:
    path = folder / "foreign.urdf"
    path.write_text(urdf(), encoding="utf-8")
    return path


def state_servos(robot: Path, stiffness_per_rad: float) -> None:
    """What its owner knows of the position controller: stiffness and damping of each joint, as shares of its largest torque."""
    text = robot.read_text()
    for name in JOINTS:
        head, of, rest = text.partition(f"\n  {name}:")
        for key, value in {
            "supply_voltage_V": SUPPLY_V, "back_emf_V_s_per_rad": damping_s_per_rad(stiffness_per_rad) * SUPPLY_V,
            "resistance_ohm": SUPPLY_V / EFFORT_N_M[name],
            "driven_by": f"{{kind: position_servo, gain_per_rad: {stiffness_per_rad}}}",
        }.items():  # fmt: skip
            rest = re.sub(rf"\b{key}: \S+", f"{key}: {value}", rest, count=1)
        text = head + of + rest
    robot.write_text(text)
