"""A sphere that rolls in a box: our forward pass beside plain C, our fit beside MuJoCo's, and what steps and laws cost.

The benchmark's own recording is not used. Both fits read one recording that MuJoCo made: its own law of contact, a fine step,
12 bit and noise. The joint is the arm's wrist with the other joints held; MuJoCo gets it as one hinge with the same inertia and
load. Its RK4 at 2.5 ms, a longer step than which the contacts do not bear, is as accurate as ours; Euler at 0.5 ms is 0.4 % off.
"""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from case import REPEATS, REPOSITORY, Case, Kept, Row, Timing, measure, measure_in_turn
from scipy.optimize import least_squares
from support.plain_laws import parts, record_forward, states_of

from proprio_ros.identification.prepared_runs import prepare_run
from proprio_ros.identification.robot_calibration import LoadedRun, calibrate
from proprio_ros.identification.solvers import Solution, levenberg_marquardt
from proprio_ros.identification.unknowns import Role
from proprio_ros.inputs.settings import Settings, probe_file
from proprio_ros.pipeline.loading import bag_runs
from proprio_ros.pipeline.request import DEFAULT_ROBOT, Request
from proprio_ros.probes.container.facts import container_facts
from proprio_ros.probes.container.identify import find_sphere
from proprio_ros.probes.container.problem import (
    ContainerFacts,
    ContainerProblem,
    container_unknowns,
    sphere_run,
    start_prior,
)
from proprio_ros.probes.container.search import ContainerOptions
from proprio_ros.probes.payload.paper import FRAME_S
from proprio_ros.quantity import Quantity
from proprio_ros.records import Run
from proprio_ros.robot import Robot, load_robot
from proprio_ros.sim.joint import JointRun
from proprio_ros.sim.sphere import (
    SPHERE_INDEX,
    Contact,
    Enclosure,
    SphereRun,
    SphereSimulator,
    paper_contact,
)

C_GOAL = 1.5
WHOLE_GOAL_S = 0.2
MUJOCO_GOAL = 20.0
EQUAL = 1e-9
AGREEMENT = 0.05
"""A fit that misses the truth by more than this share is void, however fast."""
FLAGS = ("-O3", "-march=native")
SOURCE = Path(__file__).with_name("sphere_pass.c")

SPHERE_KG = 0.012
SHELL_KG = 0.03
FRICTION = 0.35
DAMPING_RATIO = 0.4
JOINT = "joint4"
HELD = {"joint1": 0.0, "joint2": -0.6, "joint3": -0.2, "gripper_left_joint": 0.0}
START_RAD = 0.4
CURRENT_A = -0.07
DURATION_S = 0.6
RATE_HZ = 40.0
TRUTH_STEP_S = 2.5e-5
MUJOCO_SETTINGS = (("RK4", 2.5e-3), ("EULER", 5e-4))
"""The first is the one that the goal counts for."""
STARTS_KG = ContainerOptions().starts_kg


