"""A scene in other units, and the arguments that make a scene again."""

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
        units = dict.fromkeys(("width", "height", "position", "radius"), self.length)
        units |= {"velocity": self.speed, "spin": 1 / self.time}
        units |= dict.fromkeys(("gravity", "acceleration"), self.acceleration)
        features |= {name: features[name] * unit for name, unit in units.items() if features.get(name) is not None}
        features |= {
            "mass": scene.masses * self.mass if is_weighed(scene) else None,
            "obstacles": [self.obstacle(obstacle) for obstacle in scene.obstacles],
            "emitters": [self.emitter(emitter) for emitter in scene.emitters],
        }
        if scene.piston is not None:
            places = {name: getattr(scene.piston, name) for name in ("start", "stop")}
            places = {name: place * self.length for name, place in places.items() if place is not None}
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
