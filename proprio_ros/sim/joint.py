"""One driven joint with everything else locked: the law, its exact tangents, and its adjoint.

The paper's equation (1) for one degree of freedom, with the drive train it leaves out:

    J a + g(q) = tau_m - (f_c + f_l |tau_m|) (1 + s exp(-(v / w)^2)) tanh(v / v_s) - f_v v,      tau_m = k_t i
    g(q) = g_a cos q + g_b sin q + g_c + e_0(t) + m e_1(t)
    i    = command, held inside what the supply can push against the back-EMF: |i| <= (V -+ k_e v) / R

``J`` holds the merged arm, the payload and the armature; ``g_a, g_b, g_c`` its gravity load (``payload.py`` says how they come
from inertial parameters). ``e_0, e_1`` is the torque that the held joints cause by yielding, with nothing in the hand and per
kilogram of payload ``m``; it is given with the current, piecewise constant. The rollout starts when the command does, at time 0
in state (q0, v0); sample k is compared at ``t_k - delay``, so the delay from command to motion shifts the observation and needs
no moving discontinuity.

Departures from the paper: armature, friction, supply limit and delay are ours (HARDWARE: each of them is worth 10 g or more);
the default integrator is RK4, because the substep error of the paper's equation (2), semi-implicit Euler, is itself grams of
mass. ``integrator="semi_implicit"`` is equation (2) to the letter.

Two independent derivatives: forward sensitivities in the same launch as the rollout (the default), and ``wp.Tape`` over a
separate kernel that stores every state (an adjoint is only right when no state is overwritten).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import warp as wp

from proprio_ros.errors import SimulationError
from proprio_ros.sim import runtime
from proprio_ros.sim.runtime import FLOAT

PARAMETERS = (
    "inertia",
    "gravity_cos",
    "gravity_sin",
    "gravity_constant",
    "torque_constant",
    "coulomb",
    "viscous",
    "load_friction",
    "delay",
    "q0",
    "v0",
    "carried",
    "stribeck",
    "stribeck_velocity",
)
"""Rows of a parameter vector, SI: kg m^2, N m (three), N m/A, N m, N m s/rad, 1, s, rad, rad/s, kg, 1, rad/s (kg, N, m for a
slide)."""
INDEX = {name: row for row, name in enumerate(PARAMETERS)}
_HARMLESS = np.array([float(name in ("inertia", "stribeck_velocity")) for name in PARAMETERS])

INTEGRATORS = ("rk4", "semi_implicit")
_TANGENT_SIZES = (1, 3, 4, 6, 8, 12, 14, 16, 24, 32)
_USUAL_SIZE = 16  # there are no more parameters to differentiate by; more directions come from callers of their own
MAX_STEPS = 200_000
TIME_EPS = 1e-9  # s; two instants closer than this are one

runtime.start()
_VEC2 = wp.types.vector(length=2, dtype=FLOAT)


@dataclass(frozen=True)
class JointRun:
    """What one rollout is driven by and where it is looked at.

    Attributes:
        sample_times_s: encoder stamps after command onset [s], shape (T,), increasing.
        input_times_s: when the current changes [s], shape (S,), increasing, first at 0.
        input_current_A: the current from each of those instants on [A], shape (S,).
        input_load: load from each of those instants on beside gravity's, shape (S, 2): with an empty hand [N m], and what each
            kilogram carried adds [N m/kg]; None is none.
        supply: (voltage [V], back-EMF constant [V s/rad], resistance [ohm]); voltage 0 means no limit.
        friction_velocity: v_s, where Coulomb's law is smoothed [rad/s].
        step_s: longest integration step [s]; 1/60/substeps makes semi-implicit Euler the paper's.
        fine_step_s: step while the joint is near standstill [s]; equal to ``step_s`` where there is no dry friction.
    """

    sample_times_s: np.ndarray
    input_times_s: np.ndarray
    input_current_A: np.ndarray
    supply: tuple[float, float, float] = (0.0, 0.0, 1.0)
    friction_velocity: float = 1e-3
    step_s: float = 1.0 / 240.0
    fine_step_s: float = 1.0 / 240.0
    input_load: np.ndarray | None = None


@wp.func
def limited_current(command: FLOAT, v: FLOAT, volt: FLOAT, emf: FLOAT, ohm: FLOAT):
    """The current that flows, and its derivative by the velocity."""
    i = command
    slope = FLOAT(0.0)
    if volt > FLOAT(0.0):
        high = (volt - emf * v) / ohm
        low = -(volt + emf * v) / ohm
        if command > FLOAT(0.0) and command > high:
            i = wp.max(high, FLOAT(0.0))
            if high > FLOAT(0.0):
                slope = -emf / ohm
        if command < FLOAT(0.0) and command < low:
            i = wp.min(low, FLOAT(0.0))
            if low < FLOAT(0.0):
                slope = -emf / ohm
    return i, slope


@wp.func
def _acceleration(
    q: FLOAT,
    v: FLOAT,
    command: FLOAT,
    extra: FLOAT,
    p: wp.array2d(dtype=FLOAT),
    world: wp.int32,
    constants: wp.array2d(dtype=FLOAT),
    run: wp.int32,
):
    i, _slope = limited_current(command, v, constants[run, 0], constants[run, 1], constants[run, 2])
    motor = p[world, 4] * i
    dry = p[world, 5] + p[world, 7] * wp.abs(motor)
    if p[world, 13] > FLOAT(0.0):
        slow = v / p[world, 13]
        dry = dry * (FLOAT(1.0) + p[world, 12] * wp.exp(-slow * slow))
    friction = dry * wp.tanh(v / constants[run, 3]) + p[world, 6] * v
    load = p[world, 1] * wp.cos(q) + p[world, 2] * wp.sin(q) + p[world, 3] + extra
    return (motor - friction - load) / p[world, 0]


@wp.func
def _rk4(
    q: FLOAT,
    v: FLOAT,
    h: FLOAT,
    command: FLOAT,
    extra: FLOAT,
    p: wp.array2d(dtype=FLOAT),
    world: wp.int32,
    constants: wp.array2d(dtype=FLOAT),
    run: wp.int32,
):
    """The state one step later."""
    half = FLOAT(0.5)
    two = FLOAT(2.0)
    a1 = _acceleration(q, v, command, extra, p, world, constants, run)
    v2 = v + half * h * a1
    a2 = _acceleration(q + half * h * v, v2, command, extra, p, world, constants, run)
    v3 = v + half * h * a2
    a3 = _acceleration(q + half * h * v2, v3, command, extra, p, world, constants, run)
    v4 = v + h * a3
    a4 = _acceleration(q + h * v3, v4, command, extra, p, world, constants, run)
    sixth = h / FLOAT(6.0)
    return q + sixth * (v + two * v2 + two * v3 + v4), v + sixth * (a1 + two * a2 + two * a3 + a4)


@wp.func
def _semi_implicit(
    q: FLOAT,
    v: FLOAT,
    h: FLOAT,
    command: FLOAT,
    extra: FLOAT,
    p: wp.array2d(dtype=FLOAT),
    world: wp.int32,
    constants: wp.array2d(dtype=FLOAT),
    run: wp.int32,
):
    """The paper's equation (2)."""
    later = v + h * _acceleration(q, v, command, extra, p, world, constants, run)
    return q + h * later, later


