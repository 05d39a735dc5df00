"""The moving picture of two bending planes: a tip writes a star under a PID, the inverse model and the predictive one.

Run: python docs/figures/star_picture.py docs/figures/star.svg

The runs are those of the gallery's page `examples/gallery/plot_17_two_planes.py`. The file needs no script. Where
animations do not play, or the reader asks for less motion, it shows the whole run as a still figure.
"""

from __future__ import annotations

import runpy
import sys
from collections.abc import Mapping
from pathlib import Path

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from moving_picture import Scene, element, line, style, text

Vec = npt.NDArray[np.float64]

PAGE = Path(__file__).resolve().parents[2] / "examples" / "gallery" / "plot_17_two_planes.py"
WIDTH, HEIGHT, SIDE = 960, 392, 300
EVERY = 2  # samples of the run in a frame of the picture
SHOWN = {"PID": ("command", "PID"), "inverse": ("model", "inverse model"), "MPC": ("measured", "predictive controller")}
NAME = "A tip writes a star in two bending planes; tendons are not aligned, friction is shared (simulated)"


def panel(number: int, wanted: Vec, tip: Vec, scene: Scene, class_: str) -> str:
    """The star and the way of a tip, (T, 2) [deg]."""
    low, high = wanted.min(axis=0), wanted.max(axis=0)
    scale = (SIDE - 44) / float((high - low).max())
    corner = np.array([20 + (SIDE + 10) * number + SIDE / 2, 58 + SIDE / 2])

    def placed(angles: Vec) -> Vec:
        return np.asarray(corner + scale * (angles - 0.5 * (low + high)) * [1.0, -1.0])

    way = placed(tip[::EVERY])
    steps = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(way, axis=0).T))])
    left = [f"{steps[-1] - step:.1f}" for step in steps]
    drawn = {"d": line(way), "class_": class_, "stroke_width": 2.0, "stroke_dasharray": f"{steps[-1]:.1f}"}
    star = {"d": line(placed(wanted[::EVERY])), "class_": "reference", "stroke_width": 5.0, "stroke_opacity": 0.4}
    moves = [scene.animate(axis, [f"{x:.1f}" for x in way[:, k]]) for k, axis in enumerate(("cx", "cy"))]
    dot = {"cx": f"{way[-1, 0]:.1f}", "cy": f"{way[-1, 1]:.1f}", "r": 5, "class_": f"dot-{class_}"}
    return (
        element("path", star)
        + element("path", drawn, scene.animate("stroke-dashoffset", left))
        + element("circle", dot, "".join(moves))
    )


def svg(wanted: Vec, tips: Mapping[str, Vec], errors: Mapping[str, float], dt_s: float) -> str:
    """The whole picture, in motion and still; a style chooses between them."""
    groups = ""
    for name, moves in (("moving", True), ("still", False)):
        scene = Scene(dt_s * len(wanted), moves)
        panels = [panel(k, wanted, tips[kind], scene, class_) for k, (kind, (class_, _)) in enumerate(SHOWN.items())]
        groups += element("g", {"class_": name}, "".join(panels))
    titles = "".join(
        text(20 + (SIDE + 10) * k + SIDE / 2, 62, f"{words}: {errors[kind]:.2f} deg", "text", "middle")
        for k, (kind, (_, words)) in enumerate(SHOWN.items())
    )
    paper = element("rect", {"x": 0.5, "y": 0.5, "width": WIDTH - 1, "height": HEIGHT - 1, "rx": 4, "class_": "paper"})
    head = element("title", {}, NAME) + style() + paper + text(22, 30, NAME, "head")
    attributes = {"xmlns": "http://www.w3.org/2000/svg", "viewBox": f"0 0 {WIDTH} {HEIGHT}", "role": "img"}
    return element("svg", attributes, head + titles + groups) + "\n"


def main() -> None:
    """Run the page, draw, and print the numbers of the legend."""
    mpl.use("Agg")
    page = runpy.run_path(str(PAGE))
    Path(sys.argv[1]).write_text(svg(page["wanted"], page["tips"], page["errors"], page["dt"]), encoding="utf-8")
    for name, error in page["errors"].items():
        print(f"{name}: RMSE {error:.3f} deg")


if __name__ == "__main__":
    main()