class MujocoBox:
    """The same hinge, box and sphere in MuJoCo, with its own contacts.

    The world's axes are the container's at joint position 0. The arm beyond the hinge is a point mass that makes the same load of
    gravity, and armature for the rest of the inertia.

    Args:
        run: joint and gravity as the container sees them.
        p: parameters of the joint as in ``SPHERE_PARAMETERS``, the empty container included.
        facts: of container and sphere; the contact's frequency and damping become MuJoCo's ``solref``.
        step_s, integrator: its time step, and ``"EULER"`` or ``"RK4"``.
    """

    def __init__(
        self,
        run: SphereRun,
        p: np.ndarray,
        facts: ContainerFacts,
        step_s: float,
        integrator: str = "EULER",
    ) -> None:
        import mujoco

        self._mujoco = mujoco
        self._run, self._step_s = run, step_s
        self._torque_constant = float(p[SPHERE_INDEX["torque_constant"]])
        self._radius = facts.enclosure.radius
        spec = mujoco.MjSpec()
        spec.option.timestep = step_s
        spec.option.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator}")
        spec.option.gravity = run.gravity
        frequency = facts.contact_frequency
        ratio = facts.damping_ratio.value
        contact = {
            "solref": [1.0 / (frequency * ratio), ratio],
            "friction": [facts.friction.value, 0.0, 0.0],
        }
        hand = self._add_hand(spec, p)
        self._add_walls(hand, 0.5 * np.asarray(facts.enclosure.inner_size), contact)
        sphere = spec.worldbody.add_body(name="sphere")
        sphere.add_freejoint()
        sphere.add_geom(
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=[self._radius, 0, 0],
            mass=0.01,
            condim=3,
            **contact,
        )
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)

    def _add_hand(self, spec: Any, p: np.ndarray) -> Any:
        """The hinge and what hangs on it, by the joint's parameters (P,)."""
        run = self._run
        hand = spec.worldbody.add_body(name="hand")
        hand.add_joint(
            name="hinge",
            type=self._mujoco.mjtJoint.mjJNT_HINGE,
            axis=run.axis,
            pos=run.joint_origin,
        )
        inertia, by_cos, by_sin, _constant = p[:4]
        across = run.gravity - run.axis * (run.axis @ run.gravity)
        # load = arm . (axis x gravity) cos q + arm . gravity sin q, where ``arm`` is a kilogram's place from the axis
        arm = (by_cos * np.cross(run.axis, run.gravity) + by_sin * across) / (across @ across)
        hand.explicitinertial = True
        hand.mass = 1.0
        hand.ipos = run.joint_origin + arm
        hand.inertia = np.full(3, 1e-6)
        spec.joint("hinge").armature = float(inertia - arm @ arm - 1e-6)
        return hand

    def _add_walls(
        self,
        hand: Any,
        half: np.ndarray,
        contact: dict[str, Any],
    ) -> None:
        """Six of them about the inside of those half sizes [m], (3,)."""
        for axis in range(3):
            for side in (-1.0, 1.0):
                size = half + 0.01
                size[axis] = 0.01
                place = np.zeros(3)
                place[axis] = side * (half[axis] + 0.01)
                hand.add_geom(
                    type=self._mujoco.mjtGeom.mjGEOM_BOX, size=size, pos=place, condim=3, **contact
                )

    def positions(
        self,
        mass: float,
        start: np.ndarray,
        q0: float,
        v0: float,
        current_A: float,
        times_s: np.ndarray,
    ) -> np.ndarray:
        """Where the joint is at multiples of the step [rad], shape (T,).

        Args:
            mass: of the sphere [kg]; start: of its centre in the container's frame [m], shape (3,).
        """
        mujoco = self._mujoco
        model = self._model
        data = self._data
        model.body_mass[2] = mass
        model.body_inertia[2] = 0.4 * mass * self._radius**2
        mujoco.mj_setConst(model, data)
        mujoco.mj_resetData(model, data)
        turn = np.zeros(4)
        place = np.zeros(3)
        axis = self._run.axis
        mujoco.mju_axisAngle2Quat(turn, axis, q0)
        mujoco.mju_rotVecQuat(place, start - self._run.joint_origin, turn)
        data.qpos[0], data.qvel[0] = q0, v0
        data.qpos[1:4], data.qpos[4:8] = self._run.joint_origin + place, turn
        data.qvel[1:4], data.qvel[4:7] = v0 * np.cross(axis, place), v0 * axis
        data.qfrc_applied[0] = self._torque_constant * current_A
        shown = np.empty(len(times_s))
        done = 0
        for row, step in enumerate(np.rint(times_s / self._step_s).astype(int)):
            if step > done:
                mujoco.mj_step(model, data, nstep=int(step - done))
                done = step
            shown[row] = data.qpos[0]
        return shown


