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
from plait.pipeline.pictures.creases import Creased
from plait.pipeline.pictures.curves import shade
from plait.pipeline.pictures.drawables import Changing, Dots, Drawable, Lines, Shell
from plait.pipeline.pictures.framing import View

FINER = 2  # drawn this much larger and averaged down: smooth edges, hair finer than a pixel
KEY, FILL, RIM = (-0.55, 0.75, 0.75), (0.85, 0.15, 0.55), (0.35, 0.65, -0.85)  # towards the lights, view axes
LIGHTS = ((KEY, 0.78, (1.0, 0.98, 0.95)), (FILL, 0.42, (0.88, 0.93, 1.0)), (RIM, 0.32, (1.0, 1.0, 1.0)))
MATTER = {"ambient": 0.24, "diffuse": 0.9, "specular": 0.08, "specular_power": 25.0}
THINNEST = 1.5  # pixels, before they are averaged, of a line
SKY = 0.5  # of the key light comes from around, and reaches into shadows
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

    def __init__(
        self, size: tuple[int, int], drawables: Sequence[Drawable], ground: Shell | None, axes: np.ndarray
    ) -> None:
        """ground: what shadows fall on, level.  axes: (3, 3) as `View.axes`, of the view the lights are set by."""
        probe()
        import pyvista
        from vtkmodules.vtkCommonCore import vtkLogger

        vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
        self._size = size
        self._plotter = pyvista.Plotter(
            off_screen=True, window_size=[FINER * side for side in size], lighting="none"
        )
        self._plotter.set_background(BOTTOM, top=TOP)
        self._lights = [_unit(place) @ axes for place, _, _ in LIGHTS]
        for place, (_, intensity, colour) in zip(self._lights, LIGHTS, strict=True):
            light = pyvista.Light(light_type="scene light", intensity=intensity, color=colour)
            light.positional = False
            light.position, light.focal_point = place, (0.0, 0.0, 0.0)
            self._plotter.add_light(light)
        self._shown = [_Shown(self._plotter, drawable, self._lights[0]) for drawable in drawables]
        if ground is not None:
            casting = [drawable for drawable in drawables if drawable is not ground]
            self._shown += [_Shadow(self._plotter, drawable, ground, self._lights) for drawable in casting]

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

    def __init__(self, plotter: Any, drawable: Drawable, to_light: np.ndarray) -> None:
        self._plotter, self._drawable, self._to_light = plotter, drawable, to_light
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
        elif isinstance(self._drawable, Changing):
            self._update_changing(self._drawable, points, code)
        else:
            self._update_fibres(self._drawable, points, code, view, pixels_high)

    def _update_shell(self, shell: Shell, points: np.ndarray, code: float) -> None:
        if self._actor is None:
            self._creased = Creased(shell, points, code)
            self._mesh, self._actor = self._add_shell(*self._creased.placed(points))
        elif shell.animated:
            self._mesh.points[:], self._mesh.point_data["Normals"][:] = self._creased.placed(points)
            self._mesh.Modified()

    def _update_changing(self, shown: Changing, points: np.ndarray, code: float) -> None:
        import pyvista

        mesh = pyvista.PolyData.from_regular_faces(points.astype(np.float32), shown.triangles(code))
        mesh.point_data["rgb"] = to_bytes(shown.point_colours(code))
        mesh = mesh.compute_normals(cell_normals=False, split_vertices=False, consistent_normals=False)
        if self._actor is not None:
            self._mesh.copy_from(mesh)
            return
        self._mesh = mesh
        self._actor = self._plotter.add_mesh(
            mesh, scalars="rgb", rgb=True, render=False, reset_camera=False, **MATTER
        )
        self._actor.prop.interpolation = "Phong"

    def _add_shell(self, points: np.ndarray, normals: np.ndarray) -> tuple[Any, Any]:
        import pyvista

        mesh = pyvista.PolyData.from_regular_faces(points.astype(np.float32), self._creased.triangles)
        mesh.point_data["rgb"] = self._creased.colours
        mesh.point_data["Normals"] = normals.astype(np.float32)
        mesh.point_data.active_normals_name = "Normals"
        actor = self._plotter.add_mesh(
            mesh,
            scalars="rgb",
            rgb=True,
            opacity=self._drawable.opacity,
            render=False,
            reset_camera=False,
            **MATTER,
        )
        actor.prop.interpolation = "Phong"
        return mesh, actor

    def _update_fibres(
        self, fibres: Lines | Dots, points: np.ndarray, code: float, view: View, pixels_high: int
    ) -> None:
        width = fibres.width(code)
        pixels = width / view.pixel_size(points, pixels_high)
        colour = fibres.point_colours(code)
        solid = isinstance(fibres, Lines) and pixels >= SOLID * FINER
        if isinstance(fibres, Lines) and not solid:
            colour = shade(points, fibres.counts(code), colour, self._to_light, view.axes[2])
        mesh = _fibres(fibres, points, colour, code)
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
        thinnest = THINNEST if isinstance(fibres, Lines) else 2.0 * FINER
        self._actor.prop.line_width = self._actor.prop.point_size = max(pixels, thinnest)


