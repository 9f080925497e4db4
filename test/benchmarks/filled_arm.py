"""Recordings of arms that hold a container with a liquid, grains, something rigid or nothing in it.

Arms are those of ``random_arm.py``; what is in the container moves by ``support/contents.py``. Both are coupled both ways. MuJoCo
moves the hand with the contents frozen to it, and what they do otherwise acts on the hand as a wrench. Every `EXCHANGE_S` the
particles get the container's mean acceleration since the last time and say the mean wrench, from which that of the frozen contents
is taken. The difference is carried on linearly to the middle of the next interval. What is late is thereby what sloshes alone, so a
light arm stays stable.
"""

from __future__ import annotations

import functools
import json
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from coverage import MATCHED
from random_arm import (
    BRAKED_S,
    EFFECTS,
    EMPTY_PROBES,
    GRIPPER,
    JOINTS,
    NOMINAL_TORQUE_CONSTANT,
    STEP_S,
    HiddenRobot,
    Load,
    Probe,
    draw_robot,
    record,
    simulate,
)
from support.contents import Contents, Cylinder, Grains, Liquid, shake_period_s, sloshing, theory_hz
from support.recording_bag import write_recording

EXCHANGE_S = 0.002
AFTER_S = 0.2
"""Held and recorded after a push."""
ONSET_NS = 1_760_000_010_000_000_000


@dataclass(frozen=True)
class Container:
    """An upright cylinder with a lid.

    Attributes:
        radius, height: Inside [m].
        bottom: Where the middle of its bottom is in end_effector_link [m].
        mass: Of the empty one [kg].
        layers: Cells over its height: the liquid's resolution.
    """

    radius: float
    height: float
    bottom: tuple[float, float, float]
    mass: float
    layers: int

    @property
    def cylinder(self) -> Cylinder:
        return Cylinder(self.radius, self.height)

    def moments(self) -> tuple[float, np.ndarray, np.ndarray]:
        """Mass, centre and inertia about the bottom's middle: a thin skin, as thick everywhere."""
        r = self.radius
        h = self.height
        side = 2.0 * np.pi * r * h
        end = np.pi * r**2
        each = self.mass / (side + 2.0 * end)
        across = each * (side * (r**2 / 2.0 + h**2 / 3.0) + end * (r**2 / 2.0 + h**2))
        along = each * (side * r**2 + end * r**2)
        return self.mass, np.array([0.0, 0.0, 0.5 * h]), np.diag([across, across, along])


CONTAINERS = (
    Container(0.025, 0.080, (0.010, 0.0, -0.030), 0.025, 24),
    Container(0.035, 0.100, (0.015, 0.0, -0.040), 0.040, 20),
    Container(0.045, 0.090, (0.025, 0.0, -0.035), 0.055, 18),
)
FILLS_M = ((0.015, 0.03, 0.045, 0.06), (0.015, 0.03, 0.045, 0.06), (0.015, 0.025, 0.035, 0.045))
VISCOSITIES = (0.001, 0.1, 1.0)
GRAINS_M = (
    (0.006, (0.02, 0.035, 0.05)),
    (0.008, (0.02, 0.035, 0.05)),
    (0.008, (0.015, 0.022, 0.03)),
)
"""Diameter, and fills."""
GRAIN_KG_M3 = (1200.0, 1400.0, 2500.0)


@dataclass(frozen=True)
class Case:
    """What one recording has in its container: `kind` is nothing, rigid, liquid or granular."""

    kind: str
    container: int
    fill: float = 0.0
    viscosity: float | None = None

    @property
    def name(self) -> str:
        thick = "" if self.viscosity is None else f"_{1e3 * self.viscosity:g}mPas"
        return (
            f"{self.kind}_r{1e3 * CONTAINERS[self.container].radius:g}_h{1e3 * self.fill:g}{thick}"
        )


def cases() -> list[Case]:
    """The 61, mixed so that the first ones have some of each."""
    many = [
        Case("liquid", c, fill, v) for c in range(3) for fill in FILLS_M[c] for v in VISCOSITIES
    ]
    many += [Case("granular", c, fill) for c in range(3) for fill in GRAINS_M[c][1]]
    many += [Case("rigid", c, fill) for c in range(3) for fill in FILLS_M[c]]
    many += [Case("nothing", c) for c in (0, 1, 2, 1)]
    kinds = {
        kind: [case for case in many if case.kind == kind]
        for kind in ("liquid", "granular", "rigid", "nothing")
    }
    rng = np.random.default_rng(31)
    mixed = []
    for kind, found in kinds.items():
        order = rng.permutation(len(found))
        mixed += [
            ((rank + 0.5 * rng.random()) / len(found), kind, found[at])
            for rank, at in enumerate(order)
        ]
    return [case for _, _, case in sorted(mixed, key=lambda each: each[0])]


