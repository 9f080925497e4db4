"""How well servos that a voltage drives are weighed with known loads: servos drawn at random, moved by MuJoCo.

Each servo runs its own position law (duty = gain x (goal - position), limited) on a supply that sags, with a torque constant, a
rotor, dry and viscous friction and a share of the torque that its gears lose, drawn as a robot file states them: torque constant to
a third, friction not at all. MuJoCo's dry friction sticks, and changes by 8 % from motion to motion. Goals reach the servo 10 to 35
ms late. Recorded are goal, position (4096 counts) and battery voltage, 100 Hz, as bags; two motions each with three known loads
calibrate, and others with a load that nobody stated are asked: what `proprio calibrate` and `proprio replay` say.

    python test/benchmarks/servos.py [--servos 100] [--first 0] [--rate 100]
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from results import Results, each_answer, parser_of
from scipy.stats import binomtest
from support.machines import pendulum_urdf
from support.servo_bag import write
from support.sines import Sines

from proprio_ros.errors import ProprioError
from proprio_ros.identification.estimate import Verdict
from proprio_ros.pipeline.calibrate import calibrate_from_bags
from proprio_ros.pipeline.replay import replay
from proprio_ros.pipeline.request import Options

ARM_M = 0.1
ROD_KG = 0.01
GRAVITY = 9.80665
KNOWN_KG = (0.3, 0.7, 1.1)
POINT: dict[str, Any] = {"payload.com": [0.0, 0.0, 0.0], "payload.shape": "point"}
GAIN = 2.656
STEP_S = 0.0005
COUNT_RAD = 0.00153398
LASTS_S = 10.0
LAW = "{kind: position_servo, gain_per_rad: 2.656, limit: 0.97, goal_speed_rad_s: 5.215}"
FILE = f"""name: servo
urdf: servo.urdf
payload_frame: tip
delay_s: {{value: 0.02, std: 0.02}}
joints:
  pendulum:
    motor:
      nominal_torque_constant_N_m_per_A: 1.21
      resistance_ohm: 2.68
      back_emf_V_s_per_rad: 1.21
      encoder_resolution_rad: 0.00153398
      driven_by: {LAW}
    drive_train:
      torque_constant_N_m_per_A: {{value: 1.21, std: 0.4}}
