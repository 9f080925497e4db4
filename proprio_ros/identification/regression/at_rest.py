"""What an arm holds that stands, or that moves for a few seconds only, by what a calibration of motions knows of it.

Where a joint stands, its motor holds what gravity pulls, less what dry friction carries of it: anything from all that friction has
on one side to all of it on the other. So a stance is an equation for each joint with an error that large:

    torque = bodies, payload + friction (coulomb + load friction |torque|) u,      |u| at most about 1

A joint that has just arrived was braked by its friction, and mostly rests there, with u on the side it came from; a rebound leaves
it on the other. Of a joint that was never seen moving u is anything. Bodies, gears and torque constants are the calibration's, with
its covariance, and the mass is the one unknown (generalised least squares). Several poses, and the same pose reached from above and
from below, make the errors of friction differ, and their mean small.

Where the arm moved for a moment, its sliding friction is known, and the running estimate (`online`) says more than how it stands.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from proprio_ros.calibration_files.motions import ARM_TERMS, MotionCalibration
from proprio_ros.errors import TooLittleMotion
from proprio_ros.identification.gates import chi2_limit
from proprio_ros.identification.regression.error_budget import CALIBRATION, CONSTANTS
from proprio_ros.identification.regression.motion_equations import Arm, Problem, equations
from proprio_ros.identification.regression.motion_fit import check_arm
from proprio_ros.identification.regression.motion_prior import LOAD_FRICTION_SPREAD, payload_stds
from proprio_ros.identification.regression.online import TOLD_S, OnlineEstimate, OnlineEstimator
from proprio_ros.quantity import Z95
from proprio_ros.recordings.motions import Motion
from proprio_ros.records import FloatArray
from proprio_ros.robot import Robot
from proprio_ros.robot.regressor import gravity_torques, point_mass

SHORTEST_S, SETTLING_S = 0.6, 0.3
"""How long all joints stand in a stance, and how much of it they take to come to rest."""
# They stand while none leaves a band as wide as the larger of these.
STILL_RAD = 2e-3
STILL_COUNTS = 2.5
SAME_POSE_RAD = 0.05
"""Stances nearer to each other, which no joint reached from the other side, are one, which somebody touched."""
ARRIVED, ARRIVED_STD, ANYWHERE_STD = 0.6, 0.6, 0.7
"""Of the friction that a joint has, how much carries where it arrived, against its way; and where nobody saw it arrive."""
ALIKE = 0.5
"""Part of that variance which a joint has in common in all poses that it reached from one side: many of them are no cure."""
FRICTION = "friction of joints that stand"
PLACE = "where the load lies"
MOVING = "a few seconds of motion"
ROUNDS = 20
STANCE_S, CHANGED_SIGMAS = 0.2, 2.0
"""So often it is asked what an arm holds that stands; and so far from what it held on its way something was put in or taken out."""


def _still_band(robot: Robot, joints: Sequence[str]) -> FloatArray:
    """What each joint may move by and stand [rad], shape (n,)."""
    return np.maximum(
        STILL_COUNTS * np.array([robot.drive_trains[name].encoder_resolution for name in joints]),
        STILL_RAD,
    )


@dataclass(frozen=True)
class Stances:
    """Where an arm stood, S times: positions [rad], currents [A], and the sign of each joint's way there, shape (S, n) each."""

    position: FloatArray
    current_A: FloatArray
    way: FloatArray

    @classmethod
    def of(
        cls,
        robot: Robot,
        motion: Motion,
        joints: Sequence[str],
    ) -> Stances:
        """Those of a recording, of some of its joints."""
        columns = [motion.joints.index(name) for name in joints]
        position = motion.position[:, columns]
        current = motion.current_A[:, columns]
        times_s = motion.times_s
        band = _still_band(robot, joints)
        found: list[tuple[FloatArray, FloatArray, FloatArray]] = []
        width = round(SHORTEST_S / float(np.median(np.diff(times_s)))) + 1
        if len(times_s) < width:
            return cls(*np.zeros((3, 0, len(joints))))
        spans = np.ptp(
            np.lib.stride_tricks.sliding_window_view(position, width, axis=0),
            axis=2,
        )
        quiet = np.flatnonzero((spans <= band).all(axis=1))
        end = 0
        while len(quiet := quiet[quiet >= end]):
            first = int(quiet[0])
            rest = position[first:]
            gone = ((np.maximum.accumulate(rest) - np.minimum.accumulate(rest)) > band).any(axis=1)
            end = first + (int(np.argmax(gone)) if gone.any() else len(rest))
            stood = slice(
                int(np.searchsorted(times_s, times_s[first] + SETTLING_S)),
                end,
            )
            at = position[stood].mean(axis=0)
            away = np.abs(position[:first] - at) > band
            before = [int(np.flatnonzero(column)[-1]) if column.any() else -1 for column in away.T]
            way = [
                float(np.sign(at[n] - position[row, n])) if row >= 0 else 0.0
                for n, row in enumerate(before)
            ]
            if (
                found
                and np.abs(found[-1][0] - at).max() < SAME_POSE_RAD
                and way == found[-1][2].tolist()
            ):
                found.pop()
            found.append((at, current[stood].mean(axis=0), np.array(way)))
        shape = (len(found), len(joints))
        return cls(*(np.array([row[k] for row in found]).reshape(shape) for k in range(3)))


