"""A scene in other units, mirrored, turned or renumbered: what physics and rounding do not care about."""

import copy
import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np

import mpsim


@dataclass(frozen=True)
class Units:
    """Factors of length, time and mass. Powers of two change no digit of a number."""

    length: float = 1.0
    time: float = 1.0
    mass: float = 1.0

    @classmethod
    def drawn(cls, rng: np.random.Generator, most: int) -> "Units":
        """Powers of two, up to 2^most and down to 2^-most."""
        return cls(*(2.0 ** rng.integers(-most, most + 1, 3)).tolist())

    @property
    def speed(self) -> float:
        return self.length / self.time

    @property
    def acceleration(self) -> float:
        return self.length / self.time / self.time

    def measure(self, name: str) -> float:
        """Factor of a measure of a run, by its dimension."""
        energy = self.mass * self.speed * self.speed
        rate = 1 / self.time
        pressure = self.mass / self.time / self.time
        factors = {
            "overlap": self.length, "largest_overlap": self.length, "kinetic_energy": energy, "temperature": energy,
            "speed_kurtosis": 1.0, "collision_rate": rate, "contact_rate": rate, "energy_drift": rate,
            "momentum_drift": rate,
        }  # fmt: skip
        return pressure if name.startswith("pressure") else factors[name]

    def scene(self, scene: mpsim.Scene) -> mpsim.Scene:
        """The scene in these units."""
        features = features_of(scene)
        features |= {
            "width": scene.width * self.length,
            "height": scene.height * self.length,
            "position": scene.position * self.length,
            "velocity": scene.velocity * self.speed,
            "radius": scene.radius * self.length,
            "mass": scene.masses * self.mass if is_weighed(scene) else None,
            "obstacles": [self.obstacle(obstacle) for obstacle in scene.obstacles],
            "emitters": [self.emitter(emitter) for emitter in scene.emitters],
        }
        for name in ("gravity", "acceleration"):
            if features[name] is not None:
                features[name] = features[name] * self.acceleration
        if features.get("spin") is not None:
            features["spin"] = features["spin"] / self.time
        if scene.piston is not None:
            places = {"stop": scene.piston.stop * self.length}
            start = getattr(scene.piston, "start", None)
            places |= {} if start is None else {"start": start * self.length}
            features["piston"] = dataclasses.replace(scene.piston, speed=scene.piston.speed * self.speed, **places)
        return mpsim.Scene(**features)

    def obstacle(self, obstacle: Any) -> Any:
        if isinstance(obstacle, mpsim.FixedDisc):
            return mpsim.FixedDisc(np.multiply(obstacle.position, self.length), obstacle.radius * self.length)
        assert isinstance(obstacle, mpsim.Polyline)
        return mpsim.Polyline(np.multiply(obstacle.points, self.length), obstacle.thickness * self.length)

    def emitter(self, emitter: mpsim.Emitter) -> mpsim.Emitter:
        factors = {"position": self.length, "velocity": self.speed, "interval": self.time, "radius": self.length}
        factors["mass"] = self.mass
        values = {name: getattr(emitter, name) for name in factors}
        scaled = {name: np.multiply(value, factors[name]) for name, value in values.items() if value is not None}
        plain = {name: value if name in ("position", "velocity") else float(value) for name, value in scaled.items()}
        return dataclasses.replace(emitter, **plain)


def is_weighed(scene: mpsim.Scene) -> bool:
    """Whether masses are given: else they are 1 in any units."""
    return scene.mass is not None or any(emitter.mass is not None for emitter in scene.emitters)


def features_of(scene: mpsim.Scene) -> dict[str, Any]:
    """Arguments that make the scene again."""
    names = {name for name in scene.__getstate__() if not name.startswith("_")} | {"position", "velocity"}
    return copy.deepcopy({name: getattr(scene, name) for name in names})


