"""A joint that a servo holds, rolled out by implicit steps: its gears stick, and explicit steps would have to be 25 us short.

A stuck joint creeps through friction that is smoothed over 0.1 mrad/s. Alexander's two stages (SIAM J. Numer. Anal. 14, 1977: of
second order, and what is stiff dies out) take `STEPS` steps from one change of the input to the next. Each stage is an equation in
the velocity that friction only makes steeper, so that Newton's way from standstill to its root does not turn back.

The first two directions are the state's own, and no parameter's: along them the law's tangents are the slopes that Newton needs.
"""

from functools import cache
from typing import Any

import warp as wp

from proprio_ros.sim.joint_kernels import FRICTION_VELOCITY, VEC2, JointData, joint_law
from proprio_ros.sim.runtime import FLOAT, FLOATS

OWN = 2  # directions of the state
DIRECTIONS = 6  # with those of a servo's three numbers and a run's own
STEPS = 2
FINER = 16  # parts of a step that may bring a sliding joint to rest: friction turns over there
# a joint is that is slower than so many times the velocity over which friction is smoothed
STUCK = 3.0
SHARE = 1.0 - 0.5**0.5  # of a step that each stage takes
MOST_ITERATIONS = 50
# the last iteration's step, over the velocity and that over which friction is smoothed
CLOSE = 1e-7


@cache
def implicit_rollout(stribeck: bool) -> Any:
    """The kernel for runs that are looked at where their input changes, and nowhere else (thread = world).

    A simulator launches it in the place of `rollout_kernels.rollout`, so its arguments are the same.
    """
    law = joint_law(DIRECTIONS, stribeck)
    rates, record = law.rates, law.record
    vec = wp.types.vector(length=DIRECTIONS, dtype=FLOAT)
    mat = law.tangent
    part = FLOAT(1.0 / STEPS)

    @wp.func
    def stage(
        base: VEC2,
        d_base: mat,
        reach: FLOAT,
        u: law.input,
        p: FLOATS,
        dp: wp.array2d(dtype=vec),
        w: wp.int32,
        data: JointData,
        r: wp.int32,
    ):
        """The state that is ``base`` and its own rates for a time of ``reach``, with its tangents."""
        smoothing = data.constants[r, FRICTION_VELOCITY]
        along_state = mat()
        along_state[0, 0] = FLOAT(1.0)
        along_state[1, 1] = FLOAT(1.0)
        v = FLOAT(0.0)
        slope = FLOAT(1.0)
        da = vec()
        left = wp.int32(MOST_ITERATIONS)
        while left > 0:
            k, dk = rates(VEC2(base[0] + reach * v, v), along_state, u, p, dp, w, data, r)
            da = dk[1]
            slope = FLOAT(1.0) - reach * (da[1] + reach * da[0])
            change = (base[1] + reach * k[1] - v) / slope
            v = v + change
            left = left - 1
            if wp.abs(change) <= FLOAT(CLOSE) * (wp.abs(v) + smoothing):
                left = wp.int32(0)
        by_q = da[0]
        da[0] = FLOAT(0.0)
        da[1] = FLOAT(0.0)
        dv = (d_base[1] + reach * (by_q * d_base[0] + da)) / slope
        dq = d_base[0] + reach * dv
        return VEC2(base[0] + reach * v, v), wp.matrix_from_rows(dq, dv)

    @wp.kernel(module="unique", enable_backward=False)
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
        w = wp.tid()
        r = world_run[w]
        y, dy = law.start(p, dp, w, data, r)
        record(out, w, 0, y, dy, FLOAT(0.0), vec())
        stuck = FLOAT(STUCK) * data.constants[r, FRICTION_VELOCITY]
        gained = FLOAT(0.0)
        for k in range(1, sample_count[r]):
            u = inputs[r, k - 1]
            for _step in range(STEPS):
                parts = wp.int32(1)
                if wp.abs(y[1]) > stuck and wp.abs(y[1]) < FLOAT(2.0) * wp.abs(gained):
                    parts = wp.int32(FINER)
                h = part * (sample_times[r, k] - sample_times[r, k - 1]) / FLOAT(parts)
                reach = FLOAT(SHARE) * h
                # what the first stage's rates do in the rest of the step
                rest = (h - reach) / reach
                gained = -y[1]
                for _part in range(parts):
                    first, d_first = stage(y, dy, reach, u, p, dp, w, data, r)
                    base = y + rest * (first - y)
                    d_base = dy + rest * (d_first - dy)
                    y, dy = stage(base, d_base, reach, u, p, dp, w, data, r)
                gained = gained + y[1]
            record(out, w, k, y, dy, FLOAT(0.0), vec())

    return kernel
