"""Arms with torque sensing that work and pick things up: MuJoCo's inverse dynamics along smooth moves from pose to pose.

The arm differs from its URDF: links, what friction the sensors see, how that goes with place and time, scale and offset of each
sensor are drawn at random. Efforts are N m, and no line is shared with the identification.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from proprio_ros.recordings.motions import Motion
from support.drawn_arm import joints_of, write_urdf

TORQUE_STD = 0.01
"""Relative, of each sensor's scale, as the robot file says."""
Load = tuple[float, np.ndarray]
"""Mass [kg] and centre in the hand's frame [m]."""


def write_sensing_arm(folder: Path, joints: int, seed: int) -> Path:
    """URDF and robot file of an arm whose joint states carry torque; returns the robot file."""
    write_urdf(folder / "sensing.urdf", joints, seed)
    lines = ["name: sensing", "urdf: sensing.urdf", "payload_frame: tool0", "joints:"]
    for name in joints_of(joints):
        lines += [
            f"  {name}:",
            "    motor: {nominal_torque_constant_N_m_per_A: 1.0, encoder_resolution_rad: 2.0e-5, encoder_noise_rad: 2.0e-5}",
            f"    drive_train: {{torque_constant_N_m_per_A: {{value: 1.0, std: {TORQUE_STD}}}}}",
        ]
    path = folder / "sensing.yaml"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


