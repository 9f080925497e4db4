"""The speed table: one recording, one problem, five first guesses, and who needs how long to find the mass.

The recording is one that comes with the package, of a robot without friction in MuJoCo, so that general tools need no law of
friction: 50 g at the elbow. Unknown are the mass and where and how fast the joint began, under the same priors for everyone; the
paper's way knows the mass only. Each has its library loaded and its kernels compiled.
"""

from __future__ import annotations

import io
import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from proprio_ros.addons.paper.cases import one_lift
from proprio_ros.addons.paper.hand import stated_robot
from proprio_ros.addons.paper.ways import Answer, ours, paper_mass, timed
from proprio_ros.errors import ConfigurationError
from proprio_ros.identification.solvers import levenberg_marquardt
from proprio_ros.inputs.resources import share_directory
from proprio_ros.pipeline.loading import bag_runs
from proprio_ros.pipeline.request import Request
from proprio_ros.probes.payload.identify import weigh
from proprio_ros.robot import inertia_about_origin
from proprio_ros.sim.joint import INDEX
from proprio_ros.sim.payload import PayloadFacts, PayloadShape

BAG = "quantised_s00_fixed_heavy_ball_50g_joint3"
TRUE_KG = 0.05
STARTS_KG = (0.005, 0.016, 0.05, 0.16, 0.5)
RTOL = 1e-8
ATOL = 1e-10


class _Case:
    """The recording and the problem that everyone solves."""

    def __init__(self) -> None:
        robot = stated_robot()
        (run,) = bag_runs(share_directory() / "bags" / BAG / "bag_mcap", Request(robot))
        self.robot = robot
        self.run = run
        self.facts = PayloadFacts(shape=PayloadShape.of("sphere", 0.04))
        self.problem = one_lift(robot, run, self.facts)
        (self.prepared,) = self.problem.runs
        names = [self.problem.unknowns[row].kind for row in self.problem.estimated]
        if names != ["payload_mass", "q0", "v0"] or len(run.input_times_s) != 1:
            wanted = "the comparison wants one constant current, and a robot file without friction"
            raise ConfigurationError(f"{BAG}: {wanted}")
        first = np.tile(
            self.problem.coordinates.prior_mean,
            (len(STARTS_KG), 1),
        )
        first[:, 0] = STARTS_KG
        self.starts = self.problem.coordinates.internal(first)

    def masses(self, internal: np.ndarray) -> np.ndarray:
        """[kg], shape (S,)."""
        return self.problem.coordinates.physical(internal)[:, 0]


def speed(seed: int) -> dict[str, Any]:
    """The table; the recording is the same for every seed, and the times are taken again."""
    case = _Case()
    whole = ours(
        partial(weigh, case.robot, [case.run], case.facts),
        "payload_mass",
    )
    rows = [whole.row(way="ours: weighing with interval and verdict", truth=TRUE_KG)]
    for way, solve in (
        ("ours: the search alone", _ours),
        ("scipy: least_squares and solve_ivp", _scipy),
    ):
        rows.append(_row(way, *timed(solve(case))))
    theirs = paper_mass(case.robot, case.run, case.facts)
    return {
        "rows": [
            *rows,
            theirs.row(way="the paper's way", truth=TRUE_KG),
            _sysid_row(case),
        ]
    }


def _row(
    way: str,
    mass: float | None,
    seconds: float | None = None,
    why: str = "",
) -> dict[str, Any]:
    return Answer(mass, seconds=seconds, why=why).row(
        way=way,
        truth=TRUE_KG,
    )


def _ours(case: _Case) -> Callable[[], float]:
    def solve() -> float:
        found = levenberg_marquardt(case.problem, case.starts, case.problem.simulator.windows)
        return float(case.masses(found.internal)[found.best])

    return solve


def _scipy(case: _Case) -> Callable[[], float]:
    """scipy's general tools: DOP853 at a relative tolerance of 1e-8, Jacobian by forward differences."""
    from scipy.optimize import least_squares

    coordinates = case.problem.coordinates
    prepared = case.prepared
    weight = np.sqrt(np.diag(coordinates.prior_precision))
    positions = _rolled_by_scipy(case)

    def residual(internal: np.ndarray) -> np.ndarray:
        now = coordinates.physical(internal)
        off = (positions(now) - prepared.position) / prepared.sigma
        return np.append(off, ((now - coordinates.prior_mean) * weight)[1:])

    def solve() -> float:
        ends = [
            least_squares(residual, start, x_scale=coordinates.natural) for start in case.starts
        ]
        best = ends[int(np.argmin([end.cost for end in ends]))]
        return float(case.masses(best.x[None])[0])

    return solve


