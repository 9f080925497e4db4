"""The page about settings, robot files, driver profiles, calibrations and limits, from the forms that check them."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from typing import Any

Table = Callable[[tuple[str, ...], list[Any]], str]
ABOUT = """What a setting (`--set KEY=VALUE`, the identifier's parameter `settings`), a robot file, a driver profile \
and a calibration may say. Ranges are wider than any arm on a table needs; what lies outside is refused in one \
sentence. Defaults are those of the files in `config/probes`. "0 to 1 m" is a number in that range; ± takes \
`{value: .., std: ..}`, too."""
OF_PROBES = """`payload.size`, `container.inner_size` and `block.size` are lengths in m of the form that the shape \
needs: a diameter or an edge, `[diameter, length]`, or `[x, y, z]`. `payload.frame` is a link of the robot, \
`held.JOINT` the position of a joint that was locked and not recorded, and `robot.KEY` any key of the robot file."""
OF_ROBOTS = """An uncertain number is `{value: .., std: ..}`; a plain one is known exactly. `null` is left out, which \
has its default. `proprio robot new` writes a file with every key. The nominal torque constant may be \
left out where the drive train's is stated."""
OF_DRIVERS = """Files of `config/drivers`, or of your own, for `--driver` and the identifier's parameter `driver`. \
Keys that are left out are those of the profile that a file extends. Topics are named without a namespace, and found \
in any."""
OF_CALIBRATIONS = """The section `calibration` of a robot file, as `proprio calibrate` writes it. `model_fingerprint` \
is required; joints and links must be the robot's; of a calibrated joint no unknown may be missing that the robot file \
leaves open; a torque constant lies within five times the motor's nominal one, up or down. A number within its range \
that is nevertheless wrong cannot be seen in the file: only further runs show it (`--baseline`)."""


def page(note: str, table: Table, once: Callable[[str], str]) -> str:
    """Its text.

    Args:
        note: That it is generated.
        table: Of titles and rows a table in Markdown.
        once: Of a meaning its words, or what stands for them where they were shown before.
    """
    parts = [note, "# Settings, files and limits", ABOUT]
    parts += _probes(table, once)
    parts += [OF_PROBES, "## Robot file", OF_ROBOTS]
    parts += _robot_file(table, once)
    parts += ["## Driver profile", OF_DRIVERS, *_driver_profile(table)]
    parts += ["## Calibration", OF_CALIBRATIONS, _calibration()]
    parts += ["## Limits", table(("of", "at most"), _limits())]
    return "\n\n".join(parts) + "\n"


def _probes(table: Table, once: Callable[[str], str]) -> Iterable[str]:
    from proprio_ros.addons.contents.facts import FORMS as OF_CONTENTS
    from proprio_ros.inputs.settings import SEARCH
    from proprio_ros.probes.container.facts import FORMS as OF_CONTAINER
    from proprio_ros.probes.payload.facts import FORMS as OF_PAYLOAD
    from proprio_ros.probes.softness.facts import FORMS as OF_BLOCK

    of_probes = {
        "payload": OF_PAYLOAD,
        "container": OF_CONTAINER,
        "softness": OF_BLOCK,
        "contents": OF_CONTENTS,
    }
    for probe, forms in of_probes.items():
        rows = _settings_of(probe, forms, SEARCH, once)
        yield f"## Probe {probe}"
        yield table(("key", "default", "value", "meaning"), rows)


def _settings_of(
    probe: str,
    forms: Mapping[str, Any],
    search: Mapping[str, Any],
    once: Callable[[str], str],
) -> list[tuple[str, str, str, str]]:
    """Rows of a probe's own keys, and of those of the search that its file states."""
    from proprio_ros.inputs.settings import probe_file

    content = probe_file(probe)
    rows = []
    for key, form in {**forms, **search}.items():
        section, _, name = key.partition(".")
        stated = content.get(section, {})
        if key not in forms and name not in stated:
            continue
        value = stated.get(name)
        default = "" if value is None else f"`{_yaml(value)}`"
        rows.append((f"`{key}`", default, _shortly(form), once(form.meaning)))
    return rows


def _robot_file(table: Table, once: Callable[[str], str]) -> Iterable[str]:
    from proprio_ros.inputs.forms import REQUIRED
    from proprio_ros.robot import fields

    for title, found in (
        ("The robot", fields.ROBOT),
        ("joints: JOINT", fields.JOINT),
        ("joints: JOINT: motor", fields.MOTOR),
        ("joints: JOINT: drive_train", fields.DRIVE_TRAIN),
    ):
        rows = []
        for key, field in found.items():
            default = _default(field.default, REQUIRED)
            rows.append((f"`{key}`", default, _shortly(field.form), once(field.form.meaning)))
        yield f"### {title}"
        yield table(("key", "default", "value", "meaning"), rows)


def _driver_profile(table: Table) -> Iterable[str]:
    from proprio_ros.recordings.drivers import COLUMNS, FORMS, INPUT

    for title, forms in (("", FORMS), ("### inputs", INPUT), ("### columns", COLUMNS)):
        if title:
            yield title
        rows = [(f"`{key}`", _shortly(form), form.meaning) for key, form in forms.items()]
        yield table(("key", "value", "meaning"), rows)


def _calibration() -> str:
    """The unknowns that may stand in one; their ranges are in the code, since a program writes them."""
    from proprio_ros.calibration_files.pushes import NOISE, RANGES
    from proprio_ros.kinds import KINDS

    names = []
    for kind in RANGES:
        of = KINDS[kind].of
        names.append(f"`{kind}[{of.upper()}]`" if of else f"`{kind}`")
    names += [f"`{key}`" for key in NOISE]
    return f"Unknowns are {', '.join(names)}; `calibration_files/pushes.py` has their ranges."


def _limits() -> list[tuple[str, str]]:
    from proprio_ros.inputs import reading
    from proprio_ros.recordings import reader, storage, text
    from proprio_ros.robot import urdf

    together = f"{reader.MOST_BYTES / 1e6:g} MB together"
    return [
        ("a YAML, JSON or URDF file", f"{reading.LONGEST_TEXT / 1e6:g} MB"),
        ("lists and mappings within each other", str(reading.DEEPEST)),
        ("values of a YAML file, aliases counted as what they stand for", str(reading.MOST_NODES)),
        ("VALUE of a setting", f"{reading.LONGEST_VALUE} characters"),
        ("links of a URDF, and joints", str(urdf.MOST_LINKS)),
        ("names of joints and links", f"{urdf.LONGEST_NAME} printable characters"),
        ("rows of a CSV file", str(text.MOST_ROWS)),
        ("messages of one topic", f"{reader.MOST_MESSAGES}, {together}"),
        ("one message", f"{reader.MOST_BYTES_OF_ONE / 1e3:g} kB"),
        ("files of a compressed bag, unpacked", f"{storage.MOST_UNPACKED / 1e9:g} GB each"),
    ]


def _shortly(form: Any) -> str:
    """Type, range and unit in as few words as a table has room for."""
    words = (
        form.described().replace(", or its value and std", " ±").replace("each a number", "each")
    )
    return re.sub(
        r"\b(number|each) (from )?(?=\S)", lambda found: "each " * (found[1] == "each"), words
    )


def _yaml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return str(value)


def _default(value: Any, required: Any) -> str:
    if value is required:
        return "required"
    if value is None or value == "" or value == float("inf"):
        return ""
    if hasattr(value, "described"):
        return str(value.described())
    if getattr(value, "std", 0.0):
        return f"`{{value: {value.value:g}, std: {value.std:g}}}`"
    plain = list(value) if isinstance(value, tuple) else value
    return f"`{_yaml(getattr(value, 'value', plain))}`"
