"""What an arm carries, from any motion of several joints, against the same arm with an empty hand.

A linear regression in weak form (`weak_form`): over windows of half a second the mean torque of each joint is that of the arm's
bodies, of the rotors, of friction and of what the hand carries. The arm's own parameters are unknowns, too, around what its URDF
says, and the empty runs determine them: a URDF alone puts an empty arm off by some percent of its own weight. What no model has
(friction that depends on place and temperature) is a torque that drifts over seconds, so neighbouring windows share one error and
the formal covariance of a regression is five to ten times too small. The interval comes from leaving out stretches of 2.5 s
instead, one by one (delete-a-group jackknife, Kott 2001, Journal of Official Statistics 17), which assumes nothing about the
residuals within a stretch.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, filtfilt
from scipy.stats import t as student

from proprio_ros.errors import RecordingError
from proprio_ros.identification.regression.rigid_body import pseudo_inertia
from proprio_ros.identification.regression.weak_form import Windows, torque_regressor
from proprio_ros.kinds import KINDS
from proprio_ros.recordings.motions import LONGEST_GAP_S, Motion
from proprio_ros.robot import ReducedModel, Robot
from proprio_ros.robot.regressor import PARAMETERS, body_parameters, point_mass

FloatArray = NDArray[np.float64]

WINDOW_S = 0.5
"""Long enough to average over what encoders and current sensors add, short enough to tell one attitude from the next."""
HOP_SHARE = 0.25
BANDWIDTH_HZ = 6.0
"""Positions are smoothed to this before their velocity is taken: arms follow nothing faster with weight on them."""
SLOW_RAD_S = 0.02
"""Dry friction is smoothed over this; a joint that is slower for most of a window rests on friction, which then does not count."""
ITERATIONS = 6
"""Of weights and load friction; the mass of a UR10e changes by less than 1 g in the last."""
BLOCK_S = 2.5
"""Stretches that are left out together: longer than what friction and controllers keep in memory."""
MIN_BLOCKS = 4
RUNS_OF_ITS_OWN = 10_000  # stretches that one run has at most: labels of the next run's start there
LEAST_TORQUE_STD = 0.01
"""Relative; magnets lose 0.1 % of their torque per kelvin, and motors that lift warm by ten."""
VOLTAGE_TORQUE_STD = 0.2
"""Relative, where a voltage drives the motor: its torque is a maker's constant over a winding that warms up, times a gain."""
URDF_SHARE = 0.15
"""An arm that weighs more or less than its URDF by more may owe it to the torque constants, whatever their file says of them; URDFs
were seen to be off by 8 to 16 %."""
LEAST_LOAD_FRICTION_STD = 0.05
"""Gears lose part of the torque that they transmit; a file that does not say how much has not measured it."""
LINK_SHARE = 0.2
"""How far a body's mass may lie off its URDF, relative; first moments and inertia accordingly over the body's size."""
ARM_SHARE = 0.01
"""And in parts of the whole arm's: cables and screws are in no model."""


@dataclass(frozen=True)
class Term:
    """One unknown of the regression.

    Attributes:
        kind: What it is: a key of `KINDS`, or a body's parameter.
        scope: Joint, link or run.
        prior, std: Gaussian prior.
    """

    kind: str
    scope: str
    unit: str
    prior: float
    std: float

    @property
    def label(self) -> str:
        """For people: ``mass of the body behind elbow_joint``."""
        if self.kind.startswith("body_"):
            return f"{self.kind.removeprefix('body_').replace('_', ' ')} of the body behind {self.scope}"
        return f"{KINDS[self.kind].label if self.kind in KINDS else self.kind.replace('_', ' ')} {self.scope}".strip()


