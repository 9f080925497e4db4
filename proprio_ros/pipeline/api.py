"""For scripts and notebooks: ``from proprio_ros import weigh, calibrate, plan, check``.

Each is one call, does what the command of that name does (``weigh``: ``proprio replay``), gives the same numbers, and returns an
object that shows itself in a notebook.
"""

from __future__ import annotations

import inspect
import os
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from proprio_ros.calibration_files.pushes import Calibration
from proprio_ros.errors import ConfigurationError, ProprioError
from proprio_ros.identification.calibration_estimate import CalibrationEstimate, ExcitationPlan
from proprio_ros.identification.estimate import Estimate, Value
from proprio_ros.inputs.forms import (
    Form,
    FormError,
    Number,
    Part,
    Perhaps,
    Truth,
    Whole,
    mapping,
    shortly,
    under,
)
from proprio_ros.inputs.settings import read
from proprio_ros.inputs.signs import EFFORT_SIGN
from proprio_ros.pipeline.calibrate import calibrate_from_bags, plan_excitations
from proprio_ros.pipeline.check import check_bags
from proprio_ros.pipeline.looked_into import BagCheck
from proprio_ros.pipeline.looked_into import as_json as checks_as_json
from proprio_ros.pipeline.replay import replay, write_report
from proprio_ros.pipeline.request import Options
from proprio_ros.pipeline.shown import checks_figure, checks_table, plans_figure, plans_table
from proprio_ros.probes import all_probes
from proprio_ros.quantity import spec_for
from proprio_ros.report import (
    calibration_figure,
    card,
    motions_figure,
    runs_figure,
    words_figure,
    write_calibration_report,
)
from proprio_ros.robot import Robot
from proprio_ros.schema import header

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

AnyPath = str | os.PathLike[str]
Paths = AnyPath | Sequence[AnyPath]
_Row = TypeVar("_Row")


class _Answered:
    """What every answer has."""

    estimate: Estimate | CalibrationEstimate

    @property
    def verdict(self) -> str:
        """``accepted``, ``too_wide`` (for a number), ``rejected`` (by the model) or ``not_identifiable`` (by this recording)."""
        return self.estimate.verdict.value

    @property
    def accepted(self) -> bool:
        """Whether the answer can be used."""
        return self.verdict == "accepted"

    @property
    def reasons(self) -> tuple[str, ...]:
        """Sentences on what is wrong or worth knowing; some have a ``code``."""
        return self.estimate.reasons


def _refuse_to_replace(path: Path, force: bool) -> None:
    if path.exists() and not force:
        raise ConfigurationError(
            f"{path}: is there already; force=True replaces it, or name another file"
        )


