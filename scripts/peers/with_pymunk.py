"""pymunk (Chipmunk): circles of elasticity 1 between static segments, with the spatial hash for equal sizes."""

import math

import numpy as np
import pymunk  # pyright: ignore[reportMissingImports]
import pymunk.batch  # pyright: ignore[reportMissingImports]
from numpy.typing import NDArray
from peers.engine import Plan, Run, Start

HEAVY = 1e8
"""Mass of walls whose impulse is counted [masses of a disc]."""

THICK = 2.0
"""Half the thickness of a wall [radii]."""


class Engine(Run):
    """A space; the knob is its number of iterations. Double precision.

    While impulses are counted the walls are heavy bodies that are brought back to rest and place after each frame: what
    each gained is the impulse on it.
    """

    def __init__(self, start: Start, plan: Plan):
        self._space = space = pymunk.Space()
        space.iterations = plan.knob
        space.collision_slop = 0.0
        space.use_spatial_hash(2 * start.radius, 10 * start.count)
        self._dt, self._count, self.impulses = plan.dt, start.count, np.zeros(4)
        moment, bodies, shapes = math.inf, [], []  # smooth discs do not spin
        for place, speed in zip(start.position.tolist(), start.velocity.tolist(), strict=True):
            body = pymunk.Body(1.0, moment)
            body.position, body.velocity = (place[0], place[1]), (speed[0], speed[1])
            shape = pymunk.Circle(body, start.radius)
            shape.elasticity, shape.friction = 1.0, 0.0
            bodies.append(body)
            shapes.append(shape)
        space.add(*bodies, *shapes)
        self._add_walls(start, plan.counting)

    def _add_walls(self, start: Start, heavy: bool) -> None:
        width, height, thick = start.width, start.height, THICK * start.radius
        left, right, low, high = -thick, width + thick, -thick, height + thick
        ends = (((left, low), (left, high)), ((right, low), (right, high)))
        ends += (((left, low), (right, low)), ((left, high), (right, high)))
        self._heavy = []
        for one, other in ends:
            body = self._space.static_body
            if heavy:
                body = pymunk.Body(HEAVY, math.inf)
                self._space.add(body)
                self._heavy.append(body)
            wall = pymunk.Segment(body, one, other, thick)
            wall.elasticity, wall.friction = 1.0, 0.0
            wall.filter = pymunk.ShapeFilter(group=1)  # walls do not meet each other
            self._space.add(wall)

    def run(self, frames: int) -> None:
        step, dt = self._space.step, self._dt
        for _ in range(frames):
            step(dt)
            for number, wall in enumerate(self._heavy):
                self.impulses[number] += abs(wall.velocity[number // 2]) * HEAVY
                wall.velocity, wall.position = (0.0, 0.0), (0.0, 0.0)

    def state(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        buffer = pymunk.batch.Buffer()
        fields = pymunk.batch.BodyFields.POSITION | pymunk.batch.BodyFields.VELOCITY
        pymunk.batch.get_space_bodies(self._space, fields, buffer)
        numbers = np.frombuffer(buffer.float_buf(), dtype=np.float64).reshape(-1, 4)[: self._count]  # then the walls
        return numbers[:, :2].copy(), numbers[:, 2:].copy()