def _rolled_by_scipy(case: _Case) -> Callable[[np.ndarray], np.ndarray]:
    """Positions at the samples (T,) [rad] by mass, position and velocity at the start, shape (3,)."""
    from scipy.integrate import solve_ivp

    values = case.problem.coordinates.prior_mean[None].copy()
    values[0, 0] = 0.0
    p, dp = case.problem.parameters(
        case.problem.all_values(values),
        case.problem.estimated,
    )
    empty = p[0, 0]
    per_kg = dp[0, 0, :, 0]
    torque = empty[INDEX["torque_constant"]] * float(case.run.input_current_A[0])
    times = case.prepared.times_s - empty[INDEX["delay"]]
    span = (0.0, float(times[-1]))

    def positions(now: np.ndarray) -> np.ndarray:
        inertia, cosine, sine, constant = (empty + now[0] * per_kg)[:4]

        def law(_t: float, y: np.ndarray) -> tuple[float, float]:
            q, v = y.tolist()
            return v, (torque - cosine * math.cos(q) - sine * math.sin(q) - constant) / inertia

        rolled = solve_ivp(law, span, now[1:], "DOP853", times, rtol=RTOL, atol=ATOL)
        found: np.ndarray = rolled.y[0]
        return found

    return positions


def _sysid_row(case: _Case) -> dict[str, Any]:
    try:
        from absl import logging
        from mujoco import sysid

        sysid.optimize  # noqa: B018 - a part of an extra: is it there?
    except (ImportError, AttributeError):
        return _row("mujoco.sysid", None, why="not installed")
    logging.set_verbosity(logging.ERROR)
    step_s = float(case.problem.simulator.runs[0].step_s)
    (_, mass), seconds = timed(SysidSearch(case, step_s))
    return _row("mujoco.sysid", mass, seconds)


class SysidSearch:
    """MuJoCo's own system identification, set up in its favour: held joints welded, constraints off, no resampling, RK4."""

    def __init__(self, case: _Case, step_s: float) -> None:
        from mujoco import sysid

        self._case = case
        self._prepared = case.prepared
        self._coordinates = case.problem.coordinates
        spec = welded(case, step_s)
        self._model = spec.compile()
        last_s = self._prepared.times_s[-1]
        times = step_s * np.arange(int(np.ceil(last_s / step_s - 1e-9)) + 1)
        current = np.full((len(times), 1), case.run.input_current_A[0])
        encoder = sysid.TimeSeries.from_names(
            self._prepared.times_s,
            self._prepared.position[:, None],
            self._model,
        )
        rest = np.array([self._prepared.rest.value])
        sequences = sysid.ModelSequences(
            "arm",
            spec,
            "probe",
            sysid.create_initial_state(self._model, rest),
            sysid.TimeSeries(times, current),
            encoder,
        )
        self._residual = sysid.build_residual_fn(
            models_sequences=[sequences],
            modify_residual=self._whitened,
            custom_rollout=self._rollout,
            resample_true=False,
        )

    def _rollout(
        self,
        models: Any,
        datas: Any,
        control_signal: Any,
        param_dicts: Any,
        initial_states: Any,
        **maps: Any,
    ) -> Any:
        """One recording, so one state per column of finite differences."""
        from mujoco import sysid

        states = [
            sysid.create_initial_state(self._model, one["q0"].value, one["v0"].value)
            for one in param_dicts
        ]
        names = ("rollout_signal_mapping", "rollout_state_mapping", "ctrl_mapping")
        return sysid.sysid_rollout(
            models=models,
            datas=datas,
            control_signal=control_signal,
            initial_states=states,
            **{name: maps[name] for name in names},
        )

    def _whitened(
        self,
        params: Any,
        predicted: Any,
        measured: Any,
        model: Any,
        everything: bool,
        state: Any,
    ) -> Any:
        """The same residual and priors as everyone's."""
        values = params.as_vector()
        prepared = self._prepared
        coordinates = self._coordinates
        seen = np.interp(
            prepared.times_s,
            np.append(0.0, state[:, 0]),
            np.append(values[1], state[:, 1]),
        )
        off = (seen - prepared.position) / prepared.sigma
        weight = np.sqrt(np.diag(coordinates.prior_precision))
        prior = ((values - coordinates.prior_mean) * weight)[1:]
        return np.concatenate([off, prior])[:, None], measured, measured

    def _guess(self, mass: float) -> Any:
        """The unknowns with a first guess of the mass [kg]."""
        from mujoco import sysid

        rest = self._prepared.rest.value
        speed_at_start = self._coordinates.prior_mean[2]
        first = sysid.ParameterDict()
        first.add(sysid.Parameter("mass", mass, 1e-4, 2.0, modifier=self._heavier))
        first.add(sysid.Parameter("q0", rest, rest - 0.1, rest + 0.1))
        first.add(sysid.Parameter("v0", speed_at_start, -1.0, 1.0))
        return first

    def _heavier(self, spec: Any, parameter: Any) -> None:
        set_mass(spec.body("payload"), float(parameter.value[0]), self._case)

    def __call__(self) -> tuple[np.ndarray, float]:
        """Where the search ends from all starts, shape (5,), and the best of these [kg]."""
        from mujoco import sysid

        masses = []
        costs = []
        for mass in STARTS_KG:
            found, _ = sysid.optimize(
                self._guess(mass),
                self._residual,
                verbose=False,
                output=io.StringIO(),
            )
            (end,), _, _ = self._residual(found.as_vector(), found)
            masses.append(float(found["mass"].value[0]))
            costs.append(float(end @ end))
        return np.array(masses), masses[int(np.argmin(costs))]