@dataclass(frozen=True)
class Boxed:
    """The recording and the problem that it poses, as the first search of ``find_sphere`` has it.

    Attributes:
        problem: unknown mass of the sphere, its place at the start, the joint's position and velocity then.
        starts: the five first guesses in solver coordinates, shape (5, F).
    """

    robot: Robot
    facts: ContainerFacts
    problem: ContainerProblem
    starts: np.ndarray

    @property
    def run(self) -> SphereRun:
        return self.problem.simulator.special.sphere_runs[0]

    @property
    def names(self) -> list[str]:
        """What is unknown."""
        return [self.problem.unknowns[row].name for row in self.problem.estimated]

    def solve(self) -> Solution:
        """Our search: the problem is built and everything is warm."""
        return levenberg_marquardt(
            self.problem,
            self.starts,
            self.problem.simulator.windows,
            window_iterations=3,
            iterations=12,
            tolerance=0.03,
        )

    def masses(self, internal: np.ndarray) -> np.ndarray:
        """Masses of the sphere [kg] of solver coordinates (S, F)."""
        return self.problem.coordinates.physical(internal)[:, self.names.index("sphere_mass")]

    def parameters(
        self,
        masses: Sequence[float],
    ) -> tuple[np.ndarray, np.ndarray]:
        """Simulator parameters (S, P) and their derivative by the unknowns (S, P, F), the rest at its prior."""
        values = np.tile(
            self.problem.base,
            (len(masses), 1),
        )
        values[:, self.problem.index["sphere_mass"]] = masses
        p, dp = self.problem.parameters(values, self.problem.estimated)
        return np.ascontiguousarray(p[:, 0]), np.ascontiguousarray(dp[:, 0])


def facts_of_the_box() -> ContainerFacts:
    """What is stated to both: all but the sphere's mass, and where exactly it lies."""
    return ContainerFacts(
        Enclosure(
            "box",
            np.array([0.06, 0.04, 0.04]),
            0.01,
        ),
        centre=np.array([0.035, 0.0, 0.0]),
        mass=SHELL_KG,
        mass_std=0.0,
        damping_ratio=Quantity(DAMPING_RATIO, 0.0),
        friction=Quantity(FRICTION, 0.0),
    )


def _recorded(
    times_s: np.ndarray,
    position: np.ndarray,
    before: np.ndarray,
) -> Run:
    return Run(
        name="sphere in a box",
        joint=JOINT,
        onset_ns=0,
        times_s=times_s,
        position=position,
        before_times_s=(np.arange(len(before)) - len(before)) / RATE_HZ,
        before_position=before,
        held=dict(HELD),
        held_span=dict.fromkeys(HELD, 0.0),
        input_times_s=np.zeros(1),
        input_current_A=np.array([CURRENT_A]),
        duration_s=DURATION_S,
        source="simulated",
    )


def _pose(
    robot: Robot,
    facts: ContainerFacts,
    run: Run,
    mass_alone: bool = False,
) -> Boxed:
    prepared = prepare_run(robot, run, None, facts.shell)
    nothing = JointRun(prepared.times_s, run.input_times_s, run.input_current_A)
    prior = start_prior(
        sphere_run(robot, prepared, facts, nothing),
        facts,
        prepared.rest.value,
    )
    unknowns = container_unknowns(
        robot,
        [prepared],
        [True],
        facts,
        [prior],
        Role.FIXED,
    )
    if mass_alone:
        unknowns = [u if u.name == "sphere_mass" else u.at_role(Role.FIXED) for u in unknowns]
    options = ContainerOptions()
    problem = ContainerProblem(
        robot, [prepared], facts, [True], unknowns, options.integrator, options.step_s
    )
    if len(prior.guesses) != 1:
        raise SystemExit(
            "the comparison wants a start whose place is known but for a little: five starts, not more"
        )
    values = np.tile(
        problem.base,
        (len(STARTS_KG), 1),
    )
    values[:, problem.index["sphere_mass"]] = STARTS_KG
    starts = problem.coordinates.internal(values[:, list(problem.estimated)])
    return Boxed(robot, facts, problem, starts)