@cache
def linearised_law(directions: int, stribeck: bool) -> Any:
    """The joint's acceleration and its exact change along ``directions`` tangents, as a Warp function.

    Without ``stribeck`` its terms are left out at compile time: a robot whose friction does not rise towards standstill does not
    pay for the exponential.
    """
    vec = wp.types.vector(length=directions, dtype=FLOAT)

    @wp.func
    def linearised(
        q: FLOAT,
        v: FLOAT,
        dq: vec,
        dv: vec,
        command: FLOAT,
        inertia: FLOAT,
        ga: FLOAT,
        gb: FLOAT,
        gc: FLOAT,
        kt: FLOAT,
        fc: FLOAT,
        fv: FLOAT,
        fl: FLOAT,
        volt: FLOAT,
        emf: FLOAT,
        ohm: FLOAT,
        vs: FLOAT,
        d_inertia: vec,
        d_ga: vec,
        d_gb: vec,
        d_gc: vec,
        d_kt: vec,
        d_fc: vec,
        d_fv: vec,
        d_fl: vec,
        rise: FLOAT,
        width: FLOAT,
        d_rise: vec,
        d_width: vec,
    ):
        i, slope = limited_current(command, v, volt, emf, ohm)
        motor = kt * i
        side = wp.tanh(v / vs)
        load = wp.abs(motor)
        c = wp.cos(q)
        s = wp.sin(q)
        inverse = FLOAT(1.0) / inertia
        if wp.static(stribeck):
            slow = v / width
            bump = wp.exp(-slow * slow)
            level = FLOAT(1.0) + rise * bump
            dry = fc + fl * load
            a = (motor - dry * level * side - fv * v - ga * c - gb * s - gc) * inverse
            # d motor / d(.) enters the friction through |motor| as well
            gain = FLOAT(1.0) - fl * level * wp.sign(motor) * side
            by_q = ga * s - gb * c
            by_v = gain * kt * slope - dry * level * (FLOAT(1.0) - side * side) / vs - fv
            by_v = by_v + FLOAT(2.0) * dry * rise * bump * slow / width * side
            total = by_q * dq + by_v * dv + (gain * i) * d_kt
            total = total - (level * side) * d_fc - v * d_fv - (load * level * side) * d_fl
            total = (
                total
                - (dry * bump * side) * d_rise
                - (FLOAT(2.0) * dry * rise * bump * slow * slow / width * side) * d_width
            )
        else:
            a = (motor - (fc + fl * load) * side - fv * v - ga * c - gb * s - gc) * inverse
            gain = FLOAT(1.0) - fl * wp.sign(motor) * side
            by_q = ga * s - gb * c
            by_v = gain * kt * slope - (fc + fl * load) * (FLOAT(1.0) - side * side) / vs - fv
            total = by_q * dq + by_v * dv + (gain * i) * d_kt
            total = total - side * d_fc - v * d_fv - (load * side) * d_fl
        total = total - c * d_ga - s * d_gb - d_gc - a * d_inertia
        return a, inverse * total

    return linearised


