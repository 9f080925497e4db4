"""One Jacobian pass (five worlds, three directions, RK4) against the same algorithm in plain C, ``joint_pass.c``."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from case import STARTS_KG, Case, Row, Timing, measure_in_turn

from proprio_ros.sim.joint import INDEX, JointRun, JointSimulator

GOAL = 1.5
EQUAL = 1e-10
FLAGS = ("-O3", "-march=native")
SOURCE = Path(__file__).with_name("joint_pass.c")

Arrays = tuple[np.ndarray, np.ndarray, np.ndarray]


class CPass:
    """``joint_pass`` for one run, buffers bound once.

    Args:
        run: what is simulated.
        p: parameters, shape (W, P).
        dp: tangent directions, shape (W, P, D).
        folder: where the library is built.
    """

    def __init__(
        self,
        run: JointRun,
        p: np.ndarray,
        dp: np.ndarray,
        folder: str,
    ) -> None:
        library = Path(folder) / f"joint_pass_{dp.shape[2]}.so"
        if not library.exists():
            command = [
                "gcc",
                *FLAGS,
                f"-DD={dp.shape[2]}",
                "-shared",
                "-fPIC",
                str(SOURCE),
                "-o",
                str(library),
                "-lm",
            ]
            subprocess.run(command, check=True)
        self._function = ctypes.CDLL(str(library)).joint_pass
        self._function.restype = None
        constants = np.array(
            [*run.supply, run.friction_velocity, run.step_s, min(run.fine_step_s, run.step_s)]
        )
        worlds = len(p)
        samples = len(run.sample_times_s)
        self.out: Arrays = (
            np.zeros((worlds, samples)), np.zeros((worlds, samples)), np.zeros((worlds, samples, dp.shape[2])),
        )  # fmt: skip
        given = [
            run.sample_times_s,
            run.input_times_s,
            run.input_current_A,
            constants,
            p,
            dp,
        ]
        self._arrays = [np.ascontiguousarray(values, dtype=np.float64) for values in given]
        times, switches, currents, constants, p, dp = (
            self._pointer(values) for values in self._arrays
        )
        self._arguments = (
            ctypes.c_int(worlds), ctypes.c_int(samples), times, ctypes.c_int(len(run.input_times_s)), switches, currents,
            constants, p, dp, *(self._pointer(values) for values in self.out),
        )  # fmt: skip

    @staticmethod
    def _pointer(values: np.ndarray) -> ctypes.c_void_p:
        return ctypes.c_void_p(values.ctypes.data)

    def __call__(self) -> Arrays:
        self._function(*self._arguments)
        return self.out


def hard_run(run: JointRun) -> JointRun:
    """The same run with everything that the law knows: a changing current, and a supply that limits it."""
    current = float(run.input_current_A[0])
    return replace(
        run,
        input_times_s=np.array([0.0, 0.11, 0.24]),
        input_current_A=np.array([current, -0.5 * current, 4.0 * current]),
        supply=(6.0, 2.49, 5.22),
        fine_step_s=run.step_s / 16.0,
    )


def hard_parameters(
    p: np.ndarray,
    dp: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Friction and a delay, and a direction along the delay."""
    p = p.copy()
    dp = dp.copy()
    for name, value in (
        ("coulomb", 0.03),
        ("viscous", 0.01),
        ("load_friction", 0.05),
        ("delay", 0.004),
    ):
        p[:, INDEX[name]] = value
    dp[:, INDEX["delay"], 2] = 0.01
    dp[:, INDEX["coulomb"], 0] = 0.1
    return p, dp


def difference(ours: Arrays, theirs: Arrays) -> float:
    """Largest difference, relative to the largest number of each array."""
    return max(
        float(np.abs(a - b).max() / np.abs(b).max()) for a, b in zip(ours, theirs, strict=True)
    )


def launcher(
    simulator: JointSimulator,
    p: np.ndarray,
    dp: np.ndarray,
) -> Callable[[], object]:
    """The bare kernel launch on arguments that are already in place."""
    simulator.jacobian(
        np.zeros(len(p), dtype=np.int32),
        p,
        dp,
    )
    (launch,) = simulator._launches.values()
    return launch._command.launch


def rows(case: Case) -> list[Row]:
    """Agreement and times, on the recording and on a harder run."""
    if shutil.which("gcc") is None:
        return [Row("plain C, one Jacobian pass", note="skipped: no gcc")]
    easy_run = case.problem.simulator.runs[0]
    easy = case.parameters(np.array(STARTS_KG))
    with tempfile.TemporaryDirectory() as folder:
        return [
            *_pair("the recording", easy_run, *easy, folder),
            *_pair(
                "with friction, delay, supply limit",
                hard_run(easy_run),
                *hard_parameters(*easy),
                folder,
            ),
        ]


def _pair(
    name: str,
    run: JointRun,
    p: np.ndarray,
    dp: np.ndarray,
    folder: str,
) -> list[Row]:
    worlds = np.zeros(len(p), dtype=np.int32)
    simulator = JointSimulator([run])

    def call() -> Arrays:
        return simulator.jacobian(worlds, p, dp)

    plain = CPass(run, p, dp, folder)
    apart = difference(call(), plain())
    what = f"gcc {' '.join(FLAGS)}, one Jacobian pass, {name}"
    if not apart <= EQUAL:
        return [Row(what, None, "void", False, f"results differ by {apart:.1e}")]
    contestants = (plain, launcher(simulator, p, dp), call)
    theirs, kernel, whole = measure_in_turn(
        contestants, repeats=15, calls=(100, 100, 100), warm_up=20
    )
    return [
        Row(what, theirs, note=f"same numbers to {apart:.0e}"),
        _beside_c("  our kernel", kernel, theirs),
        _beside_c("  our JointSimulator.jacobian(), copies included", whole, theirs),
    ]


def _beside_c(what: str, ours: Timing, theirs: Timing) -> Row:
    ratio = ours.median / theirs.median
    return Row(what, ours, f"{ratio:.2f}x C (goal <= {GOAL:g}x)", ratio <= GOAL)
