"""What an arm holds that stands, or that moves for a few seconds only, by what a calibration of motions knows of it.

Where a joint stands, its motor holds what gravity pulls, less what dry friction carries of it: anything from all that friction has
on one side to all of it on the other. So a stance is an equation for each joint with an error that large:

    torque = bodies, payload + friction (coulomb + load friction |torque|) u,      |u| at most about 1

A joint that has just arrived was braked by its friction, and mostly rests there, with u on the side it came from; a rebound leaves
it on the other. Of a joint that was never seen moving u is anything. Bodies, gears and torque constants are the calibration's, with
its covariance, and the mass is the one unknown (generalised least squares). Several poses, and the same pose reached from above and
from below, make the errors of friction differ, and their mean small.

Where the arm moved for a moment, its sliding friction is known, and the running estimate (`online`) says more than how it stands.
Constants below that name no source were chosen by hand; `test/benchmarks/at_rest.py` measures how intervals hold with them.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from proprio_ros.calibration_files.motions import MotionCalibration
from proprio_ros.errors import RecordingError, TooLittleMotion
from proprio_ros.identification.chance import beyond_chance
from proprio_ros.identification.regression.arm_terms import ArmTerms
from proprio_ros.identification.regression.error_budget import CALIBRATION, CONSTANTS
from proprio_ros.identification.regression.known_load import (
    covariance_with_scale,
    deviations_with_scale,
    scale_variance_alone,
)
from proprio_ros.identification.regression.motion_equations import Arm, Problem, equations
from proprio_ros.identification.regression.motion_fit import LEAST_PLACE_STD_M, check_arm
from proprio_ros.identification.regression.motion_prior import LOAD_FRICTION_SPREAD, payload_stds
from proprio_ros.identification.regression.online import (
    TOLD_S,
    OnlineEstimate,
    OnlineEstimator,
    is_finite,
)
from proprio_ros.identification.regression.scale_in_motion import NOTHING_SEEN, TorqueScale
from proprio_ros.quantity import Z95
from proprio_ros.recordings.motions import Motion
from proprio_ros.records import FloatArray
from proprio_ros.robot import Robot
from proprio_ros.robot.regressor import gravity_torques, point_mass

SHORTEST_S = 0.6  # So long all joints stand in a stance,
SETTLING_S = 0.3  # and so much of it they take to come to rest.
# They stand while none leaves a band as wide as the larger of these.
STILL_RAD = 2e-3
STILL_COUNTS = 2.5
SAME_POSE_RAD = 0.05
"""Stances nearer to each other, which no joint reached from the other side, are one, which somebody touched."""
# Of the friction that a joint has, how much carries where it arrived, against its way; and where nobody saw it arrive. Guesses:
# `test/benchmarks/at_rest.py` says how intervals hold with them.
ARRIVED = 0.6
ARRIVED_STD = 0.6
ANYWHERE_STD = 0.7
ALIKE = 0.5
"""Part of that variance which a joint has in common in all poses that it reached from one side: many of them are no cure."""
FRICTION = "friction of joints that stand"
PLACE = "where the load lies"
GAIN = "the servos' gain"
MOVING = "a few seconds of motion"
ROUNDS = 20
SETTLED_KG = 1e-6  # What the mass changes by in a round that is the last.
STANCE_S = 0.2  # So often it is asked what an arm holds that stands.
# And so far from what it held on its way something was put in or taken out.
CHANGED_SIGMAS = 2.0
LEANT_RAD = 0.02
"""What carries the arm may lean over by so much and stand: 2 % of gravity's torque [rad]."""
LOOKS = 20  # places along a recording where that is looked at


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
        """Those of a recording.

        ``robot``: whose encoders they are; ``motion``: the recording; ``joints``: some of its joints, n.
        """
        columns = [motion.joints.index(name) for name in joints]
        position = motion.position[:, columns]
        current = motion.current_A[:, columns]
        band = _still_band(robot, joints)
        found: list[_Stance] = []
        for first, end in _quiet_spans(motion.times_s, position, band):
            settled_s = motion.times_s[first] + SETTLING_S
            stood = slice(
                int(np.searchsorted(motion.times_s, settled_s)),
                end,
            )
            at = position[stood].mean(axis=0)
            way = _way_there(position[:first], at, band)
            stance = _Stance(
                at,
                current[stood].mean(axis=0),
                way,
            )
            if found and stance.repeats(found[-1]):
                found.pop()
            found.append(stance)
        shape = (len(found), len(joints))
        return cls(
            position=np.array([each.position for each in found]).reshape(shape),
            current_A=np.array([each.current_A for each in found]).reshape(shape),
            way=np.array([each.way for each in found]).reshape(shape),
        )

    @classmethod
    def together(cls, parts: Sequence[Stances]) -> Stances:
        """Of several recordings."""
        return cls(
            position=np.concatenate([part.position for part in parts]),
            current_A=np.concatenate([part.current_A for part in parts]),
            way=np.concatenate([part.way for part in parts]),
        )