@dataclass(frozen=True, repr=False)
class Weighing(_Answered):
    """What the hand holds."""

    estimate: Estimate  # everything that was found out: fits of the runs, unknowns, solver
    bags: tuple[str, ...]  # what it was found out from
    call: str  # the call that gives it again

    @property
    def values(self) -> dict[str, Value]:
        """Every estimated quantity by name, with standard deviation, interval and unit."""
        return {value.name: value for value in self.estimate.values}

    def value(self, name: str | None = None) -> Any:
        """The number called ``name``, in SI units; None when it cannot be determined.

        Args:
            name: Such as ``payload_mass`` or ``lame_mu``; without one, what the probe is for.

        Raises `KeyError`: There is none of that name; the message lists those there are.
        """
        return self._main.value if name is None else self.estimate.value(name).value

    @property
    def _main(self) -> Value:
        return self.estimate.values[0]

    @property
    def mass(self) -> float | None:
        """Mass of the payload, or of the sphere in the container [kg]; None when it cannot be determined.

        Raises `AttributeError`: The probe does not weigh.
        """
        if self.unit != "kg":
            there = f"ask for value(name) with one of: {', '.join(self.values)}"
            raise AttributeError(f"the probe {self.estimate.probe} has no mass; {there}")
        return self.value()

    @property
    def unit(self) -> str:
        """Of ``value()``, ``std`` and ``ci95``."""
        return self._main.unit

    @property
    def std(self) -> float | None:
        """Standard deviation of ``value()``."""
        return self._main.std  # type: ignore[return-value]

    @property
    def ci95(self) -> tuple[float, float] | None:
        """95 % interval of ``value()``."""
        return None if self._main.ci95 is None else tuple(self._main.ci95)

    def as_json(self) -> dict[str, Any]:
        """What ``proprio replay --json`` prints."""
        return self.estimate.as_json()

    def to_frame(self) -> pandas.DataFrame:
        """A table with one row per estimated quantity; needs pandas."""
        columns = ("name", "value", "std", "ci95_low", "ci95_high", "unit", "reason", "verdict")
        rows = [
            (v.name, v.value, v.std, *_ends(v.ci95), v.unit, v.reason, self.verdict)
            for v in self.estimate.values
        ]
        return frame(columns, rows)

    def plot(self) -> Figure:
        """Measured against simulated, with the residual, run by run; of motions torque, joint by joint; of neither why."""
        found = self.estimate
        if found.joint_fits:
            return motions_figure(found.joint_fits)
        return (
            runs_figure(found.run_fits)
            if found.run_fits
            else words_figure(repr(self)[1:-1], self.reasons)
        )

    def report(self, path: AnyPath, force: bool = False) -> Path:
        """Write the HTML page; returns the file.

        Raises `ConfigurationError`: It cannot be written, or there is such a file and ``force`` does not say that it may go.
        """
        _refuse_to_replace(Path(path), force)
        write_report(
            self.estimate,
            Path(path),
            command=self.call,
            sources=self.bags,
            force=force,
        )
        return Path(path)

    def _repr_html_(self) -> str:
        found = self.estimate
        title = f"{found.probe}, {found.robot}"
        return card(title, found.verdict, found.values, found.reasons, found.interval_first)

    def __repr__(self) -> str:
        if self._main.value is None:
            return f"<{self._main.name}: not determined ({self.verdict})>"
        spec = spec_for(self.unit, self.std, kept=True)
        interval = (
            ""
            if self.ci95 is None
            else f", 95 % interval {self.ci95[0]:{spec}} .. {self.ci95[1]:{spec}}"
        )
        return f"<{self._main.name} {self.value():{spec}} {self.unit}{interval} ({self.verdict})>"


@dataclass(frozen=True, repr=False)
class CalibrationResult(_Answered, os.PathLike[str]):
    """What is known about the robot now; give it to ``weigh(..., calibration=result)``.

    It stands for a calibration file: the one that was asked for, or else one that is deleted with this object.
    """

    # everything that was found out: fits of the runs, unknowns, advice for further runs
    estimate: CalibrationEstimate
    path: Path | None  # the calibration file; None when the calibration was not accepted
    call: str  # the call that gives it again
    _folder: Any = field(default=None, compare=False)

    @property
    def calibration(self) -> Calibration | None:
        """Values with their covariance; None where the runs do not determine them, or were motions (see ``estimate.motion``)."""
        return self.estimate.calibration

    def __fspath__(self) -> str:
        if self.path is None:
            why = f": {self.reasons[0]}" if self.reasons else ""
            raise ConfigurationError(f"this calibration is {self.verdict} and cannot be used{why}")
        return str(self.path)

    def as_json(self) -> dict[str, Any]:
        """What ``proprio calibrate --json`` prints."""
        kept = self.path if self._folder is None else None
        return {
            **self.estimate.as_json(),
            "output": None if kept is None else str(kept),
        }

    def to_frame(self) -> pandas.DataFrame:
        """A table with one row per unknown of the robot: what its file says (prior), and what the runs say; needs pandas."""
        columns = ("name", "value", "std", "unit", "prior", "prior_std")
        rows = [
            (u.name, u.value, u.std, u.unit, u.prior, u.prior_std) for u in self.estimate.unknowns
        ]
        return frame(columns, rows)

    def report(self, path: AnyPath, force: bool = False) -> Path:
        """Write the HTML page; returns the file.

        Raises `ConfigurationError`: It cannot be written, or there is such a file and ``force`` does not say that it may go.
        """
        _refuse_to_replace(Path(path), force)
        origin = self.estimate.origin
        sources = [
            *origin["bags"],
            *(entry["bag"] for entry in origin["references"]),
        ]
        write_calibration_report(
            self.estimate, Path(path), command=self.call, sources=sources, force=force
        )
        return Path(path)

    def plot(self) -> Figure:
        """Drive trains before and after, or each motion weighed by the others; where it was refused, why."""
        return calibration_figure(self.estimate)

    def _repr_html_(self) -> str:
        can = () if self.estimate.weighable is None else (self.estimate.weighable.sentence(),)
        return card(
            f"calibration, {self._about}",
            self.estimate.verdict,
            (),
            (*self.reasons, *can),
        )

    @property
    def _about(self) -> str:
        return f"{self.estimate.robot}, {self.estimate.used} of {self.estimate.runs} runs used"

    def __repr__(self) -> str:
        return f"<calibration of {self._about} ({self.verdict})>"


