"""Holds joints by efforts alone, as an effort controller of somebody else's driver needs it: nobody else holds them there.

The effort is what gravity needs by the URDF, a spring and a damper towards the goal, and what efforts turned out to leave
unexplained (what is in the hand, friction). Spring and damper are those of a mass on a given frequency, with the inertia that the
joint turns; they act on where joints will be when the effort comes into effect, and are softer where that takes long. So the arm is
asked for its delay first. No clock, no ROS.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from proprio_ros.excitation.arrivals import GAP_S, Arrivals
from proprio_ros.excitation.delay import Delay, Nudge
from proprio_ros.robot import Robot
from proprio_ros.robot.geometry import FloatArray
from proprio_ros.robot.kinematics import zero_pose
from proprio_ros.robot.loads import Load, Loads

FILTER_S = 0.01  # time constant of velocities, which are differences of coarse positions
PERIODS_PER_RAD = 0.1
"""Frequency x period of the joint states at most: more swings, with a sample of delay and another in the filter."""
SLOWEST_HZ = 80.0  # joint states that come less often cannot hold an arm
# the spring pulls no more than from here: an arm that was moved by hand comes back slowly
FARTHEST_RAD = 0.15
CORRECTING_SHARE = 0.85
"""Of what may be commanded, spring and damper use no more: a pause in mid-braking leaves it on, and throws the joint
back. With 0.6 a shoulder with 150 g in the hand ran on for 0.9 rad after a push, with this for 0.28."""
LOST_RAD = 0.5
BRAKED_RAD = 1.2
BRAKED_S = 1.0
"""A joint that is so far from its goal is not held any more: sign or unit are wrong, or the load is too heavy. One that was pushed
until a second ago may have run on where whoever takes commands has stalled, and is caught rather than let go; a hold that is softer
than stated needs longer to bring it back."""
USUAL_ROTOR = 1.0 / 3.0
"""Of the spread that holds where no file states a rotor. Held for one three times as heavy as it was, a wrist swung up."""
# nothing is summed up of a joint that stands so near to its goal: friction would have it hunt
SLACK_RAD = 0.004
DEAD_RAD = 0.0015
DEAD_RAD_S = 0.12
"""Off by so little is not off: an encoder's noise would shake a joint that stands, and what shakes creeps in spite of friction."""
SETTLING_S = 0.6
"""Loads are summed up for so long after the goals have come to rest, and then no more: a joint must be still before a push."""
# what a spring gives in the mean over this time, where a joint stands, belongs to what holds it
LEANING_S = 0.05
ASTRAY_RAD = 0.03  # unless a joint is so far off: something else hangs at it
DELAYS_PER_RAD = 0.4
FILTER_AND_SAMPLE_S = 0.01
"""Frequency x delay at most, with what filter and sample add: with 73 ms, 5 rad/s hold a kilogram at 0.6 m."""
# time constant of what is summed up, beside 1 / frequency, and altogether
LOAD_S = 0.05
LONGEST_LOAD_S = 1.0
HAND_S = 0.3  # the same of what fits a weight in the hand at every joint
# of what may be commanded, no more is summed up: a command that came late looks like a load
UNKNOWN_SHARE = 0.2
HARDEST_RAD_S2 = 20.0
HARDEST_PER_S = 16.0
"""Spring and damper ask for no more than the larger of this acceleration and of this times the speed that is to be taken away:
who takes commands may stall for 0.2 s in mid-braking, and keep the last one."""
NUDGE_SHARE = 0.3  # of what may be commanded
# the same, against a push that ends where nobody looks on; friction is more than that
STOPPING_SHARE = 0.01
MOVED_RAD = 0.005  # gravity and inertia are computed anew when a joint has moved by so much
LONGEST_WAIT_S = 0.02
"""No sequence begins while joint states are further apart, as `Hold.wait_s` counts: the hold would be too soft."""


