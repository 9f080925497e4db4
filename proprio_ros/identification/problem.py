"""A weighing as a least-squares problem: runs, robot and payload in; whitened residuals and their exact Jacobian out.

The observation model: the encoder shows ``q(t - delay)`` plus rounding, noise and stamp jitter, so a residual is weighted by
``sqrt(resolution^2 / 12 + noise^2 + (velocity x jitter)^2)``. All samples of the used window count, not only the last.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from proprio_ros.errors import RecordingError
from proprio_ros.identification.unknowns import Coordinates, Role, Unknown
from proprio_ros.records import MEASURED_EFFORT, Run
from proprio_ros.robot import DriveTrain, Quantity, ReducedModel, Robot
from proprio_ros.sim.joint import INDEX, PARAMETERS, JointRun, JointSimulator
from proprio_ros.sim.payload import (
    PayloadFacts,
    joint_coefficients,
    payload_parameters,
    payload_parameters_by_com,
    pseudo_inertia_basis,
)

START_VELOCITY_STD = 0.01
"""rad/s: how still a held joint is when the current comes on. A probe starts from rest; this is its measure."""
DRIVE_TERMS = ("torque_constant", "coulomb", "viscous", "load_friction", "armature")
"""Fields of a ``DriveTrain`` that are unknowns of the driven joint."""
MIN_SLOW = 3
"""Slow samples needed to relate reported effort to the command."""
_POSE_STEP = 1e-5  # rad or m, central difference over the pose of a held joint (numpy only, error about 1e-10)
_GRAVITY_ROWS = slice(0, 4)


@dataclass(frozen=True)
class Coefficients:
    """Inertia and gravity load of the moving part as functions of the payload and of pose errors.

    Attributes:
        arm: without payload, shape (4,).
        payload: per payload parameter, shape (4, 10).
        pose: names of the held joints whose zero matters.
        arm_by_pose: shape (H, 4); payload_by_pose: shape (H, 4, 10): change per unit of the held joint's position.
    """

    arm: np.ndarray
    payload: np.ndarray
    pose: tuple[str, ...]
    arm_by_pose: np.ndarray
    payload_by_pose: np.ndarray


@dataclass(frozen=True)
class PreparedRun:
    """A run as the fit uses it.

    Attributes:
        run: as recorded.
        used: number of leading samples inside the usable window.
        cut_reason: why later samples are left out, or an empty string.
        hit_limit: whether that is because the joint reached its limit.
        drive: drive train of the driven joint.
        coefficients: see ``Coefficients``.
        sigma: standard deviation of each used sample [rad or m], shape (used,).
        rest: start position from the samples before onset.
        limited: whether the supply may limit the current inside the window, as far as the recording tells.
    """

    run: Run
    used: int
    cut_reason: str
    hit_limit: bool
    drive: DriveTrain
    coefficients: Coefficients
    sigma: np.ndarray
    rest: Quantity
    limited: bool

    @property
    def times_s(self) -> np.ndarray:
        return self.run.times_s[: self.used]

    @property
    def position(self) -> np.ndarray:
        return self.run.position[: self.used]

    @property
    def travel(self) -> float:
        """Signed largest excursion from rest inside the used window."""
        excursion = self.position - self.rest.value
        return float(excursion[np.argmax(np.abs(excursion))])


def _reduced(robot: Robot, run: Run, shift: Mapping[str, float]) -> ReducedModel:
    held = {name: position + shift.get(name, 0.0) for name, position in run.held.items()}
    return robot.model.lock([run.joint], held, robot.gravity)


def _coefficients(robot: Robot, run: Run, shift: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
    model = _reduced(robot, run, shift)
    body, body_from_payload = model.frames[robot.payload_frame]
    if body != 0:
        raise RecordingError(
            f"{run.name}: {run.joint} was driven but does not move {robot.payload_frame}: probe a joint between the base and it"
        )
    gravity = model.placement[0][:3, :3].T @ model.gravity
    axis = model.axes[0]
    moved = body_from_payload @ pseudo_inertia_basis() @ body_from_payload.T
    arm = joint_coefficients(model.pseudo_inertia[0], model.kinds[0], axis, gravity)
    return arm, joint_coefficients(moved, model.kinds[0], axis, gravity).T


def prepare_run(robot: Robot, run: Run) -> PreparedRun:
    """Choose the usable window, weigh the samples, and reduce the robot to the driven joint.

    Raises:
        RecordingError: a joint the robot has is missing from the recording, or the driven joint has no drive train.
    """
    if run.joint not in robot.drive_trains:
        known = ", ".join(robot.drive_trains)
        raise RecordingError(
            f"{run.name}: {run.joint} was driven, but {robot.name} has no drive train for it (it has: {known})"
        )
    missing = [j for j in robot.model.independent_joints if j != run.joint and j not in run.held]
    if missing:
        raise RecordingError(
            f"{run.name}: no position of {', '.join(missing)} in the recording; state it with --set held.{missing[0]}=VALUE"
        )
    drive = robot.drive_trains[run.joint]
    joint = robot.model.joint(run.joint)
    velocity = np.gradient(run.position, run.times_s)
    followed = _followed(run, velocity, drive)
    used, reason, hit_limit = _usable_window(run, velocity, followed, drive, joint.lower, joint.upper)
    reading = float(np.hypot(drive.encoder_resolution / np.sqrt(12.0), drive.encoder_noise))
    # random errors of the stamps show in their intervals, sqrt(2) times; stamps like clockwork have none
    jitter = min(robot.stamp_jitter_s, float(np.std(np.diff(run.times_s))) / np.sqrt(2.0))
    sigma = np.hypot(reading, velocity[:used] * jitter)
    if len(run.before_position):
        # at rest the rounding error repeats, so only the noise averages out
        noise = drive.encoder_noise / np.sqrt(len(run.before_position))
        rest = Quantity(
            float(np.mean(run.before_position)), float(np.hypot(drive.encoder_resolution / np.sqrt(12.0), noise))
        )
    else:
        rest = Quantity(float(run.position[0]), 3.0 * reading)
    held = tuple(name for name in robot.model.independent_joints if name != run.joint)
    arm, payload = _coefficients(robot, run, {})
    arm_by_pose, payload_by_pose = np.zeros((len(held), 4)), np.zeros((len(held), 4, 10))
    for row, name in enumerate(held):
        up, down = (_coefficients(robot, run, {name: sign * _POSE_STEP}) for sign in (1.0, -1.0))
        arm_by_pose[row] = (up[0] - down[0]) / (2.0 * _POSE_STEP)
        payload_by_pose[row] = (up[1] - down[1]) / (2.0 * _POSE_STEP)
    matters = np.abs(arm_by_pose).max(axis=1) > 1e-6
    coefficients = Coefficients(
        arm,
        payload,
        tuple(n for n, m in zip(held, matters, strict=True) if m),
        arm_by_pose[matters],
        payload_by_pose[matters],
    )
    return PreparedRun(
        run, used, reason, hit_limit, drive, coefficients, sigma, rest, limited=not followed[1:used].all()
    )


def _followed(run: Run, velocity: np.ndarray, drive: DriveTrain) -> np.ndarray:
    """At which samples the motor reported the current it was told, shape (K,); False where nothing was reported.

    The reported effort is compared with the command in its own unit: what the two have to do with each other is read off the
    slow samples, where the supply limits nothing.
    """
    blind = np.zeros(len(run.times_s), dtype=bool)
    if run.reported_effort is None:
        return blind
    command = run.input_current_A[np.searchsorted(run.input_times_s, run.times_s, side="left").clip(1) - 1]
    slow = (np.abs(velocity) < 0.5 * drive.usable_velocity) & (command != 0.0) & np.isfinite(run.reported_effort)
    slow &= run.times_s > run.times_s[0]  # the first report may be older than the command
    if slow.sum() < MIN_SLOW or np.median(run.reported_effort[slow] / command[slow]) <= 0.0:
        return blind
    unit = float(np.median(run.reported_effort[slow] / command[slow]))
    off = np.abs(run.reported_effort / unit - command)
    noise = 1.4826 * float(np.median(off[slow]))
    return off <= np.maximum(0.05 * np.abs(command), 4.0 * noise)


def _usable_window(
    run: Run, velocity: np.ndarray, followed: np.ndarray, drive: DriveTrain, lower: float, upper: float
) -> tuple[int, str, bool]:
    """Samples before the joint meets its limit, or runs so fast that the supply may no longer drive the current.

    A fast sample still counts while the motor itself reports the commanded current. Returns how many samples are usable, why no
    more, and whether the limit is the reason.
    """
    count = len(run.times_s)
    # how close to the limit a reading is no longer certain to be short of it
    margin = 3.0 * float(np.hypot(drive.zero.std, drive.encoder_resolution))
    before = np.concatenate([[run.position[0]], run.position[:-1]])
    step = np.diff(run.position, prepend=run.position[0])
    # where the sample would be at the speed of the last interval: an impact may hide between two samples
    expected = before + np.concatenate([[0.0], step[:-1]])
    furthest, nearest = np.maximum(run.position, expected), np.minimum(run.position, expected)
    beyond = (furthest > upper - margin) | (nearest < lower + margin)
    # a joint that starts at a limit and leaves it is free to move
    stopped = np.flatnonzero(beyond & (np.abs(run.position - run.position[0]) > margin))
    fast = np.flatnonzero((np.abs(velocity) > drive.usable_velocity) & ~followed)
    limit = int(stopped[0]) if len(stopped) else count
    speed = int(fast[0]) if len(fast) else count
    if limit < count and limit <= speed:
        return limit, f"{run.joint} reached its limit {run.times_s[limit]:.3f} s after the start", True
    if speed < count:
        told = (
            "the supply may no longer drive the commanded current"
            if run.reported_effort is None
            else "the motor did not report the commanded current"
        )
        reason = (
            f"{run.joint} passed {drive.usable_velocity:g} rad/s {run.times_s[speed]:.3f} s after the start and {told}"
        )
        return speed, reason, False
    return count, "", False


def payload_unknowns(
    robot: Robot, runs: Sequence[PreparedRun], facts: PayloadFacts, drive_role: Role, start_mass_kg: float
) -> list[Unknown]:
    """All unknowns of a weighing: the payload, what the robot file leaves open, and each run's start.

    Args:
        drive_role: ``FROZEN`` keeps the robot at its file's values, ``FREE`` lets the recording move them under their priors.
    """
    unknowns = [Unknown("payload_mass", "kg", start_mass_kg, np.inf, -0.5, 20.0, asinh_scale=0.005)]
    for axis, name in enumerate("xyz"):
        spread = float(facts.com_std[axis])
        unknowns.append(
            Unknown(f"payload_com_{name}", "m", float(facts.com[axis]), spread, -1.0, 1.0).at_role(Role.FREE)
        )
    unknowns.append(Unknown("shape_scale", "1", 1.0, facts.shape_std_relative, 0.0, 10.0).at_role(drive_role))
    unknowns.append(_from_quantity("arm_scale", "1", robot.arm_scale, drive_role, lower=0.1))
    unknowns.append(_from_quantity("delay", "s", _delay(robot, runs), drive_role, lower=-0.1, upper=0.1))
    for name in dict.fromkeys(run.run.joint for run in runs):
        drive = robot.drive_trains[name]
        units = ("N m/A", "N m", "N m s/rad", "1", "kg m^2")
        fields = (drive.torque_constant, drive.coulomb, drive.viscous, drive.load_friction, drive.armature)
        for kind, unit, quantity in zip(DRIVE_TERMS, units, fields, strict=True):
            unknowns.append(_from_quantity(f"{kind}[{name}]", unit, quantity, drive_role, lower=0.0))
    for name in dict.fromkeys(name for run in runs for name in (run.run.joint, *run.coefficients.pose)):
        held = robot.drive_trains.get(name)
        if held is not None:
            # a held joint's reading is rounded the same way in every sample
            std = float(np.hypot(held.zero.std, held.encoder_resolution / np.sqrt(12.0)))
            unknowns.append(_from_quantity(f"zero[{name}]", "rad", Quantity(held.zero.value, std), drive_role))
    for row, run in enumerate(runs):
        unknowns.append(Unknown(f"q0[{row}]", "rad", run.rest.value, run.rest.std))
        unknowns.append(Unknown(f"v0[{row}]", "rad/s", 0.0, START_VELOCITY_STD))
    return unknowns


def _delay(robot: Robot, runs: Sequence[PreparedRun]) -> Quantity:
    """The robot's delay; where the input is measured effort, the onset is only known to one sample period."""
    periods = [float(np.median(np.diff(run.run.times_s))) for run in runs if run.run.source == MEASURED_EFFORT]
    return Quantity(robot.delay.value, float(np.hypot(robot.delay.std, max(periods, default=0.0) / 2.0)))


