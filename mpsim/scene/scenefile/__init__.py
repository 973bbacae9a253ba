"""Scene files: TOML that a person can read and write, checked as a whole.

A scene file holds what Scene's arguments hold, by the same names, and may start discs by rule (random places, lattices,
thermal velocities). It can be trusted as far as data can: nothing in it is executed, and it leads to no other files
than .npy and .csv in its own folder or below, which are logged and listed in `SceneFile.read`.

Import this module only where it is used: its checker takes a moment to load.
"""

from mpsim.scene.scenefile.reading import SceneFile, load, names, titles
from mpsim.scene.scenefile.writing import save

__all__ = ["SceneFile", "load", "names", "save", "titles"]
