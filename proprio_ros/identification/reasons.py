"""A sentence for the user that carries a code for programs."""

from __future__ import annotations

CODES = {
    "few_samples": "a run has too few usable samples",
    "stuck": "the joint hardly moved, so friction and not the load decides where it is",
    "left_out_samples": "samples at the end of a run were left out",
    "stood_still": "a joint stood still where the answer says that it should have moved",
    "short_travel": "the joint moved, but less than a trustworthy result needs",
    "starts_at_limit": "the joint starts at its limit, where the stop may carry part of the weight",
    "current_above_limit": "more current was commanded than the motor's limit lets flow",
    "held_joint_moved": "a joint that should be held moved",
    "never_reversed": "a joint moved in one direction only, so its friction was never seen reversed",
    "one_run": "a calibration rests on one run, which nothing confirms",
    "not_separated": "torque and friction of a joint cannot be told apart, so it stays uncalibrated",
    "hand_not_empty": "runs with an empty hand look as if it held something",
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
    "lighter_than_empty": "the hand seems lighter than it was empty",
    "says_too_little": "the motion determines the value too coarsely to state it",
    "one_sided": "the recording bounds the value on one side at most",
    "too_wide": "the interval is wider than a stated share of the value; both are given",
    "far_from_prior": "an unknown ended further from its prior than a right model takes it",
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
    "other": "a reason without a code of its own",
}
"""Every code and what it means. A code keeps its meaning; the words of a sentence may change."""


class Reason(str):
    """A sentence, and why it was said.

    Attributes:
        code: One of `CODES`.
    """

    code: str

    def __new__(cls, code: str, sentence: str) -> Reason:
        reason = super().__new__(cls, sentence)
        reason.code = code
        return reason

    def __getnewargs__(self) -> tuple[str, str]:  # type: ignore[override]
        """What copies and pickles are made from."""
        return self.code, str(self)


def of_run(name: str, sentence: str) -> str:
    """The same reason with the run's name in front."""
    return Reason(getattr(sentence, "code", "other"), f"{name}: {sentence}")
