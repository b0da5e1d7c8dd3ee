"""The canvas: VTK through pyvista, off screen. The only place that imports either, when first used."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np

from plait.pipeline.errors import PlaitError
from plait.pipeline.pictures.colours import to_bytes
from plait.pipeline.pictures.curves import shade
from plait.pipeline.pictures.drawables import Dots, Drawable, Lines, Shell
from plait.pipeline.pictures.framing import View

FINER = 2  # drawn this much larger and averaged down: smooth edges, hair finer than a pixel
CREASE = 50.0  # degrees between faces at which a surface is no longer shaded as smooth
KEY, FILL, RIM = (-0.55, 0.75, 0.75), (0.85, 0.15, 0.55), (0.35, 0.65, -0.85)  # towards the lights, view axes
LIGHTS = ((KEY, 0.78, (1.0, 0.98, 0.95)), (FILL, 0.42, (0.88, 0.93, 1.0)), (RIM, 0.32, (1.0, 1.0, 1.0)))
MATTER = {"ambient": 0.24, "diffuse": 0.9, "specular": 0.08, "specular_power": 25.0}
SOLID = 3.0  # pixels from which a curve is drawn as a tube rather than a line
BOTTOM, TOP = (0.80, 0.82, 0.85), (0.965, 0.97, 0.98)  # of the background
# Without OpenGL VTK ends the process it runs in, so that it is asked in another one.
_ASK = """
import vtkmodules.vtkRenderingOpenGL2
from vtkmodules.vtkCommonCore import vtkVersion
from vtkmodules.vtkRenderingCore import vtkRenderWindow
window = vtkRenderWindow()
window.SetOffScreenRendering(True)
window.SetShowWindow(False)
window.SetSize(8, 8)
window.Render()
said = dict(line.split(":", 1) for line in window.ReportCapabilities().splitlines() if ":" in line)
name = said["OpenGL renderer string"].strip()
print(f"VTK {vtkVersion.GetVTKVersion()}, {window.GetClassName()}, {name}")
"""


@cache
def probe() -> str:
    """What draws here, in one line. Raises PlaitError when nothing does."""
    try:
        asked = subprocess.run(
            [sys.executable, "-c", _ASK], capture_output=True, text=True, timeout=120, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise PlaitError(f"pictures cannot be drawn here: {error}") from error
    answer = asked.stdout.strip().splitlines()
    if asked.returncode == 0 and answer:
        return answer[-1]
    said = [line for line in asked.stderr.splitlines() if "Error:" in line]
    reason = said[-1].strip() if said else "no OpenGL: neither a display nor EGL with a driver"
    raise PlaitError(f"pictures cannot be drawn here: {reason} (Debian: apt-get install libegl1 libgl1-mesa-dri)")


class Canvas:
    """One window, off screen, on which drawables are shown at one time code after another."""

    def __init__(self, size: tuple[int, int], drawables: Sequence[Drawable]) -> None:
        probe()
        import pyvista
        from vtkmodules.vtkCommonCore import vtkLogger

        vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
        self._size = size
        self._plotter = pyvista.Plotter(
            off_screen=True, window_size=[FINER * side for side in size], lighting="none"
        )
        self._plotter.set_background(BOTTOM, top=TOP)
        for place, intensity, colour in LIGHTS:
            light = pyvista.Light(light_type="camera light", intensity=intensity, color=colour)
            light.position, light.focal_point = place, (0.0, 0.0, 0.0)
            self._plotter.add_light(light)
        self._shown = [_Shown(self._plotter, drawable) for drawable in drawables]

    def draw(self, code: float, view: View) -> np.ndarray:
        """(height, width, 3) uint8."""
        from PIL import Image

        camera = self._plotter.camera
        camera.position, camera.focal_point, camera.up = view.position, view.target, view.up
        camera.parallel_projection = view.height is not None
        if view.height is not None:
            camera.parallel_scale = 0.5 * view.height
        camera.view_angle = view.angle
        for shown in self._shown:
            shown.update(code, view, FINER * self._size[1])
        if view.clip is not None:
            camera.clipping_range = view.clip
        else:
            self._plotter.renderer.ResetCameraClippingRange()
        self._plotter.render()
        large = self._plotter.screenshot(return_img=True)
        return np.asarray(Image.fromarray(large).resize(self._size, Image.Resampling.BOX))

    def close(self) -> None:
        self._plotter.close()


class _Shown:
    """A drawable's actor, made when it is first visible."""

    def __init__(self, plotter: Any, drawable: Drawable) -> None:
        self._plotter, self._drawable = plotter, drawable
        self._actor: Any = None
        self._mesh: Any = None

    def update(self, code: float, view: View, pixels_high: int) -> None:
        """Shows it as it is at `code`."""
        visible = self._drawable.visible(code)
        points = self._drawable.points(code) if visible else np.zeros((0, 3))
        if self._actor is not None:
            self._actor.SetVisibility(bool(len(points)))
        if not len(points):
            return
        if isinstance(self._drawable, Shell):
            self._update_shell(self._drawable, points, code)
        else:
            self._update_fibres(self._drawable, points, code, view, pixels_high)

    def _update_shell(self, shell: Shell, points: np.ndarray, code: float) -> None:
        if self._actor is None:
            self._surface = _Surface(shell, points, code)
            self._mesh, self._actor = self._surface.add_to(self._plotter)
        elif shell.animated:
            self._mesh.points[:], self._mesh.point_data["Normals"][:] = self._surface.placed(points)
            self._mesh.Modified()

    def _update_fibres(
        self, fibres: Lines | Dots, points: np.ndarray, code: float, view: View, pixels_high: int
    ) -> None:
        width = fibres.width(code)
        pixels = width / view.pixel_size(points, pixels_high)
        colour = fibres.point_colours(code)
        solid = isinstance(fibres, Lines) and pixels >= SOLID * FINER
        if isinstance(fibres, Lines) and not solid:
            to_light = np.asarray(KEY) / np.linalg.norm(KEY) @ view.axes
            colour = shade(points, fibres.counts, colour, to_light, view.axes[2])
        mesh = _fibres(fibres, points, colour)
        if solid:
            mesh = mesh.tube(radius=0.5 * width, n_sides=12, capping=True)
        if self._actor is None:
            self._mesh = mesh
            self._actor = self._plotter.add_mesh(
                mesh,
                scalars="rgb",
                rgb=True,
                lighting=solid or isinstance(fibres, Dots),
                render_points_as_spheres=True,
                render=False,
                reset_camera=False,
                **MATTER,
            )
            self._actor.prop.interpolation = "Phong"
        else:
            self._mesh.copy_from(mesh)
        thinnest = 1.5 if isinstance(fibres, Lines) else 2.0 * FINER
        self._actor.prop.line_width = self._actor.prop.point_size = max(pixels, thinnest)


