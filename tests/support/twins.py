"""Slow obvious twins of the stepped methods: NumPy scalars of the run's precision, one operation at a time.

They take nothing from mpsim but a scene and settings as people write them, and the record of a state to compare. What
defines the order of contacts, the sizes of grids and which discs are giants, is written here again.
"""

import math
from typing import Any

import numpy as np

import mpsim
from support.compare import assert_same_bits
from support.scenes import simulate
from support.twin_motion import EDGES, Motion, landing, limited, segments_of

CELLS_PER_DISC = 2  # at most so many cells for each disc

FEW_GIANTS, GIANTS_PER, GIANT = 8, 500, 2.0
"""At most 8 discs, and one in 500, are giants: each has more than twice the radius of all others."""

Cells = dict[tuple[int, int], list[int]]


def assert_is_its_twin(scene: mpsim.Scene, frames: int, note: str, **settings: Any) -> "Twin":
    """Run simulation and twin side by side and compare after each frame, also the numbers of contacts."""
    twin, contacts = Twin(scene, **settings), 0
    with simulate(scene, **settings) as sim:
        for frame in range(frames):
            contacts += sim.run(frames=1).collisions
            twin.run(1)
            assert_same_bits(sim.state, twin.state, f"{note}, {settings}, after frame {frame + 1}")
        assert sim.absorbed.tolist() == twin.gone.tolist(), f"{note}, {settings}: other discs have left"
    assert contacts == twin.contacts, f"{note}, {settings}: {contacts} contacts reported, the twin has {twin.contacts}"
    return twin


def normalised(i: int, j: int, x: Any, y: Any) -> tuple[Any, Any, Any]:
    """Unit vector along (x, y) from disc i to disc j, and its length, in the precision of x and y."""
    length = np.sqrt(x * x + y * y)
    if length > 0:
        return x / length, y / length, length
    nx, ny = direction_of(i, j) if i < j else -direction_of(j, i)
    return type(x)(nx), type(x)(ny), length


def direction_of(i: int, j: int) -> Any:
    """Where disc j goes from the point at which disc i is, too, i < j: a half circle, by a low-discrepancy sequence."""
    tangent = 2 * ((i * 0.6180339887498949 + j * 0.7548776662466927) % 1.0) - 1  # of half of the angle
    return np.array([1 - tangent**2, 2 * tangent]) / (1 + tangent**2)


def giant_radius(radii: Any) -> float | None:
    """Radius above which discs are giants, or None where there are none."""
    ordered, most = sorted(radii), FEW_GIANTS + len(radii) // GIANTS_PER
    if len(ordered) <= 2 * most or ordered[-1] <= GIANT * ordered[-most - 1]:
        return None
    return max(radius for radius in ordered if radius <= GIANT * ordered[-most - 1])


