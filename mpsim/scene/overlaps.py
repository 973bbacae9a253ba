"""Messages about overlaps at the start of a scene."""

from typing import Any

from mpsim.scene import placement


def overlaps_in_words(scene: Any) -> str:
    """Overlaps of discs with each other and with obstacles; "" without any. See `Scene.overlaps_at_start`."""
    if scene.on_lattice is not None:  # displacements are shorter than half of the gaps; there are no obstacles
        return ""
    words: list[str] = []
    pairs, (i, j), depth = placement.overlaps(
        scene.position, scene.width, scene.height, 2 * scene.radius, scene.periodic
    )
    if pairs:
        words.append(
            f"1 pair of discs overlaps at the start: discs {i} and {j}, by {depth:.3g}"
            if pairs == 1
            else f"{pairs} pairs of discs overlap at the start, discs {i} and {j} deepest, by {depth:.3g}"
        )
    found = scene.deepest(scene.position, scene.radii)
    if found is not None:
        words.append(
            f"disc {found.disc} overlaps {found.where} at the start, by {found.depth:.3g}"
            if found.number == 1
            else f"{found.number} discs overlap an obstacle at the start, disc {found.disc} and {found.where} deepest, "
            f"by {found.depth:.3g}"
        )
    return "; ".join(words)