@dataclass(frozen=True)
class _Stance:
    """One of them, shape (n,) each."""

    position: FloatArray
    current_A: FloatArray
    way: FloatArray

    def repeats(self, before: _Stance) -> bool:
        """Whether the pose is the one before, reached from the same side."""
        near = np.abs(before.position - self.position).max() < SAME_POSE_RAD
        return bool(near and self.way.tolist() == before.way.tolist())


def _quiet_spans(
    times_s: FloatArray, position: FloatArray, band: FloatArray
) -> Iterator[tuple[int, int]]:
    """First sample, and the one behind the last, of each span in which no joint leaves its band."""
    width = round(SHORTEST_S / float(np.median(np.diff(times_s)))) + 1
    if len(times_s) < width:
        return
    samples = np.lib.stride_tricks.sliding_window_view(position, width, axis=0)
    still = np.ptp(samples, axis=2) <= band
    quiet = np.flatnonzero(still.all(axis=1))
    end = 0
    while len(quiet := quiet[quiet >= end]):
        first = int(quiet[0])
        rest = position[first:]
        spread = np.maximum.accumulate(rest) - np.minimum.accumulate(rest)
        gone = (spread > band).any(axis=1)
        lasts = int(np.argmax(gone)) if gone.any() else len(rest)
        end = first + lasts
        yield first, end


def _way_there(
    before: FloatArray,
    at: FloatArray,
    band: FloatArray,
) -> FloatArray:
    """The sign of each joint's way to a pose from where it last was away from it; 0 where it never was, shape (n,)."""
    way = np.zeros(len(at))
    for joint, away in enumerate((np.abs(before - at) > band).T):
        if away.any():
            last = int(np.flatnonzero(away)[-1])
            way[joint] = np.sign(at[joint] - before[last, joint])
    return way


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
    scale: TorqueScale = NOTHING_SEEN  # of the torques, as motion before and between shows it
    by_scale_kg: float = 0.0  # what the mass is too large by per part that all torques are
    # what the other of the two says, with its standard deviation [kg]
    beside: tuple[float, float] | None = None

    def scaled_by(self, scale: TorqueScale) -> RestFit:
        """The same where motion leaves the torques' ``scale`` open."""
        of_gain = abs(self.by_scale_kg) * scale.unresolved
        return replace(
            self,
            std_kg=float(np.hypot(self.std_kg, of_gain)),
            parts={**self.parts, **({GAIN: of_gain} if of_gain else {})},
            scale=scale,
        )


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
    check_carriers(robot, motions, calibration.joints)
    arm = Arm.of(
        robot,
        calibration.joints,
        dict(motions[0].held),
    )
    if centre_std_m is None:
        centre_std_m = payload_stds(arm)[1:4]
    found = [Stances.of(robot, motion, calibration.joints) for motion in motions]
    stood = Stances.together(found)
    in_motion = [
        _in_motion(robot, motion, calibration, centre_m, centre_std_m) for motion in motions
    ]
    scale = NOTHING_SEEN
    for moved in in_motion:
        scale = scale.plus(moved.scale)
    fits: list[RestFit] = []
    if len(stood.way):
        fit = _by_stances(arm, calibration, stood, centre_m, centre_std_m)
        fits.append(fit.scaled_by(scale))
    if len(motions) == 1 and in_motion[0].moved_s:
        fits.append(in_motion[0])
    if not fits:
        raise TooLittleMotion(
            f"{motions[0].name}: the arm neither stands still for {SHORTEST_S:g} s nor moves for long enough: hold it in several "
            "poses for 2 s each, or record 15 s of motion"
        )
    if len(fits) == 1:
        return fits[0]
    coarser, finer = sorted(fits, key=lambda fit: -fit.std_kg)
    return replace(
        finer,
        beside=(coarser.mass_kg, coarser.std_kg),
    )


