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
from dataclasses import dataclass
from typing import Any

import numpy as np

from proprio_ros.identification.moving_part import (
    InertialTerms,
    MovingPart,
    PoseShift,
    moving_part,
)
from proprio_ros.identification.prepared_runs import PreparedRun
from proprio_ros.identification.robot_unknowns import (
    DRIVE_TERMS,
    PAYLOAD_TERMS,
    of_one_kind,
    prior_of,
)
from proprio_ros.identification.run_kinds import RIPPLE_TERMS
from proprio_ros.identification.unknowns import (
    Coordinates,
    Role,
    Unknown,
)
from proprio_ros.kinds import KINDS, Key
from proprio_ros.robot import Robot
from proprio_ros.sim.joint import INDEX, JointRun, JointSimulator
from proprio_ros.sim.mixed import MixedSimulator
from proprio_ros.sim.payload import (
    PayloadFacts,
    payload_parameters,
    payload_parameters_by_com,
)

_GRAVITY_ROWS = slice(0, 4)
_BEND_THE_PARAMETERS = {
    *PAYLOAD_TERMS[1:],
    "zero",
    "arm_scale",
    *RIPPLE_TERMS,
    "friction_change",
    "moment_change",
    "swing_zero",
}
"""Unknowns on which the simulator's parameters depend non-linearly."""


def _read_only(array: np.ndarray) -> np.ndarray:
    array.setflags(write=False)
    return array


@dataclass(eq=False)
class _NormalEquations:
    """Half a squared norm of whitened residuals and its derivatives, summed up part by part, for S guesses of F unknowns."""

    cost: np.ndarray  # (S,)
    gradient: np.ndarray  # (S, F)
    matrix: np.ndarray  # Gauss-Newton's, (S, F, F)

    @classmethod
    def of_priors(cls, coordinates: Coordinates, physical: np.ndarray) -> _NormalEquations:
        """The priors' part at guesses in physical units, shape (S, F)."""
        off = physical - coordinates.prior_mean
        pull = off @ coordinates.prior_precision
        cost = 0.5 * np.einsum("sf,sf->s", off, pull)
        return cls(
            cost,
            pull.copy(),
            np.tile(coordinates.prior_precision, (len(physical), 1, 1)),
        )

    def add(
        self,
        columns: np.ndarray,
        residual: np.ndarray,
        slopes: np.ndarray,
    ) -> None:
        """Residuals that depend on some of the unknowns.

        Args:
            columns: The unknowns that they depend on, shape (C,).
            residual: Whitened, shape (S, T).
            slopes: Their derivatives, shape (S, T, C).
        """
        across = slopes.transpose(0, 2, 1)
        self.cost += 0.5 * np.einsum("st,st->s", residual, residual)
        self.gradient[:, columns] += (across @ residual[..., None])[..., 0]
        self.matrix[:, columns[:, None], columns] += across @ slopes


