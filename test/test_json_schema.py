"""What is printed with --json, against the schema that is installed with the package."""

from __future__ import annotations

import copy
import json
import re
import tempfile
from pathlib import Path
from typing import Any

import pytest

from proprio_ros.cli import main
from proprio_ros.identification.reasons import CODES
from proprio_ros.inputs.resources import resource
from proprio_ros.version import __version__

jsonschema = pytest.importorskip("jsonschema")
ROOT = Path(__file__).resolve().parents[1]
REAL = ROOT.parent / "shared" / "recordings_real"


def strict(schema: Any) -> Any:
    """The same, and nothing may be there that the schema does not describe."""
    if isinstance(schema, list):
        return [strict(entry) for entry in schema]
    if not isinstance(schema, dict):
        return schema
    inner = {key: strict(value) for key, value in schema.items()}
    if (
        schema.get("type") == "object"
        and "required" in schema
        and "properties" in schema
        and "$defs" not in schema
    ):
        inner.setdefault("additionalProperties", False)
    return inner


@pytest.fixture(scope="module")
def validator() -> Any:
    schema = json.loads(resource("schema", "output").read_text())
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(strict(schema))


def bag(name: str) -> str:
    return str(ROOT / "bags" / name / "bag_mcap")


@pytest.fixture(scope="module")
def calibration(tmp_path_factory: pytest.TempPathFactory) -> str:
    """All joints that the outputs below need, in one file."""
    path = tmp_path_factory.mktemp("calibration") / "arm.yaml"
    empty = [bag(folder.name) for folder in sorted((ROOT / "bags").glob("realistic_s00_empty_*"))]
    closings = [bag("realistic_s00_squeeze_empty_0"), bag("realistic_s00_squeeze_empty_1")]
    assert main(["calibrate", *empty, *closings, "--output", str(path)]) == 0
    return str(path)


def printed(
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    code: int,
) -> dict[str, Any]:
    """The one object on stdout."""
    capsys.readouterr()
    assert main(arguments) == code
    return json.loads(capsys.readouterr().out)


def outputs(calibration: str) -> dict[str, tuple[list[str], int]]:
    ball = bag("quantised_s00_fixed_heavy_ball_50g_joint3")
    return {
        "payload": (["replay", ball, "--probe", "payload"], 3),
        "payload, paper": (["replay", ball, "--probe", "payload", "--profile", "paper",], 3,),
        "calibrated payload": (
            ["replay", bag("realistic_s00_fixed_heavy_ball_50g_joint3"), "--probe", "payload", "--calibration", calibration,
             "--baseline", bag("realistic_s00_empty_00_joint3")], 0,
        ),
        "stuck": (["replay", bag("friction_s00_fixed_random_a_joint3"), "--probe", "payload",], 3,),
        "container": (
            ["replay", bag("realistic_s00_container_sphere_random_joint4_030mA"), "--probe", "container", "--calibration",
             calibration, "--baseline", bag("realistic_s00_container_no_sphere_joint4_030mA")], 0,
        ),
        "softness": (
            ["replay", bag("realistic_s00_squeeze_light"), "--probe", "softness", "--calibration", calibration,], 0,
        ),
        "plan": (["plan", "--mass", "0.05", "--count", "2", "--calibration", calibration,], 0,),
        "check": (["check", ball, bag("friction_s00_fixed_random_a_joint3"), bag("realistic_s00_squeeze_light"),], 0,),
        "robot": (
            ["robot", "new", str(ROOT / "urdf" / "open_manipulator_x.urdf"), "--force", "--output",
             str(Path(tempfile.gettempdir()) / "proprio_new_robot.yaml")], 0,
        ),
        "check of a motion": (["check", str(REAL / "omx_empty_1")], 0),
        "unusable": (["check", bag("friction_s00_fixed_random_a_joint3")], 3),
        "no bag": (["replay", "nowhere", "--probe", "payload"], 2),
        "no bag to check": (["check", "nowhere"], 2),
        "report nowhere": (["replay", ball, "--probe", "payload", "--report", "/nowhere/page.html",], 2,),
    }  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize("name", sorted(outputs("")))