@cache
def _tangent_kernel(directions: int, integrator: str, stribeck: bool) -> Any:
    """Rollout with ``directions`` exact forward sensitivities in the same thread (thread = world)."""
    vec = wp.types.vector(length=directions, dtype=FLOAT)
    linearised = linearised_law(directions, stribeck)
    rk4 = integrator == "rk4"

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
        inertia = p_in[w, 0]
        ga = p_in[w, 1]
        gb = p_in[w, 2]
        carried = p_in[w, 11]
        extra = input_load[r, 0]
        gc = p_in[w, 3] + extra[0] + carried * extra[1]
        kt = p_in[w, 4]
        fc = p_in[w, 5]
        fv = p_in[w, 6]
        fl = p_in[w, 7]
        delay = p_in[w, 8]
        q0 = p_in[w, 9]
        v0 = p_in[w, 10]
        d_inertia = dp_in[w, 0]
        d_ga = dp_in[w, 1]
        d_gb = dp_in[w, 2]
        d_gc = dp_in[w, 3] + extra[1] * dp_in[w, 11]
        d_kt = dp_in[w, 4]
        d_fc = dp_in[w, 5]
        d_fv = dp_in[w, 6]
        d_fl = dp_in[w, 7]
        d_delay = dp_in[w, 8]
        rise = p_in[w, 12]
        width = p_in[w, 13]
        d_rise = dp_in[w, 12]
        d_width = dp_in[w, 13]
        volt = constants[r, 0]
        emf = constants[r, 1]
        ohm = constants[r, 2]
        vs = constants[r, 3]
        coarse = constants[r, 4]
        fine = constants[r, 5]
        half = FLOAT(0.5)
        sixth = FLOAT(1.0) / FLOAT(6.0)
        two = FLOAT(2.0)

        q = q0
        v = v0
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
                q_out[w, k] = q0 + v0 * goal
                v_out[w, k] = v0
                dq_out[w, k] = dp_in[w, 9] + goal * dp_in[w, 10] - v0 * d_delay
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
                            q, v, dq, dv, command, inertia, ga, gb, gc, kt, fc, fv, fl, volt, emf, ohm, vs,
                            d_inertia, d_ga, d_gb, d_gc, d_kt, d_fc, d_fv, d_fl, rise, width, d_rise, d_width,
                        )  # fmt: skip
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
                                q2, v2, dq2, dv2, command, inertia, ga, gb, gc, kt, fc, fv, fl, volt, emf, ohm, vs,
                                d_inertia, d_ga, d_gb, d_gc, d_kt, d_fc, d_fv, d_fl, rise, width, d_rise, d_width,
                            )  # fmt: skip
                            q3 = q + half * h * v2
                            v3 = v + half * h * a2
                            dq3 = dq + (half * h) * dv2 + (half * v2) * dh
                            dv3 = dv + (half * h) * da2 + (half * a2) * dh
                            a3, da3 = linearised(
                                q3, v3, dq3, dv3, command, inertia, ga, gb, gc, kt, fc, fv, fl, volt, emf, ohm, vs,
                                d_inertia, d_ga, d_gb, d_gc, d_kt, d_fc, d_fv, d_fl, rise, width, d_rise, d_width,
                            )  # fmt: skip
                            q4 = q + h * v3
                            v4 = v + h * a3
                            dq4 = dq + h * dv3 + v3 * dh
                            dv4 = dv + h * da3 + a3 * dh
                            a4, da4 = linearised(
                                q4, v4, dq4, dv4, command, inertia, ga, gb, gc, kt, fc, fv, fl, volt, emf, ohm, vs,
                                d_inertia, d_ga, d_gb, d_gc, d_kt, d_fc, d_fv, d_fl, rise, width, d_rise, d_width,
                            )  # fmt: skip
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
                        extra = input_load[r, segment]
                        gc = p_in[w, 3] + extra[0] + carried * extra[1]
                        d_gc = dp_in[w, 3] + extra[1] * dp_in[w, 11]
                    else:
                        arrived = 1
                q_out[w, k] = q
                v_out[w, k] = v
                dq_out[w, k] = dq

    return kernel


