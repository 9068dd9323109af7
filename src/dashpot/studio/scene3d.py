"""The arm in 3D: MuJoCo's shapes as viser meshes, one frame per body, and only the frames move."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from typing import Any

import mujoco
import numpy as np
import trimesh
import viser

from dashpot.support.arrays import Floats

GHOST, GHOST_OPACITY = (213, 94, 0), 0.35  # the rival: vermillion, and transparent
THINNER = 0.003  # [m] by which a ghost is thinner: where it stands in the arm, the arm hides it
FORCE = (213, 94, 0)
PER_NEWTON = 0.008  # [m/N] of a force's arrow
STILL = 2e-5  # [m] and quaternion units that are not worth a message
SHOWN_GROUPS = 3  # geoms of groups 0-2 are for the eye; the rest is for contacts
ROUND = 24  # faces around a cylinder


class ArmScene:
    """One arm, drawn.

    Attributes:
        root: Name of its node in the scene.
    """

    def __init__(self, server: viser.ViserServer, root: str, ghost: bool = False) -> None:
        self._server, self.root, self._ghost = server, root, ghost
        self._frames: list[Any] = []
        self._names: list[str] = []
        self._stamps: dict[str, str] = {}
        self._nodes: dict[str, list[Any]] = {}
        self._drag: Callable[[int, Any], Any] | None = None
        self._last: tuple[Floats, Floats] | None = None

    def on_drag(self, handler: Callable[[int, Any], Any]) -> None:
        """Has links dragged with Ctrl (or Cmd) held: an async function of body and event."""
        self._drag = handler

    def draw(self, model: Any) -> None:
        """Draws a model's bodies; those that look as before stay as they are."""
        names = [model.body(i).name or f"body{i}" for i in range(model.nbody)]
        with self._server.atomic():
            for name in set(self._names) - set(names):
                self._remove(name)
            self._frames = []
            for body, name in enumerate(names):
                shapes = body_shapes(model, body, THINNER if self._ghost else 0.0)
                stamp = hashlib.sha256(
                    b"".join(part.tobytes() for v, f, c in shapes for part in (v, f, np.array(c)))
                ).hexdigest() + str(body)
                if self._stamps.get(name) != stamp:
                    self._remove(name)
                    self._add(name, body, shapes)
                    self._stamps[name] = stamp
                self._frames.append(self._nodes[name][0])
        self._names, self._last = names, None

    def move(self, positions: Floats, rotations: Floats) -> None:
        """Moves the bodies to positions (nbody, 3) [m] and quaternions wxyz (nbody, 4)."""
        if len(positions) != len(self._frames):
            return  # of another model, which will be drawn next
        last = self._last
        moved = np.ones(len(positions), bool)
        if last is not None:
            moved = (np.abs(positions - last[0]).max(1) > STILL) | (
                np.abs(rotations - last[1]).max(1) > STILL
            )
        if not moved.any():
            return
        for i in np.flatnonzero(moved):
            self._frames[i].position, self._frames[i].wxyz = positions[i], rotations[i]
        if last is None:
            self._last = positions.copy(), rotations.copy()
        else:
            last[0][moved], last[1][moved] = positions[moved], rotations[moved]

    def clear(self) -> None:
        """Removes everything."""
        for name in list(self._nodes):
            self._remove(name)
        self._frames, self._names, self._last = [], [], None

    def _remove(self, name: str) -> None:
        for node in reversed(self._nodes.pop(name, [])):
            node.remove()
        self._stamps.pop(name, None)

    def _add(self, name: str, body: int, shapes: Sequence[tuple[Floats, Any, tuple[int, int, int]]]) -> None:
        place = f"{self.root}/{name}"
        nodes: list[Any] = [self._server.scene.add_frame(place, show_axes=False)]
        for k, (vertices, faces, colour) in enumerate(shapes):
            mesh = self._server.scene.add_mesh_simple(
                f"{place}/{k}",
                vertices.astype(np.float32),
                faces.astype(np.uint32),
                color=GHOST if self._ghost else colour,
                opacity=GHOST_OPACITY if self._ghost else None,
                side="double",
                cast_shadow=not self._ghost,
                receive_shadow=False,
            )
            if self._drag is not None and body > 0:
                self._make_draggable(mesh, body)
            nodes.append(mesh)
        self._nodes[name] = nodes

    def _make_draggable(self, mesh: Any, body: int) -> None:
        handler = self._drag
        assert handler is not None

        async def dragged(event: Any) -> None:  # async: start, updates and end come in order
            handler(body, event)

        mesh.on_drag("left", modifier="cmd/ctrl")(dragged)


