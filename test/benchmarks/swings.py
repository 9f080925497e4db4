"""How often the interval of a weighing from free swings holds, on pendulums that an independent simulation let go.

Each pendulum has a random rotor, random friction (Coulomb, viscous, a rise towards standstill) that differs by 8 % from swing to
swing, an encoder of 4096 counts and 100 Hz, whose readings are up to 8 ms old. With ``--harsh``, friction also grows with the
weight that the gears carry, which our model does not know. Two known loads calibrate, a third is asked.

    python test/benchmarks/swings.py [--pendulums 20] [--harsh]
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
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


def released(
    rng: np.random.Generator,
    masses: np.ndarray,
    machine: dict[str, Any],
    harsh: bool,
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Stamps [s] and readings [rad] of one swing per mass; the servo holds until RELEASED_S."""
    count = len(masses)
    moment = (masses * ARM_M + ROD_KG * ROD_M) * GRAVITY
    inertia = machine["armature"] + ROD_KG * ROD_M**2 + 1e-5 + masses * (ARM_M**2 + SPREAD_M2)
    factor = 1.0 + 0.08 * rng.standard_normal(count)
    start = -rng.uniform(1.2, 1.6, count)

    def rate(
        q: np.ndarray,
        v: np.ndarray,
    ) -> np.ndarray:
        weight = moment * np.sin(q)
        dry = machine["coulomb"] + (machine["load"] * np.abs(weight) if harsh else 0.0)
        dry = dry * (1.0 + machine["rise"] * np.exp(-((v / machine["rise_speed"]) ** 2)))
        return (-weight - factor * (dry * np.tanh(v / 0.005) + machine["viscous"] * v)) / inertia

    q, v, track = start.copy(), np.zeros(count), [start.copy()]
    for _ in range(round(LASTS_S / STEP_S)):
        a1 = rate(q, v)
        a2 = rate(
            q + 0.5 * STEP_S * v,
            v + 0.5 * STEP_S * a1,
        )
        a3 = rate(
            q + 0.5 * STEP_S * (v + 0.5 * STEP_S * a1),
            v + 0.5 * STEP_S * a2,
        )
        a4 = rate(
            q + STEP_S * (v + 0.5 * STEP_S * a2),
            v + STEP_S * a3,
        )
        q = q + STEP_S * v + STEP_S**2 / 6.0 * (a1 + a2 + a3)
        v = v + STEP_S / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
        track.append(q)
    path = np.array(track)
    swings = []
    for column in range(count):
        stamps = np.arange(0.0, LASTS_S, PERIOD_S) + 3e-4 * rng.standard_normal(
            round(LASTS_S / PERIOD_S)
        )
        # the register is renewed every 8 ms
        seen = AGE_S * np.floor(stamps / AGE_S + rng.uniform()) - RELEASED_S
        row = np.clip(
            np.rint(seen / STEP_S).astype(int),
            0,
            len(path) - 1,
        )
        reading = path[row, column] + 5e-4 * rng.standard_normal(len(row))
        swings.append((stamps, COUNT_RAD * np.rint(reading / COUNT_RAD)))
    return swings


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


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the error and the interval of each, and how many held."""
    parser = parser_of(__doc__)
    parser.add_argument("--pendulums", type=int, default=20)
    parser.add_argument("--harsh", action="store_true")
    options = parser.parse_args(arguments)
    results = Results(__file__, options.json, arguments)
    count = options.pendulums
    harsh = options.harsh
    rng = np.random.default_rng(7)
    off = []
    sigmas = []
    refused = 0
    with tempfile.TemporaryDirectory() as folder:
        robot = robot_in(Path(folder))
        for number in range(count):
            machine = machine_of(rng)
            masses = rng.uniform(0.45, 1.3, 3)
            while abs(masses[0] - masses[1]) < 0.2:
                masses[:2] = rng.uniform(0.45, 1.3, 2)
            runs = [
                as_run(f"s{n}", *swing)
                for n, swing in enumerate(released(rng, masses, machine, harsh))
            ]
            known = [
                LoadedRun(run, KnownLoad(float(m), facts()))
                for run, m in zip(runs[:2], masses[:2], strict=True)
            ]
            try:
                learnt = calibrate(robot, known)
                if learnt.calibration is None or learnt.verdict.value != "accepted":
                    raise ProprioError("; ".join(learnt.reasons))
                estimate = weigh(
                    robot.with_calibration(learnt.calibration),
                    runs[2:],
                    facts(),
                )
            except ProprioError as error:
                refused += 1
                print(f"{number}: {error}", flush=True)
                continue
            value = estimate.values[0]
            if not isinstance(value.value, float) or not isinstance(value.std, float):
                refused += 1
                print(
                    f"{number}: {estimate.verdict.value}: {'; '.join(estimate.reasons)}", flush=True
                )
                continue
            off.append(100.0 * (value.value / masses[2] - 1.0))
            sigmas.append((value.value - masses[2]) / value.std)
            print(
                f"{number}: {masses[2]:.3f} kg {off[-1]:+.2f} %, sd {100.0 * value.std / masses[2]:.2f} %, {sigmas[-1]:+.1f} sd",
                flush=True,
            )
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
    if off:
        results.row(
            "swings", pendulums="harsh" if harsh else "as the model knows them", answered=len(off), asked=count,
            mean=np.mean(np.abs(off)), worst=np.max(np.abs(off)), hold=100.0 * np.mean(np.abs(sigmas) < Z95),
            farthest=np.max(np.abs(sigmas)),
        )  # fmt: skip
    results.keep()


if __name__ == "__main__":
    main()
