"""Levenberg-Marquardt of many fits at once for Warp: what ``descent.py`` launches, in the order in which it does.

A *guess* is one start of one fit, and a *world* one run of a guess. Each iteration places the worlds' parameters by the guesses
(``place``), rolls the worlds out with the normal equations summed up on the way (``fitted_law``), judges the steps (``look``,
``judge``) and makes the next (``propose``). The steps are those of ``identification/solvers.py``, bound by bound; loops run over as
many unknowns as there are, so one compiled kernel serves every size.
"""

from dataclasses import replace
from functools import cache

import warp as wp

from proprio_ros.sim.joint_kernels import INERTIA, joint_law
from proprio_ros.sim.rollout_kernels import Law
from proprio_ros.sim.runtime import FLOAT, FLOATS

FLAT = wp.array(dtype=FLOAT)
STACK = wp.array3d(dtype=FLOAT)
INTS = wp.array(dtype=wp.int32)
SMALLEST_DAMPING, LARGEST_DAMPING = 1e-8, 1e10
FIRST_DAMPING, FIRST_GROWTH = 1e-3, 2.0
DAMPED_OUT = 1e6
IDLE_STEPS = 3
SETTLED = 1e-2
"""Steps shorter than this part of a standard deviation are those of a guess that has arrived."""


@wp.struct
class Fits:
    """What is known: A fits of F unknowns, G guesses, W worlds, R runs of P parameters."""

    fit_of: INTS  # of each guess, (G,)
    first_guess: INTS  # of each fit, and where the last one ends, (A + 1,)
    first_world: INTS  # of each guess, and where the last one ends, (G + 1,)
    run_of: INTS  # of each world, (W,)
    idle_run: wp.int32  # a run without samples, where the worlds of finished fits wait
    offset: FLOATS  # parameters where all unknowns are 0, (R, P)
    slope: STACK  # and what each unknown adds, (R, P, F)
    harmless: FLAT  # parameters of a world that does nothing, (P,)
    # solver coordinates: bounds, longest step, and the scale of those that are an inverse hyperbolic sine, else 0; (A, F)
    lower: FLOATS
    upper: FLOATS
    step_limit: FLOATS
    scale: FLOATS
    prior_mean: FLOATS  # (A, F)
    prior_precision: STACK  # (A, F, F)
    # what gains less does not matter, and the largest curvature whose products are finite
    idle_gain: FLOAT
    largest_curvature: FLOAT
    persistent: wp.int32


@wp.struct
class Guesses:
    """Where every guess is, where it tries to go, and room to work in."""

    u: FLOATS  # solver coordinates, (G, F)
    cost: FLAT  # (G,)
    gradient: FLOATS  # (G, F)
    matrix: STACK  # (G, F, F)
    # the same where it tries to go
    trial: FLOATS
    trial_cost: FLAT
    trial_gradient: FLOATS
    trial_matrix: STACK
    lost: INTS  # whether a parameter there is no number, (G,)
    damping: FLAT  # (G,)
    growth: FLAT  # factor on the damping after a step that gains nothing, (G,)
    size: FLAT  # of its last step in standard deviations, (G,)
    idle: INTS  # steps in a row that gained nothing that matters, (G,)
    step: FLOATS  # (G, F)
    fixed: wp.array2d(dtype=wp.int32)  # unknowns that stay in a step, (G, F)
    factor: STACK  # Cholesky's, (G, F, F)
    running: INTS  # whether a fit goes on, (A,)
    path: STACK  # solver coordinates after each iteration, (I, G, F)
    path_cost: FLOATS  # (I, G)


@wp.struct
class Sums:
    """Half a squared norm of each world's whitened residuals, and its derivatives by D directions."""

    measured: FLOATS  # (R, T)
    weight: FLOATS  # (R, T)
    ripple: FLOATS  # the encoder shows ``q + a cos q + b sin q``: a and b, (R, 2)
    run_of: INTS  # (W,)
    cost: FLAT  # (W,)
    # worlds last: neighbouring threads of a graphics card then write side by side
    gradient: FLOATS  # (D, W)
    matrix: STACK  # the lower triangle, (D, D, W)


