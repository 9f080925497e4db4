"""Kernels are compiled ahead for those who cannot wait; whoever waits hears how far it is; a cache that fails is one line."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import warp as wp

from proprio_ros import progress
from proprio_ros.errors import ConfigurationError
from proprio_ros.pipeline.replay import compile_for, replay
from proprio_ros.pipeline.request import Options
from proprio_ros.probes import all_probes
from proprio_ros.sim import runtime, sphere, squeeze
from proprio_ros.sim.joint import JointSimulator

runtime.start()  # it decides where kernels are kept
COMPILING = "once on this computer"
LAWS = (JointSimulator, sphere.SphereSimulator, squeeze.SqueezeSimulator)


def kernel_of(number: float) -> Any:
    """A kernel in a module of its own; another number is another kernel."""

    @wp.kernel(module="unique", enable_backward=False)
    def write(out: wp.array(dtype=wp.float64)):  # type: ignore[valid-type]
        out[0] = wp.float64(number)

    return write


def test_what_is_compiled_is_said_and_only_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path))
    kernels = [kernel_of(1.5), kernel_of(2.5)]
    heard = []
    with progress.listening(heard.append):
        runtime.load(kernels, "cpu")
        assert [words.split(",")[0] for words in heard] == [
            f"compiling {number} of 2 kernels" for number in (1, 2)
        ]
        assert all(words.endswith(f" s and more, {COMPILING}") for words in heard)
        runtime.load([*kernels, kernel_of(3.5)], "cpu")
        assert len(heard) == 3 and heard[2].startswith("compiling 1 of 1 kernels, ")
        out = wp.zeros(1, dtype=wp.float64, device="cpu")
        runtime.launch(
            kernels[1],
            dim=1,
            inputs=[out],
            device="cpu",
        )
        assert out.numpy()[0] == 2.5 and len(heard) == 3
        runtime.launch(
            kernel_of(4.5),
            dim=1,
            inputs=[out],
            device="cpu",
        )
        assert heard[-1].startswith("compiling kernel ") and out.numpy()[0] == 4.5
    runtime.load([kernel_of(5.5)], "cpu")
    assert len(heard) == 4, "nobody listens any more"


def test_a_cache_that_cannot_be_written_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was there when Warp started, and is not when a kernel is to be kept."""
    (tmp_path / "file").touch()
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path / "file"))
    with pytest.raises(
        ConfigurationError, match="set WARP_CACHE_PATH to a folder that can be written"
    ) as error:
        runtime.load([kernel_of(6.5)], "cpu")
    assert "\n" not in str(error.value) and str(tmp_path) in str(error.value)