class Listed(Sequence[_Row]):
    """Rows that cannot be changed."""

    def __init__(self, rows: Iterable[_Row]) -> None:
        self._rows = tuple(rows)

    def __getitem__(self, index: Any) -> Any:
        return self._rows[index]

    def __len__(self) -> int:
        return len(self._rows)


class Plans(Listed[ExcitationPlan]):
    """Runs that have not been made, best first.

    Attributes:
        robot: Which is to make them, with its calibration where there is one.
        masses_kg: What the hand may hold [kg].
    """

    def __init__(
        self, robot: Robot, plans: Iterable[ExcitationPlan], masses_kg: Sequence[float]
    ) -> None:
        super().__init__(plans)
        self.robot = robot
        self.masses_kg = list(masses_kg)

    def as_json(self) -> dict[str, Any]:
        """What ``proprio plan --json`` prints."""
        about = {
            "robot": self.robot.name,
            "calibrated": self.robot.is_calibrated(),
            "masses_kg": self.masses_kg,
        }
        return {
            **header("plan"),
            "probe": "payload",
            **about,
            "plans": [plan.as_json() for plan in self],
        }

    def to_frame(self) -> pandas.DataFrame:
        """A table with one row per plan; needs pandas."""
        keys = (
            "joint",
            "current_A",
            "duration_s",
            "start",
            "kind",
            "travel",
            "clearance_m",
            "std_kg",
            "reason",
        )
        return frame(
            keys,
            [tuple(getattr(plan, key) for key in keys) for plan in self],
        )

    def plot(self) -> Figure:
        """Half of the 95 % interval that each promises."""
        return plans_figure(repr(self)[1:-1], self)

    def _repr_html_(self) -> str:
        return plans_table(repr(self)[1:-1], self, self.masses_kg)

    def __repr__(self) -> str:
        masses = ", ".join(f"{mass:g}" for mass in self.masses_kg)
        return f"<{len(self)} plans of {self.robot.name} for {masses} kg>"


class Checks(Listed[BagCheck]):
    """What is in each bag, before any fit.

    Attributes:
        robot: Name of the robot they were read for.
    """

    def __init__(self, robot: str, checks: Iterable[BagCheck]) -> None:
        super().__init__(checks)
        self.robot = robot

    @property
    def usable(self) -> int:
        """Number of runs that a fit could use."""
        return sum(check.usable for check in self)

    def as_json(self) -> dict[str, Any]:
        """What ``proprio check --json`` prints."""
        return checks_as_json(self.robot, self)

    def to_frame(self) -> pandas.DataFrame:
        """A table with one row per run; needs pandas."""
        keys = ("name", "joint", "duration_s", "travel", "unit", "current_A", "samples", "problem")
        rows = [
            (check.bag, *(getattr(run, key) for key in keys))
            for check in self
            for run in check.runs
        ]
        return frame(("bag", *keys), rows)

    def plot(self) -> Figure:
        """How long each run or motion is; what is not usable is grey."""
        return checks_figure(repr(self)[1:-1], self)

    def _repr_html_(self) -> str:
        return checks_table(repr(self)[1:-1], self)

    def __str__(self) -> str:
        return "\n".join(check.as_text() for check in self)

    def __repr__(self) -> str:
        runs = sum(len(check.runs) for check in self)
        return f"<{len(self)} bags, {self.usable} of {runs} runs usable>"


