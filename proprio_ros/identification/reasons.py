"""A sentence for the user that carries a code for programs."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class Code:
    """Why something was said, for programs and for whoever has never met it."""

    meaning: str  # in one line
    remedy: str  # what to do about it; the sentence of a reason says it for that recording


CODES = {
    "few_samples": Code(
        "a run has too few usable samples",
        "record the joint for longer, away from its stops; the sentence says what ended the run",
    ),
    "stuck": Code(
        "the joint hardly moved, so friction and not the load decides where it is",
        "push with more current, or from a pose in which gravity helps, so that it moves by 0.3 rad or more",
    ),
    "position_jumps": Code(
        "a joint's reading jumps and stays off, as no body moves",
        "see that its encoder is firm and nobody sets its zero meanwhile, and record again",
    ),
    "left_out_samples": Code(
        "samples at the end of a run were left out",
        "nothing, if enough is left; else push shorter, or start further from the joint's limit",
    ),
    "stood_still": Code(
        "a joint stood still where the answer says that it should have moved",
        "free the joint: see whether it leans on something or its motor sticks, and record again",
    ),
    "short_travel": Code(
        "the joint moved, but less than a trustworthy result needs",
        "push so that the joint moves by 0.3 rad or more; `proprio plan` proposes such pushes",
    ),
    "starts_at_limit": Code(
        "the joint starts at its limit, where the stop may carry part of the weight",
        "start away from the stop",
    ),
    "current_above_limit": Code(
        "more current was commanded than the motor's limit lets flow",
        "push below the limit, or correct current_limit_A in the robot file",
    ),
    "held_joint_moved": Code(
        "a joint that should be held moved",
        "hold the other joints more stiffly while one is pushed",
    ),
    "never_reversed": Code(
        "a joint moved in one direction only, so its friction was never seen reversed",
        "add a run in which the joint moves the other way",
    ),
    "one_run": Code(
        "a calibration rests on one run, which nothing confirms",
        "add runs, of each joint in both directions",
    ),
    "not_separated": Code(
        "torque and friction of a joint cannot be separated, so it stays uncalibrated",
        "add runs that drive the joint the other way",
    ),
    "hand_not_empty": Code(
        "recordings of an empty hand look as if it held something, or lacked a tool",
        "empty the hand, record anew; a tool that stays mounted, hand and fingers belong in the URDF",
    ),
    "runs_differ": Code(
        "a run differs from the others; the interval carries half of that",
        "nothing, if the interval is narrow enough; else hold the object more firmly and record again",
    ),
    "runs_contradict": Code(
        "a run contradicts the others",
        "see that all runs held the same object in the same way, and leave out the one that is named",
    ),
    "unsimulated": Code(
        "no guess could be simulated",
        "check robot file, pose, units and --effort-unit: no mass whatever moves this arm like this",
    ),
    "stamps_off": Code(
        "the joint moved earlier or later than the stamps of its input allow",
        "stamp commands and joint states by one clock, when they are sent and read",
    ),
    "paused": Code(
        "the joint states of a rejected recording paused, as on a computer that is busy elsewhere",
        "keep the computer free while it records, and record again",
    ),
    "uneven": Code(
        "the joint states of a rejected recording came unevenly, as from a computer that is busy elsewhere",
        "keep the computer free while it records, and record again",
    ),
    "drift": Code(
        "the empty hand contradicts the calibration",
        "see that the baseline's hand was empty and nothing touched the arm; if so, calibrate again",
    ),
    "on_bound": Code(
        "the value ended on a bound of the search",
        "check robot, joint and unit of the current; for a delay, stamp commands and joint states by one clock",
    ),
    "misfit": Code(
        "the best simulation does not follow the recording",
        "check the effort's unit and sign, the robot file, and that nothing touched the arm; `proprio check` helps",
    ),
    "coarse_fit": Code(
        "the residuals are coarser than the encoder; the interval is wider for it",
        "nothing, if the interval is narrow enough; else calibrate the robot",
    ),
    "arm_unlike_urdf": Code(
        "by its torques the arm weighs far more or less than its URDF says",
        "put a mounted tool into the URDF; check the effort's unit and sign, torque constants, zeros, payload.com",
    ),
    "other_torque": Code(
        "a joint's torque is larger or smaller than the empty arm's, as in another unit",
        "record both with the same driver, unit and torque constants, on the same arm",
    ),
    "other_zero": Code(
        "a joint's positions are read from elsewhere than the empty arm's, as after its horn was put on anew",
        "put the joint together as it was, or calibrate again; where its URDF's zero is off, correct it there",
    ),
    "leans_on_zero": Code(
        "one pose does not tell a joint's zero from weight; `if_zeros_moved` is the interval for 20 mrad of it",
        "add an empty-hand run of today with --baseline",
    ),
    "misread_joint": Code(
        "a joint's positions or efforts are counted the other way round, or are another joint's",
        "state an effort's sign (--effort-sign); turn positions or names where they are published, or an axis",
    ),
    "lighter_than_empty": Code(
        "the hand seems lighter than it was empty",
        "see that bags are not swapped, and that the baseline's hand was empty",
    ),
    "says_too_little": Code(
        "the motion determines the value too coarsely to state it",
        "move faster, further and longer, through more attitudes of the hand; for a reference take a heavier one",
    ),
    "one_sided": Code(
        "the recording bounds the value on one side at most",
        "squeeze harder, or with several currents; calibrate the gripper",
    ),
    "too_wide": Code(
        "the interval is wider than a stated share of the value; both are given",
        "take the interval as it is, or narrow it: calibrate the robot, with a reference weight, or record more runs",
    ),
    "far_from_prior": Code(
        "an unknown ended further from its prior than a right model takes it",
        "weigh the reference again; check what the robot file says of the unknown that is named",
    ),
    "another_joint": Code(
        "friction, damping or rotor of a joint are not those that its calibration knows, as of another servo or gain",
        "calibrate this servo, on this arm, with its gain and supply as they are; let it warm up as then",
    ),
    "not_covered": Code(
        "the value lies far outside of those that the calibration was made with",
        "see that servo and arm are those that were calibrated; if so, calibrate with a load like this one, too",
    ),
    "starts_disagree": Code(
        "some starts of the search ended elsewhere",
        "nothing, if it is the only reason: the best start was taken",
    ),
    "guessed_facts": Code(
        "facts that decide the answer were not stated; the interval carries a guess of how far off they are",
        "state the fact with --set, such as --set payload.com=[0,0,0.02]",
    ),
    "several_values": Code(
        "more than one value explains the recording",
        "add a run with more travel, or from another pose",
    ),
    "baseline_not_empty": Code(
        "the baseline contradicts what is known about it",
        "record the baseline with nothing in the container, or correct container.mass",
    ),
    "hardly_pressed": Code(
        "the block was hardly pressed",
        "see that the block is between the fingers, check block.size, and squeeze harder",
    ),
    "not_calibrated": Code(
        "what the robot's file leaves open counts as uncertainty",
        "calibrate: `proprio calibrate` with empty-hand runs, with a reference weight if torque is open",
    ),
    "no_empty_motion": Code(
        "a motion of several joints came without one of the empty hand",
        "record about the same motion with an empty hand, and add it with --baseline or to `proprio calibrate`",
    ),
    "torque_scale_open": Code(
        "the scale of the motor's torque is not known well enough to state a mass",
        "calibrate with a reference weight, or state a measured torque constant with its std",
    ),
    "within_friction": Code(
        "the motor's torque lies within friction and says little about the load",
        "move faster and further, so that the motor has to accelerate the load",
    ),
    "changed_midway": Code(
        "the two halves of a recording say different values",
        "record the motions with and without the object apart, or take a part with --span FROM:TO",
    ),
    "changed_along": Code(
        "friction or torque per effort changed along the recording, as while motors warm up",
        "let the arm move for some minutes before it is recorded, so that its motors are warm",
    ),
    "kind_open": Code(
        "the recording does not tell what is in the container",
        "shake the container harder, about as fast as a liquid in it would slosh, and calibrate the robot",
    ),
    "clock_off": Code(
        "by its torques a recording took another time than its stamps say, or its efforts are late",
        "let the recorder stamp each sample by a clock when it is read, not by counting frames, and record again",
    ),
    "other": Code(
        "a reason without a code of its own",
        "read the sentence: it says what to do",
    ),
}
"""Every code. It keeps its meaning; the words of a sentence may change. `docs/pages/refusals.md` is made from these."""


class Reason(str):
    """A sentence, and why it was said.

    Attributes:
        code: One of `CODES`.
        subject: The run or recording that it begins with; empty where it begins with none.
        words: The sentence without its subject.
    """

    code: str
    subject: str
    words: str

    def __new__(cls, code: str, words: str, subject: str = "") -> Reason:
        reason = super().__new__(cls, f"{subject}: {words}" if subject else words)
        reason.code = code
        reason.subject = subject
        reason.words = words
        return reason

    def __getnewargs__(self) -> tuple[str, str, str]:  # type: ignore[override]
        """What copies and pickles are made from."""
        return self.code, self.words, self.subject


def of_run(name: str, sentence: str) -> str:
    """The same reason with the run's name in front."""
    return Reason(getattr(sentence, "code", "other"), sentence, name)


def about(reasons: Iterable[str], name: str) -> list[str]:
    """What is said of a run, without its name; and sentences that name none, as they are."""
    return [
        reason.words if isinstance(reason, Reason) and reason.subject == name else reason
        for reason in reasons
    ]
