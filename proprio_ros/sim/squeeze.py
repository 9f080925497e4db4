"""A gripper that closes on a soft block: one driven joint, and the block's tabulated resistance.

The joint of ``joint.py`` (armature, friction, supply limits, delay) with the block as a load that depends on its position:

    s = (c(q) - gap) / L                                      squeeze relative to the block's length
    P = A (E phi(s, nu) + eta ds/dt min(s / s_r, 1))          where s > 0, and never below 0: a block that is let go does not pull
    J a = tau_m - friction - gravity - c'(q) P

``c`` is how far the fingers have closed on each other: ``travel`` times the joint's coordinate, twice the ratio of one finger;
with ``bend``, where it was measured that a gripper's linkage does not close evenly. ``c'`` stands in both lines by virtual work.
``phi`` is the table of ``response.py``, E and nu are those at small strain, whatever the law. ``eta`` is the block's viscosity
(Kelvin and Voigt), which sets in over the first ``RAMP`` of squeeze, so that the force has no jump where the fingers touch.

Departures from the paper: its block has inertia of its own and its gripper neither armature nor friction. The armature, 15 to
76 kg at the finger, is what decides; that the block is in equilibrium at every instant changes the encoder by a tenth of a
count (``softbody.py`` is the paper's way, and the test's oracle).

Derivatives as in ``joint.py``: forward sensitivities in the rollout, and ``wp.Tape`` over a kernel that keeps every state.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import warp as wp

from proprio_ros.errors import SimulationError
from proprio_ros.sim.joint import (
    _VEC2,
    PARAMETERS,
    TIME_EPS,
    JointRun,
    JointSimulator,
    _acceleration,
    linearised_law,
)
from proprio_ros.sim.response import Response, tabulated
from proprio_ros.sim.runtime import FLOAT

BLOCK_TERMS = ("youngs_modulus", "poissons_ratio", "block_viscosity", "gap")
"""What a block adds to the parameters of ``joint.py``: Pa, 1, Pa s, m."""
SQUEEZE_PARAMETERS = (*PARAMETERS, *BLOCK_TERMS)
SQUEEZE_INDEX = {name: row for row, name in enumerate(SQUEEZE_PARAMETERS)}
RAMP = 1e-3
"""s_r: relative squeeze over which the viscosity sets in."""
_E, _NU, _ETA, _GAP = (SQUEEZE_INDEX[name] for name in BLOCK_TERMS)
_VEC4 = wp.types.vector(length=4, dtype=FLOAT)
_SIZES = (1, 4, 8, 12, 18)


@dataclass(frozen=True)
class SqueezeRun:
    """One closing of the gripper on the block.

    Attributes:
        joint: what drives the joint and when it is looked at.
        length: of the block along the squeeze [m].
        area: of the face that is pushed [m^2].
        travel: how fast the fingers close on each other per unit of the joint [m/rad, or m/m], not 0; negative where the joint's
            coordinate falls when closing.
        response: of the block in this run's orientation and contact.
        bend: what the second and the third power of the joint's coordinate add to that closing [m/rad^2, m/rad^3].

    Raises:
        SimulationError: a length or area that is not above 0, or no travel.
    """

    joint: JointRun
    length: float
    area: float
    travel: float
    response: Response
    bend: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        if not (self.length > 0.0 and self.area > 0.0 and np.isfinite(self.travel) and self.travel != 0.0):
            raise SimulationError(
                f"a block of length {self.length:g} m and face {self.area:g} m^2 between fingers that close by {self.travel:g} m: "
                "the first two must be above 0, the last not 0"
            )


@wp.func
def _push(
    q: FLOAT,
    v: FLOAT,
    p: wp.array2d(dtype=FLOAT),
    world: wp.int32,
    block: wp.array2d(dtype=FLOAT),
    run: wp.int32,
    grid: wp.array(dtype=FLOAT),
    nodes: wp.array3d(dtype=_VEC4),
):
    """Load of the block on the joint, and its derivatives: by q and v, and by E, nu, eta and gap."""
    zero = FLOAT(0.0)
    length = block[run, 0]
    area = block[run, 1]
    closed = q * (block[run, 2] + q * (block[run, 4] + q * block[run, 5]))
    travel = block[run, 2] + q * (FLOAT(2.0) * block[run, 4] + FLOAT(3.0) * q * block[run, 5])
    bend = FLOAT(2.0) * block[run, 4] + FLOAT(6.0) * q * block[run, 5]
    s = (closed - p[world, _GAP]) / length
    load = zero
    by_q = zero
    by_v = zero
    by_p = _VEC4()
    if s > zero:
        modulus = p[world, _E]
        eta = p[world, _ETA]
        phi, by_s, by_nu = tabulated(s, p[world, _NU], wp.int32(block[run, 3]), grid, nodes)
        rate = travel * v / length
        ramp = s / FLOAT(RAMP)
        rise = FLOAT(1.0) / FLOAT(RAMP)
        if ramp > FLOAT(1.0):
            ramp = FLOAT(1.0)
            rise = zero
        push = area * (modulus * phi + eta * rate * ramp)
        if push > zero:
            load = travel * push
            slope = travel * area * (modulus * by_s + eta * rate * rise) / length
            by_q = slope * travel + bend * (push + travel * area * eta * ramp * v / length)
            by_v = travel * area * eta * ramp * travel / length
            by_p = _VEC4(travel * area * phi, travel * area * modulus * by_nu, travel * area * rate * ramp, -slope)
    return load, by_q, by_v, by_p


@wp.func
def _block_load(
    q: FLOAT,
    v: FLOAT,
    p: wp.array2d(dtype=FLOAT),
    world: wp.int32,
    block: wp.array2d(dtype=FLOAT),
    run: wp.int32,
    grid: wp.array(dtype=FLOAT),
    nodes: wp.array3d(dtype=_VEC4),
):
    load, _by_q, _by_v, _by_p = _push(q, v, p, world, block, run, grid, nodes)
    return load


@cache
def _tangent_kernel(directions: int, integrator: str, stribeck: bool) -> Any:
    """Rollout with ``directions`` exact forward sensitivities in the same thread (thread = world)."""
    vec = wp.types.vector(length=directions, dtype=FLOAT)
    joint_law = linearised_law(directions, stribeck)
    rk4 = integrator == "rk4"

    @wp.func
    def linearised(
        q: FLOAT,
        v: FLOAT,
        dq: vec,
        dv: vec,
        command: FLOAT,
        extra: FLOAT,
        d_extra: vec,
        p: wp.array2d(dtype=FLOAT),
        dp: wp.array2d(dtype=vec),
        w: wp.int32,
        constants: wp.array2d(dtype=FLOAT),
        block: wp.array2d(dtype=FLOAT),
        r: wp.int32,
        grid: wp.array(dtype=FLOAT),
        nodes: wp.array3d(dtype=_VEC4),
    ):
        load, by_q, by_v, by_p = _push(q, v, p, w, block, r, grid, nodes)
        d_load = by_q * dq + by_v * dv
        d_load = d_load + by_p[0] * dp[w, _E] + by_p[1] * dp[w, _NU] + by_p[2] * dp[w, _ETA] + by_p[3] * dp[w, _GAP]
        a, da = joint_law(
            q, v, dq, dv, command,
            p[w, 0], p[w, 1], p[w, 2], p[w, 3] + extra + load, p[w, 4], p[w, 5], p[w, 6], p[w, 7],
            constants[r, 0], constants[r, 1], constants[r, 2], constants[r, 3],
            dp[w, 0], dp[w, 1], dp[w, 2], dp[w, 3] + d_extra + d_load, dp[w, 4], dp[w, 5], dp[w, 6], dp[w, 7],
            p[w, 12], p[w, 13], dp[w, 12], dp[w, 13],
        )  # fmt: skip
        return a, da

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(
        # Run data:
        sample_times: wp.array2d(dtype=FLOAT),
        sample_count: wp.array(dtype=wp.int32),
        input_times: wp.array2d(dtype=FLOAT),
        input_current: wp.array2d(dtype=FLOAT),
        input_load: wp.array2d(dtype=_VEC2),
        input_count: wp.array(dtype=wp.int32),
        constants: wp.array2d(dtype=FLOAT),
        block: wp.array2d(dtype=FLOAT),
        grid: wp.array(dtype=FLOAT),
        nodes: wp.array3d(dtype=_VEC4),
        # World data in:
        world_run: wp.array(dtype=wp.int32),
        p_in: wp.array2d(dtype=FLOAT),
        dp_in: wp.array2d(dtype=vec),
        # World data out:
        q_out: wp.array2d(dtype=FLOAT),
        v_out: wp.array2d(dtype=FLOAT),
        dq_out: wp.array2d(dtype=vec),
    ):
        w = wp.tid()
        r = world_run[w]
        carried = p_in[w, 11]
        loads = input_load[r, 0]
        extra = loads[0] + carried * loads[1]
        d_extra = loads[1] * dp_in[w, 11]
        delay = p_in[w, 8]
        d_delay = dp_in[w, 8]
        vs = constants[r, 3]
        coarse = constants[r, 4]
        fine = constants[r, 5]
        half = FLOAT(0.5)
        sixth = FLOAT(1.0) / FLOAT(6.0)
        two = FLOAT(2.0)

        q = p_in[w, 9]
        v = p_in[w, 10]
        dq = dp_in[w, 9]
        dv = dp_in[w, 10]
        t = FLOAT(0.0)
        dt = vec()  # how the present instant moves with each direction: only sample instants move, with the delay
        segment = wp.int32(0)
        segments = input_count[r]
        command = input_current[r, 0]
        for k in range(sample_count[r]):
            goal = sample_times[r, k] - delay
            if goal <= FLOAT(0.0):
                q_out[w, k] = p_in[w, 9] + p_in[w, 10] * goal
                v_out[w, k] = p_in[w, 10]
                dq_out[w, k] = dp_in[w, 9] + goal * dp_in[w, 10] - p_in[w, 10] * d_delay
            else:
                arrived = wp.int32(0)
                while arrived == 0:
                    # the next event: the sample, or a change of the current before it
                    end = goal
                    d_end = -d_delay
                    switches = wp.int32(0)
                    if segment + 1 < segments:
                        if input_times[r, segment + 1] < goal:
                            end = input_times[r, segment + 1]
                            d_end = vec()
                            switches = 1
                    # the last step is taken even when it has no length: the instant may still move with the delay
                    last = wp.int32(0)
                    while last == 0:
                        a1, da1 = linearised(
                            q, v, dq, dv, command, extra, d_extra, p_in, dp_in, w, constants, block, r, grid, nodes
                        )
                        h = coarse
                        if fine < coarse:
                            if wp.abs(v) < FLOAT(20.0) * vs + wp.abs(a1) * coarse:
                                h = fine
                        dh = vec()
                        if t + h > end - FLOAT(TIME_EPS):
                            h = end - t
                            dh = d_end - dt
                            last = 1
                        if wp.static(rk4):
                            q2 = q + half * h * v
                            v2 = v + half * h * a1
                            dq2 = dq + (half * h) * dv + (half * v) * dh
                            dv2 = dv + (half * h) * da1 + (half * a1) * dh
                            a2, da2 = linearised(
                                q2,
                                v2,
                                dq2,
                                dv2,
                                command,
                                extra,
                                d_extra,
                                p_in,
                                dp_in,
                                w,
                                constants,
                                block,
                                r,
                                grid,
                                nodes,
                            )
                            q3 = q + half * h * v2
                            v3 = v + half * h * a2
                            dq3 = dq + (half * h) * dv2 + (half * v2) * dh
                            dv3 = dv + (half * h) * da2 + (half * a2) * dh
                            a3, da3 = linearised(
                                q3,
                                v3,
                                dq3,
                                dv3,
                                command,
                                extra,
                                d_extra,
                                p_in,
                                dp_in,
                                w,
                                constants,
                                block,
                                r,
                                grid,
                                nodes,
                            )
                            q4 = q + h * v3
                            v4 = v + h * a3
                            dq4 = dq + h * dv3 + v3 * dh
                            dv4 = dv + h * da3 + a3 * dh
                            a4, da4 = linearised(
                                q4,
                                v4,
                                dq4,
                                dv4,
                                command,
                                extra,
                                d_extra,
                                p_in,
                                dp_in,
                                w,
                                constants,
                                block,
                                r,
                                grid,
                                nodes,
                            )
                            mean_v = sixth * (v + two * v2 + two * v3 + v4)
                            mean_a = sixth * (a1 + two * a2 + two * a3 + a4)
                            dq = dq + (sixth * h) * (dv + two * dv2 + two * dv3 + dv4) + mean_v * dh
                            dv = dv + (sixth * h) * (da1 + two * da2 + two * da3 + da4) + mean_a * dh
                            q = q + h * mean_v
                            v = v + h * mean_a
                        else:
                            v = v + h * a1
                            dv = dv + h * da1 + a1 * dh
                            q = q + h * v
                            dq = dq + h * dv + v * dh
                        t = t + h
                        if last == 1:
                            t = end
                            dt = d_end
                    if switches == 1:
                        segment = segment + 1
                        command = input_current[r, segment]
                        loads = input_load[r, segment]
                        extra = loads[0] + carried * loads[1]
                        d_extra = loads[1] * dp_in[w, 11]
                    else:
                        arrived = 1
                q_out[w, k] = q
                v_out[w, k] = v
                dq_out[w, k] = dq

    return kernel


@cache
def _primal_step(integrator: str) -> Any:
    """The state one step later, without tangents."""
    rk4 = integrator == "rk4"

    @wp.func
    def rate(
        q: FLOAT,
        v: FLOAT,
        command: FLOAT,
        extra: FLOAT,
        p: wp.array2d(dtype=FLOAT),
        w: wp.int32,
        constants: wp.array2d(dtype=FLOAT),
        block: wp.array2d(dtype=FLOAT),
        r: wp.int32,
        grid: wp.array(dtype=FLOAT),
        nodes: wp.array3d(dtype=_VEC4),
    ):
        load = _block_load(q, v, p, w, block, r, grid, nodes)
        return _acceleration(q, v, command, extra + load, p, w, constants, r)

    @wp.func
    def step(
        q: FLOAT,
        v: FLOAT,
        h: FLOAT,
        command: FLOAT,
        extra: FLOAT,
        p: wp.array2d(dtype=FLOAT),
        w: wp.int32,
        constants: wp.array2d(dtype=FLOAT),
        block: wp.array2d(dtype=FLOAT),
        r: wp.int32,
        grid: wp.array(dtype=FLOAT),
        nodes: wp.array3d(dtype=_VEC4),
    ):
        a1 = rate(q, v, command, extra, p, w, constants, block, r, grid, nodes)
        if wp.static(rk4):
            half = FLOAT(0.5)
            two = FLOAT(2.0)
            v2 = v + half * h * a1
            a2 = rate(q + half * h * v, v2, command, extra, p, w, constants, block, r, grid, nodes)
            v3 = v + half * h * a2
            a3 = rate(q + half * h * v2, v3, command, extra, p, w, constants, block, r, grid, nodes)
            v4 = v + h * a3
            a4 = rate(q + h * v3, v4, command, extra, p, w, constants, block, r, grid, nodes)
            sixth = h / FLOAT(6.0)
            return q + sixth * (v + two * v2 + two * v3 + v4), v + sixth * (a1 + two * a2 + two * a3 + a4)
        else:
            later = v + h * a1
            return q + h * later, later

    return rate, step


@cache
def _schedule_kernel(integrator: str) -> Any:
    """Rollout without tangents that writes down every step it takes, for the adjoint to follow."""
    rate, step = _primal_step(integrator)

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(
        # Run data:
        sample_times: wp.array2d(dtype=FLOAT),
        sample_count: wp.array(dtype=wp.int32),
        input_times: wp.array2d(dtype=FLOAT),
        input_current: wp.array2d(dtype=FLOAT),
        input_load: wp.array2d(dtype=_VEC2),
        input_count: wp.array(dtype=wp.int32),
        constants: wp.array2d(dtype=FLOAT),
        block: wp.array2d(dtype=FLOAT),
        grid: wp.array(dtype=FLOAT),
        nodes: wp.array3d(dtype=_VEC4),
        # World data in:
        world_run: wp.array(dtype=wp.int32),
        p_in: wp.array2d(dtype=FLOAT),
        capacity: wp.int32,
        # World data out: step length, its change with the delay, command, and the step after which each sample is taken
        step_out: wp.array2d(dtype=FLOAT),
        step_by_delay_out: wp.array2d(dtype=FLOAT),
        command_out: wp.array2d(dtype=FLOAT),
        load_out: wp.array2d(dtype=_VEC2),
        steps_out: wp.array(dtype=wp.int32),
        sample_step_out: wp.array2d(dtype=wp.int32),
    ):
        w = wp.tid()
        r = world_run[w]
        vs = constants[r, 3]
        coarse = constants[r, 4]
        fine = constants[r, 5]
        delay = p_in[w, 8]
        q = p_in[w, 9]
        v = p_in[w, 10]
        t = FLOAT(0.0)
        moved = FLOAT(0.0)  # d t / d delay
        segment = wp.int32(0)
        command = input_current[r, 0]
        loads = input_load[r, 0]
        extra = loads[0] + p_in[w, 11] * loads[1]
        n = wp.int32(0)
        for k in range(sample_count[r]):
            goal = sample_times[r, k] - delay
            sample_step_out[w, k] = -1
            if goal > FLOAT(0.0):
                arrived = wp.int32(0)
                while arrived == 0:
                    end = goal
                    d_end = FLOAT(-1.0)
                    switches = wp.int32(0)
                    if segment + 1 < input_count[r]:
                        if input_times[r, segment + 1] < goal:
                            end = input_times[r, segment + 1]
                            d_end = FLOAT(0.0)
                            switches = 1
                    last = wp.int32(0)
                    while last == 0 and n < capacity:
                        a1 = rate(q, v, command, extra, p_in, w, constants, block, r, grid, nodes)
                        h = coarse
                        if fine < coarse:
                            if wp.abs(v) < FLOAT(20.0) * vs + wp.abs(a1) * coarse:
                                h = fine
                        dh = FLOAT(0.0)
                        if t + h > end - FLOAT(TIME_EPS):
                            h = end - t
                            dh = d_end - moved
                            last = 1
                        step_out[w, n] = h
                        step_by_delay_out[w, n] = dh
                        command_out[w, n] = command
                        load_out[w, n] = loads
                        q_next, v_next = step(q, v, h, command, extra, p_in, w, constants, block, r, grid, nodes)
                        q = q_next
                        v = v_next
                        n = n + 1
                        t = t + h
                        if last == 1:
                            t = end
                            moved = d_end
                    if n >= capacity:
                        arrived = 1
                    elif switches == 1:
                        segment = segment + 1
                        command = input_current[r, segment]
                        loads = input_load[r, segment]
                        extra = loads[0] + p_in[w, 11] * loads[1]
                    else:
                        arrived = 1
                sample_step_out[w, k] = n
        steps_out[w] = n

    return kernel


@cache
def _taped_kernel(integrator: str) -> Any:
    """A kernel whose adjoint is right: every step writes its own row, no state is overwritten."""
    _rate, step = _primal_step(integrator)

    @wp.kernel(module="unique")
    def roll(
        # Run data:
        constants: wp.array2d(dtype=FLOAT),
        block: wp.array2d(dtype=FLOAT),
        grid: wp.array(dtype=FLOAT),
        nodes: wp.array3d(dtype=_VEC4),
        # World data in:
        world_run: wp.array(dtype=wp.int32),
        p_in: wp.array2d(dtype=FLOAT),
        delay_at: wp.array(dtype=FLOAT),
        step_in: wp.array2d(dtype=FLOAT),
        step_by_delay_in: wp.array2d(dtype=FLOAT),
        command_in: wp.array2d(dtype=FLOAT),
        load_in: wp.array2d(dtype=_VEC2),
        steps_in: wp.array(dtype=wp.int32),
        # World data out:
        q_out: wp.array2d(dtype=FLOAT),
        v_out: wp.array2d(dtype=FLOAT),
    ):
        w = wp.tid()
        r = world_run[w]
        delay = p_in[w, 8]
        q_out[w, 0] = p_in[w, 9]
        v_out[w, 0] = p_in[w, 10]
        for n in range(steps_in[w]):
            h = step_in[w, n] + step_by_delay_in[w, n] * (delay - delay_at[w])
            loads = load_in[w, n]
            extra = loads[0] + p_in[w, 11] * loads[1]
            q_next, v_next = step(
                q_out[w, n], v_out[w, n], h, command_in[w, n], extra, p_in, w, constants, block, r, grid, nodes
            )
            q_out[w, n + 1] = q_next
            v_out[w, n + 1] = v_next

    return roll


class SqueezeSimulator(JointSimulator):
    """Rolls out many worlds (guesses) of one or more closings of a gripper on a block.

    Parameter vectors have the order of ``SQUEEZE_PARAMETERS``; everything else is as in ``JointSimulator``.

    Args:
        runs: the runs; worlds refer to them by index. Their tables may differ, over the same grid (the same law).
        integrator: ``"rk4"`` or ``"semi_implicit"`` (the paper's equation (2)).
        device: Warp device name.

    Raises:
        SimulationError: unknown integrator, no runs, a run without samples, or tables of different laws.
    """

    parameters = SQUEEZE_PARAMETERS
    harmless = np.array([float(name in ("inertia", "stribeck_velocity")) for name in SQUEEZE_PARAMETERS])
    tangent_sizes = _SIZES

    def __init__(self, runs: Sequence[SqueezeRun], integrator: str = "rk4", device: str = "cpu") -> None:
        super().__init__([run.joint for run in runs], integrator, device)
        self.squeeze_runs = tuple(runs)
        tables = list({run.response.made_of: run.response for run in runs}.values())
        if any(table.nodes.shape != tables[0].nodes.shape or (table.grid != tables[0].grid).any() for table in tables):
            raise SimulationError("the runs' tables are over different grids: use one law of elasticity for all runs")
        which = {table.made_of: row for row, table in enumerate(tables)}
        self._block = self._array(
            np.array([[run.length, run.area, run.travel, which[run.response.made_of], *run.bend] for run in runs])
        )
        self._grid = self._array(tables[0].grid)
        self._nodes = wp.array(np.stack([table.nodes for table in tables]), dtype=_VEC4, device=device)

    def squeeze(self, world_run: np.ndarray, p: np.ndarray, q: np.ndarray) -> np.ndarray:
        """Squeeze relative to the block's length at some joint positions; where beyond the table's reach, the law is a guess.

        Args:
            world_run, p: as for ``jacobian``.
            q: positions, shape (W, T).

        Returns:
            shape (W, T), below 0 where the block is not touched.
        """
        length, _, travel, _, second, third = self._block.numpy()[np.asarray(world_run)].T[:, :, None]
        return (q * (travel + q * (second + q * third)) - p[:, _GAP : _GAP + 1]) / length

    def _kernel(self, size: int, stribeck: bool) -> Any:
        return _tangent_kernel(size, self.integrator, stribeck)

    def _schedule_kernel(self) -> Any:
        return _schedule_kernel(self.integrator)

    def _taped_kernel(self) -> Any:
        return _taped_kernel(self.integrator)

    def _object_data(self) -> list[wp.array]:
        return [self._block, self._grid, self._nodes]


def compile_kernels(response: Response, integrator: str = "rk4") -> None:
    """Compile and load the kernels that a fit needs, for whoever cannot wait for them later; again it costs nothing."""
    run = SqueezeRun(JointRun(np.array([0.01]), np.zeros(1), np.zeros(1)), 1.0, 1.0, 1.0, response)
    simulator = SqueezeSimulator([run], integrator)
    for size in _SIZES:
        for stribeck in (0.0, 1.0):
            p = SqueezeSimulator.harmless[None].copy()
            p[:, SQUEEZE_INDEX["stribeck"]] = stribeck
            simulator.jacobian(np.zeros(1, dtype=np.int32), p, np.zeros((1, len(SQUEEZE_PARAMETERS), size)))
