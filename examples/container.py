"""What is in the box? The mass of a sphere that rolls in a closed container, from runs with and without it."""

# %% Calibrate the joint that will move, with an empty hand
from proprio_ros import calibrate, weigh
from proprio_ros.inputs.resources import resource


def bag(name: str) -> str:
    """One of the small recordings that come with the package; yours are paths."""
    return str(resource("bags", f"realistic_s00_{name}") / "bag_mcap")


calibration = calibrate([bag(f"empty_{number}_joint4") for number in (12, 13, 14, 15)])
print(calibration)

# %% The same run with the empty container separates the sphere from the container; sizes and place are facts that you state
sphere = weigh(
    bag("container_sphere_random_joint4_030mA"),
    probe="container",
    baseline=bag("container_no_sphere_joint4_030mA"),
    calibration=calibration,
    container={"inner_size": [0.06, 0.04, 0.04], "centre": [0.035, 0.0, 0.0]},
    settings={"sphere.radius": 0.01},
)
print(sphere)
for reason in sphere.reasons:
    print("-", reason)
sphere

# %% Measured against simulated
figure = sphere.plot()
