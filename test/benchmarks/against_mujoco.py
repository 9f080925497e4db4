"""The same identification by ``mujoco.sysid``, MuJoCo's own system identification (finite differences, box-bounded LM).

Set up in MuJoCo's favour: held joints welded, constraints off, no resampling, and RK4 with our step, the cheapest setting with
our accuracy (its default, Euler at 2 ms, is a gram off). Same samples, weights, priors and starts as ours.
"""

from __future__ import annotations

import io
from typing import Any

import numpy as np
from case import STARTS_KG, Case, Row, compare

from proprio_ros.paper.speed import set_mass, welded

GOAL = 30.0


def identify(case: Case) -> Any:
    """A function that identifies from five starts and returns where they end and the best [kg]."""
    from mujoco import sysid

    spec = welded(case, case.step_s)
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
                "mass", mass, 1e-4, 2.0, modifier=lambda s, p: set_mass(s.body("payload"), float(p.value[0]), case)
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