def pose(
    record: Callable[[Boxed, np.ndarray], np.ndarray] | None = None,
    seed: int = 0,
    mass_alone: bool = False,
) -> Boxed:
    """The problem of a recording.

    Args:
        record: true positions [rad] at instants [s] of the problem that it is given; None is a joint that stands still.
        seed: of the encoder's noise.
        mass_alone: everything but the sphere's mass is held at what is expected of it.
    """
    robot = load_robot(DEFAULT_ROBOT)
    facts = facts_of_the_box()
    times_s = np.arange(round(DURATION_S * RATE_HZ) + 1) / RATE_HZ
    before = np.full(10, START_RAD)
    blank = _pose(
        robot,
        facts,
        _recorded(
            times_s,
            np.full(len(times_s), START_RAD),
            before,
        ),
    )
    if record is None:
        return blank
    drive = robot.drive_trains[JOINT]
    draw = np.random.default_rng(seed)

    def read(true: np.ndarray) -> np.ndarray:
        noisy = true + draw.normal(0.0, drive.encoder_noise, len(true))
        return drive.encoder_resolution * np.rint(noisy / drive.encoder_resolution)

    return _pose(
        robot,
        facts,
        _recorded(
            times_s,
            read(record(blank, times_s)),
            read(before),
        ),
        mass_alone,
    )


def by_mujoco(box: Boxed, times_s: np.ndarray) -> np.ndarray:
    """What the joint does in MuJoCo at a fine step, the sphere a little off where it is expected [rad], shape (T,)."""
    p, _ = box.parameters([SPHERE_KG])
    start = p[0, 15:18] + np.array([1e-4, 2e-3, 1e-4])
    mujoco_box = MujocoBox(
        box.run,
        p[0],
        box.facts,
        TRUTH_STEP_S,
    )
    return mujoco_box.positions(
        SPHERE_KG,
        start,
        START_RAD + 4e-4,
        0.0,
        CURRENT_A,
        times_s,
    )


class MujocoFit:
    """Fits MuJoCo to the recording with scipy's ``least_squares`` and its 2-point differences.

    Same unknowns, priors, weights and first guesses as ours; the mass as its logarithm, the others in standard deviations of their
    prior. Scipy's difference is a share of the coordinate, so none may lie at 0: priors lie at 10.

    Args:
        box: The recording and the problem.
        step_s: MuJoCo's.
        integrator: MuJoCo's.
    """

    def __init__(
        self,
        box: Boxed,
        step_s: float,
        integrator: str,
    ) -> None:
        empty, _ = box.parameters([0.0])
        self._mujoco = MujocoBox(box.run, empty[0], box.facts, step_s, integrator)
        self._problem = box.problem
        self._mass = box.names.index("sphere_mass")
        unknowns = box.problem.estimated_unknowns()
        std = np.array([u.std for u in unknowns])
        self._mean = np.array([u.value for u in unknowns])
        self._width = np.where(np.isfinite(std), std, 0.0)
        # one step is 0.01 of the priors' width
        self._shares = np.full(len(unknowns), 1e-3)
        self._shares[self._mass] = 1e-4
        self._rollouts = 0

    def __call__(self) -> tuple[np.ndarray, np.ndarray, int]:
        """Where the starts end [kg], their costs, and how many rollouts it took."""
        self._rollouts = 0
        ends = []
        for guess in STARTS_KG:
            start = np.full(len(self._mean), 10.0)
            start[self._mass] = np.log(guess)
            ends.append(least_squares(self._residual, start, diff_step=self._shares))
        masses = np.exp([end.x[self._mass] for end in ends])
        return masses, np.array([end.cost for end in ends]), self._rollouts

    def _residual(self, x: np.ndarray) -> np.ndarray:
        """Of the samples and of the priors, in standard deviations."""
        self._rollouts += 1
        at = self._problem.index
        values = self._problem.base.copy()
        values[self._problem.estimated] = self._mean + self._width * (x - 10.0)
        values[at["sphere_mass"]] = np.exp(x[self._mass])
        recorded = self._problem.runs[0]
        shown = self._mujoco.positions(
            values[at["sphere_mass"]],
            values[[at[f"sphere_{axis}", 0] for axis in "xyz"]],
            values[at["q0", 0]],
            values[at["v0", 0]],
            CURRENT_A,
            recorded.times_s,
        )
        off = np.delete(x - 10.0, self._mass)
        return np.append((shown - recorded.position) / recorded.sigma, off)