class ForceArrow:
    """The force of the hand."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        self._node: Any = None

    def show(self, push: tuple[Floats, Floats] | None) -> None:
        """Force (3,) [N] at a point (3,) [m]; None: nothing."""
        if push is None:
            if self._node is not None:
                self._node.remove()
                self._node = None
            return
        force, point = push
        points = np.array([[point, point + PER_NEWTON * force]], np.float32)
        if self._node is None:
            self._node = self._server.scene.add_arrows(
                "/force", points, FORCE, shaft_radius=0.007, head_radius=0.02, head_length=0.04
            )
        else:
            self._node.points = points


def stage(server: viser.ViserServer) -> None:
    """Floor, lights and up."""
    scene = server.scene
    scene.set_up_direction("+z")
    scene.configure_environment_map(None)
    scene.configure_default_lights(enabled=False)
    scene.add_light_hemisphere(
        "/light/sky", sky_color=(255, 255, 255), ground_color=(190, 190, 200), intensity=2.2
    )
    scene.add_light_directional("/light/key", intensity=1.6, position=(1.5, -2.0, 3.0))
    scene.add_grid(
        "/floor",
        width=4.0,
        height=4.0,
        cell_size=0.1,
        cell_color=(226, 228, 230),
        section_size=0.5,
        section_color=(200, 203, 206),
    )
    scene.world_axes.visible = False


def look_at(server: viser.ViserServer, model: Any) -> None:
    """Camera for an arm of this size."""
    size = max(float(model.stat.extent), 0.4)
    centre = np.array(model.stat.center)
    if not np.isfinite(centre).all() or size > 10:
        centre, size = np.array([0.2, 0.0, 0.4]), 1.0
    server.initial_camera.position = tuple(centre + size * np.array([0.8, -0.95, 0.33]))
    server.initial_camera.look_at = tuple(centre)


def body_shapes(
    model: Any, body: int, thinner: float = 0.0
) -> list[tuple[Floats, Any, tuple[int, int, int]]]:
    """Vertices, faces and colour of everything of one colour on a body, in its frame; `thinner` in m."""
    first, count = int(model.body_geomadr[body]), int(model.body_geomnum[body])
    geoms = [g for g in range(first, first + count) if model.geom_group[g] < SHOWN_GROUPS] if count else []
    parts: dict[tuple[int, int, int], list[trimesh.Trimesh]] = {}
    for g in geoms or range(first, first + count if count else first):
        mesh = _mesh(model, g)
        if mesh is None:
            continue
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, model.geom_quat[g])
        placed = np.eye(4)
        placed[:3, :3], placed[:3, 3] = turn.reshape(3, 3), model.geom_pos[g]
        mesh.apply_transform(placed)
        parts.setdefault(_colour(model, g), []).append(mesh)
    found: list[tuple[Floats, Any, tuple[int, int, int]]] = []
    for colour, meshes in parts.items():
        whole: Any = trimesh.util.concatenate(meshes) if len(meshes) > 1 else meshes[0]
        vertices = np.array(whole.vertices, np.float64)
        if thinner:
            vertices -= thinner * np.asarray(whole.vertex_normals)
        found.append((vertices, np.array(whole.faces), colour))
    return found


def _colour(model: Any, geom: int) -> tuple[int, int, int]:
    material = int(model.geom_matid[geom])
    rgba = model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
    red, green, blue = (round(255 * float(c)) for c in rgba[:3])
    return red, green, blue


def _mesh(model: Any, geom: int) -> Any:
    kind, size = mujoco.mjtGeom(int(model.geom_type[geom])), np.array(model.geom_size[geom])
    shapes = mujoco.mjtGeom
    if kind == shapes.mjGEOM_SPHERE:
        return trimesh.creation.icosphere(subdivisions=2, radius=size[0])
    if kind == shapes.mjGEOM_CAPSULE:
        capsule = trimesh.creation.capsule(height=2 * size[1], radius=size[0], count=[12, ROUND])
        capsule.apply_translation([0, 0, -capsule.bounds.mean(0)[2]])
        return capsule
    if kind == shapes.mjGEOM_CYLINDER:
        return trimesh.creation.cylinder(radius=size[0], height=2 * size[1], sections=ROUND)
    if kind == shapes.mjGEOM_BOX:
        return trimesh.creation.box(extents=2 * size)
    if kind == shapes.mjGEOM_ELLIPSOID:
        ball = trimesh.creation.icosphere(subdivisions=2, radius=1.0)
        ball.apply_scale(size)
        return ball
    if kind == shapes.mjGEOM_MESH:
        i = int(model.geom_dataid[geom])
        v, nv = int(model.mesh_vertadr[i]), int(model.mesh_vertnum[i])
        f, nf = int(model.mesh_faceadr[i]), int(model.mesh_facenum[i])
        return trimesh.Trimesh(
            model.mesh_vert[v : v + nv].copy(), model.mesh_face[f : f + nf].copy(), process=False
        )
    return None  # planes and height fields: the floor is drawn anyway
