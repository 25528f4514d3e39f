"""Meshes and motions in the files that clothfit reads: y up, right-handed, metres, as OBJ and PC2 have them."""

import json
import struct
from pathlib import Path

import numpy as np

PC2 = struct.Struct("<12siiffi")
"""Magic bytes, version, points, first frame, frames per sample, samples."""

MAGIC = b"POINTCACHE2\0"


def turned(points):
    """Points (…, 3) of Blender, z up, with y up: (x, z, -y)."""
    return np.stack([points[..., 0], points[..., 2], -points[..., 1]], axis=-1)


def write_obj(path, points, faces):
    """Write a mesh: points (n, 3), m, in Blender's axes, and faces as tuples of vertices."""
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in turned(np.asarray(points, float)).tolist()]
    lines += ["f " + " ".join(str(vertex + 1) for vertex in face) for face in faces]
    Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8")


def write_pc2(path, frames):
    """Write a motion: positions (frames, n, 3), m, in Blender's axes."""
    samples, points, _ = frames.shape
    with open(path, "wb") as file:
        file.write(PC2.pack(MAGIC, 1, points, 0.0, 1.0, samples))
        file.write(np.ascontiguousarray(turned(frames), "<f4").tobytes())


def samples(path):
    """The number of frames of a motion in PC2."""
    with open(path, "rb") as file:
        return PC2.unpack(file.read(PC2.size))[-1]


def ranges(numbers):
    """Numbers in rising order as a list of ranges, such as 0,3-7."""
    found = []
    for number in numbers:
        if found and number == found[-1][1] + 1:
            found[-1][1] = number
        else:
            found.append([number, number])
    return ",".join(str(low) if low == high else f"{low}-{high}" for low, high in found)


def vertex_stiffness(path):
    """Geometric mean (n,) of the stiffness of the springs at each vertex of a scene's first object, N/m; 0: none."""
    cloth = json.loads(Path(path).read_text(encoding="utf-8-sig"))["objects"][0]
    ends = np.array(cloth["springs"], int).reshape(-1, 2)
    logs = np.log(np.maximum(np.array(cloth["springStiffness"], float), 1e-9))
    count, total = np.zeros(len(cloth["vertPos"])), np.zeros(len(cloth["vertPos"]))
    for end in ends.T:
        np.add.at(count, end, 1.0)
        np.add.at(total, end, logs)
    return np.where(count > 0, np.exp(total / np.maximum(count, 1.0)), 0.0)


def colours(values):
    """Colours (n, 4) from blue for the lowest values over green to red, on a logarithmic scale; grey: all are equal."""
    logs = np.log(np.maximum(values, 1e-9))
    low, high = np.quantile(logs, [0.05, 0.95])
    if high - low < 1e-4:
        return np.tile([0.5, 0.5, 0.5, 1.0], (len(values), 1))
    share = np.clip((logs - low) / (high - low), 0.0, 1.0)
    red, blue = np.clip(2 * share - 1, 0, 1), np.clip(1 - 2 * share, 0, 1)
    return np.stack([red, 1 - red - blue, blue, np.ones_like(share)], axis=1)