def poured(case: Case, tilt: float = 0.0) -> Contents | None:
    """The contents, at rest; of what is rigid, those that it is as heavy as."""
    container = CONTAINERS[case.container]
    if case.kind == "nothing":
        return None
    if case.kind == "granular":
        diameter = GRAINS_M[case.container][0]
        return Grains(
            container.cylinder,
            case.fill,
            diameter,
            GRAIN_KG_M3[case.container],
            0.4,
        )
    return Liquid(
        container.cylinder,
        case.fill,
        case.viscosity or 0.0,
        container.layers,
        tilt,
    )


@dataclass(frozen=True)
class Filled(Load):
    """A container in the hand, with its contents frozen to it.

    Attributes:
        bottom: Middle of the inside of its bottom in end_effector_link [m].
        pour: Makes what moves in it, at rest under a surface with that tilt [rad]; None where nothing does.
        frozen: Mass, centre and inertia about the bottom's middle of these contents, which are part of the load.
        exchange_s: How often wrench and motion are exchanged.
    """

    bottom: tuple[float, float, float] = (0.0, 0.0, 0.0)
    pour: Callable[[float], Contents | None] | None = None
    frozen: tuple[float, np.ndarray, np.ndarray] | None = None
    exchange_s: float = EXCHANGE_S
    state: dict[str, Any] = field(
        default_factory=dict,
        compare=False,
    )

    def settle(self, model: Any, data: Any) -> np.ndarray:
        """The contents lie level, whatever the zeros of the joints are; those of the run before are gone."""
        self.state.clear()
        if self.pour is not None:
            turn = data.body("load").xmat.reshape(3, 3)
            down = turn.T @ [0.0, 0.0, -1.0]
            contents = self.pour(float(np.arctan(down[0] / -down[2])))
            self.state.update(
                contents=contents,
                step=0,
                told=[np.zeros(6)] * 2,
                last=None,
            )
        return np.zeros(4)

    def couple(self, model: Any, data: Any) -> None:
        if self.pour is None:
            return
        state = self.state
        state["step"] += 1
        if (state["step"] - 1) % round(self.exchange_s / self.step_s):
            return
        import mujoco

        at = model.body("load").id
        for compute in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_comVel):
            compute(model, data)
        moving = np.zeros(6)
        mujoco.mj_objectVelocity(
            model,
            data,
            mujoco.mjtObj.mjOBJ_XBODY,
            at,
            moving,
            0,
        )
        turn = data.xmat[at].reshape(3, 3).copy()
        omega = moving[:3].copy()
        velocity = moving[3:] + np.cross(moving[:3], turn @ self.bottom)
        if state["last"] is not None:
            told = state["told"]
            before = state["last"]
            told[:] = [
                told[1],
                self._beside_frozen(before, (turn, omega, velocity)),
            ]
            wrench = 2.0 * told[1] - told[0]
            force = turn @ wrench[:3]
            moment = turn @ wrench[3:]
            data.xfrc_applied[at, :3] = force
            data.xfrc_applied[at, 3:] = moment + np.cross(
                turn @ (np.array(self.bottom) - self.offset), force
            )
        state["last"] = turn, omega, velocity

    def _beside_frozen(self, before: Any, now: Any) -> np.ndarray:
        """Mean wrench over the interval about the bottom, in its axes, less that of the contents if they were frozen."""
        assert self.frozen is not None
        back = 0.5 * (before[0] + now[0]).T  # to the container's axes amid the interval
        gravity = back @ [0.0, 0.0, -9.81]
        acceleration, angular = (back @ ((now[n] - before[n]) / self.exchange_s) for n in (2, 1))
        omega = back @ (0.5 * (before[1] + now[1]))
        wrench = self.state["contents"].step(
            gravity,
            acceleration,
            angular,
            omega,
            self.exchange_s,
        )
        mass, centre, inertia = self.frozen
        pull = gravity - acceleration
        force = mass * (pull - np.cross(angular, centre) - np.cross(omega, np.cross(omega, centre)))
        moment = (
            mass * np.cross(centre, pull) - inertia @ angular - np.cross(omega, inertia @ omega)
        )
        result: np.ndarray = wrench - np.concatenate([force, moment])
        return result