class _Shadow:
    """What a drawable keeps of the key light from a level ground: its outline along that light."""

    def __init__(self, plotter: Any, drawable: Drawable, ground: Shell, lights: Sequence[np.ndarray]) -> None:
        self._plotter, self._drawable, self._to_light = plotter, drawable, lights[0]
        self._up, self._height = np.zeros(3), 0.0
        code = ground.source.start
        level = ground.points(code)
        self._up[np.argmin(np.ptp(level, axis=0))] = 1.0
        self._lift = 2e-4 * float(np.ptp(level, axis=0).max())  # so that the ground does not show through
        self._height = float((level @ self._up).max())
        rest = [
            intensity * np.array(colour) * max(0.0, float(place @ self._up))
            for place, (_, intensity, colour) in zip(lights, LIGHTS, strict=True)
        ]
        rest[0] = SKY * rest[0]
        lit = MATTER["ambient"] + MATTER["diffuse"] * np.sum(rest, axis=0)
        self._colour = to_bytes(ground.corner_colours(code)[0, :1])[0] / 255.0 * np.minimum(lit, 1.0)
        self._mesh: Any = None

    def update(self, code: float, view: View, pixels_high: int) -> None:
        """Casts it as it is at `code`."""
        points = self._drawable.points(code) if self._drawable.visible(code) else np.zeros((0, 3))
        if self._mesh is not None:
            self._actor.SetVisibility(bool(len(points)))
        if not len(points) or (self._mesh is not None and not self._drawable.animated):
            return
        mesh = self._cast(points, code)
        if self._mesh is not None:
            self._mesh.copy_from(mesh)
        else:
            self._mesh = mesh
            self._actor = self._plotter.add_mesh(
                mesh,
                color=self._colour,
                lighting=False,
                line_width=THINNEST,
                render_points_as_spheres=True,
                render=False,
                reset_camera=False,
            )
        if isinstance(self._drawable, Dots):
            pixels = self._drawable.width(code) / view.pixel_size(points, pixels_high)
            self._actor.prop.point_size = max(pixels, 2.0 * FINER)

    def _cast(self, points: np.ndarray, code: float) -> Any:
        """Its faces, lines or dots, cast on the ground."""
        import pyvista

        above = np.maximum(points @ self._up - self._height, 0.0) / float(self._to_light @ self._up)
        cast = points - above[:, None] * self._to_light
        cast += (self._height + self._lift - cast @ self._up)[:, None] * self._up
        mesh = pyvista.PolyData(cast.astype(np.float32))
        if isinstance(self._drawable, Dots):
            return mesh
        mesh.verts = np.zeros(0, np.int64)
        if isinstance(self._drawable, Shell):
            mesh.regular_faces = self._drawable.triangles
        elif isinstance(self._drawable, Changing):
            mesh.regular_faces = self._drawable.triangles(code)
        else:
            mesh.lines = _polylines(self._drawable.counts(code))
        return mesh


def _unit(vector: Sequence[float]) -> np.ndarray:
    return np.asarray(vector) / np.linalg.norm(vector)


def _fibres(fibres: Lines | Dots, points: np.ndarray, colour: np.ndarray, code: float) -> Any:
    """Lines or dots as VTK's cells, with their colours."""
    import pyvista

    mesh = pyvista.PolyData(points.astype(np.float32))
    if isinstance(fibres, Lines):
        mesh.verts = np.zeros(0, np.int64)
        mesh.lines = _polylines(fibres.counts(code))
    mesh.point_data["rgb"] = to_bytes(colour)
    return mesh


def _polylines(counts: np.ndarray) -> np.ndarray:
    """VTK's cells: each line's count, then its points."""
    first = np.cumsum(counts + 1) - (counts + 1)
    cells = np.arange(counts.sum() + len(counts)) - np.repeat(np.arange(len(counts)) + 1, counts + 1)
    cells[first] = counts
    return cells
