"""What is in the bottle, and how much? A liquid in an upright cylinder, from pushes and a shake with and without it."""

# %% Learn the arm from its runs with an empty hand
from proprio_ros import calibrate, weigh
from proprio_ros.inputs.resources import resource

RECORDED = resource("bags", "contents_liquid_r35_h30_1mPas")


def bags(word: str) -> list[str]:
    """Recordings that come with the package; yours are paths."""
    return sorted(str(path) for path in RECORDED.glob(f"{word}_*"))


calibration = calibrate(bags("empty"))
print(calibration)

# %% The same runs with the empty container are the baseline; its inside and where its bottom is are facts that you state
inside = weigh(
    bags("run"),
    probe="contents",
    baseline=bags("baseline"),
    calibration=calibration,
    settings={
        "contents.radius": 0.035,
        "contents.height": 0.1,
        "contents.bottom": [0.015, 0.0, -0.04],
    },
)
print(inside)
for kind in ("nothing", "rigid", "liquid", "granular"):
    print(f"{kind}: {100.0 * inside.value(f'{kind}_inside'):.0f} %")
for reason in inside.reasons:
    print("-", reason)
inside

# %% Measured against simulated
figure = inside.plot()