def filled(
    case: Case,
    moving: bool = True,
    exchange_s: float = EXCHANGE_S,
) -> Filled:
    """The container with its contents; ``moving`` False freezes them."""
    container = CONTAINERS[case.container]
    mass, centre, about = container.moments()
    contents = poured(case)
    frozen = None
    if contents is not None:
        inner, inertia = contents.moments()
        frozen = contents.kg, inner, inertia
        centre = (mass * centre + contents.kg * inner) / (mass + contents.kg)
        mass = mass + contents.kg
        about = about + inertia
    about = about - mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    offset = np.array(container.bottom) + centre
    xx, yy, zz = (float(about[n, n]) for n in range(3))
    six = (xx, yy, zz, float(about[0, 1]), float(about[0, 2]), float(about[1, 2]))
    pour = (
        functools.partial(poured, case) if moving and case.kind in ("liquid", "granular") else None
    )
    place = (float(offset[0]), float(offset[1]), float(offset[2]))
    return Filled(
        mass,
        place,
        six,
        container.bottom,
        pour,
        frozen,
        exchange_s,
    )


@dataclass(frozen=True)
class Push:
    """A run: its current brings the load, were it rigid, as far as ``travel`` [rad], and is shaken by ``shake_A``.

    The last one is what the bound asks for: the container hangs below the elbow, which moves it sideways; gravity brings it back.
    """

    joint: str
    start: tuple[float, float, float]
    travel: float
    duration_s: float = 0.6
    shake_A: float = 0.0


PUSHES = (
    Push("joint3", (-0.9, 0.3, 0.6), -0.6),
    Push("joint3", (-0.6, -0.4, 1.0), 0.6),
    Push("joint4", (-0.6, -0.2, 0.8), -0.7),
    Push("joint3", (0.15, 1.2, -1.35), -0.2, 2.5, 0.12),
)
"""The container stands upright at each start."""


def probe_of(
    push: Push,
    hidden: HiddenRobot,
    load: Load,
    shake: tuple[float, float] = (0.0, 1.0),
) -> Probe:
    """The run, with the current that a person finds by trying."""
    start = {
        **dict(zip(JOINTS, (0.0, *push.start), strict=True)),
        GRIPPER: 0.0,
    }
    column = JOINTS.index(push.joint)

    def travel(current: float) -> float:
        made = simulate(
            hidden, push.joint, start, current, push.duration_s, load, shake=shake, braked_s=0.0
        )
        moved = made.position[:, column]
        # of a shaken one where it is on average in the end
        return (
            float(moved[-round(shake[1] / STEP_S) :].mean() - moved[0])
            if shake[0]
            else float(moved[-1] - moved[0])
        )

    # more current, more travel: between currents that lift and lower
    low = -1.6
    high = 0.6
    for _ in range(9):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if travel(middle) > push.travel else (middle, high)
    return Probe(
        push.joint,
        start,
        0.5 * (low + high),
        push.duration_s,
    )


@dataclass(frozen=True)
class _Recorder:
    """Records pushes of one robot into bags of a folder.

    Attributes:
        folder: Where the bags go.
        hidden: The robot.
        rng: Draws what differs from push to push.
    """

    folder: Path
    hidden: HiddenRobot
    rng: np.random.Generator

    def write(
        self,
        name: str,
        probe: Probe,
        held: Load | None,
        shake: tuple[float, float] = (0.0, 1.0),
        after_s: float = BRAKED_S,
    ) -> dict[str, Any]:
        """One push, and what the truth says of it.

        Args:
            name: Of the bag.
            probe: The push.
            held: What is in the hand.
            shake: Amplitude [A] and period [s] of a square wave about its current.
            after_s: How long it is held and recorded afterwards.
        """
        made = record(
            self.hidden,
            probe.joint,
            probe.start,
            probe.current_A,
            probe.duration_s,
            held,
            self.rng,
            shake,
            after_s,
        )
        later = replace(
            made,
            joints=replace(made.joints, times_ns=made.joints.times_ns + ONSET_NS),
            inputs=replace(made.inputs, times_ns=made.inputs.times_ns + ONSET_NS),
        )
        write_recording(self.folder / name, later, effort_per_A=NOMINAL_TORQUE_CONSTANT)
        at = made.joints.column(probe.joint)
        return {
            "joint": probe.joint,
            "start": dict(probe.start),
            "current_A": probe.current_A,
            "shake": shake,
            "duration_s": probe.duration_s,
            "travel_rad": float(np.ptp(made.joints.position[:, at])),
        }