@dataclass(frozen=True)
class RestFit:
    """The mass in the hand of an arm that stood, or hardly moved."""

    mass_kg: float
    std_kg: float
    stances: int  # that it rests on
    parts: Mapping[str, float]  # what puts how much standard deviation on it [kg], by name
    # chi2, freedom: what is left over, in its standard deviations, squared and summed, and of how many equations
    chi2: float = 0.0
    freedom: int = 0
    # rms, expected_rms: the same in torque, and what is expected [N m]
    rms: float = float("nan")
    expected_rms: float = float("nan")
    moved_s: float = 0.0  # seconds of motion that it rests on instead; 0: on stances
    # what the other of the two says, with its standard deviation [kg]
    beside: tuple[float, float] | None = None


def fit_at_rest(
    robot: Robot,
    motions: Sequence[Motion],
    calibration: MotionCalibration,
    centre_m: FloatArray,
    centre_std_m: FloatArray | None,
) -> RestFit:
    """What all motions hold, by their stances, or by the motion of the only one where that says more.

    Args:
        robot: As its file states it.
        motions: With the payload, at least one.
        calibration: Of this arm.
        centre_m: Of the payload in its frame, shape (3,).
        centre_std_m: How far it may lie from there; None: nobody said where it is.

    Raises:
        TooLittleMotion: The arm neither stands nor moves.
        RecordingError: The calibration is of other joints.
        RobotError: Torque constants are no longer those of the calibration.
    """
    check_arm(robot, motions, calibration)
    motions = [motion.complete() for motion in motions]
    arm = Arm.of(robot, calibration.joints, dict(motions[0].held))
    if centre_std_m is None:
        centre_std_m = payload_stds(arm)[1:4]
    found = [Stances.of(robot, motion, calibration.joints) for motion in motions]
    stood = Stances(
        *(
            np.concatenate([getattr(each, name) for each in found])
            for name in Stances.__dataclass_fields__
        )
    )
    by_stance = (
        _by_stances(arm, calibration, stood, centre_m, centre_std_m) if len(stood.way) else None
    )
    moving = (
        _in_motion(robot, motions[0], calibration, centre_m, centre_std_m)
        if len(motions) == 1
        else None
    )
    if by_stance is None and moving is None:
        raise TooLittleMotion(
            f"{motions[0].name}: the arm neither stands still for {SHORTEST_S:g} s nor moves for long enough: hold it in several "
            "poses for 2 s each, or record 15 s of motion"
        )
    if by_stance is None or moving is None:
        return by_stance or moving  # type: ignore[return-value]
    coarser, finer = sorted((by_stance, moving), key=lambda fit: -fit.std_kg)
    return replace(finer, beside=(coarser.mass_kg, coarser.std_kg))


def _in_motion(
    robot: Robot,
    motion: Motion,
    calibration: MotionCalibration,
    centre_m: FloatArray,
    centre_std_m: FloatArray,
) -> RestFit | None:
    """As the running estimate has it at the end; None where nothing moved, or something was picked up or put down meanwhile."""
    std_m = float(max(np.max(centre_std_m), 1e-3))
    running = OnlineEstimator(
        robot, calibration, centre_m=centre_m.tolist(), centre_std_m=std_m, held=dict(motion.held)
    )
    columns = [motion.joints.index(name) for name in calibration.joints]
    rows = zip(
        motion.times_s.tolist(),
        motion.position[:, columns],
        motion.current_A[:, columns],
        strict=True,
    )
    changes = 0
    for time_s, position, current in rows:
        if running.add(time_s, position.tolist(), current.tolist()):
            now = running.estimate()
            changes += now is not None and now.changed
    last = running.estimate()
    if last is None or changes:
        return None
    return RestFit(
        last.mass_kg, last.std_kg, 0, {MOVING: last.std_kg}, moved_s=float(last.motion_s)
    )


