"""How soft is it? Young's modulus of a block between the fingers, from the gripper's closing."""

# %% Calibrate the gripper: it closes with nothing between its fingers
from proprio_ros import calibrate, weigh
from proprio_ros.inputs.resources import resource


def bag(name: str) -> str:
    """One of the small recordings that come with the package; yours are paths."""
    return str(resource("bags", f"realistic_s00_squeeze_{name}") / "bag_mcap")


calibration = calibrate([bag("empty_0"), bag("empty_1")])
print(calibration)

# %% Squeeze; the block's size is a fact that you state
block = weigh(bag("light"), probe="softness", calibration=calibration, block={"size": 0.03})
print(block)

# %% More than one number
for name, value in block.values.items():
    print(name, value.value, value.ci95, value.unit, value.reason)
block

# %% Measured against simulated
figure = block.plot()
