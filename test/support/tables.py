"""Recordings of bags written as people's tables: bare, of UR's RTDE recorder, of libfranka, merged with commands, Parquet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from proprio_ros.records import FloatArray, TimeArray
from support.bends.tape import Stream, tape_of

FIELDS = ("position", "velocity", "effort")


@dataclass(frozen=True)
class Recorded:
    """What a bag holds, on a clock that begins with it."""

    times_ns: TimeArray  # of the joint states' headers [ns], (T,)
    joints: tuple[str, ...]
    position: FloatArray  # [rad], (T, J)
    velocity: FloatArray  # [rad/s], (T, J)
    effort: FloatArray  # as it was published, (T, J)
    command_ns: TimeArray  # when commands were recorded [ns], (C,)
    commanded: tuple[str, ...]
    command: FloatArray  # [A], or [N m] of applied efforts, (C, K)


def recorded_in(bag: Path) -> Recorded:
    """The joint states of a bag, and its current commands or applied efforts."""
    tape = tape_of(bag)
    states = tape.states
    none = np.full_like(states.values["position"], np.nan)
    values = [states.values.get(field, none) for field in FIELDS]
    applied = [each for each in tape.streams if each.topic == "/applied_effort"]
    if applied:
        torque = applied[0].values["effort"]
        return Recorded(
            states.stamp_ns, states.names, *values, applied[0].stamp_ns, applied[0].names, torque
        )
    commands = [each for each in tape.streams if each.topic == "/current_command"]
    if not commands:
        none = np.empty(0, dtype=np.int64)
        return Recorded(states.stamp_ns, states.names, *values, none, (), np.empty((0, 0)))
    command: Stream = commands[0]
    labels = tuple(filter(None, ",".join(command.names).split(",")))
    return Recorded(
        states.stamp_ns,
        states.names,
        *values,
        command.bag_ns,
        labels or states.names,
        command.values["data"],
    )


def decimals(time_ns: int, digits: int = 9) -> str:
    """A time in units of so many digits, exactly."""
    return f"{time_ns // 10**digits}.{time_ns % 10**digits:0{digits}d}"


def written(
    path: Path,
    headers: Sequence[str],
    columns: Sequence[Sequence[object]],
    separator: str = ",",
    before: str = "",
    comma: bool = False,
) -> Path:
    """A text of columns, numbers to their last digit.

    Args:
        path: To be written.
        headers: Of the columns.
        columns: Texts or numbers, each of as many.
        separator: Between cells.
        before: What stands before the header.
        comma: Whether numbers have a decimal comma.
    """
    lines = [separator.join(headers)]
    for row in zip(*columns, strict=True):
        cells = [cell if isinstance(cell, str) else repr(float(cell)) for cell in row]
        if comma:
            cells = [cell.replace(".", ",") for cell in cells]
        lines.append(separator.join(cells))
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(before + "\n".join(lines) + "\n")
    return path


def bare(path: Path, found: Recorded, **how: object) -> Path:
    """``t [s],q0 [rad] .., dq0 [rad/s] .., current0 [A]``."""
    count = range(len(found.joints))
    headers = [
        "t [s]",
        *(f"q{n} [rad]" for n in count),
        *(f"dq{n} [rad/s]" for n in count),
        *(f"current{n} [A]" for n in count),
    ]
    columns = [
        [decimals(int(t)) for t in found.times_ns],
        *found.position.T,
        *found.velocity.T,
        *found.effort.T,
    ]
    return written(path, headers, columns, **how)  # type: ignore[arg-type]


def rtde(path: Path, found: Recorded) -> Path:
    """As record.py of UR's RTDE client library writes: a space between columns, fields of its configuration in their order.

    Fields that a bag does not have are zero. Source: UniversalRobots/RTDE_Python_Client_Library, rtde/csv_writer.py and
    examples/record_configuration.xml, commit 2fa8991.
    """
    zeros = np.zeros_like(found.position)
    one = np.zeros(len(found.times_ns))
    desired = found.command if len(found.command) == len(zeros) else zeros
    fields: list[tuple[str, FloatArray]] = [
        ("target_q", found.position),
        ("target_qd", found.velocity),
        ("target_qdd", zeros),
        ("target_current", desired),
        ("target_moment", 11.0 * desired),
        ("actual_q", found.position),
        ("actual_qd", found.velocity),
        ("actual_current", found.effort),
        ("joint_control_output", desired),
        ("actual_TCP_pose", zeros),
        ("actual_TCP_speed", zeros),
        ("actual_TCP_force", zeros),
        ("target_TCP_pose", zeros),
        ("target_TCP_speed", zeros),
        ("actual_digital_input_bits", one),
        ("joint_temperatures", zeros + 30.0),
        ("actual_execution_time", one + 0.3),
        ("robot_mode", one + 7),
        ("joint_mode", zeros + 253),
        ("safety_mode", one + 1),
        ("actual_tool_accelerometer", zeros[:, :3]),
        ("speed_scaling", one + 1.0),
        ("target_speed_fraction", one + 1.0),
        ("actual_momentum", one),
        ("actual_main_voltage", one + 48.0),
        ("actual_robot_voltage", one + 48.0),
        ("actual_robot_current", one + 0.5),
        ("actual_joint_voltage", zeros + 48.0),
        ("actual_digital_output_bits", one),
        ("runtime_state", one + 2),
    ]
    headers = ["timestamp"]
    columns: list[Sequence[object]] = [[decimals(int(t)) for t in found.times_ns]]
    for name, values in fields:
        if values.ndim == 1:
            headers.append(name)
            columns.append(values)
            continue
        headers += [f"{name}_{n}" for n in range(values.shape[1])]
        columns += list(values.T)
    return written(path, headers, columns, separator=" ")


def texts(numbers: np.ndarray) -> list[str]:
    return [repr(float(number)) for number in numbers]


def libfranka(path: Path, found: Recorded, spaced: bool = True) -> Path:
    """As franka::logToCSV writes seven joints; its times are whole milliseconds.

    Source: frankaemika/libfranka, src/log.cpp, commit 5b7e8cf; without spaces in the header src/logging/robot_state_log.cpp.
    """
    zeros = np.zeros_like(found.position)
    states = [
        ("state.q", found.position),
        ("state.q_d", found.position),
        ("state.dq", found.velocity),
        ("state.dq_d", found.velocity),
        ("state.tau_J", found.effort),
        ("state.tau_ext_hat_filtered", zeros),
        ("cmd.q_d", found.position),
        ("cmd.dq_d", found.velocity),
        ("cmd.O_T_EE_d", np.zeros((len(zeros), 16))),
        ("cmd.O_dP_EE_d", zeros[:, :6]),
        ("cmd.tau_J_d", zeros),
    ]
    gap = ", " if spaced else ","
    names = [gap.join(f"{name}[{n}]" for n in range(values.shape[1])) for name, values in states]
    since_ms = (found.times_ns - found.times_ns[0]) // 10**6
    lines = [gap.join(["time", "success_rate", ""]) + ",".join(names)]
    success = np.ones(len(zeros))
    rows = np.column_stack([success, *(values for _, values in states)])
    for time_ms, row in zip(since_ms, rows, strict=True):
        lines.append(",".join([str(int(time_ms)), *texts(row)]))
    path.write_text("\n".join(lines) + "\n")
    return path


def merged(path: Path, found: Recorded, command: str = "command [A]") -> Path:
    """Joint states and commands on one clock, a row each, cells of the other empty; joints by their names."""
    headers = ["time_s", *(f"{joint}_position_rad" for joint in found.joints)]
    headers += [f"{joint}_velocity_rad_s" for joint in found.joints]
    headers += [f"{joint}_effort" for joint in found.joints]
    headers += [f"{joint}_{command}" for joint in found.commanded]
    blank = [""] * len(found.commanded)
    rows: list[tuple[int, list[str]]] = []
    measured = np.hstack([found.position, found.velocity, found.effort])
    for time_ns, numbers in zip(found.times_ns, measured, strict=True):
        rows.append((int(time_ns), [*texts(numbers), *blank]))
    nothing = [""] * (3 * len(found.joints))
    for time_ns, command in zip(found.command_ns, found.command, strict=True):
        rows.append((int(time_ns), [*nothing, *texts(command)]))
    rows.sort(key=lambda each: each[0])
    lines = [",".join([decimals(time_ns), *cells]) for time_ns, cells in rows]
    path.write_text("\n".join([",".join(headers), *lines]) + "\n")
    return path


def parquet(path: Path, found: Recorded) -> Path:
    """A Parquet file with nanoseconds, and a vector a column."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    vectors = pa.list_(pa.float64())
    columns = {
        "timestamp": pa.array(found.times_ns, pa.timestamp("ns")),
        "position": pa.array(found.position.tolist(), vectors),
        "velocity": pa.array(found.velocity.tolist(), vectors),
        "current": pa.array(found.effort.tolist(), vectors),
    }
    pq.write_table(pa.table(columns), path)
    return path