@dataclass(frozen=True)
class Equations:
    """The linear equations of one motion: a window and a joint each.

    Attributes:
        arm: Per unit of the bodies' parameters, shape (E, n * 10).
        payload: Per unit of the payload's, in its frame, shape (E, 10).
        rotor: Per unit of armature, shape (E, n).
        direction: Mean of the joint's direction of motion, -1 to 1, shape (E,).
        friction: Per unit of viscous friction, Coulomb friction and offset of the motion's own, shape (E, 3 n).
        right: Mean motor torque [N m], shape (E,).
        joint: Number of the joint, shape (E,).
        block: Number of the stretch, shape (E,).
        waves: Per unit of the parts of Coulomb friction that go with the angle, see `waves`, shape (E, 4 n).
    """

    arm: FloatArray
    payload: FloatArray
    rotor: FloatArray
    direction: FloatArray
    friction: FloatArray
    right: FloatArray
    joint: NDArray[np.int64]
    block: NDArray[np.int64]
    waves: FloatArray

    def with_centre(self, centre: FloatArray) -> Equations:
        """The same where the payload's mass sits at ``centre`` [m]: its other parameters are how it differs from a point there."""
        payload = self.payload.copy()
        payload[:, 0] = self.payload @ point_mass(centre)
        return replace(self, payload=payload)


def equations(robot: Robot, motion: Motion, joints: Sequence[str]) -> Equations:
    """What one motion says, one row per window and moving joint.

    Raises:
        RecordingError: It is too short, or too fast for its rate.
    """
    times_s, position, current = _evenly(motion)
    period_s = float(times_s[1] - times_s[0])
    velocity = np.gradient(position, period_s, axis=0)
    model = robot.model.lock(list(joints), motion.held, robot.gravity)
    columns = [motion.joints.index(name) for name in model.joint_names]
    position, velocity, current = position[:, columns], velocity[:, columns], current[:, columns]
    count = len(columns)
    width = round(WINDOW_S / period_s)
    windows = Windows.over(len(times_s), width, max(1, round(HOP_SHARE * width)))
    regressor = torque_regressor(model, position, velocity, windows, period_s)
    body, body_from_payload = model.frames[robot.payload_frame]
    if body < 0:
        raise RecordingError(f"{motion.name}: {robot.payload_frame} does not move with any joint of {robot.name}")
    payload = regressor[:, :, body] @ moved_to_body(body_from_payload)
    torque = current * np.array([robot.drive_trains[name].torque_constant.value for name in model.joint_names])
    direction = np.tanh(velocity / SLOW_RAD_S)
    rotor = windows.derivative(velocity, period_s)
    mean = {
        "torque": windows.mean(torque),
        "viscous": windows.mean(velocity),
        "coulomb": windows.mean(direction),
    }
    slow = windows.mean((np.abs(velocity) < SLOW_RAD_S).astype(np.float64)) > 0.5
    counts = ~slow & np.isin(model.joint_names, motion.moved)[None, :]
    counts &= ~across_gaps(motion, times_s, windows, width)[:, None]
    rows, joint = np.nonzero(counts)
    if not len(rows):
        raise RecordingError(f"{motion.name}: no joint moves for long enough without a pause or a gap")
    own = np.eye(count)[joint]
    middle_s = times_s[windows.starts[rows]] + 0.5 * WINDOW_S
    return Equations(
        arm=regressor[rows, joint].reshape(len(rows), count * PARAMETERS),
        payload=payload[rows, joint],
        rotor=own * rotor[rows, joint, None],
        direction=mean["coulomb"][rows, joint],
        friction=np.hstack(
            [own * mean["viscous"][rows, joint, None], own * mean["coulomb"][rows, joint, None], own]
        ),
        right=mean["torque"][rows, joint],
        joint=joint,
        block=(middle_s / BLOCK_S).astype(np.int64),
        waves=np.hstack([own * wave[rows, joint, None] for wave in waves(windows, direction, position)]),
    )  # fmt: skip


def waves(windows: Windows, direction: FloatArray, position: FloatArray) -> tuple[FloatArray, ...]:
    """Mean of ``direction`` times sine and cosine of the angle, and of twice the angle, each of shape (windows, n).

    Args:
        windows: W of them.
        direction: Of motion, -1 to 1, shape (T, n).
        position: [rad or m], shape (T, n).
    """
    return tuple(windows.mean(direction * wave(times * position)) for times in (1.0, 2.0) for wave in (np.sin, np.cos))