def check_carriers(robot: Robot, motions: Sequence[Motion], joints: Sequence[str]) -> None:
    """Refuse motions in which what carries the arm, as a torso, leans over: gravity then pulls from elsewhere.

    Args:
        robot: Its geometry.
        motions: Weighed together.
        joints: Of the arm.

    Raises:
        RecordingError: It does.
    """
    names = robot.model.carriers(joints)
    base = robot.model.joint(joints[0]).parent
    down = []
    for motion in motions:
        moving = [name for name in names if name in motion.beside]
        if not {*names} <= {*moving, *motion.held}:
            continue
        rows = np.linspace(0, len(motion.times_s) - 1, LOOKS).astype(int)
        for row in rows:
            pose = {**motion.held, **{name: float(motion.beside[name][row]) for name in moving}}
            down.append(robot.gravity @ robot.model.frame_transform(base, pose)[:3, :3])
    if not down:
        return
    farthest = np.linalg.norm(np.array(down) - down[0], axis=1).max()
    away = farthest / np.linalg.norm(robot.gravity)
    if names and away > LEANT_RAD:
        raise RecordingError(
            f"{', '.join(names)} carried the arm and leant over by {away:.2g} rad: an arm that hardly moves is weighed where they "
            "stand; hold them, and weigh recordings between which they moved apart",
            motions[0].name,
        )


def _in_motion(
    robot: Robot,
    motion: Motion,
    calibration: MotionCalibration,
    centre_m: FloatArray,
    centre_std_m: FloatArray,
) -> RestFit:
    """As the running estimate has it at the end; of no motion where none was, or something was picked up or put down meanwhile."""
    std_m = float(max(np.max(centre_std_m), LEAST_PLACE_STD_M))
    running = OnlineEstimator(
        robot, calibration, centre_m=centre_m.tolist(), centre_std_m=std_m, held=dict(motion.held)
    )
    columns = [motion.joints.index(name) for name in calibration.joints]
    times_s = motion.times_s.tolist()
    positions = motion.position[:, columns].tolist()
    currents = motion.current_A[:, columns].tolist()
    for time_s, position, current in zip(times_s, positions, currents, strict=True):
        if running.add(time_s, position, current):
            now = running.estimate()
            if now is not None and now.changed:
                return RestFit(0.0, np.inf, 0, {}, scale=running.scale)
    last = running.estimate()
    if last is None:
        return RestFit(0.0, np.inf, 0, {})
    return RestFit(
        last.mass_kg,
        last.std_kg,
        0,
        parts={MOVING: last.std_kg},
        moved_s=float(last.motion_s),
        scale=running.scale,
    )