def weigh(
    bags: Paths,
    *,
    calibration: AnyPath | None = None,
    baseline: Paths = (),
    probe: str = "payload",
    robot: AnyPath | None = None,
    settings: Mapping[str, Any] | None = None,
    solver: str = "lm",
    profile: str = "default",
    driver: AnyPath | None = None,
    state_topic: str | None = None,
    command_topic: str | None = None,
    effort_unit: str | None = None,
    effort_sign: int | str | Mapping[str, int] | None = None,
    **facts: Mapping[str, Any],
) -> Weighing:
    """Identify what the hand holds from recorded bags; all of them are of one object.

    ``weigh(bag, payload={"size": 0.03}).mass`` is what ``proprio replay BAG --probe payload --set payload.size=0.03`` prints.

    Args:
        bags: Bag folders or files, or text recordings; one may stand alone.
        calibration: What `calibrate` returned, or its file.
        baseline: Runs made with the others with an empty hand, or with the empty container.
        probe: ``payload``, ``container`` or ``softness``.
        robot: Name, or robot file.
        settings: As for ``--set``, by dotted key: ``{"payload.com": [0, 0, 0.01]}``.
        solver: ``lm``, ``adam`` or ``cma``.
        profile: ``default``, or ``paper`` for the paper's own method.
        driver: Profile of the driver that published, a name of ``config/drivers`` or a file; the next four win over it.
        state_topic: Of the joint states, where the bag has several.
        command_topic: Of the input, where it has an unusual name.
        effort_unit: What effort of the joint states means: ``N.m``, ``A``, ``mA`` or ``raw``.
        effort_sign: -1 where efforts are counted the other way round, of all joints or by joint.
        **facts: The same by section: ``payload={"com": [0, 0, 0.01]}``, ``block={"size": 0.03}``.

    Raises:
        ConfigurationError, RobotError, RecordingError: With one line that says what is wrong and what to do.
    """
    given = read_arguments(locals())
    return Weighing(
        replay(given["bags"], options_of(given)),
        given["bags"],
        _call("weigh", given),
    )


def calibrate(
    bags: Paths,
    *,
    references: Mapping[AnyPath, float] | None = None,
    output: AnyPath | None = None,
    force: bool = False,
    robot: AnyPath | None = None,
    settings: Mapping[str, Any] | None = None,
    driver: AnyPath | None = None,
    state_topic: str | None = None,
    command_topic: str | None = None,
    effort_unit: str | None = None,
    effort_sign: int | str | Mapping[str, int] | None = None,
    progress: Callable[[str], None] = lambda _: None,
    **facts: Mapping[str, Any],
) -> CalibrationResult:
    """Learn the robot from runs with nothing in the hand, and optionally with a weighed reference.

    Args:
        bags: Recordings with nothing in the hand.
        references: Bags with the reference in the hand, and its mass [kg]; ``payload`` describes it.
        output: File (.yaml) that an accepted calibration becomes.
        force: Whether it may take the place of an older one.
        robot: As for `weigh`, like all that is not listed here.
        settings: By dotted key.
        driver: Profile of the driver that published.
        state_topic: Of the joint states.
        command_topic: Of the input.
        effort_unit: What effort means.
        effort_sign: Which way it counts.
        progress: Called with sentences on what is going on.
        **facts: About the reference, by section.

    Returns:
        What is known about the robot now.

    Raises:
        ConfigurationError, RobotError, RecordingError: With one line that says what is wrong and what to do.
    """
    given = read_arguments(locals())
    folder = tempfile.TemporaryDirectory(prefix="proprio-") if output is None else None
    path = Path(given["output"] if folder is None else f"{folder.name}/calibration.yaml")
    estimate = calibrate_from_bags(
        given["bags"], given["references"] or {}, options_of(given), path, progress, force
    )
    accepted = estimate.verdict.value == "accepted"
    return CalibrationResult(
        estimate, path if accepted else None, _call("calibrate", given), folder
    )


