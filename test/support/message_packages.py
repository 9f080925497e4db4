"""Builds packages of ROS messages, services and actions with what the pip wheels of ROS bring, and a C++ compiler.

On a robot PC colcon and rosidl_generate_interfaces do this. The wheels have the same generators, headers and libraries, but no
ament_cmake; so the generators are called one after the other here, and what each writes becomes a library.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import xml.etree.ElementTree as ElementTree
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import pytest

ALWAYS = (
    "builtin_interfaces",
    "service_msgs",
    "action_msgs",
    "unique_identifier_msgs",
    "type_description_interfaces",
)
"""What services and actions are made of, whether a package says so or not."""
PARTS = (
    "rosidl_generator_c",
    "rosidl_typesupport_fastrtps_c",
    "rosidl_typesupport_introspection_c",
    "rosidl_typesupport_c",
)
"""Libraries of a package, each of which needs those before it; the middleware asks for the last, and that for the two before."""
ROS = Path(sys.prefix)
"""Where the wheels put include/, lib/ and share/."""
BUILD_S = 600.0


def build(
    package: Path,
    prefix: Path,
) -> dict[str, str]:
    """Build a message package so that ``import <its name>.msg`` works; a test without a compiler skips, and fails in the gate.

    Args:
        package: Folder with a package.xml and with msg/*.msg, srv/*.srv, action/*.action. What it depends on must be among the
            wheels.
        prefix: New folder for what is built. The Python package lies in its site-packages.

    Returns:
        Environment in which another process of this Python can import it. For this process: `sys.path`.

    Raises:
        RuntimeError: A generator or the compiler failed, with what it said.
    """
    missing = _missing()
    if missing:
        (pytest.fail if os.environ.get("CI") else pytest.skip)(
            f"message packages cannot be built: {missing}"
        )
    paths = [str(prefix / "site-packages")]
    if os.environ.get("PYTHONPATH"):
        paths.append(os.environ["PYTHONPATH"])
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
    command = [
        sys.executable,
        str(Path(__file__).resolve()),
        str(package.resolve()),
        str(prefix.resolve()),
    ]
    # of its own, for generators keep state, and find their templates by an environment variable
    done = subprocess.run(
        command,
        env={
            **os.environ,
            "AMENT_PREFIX_PATH": str(ROS),
        },
        capture_output=True,
        text=True,
    )
    if done.returncode != 0:
        raise RuntimeError(f"building {package.name}: {done.stdout[-2000:]}{done.stderr[-6000:]}")
    return environment


def _missing() -> str:
    """What cannot be done without, or an empty string."""
    if not (ROS / "share" / "rosidl_generator_py").is_dir():
        return "no generators; install proprio_ros[ros]"
    if shutil.which("g++") is None:
        return "no g++; apt-get install g++"
    if not Path(sysconfig.get_paths()["include"], "Python.h").is_file():
        return "no Python.h; apt-get install python3-dev"
    return ""


@dataclass(frozen=True)
class _Package:
    """A package of messages, and where what is made of it goes."""

    folder: Path
    prefix: Path
    name: str
    needs: tuple[str, ...]

    @classmethod
    def of(cls, folder: Path, prefix: Path) -> _Package:
        manifest = ElementTree.parse(folder / "package.xml").getroot()
        stated = [
            element.text or ""
            for tag in ("depend", "build_depend", "exec_depend")
            for element in manifest.iter(tag)
        ]
        needs = [
            each
            for each in dict.fromkeys((*stated, *ALWAYS))
            if (ROS / "include" / each / each / "msg").is_dir()
        ]
        return cls(folder, prefix, str(manifest.findtext("name")), tuple(needs))

    @property
    def libraries(self) -> Path:
        return self.prefix / "lib"

    @property
    def module(self) -> Path:
        return self.prefix / "site-packages" / self.name

    @property
    def generated(self) -> dict[str, Path]:
        """What each part writes includes what those before it wrote, as <package>/msg/..."""
        return {part: self.prefix / "generated" / part / self.name for part in PARTS}

    def converted(self) -> list[str]:
        """Messages, services and actions as IDL."""
        from rosidl_adapter.action import convert_action_to_idl
        from rosidl_adapter.msg import convert_msg_to_idl
        from rosidl_adapter.srv import convert_srv_to_idl

        converters = {
            "msg": convert_msg_to_idl,
            "srv": convert_srv_to_idl,
            "action": convert_action_to_idl,
        }
        idl = []
        for kind, convert in converters.items():
            for path in sorted((self.folder / kind).glob(f"*.{kind}")):
                convert(
                    self.folder,
                    self.name,
                    path.relative_to(self.folder),
                    self.prefix / "idl" / kind,
                )
                idl.append(f"{self.prefix / 'idl'}:{kind}/{path.stem}.idl")
        return idl


def _generate(package: _Package) -> None:
    """Sources in C, C++ and Python."""
    from rosidl_generator_c.cli import GenerateC
    from rosidl_generator_py.cli import GeneratePython
    from rosidl_generator_type_description.cli import HashTypeDescription
    from rosidl_typesupport_c.cli import GenerateCTypesupport
    from rosidl_typesupport_fastrtps_c.cli import GenerateFastRTPSCTypesupport
    from rosidl_typesupport_introspection_c.cli import GenerateIntrospectionCTypesupport

    given = (
        package.name,
        package.converted(),
        [str(ROS / "share" / each) for each in package.needs],
    )
    hashes = HashTypeDescription("hash").generate_type_hashes(*given, package.prefix / "idl")
    messages, fastrtps, introspection, support = package.generated.values()
    GenerateC("c").generate(*given, messages, type_description_files=hashes)
    GenerateFastRTPSCTypesupport("fastrtps_c").generate(*given, fastrtps)
    GenerateIntrospectionCTypesupport("introspection_c").generate(*given, introspection)
    of_c = GenerateCTypesupport("c", typesupport_implementations=list(PARTS[1:3]))
    of_c.generate(*given, support)
    of_python = GeneratePython("py", typesupport_implementations=list(PARTS[3:]))
    of_python.generate(*given, package.module)


def _headers(package: _Package) -> list[Path]:
    """Folders of headers; the wheels put theirs into include/<package>/<package>."""
    import numpy

    ros = ROS / "include"
    own = (*package.generated.values(), package.module)
    return [
        ros,
        *(path for path in ros.iterdir() if (path / path.name).is_dir()),
        *(folder.parent for folder in own),
        Path(sysconfig.get_paths()["include"]),
        Path(numpy.get_include()),
    ]


def _build(folder: Path, prefix: Path) -> None:
    """Generate, compile and link."""
    package = _Package.of(folder, prefix)
    libraries = package.libraries
    module = package.module
    libraries.mkdir(parents=True)
    module.mkdir(parents=True)
    (module / "__init__.py").touch()
    _generate(package)
    flags = ["-fPIC", "-w", *(f"-I{folder}" for folder in _headers(package))]
    parts = (*PARTS, "rosidl_generator_py")
    others = [f"-l{each}__{part}" for each in package.needs for part in parts]
    others += [f"-l{part}" for part in (*PARTS[1:], "rosidl_runtime_c", "rcutils", "fastcdr")]
    paths = [
        f"{option}{folder}"
        for folder in (libraries, ROS / "lib")
        for option in ("-L", "-Wl,-rpath,")
    ]

    def compiled(source: Path) -> str:
        language = ["gcc"] if source.suffix == ".c" else ["g++", "-std=c++17"]
        _call([*language, *flags, "-c", str(source), "-o", f"{source}.o"])
        return f"{source}.o"

    def link(folder: Path, target: Path) -> None:
        sources = sorted(path for path in folder.rglob("*.c*") if path.suffix in (".c", ".cpp"))
        with ThreadPoolExecutor(max_workers=os.cpu_count()) as pool:
            objects = list(pool.map(compiled, sources))
        mine = [f"-l:{path.name}" for path in libraries.iterdir()]
        # rosidl_typesupport_c looks for the others by name: they must be loaded, whether they are called directly or not
        options = ["-Wl,--no-as-needed", f"-Wl,-soname,{target.name}", *paths]
        _call(["g++", "-shared", *objects, *options, *mine, *others, "-o", str(target)])

    name = package.name
    for part, folder in package.generated.items():
        link(folder, libraries / f"lib{name}__{part}.so")
    link(module, module / f"{name}_s__{PARTS[3]}{sysconfig.get_config_var('EXT_SUFFIX')}")


def _call(command: list[str]) -> None:
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(command[:2])} ... {command[-1]}: {done.stderr[-4000:]}")


if __name__ == "__main__":
    _build(
        Path(sys.argv[1]),
        Path(sys.argv[2]),
    )