def _evenly(motion: Motion) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Equally spaced times [s], smoothed positions and currents, shapes (T,), (T, J), (T, J)."""
    period_s = float(np.median(np.diff(motion.times_s)))
    times_s = np.arange(motion.times_s[0], motion.times_s[-1] + 0.5 * period_s, period_s)
    position = np.column_stack([np.interp(times_s, motion.times_s, column) for column in motion.position.T])
    current = np.column_stack([np.interp(times_s, motion.times_s, column) for column in motion.current_A.T])
    b, a = butter(2, min(2.0 * BANDWIDTH_HZ * period_s, 0.9))
    if len(times_s) <= 3 * max(len(a), len(b)):
        raise RecordingError(f"{motion.name}: {len(times_s)} samples are too few for a motion")
    return times_s, filtfilt(b, a, position, axis=0), current


def across_gaps(motion: Motion, times_s: FloatArray, windows: Windows, width: int) -> NDArray[np.bool_]:
    """Which windows of ``width`` evenly spaced samples span a gap in the recording, and know nothing of what happened there."""
    gaps = np.flatnonzero(np.diff(motion.times_s) > LONGEST_GAP_S)
    first, last = times_s[windows.starts], times_s[windows.starts + width - 1]
    crossed = np.zeros(len(windows.starts), dtype=bool)
    for gap in gaps:
        crossed |= (first < motion.times_s[gap + 1]) & (last > motion.times_s[gap])
    return crossed


def moved_to_body(body_from_payload: FloatArray) -> FloatArray:
    """The body's parameters per unit of the payload's, which count in the payload's own frame, shape (10, 10)."""
    turned = (body_from_payload @ pseudo_inertia(unit) @ body_from_payload.T for unit in np.eye(PARAMETERS))
    return np.column_stack([body_parameters(pseudo) for pseudo in turned])


STRETCHES, UNDETERMINED, CONSTANTS = (
    "what differs from stretch to stretch",
    "what the motion does not determine",
    "torque constants",
)


@dataclass(frozen=True)
class MotionFit:
    """The solution, and what it rests on.

    Attributes:
        joints: That moved or could, in the order of the arrays by joint.
        terms: Of the regression, P of them: the payload's ten first.
        values: Shape (P,).
        covariance: From the jackknife, the priors and the torque constants together, shape (P, P); where a calibration was used,
            that of the payload, of shape (10, 10).
        parts: What puts how much standard deviation on the mass [kg], by name.
        blocks: Number of stretches of the motions with the payload.
        residual, empty_residual: rms of the windows' mean torque that is left over, with the payload and without [N m], shape (n,).
        driven: rms of the mean torque itself [N m], shape (n,).
        quantile: Half width of a 95 % interval in standard deviations: Student's, by the number of stretches.
        halves: Mass and its standard deviation from the first and from the second half [kg]; None where they are too short.
        arm_kg: Mass of all that moves of the arm.
        arm_over_urdf: By how much the torques of the arm's own bodies are those that its URDF says.
        payload_prior: Standard deviations of the payload's ten parameters under their prior, shape (10,).
        torque_ratio, torque_ratio_std: Torques of the motions with the payload over what arm and payload need, by the empty motions
            or by the calibration, shape (n,): 1 unless units or torque constants differ.
    """

    joints: tuple[str, ...]
    terms: tuple[Term, ...]
    values: FloatArray
    covariance: FloatArray
    parts: Mapping[str, float]
    blocks: int
    residual: FloatArray
    empty_residual: FloatArray
    driven: FloatArray
    quantile: float
    halves: tuple[tuple[float, float], tuple[float, float]] | None
    arm_kg: float
    arm_over_urdf: float
    payload_prior: FloatArray
    torque_ratio: FloatArray
    torque_ratio_std: FloatArray

    @property
    def std(self) -> FloatArray:
        """Standard deviation of every unknown, shape (P,)."""
        return np.sqrt(np.diag(self.covariance))

    def budget(self) -> tuple[tuple[str, float], ...]:
        """What puts how much standard deviation on the mass [kg], the most first."""
        return tuple(sorted(self.parts.items(), key=lambda part: -part[1]))

    def unseen(self) -> tuple[str, ...]:
        """Of the payload's ten parameters, those that the motion says less about than what any load of that mass may have."""
        return tuple(
            term.kind
            for term, std, prior in zip(self.terms, self.std[:PARAMETERS], self.payload_prior, strict=False)
            if std > 0.5 * prior
        )

    def pulls(self) -> FloatArray:
        """How far each unknown lies from its prior, in standard deviations of the prior, shape (P,)."""
        return np.array([(v - term.prior) / term.std for v, term in zip(self.values, self.terms, strict=True)])


