"""The moving picture of the README: a catheter with twice the friction of its model follows a ring of targets.

Run: python docs/figures/moving_picture.py docs/figures/ring.svg

The file needs no script. Where animations do not play, or the reader asks for less motion, it shows the whole run as a
still figure. Bends, commands and errors come from `hystmpc.simulate`; the roll is taken to be ideal.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

import hystmpc

Vec = npt.NDArray[np.float64]

AXIS_DEG, RADIUS_DEG, TARGETS = 58.0, 18.0, 8
EVERY = 2  # samples of the run in a frame of the picture
STUDY = {
    "plant": {
        "simulator": "builtin:tendon-catheter",
        "lag_s": 0.08,
        "noise_deg": 0.15,
        "mismatch": {"prandtl_ishlinskii.alpha": 2.0},  # the plays are twice as wide as when the model was identified
    },
    "model": "builtin:auto",
    "controllers": {
        "inverse": {"kind": "inverse"},
        "pid": {  # gains found by `tune_pid: {evaluations: 300}` on the changed device and this very motion
            "kind": "pid",
            "gains": {"kp_per_deg": 0.393, "ki_per_deg_s": 3.353, "kd_s_per_deg": 0.002795, "dead_zone_deg": 0.3104},
        },
        "inverse_pid": {
            "kind": "inverse_pid",
            "gains": {"kp_per_deg": 0.2555, "ki_per_deg_s": 3.235, "kd_s_per_deg": 9.425e-05, "dead_zone_deg": 0.2002},
        },
        "linearised_mpc": {"kind": "linearised_mpc"},
    },
    "seed": 1,
}


@dataclass(frozen=True, eq=False)
class Track:
    """What one controller did on the ring.

    Attributes:
        angle_deg: true bends (N,).
        command: commands sent (N,) [mm].
        rmse_deg: root mean square error of the true bend.
        travel: sum of all command changes [mm].
    """

    angle_deg: Vec
    command: Vec
    rmse_deg: float
    travel: float


@dataclass(frozen=True, eq=False)
class Ring:
    """Runs of several controllers around one ring of targets.

    Attributes:
        time_s: time from the first target on (N,).
        reference_deg: wanted bends (N,).
        roll_deg: rolls of the bending plane (N,).
        targets_deg: roll and bend of each target, the first one again at the end (K + 1, 2).
        tracks: by the name of the controller.
    """

    time_s: Vec
    reference_deg: Vec
    roll_deg: Vec
    targets_deg: Vec
    tracks: Mapping[str, Track]


def place(psi: float) -> tuple[float, float]:
    """Roll and bend at the angle psi of the ring [deg]."""
    axis, radius = math.radians(AXIS_DEG), math.radians(RADIUS_DEG)
    off = math.sin(radius) * math.cos(psi)
    bend = math.acos(math.cos(axis) * math.cos(radius) - math.sin(axis) * off)
    roll = math.atan2(math.sin(radius) * math.sin(psi), math.sin(axis) * math.cos(radius) + math.cos(axis) * off)
    return math.degrees(roll), math.degrees(bend)


def simulate_ring() -> Ring:
    """Each controller once around the ring, from target to target with a hold of 1 s at each."""
    targets = np.array([place(2.0 * math.pi * k / TARGETS) for k in range(TARGETS + 1)])
    motion = {
        "kind": "point_to_point",
        "start_deg": float(targets[0, 1]),
        "targets_deg": targets[1:, 1].tolist(),
        "holds_s": [1.0] * TARGETS,
        "limits": {"velocity_deg_s": 30, "acceleration_deg_s2": 200, "jerk_deg_s3": 3000},
    }
    results = hystmpc.simulate({**STUDY, "motions": {"ring": motion}}).results
    first, log = results[0].run.first, results[0].run.log
    reference = log.reference_deg[first:]
    # The roll goes on as the bend does: both have come equally far from one target to the next.
    way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(reference)))])
    reached = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(targets[:, 1])))])
    psi = np.interp(way, reached, 2.0 * np.pi * np.arange(TARGETS + 1) / TARGETS)
    tracks = {
        r.controller: Track(
            r.run.true_deg[first:], r.run.log.command[first:], r.metrics.rmse_deg, r.metrics.command_travel
        )
        for r in results
    }
    roll = np.array([place(angle)[0] for angle in psi])
    return Ring(log.time_s[first:] - log.time_s[first], reference, roll, targets, tracks)


# ---- from bend and roll to the paper ----

LENGTH, BASE_X, BASE_Y = 540.0, 52.0, 330.0  # of the bending segment, px; its proximal end
AZIMUTH, ELEVATION = math.radians(48.0), math.radians(14.0)


def to_screen(points: Vec) -> Vec:
    """Points (..., 3) in lengths of the segment, x up and z along the shaft, as px (..., 2) of an oblique view."""
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    depth = -z * math.sin(AZIMUTH) + y * math.cos(AZIMUTH)
    across = z * math.cos(AZIMUTH) + y * math.sin(AZIMUTH)
    up = x * math.cos(ELEVATION) + depth * math.sin(ELEVATION)
    return np.stack([BASE_X + LENGTH * across, BASE_Y - LENGTH * up], axis=-1)


def arc(bend_deg: float, roll_deg: float) -> Vec:
    """A segment of constant curvature as the four points of a cubic (4, 3), in lengths of the segment.

    The tip is at ((1 - cos b) / b, sin b / b) of the bending plane, b in rad.
    """
    bend, roll = math.radians(bend_deg), math.radians(roll_deg)
    handle = 4.0 / 3.0 * math.tan(bend / 4.0) / bend
    radial = np.array([0.0, 0.0, (1.0 - math.cos(bend)) / bend, (1.0 - math.cos(bend)) / bend])
    along = np.array([0.0, handle, math.sin(bend) / bend, math.sin(bend) / bend])
    radial[2] -= handle * math.sin(bend)
    along[2] -= handle * math.cos(bend)
    return np.stack([radial * math.cos(roll), radial * math.sin(roll), along], axis=-1)


def catheter(bend_deg: float, roll_deg: float) -> str:
    """The path of the segment."""
    start, *rest = to_screen(arc(bend_deg, roll_deg))
    return f"M{pair(start)}C{' '.join(pair(point) for point in rest)}"


def tip(bend_deg: float, roll_deg: float) -> Vec:
    """The tip [px]."""
    point: Vec = to_screen(arc(bend_deg, roll_deg))[3]
    return point


# ---- pieces of SVG ----


def pair(point: Iterable[float]) -> str:
    return ",".join(f"{value:.1f}" for value in point)


def line(points: Iterable[Iterable[float]]) -> str:
    return "M" + "L".join(pair(point) for point in points)


def element(name: str, attributes: Mapping[str, object], inside: str = "") -> str:
    """One element; `_` of an attribute stands for `-`, a trailing one for nothing."""
    text = "".join(f' {key.rstrip("_").replace("_", "-")}="{value}"' for key, value in attributes.items())
    return f"<{name}{text}>{inside}</{name}>" if inside else f"<{name}{text}/>"


def text(x: float, y: float, words: str, class_: str = "text", anchor: str = "start") -> str:
    return element("text", {"x": x, "y": y, "class_": class_, "text_anchor": anchor}, words)


@dataclass(frozen=True)
class Scene:
    """Draws elements whose values go through frames, or their last values alone."""

    seconds: float
    moves: bool

    def animate(self, attribute: str, values: Sequence[str], **how: str) -> str:
        """The animation of one attribute; nothing in a still figure."""
        if not self.moves:
            return ""
        clock = {"dur": f"{self.seconds:.2f}s", "repeatCount": "indefinite"}
        return element("animate", {"attributeName": attribute, "values": ";".join(values), **clock, **how})


# ---- the picture ----

WIDTH, HEIGHT = 960, 470
SHOWN = {  # class, words of the legend
    "inverse": ("model", "inverse of the model alone"),
    "pid": ("command", "PID, tuned on this device"),
    "inverse_pid": ("other", "inverse and PID, tuned on it"),
    "linearised_mpc": ("measured", "predictive controller"),
}
COLOURS = {  # on a light page, on a dark page; Okabe and Ito, "Color Universal Design", 2008
    "paper": ("#ffffff", "#14181d"),
    "text": ("#222222", "#ececec"),
    "quiet": ("#6a6a6a", "#a3a9b0"),
    "grid": ("#e4e4e4", "#2d333b"),
    "reference": ("#8c8c8c", "#8b949e"),
    "measured": ("#0072b2", "#56b4e9"),
    "model": ("#d55e00", "#ff8a3d"),
    "command": ("#009e73", "#2fc69b"),
}


def style() -> str:
    """Colours for light and dark pages, and the still figure for readers who ask for less motion."""

    def colours(page: int) -> str:
        colour = {name: both[page] for name, both in COLOURS.items()}
        rules = [f".paper{{fill:{colour['paper']};stroke:{colour['grid']}}}.cover{{fill:{colour['paper']}}}"]
        rules.append(f".text,.head{{fill:{colour['text']}}}.quiet{{fill:{colour['quiet']}}}")
        lines = ("grid", "reference", "measured", "model", "command")
        rules += [f".{name}{{fill:none;stroke:{colour[name]}}}.dot-{name}{{fill:{colour[name]}}}" for name in lines]
        return "".join(rules)

    less_motion = ".still{display:inline}.moving{display:none}"
    return element(
        "style",
        {},
        f"text{{font:13px system-ui,sans-serif}}.head{{font:600 15px system-ui,sans-serif}}{colours(0)}"
        f"@media (prefers-color-scheme:dark){{{colours(1)}}}"
        f".still{{display:none}}@media (prefers-reduced-motion:reduce){{{less_motion}}}",
    )


@dataclass(frozen=True)
class Panel:
    """Axes of the right half: from time and value to px."""

    top: float
    bottom: float
    low: float
    high: float
    seconds: float
    left: float = 480.0
    right: float = 936.0

    def place(self, time_s: Vec, values: Vec) -> Vec:
        x = self.left + (self.right - self.left) * time_s / self.seconds
        return np.stack(
            [x, self.bottom - (self.bottom - self.top) * (values - self.low) / (self.high - self.low)], axis=-1
        )

    def axes(self, title: str, ticks: Iterable[int]) -> str:
        """Grid, numbers and title."""
        parts = [text(self.left, self.top - 10, title)]
        for tick in ticks:
            (point,) = self.place(np.zeros(1), np.array([float(tick)]))
            parts.append(element("path", {"d": line([point, (self.right, point[1])]), "class_": "grid"}))
            parts.append(text(self.left - 8, round(point[1] + 4, 1), str(tick), "quiet", "end"))
        return "".join(parts)


def curve(panel: Panel, time_s: Vec, values: Vec, class_: str, width: float) -> str:
    points = panel.place(time_s, values)
    return element("path", {"d": line(points), "class_": class_, "stroke_width": width, "stroke_linejoin": "round"})


def right_half(ring: Ring, scene: Scene) -> str:
    """Bend and command over time; a cover moves off the curves as time passes."""
    angle = Panel(66, 212, 36, 80, scene.seconds)
    command = Panel(258, 416, 0, 6, scene.seconds)
    drawn = [
        angle.axes("tip angle [deg], wide grey line: wanted", (40, 50, 60, 70, 80)),
        command.axes("tendon command [mm]", (0, 2, 4, 6)),
    ]
    drawn.append(curve(angle, ring.time_s, ring.reference_deg, "reference", 5.0))
    shown = [(angle, name, ring.tracks[name].angle_deg, 1.7) for name in ("inverse", "linearised_mpc")]
    shown += [
        (command, name, ring.tracks[name].command, width) for name, width in (("pid", 1.2), ("linearised_mpc", 1.6))
    ]
    drawn += [curve(panel, ring.time_s, values, SHOWN[name][0], width) for panel, name, values, width in shown]
    seconds = np.arange(0.0, scene.seconds, 2.0)
    marks = zip(seconds, angle.place(seconds, seconds)[:, 0], strict=True)
    drawn += [text(round(x, 1), 436, f"{second:.0f}", "quiet", "middle") for second, x in marks]
    drawn.append(text(angle.right, 456, "time [s]", "quiet", "end"))
    if not scene.moves:
        return "".join(drawn)
    left, right = str(angle.left), str(angle.right)
    cover = scene.animate("x", [left, right]) + scene.animate("width", [str(angle.right - angle.left), "0"])
    for panel in (angle, command):
        box = {"x": right, "y": panel.top - 4, "width": 0, "height": panel.bottom - panel.top + 8}
        drawn.append(element("rect", {**box, "class_": "cover", "fill_opacity": 0.88}, cover))
    return "".join(drawn)


def targets(ring: Ring, scene: Scene) -> str:
    """The targets; each is filled once the hold at it has ended, the present one has a wider circle around it."""
    centres = [tip(bend, roll) for roll, bend in ring.targets_deg]
    resting = np.flatnonzero(np.abs(np.diff(ring.reference_deg)) < 1e-9)
    ends = [int(run[-1]) for run in np.split(resting, np.flatnonzero(np.diff(resting) > 1) + 1)][-TARGETS:]
    times = [float(ring.time_s[end] / scene.seconds) for end in ends]
    parts = []
    for (x, y), left in zip(centres[1:], times, strict=True):
        shape = {"cx": f"{x:.1f}", "cy": f"{y:.1f}", "r": 6, "class_": "reference", "stroke_width": 1.6}
        parts.append(element("circle", shape))
        keys = {"keyTimes": f"0;{min(left, 0.999):.4f}", "calcMode": "discrete"}
        filled = {"cx": f"{x:.1f}", "cy": f"{y:.1f}", "r": 3, "class_": "dot-measured"}
        parts.append(element("circle", filled, scene.animate("r", ["0", "3"], **keys)))
    keys = {"keyTimes": ";".join(f"{start:.4f}" for start in [0.0, *times[:-1]]), "calcMode": "discrete"}
    moves = [scene.animate(axis, [f"{c[k]:.1f}" for c in centres[1:]], **keys) for k, axis in enumerate(("cx", "cy"))]
    x, y = centres[-1]
    ringed = {"cx": f"{x:.1f}", "cy": f"{y:.1f}", "r": 11, "class_": "reference", "stroke_dasharray": "3 3"}
    parts.append(element("circle", ringed, "".join(moves)))
    return "".join(parts)


def left_half(ring: Ring, scene: Scene) -> str:
    """The catheter under the predictive controller, the same under the inverse alone, and the ways of both tips."""
    shaft = to_screen(np.array([[0.0, 0.0, -0.09], [0.0, 0.0, 0.0]]))
    parts = []
    for name, width in (("inverse", 5.0), ("linearised_mpc", 8.0)):
        class_, bends = SHOWN[name][0], ring.tracks[name].angle_deg[::EVERY]
        frames = list(zip(bends.tolist(), ring.roll_deg[::EVERY].tolist(), strict=True))
        tips = np.array([tip(*frame) for frame in frames])
        steps = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(tips, axis=0).T))])
        left = [f"{steps[-1] - step:.1f}" for step in steps]
        way = {"d": line(tips), "class_": class_, "stroke_width": 1.4, "stroke_dasharray": f"{steps[-1]:.1f}"}
        parts.append(element("path", way, scene.animate("stroke-dashoffset", left)))
        shapes = [catheter(*frame) for frame in frames]
        body = {"d": shapes[-1], "class_": class_, "stroke_width": width, "stroke_linecap": "round"}
        parts.append(element("path", {**body, "stroke_opacity": 0.75}, scene.animate("d", shapes)))
    thick = {"class_": "reference", "stroke_width": 13, "stroke_linecap": "round"}
    return element("path", {"d": line(shaft), **thick}) + "".join(parts) + targets(ring, scene)


def legend(ring: Ring) -> str:
    """Error and travel of every controller."""
    parts = [text(312, 372, "RMSE", "quiet", "end"), text(420, 372, "tendon travel", "quiet", "end")]
    for row, (name, (class_, words)) in enumerate(SHOWN.items()):
        y, track = 392 + 20 * row, ring.tracks[name]
        if class_ in COLOURS:
            parts.append(element("circle", {"cx": 32, "cy": y - 4.5, "r": 5, "class_": f"dot-{class_}"}))
        parts.append(text(46, y, words))
        parts.append(text(312, y, f"{track.rmse_deg:.2f} deg", "text", "end"))
        parts.append(text(420, y, f"{track.travel:.0f} mm", "text", "end"))
    return "".join(parts)


def svg(ring: Ring) -> str:
    """The whole picture, in motion and still; a style chooses between them."""
    seconds = float(ring.time_s[-1])
    groups = "".join(
        element("g", {"class_": name}, left_half(ring, scene) + right_half(ring, scene))
        for name, scene in (("moving", Scene(seconds, True)), ("still", Scene(seconds, False)))
    )
    name = "A catheter tip follows a ring of eight targets; its friction is twice what the model knows (simulated)"
    paper = element("rect", {"x": 0.5, "y": 0.5, "width": WIDTH - 1, "height": HEIGHT - 1, "rx": 4, "class_": "paper"})
    head = element("title", {}, name) + style() + paper + text(22, 30, name, "head")
    attributes = {"xmlns": "http://www.w3.org/2000/svg", "viewBox": f"0 0 {WIDTH} {HEIGHT}", "role": "img"}
    return element("svg", attributes, head + groups + legend(ring)) + "\n"


def main() -> None:
    """Simulate, draw, and print the numbers of the legend."""
    ring = simulate_ring()
    Path(sys.argv[1]).write_text(svg(ring), encoding="utf-8")
    for name, track in ring.tracks.items():
        print(f"{name}: RMSE {track.rmse_deg:.3f} deg, tendon travel {track.travel:.1f} mm")


if __name__ == "__main__":
    main()
