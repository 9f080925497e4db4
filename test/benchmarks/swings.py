"""How often the interval of a weighing from free swings holds, on pendulums that an independent simulation let go.

Each pendulum has a random rotor, random friction (Coulomb, viscous, a rise towards standstill) that differs by 8 % from swing to
swing, an encoder of 4096 counts and 100 Hz, whose readings are up to 8 ms old. With ``--harsh``, friction also grows with the
weight that the gears carry, which our model does not know. Two known loads calibrate, a third is asked.

    python test/benchmarks/swings.py [--pendulums 20] [--harsh]
"""

from __future__ import annotations

import tempfile
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from results import Results, parser_of

from proprio_ros.errors import ProprioError
from proprio_ros.identification.prepared_runs import KnownLoad
from proprio_ros.identification.robot_calibration import LoadedRun, calibrate
from proprio_ros.probes.payload.identify import weigh
from proprio_ros.quantity import Z95
from proprio_ros.recordings.runs import cut_runs
from proprio_ros.records import JointRecord, Recording, Run
from proprio_ros.robot import Robot, load_robot
from proprio_ros.sim.payload import PayloadFacts, PayloadShape

ARM_M = 0.1
GRAVITY = 9.81
SPREAD_M2 = 0.0025
ROD_KG = 0.03
ROD_M = 0.05
COUNT_RAD = 2.0 * np.pi / 4096.0
PERIOD_S = 0.01
AGE_S = 0.008
STEP_S = 2.5e-4
RELEASED_S = 0.1
LASTS_S = 4.0

URDF = """<robot name="swing"><link name="base"/><link name="tip"/>
<link name="rod"><inertial><origin xyz="0 0 -0.05"/><mass value="0.03"/>
<inertia ixx="1e-5" iyy="1e-5" izz="1e-5" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="pivot" type="revolute"><parent link="base"/><child link="rod"/><axis xyz="0 1 0"/>
<limit lower="-3.2" upper="3.2" velocity="30" effort="5"/></joint>
<joint name="end" type="fixed"><parent link="rod"/><child link="tip"/><origin xyz="0 0 -0.1"/></joint></robot>"""
ROBOT = """name: swing
urdf: swing.urdf
payload_frame: tip
joints:
  pivot:
    motor: {nominal_torque_constant_N_m_per_A: 1.0, encoder_resolution_rad: 0.00153398, encoder_noise_rad: 0.0005}
    drive_train:
      torque_constant_N_m_per_A: 1.0
      coulomb_N_m: {value: 0.1, std: 0.2}
      viscous_N_m_s_per_rad: {value: 0.0, std: 0.1}
      load_friction: {value: 0.0, std: 0.1}
      armature_kg_m2: {value: 0.02, std: 0.02}
"""


def robot_in(folder: Path) -> Robot:
    """A pendulum without a weight of its own, whose drive train is open."""
    (folder / "swing.urdf").write_text(URDF)
    (folder / "swing.yaml").write_text(ROBOT)
    return load_robot(folder / "swing.yaml")


def facts() -> PayloadFacts:
    """Of every load: a disc in the middle of the tip."""
    return PayloadFacts(
        shape=PayloadShape.from_inertia_per_mass([SPREAD_M2, SPREAD_M2, SPREAD_M2, 0.0, 0.0, 0.0])
    )


