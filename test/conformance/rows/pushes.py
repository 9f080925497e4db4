"""What is read beside a push of one joint."""

from __future__ import annotations

from conformance.table import ACCEPTED, REFUSED, VERDICTS, Bent, Row

_SECTION = "G. Beside a push"
_20_G = "push_light_ball_20g_joint3_calibrated"
_23_G = "push_heavy_cube_23g_joint3_x0_calibrated"
_100_G = "push_reference_100g_joint3_x1_calibrated"
_LOADED = ("loaded",)

ROWS = (
    Row(
        name="push_as_it_is",
        section=_SECTION,
        trouble="nothing is wrong; uncalibrated",
        base="push_light_ball_20g_joint3",
        verdicts=VERDICTS[:2],
    ),
    Row(
        name="push_as_it_is_calibrated",
        section=_SECTION,
        trouble="nothing is wrong; calibrated",
        base=_20_G,
        verdicts=(ACCEPTED,),
        narrow=0.0035,
    ),
    *(
        Row(
            name=f"push_{joint}_zero_{1e3 * zero:+.0f}_mrad",
            section=_SECTION,
            trouble=f"{joint} is read {1e3 * zero:+.0f} mrad off",
            base=base,
            bends=(Bent("push_zero_off", {"joint": joint, "zero_rad": zero}, _LOADED),),
            cause=r"zero|rad",
            said_if=VERDICTS,
            zeros_move=True,
        )
        for joint, zero, base in (
            ("joint2", 0.02, _20_G),
            ("joint3", 0.02, _20_G),
            ("joint2", -0.1, _23_G),
            ("joint3", -0.1, _23_G),
        )
    ),
    Row(
        name="push_joint_slips",
        section=_SECTION,
        trouble="a locked joint's reading steps by 10 mrad in mid-run",
        base=_20_G,
        bends=(
            Bent(
                "push_joint_steps",
                {"joint": "joint2", "step_rad": 0.01, "at": 0.5},
                _LOADED,
            ),
        ),
        cause=r"step|jump|slip|moved",
    ),
    *(
        Row(
            name=f"push_command_times_{factor}",
            section=_SECTION,
            trouble=f"{factor} times the command that the motor was given is recorded",
            base=base,
            bends=(Bent("push_command_scaled", {"factor": factor}, _LOADED),),
            cause=r"command",
        )
        for factor, base in ((0.8, _20_G), (1.25, _100_G))
    ),
    Row(
        name="push_command_noisy_and_times_0.8",
        section=_SECTION,
        trouble="the same with 10 mA of noise, so that it never settles",
        base=_20_G,
        bends=(
            Bent(
                "push_command_scaled_and_noisy",
                {"factor": 0.8, "std_A": 0.01},
                _LOADED,
            ),
        ),
        cause=r"command",
    ),
    Row(
        name="push_joints_exchanged",
        section=_SECTION,
        trouble="the positions of two locked joints are exchanged",
        base=_23_G,
        bends=(
            Bent(
                "push_joints_exchanged",
                {"joint": "joint2", "other": "joint4"},
                _LOADED,
            ),
        ),
        verdicts=REFUSED,
        codes=("misfit",),
        cause=r"exchanged",
    ),
)