def test_outputs(
    name: str,
    validator: Any,
    calibration: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    arguments, code = outputs(calibration)[name]
    if str(REAL) in arguments[1] and not REAL.exists():
        pytest.skip("needs the real recordings")
    result = printed(capsys, [*arguments, "--json"], code)
    validator.validate(result)
    assert result["version"] == __version__
    kind = result["schema"].split("/")[1]
    assert kind == (
        "error" if code == 2 else {"replay": "estimate"}.get(arguments[0], arguments[0])
    )
    if kind == "estimate":
        assert len(result["reasons"]) == len(result["reason_codes"]) and set(
            result["reason_codes"]
        ) <= set(CODES)
        assert (result["calibration"] is not None) == ("--calibration" in arguments)
        assert result["bags"] == arguments[1:2] and len(result["baseline"]) == (
            "--baseline" in arguments
        )
    if kind == "error":
        assert result["exit_code"] == code


@pytest.mark.parametrize(
    "bags", ["realistic_s00_empty_0[0-2]_*", "friction_s00_fixed_random_a_joint3"]
)
def test_calibrations(
    bags: str,
    validator: Any,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    paths = [bag(folder.name) for folder in sorted((ROOT / "bags").glob(bags))]
    output = tmp_path / "arm.yaml"
    arguments = [
        "calibrate",
        *paths,
        "--reference",
        f"{bag('realistic_s00_fixed_reference_100g_joint3_x1')}=0.1",
    ]
    arguments = arguments if len(paths) > 1 else arguments[:2]
    accepted = len(paths) > 1
    result = printed(
        capsys,
        [*arguments, "--output", str(output), "--json"],
        0 if accepted else 3,
    )
    validator.validate(result)
    assert result["bags"] == paths and len(result["references"]) == accepted
    assert (
        (result["calibration"] is not None)
        == (result["output"] is not None)
        == output.exists()
        == accepted
    )


@pytest.mark.parametrize(
    "arguments",
    [["replay", "--json"], ["replay", "bag", "--probe", "weight", "--json"], ["weigh", "--json"]],
)
def test_a_command_line_that_does_not_parse(
    arguments: list[str],
    validator: Any,
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    said = capsys.readouterr()
    assert stopped.value.code == 2 and said.err.startswith("usage: proprio")
    result = json.loads(said.out)
    validator.validate(result)
    assert result["schema"] == "proprio_ros/error/1" and " ".join(
        result["error"].split()
    ) in " ".join(said.err.split())


def test_the_sentence_stays_on_stderr(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "nowhere", "--json"]) == 2
    said = capsys.readouterr()
    assert said.err == f"proprio: {json.loads(said.out)['error']}\n"


def test_the_schema_refuses(
    validator: Any,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A schema that lets everything pass would pass the tests above."""
    arguments, code = outputs("")["stuck"]
    good = printed(capsys, [*arguments, "--json"], code)
    for path, wrong in (
        (("verdict",), "maybe"), (("runs",), -1), (("reasons",), "stuck"), (("estimates", 0, "value"), "heavy"),
        (("calibration",), {"name": "arm.yaml"}), (("schema",), "proprio_ros/estimate/2"), (("extra",), 1),
        (("reason_codes",), ["Two words"]),
    ):  # fmt: skip
        bad = copy.deepcopy(good)
        inner = bad
        for key in path[:-1]:
            inner = inner[key]
        inner[path[-1]] = wrong
        with pytest.raises(jsonschema.ValidationError):
            validator.validate(bad)
    for key in (
        "probe",
        "robot",
        "runs",
        "verdict",
        "reasons",
        "estimates",
        "fit",
        "solver",
        "timing_s",
        "version",
    ):
        with pytest.raises(jsonschema.ValidationError):
            validator.validate({name: value for name, value in good.items() if name != key})


def test_every_code_is_in_the_table_and_every_entry_is_used() -> None:
    used = {"other"}
    for path in (ROOT / "proprio_ros").rglob("*.py"):
        used.update(
            re.findall(
                r'\b(?:(?:Reason|rejected|not_identifiable)\(\s*|yield \(?\s*)"(\w+)"',
                path.read_text(),
            )
        )
    assert used == set(CODES), (
        "a code is a literal where it is first said, and has its entry in CODES"
    )
    page = (ROOT / "docs" / "pages" / "refusals.md").read_text(encoding="utf-8")
    assert re.findall(r"^## (\w+)$", page, re.MULTILINE) == list(CODES), (
        "run python docs/generate.py"
    )