def _by_stances(
    arm: Arm,
    calibration: MotionCalibration,
    stood: Stances,
    centre_m: FloatArray,
    centre_std_m: FloatArray,
) -> RestFit:
    count = arm.count
    bodies = np.arange(10 * count)
    gears = 11 * count + np.arange(count)
    shares = 12 * count + np.arange(count)
    coulomb, offset = (ARM_TERMS * count + k * count + np.arange(count) for k in (1, 2))
    values = calibration.values
    scale = calibration.torque_scale
    by_body = gravity_torques(arm.model, stood.position)
    by_payload = by_body[:, :, arm.body] @ arm.from_payload
    per_kg = by_payload @ point_mass(centre_m) / scale
    axes = by_payload[..., 1:4] / scale
    torque = (stood.current_A * calibration.torque_constants).ravel()
    stances = len(stood.way)
    size = torque.size
    joint = np.tile(np.arange(count), stances)
    row = np.arange(size)
    way = stood.way.ravel()
    mass = 0.0
    alike = (joint[:, None] == joint) & (way[:, None] == way)
    given = 1.0 - values[shares][joint]
    pull = (by_body.reshape(size, -1) @ values[bodies]).ravel()
    lever = per_kg.ravel() * given
    shift = axes.reshape(size, 3) * given[:, None] * centre_std_m
    for _ in range(ROUNDS):
        whole = pull + mass * per_kg.ravel()
        friction = np.abs(values[coulomb])[joint] + (
            np.abs(values[gears])[joint] + LOAD_FRICTION_SPREAD
        ) * np.abs(whole)
        follows = np.zeros((size, len(values)))
        follows[:, bodies] = by_body.reshape(size, -1) * given[:, None]
        follows[row, gears[joint]] = ARRIVED * way * np.abs(whole)
        follows[row, shares[joint]] = -whole
        follows[row, coulomb[joint]], follows[row, offset[joint]] = ARRIVED * way, 1.0
        of_friction = friction * np.where(way != 0.0, ARRIVED_STD, ANYWHERE_STD)
        of_recording = follows[:, calibration.friction] * calibration.friction_spread
        learnt = follows @ calibration.covariance @ follows.T
        stretched = follows @ calibration.deviations.T
        parts = {
            CALIBRATION: max(learnt, stretched @ stretched.T, key=np.trace)
            + of_recording @ of_recording.T,
            FRICTION: np.where(alike, ALIKE * np.outer(of_friction, of_friction), 0.0)
            + np.diag((1.0 - ALIKE) * of_friction**2 + calibration.residual[joint] ** 2),
            PLACE: mass**2 * shift @ shift.T,
        }
        covariance = np.sum(list(parts.values()), axis=0)
        right = torque - pull * given - values[offset][joint] - ARRIVED * way * friction
        weighted = np.linalg.solve(covariance, lever)
        gain = weighted / max(float(lever @ weighted), 1e-12)
        before = mass
        mass = float(gain @ right)
        if abs(mass - before) < 1e-6:
            break
    left = right - mass * lever
    chi2 = float(left @ np.linalg.solve(covariance, left))
    freedom = max(size - 1, 1)
    variances = {name: float(gain @ part @ gain) for name, part in parts.items()}
    variances[CONSTANTS] = (mass * calibration.torque_scale_std) ** 2
    wider = max(1.0, chi2 / freedom)
    std = float(np.sqrt(wider * sum(variances.values())))
    return RestFit(
        mass,
        std,
        stances,
        {name: float(np.sqrt(wider * variance)) for name, variance in variances.items()},
        chi2,
        freedom,
        float(np.sqrt(np.mean(left**2))),
        float(np.sqrt(np.trace(parts[FRICTION]) / size)),
    )


