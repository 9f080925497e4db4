"""One quiet start of Warp, shared by every kernel, and kernels that say so when they have to be compiled."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from functools import partial
from typing import Any

import warp as wp

from proprio_ros import progress
from proprio_ros.errors import ComputerError, ConfigurationError

FLOAT = wp.float64
"""All rollouts run in double precision: on a CPU float32 is no faster, and its gradients are off by up to 0.1 %."""
FLOATS = wp.array2d(dtype=FLOAT)

COMPILERS = min(os.cpu_count() or 1, 4)
"""Kernels that are compiled at the same time. Each thread first compiles Warp's headers, 1.2 s; a single one is the caller's."""
SECONDS_EACH = 1.3
"""What the kernel of a push takes to compile; one of moving contents takes up to eight."""
_refusal = ""
_started = False
_alone = 0  # how many kernels were compiled in this process for the first who asked, and not ahead


def start() -> None:
    """Initialise Warp without its banner; safe to call again.

    What is wrong with its folder of compiled kernels is said by ``check``: an import that fails could not say it in one line.
    """
    global _refusal, _started
    if _started:
        return
    _started = True
    wp.config.log_level = wp.LOG_WARNING
    with nullcontext() if _has_cuda_driver() else _native_stderr_closed():
        try:
            wp.init()
        except OSError as error:
            _refusal = _unwritable(error)


def check() -> None:
    """Start Warp where nothing has: it takes 120 MB, which a motion needs no kernel for.

    Raises: ComputerError: Warp could not make its folder of compiled kernels.
    """
    start()
    if _refusal:
        raise ComputerError(_refusal)


def device_named(name: str) -> str:
    """A device as Warp takes it: ``"cpu"``, ``"cuda"`` (the first graphics card) or ``"cuda:1"``.

    Raises `ConfigurationError`: It is not there.
    """
    if name == "cpu":
        return name
    check()
    if name.partition(":")[0] != "cuda":
        raise ConfigurationError(f"--device {name}: choose cpu or cuda")
    there = ["cuda", *(f"cuda:{number}" for number in range(wp.get_cuda_device_count()))]
    if len(there) == 1:
        missing = "no CUDA device: Warp finds no NVIDIA graphics card and driver on this computer"
        raise ConfigurationError(f"--device {name}: {missing}; leave it out")
    if name not in there:
        raise ConfigurationError(f"--device {name}: choose cpu, {', '.join(there)}")
    return name


def _unwritable(error: OSError) -> str:
    return (
        f"compiled kernels cannot be kept in {wp.config.kernel_cache_dir} ({error.strerror}): "
        "set WARP_CACHE_PATH to a folder that can be written"
    )


def load(kernels: Sequence[Any], device: Any) -> None:
    """Compile and load kernels, each in a module of its own, and say how far that is for those not kept from before.

    Raises `ComputerError`: A compiled kernel cannot be kept.
    """
    check()
    missing = [kernel.module for kernel in kernels if not _is_kept(kernel.module, device)]
    with ThreadPoolExecutor(COMPILERS) as pool:
        loaded = (pool.map if COMPILERS > 1 else map)(
            partial(_load, device=device),
            missing,
        )
        for number in range(1, len(missing) + 1):
            left_s = SECONDS_EACH * (len(missing) + 1 - number) / COMPILERS
            words = f"compiling {number} of {len(missing)} kernels"
            progress.say(f"{words}, {left_s:.0f} s and more, once on this computer")
            next(loaded)
    for kernel in kernels:
        _load(kernel.module, device)


def launch(
    kernel: Any,
    *,
    device: Any,
    others: Callable[[], Sequence[Any]] = lambda: (),
    **given: Any,
) -> Any:
    """``wp.launch``, which first says so where the kernel has to be compiled.

    Args:
        kernel: What is launched.
        device: Where.
        others: Gives all kernels that the same work may need, so that who waits hears of how many this is one.
        **given: As for ``wp.launch``.

    Returns:
        What that returns.

    Raises:
        ComputerError: A compiled kernel cannot be kept.
    """
    global _alone
    block = given.get("block_dim")
    if not _is_kept(kernel.module, device, block):
        _alone += 1
        to_come = sum(not _is_kept(each.module, device) for each in others() if each != kernel)
        of = f" of at most {_alone + to_come}" if to_come else ""
        words = f"compiling kernel {_alone}{of}"
        progress.say(f"{words}, {SECONDS_EACH:.0f} s and more each, once on this computer")
        _load(kernel.module, device, block)
    return wp.launch(kernel, device=device, **given)


def _load(module: Any, device: Any, block: int | None = None) -> None:
    try:
        wp.load_module(module, device=device, block_dim=block)
    except OSError as error:
        raise ComputerError(_unwritable(error)) from error


def _is_kept(module: Any, device: Any, block: int | None = None) -> bool:
    # Warp names the folder of a module by its content, and renames it into place once everything is in it
    name = module.get_module_identifier(1 if wp.get_device(device).is_cpu else block)
    return os.path.isdir(os.path.join(wp.config.kernel_cache_dir, name))


def _has_cuda_driver() -> bool:
    try:
        ctypes.CDLL("libcuda.so.1")
    except OSError:
        return False
    return True


@contextmanager
def _native_stderr_closed() -> Iterator[None]:
    """Warp's native code writes to stderr that there is no GPU, every time, and no setting of Warp's silences it.

    A robot PC has none, and it is no problem, so nothing should say so in front of every answer.
    """
    try:
        sys.stderr.flush()
        kept = os.dup(2)
    except (
        OSError,
        ValueError,
        AttributeError,
    ):  # no stderr to silence
        yield
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(nowhere)
        os.close(kept)
