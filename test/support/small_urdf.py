"""Small robots as URDF text, a part of it at a time."""

from __future__ import annotations

INERTIA = '<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/>'
INERTIAL = f'<inertial><mass value="1"/>{INERTIA}</inertial>'
LIMIT = '<limit lower="-1" upper="1" effort="1" velocity="1"/>'


def link(name: str, inertial: str = INERTIAL) -> str:
    return f'<link name="{name}">{inertial}</link>'


def joint(
    name: str,
    parent: str = "base",
    child: str = "one",
    kind: str = "revolute",
    axis: str = "0 0 1",
    limit: str = LIMIT,
    mimic: str = "",
) -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/><axis xyz="{axis}"/>'
        f"{limit}{mimic}</joint>"
    )


def chain(*joints: str, links: str | None = None) -> str:
    links = links or "".join(
        link(name) for name in ("base", "one", "two", "three")[: len(joints) + 1]
    )
    return f'<robot name="arm">{links}{"".join(joints)}</robot>'


def inertial(mass: str = "1", **moments: str) -> str:
    values = {
        "ixx": "0.01",
        "ixy": "0",
        "ixz": "0",
        "iyy": "0.01",
        "iyz": "0",
        "izz": "0.01",
    } | moments
    text = " ".join(f'{key}="{value}"' for key, value in values.items())
    return chain(
        joint("a"),
        links=link("base")
        + link("one", f'<inertial><mass value="{mass}"/><inertia {text}/></inertial>'),
    )


THREE = chain(
    joint("a"),
    joint("b", "one", "two"),
    joint("c", "two", "three", kind="fixed"),
)
