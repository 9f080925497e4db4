"""Several driven joints at once, in a chain or a tree, with exact tangents.

Equation (1) of the paper (Chen et al. 2025, arXiv:2410.03920):

    H(q) a + b(q, v) = tau,        tau_j = m_j - (f_c + f_l |m_j|) tanh(v_j / v_s) - f_v v_j - k q_j,     m_j = k_t i_j

``H`` holds the armature on its diagonal, ``b`` gravity, centrifugal and Coriolis forces; a passive joint has ``k_t = 0``, and
perhaps a spring ``k`` about its zero. Supply limit, delay and departures from the paper are those of ``joint.py``.

Every body enters through its ten inertial parameters ``pi = (m, h, J)`` about its joint's frame, first moments ``h = m c`` and
rotational inertia ``J``. ``H`` and ``b`` are linear in them, so a direction in payload mass or centre of mass is one in ``pi``.

Spatial vectors (Featherstone, "Rigid Body Dynamics Algorithms", 2008) are taken at the origin of the base frame, angular part
first, so that nothing has to be moved between bodies: with the joint screws ``S_i``,

    V_i = V_p + S_i v_i,        A_i = A_p + S_i a_i + V_i x S_i v_i,        A_base = -gravity,
    f_i = I_i A_i + V_i x* I_i V_i,        tau_i = S_i . (sum of f over the subtree of i),
    H_ij = S_i . (sum of I over the subtree of j) S_j        for i on the way from j to the base.

Tangents. Along a direction, body i is displaced by a screw ``D_i = D_p + S_i dq_i``, and all that it carries moves with it. What
is left, ``[X_i] = dX_i - D_i x X_i``, obeys recursions in which ``D`` no longer occurs:

    [V_i] = [V_p] + S_i dv_i + (V_i x S_i) dq_i,
    [A_i] = [A_p] + (A_p x S_i) dq_i + (V_i x S_i) dv_i + [V_i] x S_i v_i,            at fixed a
    [f_i] = I_i [A_i] + [V_i] x* I_i V_i + V_i x* (I_i [V_i] + dI_i V_i) + dI_i A_i,
    [F_i] = [f_i] + sum over children c of [F_c] + (S_c x* F_c) dq_c,        d(inverse dynamics)_i = S_i . [F_i],

with ``F_i`` the sum of f over the subtree and ``dI_i`` the inertia that the direction itself adds. Then
``H da = d tau - d(inverse dynamics)(q, v, a)`` re-uses the factor of ``H``.

Code is unrolled over the joints for each tree (tuple of parents) and compiled once; geometry, kinds of joints and inertias are
data. In the functions without tangents each component of a matrix is assigned once, so that their adjoint is right: the tests hold
the tangents against one.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from proprio_ros.addons.paper.chain_kernels import (
    INERTIAL,
    JOINT_PARAMETERS,
    MAT33,
    ChainData,
    forward_kernel,
)
from proprio_ros.errors import SimulationError
from proprio_ros.robot import ReducedModel, inertia_about_origin, rotation_about
from proprio_ros.sim.joint import INTEGRATORS
from proprio_ros.sim.joint_kernels import VEC3
from proprio_ros.sim.runtime import FLOAT

PAYLOAD_JOINTS = ("prismatic", "universal")
_BLOCKS = (1, 8)
"""Directions that one thread may take: eight share one evaluation of the dynamics, at a quarter of the time of eight threads."""
_TRIANGLE = (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)  # rows and columns of J, in the order of pi


def inertial_parameters(pseudo: ArrayLike) -> NDArray[np.float64]:
    """The ten inertial parameters (m, hx, hy, hz, Jxx, Jyy, Jzz, Jxy, Jxz, Jyz) of pseudo-inertias (..., 4, 4); linear.

    Returns:
        Shape (..., 10): mass [kg], first moments [kg m], and rotational inertia about the frame's origin [kg m^2], whose
        products are entries of the matrix (Jxy = -int x y dm).
    """
    pseudo = np.asarray(pseudo, dtype=np.float64)
    rows, columns = _TRIANGLE
    second = pseudo[..., :3, :3]
    trace = np.trace(second, axis1=-2, axis2=-1)[..., None, None]
    inertia = trace * np.eye(3) - second
    return np.concatenate(
        [
            pseudo[..., 3, 3:],
            pseudo[..., :3, 3],
            inertia[..., rows, columns],
        ],
        axis=-1,
    )


def doubles(values: ArrayLike, dtype: Any, **kwargs: Any) -> wp.array:
    """An array on the CPU."""
    return wp.array(
        np.ascontiguousarray(
            values,
            dtype=np.float64,
        ),
        dtype=dtype,
        device="cpu",
        **kwargs,
    )


def constants_of(model: ReducedModel, friction_velocity: ArrayLike, supply: ArrayLike) -> Any:
    """What no parameter changes, as the kernels read it.

    Args:
        model: The bodies and their n joints.
        friction_velocity: Where Coulomb's law is smoothed [rad/s or m/s], shape (n,).
        supply: Voltage [V], back-EMF constant [V s/rad] and resistance [ohm] of each joint, shape (n, 3).
    """
    n = len(model.joint_names)
    turn = np.zeros((n, 3, 3, 3))
    shift = np.zeros((n, 2, 3))
    for i, kind in enumerate(model.kinds):
        placed = model.placement[i, :3, :3]
        axis = model.axes[i]
        shift[i, 0] = model.placement[i, :3, 3]
        if kind == "revolute":
            along = np.outer(axis, axis)
            turn[i] = (
                placed @ along,
                placed @ (rotation_about(axis, 0.5 * np.pi) - along),
                placed @ (np.eye(3) - along),
            )
        else:
            turn[i, 0] = placed
            shift[i, 1] = placed @ axis
    fixed = ChainData()
    fixed.turn = doubles(turn, MAT33)
    fixed.shift = doubles(shift, VEC3)
    fixed.axis = doubles(model.axes, VEC3)
    fixed.revolute = doubles([kind == "revolute" for kind in model.kinds], FLOAT)
    fixed.gravity = VEC3(*model.gravity)
    fixed.friction_velocity = doubles(friction_velocity, FLOAT)
    fixed.supply = doubles(supply, FLOAT)
    return fixed


class ChainSimulator:
    """Rolls out many worlds (guesses) of one run of a chain or tree in one launch.

    The rollout starts at the command's onset, time 0, in state (q0, v0). Sample k is taken at ``t_k - delay``; before the
    onset it is ``q0 + v0 (t_k - delay)``. Steps have length ``step_s`` (``fine_step_s`` while a joint with dry friction is near
    standstill), and the last one before a sample or a change of the input is shortened.

    Args:
        model: The bodies and their joints, n of them.
        sample_times_s: Encoder stamps after command onset [s], shape (T,), increasing.
        input_times_s: When any current changes [s], shape (S,), increasing, first at 0.
        input_current_A: The currents from each of those instants on [A], shape (S, n).
        friction_velocity: Where Coulomb's law is smoothed [rad/s, or m/s for a slide], one number or shape (n,).
        supply: (voltage [V], back-EMF constant [V s/rad], resistance [ohm]) of each joint, shape (n, 3); voltage 0, or None: no
            limit.
        integrator: ``"rk4"``, or ``"semi_implicit"`` (the paper's equation (2), with steps of 1/60/substeps).
        step_s, fine_step_s: Longest integration step [s], and that near standstill; None for ``step_s``.

    Raises:
        SimulationError: Unknown integrator, no samples, wrong shapes, instants out of order or steps that are not positive.

    Attributes:
        parameter_names: One for each of the P = 18 n + 1 columns of a parameter array, SI: ``torque_constant[JOINT]`` of all
            joints, then likewise ``coulomb``, ``viscous``, ``load_friction``, ``armature`` and ``stiffness``;
            ``pi[JOINT][0..9]`` (see ``inertial_parameters``); ``delay``; ``q0[JOINT]`` of all joints; ``v0[JOINT]`` of all joints.
        columns: The columns of each group: ``columns["pi"]`` is the slice of all ``pi[JOINT][k]``.
    """

    def __init__(
        self,
        model: ReducedModel,
        sample_times_s: ArrayLike,
        input_times_s: ArrayLike,
        input_current_A: ArrayLike,
        *,
        friction_velocity: ArrayLike,
        supply: ArrayLike | None = None,
        integrator: str = "rk4",
        step_s: float = 1.0 / 240.0,
        fine_step_s: float | None = None,
    ) -> None:
        n = len(model.joint_names)
        samples = np.asarray(sample_times_s, dtype=np.float64)
        switches = np.asarray(input_times_s, dtype=np.float64)
        current = np.asarray(input_current_A, dtype=np.float64)
        smoothing = np.asarray(friction_velocity, dtype=np.float64)
        limits = np.zeros((n, 3)) if supply is None else np.asarray(supply, dtype=np.float64)
        fine = step_s if fine_step_s is None else min(fine_step_s, step_s)
        if integrator not in INTEGRATORS:
            raise SimulationError(
                f"unknown integrator {integrator!r}: choose one of {', '.join(INTEGRATORS)}"
            )
        _check_instants(samples, switches)
        _check_joints(model.joint_names, switches, current, limits, smoothing)
        if not fine > 0.0:
            raise SimulationError(
                f"the integration step is {fine} s: step_s and fine_step_s must be positive"
            )
        self.model = model
        self.integrator = integrator
        self.parameter_names = _names_of_parameters(model.joint_names)
        self.columns = _columns_of_parameters(n)
        self._n = n
        self._parents = tuple(model.parents.tolist())
        self._vec = wp.types.vector(length=n, dtype=FLOAT)
        self._fixed = constants_of(model, np.broadcast_to(smoothing, (n,)), limits)
        self._samples = doubles(samples, FLOAT)
        self._switches = doubles(switches, FLOAT)
        self._current = doubles(current, self._vec)
        self._steps = (step_s, fine)

    def jacobian(
        self,
        p: ArrayLike,
        dp: ArrayLike,
    ) -> tuple[NDArray[np.float64], ...]:
        """Positions and velocities at the sample instants, with exact forward sensitivities of the positions.

        ``p``: parameters of each world, shape (W, P); ``dp``: D tangent directions of each world in parameter space,
        shape (W, P, D).

        Returns: q [rad or m] (W, T, n), v [rad/s or m/s] (W, T, n) and dq (W, T, n, D).

        Raises `SimulationError`: Parameters or directions have the wrong shape.
        """
        p = np.ascontiguousarray(p, dtype=np.float64)
        directions = np.asarray(dp, dtype=np.float64)
        columns = len(self.parameter_names)
        if p.ndim != 2 or p.shape[1] != columns:
            raise SimulationError(f"parameters have shape {p.shape}: give (worlds, {columns})")
        if directions.ndim != 3 or directions.shape[:2] != p.shape or directions.shape[2] == 0:
            raise SimulationError(
                f"directions have shape {directions.shape}: give ({p.shape[0]}, {columns}, D)"
            )
        worlds = len(p)
        samples = len(self._samples)
        per_world = directions.shape[2]
        rows = (worlds, worlds, worlds * per_world)
        outputs = [wp.empty((count, samples), dtype=self._vec, device="cpu") for count in rows]
        block = next((size for size in _BLOCKS if size >= per_world), _BLOCKS[-1])
        along = doubles(
            directions.transpose(0, 2, 1).reshape(-1, columns),
            FLOAT,
        )
        run = [
            self._fixed,
            self._samples,
            self._switches,
            self._current,
            *self._steps,
        ]
        wp.launch(
            forward_kernel(self._parents, self.integrator, block),
            dim=(worlds, -(-per_world // block)),
            inputs=[*run, doubles(p, FLOAT), along, per_world],
            outputs=outputs,
            device="cpu",
        )
        q, v, dq = (array.numpy().copy() for array in outputs)
        sensitivities = dq.reshape(worlds, per_world, samples, self._n)
        return q, v, np.ascontiguousarray(sensitivities.transpose(0, 2, 3, 1))


def _names_of_parameters(joints: Sequence[str]) -> tuple[str, ...]:
    """Of the columns of a parameter array."""
    names = [f"{group}[{joint}]" for group in JOINT_PARAMETERS for joint in joints]
    for joint in joints:
        names += [f"pi[{joint}][{k}]" for k in range(INERTIAL)]
    names.append("delay")
    for group in ("q0", "v0"):
        names += [f"{group}[{joint}]" for joint in joints]
    return tuple(names)


def _columns_of_parameters(n: int) -> dict[str, slice]:
    """Of each group of them, for n joints."""
    sizes = dict.fromkeys(JOINT_PARAMETERS, n)
    sizes |= {"pi": INERTIAL * n, "delay": 1, "q0": n, "v0": n}
    columns = {}
    start = 0
    for group, size in sizes.items():
        columns[group] = slice(start, start + size)
        start += size
    return columns


def _check_instants(samples: np.ndarray, switches: np.ndarray) -> None:
    """Raises `SimulationError`: Samples or changes of the input are in no order."""
    if samples.ndim != 1 or len(samples) == 0 or np.any(np.diff(samples) < 0.0):
        raise SimulationError("sample_times_s must be one or more increasing instants in s")
    some = switches.ndim == 1 and len(switches) > 0
    if not some or switches[0] != 0.0 or np.any(np.diff(switches) <= 0.0):
        raise SimulationError("input_times_s must be increasing instants in s, the first of them 0")


def _check_joints(
    joints: Sequence[str],
    switches: np.ndarray,
    current: np.ndarray,
    limits: np.ndarray,
    smoothing: np.ndarray,
) -> None:
    """Whether each joint has a current, a supply and a velocity over which its friction is smoothed.

    Args:
        joints: Names of the n joints.
        switches: When the currents change, shape (S,).
        current: The currents, which should have shape (S, n).
        limits: Voltage, back-EMF constant and resistance, which should have shape (n, 3).
        smoothing: Velocities, which should have shape () or (n,).

    Raises:
        SimulationError: They have not, or are negative.
    """
    n = len(joints)
    if current.shape != (len(switches), n):
        raise SimulationError(
            f"input_current_A has shape {current.shape}: give a row for each of the {len(switches)} instants of "
            f"input_times_s and a column for each joint ({', '.join(joints)})"
        )
    fits = limits.shape == (n, 3) and not np.any(limits < 0.0)
    if not fits or np.any((limits[:, 0] > 0.0) & (limits[:, 2] == 0.0)):
        raise SimulationError(
            "supply must be (voltage, back-EMF constant, resistance) of each joint, not negative"
        )
    if smoothing.shape not in ((), (n,)) or not np.all(smoothing > 0.0):
        raise SimulationError(
            "friction_velocity must be one positive number, or one for each joint"
        )


def attach_payload_joint(
    model: ReducedModel,
    frame: str,
    kind: str,
    axes: ArrayLike,
    pseudo_inertia: ArrayLike,
    name: str = "payload",
) -> ReducedModel:
    """Hang a payload on a joint of its own, so that it moves in the hand: what slides, sloshes or dangles.

    Args:
        model: The robot, some joints held.
        frame: Link that holds the payload; the joint sits at its frame's origin.
        kind: ``"prismatic"`` (one slide, joint ``NAME_slide``), or ``"universal"`` (two hinges at one point, joints
            ``NAME_swing_1`` and ``NAME_swing_2``, the second carried by the first, a massless body between them).
        axes: In the frame's axes, need not be unit vectors; shape (3,), or of the hinges (2, 3).
        pseudo_inertia: Of the payload about the frame with the new joints at zero, shape (4, 4).
        name: Of the payload's own frame in the result, and the start of the joints' names.

    Raises:
        SimulationError: Unknown frame or kind, a name that is taken, axes that are no axes (or are parallel), or a payload
            that has no inertia about them.
    """
    if frame not in model.frames:
        raise SimulationError(
            f"there is no frame {frame!r} to hold a payload: choose from {', '.join(model.frames)}"
        )
    if kind not in PAYLOAD_JOINTS:
        raise SimulationError(
            f"unknown payload joint {kind!r}: choose one of {', '.join(PAYLOAD_JOINTS)}"
        )
    directions = _unit_axes(kind, axes)
    pseudo = np.asarray(pseudo_inertia, dtype=np.float64)
    _check_inertia(kind, directions, pseudo)
    if kind == "prismatic":
        names = [f"{name}_slide"]
        kinds = ["prismatic"]
        bodies = [pseudo]
    else:
        names = [f"{name}_swing_1", f"{name}_swing_2"]
        kinds = ["revolute"] * 2
        bodies = [np.zeros((4, 4)), pseudo]
    for new in (name, *names):
        if new in (*model.frames, *model.joint_names):
            raise SimulationError(
                f"{new!r} is already a joint or frame of the model: choose another name"
            )
    parent, placement = model.frames[frame]
    # the first new joint sits in the hand, a second one on the first
    first = len(model.joint_names)
    added = len(names)
    parents = [*model.parents, *[parent, first][:added]]
    return replace(
        model,
        joint_names=(*model.joint_names, *names),
        kinds=(*model.kinds, *kinds),
        parents=np.array(parents, dtype=np.int64),
        placement=np.concatenate([model.placement, [placement, np.eye(4)][:added]]),
        axes=np.concatenate([model.axes, directions]),
        pseudo_inertia=np.concatenate([model.pseudo_inertia, bodies]),
        frames={**model.frames, name: (first + added - 1, np.eye(4))},
    )


def _unit_axes(kind: str, axes: ArrayLike) -> np.ndarray:
    """Axes of a payload joint as unit vectors, shape (1, 3) or (2, 3). Raises `SimulationError`: They are no axes."""
    wanted = (3,) if kind == "prismatic" else (2, 3)
    directions = np.asarray(axes, dtype=np.float64)
    if directions.shape != wanted or not np.all(np.linalg.norm(directions, axis=-1) > 0.0):
        raise SimulationError(
            f"a {kind} payload joint needs non-zero axes of shape {wanted}, got {directions.tolist()}"
        )
    unit: np.ndarray = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    return unit.reshape(-1, 3)


def _check_inertia(kind: str, directions: np.ndarray, pseudo: np.ndarray) -> None:
    """Raises `SimulationError`: A pseudo-inertia is no such matrix, or nothing resists a payload joint along these axes (A, 3)."""
    if pseudo.shape != (4, 4) or not np.all(np.isfinite(pseudo)):
        raise SimulationError("the payload's pseudo-inertia must be a finite 4 x 4 matrix")
    if kind == "prismatic":
        smallest = pseudo[3, 3]
    else:
        # singular as well when the hinges are parallel
        smallest = np.linalg.eigvalsh(directions @ inertia_about_origin(pseudo) @ directions.T)[0]
    if not smallest > 1e-12 * max(float(np.trace(pseudo)), 1e-12):
        raise SimulationError(
            f"the payload has no inertia against its {kind} joint: give it a mass, away from hinges that are not parallel"
        )