def echoed(recorded: Recorded, fields: Sequence[str] = FIELDS, frame: str = "") -> str:
    """As `ros2 topic echo --csv` prints joint states: no header, and one empty cell for an array without entries."""
    lines = []
    for row, time_ns in enumerate(recorded.times_ns.tolist()):
        cells = [str(time_ns // 10**9), str(time_ns % 10**9), frame, *recorded.joints]
        for field in FIELDS:
            values = getattr(recorded, field)[row].tolist()
            cells += [str(value) for value in values] if field in fields else [""]
        lines.append(",".join(cells))
    return "\n".join(lines) + "\n"


def plotted(recorded: Recorded, fields: Sequence[str] = FIELDS, names: bool = True) -> str:
    """As `rostopic echo -p` of ROS 1 prints them: entries of arrays are numbered in the header."""
    count = len(recorded.joints)
    header = ["%time", "field.header.seq", "field.header.stamp"]
    if names:
        header += ["field.header.frame_id", *(f"field.name{number}" for number in range(count))]
    header += [f"field.{field}{number}" for field in fields for number in range(count)]
    lines = [",".join(header)]
    for row, time_ns in enumerate(recorded.times_ns.tolist()):
        cells = [str(time_ns), str(row), str(time_ns)]
        cells += ["", *recorded.joints] if names else []
        cells += [str(value) for field in fields for value in getattr(recorded, field)[row]]
        lines.append(",".join(cells))
    return "\n".join(lines) + "\n"
