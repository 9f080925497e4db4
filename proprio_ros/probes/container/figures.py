"""Where the sphere was in its container, as SVG: one picture in the container's own frame, and one that moves as it moved.

Both are seen along the joint's axis. Shapes are in mm inside a group that is scaled to the picture, so the numbers in the page can
be read. The motion is SMIL, which browsers play by themselves: no script.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from proprio_ros.identification.estimate import Estimate
from proprio_ros.probes.container.detail import ContainerDetail, SpherePath
from proprio_ros.report.figures import ACCENT, INK, INSIDE, LINE, MUTED, themed
from proprio_ros.report.html import breakable, framed

EARLY, LATE = (0xF2, 0x8E, 0x2B), (0x7D, 0x4F, 0xC9)
"""Colours of the first and the last instant: also in grey print the early one is the paler."""
INSTANTS = 5  # spheres drawn in the picture, the first and the last among them
MOST_SAMPLES = 120
MOST_CLOCK_READINGS = 60
SLOWER = 5.0
PAUSE_S = 1.0  # at the end of the moving picture, before it starts again
# gravity whose part across the line of sight is less than this is not drawn as an arrow
ALONG_SIGHT = 0.05
MM = 1e3

DOWN = np.array([0.0, 0.0, -1.0])


def sections(estimate: Estimate) -> list[str]:
    """Where the sphere was in every run: a picture, and the same in motion."""
    parts: list[str] = []
    detail = estimate.detail
    paths = detail.paths if isinstance(detail, ContainerDetail) else ()
    for n, path in enumerate(paths, start=1):
        shown = drawable(path)
        if shown is None:
            continue
        moved = (
            f"moved by up to {1e3 * shown.moved:.1f} mm" if shown.moved >= 5e-5 else "did not move"
        )
        parts += [
            f"<h3>{breakable(path.run)}</h3>",
            framed(
                path_figure(shown, n),
                f"The sphere, of radius {1e3 * path.radius:g} mm, {moved}. Seen along the "
                "joint's axis: dashed at the start, bold at the end. Blue, about the path of its centre: two standard deviations, "
                "where that shows.",
                "small-one",
            ),
            "<details class=moving open><summary class=small>As it moved, five times slower</summary>",
            framed(
                moving_figure(shown, n),
                "The container turns as it turned in the world; where the hand carried it is left out. Fold it to stop watching.",
            ),
            "</details>",
        ]
    return ["<h2>Where the sphere was</h2>", *parts] if parts else []


def drawable(path: SpherePath) -> SpherePath | None:
    """The path without samples that are no numbers, and not more samples than a picture shows; None if nothing is left."""
    good = np.isfinite(path.position).all(axis=1) & np.isfinite(path.world_from_container).all(
        axis=(1, 2)
    )
    rows = np.flatnonzero(good)
    if not len(rows):
        return None
    rows = rows[_evenly(len(rows), MOST_SAMPLES)]
    by_time = ("times_s", "position", "std", "world_from_container")
    return replace(
        path,
        **{name: getattr(path, name)[rows] for name in by_time},
    )


@dataclass(frozen=True)
class _Sheet:
    """Where the container's plane lies in the picture: mm to px, and the space about it."""

    low: np.ndarray  # corner of what is drawn, to the right and up [mm], (2,)
    high: np.ndarray

    TOP: ClassVar = 10.0  # px above the drawing
    BESIDE: ClassVar = 52.0  # px for the marks to the left of it
    WIDEST: ClassVar = 400.0  # px
    HIGHEST: ClassVar = 300.0  # px

    @classmethod
    def about(cls, outline: np.ndarray) -> _Sheet:
        """With a margin about what is drawn, (N, 2) [mm]."""
        low = outline.min(axis=0)
        high = outline.max(axis=0)
        margin = 0.04 * (high - low).max()
        return cls(low - margin, high + margin)

    @property
    def scale(self) -> float:
        """Of the drawing [px/mm]."""
        extent = self.high - self.low
        return float(min(self.WIDEST / extent[0], self.HIGHEST / extent[1]))

    @property
    def size(self) -> np.ndarray:
        """Of the drawing [px], (2,)."""
        return self.scale * (self.high - self.low)

    @property
    def left(self) -> float:
        """Where the drawing begins [px]."""
        return float(self.BESIDE + (self.WIDEST - self.size[0]) / 2.0)

    @property
    def bottom(self) -> float:
        """Of the drawing [px]."""
        return float(self.TOP + self.size[1])

    @property
    def width(self) -> float:
        """Of the picture [px]."""
        return self.BESIDE + self.WIDEST + 120.0

    @property
    def height(self) -> float:
        """Of the picture [px]."""
        return max(self.bottom + 42.0, 250.0)

    @property
    def x0(self) -> float:
        """Where the container's middle is [px]."""
        return float(self.left - self.scale * self.low[0])

    @property
    def y0(self) -> float:
        return float(self.TOP + self.scale * self.high[1])