def plan(
    masses: float | Sequence[float],
    *,
    calibration: AnyPath | None = None,
    robot: AnyPath | None = None,
    count: int = 10,
    seconds: float = 3.0,
    settings: Mapping[str, Any] | None = None,
    progress: Callable[[str], None] = lambda _: None,
    **facts: Mapping[str, Any],
) -> Plans:
    """Which run to make for an object of about this mass: start poses and currents, the smallest interval first.

    Interrupted, the search returns the best so far.

    Args:
        masses: That the hand may hold [kg]; a run must suit all of them.
        calibration: What `calibrate` returned, or its file.
        robot: Name, or robot file.
        count: Of plans, at most.
        seconds: After which the search ends, or when nothing is left to try; the longer, the better its plans.
        settings: By dotted key.
        progress: Called with sentences on what is going on.
        **facts: About the object, by section.

    Returns:
        The plans, best first.

    Raises:
        ConfigurationError, RobotError: With one line that says what is wrong and what to do.
    """
    given = read_arguments(locals())
    asked = given["masses"]
    return Plans(
        *plan_excitations(
            asked,
            options_of(given),
            given["count"],
            progress,
            given["seconds"],
        ),
        asked,
    )


def check(
    bags: Paths,
    *,
    robot: AnyPath | None = None,
    driver: AnyPath | None = None,
    state_topic: str | None = None,
    command_topic: str | None = None,
    effort_unit: str | None = None,
    effort_sign: int | str | Mapping[str, int] | None = None,
    settings: Mapping[str, Any] | None = None,
) -> Checks:
    """What is in each bag, which input would be used, and which runs: before any fit.

    Args:
        bags: As for `weigh`, like all arguments.
        robot: Name, or robot file.
        driver: Profile of the driver that published.
        state_topic: Of the joint states.
        command_topic: Of the input.
        effort_unit: What effort means.
        effort_sign: Which way it counts.
        settings: By dotted key; what is stated about an object is not looked at.

    Returns:
        An entry per bag.

    Raises:
        ConfigurationError, RobotError, RecordingError: With one line that says what is wrong and what to do.
    """
    given = read_arguments(locals())
    return Checks(*check_bags(given["bags"], options_of(given)))


def _path(value: Any) -> str:
    text = os.fspath(value) if isinstance(value, os.PathLike) else value
    if not isinstance(text, str):
        raise FormError(f"expected a path, got {shortly(value)}")
    return text


def _word(value: Any) -> str:
    if not isinstance(value, str):
        raise FormError(f"expected a text, got {shortly(value)}")
    return value


def _sign(value: Any) -> str:
    """As the command line takes it."""
    return str(EFFORT_SIGN.read(value))


def _several(value: Any, what: str) -> list[Any]:
    """The entries of what is a list of some kind."""
    if isinstance(value, (str, bytes, Mapping)) or not isinstance(value, Iterable):
        raise FormError(f"expected {what}, or a list of them, got {shortly(value)}")
    return list(value)


def _paths(value: Any) -> tuple[str, ...]:
    alone = isinstance(value, (str, os.PathLike))
    return tuple(_path(entry) for entry in ([value] if alone else _several(value, "a path")))


def _masses(value: Any) -> list[float]:
    alone = isinstance(value, (int, float))
    return [
        Number(unit="kg").read(_plain(mass))
        for mass in ([value] if alone else _several(value, "a mass in kg"))
    ]


def _known(value: Any) -> dict[str | Path, float]:
    known: dict[str | Path, float] = {}
    for bag, mass in mapping(value).items():
        with under(path := _path(bag)):
            known[path] = Number(unit="kg").read(_plain(mass))
    return known


def _stated(value: Any) -> dict[str, Any]:
    given = mapping(value)
    with under("a key"):
        keys = [_word(key) for key in given]
    return {key: _plain(given[key]) for key in keys}


def _called(value: Any) -> Any:
    try:
        inspect.signature(value).bind("a sentence")
    except TypeError as error:
        raise FormError(f"expected a function of a sentence, got {shortly(value)}") from error
    except ValueError:  # one in C does not say what it takes
        pass
    return value