class SpherePass:
    """``sphere_pass`` for one run, buffers bound once.

    Args:
        simulator: of one run in a box, whose data are handed over; p: parameters, shape (W, P).
        folder: where the library is built.
    """

    def __init__(
        self,
        simulator: SphereSimulator,
        p: np.ndarray,
        folder: str,
    ) -> None:
        library = Path(folder) / "sphere_pass.so"
        if not library.exists():
            subprocess.run(
                [
                    "gcc",
                    *FLAGS,
                    "-shared",
                    "-fPIC",
                    str(SOURCE),
                    "-o",
                    str(library),
                    "-lm",
                ],
                check=True,
            )
        self._function = ctypes.CDLL(str(library)).sphere_pass
        self._function.restype = None
        run = simulator.sphere_runs[0].joint
        constants = np.array(
            [*run.supply, run.friction_velocity, run.step_s, min(run.fine_step_s, run.step_s)]
        )
        worlds = len(p)
        samples = len(run.sample_times_s)
        self.out = tuple(np.zeros((worlds, samples, *size)) for size in ((), (), (3,), (3,), (3,)))
        given = [
            run.sample_times_s,
            run.input_times_s,
            run.input_current_A,
            constants,
            simulator._geometry.numpy()[0],
            p,
        ]
        self._arrays = [np.ascontiguousarray(values, dtype=np.float64) for values in given]
        times, switches, currents, constants, geometry, p = (
            self._pointer(values) for values in self._arrays
        )
        self._arguments = (
            ctypes.c_int(worlds), ctypes.c_int(samples), times, ctypes.c_int(len(run.input_times_s)), switches, currents,
            constants, geometry, p, *(self._pointer(values) for values in self.out),
        )  # fmt: skip

    @staticmethod
    def _pointer(values: np.ndarray) -> ctypes.c_void_p:
        return ctypes.c_void_p(values.ctypes.data)

    def __call__(self) -> tuple[np.ndarray, ...]:
        """q, v (W, T) and the sphere's position, velocity and spin (W, T, 3)."""
        self._function(*self._arguments)
        return self.out


def easy_and_hard(box: Boxed) -> list[tuple[str, SphereRun, np.ndarray]]:
    """The run as it is, and one with everything that the law of the joint knows; with the five starts' parameters."""
    easy, _ = box.parameters(STARTS_KG)
    hard = easy.copy()
    terms = {
        "coulomb": 0.01,
        "viscous": 0.005,
        "load_friction": 0.05,
        "stribeck": 0.2,
        "delay": 0.004,
        "tilt": 0.01,
    }
    for name, value in terms.items():
        hard[:, SPHERE_INDEX[name]] = value
    hard[:, SPHERE_INDEX["start_y"]] = 0.004
    joint = replace(
        box.run.joint,
        input_times_s=np.array([0.0, 0.2, 0.4]),
        input_current_A=CURRENT_A * np.array([1.0, 0.3, 3.0]),
        supply=(12.0, 2.49, 5.22),
        fine_step_s=box.run.joint.step_s / 4.0,
    )
    return [
        ("the recording", box.run, easy),
        ("with friction, delay, switches", replace(box.run, joint=joint), hard),
    ]


def apart(
    ours: Sequence[np.ndarray],
    theirs: Sequence[np.ndarray],
) -> float:
    """Largest difference, relative to the largest number of each array."""
    return max(
        float(np.abs(a - b).max() / np.abs(b).max()) for a, b in zip(ours, theirs, strict=True)
    )