def path_figure(path: SpherePath, number: int) -> str:
    """The container's inside upright in its own frame, the sphere's path, and gravity at the start and the end."""
    plane = _plane(path.across)
    inside = MM * _outline(path, plane)  # (N, 2)
    centres = MM * path.position @ plane.T  # (K, 2)
    sheet = _Sheet.about(inside)
    colors = _colors(path.times_s)
    scale = sheet.scale
    marks, names = _axes(sheet, plane)
    shapes = [
        f'<polygon points="{_points(inside)}" fill="{INSIDE}" stroke="{INK}"/>',
        f'<g class="band" fill="{ACCENT}" stroke="none" opacity=".25">{_band(path, plane, scale)}</g>',
        *_line(centres, colors, 2.5 / scale),
        *_spheres(path, centres, colors, scale),
    ]
    aside = sheet.width - 58.0
    body = [
        f'<path d="{"".join(marks)}" stroke="{LINE}" fill="none"/>',
        f'<g transform="translate({_n(sheet.x0)} {_n(sheet.y0)}) scale({scale:.5g} {-scale:.5g})" fill="none" '
        f'stroke-width="{_n(1.2 / scale)}">{"".join(shapes)}</g>',
        *names,
        _text(aside, 20, "gravity", "middle"),
    ]
    for at, k, word in ((66.0, 0, "at the start"), (146.0, -1, "at the end")):
        gravity = plane @ path.world_from_container[k].T @ DOWN
        body += [
            _arrow((aside, at), gravity, 26.0, colors[k], word),
            _text(aside, at + 42, word, "middle"),
        ]
    body.append(_time_scale(path, number, aside, 206.0))
    name = f"Path {number} of the sphere in the container"
    return _svg(sheet.width, sheet.height, name, _in_words(path, centres), body)


def _in_words(path: SpherePath, centres: np.ndarray) -> str:
    """Where the sphere's centre (K, 2) [mm] went, for those who cannot see it."""
    (x_first, y_first), (x_last, y_last) = centres[[0, -1]]
    return (
        f"Seen along the joint's axis, the sphere's centre goes from ({x_first:.1f}, {y_first:.1f}) mm at {path.times_s[0]:.2f} s "
        f"to ({x_last:.1f}, {y_last:.1f}) mm at {path.times_s[-1]:.2f} s, at most {MM * path.moved:.1f} mm away from its start."
    )


def _axes(sheet: _Sheet, plane: np.ndarray) -> tuple[list[str], list[str]]:
    """Lines at round numbers, and what stands beside them."""
    marks = []
    names = []
    for tick in _ticks(sheet.low[0], sheet.high[0]):
        at = sheet.x0 + sheet.scale * tick
        marks.append(f"M{_n(at)} {_n(sheet.TOP)}V{_n(sheet.bottom)}")
        names.append(_text(at, sheet.bottom + 15, _signed(tick), "middle"))
    for tick in _ticks(sheet.low[1], sheet.high[1]):
        at = sheet.y0 - sheet.scale * tick
        marks.append(f"M{_n(sheet.left)} {_n(at)}H{_n(sheet.left + sheet.size[0])}")
        names.append(_text(sheet.left - 6, at + 4, _signed(tick), "end"))
    across = sheet.left + sheet.size[0] / 2
    upwards = sheet.TOP + sheet.size[1] / 2
    beside = sheet.left - 38
    names.append(
        _text(across, sheet.bottom + 34, f"{_direction(plane[0], 'right')} (mm)", "middle")
    )
    turned = f' transform="rotate(-90 {_n(beside)} {_n(upwards)})"'
    names.append(_text(beside, upwards, f"{_direction(plane[1], 'up')} (mm)", "middle", turned))
    return marks, names