@dataclass(frozen=True)
class Pendulums:
    """Several on one machine, each with a load; terms of each in arrays, (n,).

    Attributes:
        moment: Of the weight when it is level [N m].
        inertia: About the pivot [kg m2].
        factor: By which friction differs from swing to swing.
        machine: The drive train, as `machine_of` draws it.
    """

    moment: np.ndarray
    inertia: np.ndarray
    factor: np.ndarray
    machine: dict[str, Any]
    harsh: bool

    def acceleration(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """At angles [rad] and speeds [rad/s], (n,) [rad/s2]."""
        machine = self.machine
        weight = self.moment * np.sin(q)
        dry = machine["coulomb"] + (machine["load"] * np.abs(weight) if self.harsh else 0.0)
        dry = dry * (1.0 + machine["rise"] * np.exp(-((v / machine["rise_speed"]) ** 2)))
        friction = self.factor * (dry * np.tanh(v / 0.005) + machine["viscous"] * v)
        return (-weight - friction) / self.inertia

    def path(self, start: np.ndarray) -> np.ndarray:
        """Angles every `STEP_S`, by Runge and Kutta's fourth order, from rest at `start` [rad], (steps + 1, n)."""
        q = start.copy()
        v = np.zeros(len(start))
        track = [start.copy()]
        for _ in range(round(LASTS_S / STEP_S)):
            a1 = self.acceleration(q, v)
            a2 = self.acceleration(
                q + 0.5 * STEP_S * v,
                v + 0.5 * STEP_S * a1,
            )
            a3 = self.acceleration(
                q + 0.5 * STEP_S * (v + 0.5 * STEP_S * a1),
                v + 0.5 * STEP_S * a2,
            )
            a4 = self.acceleration(
                q + STEP_S * (v + 0.5 * STEP_S * a2),
                v + STEP_S * a3,
            )
            q = q + STEP_S * v + STEP_S**2 / 6.0 * (a1 + a2 + a3)
            v = v + STEP_S / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
            track.append(q)
        return np.array(track)


def released(
    rng: np.random.Generator,
    masses: np.ndarray,
    machine: dict[str, Any],
    harsh: bool,
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Stamps [s] and readings [rad] of one swing per mass; the servo holds until RELEASED_S.

    Args:
        rng: Draws where each begins, its friction and its readings.
        masses: Of the loads [kg].
        machine: The drive train.
        harsh: Whether friction grows with the weight that the gears carry.
    """
    count = len(masses)
    pendulums = Pendulums(
        moment=(masses * ARM_M + ROD_KG * ROD_M) * GRAVITY,
        inertia=machine["armature"] + ROD_KG * ROD_M**2 + 1e-5 + masses * (ARM_M**2 + SPREAD_M2),
        factor=1.0 + 0.08 * rng.standard_normal(count),
        machine=machine,
        harsh=harsh,
    )
    path = pendulums.path(-rng.uniform(1.2, 1.6, count))
    return [read(rng, path[:, column]) for column in range(count)]


def read(rng: np.random.Generator, path: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Stamps [s] and what the encoder says at them [rad] of angles every `STEP_S`, in a register that is renewed every 8 ms."""
    stamps = np.arange(0.0, LASTS_S, PERIOD_S) + 3e-4 * rng.standard_normal(
        round(LASTS_S / PERIOD_S)
    )
    seen = AGE_S * np.floor(stamps / AGE_S + rng.uniform()) - RELEASED_S
    row = np.clip(np.rint(seen / STEP_S).astype(int), 0, len(path) - 1)
    reading = path[row] + 5e-4 * rng.standard_normal(len(row))
    return stamps, COUNT_RAD * np.rint(reading / COUNT_RAD)


def as_run(
    name: str,
    stamps_s: np.ndarray,
    reading: np.ndarray,
) -> Run:
    """Cut out as from a bag that says when torque went off."""
    times_ns = 1_000_000_000 + np.rint(1e9 * stamps_s).astype(np.int64)
    off = (int(1_000_000_000 + 1e9 * RELEASED_S), int(times_ns[-1]) + 1)
    recording = Recording(
        name,
        JointRecord(
            times_ns,
            ("pivot",),
            reading[:, None],
        ),
        None,
        (),
        (off,),
    )
    return cut_runs(recording, joints=["pivot"])[0]


def machine_of(rng: np.random.Generator) -> dict[str, Any]:
    """A random drive train."""
    return {
        "armature": float(np.exp(rng.uniform(np.log(0.005), np.log(0.04)))),
        "coulomb": rng.uniform(0.04, 0.2),
        "viscous": rng.uniform(0.0, 0.03),
        "rise": rng.uniform(0.0, 0.4),
        "rise_speed": rng.uniform(0.05, 0.4),
        "load": rng.uniform(0.0, 0.25),
    }


@dataclass(frozen=True)
class Swung:
    """An answer: its error as a part of the truth, and in standard deviations."""

    off: float
    sigmas: float


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the error and the interval of each, and how many held."""
    parser = parser_of(__doc__)
    parser.add_argument("--pendulums", type=int, default=20)
    parser.add_argument("--harsh", action="store_true")
    options = parser.parse_args(arguments)
    results = Results(__file__, options.json, arguments)
    rng = np.random.default_rng(7)
    found = []
    with tempfile.TemporaryDirectory() as folder:
        robot = robot_in(Path(folder))
        for number in range(options.pendulums):
            machine = machine_of(rng)
            masses = rng.uniform(0.45, 1.3, 3)
            while abs(masses[0] - masses[1]) < 0.2:
                masses[:2] = rng.uniform(0.45, 1.3, 2)
            swings = released(rng, masses, machine, options.harsh)
            runs = [as_run(f"s{n}", *swing) for n, swing in enumerate(swings)]
            try:
                each = swung(robot, runs, masses, f"{number}")
            except ProprioError as error:
                print(f"{number}: {error}", flush=True)
            else:
                found.append(each)
    tell(results, found, options)
    results.keep()


def swung(robot: Robot, runs: Sequence[Run], masses: np.ndarray, name: str) -> Swung:
    """The third load by its swing, calibrated by those of two known ones; told in a line.

    Args:
        robot: The pendulum.
        runs: A swing for each load.
        masses: Of the loads [kg], (3,).
        name: Of the line.

    Raises:
        ProprioError: The calibration or the weighing is refused.
    """
    known = [
        LoadedRun(run, KnownLoad(float(mass), facts()))
        for run, mass in zip(runs[:2], masses[:2], strict=True)
    ]
    learnt = calibrate(robot, known)
    if learnt.calibration is None or learnt.verdict.value != "accepted":
        raise ProprioError("; ".join(learnt.reasons))
    estimate = weigh(robot.with_calibration(learnt.calibration), runs[2:], facts())
    value = estimate.values[0]
    if not isinstance(value.value, float) or not isinstance(value.std, float):
        raise ProprioError(f"{estimate.verdict.value}: {'; '.join(estimate.reasons)}")
    truth = masses[2]
    found = Swung(value.value / truth - 1.0, (value.value - truth) / value.std)
    print(
        f"{name}: {truth:.3f} kg {100.0 * found.off:+.2f} %, sd {100.0 * value.std / truth:.2f} %, {found.sigmas:+.1f} sd",
        flush=True,
    )
    return found


def tell(results: Results, found: Sequence[Swung], options: Namespace) -> None:
    """The row of all answers; none without any."""
    results.table(
        "swings",
        {
            "pendulums": "{pendulums}",
            "answered": "{answered} of {asked}",
            "mean error, worst": "{mean:.2f}, {worst:.2f} %",
            "intervals that hold": "{hold:.0f} %",
            "farthest, in sd": "{farthest:.1f}",
        },
    )
    if found:
        off = 100.0 * np.abs([each.off for each in found])
        sigmas = np.abs([each.sigmas for each in found])
        results.row(
            "swings",
            pendulums="harsh" if options.harsh else "as the model knows them",
            answered=len(found),
            asked=options.pendulums,
            mean=np.mean(off),
            worst=np.max(off),
            hold=100.0 * np.mean(sigmas < Z95),
            farthest=np.max(sigmas),
        )


if __name__ == "__main__":
    main()