@cache
def fitted_law(directions: int, stribeck: bool) -> Law:
    """The joint's law, which leaves the normal equations of what was measured instead of a trajectory."""
    law = joint_law(directions, stribeck)
    vec = wp.types.vector(length=directions, dtype=FLOAT)
    state = law.state
    tangent = law.tangent

    @wp.func
    def record(
        out: Sums,
        w: wp.int32,
        k: wp.int32,
        y: state,
        dy: tangent,
        lead: FLOAT,
        d_lead: vec,
    ):
        """Add a sample to the sums of its world; arguments as of ``Law.record``: out, w, k, y, dy, lead, d_lead."""
        q = y[0]
        dq = dy[0]
        if lead < FLOAT(0.0):
            q = y[0] + y[1] * lead
            dq = dy[0] + lead * dy[1] + y[1] * d_lead
        r = out.run_of[w]
        weight = out.weight[r, k]
        side = out.ripple[r, 0] * wp.cos(q) + out.ripple[r, 1] * wp.sin(q)
        change = out.ripple[r, 1] * wp.cos(q) - out.ripple[r, 0] * wp.sin(q)
        residual = (q + side - out.measured[r, k]) * weight
        slope = ((FLOAT(1.0) + change) * weight) * dq
        out.cost[w] = out.cost[w] + FLOAT(0.5) * residual * residual
        for i in range(directions):
            out.gradient[i, w] = out.gradient[i, w] + slope[i] * residual
            for j in range(directions):
                if wp.static(j <= i):
                    out.matrix[i, j, w] = out.matrix[i, j, w] + slope[i] * slope[j]

    return replace(law, out=Sums, record=record)


@wp.func
def _physical(u: FLOAT, scale: FLOAT):
    """The unknown of a solver coordinate."""
    if scale > FLOAT(0.0):
        return scale * wp.sinh(u)
    return u


@wp.func
def _physical_by_coordinate(u: FLOAT, scale: FLOAT):
    """Its derivative."""
    if scale > FLOAT(0.0):
        return scale * wp.cosh(u)
    return FLOAT(1.0)


@wp.kernel(enable_backward=False)
def place(fits: Fits, guesses: Guesses, world_run: INTS, p: FLOATS):
    """Parameters of every world where its guess tries to go (thread = guess).

    Args:
        fits: What is known.
        guesses: All of them.
        world_run: Gets the run of each world, shape (W,).
        p: Gets the parameters, shape (W, P).
    """
    g = wp.tid()
    a = fits.fit_of[g]
    running = guesses.running[a] == 1
    guesses.lost[g] = 0
    for w in range(fits.first_world[g], fits.first_world[g + 1]):
        world_run[w] = fits.idle_run
        if running:
            r = fits.run_of[w]
            world_run[w] = r
            for i in range(p.shape[1]):
                value = fits.offset[r, i]
                for f in range(fits.scale.shape[1]):
                    unknown = _physical(guesses.trial[g, f], fits.scale[a, f])
                    value = value + fits.slope[r, i, f] * unknown
                p[w, i] = value
                if not wp.isfinite(value):
                    guesses.lost[g] = 1
    if guesses.lost[g] == 1:  # a rollout of what is no number would not end
        for w in range(fits.first_world[g], fits.first_world[g + 1]):
            for i in range(p.shape[1]):
                p[w, i] = fits.harmless[i]


@wp.func
def _add_up(g: wp.int32, fits: Fits, guesses: Guesses, sums: Sums, p: FLOATS):
    """The normal equations of a guess from its priors and its worlds, in physical units; whether they are sound."""
    a = fits.fit_of[g]
    size = fits.scale.shape[1]
    cost = FLOAT(0.0)
    sound = wp.int32(1) - guesses.lost[g]
    for i in range(size):
        pull = FLOAT(0.0)
        for j in range(size):
            off = _physical(guesses.trial[g, j], fits.scale[a, j]) - fits.prior_mean[a, j]
            pull = pull + fits.prior_precision[a, i, j] * off
            guesses.trial_matrix[g, i, j] = fits.prior_precision[a, i, j]
        off = _physical(guesses.trial[g, i], fits.scale[a, i]) - fits.prior_mean[a, i]
        cost = cost + FLOAT(0.5) * off * pull
        guesses.trial_gradient[g, i] = pull
    for w in range(fits.first_world[g], fits.first_world[g + 1]):
        cost = cost + sums.cost[w]
        if p[w, INERTIA] <= FLOAT(0.0):
            sound = 0
        for i in range(size):
            guesses.trial_gradient[g, i] = guesses.trial_gradient[g, i] + sums.gradient[i, w]
            for j in range(size):
                more = sums.matrix[wp.max(i, j), wp.min(i, j), w]
                guesses.trial_matrix[g, i, j] = guesses.trial_matrix[g, i, j] + more
    guesses.trial_cost[g] = cost
    if not wp.isfinite(cost):
        sound = 0
    return sound


