"""Box2D 3 by the Python package pyb2d3: circles of restitution 1 between boxes."""

import numpy as np
import pyb2d3  # pyright: ignore[reportMissingImports]
from numpy.typing import NDArray
from peers.engine import Plan, Run, Start

HEAVY = 1e8
"""Mass of a wall whose impulse is counted [masses of a disc]."""

DISCS, WALLS = 1, 2
"""Categories of shapes: walls meet discs only."""


class Engine(Run):
    """A world; the knob is its number of sub-steps. Single precision.

    While impulses are counted the walls are heavy bodies that are brought back to rest and place after each frame: what
    each gained is the impulse on it.
    """

    def __init__(self, start: Start, plan: Plan):
        pool = pyb2d3.ThreadPool(plan.threads) if plan.threads > 1 else None
        self._world = pyb2d3.World(thread_pool=pool, gravity=(0, 0), restitution_threshold=0.0)
        self._world.sleeping_enabled = False
        self._plan, self._count = plan, start.count
        self._discs = pyb2d3.Bodies()
        circle = pyb2d3.circle(radius=start.radius)
        shape = self._shape(1 / (np.pi * start.radius**2), category_bits=DISCS, mask_bits=DISCS | WALLS)
        places, speeds = start.position.tolist(), start.velocity.tolist()
        for place, speed in zip(places, speeds, strict=True):
            body = self._world.create_dynamic_body(
                position=(place[0], place[1]), linear_velocity=(speed[0], speed[1]), fixed_rotation=True
            )
            body.create_circle_shape(shape, circle)
            self._discs.append(body.id)
        self._add_walls(start, plan.counting)
        self.impulses = np.zeros(4)

    def _shape(self, density: float, **selection: int) -> object:
        material = pyb2d3.surface_material(restitution=1.0, friction=0.0)
        return pyb2d3.shape_def(density=density, material=material, filter=pyb2d3.make_filter(**selection))

    def _add_walls(self, start: Start, heavy: bool) -> None:
        width, height, thick = start.width, start.height, 4 * start.radius
        self._places = [(-thick, height / 2), (width + thick, height / 2)]
        self._places += [(width / 2, -thick), (width / 2, height + thick)]
        halves = [(thick, height / 2 + 2 * thick)] * 2 + [(width / 2 + 2 * thick, thick)] * 2
        self._walls = []
        for place, (half_width, half_height) in zip(self._places, halves, strict=True):
            create = self._world.create_dynamic_body if heavy else self._world.create_static_body
            wall = create(position=place, **({"fixed_rotation": True} if heavy else {}))
            shape = self._shape(HEAVY / (4 * half_width * half_height), category_bits=WALLS, mask_bits=DISCS)
            wall.create_polygon_shape(shape, pyb2d3.box(half_width, half_height))
            self._walls.append(wall)

    def run(self, frames: int) -> None:
        step, dt, knob = self._world.step, self._plan.dt, self._plan.knob
        if not self._plan.counting:
            for _ in range(frames):
                step(dt, knob)
            return
        for _ in range(frames):
            step(dt, knob)
            for number, (wall, place) in enumerate(zip(self._walls, self._places, strict=True)):
                speed = wall.linear_velocity
                self.impulses[number] += abs((speed.x, speed.y)[number // 2]) * wall.mass
                wall.linear_velocity = (0.0, 0.0)
                wall.set_transform(place, pyb2d3.make_rot(0.0))

    def state(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        position, velocity = self._discs.get_positions(), self._discs.get_linear_velocities()
        return position.astype(np.float64), velocity.astype(np.float64)

    def close(self) -> None:
        self._world.destroy()