def _by_stances(
    arm: Arm,
    calibration: MotionCalibration,
    stood: Stances,
    centre_m: FloatArray,
    centre_std_m: FloatArray,
) -> RestFit:
    """The mass by generalised least squares over all joints of all stances."""
    equations = _StanceEquations(arm, calibration, stood, centre_m, centre_std_m)
    mass = 0.0
    for _ in range(ROUNDS):
        errors = equations.errors(mass)
        covariance = np.sum(
            list(errors.parts.values()),
            axis=0,
        )  # (E, E)
        weighted = np.linalg.solve(covariance, equations.lever)
        gain = weighted / max(float(equations.lever @ weighted), 1e-12)  # (E,)
        before = mass
        mass = float(gain @ errors.right)
        if abs(mass - before) < SETTLED_KG:
            break
    left = errors.right - mass * equations.lever
    chi2 = float(left @ np.linalg.solve(covariance, left))
    freedom = max(len(left) - 1, 1)
    variances = {name: float(gain @ part @ gain) for name, part in errors.parts.items()}
    variances[CONSTANTS] = mass**2 * scale_variance_alone(calibration)
    wider = max(1.0, chi2 / freedom)
    expected = np.trace(errors.parts[FRICTION]) / len(left)
    return RestFit(
        mass_kg=mass,
        std_kg=float(np.sqrt(wider * sum(variances.values()))),
        stances=len(stood.way),
        parts={name: float(np.sqrt(wider * variance)) for name, variance in variances.items()},
        chi2=chi2,
        freedom=freedom,
        rms=float(np.sqrt(np.mean(left**2))),
        expected_rms=float(np.sqrt(expected)),
        by_scale_kg=mass + float(gain @ equations.own),
    )


@dataclass(frozen=True)
class _StanceErrors:
    """What equations of stances err by, where the payload has some mass."""

    right: FloatArray  # torque that the mass is to explain [N m], shape (E,)
    parts: Mapping[str, FloatArray]  # covariances of that by their cause, shape (E, E)


