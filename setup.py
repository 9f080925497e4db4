"""The single source of what is installed: pip, uv and colcon all read this file."""

from glob import glob
from pathlib import Path

from setuptools import find_packages, setup

SHARE = "share/proprio_ros"


def tree(folder: str) -> list[tuple[str, list[str]]]:
    """Every file below a folder, to be installed under share/ in the same sub-folders."""
    files: dict[str, list[str]] = {}
    for path in sorted(Path(folder).rglob("*")):
        if path.is_file():
            files.setdefault(f"{SHARE}/{path.parent.as_posix()}", []).append(path.as_posix())
    return list(files.items())


setup(
    name="proprio_ros",
    version="0.9.0",
    description="A robot arm's sense of weight and softness from its own joints",
    # so that `pip install -e` puts the clone on the path: setuptools' own finder comes after a folder of the package's name, and a
    # script beside the clone would import that
    package_dir={"": "."},
    packages=find_packages(include=["proprio_ros", "proprio_ros.*"]),
    package_data={
        "proprio_ros": [
            "resource/*",
            "launch/*.launch.py",
            "report/*.css",
            "report/*.js",
            "addons/*/*.css",
            "addons/*/*.js",
            "py.typed",
        ]
    },
    data_files=[
        ("share/ament_index/resource_index/packages", ["proprio_ros/resource/proprio_ros"]),
        (SHARE, ["package.xml"]),
        (f"{SHARE}/launch", glob("proprio_ros/launch/*.launch.py")),
        *tree("config"),
        *tree("urdf"),
        *tree("bags"),
    ],
    zip_safe=False,
    python_requires=">=3.10",
    # dynamixel-sdk is what the driver talks to the bus with; ROS 2 Jazzy ships the same module. Lower bounds are what Ubuntu 24.04
    # has where it has it (.ci/lowest tests them all); upper bounds are there where a new major version has broken code before
    install_requires=[
        "numpy>=1.26,<3",
        "warp-lang>=1.19,<2",
        "rosbags>=0.11.9,<0.12",
        "ruamel.yaml",
        "scipy>=1.11",
        "dynamixel-sdk",
        "pyserial",
        "threadpoolctl>=3.1",
    ],
    extras_require={
        # wheels of ROS 2 Jazzy exist for x86-64 only; never beside /opt/ros, whose rclpy they would shadow
        "ros": [
            'ros-jazzy-rclpy[fastrtps]; platform_machine == "x86_64"',
            'ros-jazzy-common-interfaces; platform_machine == "x86_64"',
        ],
        # MuJoCo 4 is split over several packages; what the virtual arm asks of it is the same from 3.7 to 4.0
        "sim": ["mujoco>=3.7,<5"],
        # blocks that are no boxes come from mesh files
        "mesh": ["meshio>=5.3"],
        # rows and LeRobot data sets are parquet
        "batch": ["pyarrow>=15"],
        # one engine of batches; heavy
        "ray": ["ray[data]>=2.40", "pyarrow>=15"],
        # pages with figures, and figures of notebooks
        "report": ["matplotlib>=3.6"],
        # one solver of three, which `--solver cma` and `proprio paper` ask for
        "cma": ["cma>=3.3,<5"],
        # `proprio pendant`: pages in a browser, with all that they load
        "pendant": ["nicegui>=3.0,<4"],
        # `proprio paper` compares optimisers on recordings of a simulated arm
        "paper": ["mujoco>=3.7,<5", "cma>=3.3,<5"],
        "test": [
            "matplotlib>=3.6",
            "cma>=3.3,<5",
            "meshio>=5.3",
            "pyarrow>=15",
            "pandas",
            "jsonschema>=4",
            "pytest>=7",
            "pytest-xdist>=3",
            "greenlet",
            "hypothesis",
            "ruff",
            "mypy",
        ],
        # the pages of docs/; equations become MathML when they are built
        "docs": [
            "matplotlib>=3.6",
            "mkdocs>=1.6,<2",
            "mkdocs-material>=9.5,<10",
            "latex2mathml>=3.77",
        ],
    },
    entry_points={
        "console_scripts": [
            "proprio = proprio_ros.cli:run",
            "proprio_driver = proprio_ros.nodes.programs:driver",
            "proprio_excitation = proprio_ros.nodes.programs:excitation",
            "proprio_identifier = proprio_ros.nodes.programs:identifier",
            "proprio_virtual = proprio_ros.nodes.programs:virtual",
        ]
    },
    license="Apache-2.0",
)