@wp.func
def _linearise(g: wp.int32, fits: Fits, guesses: Guesses, sums: Sums, p: FLOATS):
    """Cost, gradient and Gauss-Newton matrix where a guess tries to go, in solver coordinates."""
    a = fits.fit_of[g]
    size = fits.scale.shape[1]
    sound = _add_up(g, fits, guesses, sums, p)
    for i in range(size):
        slope_i = _physical_by_coordinate(guesses.trial[g, i], fits.scale[a, i])
        guesses.trial_gradient[g, i] = guesses.trial_gradient[g, i] * slope_i
        for j in range(size):
            slope_j = _physical_by_coordinate(guesses.trial[g, j], fits.scale[a, j])
            value = guesses.trial_matrix[g, i, j] * slope_i * slope_j
            guesses.trial_matrix[g, i, j] = value
            if not wp.isfinite(value):
                sound = 0
    largest = FLOAT(0.0)
    for i in range(size):
        largest = wp.max(largest, wp.abs(guesses.trial_matrix[g, i, i]))
    factor = FLOAT(1.0)
    if largest > fits.largest_curvature:
        factor = fits.largest_curvature / largest
    if sound == 0:
        guesses.trial_cost[g] = FLOAT(wp.inf)
    for i in range(size):
        guesses.trial_gradient[g, i] = guesses.trial_gradient[g, i] * factor
        if sound == 0:
            guesses.trial_gradient[g, i] = FLOAT(0.0)
        for j in range(size):
            guesses.trial_matrix[g, i, j] = guesses.trial_matrix[g, i, j] * factor
            if sound == 0:
                guesses.trial_matrix[g, i, j] = wp.where(i == j, FLOAT(1.0), FLOAT(0.0))


@wp.func
def _move(g: wp.int32, guesses: Guesses):
    """A guess is where it tried to go."""
    guesses.cost[g] = guesses.trial_cost[g]
    for i in range(guesses.u.shape[1]):
        guesses.u[g, i] = guesses.trial[g, i]
        guesses.gradient[g, i] = guesses.trial_gradient[g, i]
        for j in range(guesses.u.shape[1]):
            guesses.matrix[g, i, j] = guesses.trial_matrix[g, i, j]


@wp.func
def _keep(g: wp.int32, iteration: wp.int32, guesses: Guesses):
    """Write down where a guess is."""
    guesses.path_cost[iteration, g] = guesses.cost[g]
    for i in range(guesses.u.shape[1]):
        guesses.path[iteration, g, i] = guesses.u[g, i]


@wp.kernel(enable_backward=False)
def look(iteration: wp.int32, fits: Fits, guesses: Guesses, sums: Sums, p: FLOATS):
    """Begin with another window, from where every guess is (thread = guess).

    Args:
        iteration: How many there were; 0 is the first look of all.
        fits: What is known.
        guesses: All of them.
        sums: What the rollout added up of each world.
        p: Parameters of the worlds, shape (W, P).
    """
    g = wp.tid()
    _linearise(g, fits, guesses, sums, p)
    _move(g, guesses)
    guesses.idle[g] = 0
    if iteration == 0:
        _keep(g, iteration, guesses)


@wp.func
def _damp(g: wp.int32, guesses: Guesses, better: bool, gained: FLOAT, promised: FLOAT):
    """Nielsen 1999: the damping follows how much of the promised decrease came true."""
    share = gained / wp.max(promised, wp.max(gained, FLOAT(1e-300)))
    kept = FLOAT(2.0) * wp.clamp(share, FLOAT(0.0), FLOAT(1.0)) - FLOAT(1.0)
    factor = guesses.growth[g]
    growth = FLOAT(2.0) * guesses.growth[g]
    if better:
        factor = wp.max(FLOAT(0.1), FLOAT(1.0) - kept * kept * kept)
        growth = FLOAT(FIRST_GROWTH)
    guesses.damping[g] = wp.clamp(
        guesses.damping[g] * factor, FLOAT(SMALLEST_DAMPING), FLOAT(LARGEST_DAMPING)
    )
    guesses.growth[g] = growth