def welded(case: _Case, step_s: float) -> Any:
    """``MjSpec`` of the arm with one hinge, and a payload body at the payload frame; RK4 with that step, no constraints."""
    import mujoco

    spec = mujoco.MjSpec.from_file(str(share_directory() / "urdf" / "open_manipulator_x.urdf"))
    spec.compiler.fusestatic = False  # the payload must stay a body of its own
    for equality in list(spec.equalities):
        spec.delete(equality)
    positions = dict(case.run.held)
    for joint in case.robot.model.joints:
        if joint.mimic is not None:
            source, multiplier, offset = joint.mimic
            positions[joint.name] = multiplier * positions[source] + offset
    for joint in list(spec.joints):
        if joint.name == case.run.joint:
            joint.armature = case.prepared.drive.armature.value
        else:
            _weld(spec, joint, positions[joint.name])
    payload = spec.body(case.robot.payload_frame).add_body(name="payload", pos=case.facts.com)
    payload.explicitinertial = True
    set_mass(payload, STARTS_KG[0], case)
    _instrument(spec, case)
    spec.option.gravity = case.robot.gravity
    spec.option.timestep = step_s
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    off = mujoco.mjtDisableBit
    spec.option.disableflags = int(off.mjDSBL_CONSTRAINT | off.mjDSBL_CONTACT | off.mjDSBL_LIMIT)
    return spec


def _weld(spec: Any, joint: Any, position: float) -> None:
    """Put a joint's body where the joint is held [rad, m], and take the joint away."""
    import mujoco

    body = joint.parent
    axis = np.array(joint.axis)
    if joint.type == mujoco.mjtJoint.mjJNT_SLIDE:
        moved = np.zeros(3)
        mujoco.mju_rotVecQuat(moved, axis * position, np.array(body.quat))
        body.pos = np.array(body.pos) + moved
    else:
        turn = np.zeros(4)
        turned = np.zeros(4)
        mujoco.mju_axisAngle2Quat(turn, axis, position)
        mujoco.mju_mulQuat(turned, np.array(body.quat), turn)
        body.quat = turned
    spec.delete(joint)


def _instrument(spec: Any, case: _Case) -> None:
    """The motor that drives the hinge by a current [A], and the encoder that sees it."""
    import mujoco

    hinge = case.run.joint
    motor = spec.add_actuator(name="motor", target=hinge, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    motor.gainprm[0] = case.prepared.drive.torque_constant.value
    spec.add_sensor(
        name="encoder",
        type=mujoco.mjtSensor.mjSENS_JOINTPOS,
        objtype=mujoco.mjtObj.mjOBJ_JOINT,
        objname=hinge,
    )


def set_mass(body: Any, mass: float, case: _Case) -> None:
    """Give the payload body a mass [kg], and the inertia that goes with it.

    Args:
        body: Of MuJoCo's specification.
        mass: What it weighs [kg].
        case: Whose payload it is.
    """
    body.mass = mass
    body.inertia = mass * np.diag(inertia_about_origin(case.facts.shape.second_moment_per_mass))