class _StanceEquations:
    """An equation for each joint of each stance, E = S n of them, and what a calibration says of its terms.

    Attributes:
        lever: Torque per kilogram of the payload [N m/kg], shape (E,).
    """

    def __init__(
        self,
        arm: Arm,
        calibration: MotionCalibration,
        stood: Stances,
        centre_m: FloatArray,
        centre_std_m: FloatArray,
    ) -> None:
        count = arm.count
        terms = ArmTerms(count)
        values = calibration.values
        self._terms = terms
        self._calibration = calibration
        self._joint = np.tile(np.arange(count), len(stood.way))  # (E,)
        self._way = stood.way.ravel()  # (E,)
        # one true torque of the constants, which may be off by their scale
        by_body = gravity_torques(arm.model, stood.position)  # (S, n, n, 10)
        by_payload = by_body[:, :, arm.body] @ arm.from_payload  # (S, n, 10)
        scale = calibration.torque_scale
        self._given = 1.0 - values[terms.torque_shares][self._joint]
        self._by_body = by_body.reshape(len(self._joint), -1)  # (E, 10 n)
        self._pull = (self._by_body @ values[terms.bodies]).ravel()
        self._per_kg = (by_payload @ point_mass(centre_m) / scale).ravel()
        self.lever = self._per_kg * self._given
        axes = by_payload[..., 1:4].reshape(-1, 3) / scale
        self._shift = axes * self._given[:, None] * centre_std_m  # (E, 3)
        self.own = self._pull * self._given
        torque = (stood.current_A * calibration.torque_constants).ravel()
        self._beside_arm = torque - self._pull * self._given - values[terms.offset][self._joint]

    def errors(self, mass_kg: float) -> _StanceErrors:
        """With the friction that joints have under such a payload."""
        calibration = self._calibration
        whole = self._pull + mass_kg * self._per_kg
        coulomb = np.abs(calibration.values[self._terms.coulomb])[self._joint]
        gears = np.abs(calibration.values[self._terms.load_friction])[self._joint]
        friction = coulomb + (gears + LOAD_FRICTION_SPREAD) * np.abs(whole)  # (E,)
        follows = self._by_terms(whole)
        learnt, stretched = self._of_calibration(follows, mass_kg)
        of_recording = follows[:, calibration.friction] * calibration.friction_spread
        of_calibration = max(learnt, stretched @ stretched.T, key=np.trace)
        return _StanceErrors(
            right=self._beside_arm - ARRIVED * self._way * friction,
            parts={
                CALIBRATION: of_calibration + of_recording @ of_recording.T,
                FRICTION: self._of_friction(friction),
                PLACE: mass_kg**2 * self._shift @ self._shift.T,
            },
        )

    def _of_calibration(self, follows: FloatArray, mass_kg: float) -> tuple[FloatArray, FloatArray]:
        """What the calibration errs by: covariance, shape (E, E), and which way each of its stretches pulls, (E, stretches).

        Where a known load told the scale of the torques, that errs together with the terms.

        Args:
            follows: How the equations follow its terms, shape (E, 20 n).
            mass_kg: Of the payload.
        """
        calibration = self._calibration
        if calibration.scale_of_load is None:
            learnt = follows @ calibration.covariance @ follows.T
            return learnt, follows @ calibration.deviations.T
        # a scale that is too large has the payload too heavy: what is right of an equation errs by as much the other way
        both = np.column_stack([follows, -mass_kg * self.lever])
        alone = scale_variance_alone(calibration) * mass_kg**2 * np.outer(self.lever, self.lever)
        learnt = both @ covariance_with_scale(calibration) @ both.T - alone
        return learnt, both @ deviations_with_scale(calibration).T

    def _by_terms(self, whole: FloatArray) -> FloatArray:
        """How the equations follow the calibration's terms, under such torques of gravity, shape (E, 20 n)."""
        terms = self._terms
        row = np.arange(len(whole))
        follows = np.zeros((len(whole), len(self._calibration.values)))
        follows[:, terms.bodies] = self._by_body * self._given[:, None]
        arrived = ARRIVED * self._way
        follows[row, terms.load_friction.start + self._joint] = arrived * np.abs(whole)
        follows[row, terms.torque_shares.start + self._joint] = -whole
        follows[row, terms.coulomb.start + self._joint] = arrived
        follows[row, terms.offset.start + self._joint] = 1.0
        return follows

    def _of_friction(self, friction: FloatArray) -> FloatArray:
        """Any part of it, some of which a joint has in common in all poses that it reached from one side, covariance, (E, E)."""
        of_friction = friction * np.where(self._way != 0.0, ARRIVED_STD, ANYWHERE_STD)
        same_joint = self._joint[:, None] == self._joint
        alike = same_joint & (self._way[:, None] == self._way)
        common = np.where(
            alike,
            ALIKE * np.outer(of_friction, of_friction),
            0.0,
        )
        residual = self._calibration.residual[self._joint]
        return common + np.diag((1.0 - ALIKE) * of_friction**2 + residual**2)