class StandingEstimator(OnlineEstimator):
    """A running estimate that goes on where the arm stands: by its motion, and by how it stands where that says something else.

    Where somebody takes something out of a hand that stands still, or puts it in, no joint moves, or each by a few counts. What the
    arm's motion said before then stands no longer; and nothing is known while an arm moves that nobody sends anywhere.
    """

    def __init__(self, robot: Robot, calibration: MotionCalibration, **known: Any) -> None:
        super().__init__(robot, calibration, **known)
        self._band = _still_band(robot, self.joints)
        self._centre_std_m = np.full(3, known["centre_std_m"])
        self._rows: deque[tuple[float, FloatArray, FloatArray]] = deque()
        self._stance: RestFit | None = None
        # what stood is moved by something else than its goals, or no load explains how it stands
        self._lost = False
        self._stands_since_s, self._next_stance_s = np.inf, -np.inf
        # since when what stands is that of a stance, and until when it is news
        self._of_stance: tuple[float, float] | None = None

    def add(
        self,
        time_s: float,
        positions: Sequence[float],
        currents: Sequence[float],
        works: bool = True,
    ) -> bool:
        """As that of the running estimate; ``works``: whether somebody moves the arm, as far as that is known."""
        new = works and super().add(time_s, positions, currents)
        row = (time_s, np.array(positions), np.array(currents))
        if not np.isfinite([time_s, *row[1], *row[2]]).all():
            return new
        self._lost &= not works
        if self._rows and not 0.0 <= time_s - self._rows[-1][0] < SETTLING_S:
            self._rows.clear()
            self._next_stance_s = -np.inf
        self._rows.append(row)
        while time_s - self._rows[0][0] > SHORTEST_S:
            self._rows.popleft()
        if not time_s - SHORTEST_S + SETTLING_S > self._rows[0][0] or self._same:
            return new
        position = np.array([each[1] for each in self._rows])
        if (np.ptp(position, axis=0) > self._band).any():
            self._lost |= not works and self._stands_since_s < time_s
            self._stance, self._stands_since_s = None, np.inf
            return new or self._lost
        self._stands_since_s = min(self._stands_since_s, self._rows[0][0])
        if time_s < self._next_stance_s:
            return new
        self._next_stance_s = time_s + STANCE_S
        late = [each[0] > time_s - SHORTEST_S + SETTLING_S for each in self._rows]
        at = position[late].mean(axis=0)[None]
        current = np.array([each[2] for each in self._rows])[late].mean(axis=0)[None]
        # where it came from is too long ago, or somebody touched it since
        stance = Stances(at, current, np.zeros_like(at))
        fit = _by_stances(
            self._arm, self._calibration, stance, np.array(self.centre_m), self._centre_std_m
        )
        told = fit.chi2 <= chi2_limit(fit.freedom) and fit.mass_kg > -Z95 * fit.std_kg
        self._stance, self._lost = fit if told else None, not (works or told)
        return new or told or self._lost

    def estimate(self) -> OnlineEstimate | None:
        moved = super().estimate()
        fit = self._stance
        if fit is None and self._lost:
            now_s = self._rows[-1][0]
            any_kg = self._arm.kg
            return OnlineEstimate(
                now_s, 0.0, any_kg, (-Z95 * any_kg, Z95 * any_kg), 0.0, False, now_s, None
            )
        if fit is None:
            return moved
        now_s = self._rows[-1][0]
        half = Z95 * fit.std_kg
        if moved is not None:
            if abs(moved.mass_kg - fit.mass_kg) < CHANGED_SIGMAS * np.hypot(
                moved.std_kg, fit.std_kg
            ):
                return replace(moved, resting_since_s=self._stands_since_s)
            self._forget()
            self._of_stance = now_s, now_s + TOLD_S
        since_s, news_s = self._of_stance or (self._stands_since_s, -np.inf)
        interval = fit.mass_kg - half, fit.mass_kg + half
        return OnlineEstimate(
            now_s,
            fit.mass_kg,
            fit.std_kg,
            interval,
            0.0,
            now_s < news_s,
            since_s,
            self._stands_since_s,
        )


def refuse_useless(robot: Robot, motion: Motion) -> None:
    """Refuse a motion that no fit takes by itself, in the words of that fit.

    Raises:
        RecordingError: It is too short, too slow or of other joints than the robot's calibration.
        RobotError: Torque constants are no longer those of the calibration.
    """
    learnt = robot.motion_calibration
    if learnt is not None:
        check_arm(robot, [motion], learnt)
    try:
        problem = Problem.of(
            [equations(robot, motion, motion.joints if learnt is None else learnt.joints)], 1
        )
        problem.stretches_of(problem.carrying, motion.name, better_s=15.0)
    except TooLittleMotion:
        if learnt is None:
            raise
        fit_at_rest(robot, [motion], learnt, np.zeros(3), None)
