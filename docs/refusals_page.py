"""The page about reasons and errors: what each means, what the user sees of it, and what to do."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator

import messages

ABOUT = """# Refusals

Why an answer was refused, or is wider or less certain than it could be, and which errors there are: what each means, what is said \
(`..` stands for names and numbers of your recording), and what to do. The command line and a report give a reason as a sentence; \
`--json` gives its code in `reason_codes`, as here. A code keeps its meaning; the words of a sentence may change.

What the reason makes of the answer is the [verdict](results.md#verdicts). Beside `accepted` a reason is a warning that the \
interval already counts.

A joint that stuck is refused most often (`stuck`, `short_travel`); on a new arm a wrong unit (`arm_unlike_urdf`, `misfit`), which \
`proprio check` shows before any fit."""
OF_ERRORS = """## Classes of errors

Exit code 2, and in Python an exception of `proprio_ros.errors`: something was mistyped, or cannot be read. One line says what is \
wrong, and where; each is one of these."""
DO = {
    "ProprioError": "catch it in a script for all of these",
    "RobotError": "correct the file that the line names; `proprio robot new` writes one that is sound",
    "RecordingError": "`proprio check BAG` says what is in the recording; record again what the line says is missing",
    "TooLittleMotion": "record 15 s or more in which several joints move, or poses of an arm whose motion was calibrated",
    "ConfigurationError": "correct the option or key that the line names; its choices stand there or in [settings](settings.md)",
    "ComputerError": "free the space, or give the rights, that the line names, and call again",
    "SimulationError": "check robot file and facts about the object; a step that is too long is named with the one to take",
    "BusError": "check power, cable, ids and baud rate of the servos",
    "PortLostError": "plug the adapter in, end what else uses its port; the driver goes on by itself",
    "ExcitationError": "bring arm or driver into the state that the line names, and call again",
}
"""What to do about each class of errors."""
LONGEST = 15  # words of a sentence that is shown; what is cut comes back in the remedy


def page(note: str) -> str:
    """Its text, of every code and every class.

    Args:
        note: That it is generated.
    """
    return "\n\n".join([note, ABOUT, *_reasons(), OF_ERRORS, *_errors()]) + "\n"


def classes() -> dict[str, type[Exception]]:
    """Every class of errors by its name, in the order of their file."""
    from proprio_ros import errors

    found = vars(errors).items()
    return {
        name: kind
        for name, kind in found
        if isinstance(kind, type) and issubclass(kind, errors.ProprioError)
    }


def _reasons() -> Iterator[str]:
    from proprio_ros.identification.reasons import CODES

    said = messages.of_reasons()
    for code, about in CODES.items():
        yield f"## {code}"
        yield f"{about.meaning[0].upper()}{about.meaning[1:]}."
        yield from _quoted(said.get(code, []))
        yield f"**What to do**: {about.remedy}."


def _errors() -> Iterator[str]:
    said = messages.of_errors(set(classes()))
    for name, kind in classes().items():
        about, _, _ = inspect.cleandoc(kind.__doc__ or "").partition("\n\n")
        yield f"### {name}"
        yield " ".join(about.split())
        yield from _quoted(said.get(name, []))
        yield f"**What to do**: {DO[name]}."


def _quoted(sentences: list[str]) -> Iterator[str]:
    """The sentence that is shown, as a quotation; nothing where none is."""
    for sentence in sentences[:1]:
        words = re.sub(r"\s+", " ", sentence.replace("|", r"\|")).strip().split(" ")
        shown = words if len(words) <= LONGEST else [*words[:LONGEST], ".."]
        yield f"> {' '.join(shown)}"