def arm_kg(model: ReducedModel) -> float:
    """Mass of all that moves."""
    return float(model.pseudo_inertia[:, 3, 3].sum())


def reach_m(robot: Robot, model: ReducedModel) -> float:
    """From the base to the hand along the links."""
    links = sum(np.linalg.norm(place[:3, 3]) for place in model.placement)
    return float(links + np.linalg.norm(model.frames[robot.payload_frame][1][:3, 3]))


def terms_of(robot: Robot, joints: Sequence[str], held: dict[str, float], runs: int) -> tuple[Term, ...]:
    """All unknowns: payload, bodies, rotors, torque constants, load friction, and friction of each motion."""
    model = robot.model.lock(list(joints), held, robot.gravity)
    bodies = [body_parameters(pseudo) for pseudo in model.pseudo_inertia]
    total, reach = arm_kg(model), reach_m(robot, model)
    names = [f"payload_{name}" for name in PARAMETER_NAMES]
    open_to = sizes(total, 0.3 * reach)
    terms = [Term(name, "", unit, 0.0, std) for name, unit, std in zip(names, PARAMETER_UNITS, open_to, strict=True)]
    for name, place, body in zip(model.joint_names, [*model.placement[1:], None], bodies, strict=True):
        length = max(0.1 * reach, 0.0 if place is None else float(np.linalg.norm(place[:3, 3])))
        stds = sizes(LINK_SHARE * float(body[0]) + ARM_SHARE * total, length)
        for kind, unit, value, std in zip(PARAMETER_NAMES, PARAMETER_UNITS, body, stds, strict=True):
            terms.append(Term(f"body_{kind}", name, unit, float(value), std))
    drives = [robot.drive_trains[name] for name in model.joint_names]
    effort = float(total * 9.81 * reach)
    for name, drive in zip(model.joint_names, drives, strict=True):
        std = max(drive.armature.std, 0.5 * abs(drive.armature.value), 1e-3 * total * reach**2)
        terms.append(Term("armature", name, "kg m^2", drive.armature.value, std))
    for name, drive in zip(model.joint_names, drives, strict=True):
        std = max(drive.load_friction.std, LEAST_LOAD_FRICTION_STD)
        terms.append(Term("load_friction", name, "1", drive.load_friction.value, std))
    for run in range(runs):
        for kind, unit in (("viscous", "N m s/rad"), ("coulomb", "N m"), ("offset", "N m")):
            terms += [Term(kind, f"{name}, motion {run + 1}", unit, 0.0, effort) for name in model.joint_names]
    return tuple(terms)


PARAMETER_NAMES = (
    "mass",
    *(f"moment_{a}" for a in "xyz"),
    *(f"inertia_{a}" for a in ("xx", "xy", "xz", "yy", "yz", "zz")),
)
PARAMETER_UNITS = ("kg", *["kg m"] * 3, *["kg m^2"] * 6)


def sizes(mass_kg: float, length_m: float) -> list[float]:
    """Standard deviations of a body's parameters from those of its mass, and its size."""
    return [mass_kg, *[mass_kg * length_m] * 3, *[mass_kg * length_m**2] * 6]


@dataclass(frozen=True)
class Stacked:
    """Equations of all runs; unknowns are the payload's ten, the arm's 12 n (17 n for calibrations), and 3 n of each run.

    Attributes:
        matrix: Shape (E, U); columns of gears and torque constants are filled while it is solved.
        right, joint, block, direction: Of each equation, see `Equations`; blocks are labelled apart from run to run.
        run: Number of the run.
    """

    matrix: FloatArray
    right: FloatArray
    joint: NDArray[np.int64]
    block: NDArray[np.int64]
    direction: FloatArray
    run: NDArray[np.int64]
    count: int

    def only(self, kept: NDArray[np.bool_]) -> Stacked:
        """Some of its equations."""
        return Stacked(
            self.matrix[kept], self.right[kept], self.joint[kept], self.block[kept], self.direction[kept], self.run[kept],
            self.count,
        )  # fmt: skip

    @classmethod
    def of(cls, parts: Sequence[Equations], loaded: int, count: int) -> Stacked:
        """The first ``loaded`` runs hold the payload."""
        rows = []
        for number, part in enumerate(parts):
            friction = [np.zeros_like(part.friction) for _ in parts]
            friction[number] = part.friction
            payload = part.payload if number < loaded else np.zeros_like(part.payload)
            rows.append(np.hstack([payload, part.arm, part.rotor, np.zeros((len(part.right), count)), *friction]))
        return cls(
            np.vstack(rows),
            np.concatenate([part.right for part in parts]),
            np.concatenate([part.joint for part in parts]),
            np.concatenate([part.block + RUNS_OF_ITS_OWN * number for number, part in enumerate(parts)]),
            np.concatenate([part.direction for part in parts]),
            np.concatenate([np.full(len(part.right), number) for number, part in enumerate(parts)]),
            count,
        )