@wp.func
def _curvature(g: wp.int32, guesses: Guesses):
    """Of a guess's step, its square in standard deviations."""
    curvature = FLOAT(0.0)
    for i in range(guesses.u.shape[1]):
        moved = guesses.trial[g, i] - guesses.u[g, i]
        for j in range(guesses.u.shape[1]):
            other = guesses.trial[g, j] - guesses.u[g, j]
            curvature = curvature + moved * guesses.matrix[g, i, j] * other
    return curvature


@wp.kernel(enable_backward=False)
def judge(iteration: wp.int32, fits: Fits, guesses: Guesses, sums: Sums, p: FLOATS):
    """Move every guess that gains by it (thread = guess).

    Args:
        iteration: Its number, from 1.
        fits: What is known.
        guesses: All of them.
        sums: What the rollout added up of each world.
        p: Parameters of the worlds, shape (W, P).
    """
    g = wp.tid()
    if guesses.running[fits.fit_of[g]] == 0:
        return
    _linearise(g, fits, guesses, sums, p)
    curvature = _curvature(g, guesses)
    downhill = FLOAT(0.0)
    for i in range(guesses.u.shape[1]):
        downhill = downhill - guesses.gradient[g, i] * (guesses.trial[g, i] - guesses.u[g, i])
    cost = guesses.trial_cost[g]
    better = wp.isfinite(cost) and cost <= guesses.cost[g]
    gained = FLOAT(0.0)
    if better and wp.isfinite(guesses.cost[g]):
        gained = guesses.cost[g] - cost
    _damp(g, guesses, better, gained, downhill - FLOAT(0.5) * curvature)
    # a shorter step gains
    overshot = fits.persistent == 1 and not better and downhill > fits.idle_gain
    idle = guesses.idle[g] + 1
    if gained >= fits.idle_gain or overshot:
        idle = 0
    guesses.idle[g] = idle
    guesses.size[g] = wp.sqrt(wp.max(curvature, FLOAT(0.0)))
    if better:
        _move(g, guesses)
    _keep(g, iteration, guesses)


@wp.kernel(enable_backward=False)
def settle(fits: Fits, guesses: Guesses, sums: Sums, p: FLOATS):
    """Take a short step whatever the cost says, which cannot tell so near the least one (thread = guess).

    Args:
        fits: What is known.
        guesses: All of them.
        sums: What the rollout added up of each world.
        p: Parameters of the worlds, shape (W, P).
    """
    g = wp.tid()
    if guesses.running[fits.fit_of[g]] == 0:
        return
    _linearise(g, fits, guesses, sums, p)
    curvature = _curvature(g, guesses)
    short = curvature < FLOAT(SETTLED * SETTLED)
    if short and wp.isfinite(guesses.trial_cost[g]):
        _move(g, guesses)


@wp.func
def _factorise(g: wp.int32, guesses: Guesses, more: FLOAT):
    """Cholesky's factor of the damped matrix of the unknowns that move; whether it has one."""
    sound = wp.int32(1)
    for i in range(guesses.u.shape[1]):
        for j in range(i + 1):
            value = FLOAT(0.0)
            if guesses.fixed[g, i] == 0 and guesses.fixed[g, j] == 0:
                value = guesses.matrix[g, i, j]
            if i == j:
                value = value * (FLOAT(1.0) + guesses.damping[g]) + more
                value = value + wp.where(guesses.fixed[g, i] == 1, FLOAT(1.0), FLOAT(1e-300))
            for k in range(j):
                value = value - guesses.factor[g, i, k] * guesses.factor[g, j, k]
            if i == j:
                if not value > FLOAT(0.0):
                    sound = 0
                    value = FLOAT(1.0)
                guesses.factor[g, i, i] = wp.sqrt(value)
            else:
                guesses.factor[g, i, j] = value / guesses.factor[g, j, j]
    return sound