@dataclass(frozen=True)
class Image:
    """A mirror image or a quarter turn of a box. All that a scene has goes through `point`, `vector` and `edges`.

    Attributes:
        edges: which edge each of left, right, bottom and top becomes.
        matrix: shape (2, 2), of vectors; its elements are 0, 1 and -1, so nothing is rounded. Its determinant is the
            sign that spins take.
        shift: of points, after the matrix [length].
        size: width and height of the image [length].
    """

    edges: dict[str, str]
    matrix: np.ndarray
    shift: np.ndarray
    size: tuple[float, float]

    def vector(self, value: Any) -> Any:
        """Vectors, shape (..., 2)."""
        return np.asarray(value) @ self.matrix.T

    def point(self, value: Any) -> Any:
        """Points, shape (..., 2)."""
        return self.vector(value) + self.shift

    def point_back(self, value: np.ndarray) -> np.ndarray:
        """The points that have these images."""
        return (value - self.shift) @ self.matrix

    def vector_back(self, value: np.ndarray) -> np.ndarray:
        """The vectors that have these images."""
        return value @ self.matrix

    def scene(self, scene: mpsim.Scene) -> mpsim.Scene:
        """The image of a scene."""
        features = features_of(scene) | dict(zip(("width", "height"), self.size, strict=True))
        features["boundary"] = scene.boundary if self.matrix[0, 0] else scene.boundary[::-1]
        features["position"] = self.point(scene.position)
        for name in ("velocity", "gravity", "acceleration"):
            if features[name] is not None:
                features[name] = self.vector(features[name])
        if scene.spin is not None:
            (a, b), (c, d) = self.matrix.tolist()
            features["spin"] = scene.spin * (a * d - b * c)
        features["obstacles"] = [self.obstacle(obstacle) for obstacle in scene.obstacles]
        features["absorbing"] = [self.edges[edge] for edge in scene.absorbing]
        features["emitters"] = [
            dataclasses.replace(emitter, position=self.point(emitter.position), velocity=self.vector(emitter.velocity))
            for emitter in scene.emitters
        ]
        if scene.piston is not None:
            features["piston"] = self.piston(scene.piston)
        return mpsim.Scene(**features)

    def obstacle(self, obstacle: Any) -> Any:
        if isinstance(obstacle, mpsim.FixedDisc):
            return mpsim.FixedDisc(self.point(obstacle.position), obstacle.radius)
        assert isinstance(obstacle, mpsim.Polyline)
        return mpsim.Polyline(self.point(obstacle.points), obstacle.thickness)

    def piston(self, piston: mpsim.Piston) -> mpsim.Piston:
        along = np.array([1.0, 0.0] if piston.wall in ("left", "right") else [0.0, 1.0])
        component = int(np.abs(self.vector(along)).argmax())
        place = lambda value: float(self.point(along * value)[component])  # noqa: E731
        return mpsim.Piston(
            self.edges[piston.wall],
            float(self.vector(along * piston.speed)[component]),
            place(piston.stop),
            None if piston.start is None else place(piston.start),
        )


def mirror(scene: mpsim.Scene) -> Image:
    """Left and right exchanged."""
    edges = {"left": "right", "right": "left", "bottom": "bottom", "top": "top"}
    return Image(edges, np.array([[-1, 0], [0, 1]]), np.array([scene.width, 0]), (scene.width, scene.height))


def turn(scene: mpsim.Scene) -> Image:
    """A quarter turn against the clock."""
    edges = {"left": "bottom", "bottom": "right", "right": "top", "top": "left"}
    return Image(edges, np.array([[0, -1], [1, 0]]), np.array([scene.height, 0]), (scene.height, scene.width))


def renumbered(scene: mpsim.Scene, order: np.ndarray) -> mpsim.Scene:
    """The discs in another order, the new disc k the old disc order[k], and obstacles and emitters turned round."""
    features = features_of(scene)
    for name in ("position", "velocity", "acceleration", "radius", "mass", "spin"):
        if np.ndim(features.get(name)):
            features[name] = features[name][order]
    for name in ("obstacles", "emitters"):
        features[name] = features[name][::-1]
    return mpsim.Scene(**features)