@dataclass(frozen=True)
class HoldGains:
    """How stiff a joint is held."""

    frequency_rad_s: float = 20.0  # of joint and spring; lower where joint states come slowly
    damping: float = 1.0  # of that oscillator; 1 is critical
    # a position that changes by more from sample to sample is an encoder that slipped
    jump_rad: float = 0.3
    max_velocity_rad_s: float = 6.0  # a held joint that is faster is not held any more


@dataclass(frozen=True)
class _Ahead:
    """Where a joint will be when what is sent now comes into effect."""

    position: float  # [rad or m]
    velocity: float  # [rad/s or m/s]


@dataclass(frozen=True)
class _Correction:
    """What takes a joint to its goal [N m or N]."""

    spring: float
    damper: float
    most: float  # that both may ask for
    stands: bool  # whether the joint is as fast as its goal

    @property
    def effort(self) -> float:
        return _clipped(self.spring + self.damper, self.most)


class _Dynamics:
    """Gravity and inertia of an arm near the pose in which they were computed last.

    Attributes:
        load: Efforts and inertias by joint, with what hangs in the hand.
        mass: Inertias of all joints together, shape (J, J) [kg m^2 or kg].
        inverse: Of `mass`; of a joint without inertia, its pseudo-inverse.
    """

    def __init__(self, robot: Robot, joints: Sequence[str]) -> None:
        self.joints = tuple(joints)
        self.load = Load(
            {},
            {},
            {},
            {},
        )
        self.mass: FloatArray = np.eye(len(self.joints))
        self.inverse: FloatArray = self.mass
        self._loads = Loads(robot)
        self._per_rad = _per_rad(robot, joints)
        # a rotor that nobody stated is as heavy as most are: its inertia is most of a wrist's, and makes its spring
        self._rotor = {
            name: (drive.armature.value or USUAL_ROTOR * drive.armature.std) / drive.transmission**2
            for name, drive in robot.drive_trains.items()
        }
        self._at: dict[str, float] | None = None

    def inertia(self, name: str) -> float:
        """What a joint's motor moves, its rotor with it [kg m^2 or kg]."""
        return self.load.inertia[name] + self._rotor[name]

    def forget(self) -> None:
        """Compute all anew at the next `update`."""
        self._at = None

    def update(self, pose: dict[str, float], held_kg: float) -> None:
        """The arm is in a pose [rad or m], with a point mass in its hand [kg]."""
        if self._at is not None and not self._moved(self._at, pose):
            return
        self._at = pose
        self.load = self._loads.at(pose, held_kg)
        self.mass = np.diag([self.inertia(name) for name in self.joints])
        for column, name in enumerate(self.joints):
            for other, (by_acceleration, _) in self.load.reactions[name].items():
                if other in self.joints:
                    self.mass[self.joints.index(other), column] = by_acceleration
        self.inverse = np.asarray(np.linalg.pinv(self.mass), dtype=np.float64)

    def _moved(self, before: Mapping[str, float], pose: Mapping[str, float]) -> bool:
        return any(
            abs(value - before[name]) > MOVED_RAD * self._per_rad.get(name, 1.0)
            for name, value in pose.items()
        )