_PERHAPS_PATH, _PERHAPS_WORD = Perhaps(form=Part(by=_path)), Perhaps(form=Part(by=_word))
_FACTS = Part(by=_stated)
_ARGUMENTS: dict[str, Form] = {
    **dict.fromkeys(("bags", "baseline"), Part(by=_paths)),
    **dict.fromkeys(("calibration", "robot", "driver", "output"), _PERHAPS_PATH),
    **dict.fromkeys(("probe", "solver", "profile"), Part(by=_word)),
    **dict.fromkeys(("state_topic", "command_topic", "effort_unit"), _PERHAPS_WORD),
    "effort_sign": Perhaps(form=Part(by=_sign)),
    "settings": Perhaps(form=_FACTS),
    "references": Perhaps(form=Part(by=_known)),
    "masses": Part(by=_masses),
    "count": Whole(lowest=1),
    "seconds": Number(lowest=0.0),
    "force": Truth(),
    "progress": Part(by=_called),
}
"""What the arguments of all calls may be; facts come by section, each as `_FACTS`."""


def read_arguments(given: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments of a call as its code takes them; raises ConfigurationError: One is of the wrong type."""
    known = {"held", "solver"} | {
        key.partition(".")[0] for probe in all_probes() for key in probe.keys
    }
    facts = given.get("facts", {})
    for section, values in facts.items():
        if section not in known and not isinstance(values, Mapping):
            by_section = "facts come by section, such as payload={'size': 0.03}"
            raise TypeError(f"{section}= is no argument; {by_section}")
    stated = {
        name: _argument(name, value, _ARGUMENTS[name])
        for name, value in given.items()
        if name != "facts"
    }
    return {
        **stated,
        "facts": {section: _argument(section, values, _FACTS) for section, values in facts.items()},
    }


def _argument(name: str, value: Any, form: Form) -> Any:
    try:
        return read(name, _plain(value), form)
    except ProprioError:
        raise
    except Exception as error:
        # of a value's own methods: a path or a list that is none, or holds itself
        raise ConfigurationError(
            f"cannot be read ({type(error).__name__}: {error})", name
        ) from error


def options_of(given: Mapping[str, Any]) -> Options:
    """What a call states, by the names of its arguments; facts get dotted keys."""
    stated = {entry.name: given[entry.name] for entry in fields(Options) if entry.name in given}
    dotted = dict(given["settings"] or {})
    for section, values in given["facts"].items():
        dotted |= {f"{section}.{key}": value for key, value in values.items()}
    return Options(**{**stated, "settings": dotted})


def _plain(value: Any) -> Any:
    """Paths become text, arrays lists."""
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, (list, tuple)):
        return [_plain(entry) for entry in value]
    return value.tolist() if hasattr(value, "tolist") and not isinstance(value, type) else value


def _call(name: str, given: Mapping[str, Any]) -> str:
    """The call as it was made, for the report."""
    usual = {"probe": "payload", "solver": "lm", "profile": "default"}
    words = [repr(list(given["bags"]))]
    for key, value in given.items():
        if key == "facts":
            words += [f"{section}={values!r}" for section, values in value.items()]
        elif key not in ("bags", "progress") and value and value != usual.get(key):
            words.append(f"{key}={list(value) if isinstance(value, tuple) else value!r}")
    return f"{name}({', '.join(words)})"


def _ends(interval: Any) -> tuple[Any, Any]:
    """Lower and upper ends; of a vector, lists of them."""
    if interval is None:
        return None, None
    if interval and isinstance(interval[0], (list, tuple)):
        ends = [_ends(entry) for entry in interval]
        return [low for low, _ in ends], [high for _, high in ends]
    low, high = interval
    return low, high


def frame(
    columns: Sequence[str],
    rows: Sequence[tuple[Any, ...]],
) -> pandas.DataFrame:
    """A table; raises ConfigurationError: pandas is not installed."""
    try:
        import pandas
    except ModuleNotFoundError as error:
        raise ConfigurationError("to_frame() needs pandas: pip install pandas") from error
    return pandas.DataFrame(rows, columns=list(columns))