def share_in_contact(simulator: SphereSimulator, p: np.ndarray) -> float:
    """In how many of the samples the sphere touches a wall."""
    x = states_of(
        simulator,
        np.zeros(len(p), dtype=np.int32),
        p,
    )[2]
    return float((np.abs(x) > simulator.enclosure.room).any(axis=2).mean())


LOWERED = (START_RAD, (CURRENT_A,), DURATION_S)
SHAKEN = (0.74, (0.08, -0.36), 0.1)
"""Start [rad], currents that take turns [A], how long each lasts [s]: the box is lowered through level, or shaken about it."""
SUBSTEPS = 64
FINE_STEP_S = 1e-5


def moved_run(
    box: Boxed,
    probe: tuple[float, tuple[float, ...], float],
    contact: Contact,
    mass: float,
) -> tuple[SphereRun, np.ndarray]:
    """The run and the parameters (P,) of a motion, the sphere at rest in a corner when it begins."""
    start_rad, currents, lasting_s = probe
    switches = lasting_s * np.arange(round(DURATION_S / lasting_s))
    joint = replace(
        box.run.joint,
        input_times_s=switches,
        input_current_A=np.resize(currents, len(switches)),
        supply=(0.0, 0.0, 1.0),
    )
    run = replace(box.run, joint=joint)
    p = box.parameters([mass])[0][0]
    gravity = run.gravity_at(start_rad)
    start = np.sign(gravity) * (box.facts.enclosure.room + np.abs(gravity) / contact.stiffness)
    start[np.abs(gravity) < 1e-9] = 0.0
    told = {
        "q0": start_rad,
        "start_x": start[0],
        "start_y": start[1],
        "start_z": start[2],
    }
    told |= {
        name: getattr(contact, name) for name in ("stiffness", "damping", "traction", "friction")
    }
    for name, value in told.items():
        p[SPHERE_INDEX[name]] = value
    return run, p


def bias_of_steps(
    box: Boxed,
    probe: tuple[float, tuple[float, ...], float],
    contact: Contact,
    law: str,
    integrator: str,
    step_s: float,
) -> float:
    """How far off the mass is that fits the same law at a fine step, relative to it."""
    run, p = moved_run(box, probe, contact, SPHERE_KG)

    def stepped(integrator: str, step_s: float) -> SphereSimulator:
        joint = replace(run.joint, step_s=step_s, fine_step_s=step_s)
        return SphereSimulator(
            [replace(run, joint=joint)],
            box.facts.enclosure,
            law,
            integrator,
        )

    world = np.zeros(1, dtype=np.int32)
    row = SPHERE_INDEX["sphere_mass"]
    by_mass = np.zeros((1, len(p), 1))
    by_mass[0, row] = 1.0
    true = (
        stepped("rk4", FINE_STEP_S)
        .jacobian(
            world,
            p[None],
            by_mass,
        )[0][0]
        .copy()
    )
    simulator = stepped(integrator, step_s)
    found = p.copy()
    for _ in range(15):
        q, _, dq = simulator.jacobian(
            world,
            found[None],
            by_mass,
        )
        slope = dq[0, :, 0]
        found[row] += np.clip(
            slope @ (true - q[0]) / (slope @ slope), -0.2 * SPHERE_KG, 0.2 * SPHERE_KG
        )
    return float(found[row] / SPHERE_KG - 1.0)


def _forward_rows(box: Boxed) -> list[Row]:
    if shutil.which("gcc") is None:
        return [Row("plain C, a sphere's forward pass", note="skipped: no gcc")]
    rows = []
    for name, run, p in easy_and_hard(box):
        simulator = SphereSimulator([run], box.facts.enclosure)
        states, launch = record_forward(
            simulator,
            np.zeros(len(p), dtype=np.int32),
            p,
        )
        launch.launch()
        with tempfile.TemporaryDirectory() as folder:
            plain = SpherePass(simulator, p, folder)
            off = apart(parts(states), plain())
            what = f"gcc {' '.join(FLAGS)}, sphere's forward pass, {name}"
            if not off <= EQUAL:
                rows.append(Row(what, None, "void", False, f"results differ by {off:.1e}"))
                continue
            theirs, ours = measure_in_turn(
                (plain, launch.launch), repeats=25, calls=(20, 20), warm_up=5
            )
        ratio = ours.median / theirs.median
        touching = f"in contact in {100 * share_in_contact(simulator, p):.0f} % of the samples"
        rows.append(Row(what, theirs, note=f"same numbers to {off:.0e}, {touching}"))
        rows.append(
            Row(
                "  our recorded launch",
                ours,
                f"{ratio:.2f}x C (goal <= {C_GOAL:g}x)",
                ratio <= C_GOAL,
            )
        )
    return rows


