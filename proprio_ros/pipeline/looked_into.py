"""What was found in a bag before any fit, as JSON and for the terminal."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from typing import TYPE_CHECKING, Any

from proprio_ros.errors import ProprioError, some
from proprio_ros.identification.estimate import plain
from proprio_ros.quantity import shown
from proprio_ros.recordings.drivers import Driver
from proprio_ros.recordings.effort_units import EffortUnit
from proprio_ros.recordings.motions import Motion
from proprio_ros.recordings.plausibility import Finding
from proprio_ros.records import STALL_CURRENT
from proprio_ros.schema import header, reason_codes

if TYPE_CHECKING:
    from proprio_ros.experiment_design.predicted_mass import OneMore

FREE_SWING = (
    "it tells gravity moment over inertia, without any torque constant: a mass with a calibration from swings with two known loads "
    "(calibrate --reference BAG=KG --reference BAG=KG)"
)


def _brings(more: OneMore) -> str:
    """What one more recording would bring, in words."""
    half = f"+-{_grams(more.mass_half_width_kg)}"
    if more.load_kg is not None and more.mass_half_width_per_kg is not None:
        share = f"{100.0 * more.mass_half_width_per_kg:.0f} % of the mass"
        load = f"a known load of about {_grams(more.load_kg)} (`calibrate --reference`)"
        return f"a third one with {load} makes it about {half} and {share}"
    if more.kind == "push":
        return f"another such push makes it about {half}"
    if more.kind == "empty_hand":
        return f"a second one with an empty hand makes it about {half}"
    return f"beside such pushes with an empty hand (`calibrate`) it is about {half}"


@dataclass(frozen=True)
class RunCheck:
    """One run as it was found."""

    name: str
    joint: str
    duration_s: float  # how long the joint was driven [s]
    # from the first to the last sample [rad or m, as ``unit`` says]; of a free swing its whole span
    travel: float
    unit: str
    current_A: float  # the largest of its currents, with its sign [A]; 0 in a free swing
    samples: int  # joint states while it was driven
    problem: str = ""  # why it is not usable, or an empty string
    notes: tuple[str, ...] = ()  # what else a reader should know
    # about half the 95 % interval of a light object's mass from this run alone; None where it lifts nothing
    mass_half_width_kg: float | None = None
    is_free_response: bool = False  # whether it is a free swing: torque was off
    one_more: tuple[OneMore, ...] = ()  # what another one beside it would bring

    def as_json(self) -> dict[str, Any]:
        return {
            **_named(self, "name", "joint", "duration_s", "travel", "unit", "current_A", "samples"),
            "free_swing": self.is_free_response,
            "usable": not self.problem,
            "problem": self.problem or None,
            "problem_code": reason_codes([self.problem])[0] if self.problem else None,
            "notes": list(self.notes),
            **_named(self, "mass_half_width_kg", "one_more"),
        }

    def lines(self) -> list[str]:
        """For the terminal."""
        judged = f"not usable, {self.problem}" if self.problem else "usable"
        if not self.problem and self.mass_half_width_kg is not None:
            judged += f"; alone it tells a light object's mass to about +-{_grams(self.mass_half_width_kg)}"
            judged += "".join(f"; {_brings(more)}" for more in self.one_more)
        if self.is_free_response:
            until = (
                f"{self.duration_s:.2f} s until it hangs still, over {self.travel:.2f} {self.unit}"
            )
            about = f"a free swing of {self.joint}: torque off, {until}"
        else:
            moved = f"{1e3 * self.current_A:+.0f} mA for {self.duration_s:.2f} s, travel {self.travel:+.3f} {self.unit}"
            about = f"run of {self.joint}: {moved}"
        good_for = [f"    {FREE_SWING}"] if self.is_free_response and not self.problem else []
        notes = [f"    note: {note}" for note in self.notes]
        return [f"  {about}, {self.samples} samples: {judged}", *good_for, *notes]


@dataclass(frozen=True)
class MotionCheck:
    """What a motion of several joints determines, were it made once more with an empty hand."""

    joints: tuple[str, ...]  # that moved
    duration_s: float
    mass_half_width_kg: float  # about half the 95 % interval of a light object's mass
    # what every kg of the object adds to it, since torque constants are not known better; None where nobody stated them
    mass_half_width_per_kg: float | None
    one_more: tuple[OneMore, ...] = ()  # what another one beside both would bring

    def sentence(self) -> str:
        """For the terminal."""
        if self.mass_half_width_per_kg is None:
            more = "as much of the mass as the torque constants are uncertain"
        else:
            more = f"{100.0 * self.mass_half_width_per_kg:.0f} % of the mass, which is how well the torque constants are known"
        width = f"+-{_grams(self.mass_half_width_kg)} (95 %)"
        said = f"beside the same motion with an empty hand it tells a light object's mass to about {width}, and {more}"
        return "; ".join([said, *map(_brings, self.one_more)])

    def as_json(self) -> dict[str, Any]:
        widths = ("mass_half_width_kg", "mass_half_width_per_kg")
        return _named(self, "joints", "duration_s", *widths, "one_more")


@dataclass(frozen=True)
class BagCheck:
    """One bag as it was found."""

    bag: str
    joints: tuple[str, ...] = ()  # joints whose positions were recorded
    duration_s: float = 0.0  # from the first to the last joint state [s]
    # of the joint states, by their median interval [1/s]; NaN where none could be read
    rate_Hz: float = float("nan")
    gaps: int = 0  # intervals of more than 2.5 periods
    longest_gap_s: float = float("nan")  # the longest interval [s]
    topics: tuple[tuple[str, str, int], ...] = ()  # name, type and number of messages of each
    # of a table: each header, and what it was read as; empty where it was not
    columns: tuple[tuple[str, str], ...] = ()
    state_topic: str | None = None  # topic of the joint states
    # where the current that drove the joints would be taken from: a topic, or ``measured effort``
    input: str | None = None
    input_unit: str | None = None  # what its numbers are
    runs: tuple[RunCheck, ...] = ()
    refusal: ProprioError | None = None  # why no run could be looked for
    notes: tuple[str, ...] = ()  # every repair made while reading
    # what was recorded where several joints were driven at once; then there are no runs
    motion: Motion | None = None
    # moves, still: the joints that move, and those that do not
    moves: tuple[str, ...] = ()
    still: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()  # what the recording shows of itself
    # how the effort would compare with what gravity needs if it were in one unit or another
    effort_units: tuple[EffortUnit, ...] = ()
    sign_option: str = ""  # with which efforts of all joints count the other way
    # the effort over what gravity needs, by joint, in the publisher's unit
    effort_per_N_m: Mapping[str, float] = field(default_factory=dict)
    tells: MotionCheck | None = None  # what a motion determines
    record: tuple[str, ...] = ()  # what to record instead, or beside it
    driver: Driver | None = None  # profile by which it was read; None where nobody stated one
    # names of the profiles that its topics identify; none of them is used before it is stated
    fitting: tuple[str, ...] = ()

    @property
    def problem(self) -> str:
        """Why no run could be looked for, or an empty string."""
        return "" if self.refusal is None else str(self.refusal)

    @property
    def usable(self) -> int:
        """Number of runs that a fit could use; a motion counts as one."""
        return sum(not run.problem for run in self.runs) + (self.motion is not None)

    def as_json(self) -> dict[str, Any]:
        motion = self.motion
        seen = ("notes", "moves", "still", "findings", "effort_units", "effort_per_N_m", "tells")
        record = {
            **_named(self, "bag", "joints", "duration_s", "rate_Hz", "gaps", "longest_gap_s"),
            "topics": [
                {"name": name, "type": kind, "messages": count} for name, kind, count in self.topics
            ],
            "columns": [{"name": name, "read_as": what or None} for name, what in self.columns],
            **_named(self, "state_topic", "input", "input_unit", "runs"),
            "motion": motion and {"joints": motion.moved, "duration_s": motion.times_s[-1]},
            "usable_runs": self.usable,
            "problem": self.problem or None,
            **_named(self, *seen, "record"),
            "driver": self.driver and self.driver.name,
            "fitting_drivers": self.fitting,
        }
        return dict(plain(record))

    def as_text(self) -> str:
        """For the terminal."""
        found = len(self.runs) + (self.motion is not None)
        lines = [f"{self.bag}: {self.usable} of {found} run{'s' * (found != 1)} usable"]
        if self.joints:
            longest = f"{self.gaps} gap{'s' * (self.gaps != 1)}, the longest {1e3 * self.longest_gap_s:.0f} ms"
            states = f"{self.state_topic or 'in a text file'}, {', '.join(self.joints)}"
            rate = f"{self.duration_s:.2f} s at {self.rate_Hz:.1f} Hz, {longest if self.gaps else 'no gaps'}"
            lines.append(f"  joint states: {states}; {rate}")
        if self.input:
            lines.append(
                f"  input: {self.input}" + (f" ({self.input_unit})" if self.input_unit else "")
            )
        lines += [
            f"  topic: {name} ({kind}), {count} messages" for name, kind, count in self.topics
        ]
        lines += self._column_lines()
        lines += self._driver_lines()
        lines += [line for run in self.runs for line in run.lines()]
        if self.motion is not None:
            lines.append(f"  {self._about_motion(self.motion)}")
        if self.tells is not None:
            lines.append(f"  {self.tells.sentence()}")
        if self.moves or self.still:
            still = f"; still: {', '.join(self.still)}" if self.still else ""
            lines.append(f"  moves: {', '.join(self.moves) or 'nothing'}{still}")
        lines += [f"  seen: {finding.sentence}" for finding in self.findings]
        lines += self._effort_lines()
        lines += [f"  problem: {self.problem}"] * bool(self.problem)
        lines += [f"  record: {advice}" for advice in self.record]
        return "\n".join([*lines, *(f"  note: {note}" for note in self.notes)])

    def _about_motion(self, motion: Motion) -> str:
        took = f"{motion.times_s[-1]:.1f} s"
        if self.input is not None and self.input.startswith(STALL_CURRENT):
            return f"a motion under a controller, {took}, driven by a voltage"
        if len(motion.joints) == 1:
            return (
                f"a motion of one joint under a controller, {took}: tells how it swings (`replay --probe payload`), and the mass "
                "where the torque is known and one with an empty hand is beside it (`--baseline EMPTY`)"
            )
        return (
            f"a motion of {len(motion.moved)} joints at once, {took}: tells the payload's mass and centre beside one with an empty "
            "hand (`replay --probe payload --baseline EMPTY`, or `calibrate EMPTY`)"
        )

    def _column_lines(self) -> list[str]:
        """What the columns of a table were read as, those of a kind together, and the others."""
        kinds: dict[str, list[str]] = {}
        for name, what in self.columns:
            kind, _, joint = what.partition(" of ")
            unit = joint.partition(" in ")[2]
            kinds.setdefault(f"{kind} in {unit}" if unit else kind, []).append(name)
        others = kinds.pop("", [])
        lines = [f"  {kind}: {_ends(names)}" for kind, names in kinds.items()]
        unread = "columns that are not read" if lines else "columns"
        alike = groupby(others, lambda name: re.sub(r"\d+", "", name))
        shown = [_ends(list(names)) for _, names in alike]
        return lines + [f"  {unread}: {some(shown, 12)}"] * bool(others)

    def _driver_lines(self) -> list[str]:
        stated = self.driver
        what = "columns" if self.columns else "topics"
        words = f"its {what} are those of {' or '.join(self.fitting)}"
        if stated is None:
            which = "one" if len(self.fitting) > 1 else "it"
            return [f"  driver: {words}; state {which} with --driver, none is used before"] * bool(
                self.fitting
            )
        lines = [
            f"  driver: {stated.name}, {stated.title}",
            *(f"    {note}" for note in stated.notes),
        ]
        other = self.fitting and not {stated.name, *stated.extends} & set(self.fitting)
        return [*lines, *[f"  problem: {words}, not of {stated.name}"] * bool(other)]

    def _effort_lines(self) -> list[str]:
        if not self.effort_per_N_m:
            return []
        joints = ", ".join(self.effort_per_N_m)
        parts = []
        for unit in self.effort_units:
            ends = dict.fromkeys(
                _short(edge) for edge in (min(unit.ratio.values()), max(unit.ratio.values()))
            )
            parts.append(
                f"{' to '.join(ends)} in {unit.unit}{' (plausible)' if unit.plausible else ''}"
            )
        lines = [
            f"  effort over the torque that gravity needs by the URDF, of {joints}: {'; '.join(parts)}; an empty hand gives 1, a "
            "load more; nothing is chosen by it"
        ]
        if len(self.effort_units) == 1:
            constants = ", ".join(
                _short(1.0 / abs(value)) for value in self.effort_per_N_m.values()
            )
            would = f"the torque constants would be {constants} N m per unit of it"
            lines.append(f"  were it a current and the hand empty, {would}")
        if all(value < 0.0 for value in self.effort_per_N_m.values()):
            lines.append(
                "  the effort has the sign of the torque that gravity makes, not of what holds against it: where its publisher "
                f"counts it so, and the arm does not hang, {self.sign_option} states it"
            )
        return lines


def _named(values: object, *names: str) -> dict[str, Any]:
    return {name: getattr(values, name) for name in names}


def _ends(names: Sequence[str]) -> str:
    """The first and the last of several."""
    return " .. ".join(dict.fromkeys((names[0], names[-1])))


def _short(value: float) -> str:
    """Two digits, without an exponent where people would write none."""
    return f"{float(f'{value:.2g}'):g}"


def _grams(mass_kg: float) -> str:
    return shown("kg", float(f"{mass_kg:.2g}"), spec="g")


def as_json(
    robot: str,
    checks: Sequence[BagCheck],
) -> dict[str, Any]:
    """What ``proprio check --json`` prints."""
    return {
        **header("check"),
        "robot": robot,
        "usable_runs": sum(check.usable for check in checks),
        "bags": [check.as_json() for check in checks],
    }