@pytest.mark.long
@pytest.mark.parametrize("command", ["replay", "warmup"])
def test_the_command_line_says_so_in_one_line(
    command: str,
    bags: Path,
    tmp_path: Path,
) -> None:
    (tmp_path / "file").touch()
    words = [command]
    if command == "replay":
        bag = bags / "quantised_s00_fixed_heavy_ball_50g_joint3" / "bag_mcap"
        words += [str(bag), "--probe", "payload"]
    done = subprocess.run(
        [sys.executable, "-m", "proprio_ros.cli", *words],
        env={**os.environ, "WARP_CACHE_PATH": str(tmp_path / "file" / "cache")},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 2 and not done.stdout
    assert done.stderr.count("\n") == 1 and "set WARP_CACHE_PATH" in done.stderr


CONTAINER = (
    "--probe",
    "container",
    "--baseline",
    "{bags}/realistic_s00_container_no_sphere_joint3_100mA/bag_mcap",
)


@pytest.mark.long
@pytest.mark.parametrize(
    ("bag", "options", "at_most"),
    [
        ("quantised_s00_fixed_heavy_ball_50g_joint3", ("--probe", "payload"), 8),
        ("realistic_s00_container_sphere_12g_joint3_100mA", CONTAINER, None),
    ],
)
def test_a_replay_says_what_it_compiles(
    bag: str,
    options: tuple[str, ...],
    at_most: int | None,
    bags: Path,
    tmp_path: Path,
) -> None:
    words = [sys.executable, "-m", "proprio_ros.cli", "replay", str(bags / bag / "bag_mcap")]
    words += [option.format(bags=bags) for option in options]

    def said() -> list[str]:
        environment = {**os.environ, "WARP_CACHE_PATH": str(tmp_path)}
        done = subprocess.run(
            [*words, "--json"],
            env=environment,
            capture_output=True,
            text=True,
        )
        assert done.returncode in (0, 3), done.stderr  # too wide: the arm is not calibrated
        return done.stderr.splitlines()

    lines = [line for line in said() if "compiling" in line]
    assert lines
    for number, line in enumerate(lines, start=1):
        assert line.startswith(f"proprio: compiling kernel {number} of at most {at_most or ''}")
        assert line.endswith(f" s and more each, {COMPILING}")
    assert not any("compiling" in line for line in said())


@pytest.mark.parametrize("law", LAWS)
def test_each_law_has_sizes_that_are_compiled(law: type[JointSimulator]) -> None:
    # a sphere has more parameters than its largest size has directions: they go in blocks
    sizes = law.usual_sizes()
    assert sizes and tuple(sizes) == law.tangent_sizes[: len(sizes)]
    assert sizes[-1] >= len(law.parameters) or sizes[-1] == law.tangent_sizes[-1]


def kernels_loaded(
    monkeypatch: pytest.MonkeyPatch,
    do: Callable[[], Any],
    really: bool = True,
) -> set[str]:
    """Names of the modules of kernels that something loads."""
    names: set[str] = set()
    load = runtime.load
    launch = runtime.launch

    def loaded(kernels: list[Any], device: Any) -> None:
        names.update(kernel.module.name for kernel in kernels)
        if really:
            load(kernels, device)

    def launched(kernel: Any, **given: Any) -> Any:
        names.add(kernel.module.name)
        return launch(kernel, **given)

    with monkeypatch.context() as patch:
        patch.setattr(runtime, "load", loaded)
        patch.setattr(runtime, "launch", launched)
        do()
    return names


def compiled_for(
    monkeypatch: pytest.MonkeyPatch, probe: str, robot: str = "open_manipulator_x"
) -> set[str]:
    return kernels_loaded(
        monkeypatch, lambda: compile_for(Options(probe=probe, robot=robot)), really=False
    )


def test_a_probe_compiles_what_it_needs_and_no_more(monkeypatch: pytest.MonkeyPatch) -> None:
    kernels = {probe.name: compiled_for(monkeypatch, probe.name) for probe in all_probes()}
    assert len(kernels["payload"]) == 8, (
        "four sizes, with friction that rises towards standstill and without"
    )
    assert kernels["payload"] < kernels["container"] and kernels["payload"] < kernels["softness"]
    assert not any(
        name.startswith("tangent") for name in kernels["payload"] | kernels["softness"]
    ), "the sphere's"
    # a pendulum's friction does not rise: only where every parameter has its direction
    expected = {"payload": (8, 5), "container": (14, 10), "softness": (16, 10)}
    for probe, (of_the_arm, of_the_pendulum) in expected.items():
        assert len(kernels[probe]) == of_the_arm
        assert len(compiled_for(monkeypatch, probe, "pendulum")) == of_the_pendulum


@pytest.mark.long
@pytest.mark.parametrize(
    ("probe", "bag", "baseline"),
    [
        ("payload", "realistic_s00_fixed_heavy_ball_50g_joint3", "realistic_s00_empty_00_joint3"),
        ("container", "realistic_s00_container_sphere_12g_joint3_100mA", "realistic_s00_container_no_sphere_joint3_100mA"),
        ("softness", "realistic_s00_squeeze_heavy", "realistic_s00_squeeze_empty_0"),
    ],
)  # fmt: skip
def test_nothing_is_left_to_compile_after_a_warmup(
    probe: str,
    bag: str,
    baseline: str,
    bags: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    options = Options(
        probe=probe,
        baseline=(bags / baseline / "bag_mcap",),
    )
    needed = kernels_loaded(
        monkeypatch,
        lambda: replay(bags / bag / "bag_mcap", options),
    )
    assert needed and needed <= compiled_for(monkeypatch, probe)