def _fibres(fibres: Lines | Dots, points: np.ndarray, colour: np.ndarray) -> Any:
    """Lines or dots as VTK's cells, with their colours."""
    import pyvista

    mesh = pyvista.PolyData(points.astype(np.float32))
    if isinstance(fibres, Lines):
        mesh.verts = np.zeros(0, np.int64)
        mesh.lines = _polylines(fibres.counts)
    mesh.point_data["rgb"] = to_bytes(colour)
    return mesh


def _polylines(counts: np.ndarray) -> np.ndarray:
    """VTK's cells: each line's count, then its points."""
    first = np.cumsum(counts + 1) - (counts + 1)
    cells = np.arange(counts.sum() + len(counts)) - np.repeat(np.arange(len(counts)) + 1, counts + 1)
    cells[first] = counts
    return cells


def _parted(points: np.ndarray, triangles: np.ndarray, crease: float) -> tuple[np.ndarray, np.ndarray]:
    """Triangles (m, 3) into points that are parted where faces meet at more than `crease` degrees, and which of
    `points` each of those is, (k,)."""
    normal = np.cross(
        points[triangles[:, 1]] - points[triangles[:, 0]], points[triangles[:, 2]] - points[triangles[:, 0]]
    )
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    starts, ends = triangles.ravel(), triangles[:, [1, 2, 0]].ravel()
    low, high = np.minimum(starts, ends), np.maximum(starts, ends)
    order = np.lexsort((high, low))
    same = (low[order][1:] == low[order][:-1]) & (high[order][1:] == high[order][:-1])
    one, other = order[:-1][same], order[1:][same]  # half edges, 3 triangle + corner, that are one edge
    smooth = np.sum(normal[one // 3] * normal[other // 3], axis=1) >= np.cos(np.radians(crease)) - 1e-9
    one, other = one[smooth], other[smooth]
    after = np.array([1, 2, 0])
    along = starts[one] == starts[other]  # neighbours that wind alike run along their edge in opposite directions
    begin, end = other, other // 3 * 3 + after[other % 3]
    pairs = np.concatenate(
        [
            np.stack([one, np.where(along, begin, end)], axis=1),
            np.stack([one // 3 * 3 + after[one % 3], np.where(along, end, begin)], axis=1),
        ]
    )
    label = np.arange(3 * len(triangles))
    while True:  # the least corner of all that are smoothly joined; as many rounds as a fan has triangles
        lowest = label[pairs].min(axis=1)
        if (label[pairs] == lowest[:, None]).all():
            break
        np.minimum.at(label, pairs[:, 0], lowest)
        np.minimum.at(label, pairs[:, 1], lowest)
        label = label[label]
    kept, corners = np.unique(label, return_inverse=True)
    return corners.reshape(-1, 3), triangles.ravel()[kept]


class _Surface:
    """A shell's topology for drawing: its points parted at creases and where colours change."""

    def __init__(self, shell: Shell, points: np.ndarray, code: float) -> None:
        triangles = shell.triangles
        crease = 180.0 if shell.body.subdivided else CREASE
        self._corners, self._origin = _parted(points, triangles, crease)
        colours = to_bytes(shell.corner_colours(code).reshape(-1, 3)).astype(np.int64)
        keys = self._corners.ravel() << 24 | (colours @ [1 << 16, 1 << 8, 1])
        _, first, drawn = np.unique(keys, return_index=True, return_inverse=True)
        self._parted = self._corners.ravel()[first]  # of each drawn point
        self._triangles = drawn.reshape(-1, 3)
        self._colours = colours[first].astype(np.uint8)
        self._points = points

    def placed(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n, 3) points and normals to draw; a corner weighs in a normal by its triangle's area."""
        parted = points[self._origin]
        a, b, c = (parted[self._corners[:, k]] for k in range(3))
        area = np.repeat(np.cross(b - a, c - a), 3, axis=0)
        normal = np.stack(
            [np.bincount(self._corners.ravel(), area[:, k], minlength=len(parted)) for k in range(3)], axis=1
        )
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
        return parted[self._parted], normal[self._parted]

    def add_to(self, plotter: Any) -> tuple[Any, Any]:
        import pyvista

        points, normals = self.placed(self._points)
        mesh = pyvista.PolyData.from_regular_faces(points.astype(np.float32), self._triangles)
        mesh.point_data["rgb"] = self._colours
        mesh.point_data["Normals"] = normals.astype(np.float32)
        mesh.point_data.active_normals_name = "Normals"
        actor = plotter.add_mesh(
            mesh,
            scalars="rgb",
            rgb=True,
            render=False,
            reset_camera=False,
            **MATTER,
        )
        actor.prop.interpolation = "Phong"
        return mesh, actor
