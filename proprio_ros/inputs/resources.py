"""Where the files that belong to the package lie: robots, probes, URDFs and small recordings; and how the user's are written.

The same names work from a source tree (also editable and symlinked installs), a wheel, a colcon workspace and a Debian
package. Nothing of ROS is imported: ``get_package_share_directory`` raises where no workspace is sourced, and pip
installs no data files at all for an editable package.
"""

from __future__ import annotations

import errno
import functools
import os
import stat
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from proprio_ros.errors import ConfigurationError
from proprio_ros.whole_files import in_one_step, real_path

KINDS: dict[str, tuple[str, str]] = {
    "robots": ("config/robots", ".yaml"),
    "probes": ("config/probes", ".yaml"),
    "drivers": ("config/drivers", ".yaml"),
    "parameters": ("config", ".yaml"),
    "schema": ("config/schema", ".json"),
    "urdf": ("urdf", ".urdf"),
    "bags": ("bags", ""),
}
"""Folder of each kind of resource under the share directory, and the suffix of its names."""

WRITTEN_BY = '<meta name="generator" content="proprio_ros">'
"""In the head of every page, by which it may be replaced later."""
_OWN_PAGE = (
    WRITTEN_BY.encode(),
    b"default-src 'none'; style-src 'unsafe-inline'; script-src 'sha256-",
)
"""The second is in pages of versions that did not say who wrote them."""

_MARKER = "config/robots/open_manipulator_x.yaml"


def _candidates() -> Iterator[Path]:
    """Nearest to the running code first, so that data and code are of one version even where several are installed."""
    module = Path(__file__).resolve()
    yield module.parents[2]
    for parent in module.parents:
        yield parent / "share" / "proprio_ros"
    yield Path(sys.prefix) / "share" / "proprio_ros"
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        if prefix:
            yield Path(prefix) / "share" / "proprio_ros"


@functools.cache
def share_directory() -> Path:
    """Folder that holds ``config/``, ``urdf/`` and ``bags/``.

    Raises `ConfigurationError`: The package was installed without its data files.
    """
    for candidate in _candidates():
        if (candidate / _MARKER).is_file():
            return candidate
    raise ConfigurationError(
        f"the package's data files ({_MARKER} and others) are neither beside the code nor under {sys.prefix}/share: "
        "install proprio_ros with pip or colcon, or run it from its source tree"
    )


def resource_names(kind: str) -> tuple[str, ...]:
    """Names of all resources of one of `KINDS`, sorted."""
    folder, suffix = KINDS[kind]
    found = (share_directory() / folder).glob(f"*{suffix}")
    return tuple(
        sorted(path.name.removesuffix(suffix) for path in found if suffix or path.is_dir())
    )


def resource(kind: str, name: str) -> Path:
    """Path of a resource by its name, with or without the suffix of its kind.

    Raises `ConfigurationError`: There is none of that name.
    """
    folder, suffix = KINDS[kind]
    path = share_directory() / folder / (name.removesuffix(suffix) + suffix)
    if len(os.fsencode(name)) > 200 or "\0" in name or not path.exists():
        choices = ", ".join(resource_names(kind)) or "none"
        raise ConfigurationError(
            f"no {name[:100]!r} among the {kind}; there are: {choices}; or give a path"
        )
    return path


def paths_of(paths: str | Path | Sequence[str | Path]) -> list[str | Path]:
    """A list of paths; one path that stands alone is a list of one."""
    return [paths] if isinstance(paths, (str, os.PathLike)) else list(paths)


def write_in_one_step(path: Path, text: str, option: str) -> None:
    """Write a text file that is either whole or as it was before.

    A new file gets the mode that the user's umask leaves, a replaced one keeps its own. A link is followed, and what is no file
    (``/dev/stdout``, a pipe) is written into: nothing but a file is ever replaced. The option is what named the file.

    Args:
        path: Of the file.
        text: All of it.
        option: Of the command line, for messages.

    Raises:
        ConfigurationError: The file cannot be written.
    """
    encoded = text.encode("utf-8", errors="backslashreplace")
    try:
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        if path.exists() and not path.is_file():
            # a pipe that nobody reads is refused, not waited for
            handle = os.open(path, os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY)
            with open(handle, "wb") as stream:
                os.set_blocking(handle, True)
                stream.write(encoded)
            return
        with in_one_step(real_path(path)) as stream:
            stream.write(encoded)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise ConfigurationError(
            f"{option} {path}: cannot be written ({reason}); name a file in a folder that exists and is writable"
        ) from error


def check_new_yaml(path: Path, force: bool) -> None:
    """As `check_new`, of a .yaml file."""
    check_new(path, (".yaml", ".yml"), force)


def check_new(path: Path, suffixes: Sequence[str], force: bool) -> None:
    """Refuse an output that has no such suffix, cannot be written, or is there and may not be replaced, before the work is done.

    Args:
        path: Of the output.
        suffixes: That it may have.
        force: Whether an older file is replaced.
    """
    if path.suffix not in suffixes:
        raise ConfigurationError(f"--output {path}: name a {suffixes[0]} file")
    if not real_path(path).parent.is_dir() or not os.access(real_path(path).parent, os.W_OK):
        raise ConfigurationError(f"--output {path}: the folder does not exist or is not writable")
    if path.exists() and not force:
        raise ConfigurationError(
            f"--output {path}: the file exists; --force replaces it (in Python: force=True)"
        )


def check_page(path: Path, option: str, force: bool = False) -> None:
    """Refuse to replace what is no page of this package: a robot file, a calibration, whatever is somebody's.

    Args:
        path: Of the page.
        option: Of the command line, for messages.
        force: Whether anything is replaced.

    Raises:
        ConfigurationError: Such a file is there, and ``force`` does not say that it may go.
    """
    try:
        if force or not path.is_file() or path.stat().st_size == 0:
            return
        with path.open("rb") as stream:
            head = stream.read(1000)
    except PermissionError:
        head = b""
    except (OSError, ValueError):  # who writes it says why it cannot be
        return
    if not head.startswith(b"<!doctype html>") or not any(mark in head for mark in _OWN_PAGE):
        or_force = (
            ", or --force replaces it (in Python: force=True)" if option == "--report" else ""
        )
        raise ConfigurationError(
            f"{option} {path}: the file exists and is no page of proprio: name another{or_force}"
        )


def private_folder(path: Path) -> Path:
    """A folder that only this user can read, made where it is not; raises `OSError` where it is a link or somebody else's."""
    path.mkdir(mode=0o700, parents=False, exist_ok=True)
    there = path.lstat()
    if not stat.S_ISDIR(there.st_mode) or there.st_uid != os.getuid():
        raise OSError(errno.EPERM, f"{path} is not a folder of this user")
    path.chmod(0o700)
    return path