def _line(centres: np.ndarray, colors: Sequence[str], width: float) -> list[str]:
    """The path of the sphere's centre (K, 2) [mm], each piece in the colour of its time."""
    return [
        f'<path d="M{_points(centres[k : k + 2])}" stroke="{colors[k]}" stroke-width="{_n(width)}"/>'
        for k in range(len(centres) - 1)
    ]


def _spheres(
    path: SpherePath, centres: np.ndarray, colors: Sequence[str], scale: float
) -> list[str]:
    """The sphere at some instants, dashed at the first and bold at the last."""
    shapes = []
    # the start on top: where nothing moved it would not be seen
    for k in _instants(path.times_s)[::-1]:
        drawn = f'cx="{_n(centres[k, 0])}" cy="{_n(centres[k, 1])}" r="{_n(MM * path.radius)}" stroke="{colors[k]}"'
        if k == 0:
            dashes = f"{_n(5 / scale)} {_n(4 / scale)}"
            drawn += f' class="start" stroke-dasharray="{dashes}" stroke-width="{_n(1.8 / scale)}"'
        elif k == len(centres) - 1:
            drawn += f' class="end" stroke-width="{_n(2.6 / scale)}"'
        shapes.append(f"<circle {drawn}/>")
    return shapes


@dataclass(frozen=True)
class _Clockwork:
    """How time runs in a moving picture: slower, with a pause at the end."""

    times_s: np.ndarray  # of the path, (K,)

    @property
    def duration_s(self) -> float:
        return float(SLOWER * (self.times_s[-1] - self.times_s[0]) + PAUSE_S)

    @property
    def keys(self) -> np.ndarray:
        """The instants as shares of the duration, (K,)."""
        return SLOWER * (self.times_s - self.times_s[0]) / self.duration_s

    def moving(self, attribute: str, values: Sequence[str], kind: str = "") -> str:
        """An attribute that takes one value after the other, and rests in the end.

        Args:
            attribute: Of the shape about it.
            values: K of them.
            kind: Of a transformation, such as ``rotate``.
        """
        every = ";".join([*values, values[-1]])
        when = ";".join([*(f"{key:.4f}" for key in self.keys), "1"])
        tag = "animateTransform" if kind else "animate"
        of_kind = f' type="{kind}"' if kind else ""
        return (
            f'<{tag} attributeName="{attribute}"{of_kind} values="{every}" keyTimes="{when}" '
            f'dur="{self.duration_s:.2f}s" repeatCount="indefinite"/>'
        )

    def readings(self, x: float, y: float) -> list[str]:
        """The time, as one text per reading that is shown in its turn."""
        keys = self.keys
        rows = _evenly(len(self.times_s), MOST_CLOCK_READINGS)
        parts = []
        for place, row in enumerate(rows):
            shown = ["visible"]
            when = ["0"]
            if place > 0:
                shown = ["hidden", "visible"]
                when = ["0", f"{keys[row]:.4f}"]
            if place + 1 < len(rows):
                shown.append("hidden")
                when.append(f"{keys[rows[place + 1]]:.4f}")
            parts.append(
                f'<text x="{_n(x)}" y="{_n(y)}" text-anchor="middle" font-size="17" visibility="{shown[0]}">'
                f'{self.times_s[row]:.2f} s<animate attributeName="visibility" calcMode="discrete" '
                f'values="{";".join(shown)}" keyTimes="{";".join(when)}" dur="{self.duration_s:.2f}s" '
                'repeatCount="indefinite"/></text>'
            )
        return parts


def moving_figure(path: SpherePath, number: int) -> str:
    """The container turning as it did, gravity down, and the sphere in it, slower and again and again."""
    plane = _plane(path.across)
    inside = MM * _outline(path, plane)
    centres = MM * path.position @ plane.T
    angles, fall = _turns(path, plane)
    side = 300.0
    aside = side + 34
    scale = 130.0 / np.linalg.norm(inside, axis=1).max()
    clockwork = _Clockwork(path.times_s)
    degrees = [_n(angle) for angle in np.degrees(angles)]
    x = [_n(value) for value in centres[:, 0]]
    y = [_n(value) for value in centres[:, 1]]
    sphere = (
        f'<circle cx="{x[0]}" cy="{y[0]}" r="{_n(MM * path.radius)}" fill="{ACCENT}" fill-opacity=".35" '
        f'stroke="{ACCENT}">{clockwork.moving("cx", x)}{clockwork.moving("cy", y)}</circle>'
    )
    turn = clockwork.moving("transform", degrees, "rotate")
    body = [
        f'<g transform="translate({_n(side / 2)} {_n(side / 2)}) scale({scale:.5g} {-scale:.5g})" fill="none" '
        f'stroke-width="{_n(1.6 / scale)}"><g transform="rotate({degrees[0]})">{turn}'
        f'<polygon points="{_points(inside)}" fill="{INSIDE}" stroke="{INK}"/>'
        f'<path d="M{_points(centres)}" stroke="{MUTED}"/>{sphere}</g></g>',
        _arrow((aside, 76), np.array([0.0, -fall]), 40.0, INK, "in the world"),
        _text(aside, 22, "gravity", "middle"),
        *clockwork.readings(aside, side - 40),
    ]
    return _svg(
        side + 80, side, f"Path {number}: the container and the sphere as they moved", "", body
    )


