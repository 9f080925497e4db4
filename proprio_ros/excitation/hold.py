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

from proprio_ros.excitation.delay import Delay, Nudge
from proprio_ros.robot import Robot
from proprio_ros.robot.geometry import FloatArray
from proprio_ros.robot.kinematics import zero_pose
from proprio_ros.robot.loads import Loads

FILTER_S = 0.01  # time constant of velocities, which are differences of coarse positions
PERIODS_PER_RAD = 0.1
"""Frequency x period of the joint states at most: more swings, with a sample of delay and another in the filter."""
# between joint states: what loses a joint within a second after it is said to come from it
PAUSE_S = 0.03
SLOWEST_HZ = 80.0  # joint states that come less often cannot hold an arm
# the spring pulls no more than from here: an arm that was moved by hand comes back slowly
FARTHEST_RAD = 0.15
CORRECTING_SHARE = 0.85
"""Of what may be commanded, spring and damper use no more: a pause in mid-braking leaves it on, and throws the joint
back. With 0.6 a shoulder with 150 g in the hand ran on for 0.9 rad after a push, with this for 0.28."""
LOST_RAD, BRAKED_RAD, BRAKED_S = 0.5, 1.2, 1.0
"""A joint that is so far from its goal is not held any more: sign or unit are wrong, or the load is too heavy. One that was pushed
until a second ago may have run on where whoever takes commands has stalled, and is caught rather than let go; a hold that is softer
than stated needs longer to bring it back."""
USUAL_ROTOR = 1.0 / 3.0
"""Of the spread that holds where no file states a rotor. Held for one three times as heavy as it was, a wrist swung up."""
# nothing is summed up of a joint that stands so near to its goal: friction would have it hunt
SLACK_RAD = 0.004
DEAD_RAD, DEAD_RAD_S = 0.0015, 0.12
"""Off by so little is not off: an encoder's noise would shake a joint that stands, and what shakes creeps in spite of friction."""
SETTLING_S = 0.6
"""Loads are summed up for so long after the goals have come to rest, and then no more: a joint must be still before a push."""
# what a spring gives in the mean over this time, where a joint stands, belongs to what holds it
LEANING_S = 0.05
ASTRAY_RAD = 0.03  # unless a joint is so far off: something else hangs at it
DELAYS_PER_RAD, FILTER_AND_SAMPLE_S = 0.4, 0.01
"""Frequency x delay at most, with what filter and sample add: with 73 ms, 5 rad/s hold a kilogram at 0.6 m."""
# time constant of what is summed up, beside 1 / frequency, and altogether
LOAD_S = 0.05
LONGEST_LOAD_S = 1.0
HAND_S = 0.3  # the same of what hangs at all joints as something in the hand would
# of what may be commanded, no more is summed up: a command that came late looks like a load
UNKNOWN_SHARE = 0.2
HARDEST_RAD_S2, HARDEST_PER_S = 20.0, 16.0
"""Spring and damper ask for no more than the larger of this acceleration and of this times the speed that is to be taken away:
who takes commands may stall for 0.2 s in mid-braking, and keep the last one."""
NUDGE_SHARE = 0.3  # of what may be commanded
# the same, against a push that ends where nobody looks on; friction is more than that
STOPPING_SHARE = 0.01
MOVED_RAD = 0.005  # gravity and inertia are computed anew when a joint has moved by so much
GAP_S = 0.1  # after a longer pause the last velocity says nothing, of a joint or of a goal
REMEMBERED_S = 1.0
"""Pauses between joint states make the hold softer for so long: an effort stays until the next, and a stiff one would overshoot."""
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


