"""How heavy is it? Calibrate the arm with an empty hand, then weigh what it holds. Cells: open it as a notebook, or run it."""

# %% What the recordings hold, before any fit
from proprio_ros import calibrate, check, weigh
from proprio_ros.inputs.resources import resource


def bag(name: str) -> str:
    """One of the small recordings that come with the package; yours are paths."""
    return str(resource("bags", f"realistic_s00_{name}") / "bag_mcap")


empty_hand = [bag(f"empty_{number:02d}_joint3") for number in range(6)]
print(check([*empty_hand, bag("fixed_heavy_ball_50g_joint3")]))

# %% Learn the arm's friction, torque constants and weight from runs with nothing in the hand
calibration = calibrate(empty_hand)
print(calibration)
for advice in calibration.estimate.advice:  # `plan` says the same for weighings of about a mass
    print(
        f"next: {advice.joint}, {1e3 * advice.current_A:+.0f} mA from {dict(advice.start)}: {advice.reason}"
    )

# %% Weigh; in a notebook, the last line of a cell shows the result
ball = weigh(
    bag("fixed_heavy_ball_50g_joint3"),
    calibration=calibration,
    payload={"shape": "sphere", "size": 0.043},
)
assert ball.mass is not None and ball.ci95 is not None
print(
    f"{1e3 * ball.mass:.1f} g, 95 % interval {1e3 * ball.ci95[0]:.1f} .. {1e3 * ball.ci95[1]:.1f} g: {ball.verdict}"
)
ball

# %% Measured against simulated
figure = ball.plot()