class Problem:
    """The whitened residuals of all runs as a function of the unknowns, for many guesses at once.

    A subclass puts something else into the hand. It may override what stands under "Hooks" below and the public ``linearise``,
    ``samples`` and ``other_information``, and nothing else; the hooks are called from here on, so it sets its own fields before it
    calls ``super().__init__``.

    Args:
        robot: Supply and friction smoothing are its.
        runs: They share payload and drive trains.
        facts: What is stated about the payload.
        unknowns: Those of ``load_unknowns``, or of ``robot_unknowns`` where every run's load is known.
        integrator: ``"rk4"`` or ``"euler"``.
        step_s: The longest step [s].
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
        self.integrator = integrator
        self.unknowns = tuple(unknowns)
        self.index: dict[Key, int] = {u.key: row for row, u in enumerate(unknowns)}
        rows = [row for row, u in enumerate(unknowns) if u.role is Role.ESTIMATED]
        self.estimated = np.array(rows)
        """Rows of the unknowns that the solver moves, shape (F,)."""
        moved = self.estimated_unknowns()
        self.coordinates = Coordinates(moved, _known_together(robot, runs, moved))
        self.base = np.array([u.value for u in unknowns])
        self.simulator = self.simulator_of(
            [self._joint_run(run, step_s) for run in runs],
            integrator,
        )
        self.measured, self.weight = self._observations()
        self._ripple = [self._ripple_rows(run) for run in self.runs]
        seen = [row for pair in self._ripple for row in pair if row >= 0]
        open_ripple = any(u.kind in RIPPLE_TERMS for u in moved)
        self.ripples = open_ripple or bool(self.base[seen].any())
        """Whether any encoder has a once-per-turn error."""
        self._affine = self.is_affine()
        self._affine_maps: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        self._world_runs: dict[int, np.ndarray] = {}
        self._identities: dict[int, np.ndarray] = {}

    # ---------------------------------------------------------------------------------------------------------------- Hooks

    def simulator_of(
        self, runs: list[JointRun], integrator: str
    ) -> JointSimulator | MixedSimulator[Any]:
        """What simulates the runs; its parameters begin with those of ``JointSimulator``."""
        return JointSimulator(runs, integrator)

    def is_affine(self) -> bool:
        """Whether the simulator's parameters are affine in the estimated unknowns: then their tangents need no guess."""
        kinds = {u.kind for u in self.estimated_unknowns()}
        return kinds.isdisjoint(_BEND_THE_PARAMETERS) and not kinds.issuperset(
            {"torque_constant", "disturbance"}
        )

    def touches(self, unknown: Unknown, row: int) -> bool:
        """Whether an unknown can change anything in a run: its joints, its links, its own start, and what all share."""
        run = self.runs[row]
        owner = unknown.scope
        if unknown.kind in PAYLOAD_TERMS:
            return run.load is None
        kept = unknown.kind in run.kind.kept and owner == run.run.joint
        if kept or unknown.kind in run.kind.unneeded:
            return False
        match KINDS[unknown.kind].of:
            case "run":
                return owner == row
            case "joint":
                return owner == run.run.joint or owner in run.coefficients.pose
            case "link":
                return unknown.key in run.coefficients.links
        return True

    def payload(self, values: np.ndarray) -> InertialTerms:
        """The unknown payload at guesses (S, N), as a rigid body in the payload's frame."""
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
        for axis, name in enumerate("xyz"):
            changes[at[f"payload_com_{name}"]] = by_com[:, :, axis]
        return InertialTerms(mass[:, None] * per_mass, changes)

    def payload_in(self, row: int, payload: InertialTerms) -> InertialTerms:
        """What the hand rigidly holds in a run whose load is not known, given the ``payload`` that all such runs share."""
        return payload

    def all_parameters(
        self,
        values: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """As ``parameters``, by every unknown; a subclass fills in what its simulator has beyond a joint's parameters."""
        guesses = len(values)
        width = len(self.simulator.parameters)
        p = np.zeros((guesses, len(self.runs), width))
        dp = np.zeros((guesses, len(self.runs), width, len(self.unknowns)))
        payload = self.payload(values) if "payload_mass" in self.index else None
        for row in range(len(self.runs)):
            self._fill(
                row,
                values,
                payload,
                p[:, row],
                dp[:, row],
            )
        return p, dp

    # ------------------------------------------------------------------------------------------------- What the runs are made of

    def estimated_unknowns(self) -> list[Unknown]:
        """What the solver moves, in its order."""
        return [self.unknowns[row] for row in self.estimated]

    def column_of(self, key: Key) -> int:
        """The column of an estimated unknown in gradients and covariances; ValueError: it is fixed."""
        return self.estimated.tolist().index(self.index[key])

    def _observations(self) -> tuple[np.ndarray, np.ndarray]:
        """Measured positions and one over their standard deviations, shape (R, T) each, 0 behind a run's end."""
        width = int(self.simulator.sample_counts.max())
        measured = np.zeros((len(self.runs), width))
        weight = np.zeros((len(self.runs), width))
        for row, run in enumerate(self.runs):
            measured[row, : run.used] = run.position
            weight[row, : run.used] = 1.0 / run.sigma
        return measured, weight

    def _ripple_rows(self, run: PreparedRun) -> tuple[int, int]:
        """Columns of the unknowns of the encoder's once-per-turn error, -1 where there are none."""
        if "ripple_cos" in run.kind.kept:
            return -1, -1
        of_cos = self.index.get(("ripple_cos", run.run.joint), -1)
        of_sin = self.index.get(("ripple_sin", run.run.joint), -1)
        return of_cos, of_sin

    def known_ripple(self) -> np.ndarray:
        """What is known of each encoder's once-per-turn error: the factors of cosine and sine [rad], shape (R, 2)."""
        return np.array(
            [[self.base[row] if row >= 0 else 0.0 for row in pair] for pair in self._ripple]
        )

    @functools.cached_property
    def _touching(self) -> list[np.ndarray]:
        """Which estimated unknowns can change anything in each run; of use to a fit only."""
        moved = self.estimated_unknowns()
        return [
            np.flatnonzero([self.touches(u, row) for u in moved]) for row in range(len(self.runs))
        ]

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
        if not len(run.loads.times_s):
            return times_s, current_A, None
        begins = run.loads.times_s - self.robot.delay.value
        begins[0] = min(begins[0], 0.0)
        union = np.union1d(times_s, begins[begins > 0.0])
        current = current_A[np.searchsorted(times_s, union, side="right") - 1]
        return (
            union,
            current,
            run.loads.load[np.searchsorted(begins, union, side="right") - 1],
        )

    def _reach(self, key: Key) -> float:
        """How large an unknown may get during the fit: its value, and two standard deviations more where it moves."""
        unknown = self.unknowns[self.index[key]]
        return unknown.value + (2.0 * unknown.std if unknown.role is Role.ESTIMATED else 0.0)

    def parameters(
        self,
        values: np.ndarray,
        columns: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Simulator parameters of every guess and run, shape (S, R, P), and their derivative, shape (S, R, P, F).

        ``values``: all unknowns of each guess, shape (S, N); ``columns``: which unknowns to differentiate by, shape (F,).
        """
        p, dp = self.all_parameters(values)
        return p, dp[..., columns]

    def _fill(
        self,
        row: int,
        values: np.ndarray,
        payload: InertialTerms | None,
        p: np.ndarray,
        dp: np.ndarray,
    ) -> None:
        """A joint's parameters in one run, written into p (S, P) and dp (S, P, N), which are zero; see ``all_parameters``."""
        run = self.runs[row]
        part = self._moving_part(row, values, payload)
        p[:, _GRAVITY_ROWS] = part.load
        dp[:, _GRAVITY_ROWS] = part.by_unknown
        for kind in run.kind.kept_rise:
            column = self.index[kind, run.run.joint]
            p[:, INDEX[kind]] = self.base[column]
        for column, parameter in self._direct[row].items():
            p[:, parameter] += values[:, column]
            dp[:, parameter, column] = 1.0
        self._disturb(row, p, dp, values)
        if ("friction_change", row) in self.index:
            self._change_friction(row, p, dp, values)
        elif run.load is None:
            mass = self.index["payload_mass"]
            p[:, INDEX["carried"]] = values[:, mass]
            dp[:, INDEX["carried"], mass] = 1.0
        else:
            p[:, INDEX["carried"]] = run.load.mass
        self._start_reading(row, p, dp, values)

    @functools.cached_property
    def _direct(self) -> list[dict[int, int]]:
        """Of each run the unknowns that are parameters of its simulation as they are, or are added to one: rows of the two."""
        found = []
        for row, run in enumerate(self.runs):
            joint = run.run.joint
            direct: dict[Key, str] = {(kind, joint): kind for kind in DRIVE_TERMS}
            direct["armature", joint] = "inertia"
            direct["delay"] = "delay"
            direct["onset", row] = "delay"
            direct["q0", row] = "q0"
            direct["v0", row] = "v0"
            left_out = (*run.kind.unneeded, *run.kind.kept)
            rows = {self.index[key]: INDEX[to] for key, to in direct.items() if to not in left_out}
            found.append(rows)
        return found

    def _moving_part(
        self,
        row: int,
        values: np.ndarray,
        payload: InertialTerms | None,
    ) -> MovingPart:
        """Inertia and gravity load of arm and payload in one run, as its encoder's reading sees them."""
        run = self.runs[row]
        at = self.index
        coefficients = run.coefficients
        if run.load is None:
            assert payload is not None
            load = self.payload_in(row, payload)
        else:
            load = InertialTerms(
                np.tile(run.load.inertial_parameters, (len(values), 1)),
                {},
            )
        part = moving_part(
            coefficients,
            load,
            [self.shift(name, run.run.held[name], values) for name in coefficients.pose],
            values,
            at["arm_scale"],
            [at[key] for key in coefficients.links],
        )
        zero = at.get(("zero", run.run.joint))
        own = at.get(("swing_zero", row))
        if zero is not None and own is not None:
            part.turn(self.base[zero] + values[:, own], own)
        elif zero is not None:
            part.turn(values[:, zero], zero)
        change = at.get(("moment_change", row))
        if change is not None:
            part.scale_gravity(1.0 + values[:, change], change)
        return part

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
        p[:, to] -= factor * values[:, disturbance]
        dp[:, to, disturbance] = -factor
        dp[:, to, constant] -= values[:, disturbance] / stated

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
            p[:, INDEX[kind]] *= factor
            dp[:, INDEX[kind], at[kind, joint]] = factor
            dp[:, INDEX[kind], change] = values[:, at[kind, joint]]
        run = self.runs[row]
        load_friction = at["load_friction", joint]
        mass = run.loads.arm_as_payload + (
            values[:, at["payload_mass"]] if run.load is None else run.load.mass
        )
        lost = values[:, load_friction]
        carried = INDEX["carried"]
        p[:, carried] = factor * lost * mass
        dp[:, carried, load_friction] = factor * mass
        dp[:, carried, change] = lost * mass
        if run.load is None:
            dp[:, carried, at["payload_mass"]] = factor * lost

    def shift(self, name: str, reading: float, values: np.ndarray) -> PoseShift:
        """True position less reading of a locked joint.

        Args:
            name: The joint.
            reading: Where its encoder has it [rad].
            values: All unknowns of each guess, shape (S, N).

        Returns: the difference [rad], and what it changes with.
        """
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
        total = np.zeros(len(values))
        for column, factor in present:
            total = total + values[:, column] * factor
        return PoseShift(total, present)

    def _start_reading(
        self,
        row: int,
        p: np.ndarray,
        dp: np.ndarray,
        values: np.ndarray,
    ) -> None:
        """``q0`` is what the encoder shows at the start; the simulator wants it without the encoder's error."""
        cos_row, sin_row = self._ripple[row]
        if not self.ripples or cos_row < 0:
            return
        a = values[:, cos_row]
        b = values[:, sin_row]
        start = INDEX["q0"]
        q = p[:, start].copy()
        cos = np.cos(q)
        sin = np.sin(q)
        p[:, start] = q - a * cos - b * sin
        dp[:, start, self.index["q0", row]] = 1.0 + a * sin - b * cos
        dp[:, start, cos_row] = -cos
        dp[:, start, sin_row] = -sin

    def observe(
        self,
        row: int,
        values: np.ndarray,
        q: np.ndarray,
        dq: np.ndarray,
        columns: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """What the encoder of one run shows, and its derivatives.

        Args:
            row: Of the run.
            values: All unknowns of each guess, shape (S, N).
            q: Simulated positions [rad], shape (S, T); may be changed.
            dq: Their derivatives, shape (S, T, F); may be changed.
            columns: The unknowns of the derivatives, shape (F,).
        """
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

    def all_values(self, estimated_values: np.ndarray) -> np.ndarray:
        """Every unknown of each guess, shape (S, N), from the estimated ones, shape (S, F)."""
        values = np.tile(self.base, (len(estimated_values), 1))
        values[:, self.estimated] = estimated_values
        return values

    def kernel_parameters(
        self,
        estimated_values: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Parameters (W, P) of every world, a guess's runs side by side, and their tangents (W, P, F).

        Where the parameters are affine in what is estimated, the tangents are one read-only array, which the simulator copies once.
        """
        guesses = len(estimated_values)
        if not self._affine:
            p, dp = self.parameters(self.all_values(estimated_values), self.estimated)
            p = p.reshape(-1, p.shape[-1])
            return p, dp.reshape(-1, *dp.shape[2:])
        if guesses not in self._affine_maps:
            offset, slope = self.affine_map()
            self._affine_maps[guesses] = (
                offset,
                _read_only(np.tile(slope, (guesses, 1, 1))),
            )
        offset, tangents = self._affine_maps[guesses]
        slope = tangents[: len(self.runs)]
        p = offset + np.tensordot(estimated_values, slope, axes=(1, 2))
        return p.reshape(-1, p.shape[-1]), tangents

    def affine_map(self) -> tuple[np.ndarray, np.ndarray]:
        """Parameters (R, P) where all estimated unknowns are 0, and what each adds (R, P, F): all there is if they are affine."""
        origin = self.all_values(np.zeros((1, len(self.estimated))))
        p, dp = self.parameters(origin, self.estimated)
        return p[0], dp[0]

    def worlds(self, guesses: int) -> np.ndarray:
        if guesses not in self._world_runs:
            self._world_runs[guesses] = _read_only(
                np.tile(
                    np.arange(len(self.runs), dtype=np.int32),
                    guesses,
                )
            )
        return self._world_runs[guesses]

    def identity(self, worlds: int) -> np.ndarray:
        """Tangent directions along the simulator's own parameters, shape (W, P, P)."""
        if worlds not in self._identities:
            self._identities[worlds] = _read_only(
                np.tile(
                    np.eye(len(self.simulator.parameters)),
                    (worlds, 1, 1),
                )
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
        tangents = dp if direct else self.identity(len(p))
        q, v, dq = self.simulator.jacobian(
            self.worlds(guesses),
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
        self,
        internal: np.ndarray,
        counts: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Cost, gradient and Gauss-Newton matrix in solver coordinates, priors included.

        Args:
            internal: Guesses in solver coordinates, shape (S, F).
            counts: Leading samples to use per run, shape (R,); default all.

        Returns:
            Half the squared norm of the whitened residuals, shape (S,), gradient (S, F), matrix (S, F, F). A guess whose rollout
            diverged, or whose moving part would have no inertia, has an infinite cost and zero gradient.
        """
        physical = self.coordinates.physical(internal)
        p, dp = self.kernel_parameters(physical)
        normal = _NormalEquations.of_priors(self.coordinates, physical)
        slope = self.coordinates.slope(internal)
        with np.errstate(over="ignore", invalid="ignore"):
            self._add_runs(
                normal,
                physical,
                p,
                dp,
                self.simulator.sample_counts if counts is None else counts,
            )
            cost = normal.cost
            gradient = normal.gradient * slope
            matrix = normal.matrix * slope[:, :, None] * slope[:, None, :]
        guesses, size = internal.shape
        inertia = p[:, INDEX["inertia"]].reshape(guesses, -1)
        massless = (inertia <= 0.0).any(axis=1)
        finite = np.isfinite(cost) & np.isfinite(matrix).all(axis=(1, 2))
        bad = massless | ~finite
        if bad.any():
            cost[bad] = np.inf
            gradient[bad] = 0.0
            matrix[bad] = np.eye(size)
        return cost, gradient, matrix

    def _add_runs(
        self,
        normal: _NormalEquations,
        physical: np.ndarray,
        p: np.ndarray,
        dp: np.ndarray,
        counts: np.ndarray,
    ) -> None:
        """The runs' part of the normal equations.

        Args:
            normal: Where it is added.
            physical: Free unknowns of each guess, shape (S, F).
            p: Parameters of each world, shape (S R, P).
            dp: Their tangents, shape (S R, P, F).
            counts: Leading samples to use per run, shape (R,).
        """
        guesses = len(physical)
        values = self.all_values(physical) if self.ripples else physical
        q, _, dq, direct = self._rollout(p, dp, counts)
        dp = dp.reshape(
            guesses,
            len(self.runs),
            *dp.shape[1:],
        )
        # run by run: a run is touched by few of many unknowns
        for row, columns in enumerate(self._touching):
            count = int(counts[row])
            shown = q[:, row, :count]
            slopes = dq[:, row, :count]
            by_unknown = dp[:, row]
            slopes = slopes[:, :, columns] if direct else slopes @ by_unknown[:, :, columns]
            if self.ripples:
                shown, slopes = self.observe(
                    row,
                    values,
                    shown.copy(),
                    slopes,
                    self.estimated[columns],
                )
            weight = self.weight[row, :count]
            residual = (shown - self.measured[row, :count]) * weight
            normal.add(columns, residual, slopes * weight[:, None])

    @property
    def samples(self) -> int:
        """How many numbers were measured."""
        return int(np.count_nonzero(self.weight))

    def other_information(self, values: np.ndarray) -> np.ndarray:
        """Information of other signals than the encoder's on the estimated unknowns at given values, shape (F, F): none here."""
        return np.zeros((len(self.estimated), len(self.estimated)))

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
            by_unknown = dp.reshape(*q.shape[:2], *dp.shape[1:])
            dq = dq.copy() if direct else dq @ by_unknown
        if self.ripples:
            for row in range(len(self.runs)):
                q[:, row], dq[:, row] = self.observe(
                    row,
                    values,
                    q[:, row],
                    dq[:, row],
                    columns,
                )
        return q, v, dq


def _known_together(
    robot: Robot,
    runs: Sequence[PreparedRun],
    estimated: Sequence[Unknown],
) -> tuple[Sequence[Key], np.ndarray]:
    """Keys and joint covariance of those estimated unknowns whose priors are correlated."""
    calibration = prior_of(robot, runs)
    if calibration is None:
        return of_one_kind(robot, estimated)
    if calibration.swing_error > 0.0:
        calibration = calibration.given(
            {(kind, run.run.joint) for run in runs for kind in run.kind.kept_rise}
        )
    return calibration.keys, calibration.covariance
