"""Scene files: TOML that a person can read and write, checked as a whole.

A scene file holds the arguments of Scene by the same names, and may start discs by rule (random places, lattices,
thermal velocities). It is safe to read: nothing in it is executed, and it refers to no other files than .npy and .csv
in its own folder or below, which are logged and listed in `SceneFile.read`.

Import this module only where it is used: its validator takes a moment to load.
"""

from mpsim.scene.scenefile.reading import SceneFile, load, names, save, titles

__all__ = ["SceneFile", "load", "names", "save", "titles"]