class StandingEstimator(OnlineEstimator):
    """A running estimate that goes on where the arm stands: by its motion, and by how it stands where that says something else.

    Where somebody takes something out of a hand that stands still, or puts it in, no joint moves, or each by a few counts. What the
    arm's motion said before then stands no longer; and nothing is known while an arm moves that nobody sends anywhere.
    """

    def __init__(
        self,
        robot: Robot,
        calibration: MotionCalibration,
        **known: Any,
    ) -> None:
        super().__init__(robot, calibration, **known)
        self._band = _still_band(robot, self.joints)
        self._centre_std_m = np.full(3, known["centre_std_m"])
        self._rows: deque[tuple[float, FloatArray, FloatArray]] = deque()
        self._stance: RestFit | None = None
        # what stood is moved by something else than its goals, or no load explains how it stands
        self._lost = False
        self._stands_since_s = np.inf
        self._next_stance_s = -np.inf
        # since when what stands is that of a stance, and until when it is news
        self._of_stance: tuple[float, float] | None = None

    def add(
        self,
        time_s: float,
        positions: Sequence[float],
        currents: Sequence[float],
        works: bool = True,
    ) -> bool:
        """As that of the running estimate.

        Args:
            time_s: Instant of the sample.
            positions: [rad], length n.
            currents: Of the motors [A], length n.
            works: Whether somebody moves the arm, as far as that is known.
        """
        new = works and super().add(time_s, positions, currents)
        row = (time_s, np.array(positions), np.array(currents))
        if not is_finite(time_s, positions, currents):
            return new
        self._lost &= not works
        self._keep(row)
        if not time_s - SHORTEST_S + SETTLING_S > self._rows[0][0] or self._same:
            return new
        position = np.array([each[1] for each in self._rows])
        if (np.ptp(position, axis=0) > self._band).any():
            self._lost |= not works and self._stands_since_s < time_s
            self._stance = None
            self._stands_since_s = np.inf
            return new or self._lost
        self._stands_since_s = min(self._stands_since_s, self._rows[0][0])
        if time_s < self._next_stance_s:
            return new
        self._next_stance_s = time_s + STANCE_S
        fit = self._fit_stance(time_s, position)
        explained = fit.mass_kg > -Z95 * fit.std_kg and not beyond_chance(fit.chi2, fit.freedom)
        self._stance = fit if explained else None
        self._lost = not (works or explained)
        return new or explained or self._lost

    def _keep(
        self,
        row: tuple[float, FloatArray, FloatArray],
    ) -> None:
        """The rows of the last moments, without a gap."""
        time_s = row[0]
        if self._rows and not 0.0 <= time_s - self._rows[-1][0] < SETTLING_S:
            self._rows.clear()
            self._next_stance_s = -np.inf
        self._rows.append(row)
        while time_s - self._rows[0][0] > SHORTEST_S:
            self._rows.popleft()

    def _fit_stance(self, time_s: float, position: FloatArray) -> RestFit:
        """The mass by how the arm stands now: where it came from is too long ago, or somebody touched it since."""
        late = [each[0] > time_s - SHORTEST_S + SETTLING_S for each in self._rows]
        at = position[late].mean(axis=0)[None]
        currents = np.array([each[2] for each in self._rows])
        current = currents[late].mean(axis=0)[None]
        stance = Stances(at, current, np.zeros_like(at))
        centre_m = np.array(self.centre_m)
        return _by_stances(
            self._arm,
            self._calibration,
            stance,
            centre_m,
            self._centre_std_m,
        )

    def estimate(self) -> OnlineEstimate | None:
        moved = super().estimate()
        fit = self._stance
        if fit is None:
            return self._anything() if self._lost else moved
        if self.scale.is_other:
            fit = replace(fit, std_kg=float(np.hypot(fit.std_kg, self._arm.kg)))
        now_s = self._rows[-1][0]
        if moved is not None:
            apart = abs(moved.mass_kg - fit.mass_kg)
            if apart < CHANGED_SIGMAS * np.hypot(moved.std_kg, fit.std_kg):
                return replace(moved, resting_since_s=self._stands_since_s)
            self._forget()
            self._of_stance = now_s, now_s + TOLD_S
        since_s, news_s = self._of_stance or (self._stands_since_s, -np.inf)
        half = Z95 * fit.std_kg
        return OnlineEstimate(
            time_s=now_s,
            mass_kg=fit.mass_kg,
            std_kg=fit.std_kg,
            ci95_kg=(fit.mass_kg - half, fit.mass_kg + half),
            motion_s=0.0,
            changed=now_s < news_s,
            since_s=since_s,
            resting_since_s=self._stands_since_s,
        )

    def _anything(self) -> OnlineEstimate:
        """Nothing is known of an arm that somebody else moves, but that the load is no heavier than the arm."""
        now_s = self._rows[-1][0]
        any_kg = self._arm.kg
        return OnlineEstimate(
            time_s=now_s,
            mass_kg=0.0,
            std_kg=any_kg,
            ci95_kg=(-Z95 * any_kg, Z95 * any_kg),
            motion_s=0.0,
            changed=False,
            since_s=now_s,
            resting_since_s=None,
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
        fit_at_rest(
            robot,
            [motion],
            learnt,
            np.zeros(3),
            None,
        )