@wp.func
def _solve(g: wp.int32, fits: Fits, guesses: Guesses):
    """The damped step of a guess, given that of the unknowns that are fixed, cut to the longest allowed."""
    a = fits.fit_of[g]
    size = guesses.u.shape[1]
    if (
        _factorise(g, guesses, FLOAT(0.0)) == 0
    ):  # numbers so far apart that a guess determines nothing
        largest = FLOAT(0.0)
        for i in range(size):
            largest = wp.max(largest, guesses.matrix[g, i, i])
        _factorise(g, guesses, FLOAT(1.0) + FLOAT(1e-9) * largest)
    for i in range(size):  # forward, into the diagonal's place of what has been found
        if guesses.fixed[g, i] == 0:
            right = guesses.gradient[g, i]
            for j in range(size):
                if guesses.fixed[g, j] == 1:
                    right = right + guesses.matrix[g, i, j] * guesses.step[g, j]
            for k in range(i):
                if guesses.fixed[g, k] == 0:
                    right = right - guesses.factor[g, i, k] * guesses.step[g, k]
            guesses.step[g, i] = right / guesses.factor[g, i, i]
    for back in range(size):
        i = size - 1 - back
        if guesses.fixed[g, i] == 0:
            found = guesses.step[g, i]
            for k in range(i + 1, size):
                if guesses.fixed[g, k] == 0:
                    found = found - guesses.factor[g, k, i] * guesses.step[g, k]
            guesses.step[g, i] = found / guesses.factor[g, i, i]
    for i in range(size):
        if guesses.fixed[g, i] == 0:
            limit = fits.step_limit[a, i]
            guesses.step[g, i] = wp.clamp(-guesses.step[g, i], -limit, limit)


@wp.kernel(enable_backward=False)
def propose(fits: Fits, guesses: Guesses):
    """Where every guess tries to go: the damped Gauss-Newton step that respects the bounds (thread = guess)."""
    g = wp.tid()
    a = fits.fit_of[g]
    if guesses.running[a] == 0:
        return
    size = guesses.u.shape[1]
    for i in range(size):
        u = guesses.u[g, i]
        slope = guesses.gradient[g, i]
        guesses.step[g, i] = FLOAT(0.0)
        guesses.fixed[g, i] = 0
        if (u <= fits.lower[a, i] and slope > FLOAT(0.0)) or (
            u >= fits.upper[a, i] and slope < FLOAT(0.0)
        ):
            guesses.fixed[g, i] = 1
    left = wp.int32(3)
    while left > 0:
        left = left - 1
        _solve(g, fits, guesses)
        crosses = wp.int32(0)
        for i in range(size):
            to = guesses.u[g, i] + guesses.step[g, i]
            if guesses.fixed[g, i] == 0 and (to < fits.lower[a, i] or to > fits.upper[a, i]):
                bound = wp.clamp(to, fits.lower[a, i], fits.upper[a, i])
                guesses.step[g, i] = bound - guesses.u[g, i]
                guesses.fixed[g, i] = 1
                crosses = 1
        if crosses == 0:
            left = 0
    for i in range(size):
        to = guesses.u[g, i] + guesses.step[g, i]
        guesses.trial[g, i] = wp.clamp(to, fits.lower[a, i], fits.upper[a, i])


@wp.kernel(enable_backward=False)
def end(
    iteration: wp.int32,
    tolerance: FLOAT,
    fits: Fits,
    guesses: Guesses,
    iterations: INTS,
    going_on: INTS,
):
    """Which fits have ended, since all of their guesses have, and how many go on (thread = fit).

    Args:
        iteration: Its number, from 1.
        tolerance: Of a guess's step over its standard deviation.
        fits: What is known.
        guesses: All of them.
        iterations: Gets the number of those that go on until now, shape (A,).
        going_on: Gets how many go on, shape (1,).
    """
    a = wp.tid()
    if guesses.running[a] == 0:
        return
    iterations[a] = iteration
    on = wp.int32(0)
    for g in range(fits.first_guess[a], fits.first_guess[a + 1]):
        arrived = guesses.size[g] < tolerance or guesses.idle[g] >= IDLE_STEPS
        if not arrived and guesses.damping[g] <= FLOAT(DAMPED_OUT):
            on = 1
    guesses.running[a] = on
    wp.atomic_add(going_on, 0, on)