class Hold:
    """One arm's joints, those of them that are held here, their goals and the efforts towards them.

    Attributes:
        largest: By joint, what may be commanded [N m or N].
        delay: Of efforts.
        held_kg: What hangs in the hand, as far as that is known.
        lost: Why the joints are not held any more; empty while they are.
    """

    def __init__(
        self,
        robot: Robot,
        joints: Sequence[str],
        gains: HoldGains | None = None,
    ) -> None:
        self.joints = tuple(joints)
        self.gains = gains or HoldGains()
        self.largest = {
            name: abs(
                robot.motors[name].current_limit_A
                * robot.drive_trains[name].nominal_effort_per_current
            )
            for name in self.joints
        }
        self._loads = Loads(robot)
        self._per_rad = {name: abs(robot.drive_trains[name].transmission) for name in self.joints}
        # a rotor that nobody stated is as heavy as most are: its inertia is most of a wrist's, and makes its spring
        self._rotor = {
            name: (drive.armature.value or USUAL_ROTOR * drive.armature.std) / drive.transmission**2
            for name, drive in robot.drive_trains.items()
        }
        self._friction = {name: drive.coulomb.value for name, drive in robot.drive_trains.items()}
        self._pose = zero_pose(robot)
        self._time_s: dict[str, float] = {}
        self._period_s = self._pauses_s = self._squares_s2 = 0.0
        self._heard_s: float | None = None
        self._position: dict[str, float] = {}
        self._velocity = dict.fromkeys(self.joints, 0.0)
        self._goal: dict[str, float] = {}
        self._goal_time_s: float | None = None
        self._goal_velocity = dict.fromkeys(self.joints, 0.0)
        self._sum = dict.fromkeys(self.joints, 0.0)
        # what springs give where joints stand off their goals
        self._leaning = dict.fromkeys(self.joints, 0.0)
        self._loads_at: dict[str, float] | None = None
        self._gravity: dict[str, float] = {}
        self._inertia: dict[str, float] = {}
        self._reactions: dict[str, dict[str, tuple[float, float]]] = {}
        self._moved_s = 0.0  # when a goal last changed
        self.lost = ""
        self._paused = (0.0, -math.inf)  # the longest pause of late, and when it ended
        self.delay, self._nudge = Delay(len(self.joints)), Nudge()
        self._mass: FloatArray = np.eye(len(self.joints))  # inertias of all joints together
        self._inverse: FloatArray = self._mass
        self._pushed: dict[str, float] = {}
        self._pushed_s: dict[str, float] = {}  # when a joint was last
        self.held_kg = 0.0
        self._per_kg: dict[str, float] = {}

    @property
    def rate_hz(self) -> float:
        """Of the joint states; 0 before there are some."""
        return 1.0 / self._period_s if self._period_s > 0.0 else 0.0

    @property
    def _now_s(self) -> float:
        """Of the latest reading; 0 before there is one."""
        return max(self._time_s.values(), default=0.0)

    @property
    def frequency_rad_s(self) -> float:
        """How stiff it is now: as stated, and less where joint states come slowly or efforts late."""
        slow_s = max(self._period_s, self.wait_s)
        frequency = (
            min(self.gains.frequency_rad_s, PERIODS_PER_RAD / slow_s) if slow_s > 0.0 else 0.0
        )
        return min(frequency, DELAYS_PER_RAD / (self.delay.assumed_s + FILTER_AND_SAMPLE_S))

    @property
    def nudging(self) -> bool:
        """Whether the arm is being asked for its delay."""
        return self.delay.delay_s is None and not self._nudge.over

    @property
    def wait_s(self) -> float:
        """Between joint states of late as they were heard, as an instant sees it: long pauses count as much as they last [s]."""
        return self._squares_s2 / self._pauses_s if self._pauses_s > 0.0 else 0.0

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
        now_s = time_s if heard_s is None else heard_s
        # in a longer one nothing but `steady` is commanded, and after it a firm hold is needed at once
        gap_s = 0.0 if self._heard_s is None else max(now_s - self._heard_s, 0.0)
        if gap_s > PAUSE_S and (gap_s > self._paused[0] or now_s - self._paused[1] > REMEMBERED_S):
            self._paused = gap_s, now_s
        pause_s = min(gap_s, GAP_S)
        self._heard_s = now_s
        kept = math.exp(-pause_s / REMEMBERED_S)
        self._pauses_s = kept * self._pauses_s + pause_s
        self._squares_s2 = kept * self._squares_s2 + pause_s**2
        for name, value in position.items():
            if not math.isfinite(value) or name not in self._pose:
                continue
            if name not in self._per_rad:
                self._pose[name] = value
                continue
            before_s = self._time_s.get(name, time_s)
            before = self._position.get(name, value)
            step_s = time_s - before_s
            if name in self._position and step_s == 0.0:
                continue
            self._time_s[name], self._position[name], self._pose[name] = time_s, value, value
            if abs(value - before) > self.gains.jump_rad * self._per_rad[name]:
                # the arm is where it was: only what it reads has changed
                self._velocity[name] = 0.0
                self.delay.slipped()
                if name in self._goal:
                    self._goal[name] += value - before
            elif not 0.0 < step_s <= GAP_S:
                self._velocity[name] = 0.0
            else:
                self._velocity[name] += _share(step_s) * (
                    (value - before) / step_s - self._velocity[name]
                )
                self._period_s += (step_s - self._period_s) * (
                    0.01 if self._period_s > 0.0 else 1.0
                )
        if self.knows and time_s - self.delay.last_s < GAP_S:
            self._sum_up(time_s)

    def _sum_up(self, time_s: float) -> None:
        """What efforts leave unexplained, of joints that move or are off their goals; one that stands may lean on its friction."""
        self._update_loads()
        told = self.delay.observe(
            time_s, [self._position[name] for name in self.joints], self._mass
        )
        if told is None:
            return
        resting = time_s - self._moved_s >= SETTLING_S or self._pushed
        time_constant_s = min(LOAD_S + 1.0 / max(self.frequency_rad_s, 1e-3), LONGEST_LOAD_S)
        for name, inertial, effort in zip(self.joints, *np.array(told).tolist(), strict=True):
            per_rad = self._per_rad[name]
            far = (
                abs(self._goal[name] - self._position[name])
                > (ASTRAY_RAD if resting else SLACK_RAD) * per_rad
            )
            # else a reaction, which passes
            moves = abs(self._velocity[name]) > DEAD_RAD_S * per_rad and not self._pushed
            if name in self._pushed or not (far or moves):
                continue
            most = UNKNOWN_SHARE * self.largest[name]
            missing = max(-most, min(most, effort - inertial))
            self._sum[name] += min(self._period_s / time_constant_s, 1.0) * (
                missing - self._sum[name]
            )
        if not self._pushed:
            self._weigh()

    def _weigh(self) -> None:
        """What hangs at all joints as something in the hand would, hangs in the hand, and pulls otherwise in another pose."""
        # friction, and with it what is not known, grows with what a joint can
        weights = {name: self._per_kg[name] / self.largest[name] ** 2 for name in self.joints}
        squares = sum(weight * self._per_kg[name] for name, weight in weights.items())
        if squares <= 0.0:
            return
        whole_kg = (
            self.held_kg
            + sum(weight * self._sum[name] for name, weight in weights.items()) / squares
        )
        most_kg = min(
            self.largest[name] / max(abs(self._per_kg[name]), 1e-9) for name in self.joints
        )
        more_kg = min(self._period_s / HAND_S, 1.0) * (
            max(0.0, min(whole_kg, most_kg)) - self.held_kg
        )
        self.held_kg += more_kg
        for name in self.joints:
            self._sum[name] -= self._per_kg[name] * more_kg
            self._gravity[name] += self._per_kg[name] * more_kg

    def aim(self, goal: Mapping[str, float]) -> None:
        """Hold joints there from now on [rad or m]; goals that move from call to call are followed with their velocity."""
        now_s = self._now_s
        step_s = 0.0 if self._goal_time_s is None else now_s - self._goal_time_s
        if (
            self._goal_time_s is not None
            and step_s == 0.0
            and all(self._goal.get(n) == q for n, q in goal.items())
        ):
            return
        self._goal_time_s = now_s
        for name in self.joints:
            before = self._goal.get(name)
            after = goal.get(name)
            if after is None or not math.isfinite(after):
                continue
            self._goal[name] = after
            if after != before:
                self._moved_s = now_s
            fastest = self.gains.max_velocity_rad_s * self._per_rad[name]
            if (
                before is None
                or not 0.0 < step_s <= GAP_S
                or abs(after - before) > fastest * step_s
            ):
                self._goal_velocity[name] = 0.0  # another goal, and not one that moves
            else:
                self._goal_velocity[name] += _share(step_s) * (
                    (after - before) / step_s - self._goal_velocity[name]
                )

    def here(self) -> None:
        """Hold all joints where they are."""
        self.aim(self._position)

    def begin(self) -> None:
        """Hold all joints where they are, with nothing summed up from before."""
        self.lost = ""
        self._sum, self._leaning = dict.fromkeys(self.joints, 0.0), dict.fromkeys(self.joints, 0.0)
        self.held_kg, self._loads_at = 0.0, None
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
        frequency = self.frequency_rad_s
        self._pushed = dict(pushed)
        ahead = self._ahead()
        efforts = {}
        reaction = self._reaction(pushed)
        # nobody moves them any more
        if self._goal_time_s is not None and now_s - self._goal_time_s > GAP_S:
            self._goal_velocity = dict.fromkeys(self.joints, 0.0)
        nudged = ""
        nudge = 0.0
        if self.nudging:
            nudged = max(
                self.joints,
                key=lambda name: self._inertia[name] * self._per_rad[name] / self.largest[name],
            )
            nudge = (
                self._nudge.at(now_s, self._position[nudged] / self._per_rad[nudged])
                * self._per_rad[nudged]
            )
        for name in self.joints:
            if name in pushed:
                self._leaning[name] = 0.0
                efforts[name] = self._bounded(name, pushed[name])
                continue
            per_rad = self._per_rad[name]
            inertia = self._inertia[name] + self._rotor[name]
            spring = inertia * frequency**2
            position, velocity = ahead[name]
            off = _beyond(self._goal[name] - position, DEAD_RAD * per_rad)
            bounded_off = math.copysign(min(abs(off), FARTHEST_RAD * per_rad), off)
            slow = _beyond(self._goal_velocity[name] - velocity, DEAD_RAD_S * per_rad)
            correcting = (
                spring * bounded_off + 2.0 * self.gains.damping * frequency * inertia * slow
            )
            hardest = max(HARDEST_RAD_S2 * per_rad, HARDEST_PER_S * abs(slow)) * inertia
            most = min(CORRECTING_SHARE * self.largest[name], hardest)
            steady = self._gravity[name] + self._sum[name] + reaction.get(name, 0.0)
            wanted = steady + max(-most, min(most, correcting))
            if name == nudged:
                jerk = NUDGE_SHARE * self.largest[name]
                wanted += max(-jerk, min(jerk, nudge * inertia))
            efforts[name] = self._bounded(name, wanted)
            if not pushed:
                leaning = max(-most, min(most, spring * bounded_off)) if slow == 0.0 else 0.0
                share = min(self._period_s / LEANING_S, 1.0)
                self._leaning[name] += share * (leaning - self._leaning[name])
        self.sent(efforts)
        return efforts

    def steady(self) -> dict[str, float]:
        """What holds the arm without anybody who looks: gravity, what was summed up, and what springs gave of late [N m or N]."""
        if self.lost:
            return dict.fromkeys(self.joints, 0.0)
        self._update_loads()
        steady = {}
        for name in self.joints:
            summed = self._sum[name]
            # what is summed up may hold its friction: a little against the push, and that stops it
            if name in self._pushed:
                pushing = self._pushed[name] - self._gravity[name] - summed
                summed -= math.copysign(STOPPING_SHARE * self.largest[name], pushing)
            steady[name] = self._bounded(
                name,
                self._gravity[name] + summed + self._leaning[name],
            )
        return steady

    def sent(self, efforts: Mapping[str, float]) -> None:
        """These are commanded [N m or N]; what `efforts` gives is."""
        self.delay.sent(
            self._now_s,
            [efforts[n] - self._gravity[n] for n in self.joints],
        )

    def _ahead(self) -> dict[str, tuple[float, float]]:
        """Where joints will be, and how fast, when what is sent now comes into effect."""
        for_s = self.delay.assumed_s
        still = np.array([self._sum[name] for name in self.joints])
        momentum, integral = self.delay.coming()
        faster = (self._inverse @ (momentum - still * for_s)).tolist()
        farther = (self._inverse @ (integral - 0.5 * still * for_s**2)).tolist()
        return {
            name: (
                self._position[name] + self._velocity[name] * for_s + far,
                self._velocity[name] + fast,
            )
            for name, far, fast in zip(self.joints, farther, faster, strict=True)
        }

    def _reaction(self, pushed: Mapping[str, float]) -> dict[str, float]:
        """What a push does to the other joints, which would give way until springs are bent: by the URDF and known friction."""
        reaction: dict[str, float] = {}
        for name, effort in pushed.items():
            velocity = self._velocity[name]
            moved = abs(velocity) > DEAD_RAD_S * self._per_rad[name]
            free = self._bounded(name, effort) - self._gravity[name] - self._sum[name]
            friction = min(self._friction[name], abs(free))
            free -= math.copysign(friction, velocity if moved else free)
            acceleration = free / (self._inertia[name] + self._rotor[name])
            for other, (by_acceleration, by_speed) in self._reactions.get(name, {}).items():
                reaction[other] = (
                    reaction.get(other, 0.0)
                    + by_acceleration * acceleration
                    + by_speed * velocity**2
                )
        return reaction

    def _look_for_lost(self, pushed: Mapping[str, float], now_s: float) -> None:
        braked_s = BRAKED_S * max(self.gains.frequency_rad_s / max(self.frequency_rad_s, 1e-3), 1.0)
        for name in self.joints:
            if self.lost or name in pushed:
                continue
            off = abs(self._goal[name] - self._position[name]) / self._per_rad[name]
            speed = abs(self._velocity[name]) / self._per_rad[name]
            braked = now_s - self._pushed_s.get(name, -math.inf) < braked_s
            if off > (BRAKED_RAD if braked else LOST_RAD):
                self.lost = f"{name} is {off:.2f} rad from where it should be held"
            elif speed > 1.5 * self.gains.max_velocity_rad_s:
                self.lost = f"{name} moves at {speed:.1f} rad/s though it should be held"
            if self.lost and (self._heard_s or 0.0) - self._paused[1] < REMEMBERED_S:
                self.lost += f", after joint states had paused for {1e3 * self._paused[0]:.0f} ms"

    def _update_loads(self) -> None:
        # where efforts will find them
        pose = {
            name: at + self._velocity.get(name, 0.0) * self.delay.assumed_s
            for name, at in self._pose.items()
        }
        if self._loads_at is None or any(
            abs(value - self._loads_at[name]) > MOVED_RAD * self._per_rad.get(name, 1.0)
            for name, value in pose.items()
        ):
            self._loads_at = pose
            self._gravity, self._inertia, self._reactions, self._per_kg = self._loads.at(
                pose, self.held_kg
            )
            self._mass = np.diag([self._inertia[name] + self._rotor[name] for name in self.joints])
            for column, name in enumerate(self.joints):
                for other, (by_acceleration, _) in self._reactions[name].items():
                    if other in self.joints:
                        self._mass[self.joints.index(other), column] = by_acceleration
            # a joint may have no inertia, by its URDF
            self._inverse = np.asarray(
                np.linalg.pinv(self._mass),
                dtype=np.float64,
            )

    def _bounded(self, name: str, effort: float) -> float:
        return max(
            -self.largest[name],
            min(self.largest[name], effort),
        )


def _share(step_s: float) -> float:
    """Of a new value in the filter of velocities."""
    return 1.0 - math.exp(-step_s / FILTER_S)


def _beyond(value: float, dead: float) -> float:
    """A number's part outside a dead band."""
    return math.copysign(max(abs(value) - dead, 0.0), value)