def fit_motions(
    robot: Robot,
    loaded: Sequence[Motion],
    empty: Sequence[Motion],
    *,
    centre: tuple[FloatArray, FloatArray] | None = None,
) -> MotionFit:
    """Fit arm, friction and payload to motions with and without it.

    Args:
        robot: The arm as its file states it.
        loaded: With the payload, at least one.
        empty: With an empty hand, at least one.
        centre: The payload's centre of mass in its frame and the standard deviation of each coordinate [m], where that is
            stated; else it may be anywhere within a third of the arm's reach.

    Raises:
        RecordingError: A motion is of no use, or all together are too short.
    """
    motions = [*loaded, *empty]
    joints = motions[0].joints
    held = dict(motions[0].held)
    parts = [equations(robot, motion, joints) for motion in motions]
    if centre is not None:
        parts = [part.with_centre(centre[0]) for part in parts]
    terms = terms_of(robot, joints, held, len(motions))
    model = robot.model.lock(list(joints), held, robot.gravity)
    count = len(model.joint_names)
    stacked = Stacked.of(parts, len(loaded), count)
    matrix, right, joint, run, block = stacked.matrix, stacked.right, stacked.joint, stacked.run, stacked.block
    with_payload = int(np.sum(np.unique(block) < RUNS_OF_ITS_OWN * len(loaded)))
    if with_payload < MIN_BLOCKS:
        raise RecordingError(
            f"{loaded[0].name}: only {BLOCK_S * with_payload:.0f} s of motion can be used; record {BLOCK_S * MIN_BLOCKS:.0f} s "
            "at least, better 15, with all joints moving"
        )
    prior, spread = np.array([t.prior for t in terms]), np.array([t.std for t in terms])

    bodies = PARAMETERS * (1 + count)
    geared = slice(bodies + count, bodies + 2 * count)
    weight = np.ones(len(right))
    length_m = float(spread[1] / spread[0])
    # gears lose part of what they transmit: take the last solution's, since the measured torque holds the friction itself
    for _ in range(ITERATIONS):
        scaled, target = matrix * weight[:, None], right * weight
        normal, side = scaled.T @ scaled, scaled.T @ target
        values = _solve(normal, side, prior, spread)
        residual = right - matrix @ values
        for number in range(count):
            mine = joint == number
            if mine.any():
                weight[mine] = 1.0 / max(float(np.std(residual[mine])), 1e-9)
        # something light has little first moment and inertia, wherever in the hand it sits
        inverse = np.linalg.inv(normal + np.diag(spread**-2.0))
        heavy_kg = abs(values[0]) + np.sqrt(inverse[0, 0])
        spread[1:PARAMETERS] = sizes(heavy_kg, length_m)[1:]
        if centre is not None:
            spread[1:4] = heavy_kg * np.maximum(centre[1], 1e-3)
        transmitted = np.abs(matrix[:, :bodies] @ values[:bodies])
        matrix[:, geared] = np.eye(count)[joint] * (transmitted * stacked.direction)[:, None]
    scaled, target = matrix * weight[:, None], right * weight
    values, jackknife = _jackknife(scaled, target, block, prior, spread)
    residual = right - matrix @ values
    # what the priors leave open, and what the torque constants do: makers' numbers err together, so their errors add up
    inverse = np.linalg.inv(scaled.T @ scaled + np.diag(spread**-2.0))
    arm_over_urdf = _arm_over_urdf(matrix, values, prior, count)
    scale = np.array([relative_torque_std(robot, name) for name in model.joint_names])
    if abs(arm_over_urdf - 1.0) > URDF_SHARE:
        scale = np.hypot(scale, arm_over_urdf - 1.0)
    by_scale = inverse @ (scaled.T @ (target * scale[joint]))
    by_prior = inverse @ np.diag(spread**-2.0) @ inverse
    covariance = jackknife + by_prior + np.outer(by_scale, by_scale)

    halves = None
    carrying = run < len(loaded)
    middle = [np.median(block[run == number]) for number in range(len(loaded))]
    # one column more for each joint: what it needs in the motions with the payload, which may be there more or less than once
    needed = np.eye(count)[joint] * (carrying * (scaled @ values))[:, None]
    more, varies = _jackknife(
        np.hstack([scaled, needed]), target, block, np.append(prior, np.zeros(count)), np.append(spread, np.ones(count))
    )
    late = np.zeros(len(right), dtype=bool)
    for number, at in enumerate(middle):
        late |= (run == number) & (block > at)
    if with_payload >= 2 * MIN_BLOCKS:
        # each against the whole of the empty runs
        first, second = (
            _mass_and_std(*_jackknife(scaled[kept], target[kept], block[kept], prior, spread))
            for kept in (~late, late | ~carrying)
        )
        halves = (first, second)
    return MotionFit(
        model.joint_names,
        terms,
        values,
        covariance,
        {
            STRETCHES: float(np.sqrt(jackknife[0, 0])),
            UNDETERMINED: float(np.sqrt(by_prior[0, 0])),
            CONSTANTS: float(abs(by_scale[0])),
        },
        with_payload,
        rms_by_joint(residual[carrying], joint[carrying], count),
        rms_by_joint(residual[~carrying], joint[~carrying], count),
        rms_by_joint(right[carrying], joint[carrying], count),
        float(student.ppf(0.975, with_payload - 1)),
        halves,
        arm_kg(model),
        arm_over_urdf,
        spread[:PARAMETERS].copy(),
        1.0 + more[-count:],
        np.sqrt(np.diag(varies)[-count:]),
    )


