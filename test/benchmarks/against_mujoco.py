"""The same identification by ``mujoco.sysid``, MuJoCo's own system identification (finite differences, box-bounded LM).

Set up in MuJoCo's favour: held joints welded, constraints off, no resampling, and RK4 with our step, the cheapest setting with
our accuracy (its default, Euler at 2 ms, is a gram off). Same samples, weights, priors and starts as ours.
"""

from __future__ import annotations

import io
from typing import Any

import numpy as np
from case import REPOSITORY, STARTS_KG, Case, Row, compare

GOAL = 30.0


def model_spec(case: Case) -> Any:
    """``MjSpec`` of the arm with one hinge, and a payload body at the payload frame."""
    import mujoco

    spec = mujoco.MjSpec.from_file(str(REPOSITORY / "urdf" / "open_manipulator_x.urdf"))
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
            continue
        body, axis, q = joint.parent, np.array(joint.axis), positions[joint.name]
        if joint.type == mujoco.mjtJoint.mjJNT_SLIDE:
            moved = np.zeros(3)
            mujoco.mju_rotVecQuat(moved, axis * q, np.array(body.quat))
            body.pos = np.array(body.pos) + moved
        else:
            turn, turned = np.zeros(4), np.zeros(4)
            mujoco.mju_axisAngle2Quat(turn, axis, q)
            mujoco.mju_mulQuat(turned, np.array(body.quat), turn)
            body.quat = turned
        spec.delete(joint)
    payload = spec.body(case.robot.payload_frame).add_body(name="payload", pos=case.facts.com)
    payload.explicitinertial = True
    _set_mass(payload, STARTS_KG[0], case)
    motor = spec.add_actuator(name="motor", target=case.run.joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    motor.gainprm[0] = case.prepared.drive.torque_constant.value
    spec.add_sensor(
        name="encoder", type=mujoco.mjtSensor.mjSENS_JOINTPOS, objtype=mujoco.mjtObj.mjOBJ_JOINT, objname=case.run.joint
    )
    spec.option.gravity = case.robot.gravity
    spec.option.timestep = case.step_s
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    disable = mujoco.mjtDisableBit
    spec.option.disableflags = int(disable.mjDSBL_CONSTRAINT | disable.mjDSBL_CONTACT | disable.mjDSBL_LIMIT)
    return spec


def _set_mass(body: Any, mass: float, case: Case) -> None:
    spread = case.facts.shape.second_moment_per_mass
    body.mass = mass
    body.inertia = mass * np.diag(np.trace(spread) * np.eye(3) - spread)


def identify(case: Case) -> Any:
    """A function that identifies from five starts and returns where they end and the best [kg]."""
    from mujoco import sysid

    spec = model_spec(case)
    prepared, coordinates = case.prepared, case.problem.coordinates
    steps = int(np.ceil(prepared.times_s[-1] / case.step_s - 1e-9))
    times = case.step_s * np.arange(steps + 1)
    model = spec.compile()
    control = sysid.TimeSeries(times, np.full((steps + 1, 1), case.run.input_current_A[0]))
    encoder = sysid.TimeSeries.from_names(prepared.times_s, prepared.position[:, None], model)
    initial = sysid.create_initial_state(model, np.array([prepared.rest.value]))
    sequences = sysid.ModelSequences("arm", spec, "probe", initial, control, encoder)

    def rollout(
        models: Any, datas: Any, control_signal: Any, param_dicts: Any, initial_states: Any, **maps: Any
    ) -> Any:
        states = [
            sysid.create_initial_state(model, params["q0"].value, params["v0"].value) for params in param_dicts
        ]  # one recording, so one state per column of finite differences
        return sysid.sysid_rollout(
            models=models,
            datas=datas,
            control_signal=control_signal,
            initial_states=states,
            rollout_signal_mapping=maps["rollout_signal_mapping"],
            rollout_state_mapping=maps["rollout_state_mapping"],
            ctrl_mapping=maps["ctrl_mapping"],
        )

    def whitened(params: Any, predicted: Any, measured: Any, model: Any, everything: bool, state: Any) -> Any:
        values = params.as_vector()
        seen = np.interp(prepared.times_s, np.append(0.0, state[:, 0]), np.append(values[1], state[:, 1]))
        residual = (seen - prepared.position) / prepared.sigma
        prior = ((values - coordinates.prior_mean) * np.sqrt(np.diag(coordinates.prior_precision)))[1:]
        return np.concatenate([residual, prior])[:, None], measured, measured

    residual = sysid.build_residual_fn(
        models_sequences=[sequences], modify_residual=whitened, custom_rollout=rollout, resample_true=False
    )

    def start(mass: float) -> Any:
        params = sysid.ParameterDict()
        params.add(
            sysid.Parameter(
                "mass", mass, 1e-4, 2.0, modifier=lambda s, p: _set_mass(s.body("payload"), float(p.value[0]), case)
            )
        )
        rest, still = prepared.rest, coordinates.prior_mean[2]
        params.add(sysid.Parameter("q0", rest.value, rest.value - 0.1, rest.value + 0.1))
        params.add(sysid.Parameter("v0", still, -1.0, 1.0))
        return params

    def solve() -> tuple[np.ndarray, float]:
        masses, costs = [], []
        for mass in STARTS_KG:
            found, _ = sysid.optimize(start(mass), residual, verbose=False, output=io.StringIO())
            masses.append(found["mass"].value[0])
            (end,), _, _ = residual(found.as_vector(), found)
            costs.append(0.5 * float(end @ end))
        return np.array(masses), float(masses[int(np.argmin(costs))])

    return solve


def rows(case: Case) -> list[Row]:
    """The comparison, or why there is none."""
    what = "mujoco.sysid, five starts"
    try:
        import mujoco
        from absl import logging
        from mujoco import sysid
    except ImportError:
        return [Row(what, note="skipped: needs pip install 'mujoco[sysid]>=4'")]
    if not hasattr(sysid, "optimize"):
        return [Row(what, note="skipped: needs the extra, pip install 'mujoco[sysid]>=4'")]
    logging.set_verbosity(logging.ERROR)  # it warns of a light start near its bound
    return [compare(f"{what} (MuJoCo {mujoco.__version__}, RK4)", identify(case), GOAL, case)]