"""
PENDULUM = """<mujoco><option timestep="{step}" gravity="0 0 -{gravity}" integrator="implicitfast"/><worldbody><body>
<joint name="j" type="hinge" axis="0 1 0" armature="{armature}" damping="{viscous}" frictionloss="0.05"/>
<inertial pos="0 0 {centre}" mass="{mass}" diaginertia="{inertia} {inertia} 1e-6"/></body></worldbody>
<actuator><motor joint="j"/></actuator></mujoco>"""


def counted(angle: float) -> float:
    """As an encoder of 4096 counts a turn has it [rad]."""
    return round(angle / COUNT_RAD) * COUNT_RAD


class Servo:
    """One servo.

    Args:
        random: what it is drawn from.
    """

    def __init__(self, random: np.random.Generator) -> None:
        self.torque_constant = float(np.clip(random.normal(1.21, 0.3), 0.7, 1.8))
        self.armature = random.uniform(0.01, 0.04)
        self.coulomb_N_m = random.uniform(0.02, 0.1)
        self.lost = random.uniform(0.0, 0.2)
        self.viscous = random.uniform(0.0, 0.03)
        self.delay_s = random.uniform(0.01, 0.035)
        self.supply_V = random.uniform(7.0, 12.6)
        self.source_ohm = random.uniform(0.05, 0.3)

    def moved(
        self, load_kg: float, random: np.random.Generator, rate_hz: float
    ) -> dict[str, np.ndarray]:
        """A motion with a load, as recorded: times, goals, positions and voltage.

        Args:
            load_kg: At the end of the rod [kg].
            random: Draws the motion, its friction and noise.
            rate_hz: Of the recording [Hz].
        """
        import mujoco

        model, moment = self._model(load_kg)
        data = mujoco.MjData(model)
        dry = self.coulomb_N_m * random.normal(1.0, 0.08)
        goals = Sines.drawn(random, 0.5)
        rows: dict[str, list[float]] = {name: [] for name in ("t", "position", "goal", "voltage")}
        every = round(1.0 / (rate_hz * STEP_S))
        goal = 0.0
        current = 0.0
        for step in range(round(LASTS_S / STEP_S)):
            t = step * STEP_S
            angle = float(data.qpos[0])
            speed = float(data.qvel[0])
            # goals come at 100 Hz and reach the law late
            heard = goals.at(max(np.floor((t - self.delay_s) * 100.0 + 1e-9) / 100.0, 0.0))
            goal += float(np.clip(heard - goal, -5.215 * STEP_S, 5.215 * STEP_S))
            duty = float(np.clip(GAIN * (goal - counted(angle)), -0.97, 0.97))
            voltage = self.supply_V - self.source_ohm * abs(current * duty)
            current = (voltage * duty - self.torque_constant * speed) / 2.68
            if step % every == 0:
                rows["t"].append(t)
                rows["position"].append(counted(angle + random.normal(0.0, 3e-4)))
                rows["goal"].append(goals.at(t))
                rows["voltage"].append(voltage + random.normal(0.0, 0.05))
            # what gears lose grows with what they carry
            model.dof_frictionloss[0] = dry + self.lost * abs(moment * GRAVITY * np.sin(angle))
            data.ctrl[0] = self.torque_constant * current
            mujoco.mj_step(model, data)
        return {name: np.array(values) for name, values in rows.items()}

    def _model(self, load_kg: float) -> tuple[Any, float]:
        """The pendulum with a load at its end, and its first moment of mass [kg m]."""
        import mujoco

        mass = load_kg + ROD_KG
        moment = load_kg * ARM_M + 0.5 * ROD_KG * ARM_M
        about_axis = load_kg * ARM_M**2 + ROD_KG * ARM_M**2 / 3.0
        centre = moment / mass
        text = PENDULUM.format(
            step=STEP_S, gravity=GRAVITY, armature=self.armature, viscous=self.viscous, mass=mass, centre=-centre,
            inertia=max(about_axis - mass * centre**2, 1e-7),
        )  # fmt: skip
        return mujoco.MjModel.from_xml_string(text), moment


Row = tuple[float, float | None, float, tuple[float, float]]
"""Truth, answer, standard deviation and interval [kg]."""


def asked(seed: int, rate_hz: float, questions: int = 3) -> list[Row]:
    """Truth, answer, standard deviation and interval [kg] of some weighings by one servo; no answer where it is refused."""
    random = np.random.default_rng(seed)
    servo = Servo(random)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        pendulum_urdf(folder, "servo", ROD_KG, ARM_M)
        (folder / "servo.yaml").write_text(FILE)
        references = {
            write(folder / f"known{number}", servo.moved(kg, random, rate_hz)): kg
            for number, kg in enumerate((*KNOWN_KG, *KNOWN_KG))
        }
        options = Options(robot=str(folder / "servo.yaml"), settings=POINT)
        output = folder / "known.yaml"
        answers = []
        truths = random.uniform(0.2, 1.2, questions)
        try:
            learnt = calibrate_from_bags([], references, options, output)
        except ProprioError:
            learnt = None
        for number, kg in enumerate(map(float, truths)):
            answer: Row = (
                kg,
                None,
                np.nan,
                (np.nan, np.nan),
            )
            if learnt is not None and learnt.verdict is Verdict.ACCEPTED:
                bag = write(
                    folder / f"asked{number}",
                    servo.moved(kg, random, rate_hz),
                )
                estimate = replay(bag, Options(calibration=output, settings=POINT))
                mass = estimate.values[0]
                if estimate.verdict is Verdict.ACCEPTED:
                    answer = (kg, mass.value, mass.std, tuple(mass.ci95))
            answers.append(answer)
    return answers


def main(arguments: Sequence[str] | None = None) -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--servos", type=int, default=100)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--questions", type=int, default=3, help="to each")
    parser.add_argument("--rate", type=float, default=100.0, help="of the recordings [Hz]")
    options = parser.parse_args(arguments)
    results = Results(__file__, options.json, arguments)
    rows = []
    for seed in range(options.first, options.first + options.servos):
        rows += asked(seed, options.rate, options.questions)
        if (seed + 1 - options.first) % 10 == 0:
            print(f"{seed + 1 - options.first} servos", file=sys.stderr)
    results.table(
        "servos",
        {
            "servos": "{servos}",
            "answered": "{answered} of {asked}",
            "intervals that hold": "{hold:.1f} % ({low:.0f} to {high:.0f})",
            "error rms, worst": "{rms:.1f}, {worst:.1f} %",
            "median half interval": "{half:.1f} %",
            "farthest, in sd": "{farthest:.1f}",
        },
    )
    given = [row for row in rows if row[1] is not None]
    if given:
        results.row("servos", servos=options.servos, asked=len(rows), **figures(given))
    results.keep()


def figures(given: Sequence[Row]) -> dict[str, Any]:
    """How often intervals hold, with Wilson's interval of that; errors and widths in % of the truth."""
    held = sum(low <= truth <= high for truth, _, _, (low, high) in given)
    off = np.array([(value - truth) / truth for truth, value, _, _ in given])
    pulls = np.array([(value - truth) / std for truth, value, std, _ in given])
    widths = np.array([(high - low) / 2.0 / truth for truth, _, _, (low, high) in given])
    least, most = binomtest(held, len(given)).proportion_ci(method="wilson")
    return {
        "answered": len(given),
        "hold": 100.0 * held / len(given),
        "low": 100.0 * least,
        "high": 100.0 * most,
        "rms": 100.0 * np.sqrt(np.mean(off**2)),
        "worst": 100.0 * np.abs(off).max(),
        "half": 100.0 * np.median(widths),
        "farthest": np.abs(pulls).max(),
        **each_answer(100.0 * off, 100.0 * widths),
    }


if __name__ == "__main__":
    main()
