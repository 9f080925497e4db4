"""A sentence for the user that carries a code for programs."""

from __future__ import annotations

from collections.abc import Iterable

CODES = {
    "few_samples": "a run has too few usable samples",
    "stuck": "the joint hardly moved, so friction and not the load decides where it is",
    "position_jumps": "a joint's reading jumps and stays off, as no body moves",
    "left_out_samples": "samples at the end of a run were left out",
    "stood_still": "a joint stood still where the answer says that it should have moved",
    "short_travel": "the joint moved, but less than a trustworthy result needs",
    "starts_at_limit": "the joint starts at its limit, where the stop may carry part of the weight",
    "current_above_limit": "more current was commanded than the motor's limit lets flow",
    "held_joint_moved": "a joint that should be held moved",
    "never_reversed": "a joint moved in one direction only, so its friction was never seen reversed",
    "one_run": "a calibration rests on one run, which nothing confirms",
    "not_separated": "torque and friction of a joint cannot be separated, so it stays uncalibrated",
    "hand_not_empty": "recordings of an empty hand look as if it held something, or lacked a tool",
    "runs_differ": "a run differs from the others; the interval carries half of that",
    "runs_contradict": "a run contradicts the others",
    "unsimulated": "no guess could be simulated",
    "stamps_off": "the joint moved earlier or later than the stamps of its input allow",
    "paused": "the joint states of a rejected recording paused, as on a computer that is busy elsewhere",
    "uneven": "the joint states of a rejected recording came unevenly, as from a computer that is busy elsewhere",
    "drift": "the empty hand contradicts the calibration",
    "on_bound": "the value ended on a bound of the search",
    "misfit": "the best simulation does not follow the recording",
    "coarse_fit": "the residuals are coarser than the encoder; the interval is wider for it",
    "arm_unlike_urdf": "by its torques the arm weighs far more or less than its URDF says",
    "other_torque": "a joint's torque is larger or smaller than the empty arm's, as in another unit",
    "other_zero": "a joint's positions are read from elsewhere than the empty arm's, as after its horn was put on anew",
    "leans_on_zero": "one pose does not tell a joint's zero from weight; `if_zeros_moved` is the interval for 20 mrad of it",
    "misread_joint": "a joint's positions or efforts are counted the other way round, or are another joint's",
    "lighter_than_empty": "the hand seems lighter than it was empty",
    "says_too_little": "the motion determines the value too coarsely to state it",
    "one_sided": "the recording bounds the value on one side at most",
    "too_wide": "the interval is wider than a stated share of the value; both are given",
    "far_from_prior": "an unknown ended further from its prior than a right model takes it",
    "another_joint": "friction, damping or rotor of a joint are not those that its calibration knows, as of another servo or gain",
    "not_covered": "the value lies far outside of those that the calibration was made with",
    "starts_disagree": "some starts of the search ended elsewhere",
    "guessed_facts": "facts that decide the answer were not stated; the interval carries a guess of how far off they are",
    "several_values": "more than one value explains the recording",
    "baseline_not_empty": "the baseline contradicts what is known about it",
    "hardly_pressed": "the block was hardly pressed",
    "not_calibrated": "what the robot's file leaves open counts as uncertainty",
    "no_empty_motion": "a motion of several joints came without one of the empty hand",
    "torque_scale_open": "the scale of the motor's torque is not known well enough to state a mass",
    "within_friction": "the motor's torque lies within friction and says little about the load",
    "changed_midway": "the two halves of a recording say different values",
    "changed_along": "friction or torque per effort changed along the recording, as while motors warm up",
    "kind_open": "the recording does not tell what is in the container",
    "clock_off": "by its torques a recording took another time than its stamps say, or its efforts are late",
    "other": "a reason without a code of its own",
}
"""Every code and what it means. A code keeps its meaning; the words of a sentence may change."""
REMEDIES = {
    "few_samples": "record the joint for longer, away from its stops; the sentence says what ended the run",
    "stuck": "push with more current, or from a pose in which gravity helps, so that it moves by 0.3 rad or more",
    "position_jumps": "see that its encoder is firm and nobody sets its zero meanwhile, and record again",
    "left_out_samples": "nothing, if enough is left; else push shorter, or start further from the joint's limit",
    "stood_still": "free the joint: see whether it leans on something or its motor sticks, and record again",
    "short_travel": "push so that the joint moves by 0.3 rad or more; `proprio plan` proposes such pushes",
    "starts_at_limit": "start away from the stop",
    "current_above_limit": "push below the limit, or correct current_limit_A in the robot file",
    "held_joint_moved": "hold the other joints more stiffly while one is pushed",
    "never_reversed": "add a run in which the joint moves the other way",
    "one_run": "add runs, of each joint in both directions",
    "not_separated": "add runs that drive the joint the other way",
    "hand_not_empty": "empty the hand, record anew; a tool that stays mounted, hand and fingers belong in the URDF",
    "runs_differ": "nothing, if the interval is narrow enough; else hold the object more firmly and record again",
    "runs_contradict": "see that all runs held the same object in the same way, and leave out the one that is named",
    "unsimulated": "check robot file, pose, units and --effort-unit: no mass whatever moves this arm like this",
    "stamps_off": "stamp commands and joint states by one clock, when they are sent and read",
    "paused": "keep the computer free while it records, and record again",
    "uneven": "keep the computer free while it records, and record again",
    "drift": "see that the baseline's hand was empty and nothing touched the arm; if so, calibrate again",
    "on_bound": "check robot, joint and unit of the current; for a delay, stamp commands and joint states by one clock",
    "misfit": "check the effort's unit and sign, the robot file, and that nothing touched the arm; `proprio check` helps",
    "coarse_fit": "nothing, if the interval is narrow enough; else calibrate the robot",
    "arm_unlike_urdf": "put a mounted tool into the URDF; check the effort's unit and sign, torque constants, zeros, payload.com",
    "other_torque": "record both with the same driver, unit and torque constants, on the same arm",
    "other_zero": "put the joint together as it was, or calibrate again; where its URDF's zero is off, correct it there",
    "leans_on_zero": "add an empty-hand run of today with --baseline",
    "misread_joint": "state an effort's sign (--effort-sign); turn positions or names where they are published, or an axis",
    "lighter_than_empty": "see that bags are not swapped, and that the baseline's hand was empty",
    "says_too_little": "move faster, further and longer, through more attitudes of the hand; for a reference take a heavier one",
    "one_sided": "squeeze harder, or with several currents; calibrate the gripper",
    "too_wide": "take the interval as it is, or narrow it: calibrate the robot, with a reference weight, or record more runs",
    "far_from_prior": "weigh the reference again; check what the robot file says of the unknown that is named",
    "another_joint": "calibrate this servo, on this arm, with its gain and supply as they are; let it warm up as then",
    "not_covered": "see that servo and arm are those that were calibrated; if so, calibrate with a load like this one, too",
    "starts_disagree": "nothing, if it is the only reason: the best start was taken",
    "guessed_facts": "state the fact with --set, such as --set payload.com=[0,0,0.02]",
    "several_values": "add a run with more travel, or from another pose",
    "baseline_not_empty": "record the baseline with nothing in the container, or correct container.mass",
    "hardly_pressed": "see that the block is between the fingers, check block.size, and squeeze harder",
    "not_calibrated": "calibrate: `proprio calibrate` with empty-hand runs, with a reference weight if torque is open",
    "no_empty_motion": "record about the same motion with an empty hand, and add it with --baseline or to `proprio calibrate`",
    "torque_scale_open": "calibrate with a reference weight, or state a measured torque constant with its std",
    "within_friction": "move faster and further, so that the motor has to accelerate the load",
    "changed_midway": "record the motions with and without the object apart, or take a part with --span FROM:TO",
    "changed_along": "let the arm move for some minutes before it is recorded, so that its motors are warm",
    "kind_open": "shake the container harder, about as fast as a liquid in it would slosh, and calibrate the robot",
    "clock_off": "let the recorder stamp each sample by a clock when it is read, not by counting frames, and record again",
    "other": "read the sentence: it says what to do",
}
"""What to do about each code, for whoever has never met it; the sentence of a reason says it for that recording."""


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