def _evenly(count: int, most: int) -> np.ndarray:
    """At most so many of ``count`` rows, the first and the last among them."""
    rows = np.linspace(0, count - 1, min(count, most)).round()
    return np.unique(rows.astype(int))


def _instants(times_s: np.ndarray) -> list[int]:
    """Rows of the spheres in the picture, equally far apart in time."""
    wanted = np.linspace(times_s[0], times_s[-1], INSTANTS)
    return sorted({int(np.abs(times_s - time).argmin()) for time in wanted})


def _plane(across: np.ndarray) -> np.ndarray:
    """To the right and up as one looks along ``across``, in the container's frame, shape (2, 3); up is near its z."""
    across = across / np.linalg.norm(across)
    nearest = np.array([0.0, 0.0, 1.0])
    if abs(across[2]) >= 0.9:
        nearest = np.array([0.0, 1.0, 0.0])
    up = nearest - across * (across @ nearest)
    up /= np.linalg.norm(up)
    return np.array([np.cross(across, up), up])


def _outline(path: SpherePath, plane: np.ndarray) -> np.ndarray:
    """The inside's silhouette [m], shape (N, 2): in every direction of the plane the farthest point of the shape."""
    size = path.inner_size
    # not along an axis of a box, where a whole side is equally far
    angle = np.radians(np.arange(1.0, 361.0, 2.0))
    along = np.stack([np.cos(angle), np.sin(angle)], axis=1) @ plane
    if path.shape == "box":
        farthest = np.sign(along.round(9)) * size / 2
    elif path.shape == "cylinder":
        round_part = np.linalg.norm(
            along[:, :2],
            axis=1,
            keepdims=True,
        )
        farthest = along / np.maximum(round_part, 1e-12) * size[0] / 2
        farthest[:, 2] = np.sign(along[:, 2].round(9)) * size[2] / 2
    else:
        farthest = along * size[0] / 2
    flat = farthest @ plane.T
    moved = flat - np.roll(flat, 1, axis=0)
    new = np.linalg.norm(moved, axis=1) > 1e-9
    return np.asarray(flat[new])


def _turns(
    path: SpherePath,
    plane: np.ndarray,
) -> tuple[np.ndarray, float]:
    """How far the container is turned in the world [rad], shape (K,), and how much of gravity one sees from there (0 to 1)."""
    first = path.world_from_container[0]
    along = first @ path.across / np.linalg.norm(path.across)
    up = -DOWN - along * (along @ -DOWN)
    fall = float(np.linalg.norm(up))
    up = up / fall if fall > ALONG_SIGHT else first @ plane[1]
    rightwards = path.world_from_container @ plane[0]
    angles = np.arctan2(rightwards @ up, rightwards @ np.cross(along, up))
    return np.unwrap(angles), fall


def _band(path: SpherePath, plane: np.ndarray, scale: float) -> str:
    """Ellipses of two standard deviations about the centre, where they are larger than a pixel."""
    parts = []
    for position, std in zip(path.position, path.std, strict=True):
        if not np.isfinite(std).all():
            continue
        covariance = plane @ np.diag((MM * std) ** 2) @ plane.T
        variance, axes = np.linalg.eigh(covariance)
        across, along = 2.0 * np.sqrt(np.maximum(variance, 0.0))
        if along * scale > 1.0:
            across = max(across, 0.5 / scale)  # an ellipse without width is not drawn
            x, y = MM * plane @ position
            turn = np.degrees(np.arctan2(axes[1, 1], axes[0, 1]))
            parts.append(
                f'<ellipse rx="{_n(along)}" ry="{_n(across)}" transform="translate({_n(x)} {_n(y)}) rotate({_n(turn)})"/>'
            )
    return "".join(parts)


