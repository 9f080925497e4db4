"""The time walk, once: from sample to sample, over switches of the input, by RK4 or semi-implicit Euler, with exact tangents.

A law (``joint_kernels.py``, ``sphere_kernels.py``, ``squeeze_kernels.py``) says what moves: its state, its rates, and how those
change along any direction in state and parameters. What a kernel does with a law is here:

* time starts with the command; sample k is looked at ``t_k - delay``, and before the onset the law extrapolates its start;
* the input changes at given instants, which end a step; the last step before an instant is shortened to it. An instant of a
  sample moves with the delay and a switch does not, so the length of a step has tangents of its own;
* steps are ``coarse``, and ``fine`` while the law says that it is near standstill;
* RK4, or semi-implicit Euler, which is equation (2) of the paper (Chen et al. 2025, arXiv:2410.03920).

State and rates are one vector, tangents one matrix with a column for each direction. They cost no time against code written
out for each law: the compiler takes them apart again, for the sphere's 11 rows up to 16 columns (``sphere_kernels.py``).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import warp as wp

from proprio_ros.sim.runtime import FLOAT, FLOATS

TIME_EPS = 1e-9  # s; two instants closer than this are one


@dataclass(frozen=True, eq=False)
class Law:
    """What a walk needs to know about what moves; everything callable is a Warp function.

    In all of them ``y`` is the state, ``dy`` its tangents, ``u`` the input, ``p``, ``dp`` the parameters and their tangents of
    world ``w``, ``data`` what is known about run ``r``.
    """

    directions: int  # how many tangents D
    # state, input: Warp vectors
    state: Any
    input: Any
    tangent: Any  # Warp matrix (state, D)
    # data, out: Warp structs, of what is known about the runs and of the results
    data: Any
    out: Any
    delay: int  # column of the delay in the parameters
    start: Callable[..., Any]  # (p, dp, w, data, r) -> y, dy
    rates: Callable[..., Any]  # (y, dy, u, p, dp, w, data, r) -> their rates
    # (y, dy, z, dz, k, dk, data, r) -> the rates k, dk with those of positions made anew from the velocities in z
    moved: Callable[..., Any]
    # (y, k, data, r, step) -> whether it is, or may come within a step, near standstill
    still: Callable[..., Any]
    # (out, w, sample, y, dy, lead, d_lead), which writes a result; ``lead`` is below 0 before the onset [s]
    record: Callable[..., Any]
    # of the outer and the inner stages of RK4, and what their sum is multiplied by
    weights: tuple[float, float, float] = (1.0, 2.0, 1.0 / 6.0)
    # loops with more turns stay loops in the compiled code, the stages of RK4 among them
    max_unroll: int = 16


@cache
def rollout(law: Law, integrator: str) -> Any:
    """The kernel that rolls a law out with exact forward sensitivities (thread = world)."""
    vec = wp.types.vector(length=law.directions, dtype=FLOAT)
    state, tangent = law.state, law.tangent
    start, rates, moved, still, record = law.start, law.rates, law.moved, law.still, law.record
    delay_column = law.delay
    outer, inner, scale = (FLOAT(weight) for weight in law.weights)
    rk4 = integrator == "rk4"
    rows = law.state._length_
    stages = 4 if rk4 else 1

    @wp.kernel(
        module="unique", enable_backward=False, module_options={"max_unroll": law.max_unroll}
    )
    def kernel(
        # Run data:
        sample_times: FLOATS,
        sample_count: wp.array(dtype=wp.int32),
        input_times: FLOATS,
        inputs: wp.array2d(dtype=law.input),
        input_count: wp.array(dtype=wp.int32),
        steps: FLOATS,
        data: law.data,
        # World data in:
        world_run: wp.array(dtype=wp.int32),
        p: FLOATS,
        dp: wp.array2d(dtype=vec),
        # World data out:
        out: law.out,
    ):
        """Roll one world out.

        Args:
            sample_times: Of each run [s].
            sample_count: How many these are.
            input_times: When inputs change [s].
            inputs: From then on.
            input_count: How many these are.
            steps: Coarse and fine step of each run [s].
            data: What else is known about the runs.
            world_run: The run of each world.
            p: Parameters of each world, shape (W, P), in the order of `INDEX`.
            dp: Their derivatives by the directions, shape (W, P).
            out: Positions, velocities and tangents.
        """
        w = wp.tid()
        r = world_run[w]
        delay = p[w, delay_column]
        d_goal = -dp[w, delay_column]
        coarse = steps[r, 0]
        fine = steps[r, 1]
        y, dy = start(p, dp, w, data, r)
        t = FLOAT(0.0)
        # how the present instant moves with each direction: only sample instants move, with the delay
        dt = vec()
        segment = wp.int32(0)
        segments = input_count[r]
        u = inputs[r, 0]
        for k in range(sample_count[r]):
            goal = sample_times[r, k] - delay
            if goal > FLOAT(0.0):
                arrived = wp.int32(0)
                while arrived == 0:
                    # the next event: the sample, or a change of the input before it
                    end = goal
                    d_end = d_goal
                    arrived = wp.int32(1)
                    if segment + 1 < segments:
                        if input_times[r, segment + 1] < goal:
                            end = input_times[r, segment + 1]
                            d_end = vec()
                            arrived = 0
                    # the last step is taken even when it has no length: the instant may still move with the delay
                    last = wp.int32(0)
                    while last == 0:
                        h = coarse
                        dh = vec()
                        z = y
                        dz = dy
                        total = state()
                        d_total = tangent()
                        for stage in range(stages):
                            a, da = rates(z, dz, u, p, dp, w, data, r)
                            if stage == 0:
                                if fine < coarse:
                                    if still(y, a, data, r, coarse):
                                        h = fine
                                if t + h > end - FLOAT(TIME_EPS):
                                    h = end - t
                                    dh = d_end - dt
                                    last = 1
                            if wp.static(rk4):
                                weight = outer
                                reach = FLOAT(0.5)
                                if stage == 1 or stage == 2:
                                    weight = inner
                                if stage == 2:
                                    reach = FLOAT(1.0)
                                total = total + weight * a
                                for i in range(rows):
                                    d_total[i] = d_total[i] + weight * da[i]
                                if stage < 3:
                                    z = y + (reach * h) * a
                                    for i in range(rows):
                                        dz[i] = dy[i] + (reach * h) * da[i]
                                    if last == 1:
                                        for i in range(rows):
                                            dz[i] = dz[i] + (reach * a[i]) * dh
                            else:
                                z = y + h * a
                                dz = dy + h * da + wp.outer(a, dh)
                                total, d_total = moved(y, dy, z, dz, a, da, data, r)
                        if wp.static(rk4):
                            total = scale * total
                            for i in range(rows):
                                dy[i] = dy[i] + (scale * h) * d_total[i]
                        else:
                            for i in range(rows):
                                dy[i] = dy[i] + h * d_total[i]
                        y = y + h * total
                        t = t + h
                        if last == 1:
                            for i in range(rows):
                                dy[i] = dy[i] + total[i] * dh
                            t = end
                            dt = d_end
                    if arrived == 0:
                        segment = segment + 1
                        u = inputs[r, segment]
            record(
                out,
                w,
                k,
                y,
                dy,
                wp.min(goal, FLOAT(0.0)),
                d_goal,
            )

    return kernel