def _arm_over_urdf(matrix: FloatArray, values: FloatArray, prior: FloatArray, count: int) -> float:
    bodies = slice(PARAMETERS, PARAMETERS * (1 + count))
    fitted, stated = matrix[:, bodies] @ values[bodies], matrix[:, bodies] @ prior[bodies]
    return float(fitted @ stated / (stated @ stated))


def relative_torque_std(robot: Robot, joint: str) -> float:
    """How well a joint's torque constant is known, relative to it; no file knows it exactly."""
    drive = robot.drive_trains[joint]
    constant = drive.torque_constant
    least = LEAST_TORQUE_STD if drive.driven_by is None else VOLTAGE_TORQUE_STD
    return max(constant.std / abs(constant.value), least)


def _solve(normal: FloatArray, side: FloatArray, prior: FloatArray, spread: FloatArray) -> FloatArray:
    """The posterior mean; columns are scaled by their priors, since they differ by ten orders of magnitude."""
    scaled = normal * spread[:, None] * spread[None, :] + np.eye(len(prior))
    return spread * np.linalg.solve(scaled, spread * side + prior / spread)


def _jackknife(
    scaled: FloatArray, target: FloatArray, block: NDArray[np.int64], prior: FloatArray, spread: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The solution, shape (P,), and how it varies when each stretch is left out in turn, as a covariance, shape (P, P)."""
    normal, side = scaled.T @ scaled, scaled.T @ target
    values = _solve(normal, side, prior, spread)
    labels = np.unique(block)
    moved = np.zeros((len(labels), len(values)))
    for row, label in enumerate(labels):
        out = scaled[block == label]
        left = side - out.T @ target[block == label]
        moved[row] = _solve(normal - out.T @ out, left, prior, spread) - values
    return values, (len(labels) - 1) / len(labels) * moved.T @ moved


def _mass_and_std(values: FloatArray, covariance: FloatArray) -> tuple[float, float]:
    return float(values[0]), float(np.sqrt(covariance[0, 0]))


def rms_by_joint(values: FloatArray, joint: NDArray[np.int64], count: int) -> FloatArray:
    """Of each joint, shape (count,); NaN of those without a value."""
    return np.array([np.sqrt(np.mean(values[joint == n] ** 2)) if (joint == n).any() else np.nan for n in range(count)])