def _direction(axis: np.ndarray, otherwise: str) -> str:
    """``x`` or ``-x`` where it is an axis of the container."""
    largest = int(np.abs(axis).argmax())
    if abs(axis[largest]) < 0.999:
        return otherwise
    return ("-" if axis[largest] < 0.0 else "") + "xyz"[largest]


def _ticks(low: float, high: float) -> np.ndarray:
    """Round numbers [mm] between the two, six or so."""
    powers = 10.0 ** np.arange(-2, 4)
    steps = np.outer(powers, [1.0, 2.0, 5.0]).ravel()
    step = steps[np.searchsorted(steps, (high - low) / 7.0)]
    first = np.ceil(low / step)
    last = np.floor(high / step)
    return np.asarray(step * np.arange(first, last + 1))


def _colors(times_s: np.ndarray) -> list[str]:
    share = (times_s - times_s[0]) / max(times_s[-1] - times_s[0], 1e-9)
    mixed = np.outer(1.0 - share, EARLY) + np.outer(share, LATE)
    return ["#" + "".join(f"{int(part):02x}" for part in color.round()) for color in mixed]


def _time_scale(path: SpherePath, number: int, x: float, y: float) -> str:
    first, last = _colors(path.times_s[[0, -1]])
    name = f"sphere-time-{number}"
    return (
        f'<linearGradient id="{name}"><stop stop-color="{first}"/><stop offset="1" stop-color="{last}"/></linearGradient>'
        f'<rect x="{_n(x - 45)}" y="{_n(y)}" width="90" height="8" fill="url(#{name})"/>'
        + _text(x - 45, y + 22, f"{path.times_s[0]:.2f}", "start")
        + _text(x + 45, y + 22, f"{path.times_s[-1]:.2f} s", "end")
    )


def _arrow(
    middle: tuple[float, float],
    vector: np.ndarray,
    length: float,
    color: str,
    name: str,
) -> str:
    """An arrow about ``middle`` (px); a dot in a ring where the vector points along the line of sight."""
    seen = float(np.linalg.norm(vector))
    x, y = middle
    if seen < ALONG_SIGHT:
        return (
            f'<g class="gravity"><title>gravity {name}: along the line of sight</title>'
            f'<circle cx="{_n(x)}" cy="{_n(y)}" r="7" fill="none" stroke="{color}" stroke-width="2"/>'
            f'<circle cx="{_n(x)}" cy="{_n(y)}" r="2" fill="{color}"/></g>'
        )
    ahead = np.array([vector[0], -vector[1]])  # the picture counts downwards
    half = length * ahead
    tip_length = 10.0 * ahead / seen
    sideways = 0.5 * np.array([-tip_length[1], tip_length[0]])
    tip = np.array(middle) + half
    shaft = np.array([np.array(middle) - half, tip - 0.6 * tip_length])
    head = np.array([tip, tip - tip_length + sideways, tip - tip_length - sideways])
    return (
        f'<g class="gravity"><title>gravity {name}</title>'
        f'<path d="M{_points(shaft)}" stroke="{color}" stroke-width="2.5"/>'
        f'<polygon points="{_points(head)}" fill="{color}"/></g>'
    )


def _text(
    x: float,
    y: float,
    words: str,
    anchor: str,
    extra: str = "",
) -> str:
    return f'<text x="{_n(x)}" y="{_n(y)}" text-anchor="{anchor}"{extra}>{words}</text>'


def _signed(tick: float) -> str:
    return f"{tick:g}".replace("-", "\N{MINUS SIGN}")


def _points(points: np.ndarray) -> str:
    return " ".join(f"{_n(x)},{_n(y)}" for x, y in points)


def _n(value: float) -> str:
    """Hundredths: of a millimetre or of a pixel; never a negative zero."""
    return f"{round(float(value), 2) + 0.0:.6g}"


def _svg(
    width: float,
    height: float,
    name: str,
    description: str,
    body: Sequence[str],
) -> str:
    described = f"<desc>{description}</desc>" if description else ""
    return themed(
        f'<svg class="sphere" xmlns="http://www.w3.org/2000/svg" role="img" aria-label="{name}" '
        f'viewBox="0 0 {_n(width)} {_n(height)}" font-size="13" fill="{INK}">{described}{"".join(body)}</svg>'
    )
