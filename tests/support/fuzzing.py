"""Damage to files, as it comes from bad disks and bad people: of bytes, of words, and of values under a good digest."""

import random
from typing import Any

import numpy as np

NUMBERS = [0, -0.0, -1, 1, 2, 3.5, 1e-320, 1e-9, 1e9, 1e30, 1e300, float("nan"), float("inf"), 2**31, 2**63, 10**400]
WORDS = ["", "walls", "periodic", "left", "../../../etc/passwd", "/dev/zero", "a\0b", "event", "x" * 5000, "ü\u202e"]


HOSTILE = [
    "a." * 3000 + "b = 1",
    "[" + "a." * 3000 + "b]",
    "k = " + "[" * 3000,
    "k = " + "{a = " * 3000 + "1" + "}" * 3000,
    f"width = 0x{'f' * 6000}",
    f"gravity = [1, {'9' * 6000}]",
    "obstacles = [" + "{}, " * 3000 + "]",
    "[[discs]]\nradius = 1\nposition = '" + "a" * 5000 + ".npy'",
    "[[discs]]\nradius = 1\nposition = 'pipe.npy'",
    "[[discs]]\nradius = 'zero.csv'\nplaces = 'random'\ncount = 1",
    "".join(f"k{i} = 1\n" for i in range(3000)),
]
"""Lines of a scene file that cost a careless reader its time, its memory or its stack: of its length alone little."""


def anything(rng: random.Random, depth: int = 3) -> Any:
    """A value of any kind."""
    kind = rng.randrange(8 if depth else 5)
    if kind < 3:
        return rng.choice(NUMBERS)
    if kind == 3:
        return rng.choice(WORDS)
    if kind == 4:
        return rng.choice([None, True, False])
    if kind < 7:
        return [anything(rng, depth - 1) for _ in range(rng.randrange(4))]
    return {rng.choice([*WORDS, "kind", "radius"]): anything(rng, depth - 1) for _ in range(rng.randrange(3))}


def damaged_bytes(content: bytes, rng: random.Random) -> bytes:
    """Bytes flipped, cut, doubled, moved or replaced, in a few places."""
    found = bytearray(content)
    for _ in range(rng.choice([1, 1, 2, 5, 50])):
        if not found:
            break
        at, length = rng.randrange(len(found)), rng.choice([1, 2, 8, 64, 1000])
        match rng.randrange(6):
            case 0:
                found[at] ^= 1 << rng.randrange(8)
            case 1:
                del found[at : at + length]
            case 2:
                del found[at:]
            case 3:
                found[at:at] = found[at : at + length]
            case 4:
                found[at : at + length] = rng.randbytes(length)
            case _:
                other = rng.randrange(len(found))
                found[at : at + length] = found[other : other + length]
    return bytes(found)


def damaged_text(text: str, rng: random.Random) -> str:
    """Lines of a scene file dropped, doubled, mixed, and values replaced by others."""
    lines = text.splitlines()
    for _ in range(rng.choice([1, 1, 2, 4])):
        at = rng.randrange(len(lines))
        match rng.randrange(6):
            case 0:
                del lines[at]
                lines = lines or [""]
            case 5:
                lines.insert(at, rng.choice(HOSTILE))
            case 1:
                lines.insert(rng.randrange(len(lines)), lines[at])
            case 2:
                rng.shuffle(lines)
            case _ if "=" in lines[at]:
                lines[at] = f"{lines[at].split('=')[0]}= {toml_of(anything(rng))}"
            case _:
                lines[at] = damaged_bytes(lines[at].encode(), rng).decode("utf-8", "replace")
    return "\n".join(lines)


def toml_of(value: Any) -> str:
    """A value as TOML writes it; None as a word that means nothing there."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{toml_of(str(name))} = {toml_of(part)}" for name, part in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml_of, value)) + "]"
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"').replace("\0", "\\u0000") + '"'
    if value is None or isinstance(value, bool):
        return str(value).lower()
    return repr(value)


def damaged_values(plain: Any, rng: random.Random) -> Any:
    """A tree of plain values with one of them replaced, removed or added."""
    if isinstance(plain, dict) and plain and rng.random() < 0.9:
        name, found = rng.choice(sorted(plain)), dict(plain)
        match rng.randrange(8):
            case 0:
                del found[name]
            case 1:
                found[rng.choice(WORDS)] = anything(rng)
            case _:
                found[name] = damaged_values(found[name], rng)
        return found
    if isinstance(plain, list) and plain and rng.random() < 0.8:
        at = rng.randrange(len(plain))
        return [damaged_values(part, rng) if k == at else part for k, part in enumerate(plain)]
    return anything(rng)


def damaged_array(array: np.ndarray, rng: random.Random) -> np.ndarray:
    """An array with elements, shape or dtype changed."""
    found = array.copy()
    match rng.randrange(6):
        case 0:
            return found.astype(rng.choice(["<f4", "<f8", "<i4", "<i8", "|u1", "<c16"]), casting="unsafe")
        case 1:
            return found[: rng.randrange(len(found) + 1)] if found.ndim else found.reshape(1)
        case 2:
            return np.concatenate([found, found]) if found.ndim else found
        case _ if found.size:
            flat = found.reshape(-1)
            for _ in range(rng.choice([1, 3])):
                value = rng.choice([number for number in NUMBERS if abs(number) < 2**31] + [float("nan"), float("inf")])
                with np.errstate(all="ignore"):
                    at = rng.randrange(flat.size)
                    flat[at : at + 1] = np.array([value]).astype(found.dtype)
    return found