def grid_of(count: int, scene: mpsim.Scene, diameter: float, precision: str) -> tuple[int, int]:
    """Columns and rows: cells a little wider than the largest diameter, of which there are not too many."""
    most = CELLS_PER_DISC * max(count, 1)
    least = [2 if word == "periodic" else 1 for word in scene.boundary]
    rounding = 8 * float(np.finfo(precision).eps) * max(scene.width, scene.height)
    side = max(diameter + rounding, math.sqrt(scene.width * scene.height / most))
    columns, rows = (max(int(size / side), few) for size, few in zip((scene.width, scene.height), least, strict=True))
    columns, rows = min(columns, max(most // rows, least[0])), min(rows, max(most // columns, least[1]))
    return columns - columns % least[0], rows  # an even number of columns round a periodic box


class Twin(Motion):
    """A scene simulated by `naive` or `grid`, disc by disc, in the order in which the discs were given."""

    def __init__(self, scene: mpsim.Scene, **settings: Any):
        super().__init__(scene, mpsim.Settings(**{"contact": "push", **settings}))  # as `simulate` has it
        self.exchange = self.real((1 + scene.restitution) / 2)
        self.contacts = 0
        self.frame = 0
        self.segments = segments_of(scene)
        self.due = [emitter.every or 8 for emitter in scene.emitters]  # frames, or eighths of an interval
        self.left = [emitter.limit or 10**9 for emitter in scene.emitters]

    @property
    def state(self) -> mpsim.State:
        position, kept = self.p.copy(), self.image.copy()
        for i, axis in np.ndindex(position.shape):
            position[i, axis] = self.wrap_disc(i, axis, position[i, axis])
        image, self.image = self.image, kept  # looking changes nothing
        periodic = any(wrap is not None for wrap in self.wrap)
        box = (0, self.scene.width, 0, self.scene.height)  # a piston's place is told by the discs that it pushes
        is_rough = self.friction or self.wall_friction or self.scene.spin is not None
        return mpsim.State(
            position,
            self.v.copy(),
            present=~self.gone,
            image=image if periodic else None,
            spin=np.where(self.gone, self.real(0), self.spin) if is_rough else None,
            box=box if periodic else None,
        )

    def run(self, frames: int) -> None:
        for _ in range(frames):
            self.emit()
            for _ in range(self.settings.substeps):
                for i in range(len(self.p)):
                    self.move(i)
                self.advance_piston()
                self.meet_all()
            self.frame += 1
            self.emit_in_time()

    def add(self, position: Any, velocity: Any, radius: Any = None, mass: Any = None, image: Any = (0, 0)) -> None:
        """One more disc."""
        self.p = np.append(self.p, [position], axis=0).astype(self.real)
        self.v = np.append(self.v, [velocity], axis=0).astype(self.real)
        self.radii = np.append(self.radii, self.scene.largest_radius if radius is None else radius)
        self.mass = np.append(self.mass, 1.0 if mass is None else mass).astype(self.real)
        self.acceleration = np.append(self.acceleration, np.zeros((1, 2)), axis=0).astype(self.real)
        self.spin = np.append(self.spin, self.real(0))
        self.gone = np.append(self.gone, False)
        self.image = np.append(self.image, [image], axis=0)

    def emit(self) -> None:
        """Discs enter where their places are free."""
        for index, emitter in enumerate(self.scene.emitters):
            radius = self.scene.largest_radius if emitter.radius is None else emitter.radius
            due = emitter.every and self.left[index] and self.frame >= self.due[index]
            if due and self.is_free(emitter.position, radius):
                self.add(emitter.position, emitter.velocity, radius, emitter.mass)
                self.left[index] -= 1
                self.due[index] = self.frame + emitter.every

    def emit_in_time(self) -> None:
        """Discs that were due in the last frame enter, oldest first, with a flight from then to now."""
        now = self.frame * self.settings.dt
        while True:
            due = [
                (self.due[index] * (emitter.interval / 8), index, emitter)
                for index, emitter in enumerate(self.scene.emitters)
                if emitter.interval is not None and self.left[index]
            ]
            time, index, emitter = min(due, default=(np.inf, 0, None), key=lambda each: each[:2])
            if time > now * (1 + 1e-12):
                return
            radius = self.scene.largest_radius if emitter.radius is None else emitter.radius
            place, velocity, image = landing(self.scene, emitter, self.segments, radius, max(now - time, 0.0), now)
            free = self.is_free(place, radius)
            if free:
                self.add(place, velocity, radius, emitter.mass, image)
                self.left[index] -= 1
            self.due[index] += 8 if free else 1

    def is_free(self, place: Any, radius: float) -> bool:
        apart = np.abs(self.state.position.astype(float) - np.array(place))
        for axis, length in enumerate((self.scene.width, self.scene.height)):
            if self.wrap[axis] is not None:
                apart[:, axis] = np.minimum(apart[:, axis], length - apart[:, axis])
        return not ((apart**2).sum(axis=1) < (self.radii + radius) ** 2)[~self.gone].any()

    # --- who meets whom, and in which order

    def meet_all(self) -> None:
        """Contacts of all pairs, in the order of the method."""
        if self.settings.method == "naive":
            for _ in range(self.settings.passes):
                self.meet_in_index_order()
            return
        cells, giants = self.cells()
        for _ in range(self.settings.passes):
            for parity in range(2):
                for column in range(parity, self.columns, 2):
                    for row in range(self.rows):
                        self.meet_around(cells, column, row)
                    self.meet_across_borders(cells, column)
            for place, giant in enumerate(giants):
                self.meet_giant(cells, giant, giants[place + 1 :])

    def meet_in_index_order(self) -> None:
        """Pairs i < j; after the discs themselves come their images above, below, right and left, and the corners."""
        here = [i for i in range(len(self.p)) if not self.gone[i]]
        for place, i in enumerate(here):
            later = here[place + 1 :]
            self.meet_each(i, later, None, None)
            self.meet_images_along_y(i, later, None)
            if self.wrap[0] is not None:
                for image in (self.wrap[0], -self.wrap[0]):
                    if self.is_near(i, 0, image):
                        self.meet_each(i, later, image, None)
                        self.meet_images_along_y(i, later, image)

    def meet_images_along_y(self, i: int, later: list[int], image_x: Any) -> None:
        if self.wrap[1] is not None:
            for image in (self.wrap[1], -self.wrap[1]):
                if self.is_near(i, 1, image):
                    self.meet_each(i, later, image_x, image)

    def is_near(self, i: int, axis: int, image: Any) -> bool:
        return -self.diameter < self.p[i, axis] - image < self.wrap[axis] + self.diameter

    def meet_each(self, i: int, others: list[int], image_x: Any, image_y: Any) -> None:
        for j in others:
            self.meet(i, j, image_x, image_y)

    def cells(self) -> tuple[Cells, list[int]]:
        """Discs of each cell (column, row) by rising index, and those that are too large for any."""
        scene, giant = self.scene, giant_radius(self.radii) if self.has_radii else None
        largest = scene.largest_radius if giant is None else giant
        self.columns, self.rows = grid_of(len(self.p), scene, 2 * largest, self.settings.precision)
        self.per_length = [self.real(self.columns / scene.width), self.real(self.rows / scene.height)]
        self.grid_radius = None if giant is None else self.real(giant)
        cells: Cells = {}
        giants = []
        for i, (x, y) in enumerate(self.p):
            if self.gone[i]:
                continue
            if self.grid_radius is not None and self.radius(i) > self.grid_radius:
                giants.append(i)
                continue
            column = min(int(x * self.per_length[0]), self.columns - 1)
            row = min(int(y * self.per_length[1]), self.rows - 1)
            cells.setdefault((column, row), []).append(i)
        return cells, giants

    def meet_around(self, cells: Cells, column: int, row: int) -> None:
        """Each disc with the later ones of its cell, the cell above, and three cells of the next column."""
        own = cells.get((column, row), [])
        neighbours = [(column, row + 1), (column + 1, row - 1), (column + 1, row), (column + 1, row + 1)]
        for place, i in enumerate(own):
            self.meet_each(i, own[place + 1 :], None, None)
            for cell in neighbours:
                self.meet_each(i, cells.get(cell, []), None, None)

    def meet_across_borders(self, cells: Cells, column: int) -> None:
        """The last column with the first one; then the last row with the first one, and the first with the last."""
        (width, height), following, image = self.wrap, column + 1, None
        if width is not None and following == self.columns:
            following, image = 0, width
            for row in range(self.rows):
                for i in cells.get((column, row), []):
                    for other in (row - 1, row, row + 1):
                        self.meet_each(i, cells.get((0, other), []), image, None)
        if height is not None:
            for i in cells.get((column, self.rows - 1), []):
                self.meet_each(i, cells.get((column, 0), []), None, height)
                self.meet_each(i, cells.get((following, 0), []), image, height)
            for i in cells.get((column, 0), []):
                self.meet_each(i, cells.get((following, self.rows - 1), []), image, -height)

    def meet_giant(self, cells: Cells, giant: int, later: list[int]) -> None:
        """A giant with what lies in the cells under it and its images, then with later giants."""
        reach = self.radius(giant) + self.grid_radius
        ranges = [(0,) if wrap is None else (-1, 0, 1) for wrap in self.wrap]
        for image_x in ranges[0]:
            for image_y in ranges[1]:
                shift_x = self.real(image_x * (self.wrap[0] or 0))
                shift_y = self.real(image_y * (self.wrap[1] or 0))
                columns = self.cells_under(giant, 0, shift_x, reach, self.columns)
                rows = self.cells_under(giant, 1, shift_y, reach, self.rows)
                for column in columns:
                    for row in rows:
                        self.meet_each(giant, cells.get((column, row), []), shift_x, shift_y)
                self.meet_each(giant, later, shift_x, shift_y)

    def cells_under(self, giant: int, axis: int, shift: Any, reach: Any, cells: int) -> range:
        centre = self.p[giant, axis] - shift
        first = max(int(max((centre - reach) * self.per_length[axis], -1)), 0)
        last = int(max((centre + reach) * self.per_length[axis], -1))
        return range(first, min(last, cells - 1) + 1)

    # --- what happens when they meet

    def apart(self, i: int, j: int, image_x: Any, image_y: Any) -> tuple[Any, Any]:
        """From disc i, or its image that many lengths back, to disc j."""
        x = self.p[i, 0] if image_x is None else self.p[i, 0] - image_x
        y = self.p[i, 1] if image_y is None else self.p[i, 1] - image_y
        return self.p[j, 0] - x, self.p[j, 1] - y

    def meet(self, i: int, j: int, image_x: Any, image_y: Any) -> None:
        """Contact, if the discs overlap now."""
        nx, ny = self.apart(i, j, image_x, image_y)
        touching = self.radius(j) + self.radius(i) if self.has_radii else self.diameter
        squared = nx * nx + ny * ny
        if not squared < touching * touching:
            return
        self.contacts += 1
        if self.settings.contact == "impact" and self.meet_where_they_touched(i, j, image_x, image_y, touching):
            return
        before = [self.p[disc].copy() for disc in (i, j)]
        nx, ny, distance = normalised(i, j, nx, ny)
        half = (touching - distance) / self.real(2)
        self.push(i, -nx * (half * self.share(i, j)), -ny * (half * self.share(i, j)))
        self.push(j, nx * (half * self.share(j, i)), ny * (half * self.share(j, i)))
        self.apply_law(i, j, nx, ny)
        if self.settings.contact == "impact" and self.pulled:
            self.pay(i, j, before, normalised(i, j, *self.apart(i, j, image_x, image_y)))

    def pay(self, i: int, j: int, before: list[Any], direction: tuple[Any, Any, Any]) -> None:
        """Take the work against gravity of a contact from the velocity with which the discs part, or move them less."""
        nx, ny, _ = direction
        work_i, work_j = (self.work(disc, start) for disc, start in zip((i, j), before, strict=True))
        mass = self.mass[i] if self.has_masses else self.real(1)
        given = self.real(4) * (work_i + work_j) / (self.share(i, j) * mass)
        along = (self.v[j, 0] - self.v[i, 0]) * nx + (self.v[j, 1] - self.v[i, 1]) * ny
        if along * along + given < 0 and self.scene.restitution == 1:
            for disc, start in zip((i, j), before, strict=True):
                self.p[disc] = [a - (b - a) * (along * along) / given for a, b in zip(start, self.p[disc], strict=True)]
        paid = np.sqrt(max(along * along + given, self.real(0)))
        change = (paid if along >= 0 else -paid) - along
        self.kick(i, -change * self.share(i, j) / self.real(2), nx, ny)
        self.kick(j, change * self.share(j, i) / self.real(2), nx, ny)

    def work(self, i: int, start: Any) -> Any:
        """What its acceleration has done on a disc since it was at `start`."""
        way = self.p[i] - start
        work = way[0] * self.pull(i, 0) + way[1] * self.pull(i, 1)
        return work * (self.mass[i] if self.has_masses else self.real(1))

    def keep_inside(self, i: int, axis: int) -> tuple[Any, Any, Any]:
        """Off the wall that an impact has led a disc beyond; at an absorbing edge, on the edge. Returns as `drift`."""
        p, v, inward, time = self.p[i, axis], self.v[i, axis], 1, self.real(0)
        if self.wrap[axis] is None:
            low, high = self.limits_at_contacts[axis]
            margin = self.radius(i) if self.has_radii else self.real(0)
            limits = low + margin, high - margin
            inward = 1 if p < limits[0] else -1
            if self.absorbs(axis, p, limits):
                p = min(max(p, limits[0]), limits[1])
            elif self.pulled:
                p, v, time = self.off_walls(axis, p, v, self.pull(i, axis), limits)
            else:
                p, v, time = self.reflected(axis, p, v, limits)
                p = min(max(p, limits[0]), limits[1])
        change = v - self.v[i, axis]
        self.p[i, axis], self.v[i, axis] = p, v
        return inward, change, time

    def absorbs(self, axis: int, place: Any, limits: tuple[Any, Any]) -> bool:
        """Whether a place lies beyond an edge that absorbs."""
        edges = EDGES[2 * axis : 2 * axis + 2]
        return (place < limits[0] and edges[0] in self.scene.absorbing) or (
            place > limits[1] and edges[1] in self.scene.absorbing
        )

    def meet_where_they_touched(self, i: int, j: int, image_x: Any, image_y: Any, touching: Any) -> bool:
        """Contact `impact`, if the discs touched within this step: back, the law, and on again."""
        r, u = self.apart(i, j, image_x, image_y), self.v[j] - self.v[i]
        b = r[0] * u[0] + r[1] * u[1]
        if not b < 0:
            return False
        c = r[0] * r[0] + r[1] * r[1] - touching * touching
        time = -c / (np.sqrt(b * b - (u[0] * u[0] + u[1] * u[1]) * c) - b)
        if not 0 <= time <= self.dt:
            return False
        before = [self.p[disc].copy() for disc in (i, j)]
        self.p[i] -= self.v[i] * time
        self.p[j] -= self.v[j] * time
        nx, ny, _ = normalised(i, j, *(np.float64(part) for part in self.apart(i, j, image_x, image_y)))
        self.apply_law(i, j, nx, ny)
        self.p[i] += self.v[i] * time
        self.p[j] += self.v[j] * time
        if self.scene.acceleration is not None:
            self.pay(i, j, before, normalised(i, j, *self.apart(i, j, image_x, image_y)))
        for disc in (i, j):
            self.rub_walls(disc, [self.keep_inside(disc, axis) for axis in range(2)], wraps=False)
        return True

    def share(self, i: int, j: int) -> Any:
        """What disc i takes of what the pair divides: by masses, twice the other's part of both, in float64."""
        if not self.has_masses:
            return self.real(1)
        mass_i, mass_j = np.float64(self.mass[i]), np.float64(self.mass[j])
        return 2.0 * mass_j / (mass_i + mass_j)

    def apply_law(self, i: int, j: int, nx: Any, ny: Any) -> None:
        """Change the velocities along the unit vector n from i to j."""
        along_i = self.v[i, 0] * nx + self.v[i, 1] * ny
        along_j = self.v[j, 0] * nx + self.v[j, 1] * ny
        if self.settings.law == "elastic":
            exchanged = (along_j - along_i) * self.exchange if along_j < along_i else self.real(0)
            self.rub_pair(i, j, nx, ny, exchanged)
            self.kick(i, exchanged * self.share(i, j), nx, ny)
            self.kick(j, -(exchanged * self.share(j, i)), nx, ny)
        else:
            self.kick(i, self.real(-2) * along_i, nx, ny)
            self.kick(j, self.real(-2) * along_j, nx, ny)

    def rub_pair(self, i: int, j: int, nx: Any, ny: Any, exchanged: Any) -> None:
        """Friction of two discs that exchange so much of their normal velocity."""
        if self.friction is None or not exchanged < 0:
            return
        slip = (self.v[j, 1] - self.v[i, 1]) * nx - (self.v[j, 0] - self.v[i, 0]) * ny
        slip -= self.surface(i) * self.spin[i] + self.surface(j) * self.spin[j]
        change = limited(self.friction, slip, -exchanged)
        for disc, other, sign in ((i, j, 1), (j, i, -1)):
            own = change * self.share(disc, other)
            self.v[disc, 0] -= sign * own * ny
            self.v[disc, 1] += sign * own * nx
            self.spin[disc] += self.real(2) * own / self.surface(disc)

    def push(self, i: int, dx: Any, dy: Any) -> None:
        """Move a disc, but not through a wall."""
        for axis, shift in enumerate((dx, dy)):
            self.p[i, axis] = self.confined(i, axis, self.p[i, axis] + shift)

    def kick(self, i: int, change: Any, nx: Any, ny: Any) -> None:
        self.v[i, 0] += change * nx
        self.v[i, 1] += change * ny