def recorded(
    folder: Path,
    case: Case,
    seed: int,
    rings: dict[str, tuple[float, float]],
) -> dict[str, Any]:
    """Make one folder: ``empty_NN`` (bare hand), ``baseline_N`` (empty container), ``run_N`` and ``truth.json``."""
    rng = np.random.default_rng([seed, 3131])
    hidden = draw_robot(rng, EFFECTS, MATCHED)
    container = CONTAINERS[case.container]
    folder.mkdir(parents=True)
    recorder = _Recorder(folder, hidden, rng)
    for n, probe in enumerate(EMPTY_PROBES):
        recorder.write(f"empty_{n:02d}", probe, None)
    inside = {"radius": container.radius, "height": container.height}
    truth = {
        "kind": case.kind,
        "name": case.name,
        "seed": seed,
        "container": {**inside, "bottom": container.bottom, "mass": container.mass},
        "contents": _truth(case, rings),
        "runs": _pushed(recorder, case),
        "robot": asdict(hidden),
    }
    (folder / "truth.json").write_text(json.dumps(truth, indent=1))
    return truth


def _pushed(recorder: _Recorder, case: Case) -> dict[str, dict[str, Any]]:
    """Every push with the empty container and with the filled one, and what the truth says of each."""
    load = filled(case)
    frozen = filled(case, moving=False)
    bare = filled(Case("nothing", case.container))
    hz = theory_hz(CONTAINERS[case.container].radius, max(case.fill, 0.02))
    runs = {}
    for n, push in enumerate(PUSHES):
        shake = (push.shake_A, shake_period_s(hz)) if push.shake_A else (0.0, 1.0)
        for name, rigid, held in ((f"baseline_{n}", bare, bare), (f"run_{n}", frozen, load)):
            probe = probe_of(push, recorder.hidden, rigid, shake)
            runs[name] = recorder.write(name, probe, held, shake, AFTER_S)
    return runs


def _truth(
    case: Case,
    rings: dict[str, tuple[float, float]],
) -> dict[str, Any]:
    contents = poured(case)
    if contents is None:
        return {"mass": 0.0, "fill": 0.0}
    found: dict[str, Any] = {
        "mass": contents.kg,
        "fill": case.fill,
    }
    if isinstance(contents, Grains):
        found |= {
            "fill": contents.fill,
            "grains": len(contents.x),
            "diameter": contents.diameter,
        }
    elif case.kind == "liquid":
        container = CONTAINERS[case.container]
        if case.name not in rings:
            rings[case.name] = sloshing(
                container.cylinder, case.fill, case.viscosity or 0.0, container.layers, EXCHANGE_S
            )
        hz, damping = rings[case.name]
        found |= {"viscosity": case.viscosity, "slosh_hz": hz, "damping_ratio": damping,
                  "theory_hz": theory_hz(container.radius, case.fill)}  # fmt: skip
    return found


def dummies(count: int, seed: int) -> list[Case]:
    """So many rigid things more, as heavy as a liquid that fills a container to anywhere."""
    rng = np.random.default_rng([seed, 62])
    return [
        Case(
            "rigid",
            int(rng.integers(3)),
            round(float(rng.uniform(0.01, 0.06)), 4),
        )
        for _ in range(count)
    ]


def all_recorded(
    root: Path,
    first_seed: int,
    made: Sequence[Case],
) -> Iterator[dict[str, Any]]:
    """Make those that are not there yet; a folder has its name when it is whole."""
    rings: dict[str, tuple[float, float]] = {}
    for number, case in enumerate(made):
        folder = root / f"{number:02d}_{case.name}"
        if not folder.exists():
            unfinished = folder.with_name(f".{folder.name}")
            shutil.rmtree(unfinished, ignore_errors=True)
            yield recorded(unfinished, case, first_seed + number, rings)
            unfinished.rename(folder)