@dataclass
class SensingArm:
    """One arm as it really is.

    Args:
        folder: With what `write_sensing_arm` wrote.
        joints, seed: As there.
        rate_Hz: Of its joint states.
        reached_rad: Poses lie within so much of the middle one.
    """

    folder: Path
    joints: int
    seed: int
    rate_Hz: float = 200.0
    reached_rad: float = 1.2

    def __post_init__(self) -> None:
        import mujoco

        self.rng = rng = np.random.default_rng([self.seed, 31])
        text = (self.folder / "sensing.urdf").read_text(encoding="utf-8").replace(
            '<link name="tool0"/>',
            '<link name="tool0"><inertial><mass value="1e-6"/><inertia ixx="1e-9" iyy="1e-9" izz="1e-9" ixy="0" ixz="0" iyz="0"/>'
            "</inertial></link>",
        )  # fmt: skip
        spec = mujoco.MjSpec.from_string(text)
        spec.compiler.fusestatic = False
        self.model = model = spec.compile()
        model.opt.disableflags |= (
            mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
        )
        self.data, self.tool = mujoco.MjData(model), model.body("tool0").id
        links = [model.body(f"body_{number}").id for number in range(self.joints)]
        model.body_mass[links] *= 1.0 + 0.05 * rng.standard_normal(self.joints)
        model.body_ipos[links] += 0.004 * rng.standard_normal((self.joints, 3))
        size = 1.0 - 0.75 * np.arange(self.joints) / self.joints
        self.noise = rng.uniform(0.04, 0.12) * size
        self.drift, self.drift_s = (
            rng.uniform(0.03, 0.12, self.joints) * size,
            rng.uniform(1.0, 8.0, self.joints),
        )
        self.coulomb = rng.uniform(0.05, 0.5, self.joints) * size
        self.viscous = rng.uniform(0.0, 0.5, self.joints) * size
        self.place, self.phase = (
            rng.uniform(0.0, 0.3, self.joints),
            rng.uniform(0.0, 6.0, self.joints),
        )
        self.scale = 1.0 + TORQUE_STD * rng.standard_normal(self.joints)
        self.middle = rng.uniform(-0.5, 0.5, self.joints)
        self.at, self.now_s = self.middle.copy(), 0.0

    def load(self, mass_kg: float) -> Load:
        """So much at a place that is 1 cm off in each direction, one standard deviation."""
        return mass_kg, 0.01 * self.rng.standard_normal(3)

    def weight_per_kg(self) -> np.ndarray:
        """Torque of each joint that carries 1 kg in the hand at a random pose [N m/kg], shape (n,)."""
        import mujoco

        pose = self.middle + self.rng.uniform(-self.reached_rad, self.reached_rad, self.joints)
        torques = []
        for load in (None, (1.0, np.zeros(3))):
            self._hold(load)
            self.data.qpos[:] = pose
            self.data.qvel[:] = 0.0
            self.data.qacc[:] = 0.0
            mujoco.mj_inverse(self.model, self.data)
            torques.append(self.data.qfrc_inverse.copy())
        return torques[1] - torques[0]

    def _moves(self, seconds: float, elsewhere: float) -> np.ndarray:
        """Positions, velocities and accelerations at the instants of the joint states, shape (3, T, n)."""
        rng = self.rng
        parts = []
        samples = round(seconds * self.rate_Hz)
        while sum(part.shape[1] for part in parts) < samples:
            away = rng.uniform(-self.reached_rad, self.reached_rad, self.joints)
            goal = self.middle + elsewhere + away
            way = goal - self.at
            takes_s = rng.uniform(0.8, 1.2) + 0.6 * np.abs(way).max()
            rest_s = rng.uniform(0.05, 0.5)
            count = round((takes_s + rest_s) * self.rate_Hz)
            s = np.arange(count)[:, None] / self.rate_Hz / takes_s
            s = np.minimum(s, 1.0)
            share = 10 * s**3 - 15 * s**4 + 6 * s**5
            rate = 30 * s**2 - 60 * s**3 + 30 * s**4
            bend = 60 * s - 180 * s**2 + 120 * s**3
            parts.append(
                np.array(
                    [
                        self.at + way * share,
                        way * rate / takes_s,
                        way * bend / takes_s**2,
                    ]
                )
            )
            self.at = goal
        moves = np.concatenate(parts, axis=1)[:, :samples]
        self.at = moves[0, -1].copy()
        return moves

    def _hold(self, load: Load | None) -> None:
        import mujoco

        mass, centre = load or (1e-6, np.zeros(3))
        self.model.body_mass[self.tool], self.model.body_ipos[self.tool] = mass, centre
        self.model.body_inertia[self.tool] = 0.4 * mass * 0.03**2
        mujoco.mj_setConst(self.model, self.data)

    def _drift(self, count: int) -> np.ndarray:
        """Offsets of the sensors that wander, of so many samples [N m], (count, n)."""
        keeps = np.exp(-1.0 / self.rate_Hz / self.drift_s)
        steps = self.rng.standard_normal((count, self.joints)) * self.drift
        drift = np.zeros_like(steps)
        drift[0] = steps[0]
        for row in range(1, count):
            drift[row] = keeps * drift[row - 1] + np.sqrt(1.0 - keeps**2) * steps[row]
        return drift

    def work(
        self,
        seconds: float,
        loads: Sequence[tuple[float, Load | None]] = (),
        name: str = "work",
        elsewhere: float = 0.0,
    ) -> Motion:
        """What it reports; it takes each load (None: puts it down) at that many seconds, in whatever motion it is.

        Args:
            seconds: How long it works [s].
            loads: When each is taken [s].
            name: Of the motion.
            elsewhere: How far from its usual poses it works [rad].
        """
        rng = self.rng
        moves = self._moves(seconds, elsewhere)
        position, velocity, _ = moves
        count = len(position)
        times_s = np.arange(count) / self.rate_Hz
        torque = self._torque_along(moves, times_s, loads)
        of_place = 1.0 + self.place * np.sin(position + self.phase)
        friction = self.coulomb * of_place * np.tanh(velocity / 0.01)
        drift = self._drift(count)
        warm = 1.0 + 0.05 * rng.standard_normal(self.joints)
        torque += friction * warm + self.viscous * velocity + drift
        effort = torque * self.scale + self.noise * rng.standard_normal(torque.shape)
        heard_s = times_s + 2e-4 * rng.standard_normal(count)
        reading = position + 2e-5 * rng.standard_normal(position.shape)
        return Motion(
            name,
            tuple(joints_of(self.joints)),
            heard_s - heard_s[0],
            reading,
            effort,
            {},
            "measured torque",
        )

    def _torque_along(
        self,
        moves: np.ndarray,
        times_s: np.ndarray,
        loads: Sequence[tuple[float, Load | None]],
    ) -> np.ndarray:
        """MuJoCo's inverse dynamics without friction [N m], (count, n), along moves, (3, count, n)."""
        import mujoco

        data = self.data
        torque = np.zeros((len(times_s), self.joints))
        ahead = list(loads)
        self._hold(None)
        for row, (q, qd, qdd) in enumerate(np.swapaxes(moves, 0, 1)):
            while ahead and times_s[row] >= ahead[0][0]:
                self._hold(ahead.pop(0)[1])
            data.qpos[:] = q
            data.qvel[:] = qd
            data.qacc[:] = qdd
            mujoco.mj_inverse(self.model, data)
            torque[row] = data.qfrc_inverse
        return torque
