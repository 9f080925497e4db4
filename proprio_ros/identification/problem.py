"""Runs, robot and what the hand rigidly carries as a least-squares problem: whitened residuals and their exact Jacobian out.

The observation model: the encoder shows ``x(t - delay) + a cos x + b sin x``, the true position less the joint's zero and a
once-per-turn error of the encoder, plus what `prepared_runs` weighs the samples by.

A run carries an unknown rigid load or a known one (nothing, a weighed reference), so one problem serves a weighing, a calibration,
and both together; probes add what else is in the hand. Whatever is unknown reaches the simulator through its eleven parameters
per run: with many unknowns the simulator's tangents are taken by those, and the chain rule does the rest.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

import numpy as np

from proprio_ros.identification.prepared_runs import PreparedRun
from proprio_ros.identification.robot_unknowns import (
    DRIVE_TERMS,
    KEPT_IN_A_SWING,
    NOT_IN_A_SWING,
    OF_A_SWING,
    PAYLOAD_TERMS,
    RIPPLE_TERMS,
    RISE,
    of_one_kind,
    prior_of,
)
from proprio_ros.identification.unknowns import Coordinates, Role, Unknown
from proprio_ros.kinds import KINDS, Key
from proprio_ros.robot import Robot
from proprio_ros.sim.joint import INDEX, JointRun, JointSimulator
from proprio_ros.sim.mixed import MixedSimulator
from proprio_ros.sim.payload import PayloadFacts, payload_parameters, payload_parameters_by_com

_GRAVITY_ROWS = slice(0, 4)


def _read_only(array: np.ndarray) -> np.ndarray:
    array.setflags(write=False)
    return array


class Problem:
    """The whitened residuals of all runs as a function of the unknowns, for many guesses at once.

    The runs share payload and drive trains; of the robot supply and friction smoothing count. The unknowns are those of
    ``load_unknowns``, or of ``robot_unknowns`` where every run's load is known; the step is the longest [s].
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
        self.index: dict[Key, int] = {u.key: row for row, u in enumerate(unknowns)}
        self.free = np.array([row for row, u in enumerate(unknowns) if u.role is Role.FREE])
        calibration = prior_of(robot, runs)
        if calibration is not None and calibration.swing_error > 0.0:
            calibration = calibration.given(
                {(kind, run.run.joint) for run in runs if run.run.free for kind in RISE}
            )
        free = [unknowns[row] for row in self.free]
        belong = (
            of_one_kind(robot, free)
            if calibration is None
            else (calibration.keys, calibration.covariance)
        )
        self.coordinates = Coordinates(free, belong)
        self.base = np.array([u.value for u in unknowns])
        self.simulator = self._simulator(
            [self._joint_run(run, step_s) for run in runs],
            integrator,
        )
        width = int(self.simulator.sample_counts.max())
        self.measured = np.zeros((len(runs), width))
        self.weight = np.zeros((len(runs), width))
        for row, run in enumerate(runs):
            self.measured[row, : run.used] = run.position
            self.weight[row, : run.used] = 1.0 / run.sigma
        # which parameters depend on the unknowns non-linearly: then the tangents must follow the guess
        bent = {*PAYLOAD_TERMS[1:], "zero", "arm_scale", *RIPPLE_TERMS, *OF_A_SWING}
        kinds = {u.kind for u in free}
        self._affine = kinds.isdisjoint(bent) and not kinds.issuperset(
            {"torque_constant", "disturbance"}
        )
        self._ripple = [
            (-1, -1)
            if run.run.free
            else tuple(self.index.get((kind, run.run.joint), -1) for kind in RIPPLE_TERMS)
            for run in self.runs
        ]
        seen = [row for pair in self._ripple for row in pair if row >= 0]
        self._ripples = not kinds.isdisjoint(RIPPLE_TERMS) or bool(self.base[seen].any())
        self._affine_maps: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        self._world_runs: dict[int, np.ndarray] = {}
        self._identities: dict[int, np.ndarray] = {}

    @functools.cached_property
    def _touching(self) -> list[np.ndarray]:
        """Which free unknowns can change anything in each run; of use to a fit only."""
        free = [self.unknowns[row] for row in self.free]
        return [
            np.flatnonzero([self._touches(u, row) for u in free]) for row in range(len(self.runs))
        ]

    def _simulator(
        self, runs: list[JointRun], integrator: str
    ) -> JointSimulator | MixedSimulator[Any]:
        return JointSimulator(runs, integrator)

    def _touches(self, unknown: Unknown, row: int) -> bool:
        """Whether an unknown can change anything in a run: its joints, its links, its own start, and what all share."""
        run = self.runs[row]
        owner = unknown.scope
        if unknown.kind in PAYLOAD_TERMS:
            return run.load is None
        kept = unknown.kind in KEPT_IN_A_SWING and owner == run.run.joint
        if run.run.free and (kept or unknown.kind in NOT_IN_A_SWING):
            return False
        match KINDS[unknown.kind].of:
            case "run":
                return owner == row
            case "joint":
                return owner == run.run.joint or owner in run.coefficients.pose
            case "link":
                return unknown.key in run.coefficients.links
        return True

    def _joint_run(self, run: PreparedRun, step_s: float) -> JointRun:
        drive = run.drive
        motor = float(np.abs(run.run.input_current_A).max()) * drive.torque_constant.value
        friction = (
            self._reach(("coulomb", run.run.joint))
            + self._reach(("load_friction", run.run.joint)) * motor
        )
        friction *= 1.0 + self.unknowns[self.index["stribeck", run.run.joint]].value
        # near standstill Coulomb's law turns over within friction_velocity: the step must resolve v_s J / f_c
        lightest = float(run.coefficients.arm[0]) + 0.5 * drive.armature.value
        fine = self.robot.friction_velocity * lightest / friction if friction > 0.0 else step_s
        input_times_s, input_current_A, input_load = self._inputs(run)
        return JointRun(
            run.times_s,
            input_times_s,
            input_current_A,
            # where the motor reported the commanded current throughout, no nominal supply may overrule it
            (
                drive.supply_voltage_V if run.limited else 0.0,
                drive.back_emf_V_s_per_rad,
                drive.resistance_ohm,
            ),
            self.robot.friction_velocity,
            step_s,
            float(np.clip(fine, 5e-5, step_s)),
            input_load,
        )

    def _inputs(
        self,
        run: PreparedRun,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """Current, and the load of yielding joints: stamped when they were read, so it is earlier by the delay."""
        times_s = run.run.input_times_s
        current_A = run.run.input_current_A
        if run.yielding_times_s is None or run.yielding_load is None:
            return times_s, current_A, None
        begins = run.yielding_times_s - self.robot.delay.value
        begins[0] = min(begins[0], 0.0)
        union = np.union1d(times_s, begins[begins > 0.0])
        current = current_A[np.searchsorted(times_s, union, side="right") - 1]
        return union, current, run.yielding_load[np.searchsorted(begins, union, side="right") - 1]

    def _reach(self, key: Key) -> float:
        """How large an unknown may get during the fit: its value, and two standard deviations more where it moves."""
        unknown = self.unknowns[self.index[key]]
        return unknown.value + (2.0 * unknown.std if unknown.role is Role.FREE else 0.0)

    def parameters(
        self,
        values: np.ndarray,
        columns: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Simulator parameters of every guess and run, shape (S, R, P), and their derivative, shape (S, R, P, F).

        ``values``: all unknowns of each guess, shape (S, N); ``columns``: which unknowns to differentiate by, shape (F,).
        """
        p, dp = self._all_parameters(values)
        return p, dp[..., columns]

    def _all_parameters(
        self,
        values: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """As ``parameters``, by every unknown."""
        guesses = len(values)
        width = len(self.simulator.parameters)
        p = np.zeros((guesses, len(self.runs), width))
        dp = np.zeros((guesses, len(self.runs), width, len(self.unknowns)))
        at = self.index
        payload = self._payload(values) if "payload_mass" in at else None
        for row, run in enumerate(self.runs):
            joint = run.run.joint
            p[:, row, _GRAVITY_ROWS], dp[:, row, _GRAVITY_ROWS] = self._moving_part(
                row, values, payload
            )
            direct: dict[Key, str] = {(kind, joint): kind for kind in DRIVE_TERMS}
            direct |= {("armature", joint): "inertia", "delay": "delay", ("onset", row): "delay"}
            direct |= {("q0", row): "q0", ("v0", row): "v0"}
            if run.run.free:
                for kind in RISE:
                    p[:, row, INDEX[kind]] = self.base[at[kind, joint]]
                left_out = (*NOT_IN_A_SWING, *KEPT_IN_A_SWING)
                direct = {key: to for key, to in direct.items() if to not in left_out}
            for key, to in direct.items():
                p[:, row, INDEX[to]] += values[:, at[key]]
                dp[:, row, INDEX[to], at[key]] = 1.0
            self._disturb(row, p, dp, values)
            if run.run.free:
                self._change_friction(row, p, dp, values)
            elif run.load is None:
                p[:, row, INDEX["carried"]] = values[:, at["payload_mass"]]
                dp[:, row, INDEX["carried"], at["payload_mass"]] = 1.0
            else:
                p[:, row, INDEX["carried"]] = run.load.mass
            self._start_reading(row, p, dp, values)
        return p, dp

    def _moving_part(
        self,
        row: int,
        values: np.ndarray,
        payload: tuple[np.ndarray, dict[int, np.ndarray]] | None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Inertia and gravity load of arm and payload, shape (S, 4), and their derivative by every unknown, shape (S, 4, N)."""
        run = self.runs[row]
        c = run.coefficients
        at = self.index
        guesses = len(values)
        arm_scale = values[:, at["arm_scale"]]
        arm = np.tile(c.arm, (guesses, 1))
        lever = np.tile(c.payload, (guesses, 1, 1))
        shifts = [self._shift(name, run.run.held[name], values) for name in c.pose]
        for h, (shift, _) in enumerate(shifts):
            # the joint stands at its reading plus its zero, less the encoder's error
            arm = arm + shift[:, None] * c.arm_by_pose[h]
            lever = lever + shift[:, None, None] * c.payload_by_pose[h]
        g = arm_scale[:, None] * arm
        d = np.zeros((guesses, 4, len(self.unknowns)))
        d[:, :, at["arm_scale"]] = arm
        links = [at[key] for key in c.links]
        g += values[:, links] @ c.arm_by_link
        d[:, :, links] += c.arm_by_link.T
        if run.load is None:
            assert payload is not None
            carried, by_unknown = payload
            for column, change in by_unknown.items():
                d[:, :, column] = np.einsum("sij,sj->si", lever, change)
        else:
            carried = np.tile(run.load.inertial_parameters, (guesses, 1))
        g += np.einsum("sij,sj->si", lever, carried)
        for h, (_, by_zero) in enumerate(shifts):
            change = arm_scale[:, None] * c.arm_by_pose[h] + carried @ c.payload_by_pose[h].T
            for column, factor in by_zero:
                d[:, :, column] += factor * change
        zero = at.get(("zero", run.run.joint))
        if zero is not None:
            own = zero
            z = values[:, zero]
            if run.run.free:
                own = at["swing_zero", row]
                z = self.base[zero] + values[:, own]
            cos = np.cos(z)
            sin = np.sin(z)
            ga = g[:, 1].copy()
            gb = g[:, 2].copy()
            da = d[:, 1].copy()
            db = d[:, 2].copy()
            g[:, 1], g[:, 2] = ga * cos + gb * sin, gb * cos - ga * sin
            d[:, 1] = da * cos[:, None] + db * sin[:, None]
            d[:, 2] = db * cos[:, None] - da * sin[:, None]
            d[:, 1, own] += g[:, 2]
            d[:, 2, own] -= g[:, 1]
        if run.run.free:
            repeats = at["moment_change", row]
            times = 1.0 + values[:, repeats]
            d[:, 1:] *= times[:, None, None]
            d[:, 1:, repeats] = g[:, 1:]
            g[:, 1:] *= times[:, None]
        return g, d

    def _disturb(
        self,
        row: int,
        p: np.ndarray,
        dp: np.ndarray,
        values: np.ndarray,
    ) -> None:
        """The torque that only this run has is stated at the torque constant that was known before, and goes with what it is.

        Motion tells torques only relative to each other. If this one were a number of its own, every run would pull all of them
        together (torque constants, the arm's weight) to lower values, where its own is more probable: half of the gradient of the
        logarithm of its variance, which the most probable values of all unknowns leave out, is missing then (MacKay 1999, Neural
        Computation 11, 1035). Sixty empty-hand runs so made everything 2 % lighter.
        """
        run = self.runs[row]
        at = self.index
        constant = at["torque_constant", run.run.joint]
        disturbance = at["disturbance", row]
        stated = run.drive.torque_constant.value
        factor = values[:, constant] / stated
        to = INDEX["gravity_constant"]
        p[:, row, to] -= factor * values[:, disturbance]
        dp[:, row, to, disturbance] = -factor
        dp[:, row, to, constant] -= values[:, disturbance] / stated

    def _change_friction(
        self,
        row: int,
        p: np.ndarray,
        dp: np.ndarray,
        values: np.ndarray,
    ) -> None:
        """Warm gears, fresh grease: all friction of a swing is the joint's times the same factor.

        The gears carry no motor's torque but the weight, and lose the same part of it; ``carried`` is what they lose per moment
        of a kilogram.
        """
        at = self.index
        joint = self.runs[row].run.joint
        change = at["friction_change", row]
        factor = 1.0 + values[:, change]
        for kind in ("coulomb", "viscous"):
            p[:, row, INDEX[kind]] *= factor
            dp[:, row, INDEX[kind], at[kind, joint]] = factor
            dp[:, row, INDEX[kind], change] = values[:, at[kind, joint]]
        run = self.runs[row]
        load_friction = at["load_friction", joint]
        mass = run.arm_as_payload + (
            values[:, at["payload_mass"]] if run.load is None else run.load.mass
        )
        lost = values[:, load_friction]
        carried = INDEX["carried"]
        p[:, row, carried] = factor * lost * mass
        dp[:, row, carried, load_friction] = factor * mass
        dp[:, row, carried, change] = lost * mass
        if run.load is None:
            dp[:, row, carried, at["payload_mass"]] = factor * lost

    def _payload(
        self,
        values: np.ndarray,
    ) -> tuple[np.ndarray, dict[int, np.ndarray]]:
        """Inertial parameters of the payload, shape (S, 10), and their derivative by each of its unknowns."""
        at = self.index
        guesses = len(values)
        mass = values[:, at["payload_mass"]]
        com = values[:, [at[f"payload_com_{axis}"] for axis in "xyz"]]
        scale = values[:, at["shape_scale"]]
        spread = self.facts.shape.second_moment_per_mass
        per_spread = payload_parameters(
            np.ones(guesses),
            np.zeros((guesses, 3)),
            spread,
        )
        per_spread[:, 0] = 0.0
        per_mass = (
            payload_parameters(np.ones(guesses), com, np.zeros((3, 3)))
            + scale[:, None] * per_spread
        )
        by_com = payload_parameters_by_com(mass, com)
        changes = {
            at["payload_mass"]: per_mass,
            at["shape_scale"]: mass[:, None] * per_spread,
        }
        changes |= {
            at[f"payload_com_{name}"]: by_com[:, :, axis] for axis, name in enumerate("xyz")
        }
        return mass[:, None] * per_mass, changes

    def _shift(
        self, name: str, reading: float, values: np.ndarray
    ) -> tuple[np.ndarray, list[tuple[int, float]]]:
        """True position less reading of a locked joint, shape (S,), and what it changes with."""
        terms = [
            ("zero", 1.0),
            ("ripple_cos", -np.cos(reading)),
            ("ripple_sin", -np.sin(reading)),
        ]
        present = [
            (self.index[kind, name], float(factor))
            for kind, factor in terms
            if (kind, name) in self.index
        ]
        return sum(
            (values[:, row] * factor for row, factor in present), np.zeros(len(values))
        ), present

    def _start_reading(
        self,
        row: int,
        p: np.ndarray,
        dp: np.ndarray,
        values: np.ndarray,
    ) -> None:
        """``q0`` is what the encoder shows at the start; the simulator wants it without the encoder's error."""
        cos_row, sin_row = self._ripple[row]
        if not self._ripples or cos_row < 0:
            return
        a = values[:, cos_row]
        b = values[:, sin_row]
        start = INDEX["q0"]
        q = p[:, row, start].copy()
        cos = np.cos(q)
        sin = np.sin(q)
        p[:, row, start] = q - a * cos - b * sin
        dp[:, row, start, self.index["q0", row]] = 1.0 + a * sin - b * cos
        dp[:, row, start, cos_row] = -cos
        dp[:, row, start, sin_row] = -sin

    def _observe(
        self,
        row: int,
        values: np.ndarray,
        q: np.ndarray,
        dq: np.ndarray,
        columns: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """What the encoder of one run shows of positions (S, T), and its derivative (S, T, F); may change its arguments."""
        cos_row, sin_row = self._ripple[row]
        if cos_row < 0:
            return q, dq
        a = values[:, cos_row, None]
        b = values[:, sin_row, None]
        cos = np.cos(q)
        sin = np.sin(q)
        dq = dq * (1.0 - a * sin + b * cos)[..., None]
        for unknown, wave in ((cos_row, cos), (sin_row, sin)):
            dq[..., columns == unknown] += wave[..., None]
        q += a * cos + b * sin
        return q, dq

    def all_values(self, free_values: np.ndarray) -> np.ndarray:
        """Every unknown of each guess, shape (S, N), from the free ones, shape (S, F)."""
        values = np.tile(self.base, (len(free_values), 1))
        values[:, self.free] = free_values
        return values

    def _kernel_parameters(
        self,
        free_values: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Parameters (W, P) of every world, a guess's runs side by side, and their tangents (W, P, F).

        Where the parameters are affine in what is free, the tangents are one read-only array, which the simulator copies once.
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
            self._world_runs[guesses] = _read_only(
                np.tile(np.arange(len(self.runs), dtype=np.int32), guesses)
            )
        return self._world_runs[guesses]

    def _identity(self, worlds: int) -> np.ndarray:
        """Tangent directions along the simulator's own parameters, shape (W, P, P)."""
        if worlds not in self._identities:
            self._identities[worlds] = _read_only(
                np.tile(np.eye(len(self.simulator.parameters)), (worlds, 1, 1))
            )
        return self._identities[worlds]

    def _rollout(
        self,
        p: np.ndarray,
        dp: np.ndarray,
        counts: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, bool]:
        """Simulate worlds with parameters p (W, P), and their tangents dp (W, P, F); ``counts`` of samples as in ``linearise``.

        Returns:
            q and v (S, R, T); q's derivative, shape (S, R, T, F) by the unknowns where these are few, (S, R, T, P) by the
            simulator's own parameters where they are many; which of the two.
        """
        direct = dp.shape[-1] <= len(self.simulator.parameters)
        runs = len(self.runs)
        guesses = len(p) // runs
        tangents = dp if direct else self._identity(len(p))
        q, v, dq = self.simulator.jacobian(
            self._worlds(guesses),
            p,
            tangents,
            counts,
        )
        return (
            *(a.reshape(guesses, runs, -1) for a in (q, v)),
            dq.reshape(guesses, runs, -1, dq.shape[-1]),
            direct,
        )

    def linearise(
        self, internal: np.ndarray, counts: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Cost, gradient and Gauss-Newton matrix in solver coordinates, priors included.

        Args:
            internal: Guesses in solver coordinates, shape (S, F).
            counts: Leading samples to use per run, shape (R,); default all.

        Returns:
            Half the squared norm of the whitened residuals, shape (S,), gradient (S, F), matrix (S, F, F). A guess whose rollout
            diverged, or whose moving part would have no inertia, has an infinite cost and zero gradient.
        """
        coordinates = self.coordinates
        physical = coordinates.physical(internal)
        slope = coordinates.slope(internal)
        guesses, size = internal.shape
        p, dp = self._kernel_parameters(physical)
        runs = len(self.runs)
        counts = self.simulator.sample_counts if counts is None else counts
        values = self.all_values(physical) if self._ripples else physical
        off = physical - coordinates.prior_mean
        pull = off @ coordinates.prior_precision
        cost = 0.5 * np.einsum("sf,sf->s", off, pull)
        gradient = pull.copy()
        matrix = np.tile(coordinates.prior_precision, (guesses, 1, 1))
        with np.errstate(over="ignore", invalid="ignore"):
            q, _, dq, direct = self._rollout(p, dp, counts)
            dp = dp.reshape(guesses, runs, *dp.shape[1:])
            # run by run: a run is touched by few of many unknowns
            for row in range(runs):
                columns = self._touching[row]
                count = int(counts[row])
                shown = q[:, row, :count]
                slopes = dq[:, row, :count]
                slopes = slopes[:, :, columns] if direct else slopes @ dp[:, row][:, :, columns]
                if self._ripples:
                    shown, slopes = self._observe(
                        row, values, shown.copy(), slopes, self.free[columns]
                    )
                weight = self.weight[row, :count]
                residual = (shown - self.measured[row, :count]) * weight
                slopes = slopes * weight[:, None]
                across = slopes.transpose(0, 2, 1)
                cost += 0.5 * np.einsum("st,st->s", residual, residual)
                gradient[:, columns] += (across @ residual[..., None])[..., 0]
                matrix[:, columns[:, None], columns] += across @ slopes
            gradient = gradient * slope
            matrix = matrix * slope[:, :, None] * slope[:, None, :]
        massless = (p[:, INDEX["inertia"]] <= 0.0).reshape(guesses, runs).any(axis=1)
        bad = massless | ~(np.isfinite(cost) & np.isfinite(matrix).all(axis=(1, 2)))
        if bad.any():
            cost[bad], gradient[bad] = np.inf, 0.0
            matrix[bad] = np.eye(size)
        return cost, gradient, matrix

    @property
    def samples(self) -> int:
        """How many numbers were measured."""
        return int(np.count_nonzero(self.weight))

    def other_information(self, values: np.ndarray) -> np.ndarray:
        """Information of other signals than the encoder's on the free unknowns at given values, shape (F, F): none here."""
        return np.zeros((len(self.free), len(self.free)))

    def simulate(
        self, values: np.ndarray, columns: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What the encoder shows and velocities, shapes (S, R, T), and sensitivities, shape (S, R, T, F); all copies.

        ``values`` and ``columns`` are those of ``parameters``.
        """
        p, dp = self.parameters(values, columns)
        p = p.reshape(-1, p.shape[-1])
        dp = dp.reshape(-1, *dp.shape[2:])
        with np.errstate(over="ignore", invalid="ignore"):
            q, v, dq, direct = self._rollout(p, dp)
            q = q.copy()
            v = v.copy()
            dq = dq.copy() if direct else dq @ dp.reshape(*q.shape[:2], *dp.shape[1:])
        if self._ripples:
            for row in range(len(self.runs)):
                q[:, row], dq[:, row] = self._observe(
                    row,
                    values,
                    q[:, row],
                    dq[:, row],
                    columns,
                )
        return q, v, dq
