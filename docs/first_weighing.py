# %% [markdown]
# # A first notebook
#
# An arm learns what its own joints feel with an empty hand, then weighs what it holds: from small recordings that come with the
# package, without ROS. Yours are paths to bags.

# %%
from proprio_ros import calibrate, check, plan, weigh
from proprio_ros.inputs.resources import resource


def bag(name):
    return resource("bags", name) / "bag_mcap"


# %% [markdown]
# What is in a recording, before any fit. The third is a run in which the joint stuck.

# %%
empty_hand = [bag(f"realistic_s00_empty_{number:02d}_joint3") for number in range(6)]
stuck = bag("friction_s00_fixed_random_a_joint3")
check([*empty_hand[:2], stuck])

# %% [markdown]
# Six runs with nothing in the hand tell the joint's friction and torque. Pale: what the robot's file says, 95 %; dark: what the
# runs leave of it.

# %%
calibration = calibrate(empty_hand)
calibration

# %%
calibration.plot()

# %% [markdown]
# A ball of 50 g. What is known about it is stated: that it is a sphere, and its diameter in metres.

# %%
ball = weigh(
    bag("realistic_s00_fixed_heavy_ball_50g_joint3"),
    calibration=calibration,
    payload={"shape": "sphere", "size": 0.043},
)
ball

# %%
print(
    f"{1e3 * ball.mass:.1f} g, and between {1e3 * ball.ci95[0]:.1f} and {1e3 * ball.ci95[1]:.1f} g (95 %)"
)
ball.plot()

# %% [markdown]
# Without the calibration the same recording says less, and no number is stated that it does not bear.

# %%
weigh(bag("realistic_s00_fixed_heavy_ball_50g_joint3"), payload={"shape": "sphere", "size": 0.043})

# %% [markdown]
# A recording that cannot tell is refused, with what to do; `mass` is then `None`.

# %%
refused = weigh(stuck)
refused

# %%
refused.mass is None, [reason.code for reason in refused.reasons]

# %% [markdown]
# Which push would tell 50 g best, by this calibration:

# %%
plan(0.05, calibration=calibration, count=3)