class Hold:
    """One arm's joints, those of them that are held here, their goals and the efforts towards them.

    Args:
        robot: The arm.
        joints: Those that are held here.
        gains: How stiff they are held.

    Attributes:
        largest: By joint, what may be commanded [N m or N].
        delay: Of efforts.
        held_kg: What hangs in the hand, as far as that is known.
        lost: Why the joints are not held any more; empty while they are.
    """

    def __init__(self, robot: Robot, joints: Sequence[str], gains: HoldGains | None = None) -> None:
        self.joints = tuple(joints)
        self.gains = gains or HoldGains()
        self.largest = {name: _largest(robot, name) for name in self.joints}
        self.delay = Delay(len(self.joints))
        self.held_kg = 0.0
        self.lost = ""
        self._per_rad = _per_rad(robot, joints)
        self._friction = {name: drive.coulomb.value for name, drive in robot.drive_trains.items()}
        self._dynamics = _Dynamics(robot, self.joints)
        self._nudge = Nudge()
        self._arrivals = Arrivals()
        # what was read; of the pose, joints that are not held here, too
        self._pose = zero_pose(robot)
        self._time_s: dict[str, float] = {}
        self._position: dict[str, float] = {}
        self._velocity = dict.fromkeys(self.joints, 0.0)
        # where joints should be
        self._goal: dict[str, float] = {}
        self._goal_time_s: float | None = None
        self._goal_velocity = dict.fromkeys(self.joints, 0.0)
        self._moved_s = 0.0  # when a goal last changed
        # what was summed up, and what springs give where joints stand off their goals [N m or N]
        self._sum = dict.fromkeys(self.joints, 0.0)
        self._leaning = dict.fromkeys(self.joints, 0.0)
        self._pushed: dict[str, float] = {}
        self._pushed_s: dict[str, float] = {}  # when a joint was last

    @property
    def rate_hz(self) -> float:
        """Of the joint states; 0 before there are some."""
        period_s = self._arrivals.period_s
        return 1.0 / period_s if period_s > 0.0 else 0.0

    @property
    def wait_s(self) -> float:
        """Between joint states of late, as `Arrivals.wait_s` counts [s]."""
        return self._arrivals.wait_s

    @property
    def _now_s(self) -> float:
        """Of the latest reading; 0 before there is one."""
        return max(self._time_s.values(), default=0.0)

    @property
    def frequency_rad_s(self) -> float:
        """How stiff it is now: as stated, and less where joint states come slowly or efforts late."""
        slow_s = max(self._arrivals.period_s, self.wait_s)
        frequency = 0.0
        if slow_s > 0.0:
            frequency = min(self.gains.frequency_rad_s, PERIODS_PER_RAD / slow_s)
        return min(frequency, DELAYS_PER_RAD / (self.delay.assumed_s + FILTER_AND_SAMPLE_S))

    @property
    def nudging(self) -> bool:
        """Whether the arm is being asked for its delay."""
        return self.delay.delay_s is None and not self._nudge.over

    @property
    def knows(self) -> bool:
        """Whether every joint was seen."""
        return all(name in self._position for name in self.joints)

    def observe(
        self, time_s: float, position: Mapping[str, float], heard_s: float | None = None
    ) -> None:
        """Take a reading.

        Args:
            time_s: When it was taken, on a clock of its own: readings may come late, but are to be stamped evenly [s].
            position: By joint [rad or m]; what is no number is passed over.
            heard_s: When it came [s]; None: when it was taken.
        """
        self._arrivals.heard(time_s if heard_s is None else heard_s)
        for name, value in position.items():
            if not math.isfinite(value) or name not in self._pose:
                continue
            if name in self._per_rad:
                self._see(name, time_s, value)
            else:
                self._pose[name] = value
        if self.knows and time_s - self.delay.last_s < GAP_S:
            self._sum_up(time_s)

    def _see(self, name: str, time_s: float, value: float) -> None:
        """A reading of a joint that is held here."""
        before = self._position.get(name, value)
        step_s = time_s - self._time_s.get(name, time_s)
        if name in self._position and step_s == 0.0:
            return
        self._time_s[name] = time_s
        self._position[name] = value
        self._pose[name] = value
        if abs(value - before) > self.gains.jump_rad * self._per_rad[name]:
            # the arm is where it was: only what it reads has changed
            self._velocity[name] = 0.0
            self.delay.slipped()
            if name in self._goal:
                self._goal[name] += value - before
        elif not 0.0 < step_s <= GAP_S:
            self._velocity[name] = 0.0
        else:
            change = (value - before) / step_s - self._velocity[name]
            self._velocity[name] += _share(step_s) * change
            self._arrivals.stepped(step_s)

    def _sum_up(self, time_s: float) -> None:
        """What efforts leave unexplained, of joints that move or are off their goals; one that stands may lean on its friction."""
        self._update_loads()
        positions = [self._position[name] for name in self.joints]
        seen = self.delay.observe(
            time_s,
            positions,
            self._dynamics.mass,
        )
        if seen is None:
            return
        inertial, effort = (values.tolist() for values in seen)
        resting = time_s - self._moved_s >= SETTLING_S or bool(self._pushed)
        astray_rad = ASTRAY_RAD if resting else SLACK_RAD
        time_constant_s = min(LOAD_S + 1.0 / max(self.frequency_rad_s, 1e-3), LONGEST_LOAD_S)
        share = min(self._arrivals.period_s / time_constant_s, 1.0)
        for place, name in enumerate(self.joints):
            if name in self._pushed or not self._off_or_moving(name, astray_rad):
                continue
            most = UNKNOWN_SHARE * self.largest[name]
            missing = _clipped(effort[place] - inertial[place], most)
            self._sum[name] += share * (missing - self._sum[name])
        if not self._pushed:
            self._weigh()

    def _off_or_moving(self, name: str, astray_rad: float) -> bool:
        per_rad = self._per_rad[name]
        far = abs(self._goal[name] - self._position[name]) > astray_rad * per_rad
        moves = abs(self._velocity[name]) > DEAD_RAD_S * per_rad
        # beside a push, motion is a reaction, which passes
        return far or (moves and not self._pushed)

    def _weigh(self) -> None:
        """Takes effort that fits a weight in the hand at every joint for one, which pulls otherwise in another pose."""
        per_kg = self._dynamics.load.per_kg
        gravity = self._dynamics.load.gravity
        # friction, and with it what is not known, grows with what a joint can
        weights = {name: per_kg[name] / self.largest[name] ** 2 for name in self.joints}
        squares = sum(weight * per_kg[name] for name, weight in weights.items())
        if squares <= 0.0:
            return
        summed = sum(weight * self._sum[name] for name, weight in weights.items())
        seen_kg = self.held_kg + summed / squares
        most_kg = min(self.largest[name] / max(abs(per_kg[name]), 1e-9) for name in self.joints)
        share = min(self._arrivals.period_s / HAND_S, 1.0)
        more_kg = share * (max(0.0, min(seen_kg, most_kg)) - self.held_kg)
        self.held_kg += more_kg
        for name in self.joints:
            self._sum[name] -= per_kg[name] * more_kg
            gravity[name] += per_kg[name] * more_kg

    def aim(self, goal: Mapping[str, float]) -> None:
        """Hold joints there from now on [rad or m]; goals that move from call to call are followed with their velocity."""
        now_s = self._now_s
        step_s = 0.0
        if self._goal_time_s is not None:
            step_s = now_s - self._goal_time_s
            same = all(self._goal.get(name) == value for name, value in goal.items())
            if step_s == 0.0 and same:
                return
        self._goal_time_s = now_s
        for name in self.joints:
            after = goal.get(name)
            if after is not None and math.isfinite(after):
                self._aim_joint(name, after, step_s)

    def _aim_joint(self, name: str, after: float, step_s: float) -> None:
        before = self._goal.get(name)
        self._goal[name] = after
        if after != before:
            self._moved_s = self._now_s
        farthest = self.gains.max_velocity_rad_s * self._per_rad[name] * step_s
        if before is None or not 0.0 < step_s <= GAP_S or abs(after - before) > farthest:
            self._goal_velocity[name] = 0.0  # another goal, and not one that moves
        else:
            change = (after - before) / step_s - self._goal_velocity[name]
            self._goal_velocity[name] += _share(step_s) * change

    def here(self) -> None:
        """Hold all joints where they are."""
        self.aim(self._position)

    def begin(self) -> None:
        """Hold all joints where they are, with nothing summed up from before."""
        self.lost = ""
        self._sum = dict.fromkeys(self.joints, 0.0)
        self._leaning = dict.fromkeys(self.joints, 0.0)
        self.held_kg = 0.0
        self._dynamics.forget()
        self.here()

    def efforts(self, pushed: Mapping[str, float]) -> dict[str, float]:
        """What to command now, within the motors' limits, beside the efforts of joints that are pushed, and not held [N m or N].

        Zeros once a joint is lost.
        """
        now_s = self._now_s
        self._pushed_s |= dict.fromkeys(pushed, now_s)
        self._look_for_lost(pushed, now_s)
        if self.lost:
            return dict.fromkeys(self.joints, 0.0)
        self._update_loads()
        self._pushed = dict(pushed)
        if self._goal_time_s is not None and now_s - self._goal_time_s > GAP_S:
            # nobody moves the goals any more
            self._goal_velocity = dict.fromkeys(self.joints, 0.0)
        ahead = self._ahead()
        reaction = self._reaction(pushed)
        jerks = self._jerks(now_s)
        efforts = {}
        for name in self.joints:
            if name in pushed:
                self._leaning[name] = 0.0
                efforts[name] = self._bounded(name, pushed[name])
                continue
            correction = self._correction(name, ahead[name])
            steady = self._dynamics.load.gravity[name] + self._sum[name] + reaction.get(name, 0.0)
            wanted = steady + correction.effort
            if name in jerks:
                wanted += jerks[name]
            efforts[name] = self._bounded(name, wanted)
            if not pushed:
                self._lean(name, correction)
        self.sent(efforts)
        return efforts

    def _correction(self, name: str, ahead: _Ahead) -> _Correction:
        """Spring and damper of a mass on a given frequency."""
        per_rad = self._per_rad[name]
        frequency = self.frequency_rad_s
        inertia = self._dynamics.inertia(name)
        off = _beyond(self._goal[name] - ahead.position, DEAD_RAD * per_rad)
        slow = _beyond(self._goal_velocity[name] - ahead.velocity, DEAD_RAD_S * per_rad)
        hardest = max(HARDEST_RAD_S2 * per_rad, HARDEST_PER_S * abs(slow)) * inertia
        return _Correction(
            spring=inertia * frequency**2 * _clipped(off, FARTHEST_RAD * per_rad),
            damper=2.0 * self.gains.damping * frequency * inertia * slow,
            most=min(CORRECTING_SHARE * self.largest[name], hardest),
            stands=slow == 0.0,
        )

    def _lean(self, name: str, correction: _Correction) -> None:
        """Take in what the spring gives where a joint stands."""
        leaning = _clipped(correction.spring, correction.most) if correction.stands else 0.0
        share = min(self._arrivals.period_s / LEANING_S, 1.0)
        self._leaning[name] += share * (leaning - self._leaning[name])

    def _jerks(self, now_s: float) -> dict[str, float]:
        """Efforts that ask the arm for its delay [N m or N]: of the joint with the most inertia for what its motor can."""
        if not self.nudging:
            return {}
        inertia = self._dynamics.load.inertia

        def slow(name: str) -> float:
            return inertia[name] * self._per_rad[name] / self.largest[name]

        nudged = max(self.joints, key=slow)
        per_rad = self._per_rad[nudged]
        acceleration = self._nudge.at(now_s, self._position[nudged] / per_rad) * per_rad
        most = NUDGE_SHARE * self.largest[nudged]
        return {nudged: _clipped(acceleration * self._dynamics.inertia(nudged), most)}

    def steady(self) -> dict[str, float]:
        """What holds the arm without anybody who looks: gravity, what was summed up, and what springs gave of late [N m or N]."""
        if self.lost:
            return dict.fromkeys(self.joints, 0.0)
        self._update_loads()
        steady = {}
        for name in self.joints:
            gravity = self._dynamics.load.gravity[name]
            summed = self._sum[name]
            # what is summed up may hold its friction: a little against the push, and that stops it
            if name in self._pushed:
                pushing = self._pushed[name] - gravity - summed
                summed -= math.copysign(STOPPING_SHARE * self.largest[name], pushing)
            steady[name] = self._bounded(name, gravity + summed + self._leaning[name])
        return steady

    def sent(self, efforts: Mapping[str, float]) -> None:
        """These are commanded [N m or N]; what `efforts` gives is."""
        gravity = self._dynamics.load.gravity
        self.delay.sent(self._now_s, [efforts[name] - gravity[name] for name in self.joints])

    def _ahead(self) -> dict[str, _Ahead]:
        """Where joints will be, and how fast, when what is sent now comes into effect."""
        for_s = self.delay.assumed_s
        still = np.array([self._sum[name] for name in self.joints])  # (J,)
        momentum, integral = self.delay.coming()
        inverse = self._dynamics.inverse
        faster = (inverse @ (momentum - still * for_s)).tolist()
        farther = (inverse @ (integral - 0.5 * still * for_s**2)).tolist()
        return {
            name: _Ahead(
                position=self._position[name] + self._velocity[name] * for_s + far,
                velocity=self._velocity[name] + fast,
            )
            for name, far, fast in zip(self.joints, farther, faster, strict=True)
        }

    def _reaction(self, pushed: Mapping[str, float]) -> dict[str, float]:
        """What a push does to the other joints, which would give way until springs are bent: by the URDF and known friction."""
        load = self._dynamics.load
        reaction: dict[str, float] = {}
        for name, effort in pushed.items():
            velocity = self._velocity[name]
            moved = abs(velocity) > DEAD_RAD_S * self._per_rad[name]
            free = self._bounded(name, effort) - load.gravity[name] - self._sum[name]
            friction = min(self._friction[name], abs(free))
            free -= math.copysign(friction, velocity if moved else free)
            acceleration = free / self._dynamics.inertia(name)
            for other, (by_acceleration, by_speed) in load.reactions.get(name, {}).items():
                before = reaction.get(other, 0.0)
                reaction[other] = before + by_acceleration * acceleration + by_speed * velocity**2
        return reaction

    def _look_for_lost(self, pushed: Mapping[str, float], now_s: float) -> None:
        if self.lost:
            return
        for name in self.joints:
            if name in pushed:
                continue
            self.lost = self._why_lost(name, now_s)
            if not self.lost:
                continue
            paused_s = self._arrivals.paused_s
            if paused_s:
                self.lost += f", after joint states had paused for {1e3 * paused_s:.0f} ms"
            return

    def _why_lost(self, name: str, now_s: float) -> str:
        """Empty where a joint is held."""
        softer = self.gains.frequency_rad_s / max(self.frequency_rad_s, 1e-3)
        braked_s = BRAKED_S * max(softer, 1.0)
        braked = now_s - self._pushed_s.get(name, -math.inf) < braked_s
        off = abs(self._goal[name] - self._position[name]) / self._per_rad[name]
        speed = abs(self._velocity[name]) / self._per_rad[name]
        if off > (BRAKED_RAD if braked else LOST_RAD):
            return f"{name} is {off:.2f} rad from where it should be held"
        if speed > 1.5 * self.gains.max_velocity_rad_s:
            return f"{name} moves at {speed:.1f} rad/s though it should be held"
        return ""

    def _update_loads(self) -> None:
        for_s = self.delay.assumed_s  # where efforts will find them
        pose = {name: at + self._velocity.get(name, 0.0) * for_s for name, at in self._pose.items()}
        self._dynamics.update(pose, self.held_kg)

    def _bounded(self, name: str, effort: float) -> float:
        return _clipped(effort, self.largest[name])


def _largest(robot: Robot, name: str) -> float:
    """What may be commanded of a joint [N m or N]."""
    per_A = robot.drive_trains[name].nominal_effort_per_current
    return abs(robot.motors[name].current_limit_A * per_A)


def _per_rad(robot: Robot, joints: Sequence[str]) -> dict[str, float]:
    """By joint, what an angle at the motor's shaft is in the joint's own unit [1 or m/rad]."""
    return {name: abs(robot.drive_trains[name].transmission) for name in joints}


def _clipped(value: float, most: float) -> float:
    return max(-most, min(most, value))


def _share(step_s: float) -> float:
    """Of a new value in the filter of velocities."""
    return 1.0 - math.exp(-step_s / FILTER_S)


def _beyond(value: float, dead: float) -> float:
    """A number's part outside a dead band."""
    return math.copysign(max(abs(value) - dead, 0.0), value)