def _tangent_rows(box: Boxed) -> list[Row]:
    simulator = box.problem.simulator.special
    p, dp = box.parameters(STARTS_KG)
    worlds = np.zeros(len(p), dtype=np.int32)
    _, forward = record_forward(simulator, worlds, p)

    def passing(directions: int) -> Callable[[], object]:
        given = np.zeros((*p.shape, directions))
        given[..., : dp.shape[2]] = dp[..., :directions]
        given.setflags(write=False)
        return lambda: simulator.jacobian(worlds, p, given)

    sizes = simulator.tangent_sizes[:3]
    base, *passes = measure_in_turn(
        (forward.launch, *(passing(size) for size in sizes)),
        repeats=15,
        calls=(10,) * (1 + len(sizes)),
        warm_up=3,
    )
    return [
        Row(
            f"ours: tangent pass, five worlds, {size} directions",
            timing,
            f"{timing.median / base.median:.1f}x forward",
        )
        for size, timing in zip(sizes, passes, strict=True)
    ]


def _fit_rows(
    what: str,
    mass_alone: bool,
    fuller: Timing | None = None,
) -> list[Row]:
    """Our fit and MuJoCo's, of the same unknowns; ``fuller`` is the time of our fit of more of them."""
    import mujoco

    box = pose(by_mujoco, mass_alone=mass_alone)
    answer = box.solve()
    masses = box.masses(answer.internal)
    best = masses[answer.best]
    rows: list[Row] = []
    for integrator, step_s in MUJOCO_SETTINGS:
        solve = Kept(MujocoFit(box, step_s, integrator))
        theirs, ours = measure_in_turn(
            (solve, box.solve), 9 if mass_alone else 3, (1, 5), warm_up=0
        )
        their_masses, costs, rollouts = solve.answer
        their_best = their_masses[int(np.argmin(costs))]
        if not rows:
            ending = _ending(masses, best, f"{answer.iterations} iterations")
            rows.append(
                Row(f"ours: sphere in a box, five starts, unknown {what}", ours, note=ending)
            )
        effort = f"{rollouts} rollouts"
        if fuller is not None:
            effort += f"; {theirs.median / fuller.median:.0f}x our fit of all"
        ratio = theirs.median / ours.median
        row = Row(
            f"  MuJoCo {mujoco.__version__} ({integrator}, {1e3 * step_s:g} ms) + least_squares",
            theirs,
            f"{ratio:.0f}x",
            note=_ending(their_masses, their_best, effort),
        )
        if not max(abs(best / SPHERE_KG - 1.0), abs(their_best / SPHERE_KG - 1.0)) <= AGREEMENT:
            row = replace(row, ratio="void", passed=False)
        elif len(rows) == 1:
            row = replace(
                row, ratio=f"{row.ratio} (goal >= {MUJOCO_GOAL:g}x)", passed=ratio >= MUJOCO_GOAL
            )
        rows.append(row)
    return rows


def _ending(
    masses: np.ndarray,
    best: float,
    effort: str,
) -> str:
    ends = ", ".join(f"{1e3 * mass:.2f}" for mass in masses)
    return f"found {1e3 * best:.2f} g ({100.0 * (best / SPHERE_KG - 1.0):+.1f} %), starts {ends}; {effort}"