@cache
def _schedule_kernel(integrator: str) -> Any:
    """Rollout without tangents that writes down every step it takes, for the adjoint to follow."""
    step = _rk4 if integrator == "rk4" else _semi_implicit

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
                        a1 = _acceleration(q, v, command, extra, p_in, w, constants, r)
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
                        q_next, v_next = step(q, v, h, command, extra, p_in, w, constants, r)
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
def _taped_kernels(integrator: str) -> tuple[Any, Any]:
    """Kernels whose adjoint is right: every step writes its own row, no state is overwritten."""
    step = _rk4 if integrator == "rk4" else _semi_implicit

    @wp.kernel(module="unique")
    def roll(
        # Run data:
        constants: wp.array2d(dtype=FLOAT),
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
            q_next, v_next = step(q_out[w, n], v_out[w, n], h, command_in[w, n], extra, p_in, w, constants, r)
            q_out[w, n + 1] = q_next
            v_out[w, n + 1] = v_next

    @wp.kernel(module="unique")
    def observe(
        # Run data:
        sample_times: wp.array2d(dtype=FLOAT),
        # World data in:
        world_run: wp.array(dtype=wp.int32),
        p_in: wp.array2d(dtype=FLOAT),
        sample_step_in: wp.array2d(dtype=wp.int32),
        q_in: wp.array2d(dtype=FLOAT),
        # World data out:
        sampled_out: wp.array2d(dtype=FLOAT),
    ):
        w, k = wp.tid()
        step = sample_step_in[w, k]
        if step < 0:
            sampled_out[w, k] = p_in[w, 9] + p_in[w, 10] * (sample_times[world_run[w], k] - p_in[w, 8])
        else:
            sampled_out[w, k] = q_in[w, step]

    return roll, observe


@dataclass(frozen=True)
class Schedule:
    """Every step of some rollouts, on the device: what the adjoint follows.

    Attributes:
        step, step_by_delay: length of each step and its change with the delay, shape (W, N).
        command, load: during each step, shape (W, N).
        steps: how many of each world, shape (W,); sample_step: after which each sample is taken, -1 before all, shape (W, T).
    """

    step: wp.array
    step_by_delay: wp.array
    command: wp.array
    load: wp.array
    steps: wp.array
    sample_step: wp.array

    @classmethod
    def empty(cls, worlds: int, capacity: int, samples: int, device: str) -> "Schedule":
        """Arrays to be filled by a kernel."""
        step, by_delay, command = (wp.zeros((worlds, capacity), dtype=FLOAT, device=device) for _ in range(3))
        return cls(
            step,
            by_delay,
            command,
            wp.zeros((worlds, capacity), dtype=_VEC2, device=device),
            wp.zeros(worlds, dtype=wp.int32, device=device),
            wp.zeros((worlds, samples), dtype=wp.int32, device=device),
        )

    def inputs(self) -> list[wp.array]:
        """What a taped kernel reads, in its order."""
        return [self.step, self.step_by_delay, self.command, self.load, self.steps]


class JointSimulator:
    """Rolls out many worlds (guesses) of one or more runs of single joints in one launch.

    Args:
        runs: the runs; worlds refer to them by index. Runs may have different lengths.
        integrator: ``"rk4"`` or ``"semi_implicit"`` (the paper's equation (2)).
        device: Warp device name.

    Raises:
        SimulationError: unknown integrator, no runs, or a run without samples.
    """

    parameters: tuple[str, ...] = PARAMETERS
    harmless: np.ndarray = _HARMLESS
    tangent_sizes: tuple[int, ...] = _TANGENT_SIZES

    def __init__(self, runs: Sequence[JointRun], integrator: str = "rk4", device: str = "cpu") -> None:
        if integrator not in INTEGRATORS:
            raise SimulationError(f"unknown integrator {integrator!r}: choose one of {', '.join(INTEGRATORS)}")
        if not runs or any(len(run.sample_times_s) == 0 for run in runs):
            raise SimulationError("nothing to simulate: every run needs at least one sample after the command's onset")
        self.runs = tuple(runs)
        self.integrator = integrator
        self.device = device
        self.sample_counts = np.array([len(run.sample_times_s) for run in runs], dtype=np.int32)
        self.sample_counts.setflags(write=False)
        self._width = int(self.sample_counts.max())
        input_counts = np.array([len(run.input_times_s) for run in runs], dtype=np.int32)
        samples = np.zeros((len(runs), self._width))
        switch_times = np.zeros((len(runs), int(input_counts.max())))
        switch_current = np.zeros_like(switch_times)
        switch_load = np.zeros((*switch_times.shape, 2))
        constants = np.zeros((len(runs), 6))
        for row, run in enumerate(runs):
            samples[row, : self.sample_counts[row]] = run.sample_times_s
            switch_times[row, : input_counts[row]] = run.input_times_s
            switch_current[row, : input_counts[row]] = run.input_current_A
            if run.input_load is not None:
                switch_load[row, : input_counts[row]] = run.input_load
            constants[row] = (*run.supply, run.friction_velocity, run.step_s, min(run.fine_step_s, run.step_s))
        self._samples = self._array(samples)
        self._switch_times = self._array(switch_times)
        self._switch_current = self._array(switch_current)
        self._switch_load = wp.array(switch_load, dtype=_VEC2, device=device)
        self._constants = self._array(constants)
        self._input_counts = wp.array(input_counts, dtype=wp.int32, device=device)
        self._full_counts = wp.array(self.sample_counts, dtype=wp.int32, device=device)
        self._launches: dict[tuple[int, int, bool], _Launch] = {}

    def _array(self, values: np.ndarray) -> wp.array:
        return wp.array(np.ascontiguousarray(values, dtype=np.float64), dtype=FLOAT, device=self.device)

    def windows(self, fraction: float) -> np.ndarray:
        """How many samples of each run lie in the first ``fraction`` of its time, at least three; shape (R,), int32."""
        counts = [
            int(np.searchsorted(run.sample_times_s, fraction * run.sample_times_s[-1] + TIME_EPS, side="right"))
            for run in self.runs
        ]
        return np.minimum(np.maximum(np.array(counts, dtype=np.int32), 3), self.sample_counts)

    def jacobian(
        self, world_run: np.ndarray, p: np.ndarray, dp: np.ndarray, counts: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions and velocities at the sample instants with exact forward sensitivities.

        Args:
            world_run: run of each world, shape (W,).
            p: parameters of each world in the order of ``PARAMETERS``, shape (W, P).
            dp: D tangent directions of each world in parameter space, shape (W, P, D); a read-only array that comes again is
                not copied again (nor are ``world_run`` and ``counts``).
            counts: only the first ``counts[r]`` samples of run r are computed, shape (R,); default all.

        Worlds whose parameters are not all finite give NaN.

        Returns:
            q (W, T), v (W, T), dq (W, T, D). Columns past a run's count hold stale numbers. The arrays are views of
            buffers that the next call of the same shape overwrites.
        """
        directions = dp.shape[2]
        q, v, dq, *_ = self._launch(world_run, p, dp, counts)
        return q, v, dq[:, :, :directions]

    def _launch(
        self, world_run: np.ndarray, p: np.ndarray, dp: np.ndarray, counts: np.ndarray | None
    ) -> tuple[np.ndarray, ...]:
        """All outputs of the tangent kernel; its directions are padded to one of ``tangent_sizes``."""
        worlds, _, directions = dp.shape
        size = next((s for s in self.tangent_sizes if s >= directions), directions)
        stribeck = bool(p[:, INDEX["stribeck"]].any() or dp[:, INDEX["stribeck"]].any())
        launch = self._launches.get((worlds, size, stribeck))
        if launch is None:
            launch = self._launches[worlds, size, stribeck] = _Launch(self, worlds, size, stribeck)
        lost = ~np.isfinite(p).all(axis=1)
        if lost.any():  # a rollout of what is no number would not end
            p = np.where(lost[:, None], self.harmless, p)
        results = launch(world_run, p, dp, self.sample_counts if counts is None else counts)
        if lost.any():
            results[0][lost] = results[1][lost] = np.nan
        return results

    def _kernel(self, size: int, stribeck: bool) -> Any:
        return _tangent_kernel(size, self.integrator, stribeck)

    def _schedule_kernel(self) -> Any:
        return _schedule_kernel(self.integrator)

    def _taped_kernel(self) -> Any:
        return _taped_kernels(self.integrator)[0]

    def _object_data(self) -> list[wp.array]:
        """What kernels are told beside that about something that moves by itself in the hand: here is nothing."""
        return []

    def _run_data(self, counts: wp.array) -> list[wp.array]:
        """What every kernel is told about the runs, in its order."""
        return [
            self._samples, counts, self._switch_times, self._switch_current, self._switch_load, self._input_counts,
            self._constants, *self._object_data(),
        ]  # fmt: skip

    def _outputs(self, worlds: int, size: int) -> list[wp.array]:
        vec = wp.types.vector(length=size, dtype=FLOAT)
        return [wp.zeros((worlds, self._width), dtype=kind, device=self.device) for kind in (FLOAT, FLOAT, vec)]

    def _schedule(self, runs: wp.array, p: wp.array, capacity: int) -> Schedule:
        plan = Schedule.empty(len(p), capacity, self._width, self.device)
        wp.launch(
            self._schedule_kernel(),
            dim=len(p),
            inputs=[*self._run_data(self._full_counts), runs, p, capacity],
            outputs=[*plan.inputs(), plan.sample_step],
            device=self.device,
        )
        return plan

    def _roll(self, runs: wp.array, p: wp.array, delay_at: wp.array, plan: Schedule, capacity: int) -> wp.array:
        """Launch the taped rollout; every position, shape (W, N + 1)."""
        q, v = (wp.zeros((len(p), capacity + 1), dtype=FLOAT, device=self.device, requires_grad=True) for _ in range(2))
        wp.launch(
            self._taped_kernel(),
            dim=len(p),
            inputs=[self._constants, *self._object_data(), runs, p, delay_at, *plan.inputs()],
            outputs=[q, v],
            device=self.device,
        )
        return q

    def rollout(self, world_run: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities at the sample instants, shapes (W, T); arguments as in ``jacobian``."""
        q, v, _ = self.jacobian(world_run, p, np.zeros((*p.shape, 1)))
        return q.copy(), v.copy()

    def tape(self, world_run: np.ndarray, p: np.ndarray) -> "TapedRollout":
        """The same rollout recorded on a ``wp.Tape`` (see ``TapedRollout``)."""
        return TapedRollout(self, np.asarray(world_run, dtype=np.int32), np.asarray(p, dtype=np.float64))


def compile_kernels(integrator: str = "rk4") -> None:
    """Compile and load the kernels of all usual sizes, for whoever cannot wait for one later; again it costs nothing."""
    simulator = JointSimulator([JointRun(np.array([0.01]), np.zeros(1), np.zeros(1))], integrator)
    for size in (size for size in _TANGENT_SIZES if size <= _USUAL_SIZE):
        for stribeck in (0.0, 1.0):
            p = _HARMLESS[None].copy()
            p[:, INDEX["stribeck"]] = stribeck
            simulator.jacobian(np.zeros(1, dtype=np.int32), p, np.zeros((1, len(PARAMETERS), size)))


class _Launch:
    """Buffers and recorded launch for one batch shape: a recorded launch costs a fifth of a fresh one."""

    def __init__(self, owner: JointSimulator, worlds: int, size: int, stribeck: bool) -> None:
        vec = wp.types.vector(length=size, dtype=FLOAT)
        device = owner.device
        self._given: dict[str, np.ndarray | None] = {}
        self._world_run = wp.zeros(worlds, dtype=wp.int32, device=device)
        self._counts = wp.clone(owner._full_counts)
        self._p = wp.zeros((worlds, len(owner.parameters)), dtype=FLOAT, device=device)
        self._dp = wp.zeros((worlds, len(owner.parameters)), dtype=vec, device=device)
        self._outputs = owner._outputs(worlds, size)
        self._command = wp.launch(
            owner._kernel(size, stribeck),
            dim=worlds,
            inputs=[*owner._run_data(self._counts), self._world_run, self._p, self._dp],
            outputs=self._outputs,
            device=device,
            record_cmd=True,
        )
        # on the CPU a Warp array is the host's own memory: written and read in place, without a copy
        inputs = {"world_run": self._world_run, "counts": self._counts, "p": self._p, "dp": self._dp}
        self._views = {name: array.numpy() for name, array in inputs.items()} if self._p.device.is_cpu else {}
        self._results = self._read() if self._views else None

    def __call__(
        self, world_run: np.ndarray, p: np.ndarray, dp: np.ndarray, counts: np.ndarray
    ) -> tuple[np.ndarray, ...]:
        self._put("world_run", self._world_run, world_run)
        self._put("counts", self._counts, counts)
        self._put("p", self._p, p)
        self._put("dp", self._dp, dp)
        self._command.launch()
        return self._results or self._read()

    def _read(self) -> tuple[np.ndarray, ...]:
        return tuple(output.numpy() for output in self._outputs)

    def _put(self, what: str, array: wp.array, values: np.ndarray) -> None:
        """Hand an input over; a read-only array that was already given has not changed."""
        if self._given.get(what) is values:
            return
        self._given[what] = None if values.flags.writeable else values
        if self._views:
            view = self._views[what]
            view[..., : values.shape[-1]] = values
            view[..., values.shape[-1] :] = 0
        else:
            whole = np.zeros_like(array.numpy())
            whole[..., : values.shape[-1]] = values
            array.assign(whole)


class TapedRollout:
    """One rollout on a ``wp.Tape``: states of every step are kept, gradients come from reverse mode.

    The step lengths are those the forward kernel takes at the same parameters; they follow the delay to first order, which is
    exact, and stay frozen otherwise.

    Attributes:
        q: positions at the sample instants, shape (W, T).
    """

    def __init__(self, owner: JointSimulator, world_run: np.ndarray, p: np.ndarray) -> None:
        device = owner.device
        worlds = len(p)
        longest = max(float(run.sample_times_s[-1]) + abs(float(p[:, 8].min())) for run in owner.runs)
        finest = min(min(run.fine_step_s, run.step_s) for run in owner.runs)
        events = owner._width + int(owner._switch_times.shape[1])
        capacity = int(np.ceil(longest / finest)) + events + 2
        if capacity > MAX_STEPS:
            raise SimulationError(
                f"{capacity} steps of {finest:.2g} s are too many for a tape (at most {MAX_STEPS}): use a longer step, "
                "or the forward sensitivities"
            )
        self._worlds = worlds
        self._samples = owner._width
        runs = wp.array(world_run, dtype=wp.int32, device=device)
        self._p = wp.array(p, dtype=FLOAT, device=device, requires_grad=True)
        plan = owner._schedule(runs, self._p, capacity)
        self._sampled = wp.zeros((worlds, owner._width), dtype=FLOAT, device=device, requires_grad=True)
        delay_at = wp.array(p[:, 8].copy(), dtype=FLOAT, device=device)
        self._tape = wp.Tape()
        with self._tape:
            q = owner._roll(runs, self._p, delay_at, plan, capacity)
            wp.launch(
                _taped_kernels(owner.integrator)[1],
                dim=(worlds, owner._width),
                inputs=[owner._samples, runs, self._p, plan.sample_step, q],
                outputs=[self._sampled],
                device=device,
            )
        self.q = self._sampled.numpy().copy()

    def gradient(self, weights: np.ndarray) -> np.ndarray:
        """Gradient of ``sum(weights * q)`` by the parameters of each world.

        Args:
            weights: shape (W, T).

        Returns:
            shape (W, P), a copy.
        """
        seed = wp.array(np.ascontiguousarray(weights, dtype=np.float64), dtype=FLOAT, device=self._p.device)
        self._tape.backward(grads={self._sampled: seed})
        gradient = self._p.grad.numpy().copy()  # a view on the CPU, and zero() below would empty it
        self._tape.zero()
        return gradient