def _from_quantity(
    name: str, unit: str, quantity: Quantity, role: Role, lower: float = -np.inf, upper: float = np.inf
) -> Unknown:
    return Unknown(name, unit, quantity.value, quantity.std, lower, upper).at_role(role)


def _read_only(array: np.ndarray) -> np.ndarray:
    array.setflags(write=False)
    return array


class PayloadProblem:
    """The whitened residuals of all runs as a function of the unknowns, for many guesses at once.

    Args:
        robot: its supply, friction smoothing and jitter.
        runs: prepared runs, sharing the payload and the drive trains.
        facts: what is told about the payload.
        unknowns: from ``payload_unknowns``.
        integrator: ``"rk4"`` or ``"semi_implicit"``.
        step_s: longest integration step; default 1/240 s.
    """

    def __init__(
        self,
        robot: Robot,
        runs: Sequence[PreparedRun],
        facts: PayloadFacts,
        unknowns: Sequence[Unknown],
        integrator: str = "rk4",
        step_s: float = 1.0 / 240.0,
    ) -> None:
        self.robot = robot
        self.runs = tuple(runs)
        self.facts = facts
        self.unknowns = tuple(unknowns)
        self.index = {u.name: row for row, u in enumerate(unknowns)}
        self.free = np.array([row for row, u in enumerate(unknowns) if u.role is Role.FREE])
        self.coordinates = Coordinates([unknowns[row] for row in self.free])
        self.base = np.array([u.value for u in unknowns])
        self.simulator = JointSimulator([self._joint_run(run, step_s) for run in runs], integrator)
        width = int(self.simulator.sample_counts.max())
        self.measured = np.zeros((len(runs), width))
        self.weight = np.zeros((len(runs), width))
        for row, run in enumerate(runs):
            self.measured[row, : run.used] = run.position
            self.weight[row, : run.used] = 1.0 / run.sigma
        self._columns = np.arange(width)
        # which parameters depend on the unknowns non-linearly: then the tangents must follow the guess
        bent = {self.index[n] for n in self.index if n.startswith(("payload_com", "zero[", "shape_scale", "arm_scale"))}
        self._affine = not bent.intersection(self.free.tolist())
        self._affine_maps: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        self._world_runs: dict[int, np.ndarray] = {}

    def _joint_run(self, run: PreparedRun, step_s: float) -> JointRun:
        drive = run.drive
        motor = float(np.abs(run.run.input_current_A).max()) * drive.torque_constant.value
        friction = self._reach(f"coulomb[{run.run.joint}]") + self._reach(f"load_friction[{run.run.joint}]") * motor
        # near standstill Coulomb's law turns over within friction_velocity: the step must resolve v_s J / f_c
        lightest = float(run.coefficients.arm[0]) + 0.5 * drive.armature.value
        fine = 0.5 * self.robot.friction_velocity * lightest / friction if friction > 0.0 else step_s
        return JointRun(
            run.times_s,
            run.run.input_times_s,
            run.run.input_current_A,
            # where the motor reported the commanded current throughout, no nominal supply may overrule it
            (drive.supply_voltage_V if run.limited else 0.0, drive.back_emf_V_s_per_rad, drive.resistance_ohm),
            self.robot.friction_velocity,
            step_s,
            float(np.clip(fine, 5e-5, step_s)),
        )

    def _reach(self, name: str) -> float:
        """How large an unknown may get during the fit: its value, and a standard deviation more where it moves."""
        unknown = self.unknowns[self.index[name]]
        return unknown.value + (unknown.std if unknown.role is Role.FREE else 0.0)

    def parameters(self, values: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Simulator parameters of every guess and run, and their derivative by chosen unknowns.

        Args:
            values: all unknowns of each guess, shape (S, N).
            columns: which unknowns to differentiate by, shape (F,).

        Returns:
            p (S, R, P) and dp (S, R, P, F).
        """
        guesses = len(values)
        p = np.zeros((guesses, len(self.runs), len(PARAMETERS)))
        dp = np.zeros((guesses, len(self.runs), len(PARAMETERS), len(self.unknowns)))
        at = self.index
        mass = values[:, at["payload_mass"]]
        com = values[:, [at["payload_com_x"], at["payload_com_y"], at["payload_com_z"]]]
        scale = values[:, at["shape_scale"]]
        spread = self.facts.shape.second_moment_per_mass
        per_mass = payload_parameters(np.ones(guesses), com, np.zeros((3, 3)))
        per_spread = payload_parameters(np.ones(guesses), np.zeros((guesses, 3)), spread)
        per_spread[:, 0] = 0.0
        per_mass = per_mass + scale[:, None] * per_spread
        payload = mass[:, None] * per_mass
        by_com = payload_parameters_by_com(mass, com)
        arm_scale = values[:, at["arm_scale"]]
        for row, run in enumerate(self.runs):
            c = run.coefficients
            joint = run.run.joint
            arm, lever = np.tile(c.arm, (guesses, 1)), np.tile(c.payload, (guesses, 1, 1))
            for h, name in enumerate(c.pose):
                # the joint stands at its reading plus its zero
                if f"zero[{name}]" in at:
                    zero = values[:, at[f"zero[{name}]"]]
                    arm = arm + zero[:, None] * c.arm_by_pose[h]
                    lever = lever + zero[:, None, None] * c.payload_by_pose[h]
            g = arm_scale[:, None] * arm + np.einsum("sij,sj->si", lever, payload)
            d = np.zeros((guesses, 4, len(self.unknowns)))
            d[:, :, at["payload_mass"]] = np.einsum("sij,sj->si", lever, per_mass)
            d[:, :, at["shape_scale"]] = np.einsum("sij,sj->si", lever, mass[:, None] * per_spread)
            d[:, :, at["arm_scale"]] = arm
            for axis, name in enumerate("xyz"):
                d[:, :, at[f"payload_com_{name}"]] = np.einsum("sij,sj->si", lever, by_com[:, :, axis])
            for h, name in enumerate(c.pose):
                if f"zero[{name}]" in at:
                    change = arm_scale[:, None] * c.arm_by_pose[h] + payload @ c.payload_by_pose[h].T
                    d[:, :, at[f"zero[{name}]"]] = change
            zero_row = at.get(f"zero[{joint}]")
            if zero_row is not None:
                z = values[:, zero_row]
                cos, sin = np.cos(z), np.sin(z)
                ga, gb = g[:, 1].copy(), g[:, 2].copy()
                da, db = d[:, 1].copy(), d[:, 2].copy()
                g[:, 1], g[:, 2] = ga * cos + gb * sin, gb * cos - ga * sin
                d[:, 1] = da * cos[:, None] + db * sin[:, None]
                d[:, 2] = db * cos[:, None] - da * sin[:, None]
                d[:, 1, zero_row] = g[:, 2]
                d[:, 2, zero_row] = -g[:, 1]
            p[:, row, _GRAVITY_ROWS] = g
            dp[:, row, _GRAVITY_ROWS] = d
            p[:, row, INDEX["inertia"]] += values[:, at[f"armature[{joint}]"]]
            dp[:, row, INDEX["inertia"], at[f"armature[{joint}]"]] = 1.0
            direct = {f"{kind}[{joint}]": kind for kind in DRIVE_TERMS if kind != "armature"}
            direct |= {"delay": "delay", f"q0[{row}]": "q0", f"v0[{row}]": "v0"}
            for name, parameter in direct.items():
                p[:, row, INDEX[parameter]] = values[:, at[name]]
                dp[:, row, INDEX[parameter], at[name]] = 1.0
        return p, dp[..., columns]

    def load_per_mass(self, run: PreparedRun) -> float:
        """Gravity load of 1 kg in the hand on the driven joint at the run's start [N m/kg]."""
        per_mass = payload_parameters(np.ones(1), self.facts.com[None], self.facts.shape.second_moment_per_mass)[0]
        _, cos, sin, constant = run.coefficients.payload @ per_mass
        return float(cos * np.cos(run.rest.value) + sin * np.sin(run.rest.value) + constant)

    def torque_stds(self, run: PreparedRun) -> np.ndarray:
        """What the robot file leaves open of the torque that holds the joint: Coulomb, motor, load friction [N m]."""
        drive = run.drive
        current = float(np.abs(run.run.input_current_A).max())
        motor = drive.torque_constant.value * current
        return np.array([drive.coulomb.std, drive.torque_constant.std * current, drive.load_friction.std * motor])

    def all_values(self, free_values: np.ndarray) -> np.ndarray:
        """Every unknown of each guess, shape (S, N), from the free ones, shape (S, F)."""
        values = np.tile(self.base, (len(free_values), 1))
        values[:, self.free] = free_values
        return values

    def _kernel_parameters(self, free_values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Parameters (W, P) of every world, a guess's runs side by side, and their tangents (W, P, F).

        Where the parameters are affine in what is free, the tangents never change: they are handed out as one read-only array,
        which the simulator copies once.
        """
        guesses = len(free_values)
        if not self._affine:
            p, dp = self.parameters(self.all_values(free_values), self.free)
            return p.reshape(-1, p.shape[-1]), dp.reshape(-1, *dp.shape[2:])
        if guesses not in self._affine_maps:
            origin = self.all_values(np.zeros((1, len(self.free))))
            offset, slope = (array[0] for array in self.parameters(origin, self.free))
            self._affine_maps[guesses] = (offset, _read_only(np.tile(slope, (guesses, 1, 1))))
        offset, tangents = self._affine_maps[guesses]
        slope = tangents[: len(self.runs)]
        p = offset + np.tensordot(free_values, slope, axes=(1, 2))
        return p.reshape(-1, p.shape[-1]), tangents

    def _worlds(self, guesses: int) -> np.ndarray:
        if guesses not in self._world_runs:
            self._world_runs[guesses] = _read_only(np.tile(np.arange(len(self.runs), dtype=np.int32), guesses))
        return self._world_runs[guesses]

    def linearise(
        self, internal: np.ndarray, counts: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Cost, gradient and Gauss-Newton matrix in solver coordinates, priors included.

        Args:
            internal: guesses in solver coordinates, shape (S, F).
            counts: leading samples to use per run, shape (R,); default all.

        Returns:
            cost (S,) = half the squared norm of the whitened residuals, gradient (S, F), matrix (S, F, F). A guess whose
            rollout diverged, or whose moving part would have no inertia, has an infinite cost and zero gradient.
        """
        coordinates = self.coordinates
        physical = coordinates.physical(internal)
        slope = coordinates.slope(internal)
        guesses, size = internal.shape
        p, dp = self._kernel_parameters(physical)
        runs = len(self.runs)
        q, _, dq = self.simulator.jacobian(self._worlds(guesses), p, dp, counts)
        weight = self.weight
        if counts is not None:
            weight = weight * (self._columns < counts[:, None])
        seen = weight > 0.0
        residual = np.where(seen, (q.reshape(guesses, runs, -1) - self.measured) * weight, 0.0).reshape(guesses, -1)
        sensitivity = np.where(seen[None, :, :, None], dq.reshape(guesses, runs, -1, size) * weight[..., None], 0.0)
        sensitivity = sensitivity.reshape(guesses, -1, size)
        prior = (physical - coordinates.prior_mean) * coordinates.prior_weight
        cost = 0.5 * (np.einsum("sn,sn->s", residual, residual) + np.einsum("sf,sf->s", prior, prior))
        transposed = sensitivity.transpose(0, 2, 1)
        gradient = (transposed @ residual[..., None])[..., 0] + prior * coordinates.prior_weight
        matrix = transposed @ sensitivity
        diagonal = np.arange(size)
        matrix[:, diagonal, diagonal] += coordinates.prior_weight**2
        gradient = gradient * slope
        matrix = matrix * slope[:, :, None] * slope[:, None, :]
        massless = (p[:, INDEX["inertia"]] <= 0.0).reshape(guesses, runs).any(axis=1)
        bad = massless | ~(np.isfinite(cost) & np.isfinite(matrix).all(axis=(1, 2)))
        if bad.any():
            cost[bad], gradient[bad] = np.inf, 0.0
            matrix[bad] = np.eye(size)
        return cost, gradient, matrix

    def simulate(self, values: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions, velocities and sensitivities by chosen unknowns at given values of all of them.

        Args:
            values: shape (S, N); columns: shape (F,).

        Returns:
            q (S, R, T), v (S, R, T), dq (S, R, T, F), copies.
        """
        p, dp = self.parameters(values, columns)
        q, v, dq = self.simulator.jacobian(
            self._worlds(len(values)), p.reshape(-1, p.shape[-1]), dp.reshape(-1, *dp.shape[2:])
        )
        shape = (len(values), len(self.runs), -1)
        return q.reshape(shape).copy(), v.reshape(shape).copy(), dq.reshape(*shape, len(columns)).copy()