def _whole_rows() -> list[Row]:
    """All of ``find_sphere`` on recordings that come with the package."""
    bags, robot = REPOSITORY / "bags", load_robot(DEFAULT_ROBOT)

    def runs(pattern: str) -> list[Run]:
        found = sorted(bags.glob(f"realistic_s00_{pattern}"))
        return [run for path in found for run in bag_runs(path / "bag_mcap", Request(robot))]

    calibrated = calibrate(robot, [LoadedRun(run) for run in runs("empty_*")]).calibration
    assert calibrated is not None
    robot = robot.with_calibration(calibrated)
    facts = container_facts(Settings({}), probe_file("container"))
    (run,), baseline = runs("container_sphere_12g_joint4_*"), runs("container_no_sphere_*")
    timing = measure(
        lambda: find_sphere(robot, [run], facts, None, baseline),
        repeats=REPEATS,
    )
    estimate = find_sphere(robot, [run], facts, None, baseline)
    value = estimate.value("sphere_mass")
    found = (
        f"{1e3 * value.value:.1f} +- {1e3 * value.std:.1f} g"
        if value.value is not None
        else value.reason
    )
    what = f"ours: find_sphere() in total, one run and {len(baseline)} of the empty container"
    note = f"{estimate.verdict.value}: {found}, truth 12 g; calibrated robot"
    within = timing.fastest <= WHOLE_GOAL_S
    return [Row(what, timing, f"{timing.fastest:.2f} s (goal <= {WHOLE_GOAL_S:g} s)", within, note)]


def _bias_rows(box: Boxed) -> list[Row]:
    """What the step does to the mass, each law against itself at a fine step."""
    ours_s = box.run.joint.step_s
    rows = []
    for law, contact in (("ramped", box.facts.contact), ("paper", paper_contact(SPHERE_KG))):
        for integrator, step_s, steps in (
            ("rk4", ours_s, f"rk4, steps of {1e3 * ours_s:g} ms"),
            ("semi_implicit", FRAME_S / SUBSTEPS, f"semi-implicit, {SUBSTEPS} substeps of 1/60 s"),
        ):
            timing = _forward_timing(box, contact, law, integrator, step_s)
            biases = ", ".join(
                f"{name} {100.0 * bias_of_steps(box, probe, contact, law, integrator, step_s):+.4f} %"
                for name, probe in (("lowered", LOWERED), ("shaken", SHAKEN))
            )
            rows.append(
                Row(
                    f"ours: forward pass, law {law}, {steps}",
                    timing,
                    note=f"bias of the mass: {biases}",
                )
            )
    return rows


def _forward_timing(
    box: Boxed,
    contact: Contact,
    law: str,
    integrator: str,
    step_s: float,
) -> Timing:
    """Of the lowered container from five starts.

    Args:
        box: The recording and the problem.
        contact: Of sphere and walls.
        law: Of the contact.
        integrator: Ours.
        step_s: Its step [s].
    """
    run, p = moved_run(box, LOWERED, contact, SPHERE_KG)
    joint = replace(run.joint, step_s=step_s, fine_step_s=step_s)
    simulator = SphereSimulator([replace(run, joint=joint)], box.facts.enclosure, law, integrator)
    worlds = np.zeros(len(STARTS_KG), dtype=np.int32)
    _, forward = record_forward(simulator, worlds, np.tile(p, (len(STARTS_KG), 1)))
    return measure(forward.launch, repeats=15, calls=10, warm_up=3)


def rows(case: Case) -> list[Row]:
    """The comparisons; the benchmark's own recording is not used."""
    box = pose()
    found = [
        *_forward_rows(box),
        *_tangent_rows(box),
        *_bias_rows(box),
    ]
    if find_spec("mujoco") is None:
        found.append(
            Row("MuJoCo, sphere in a box, five starts", note="skipped: needs pip install mujoco")
        )
    else:
        full = _fit_rows("mass, place, q0 and v0", mass_alone=False)
        found += [
            *full,
            *_fit_rows(
                "mass alone",
                mass_alone=True,
                fuller=full[0].timing,
            ),
        ]
    return [*found, *_whole_rows()]
