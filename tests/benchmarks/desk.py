"""Write the meshes and pictures of tests/data/desk/desk.xml: `python tests/benchmarks/desk.py`."""

from pathlib import Path

import matplotlib.image
import numpy as np
import OpenEXR

FOLDER = Path(__file__).parents[1] / "data/desk"


def torus(around: int = 20, across: int = 10, radius: float = 0.011, tube: float = 0.005) -> str:
    """A torus about the y axis with texture coordinates, as OBJ."""
    u, v = np.meshgrid(
        np.arange(around + 1) / around, np.arange(across + 1) / across, indexing="ij"
    )
    ring = radius + tube * np.cos(2 * np.pi * v)
    places = np.stack(
        [ring * np.cos(2 * np.pi * u), tube * np.sin(2 * np.pi * v), ring * np.sin(2 * np.pi * u)],
        axis=-1,
    )
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in places.reshape(-1, 3)]
    lines += [f"vt {x:.4f} {y:.4f}" for x, y in np.stack([4 * u, v], axis=-1).reshape(-1, 2)]
    for i in range(around):
        for k in range(across):
            a, b = 1 + i * (across + 1) + k, 1 + (i + 1) * (across + 1) + k
            lines.append("f " + " ".join(f"{corner}/{corner}" for corner in (a, a + 1, b + 1, b)))
    return "\n".join(lines) + "\n"


def pebble(rows: int = 10, columns: int = 20) -> str:
    """A sphere of 9 mm with bumps, as ASCII PLY."""
    theta, phi = np.meshgrid(
        np.linspace(0, np.pi, rows + 1), 2 * np.pi * np.arange(columns) / columns, indexing="ij"
    )
    radius = 0.009 * (1 + 0.12 * np.sin(theta) ** 2 * np.cos(3 * phi))
    places = radius[..., None] * np.stack(
        [np.sin(theta) * np.cos(phi), np.cos(theta), np.sin(theta) * np.sin(phi)], axis=-1
    )
    corner = np.arange(places.shape[0] * columns).reshape(-1, columns)
    beside = np.roll(corner, -1, axis=1)
    halves = (corner[:-1], beside[:-1], beside[1:]), (corner[:-1], beside[1:], corner[1:])
    faces = np.concatenate([np.stack(half, axis=-1).reshape(-1, 3) for half in halves])
    head = (
        f"ply\nformat ascii 1.0\nelement vertex {corner.size}\nproperty float x\nproperty float"
        " y\nproperty float z\n"
    )
    head += f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    body = [f"{x:.6f} {y:.6f} {z:.6f}" for x, y, z in places.reshape(-1, 3)]
    body += [f"3 {a} {b} {c}" for a, b, c in faces]
    return head + "\n".join(body) + "\n"


def sky(rows: int = 16, columns: int = 32) -> np.ndarray:
    """A blue sky with a bright window above a brown ground, (rows, columns, 3)."""
    height = np.linspace(1, -1, rows)[:, None, None]
    picture = (
        np.where(height > 0, [0.5, 0.7, 1.0], [0.35, 0.28, 0.2])
        * (0.3 + 0.7 * np.abs(height))
        * np.ones((1, columns, 1))
    )
    picture[3:6, 8:12] *= 6
    return np.ascontiguousarray(picture, np.float32)


def wood(side: int = 32) -> np.ndarray:
    y, x = np.mgrid[:side, :side] / side
    rings = 0.5 + 0.5 * np.sin(2 * np.pi * (6 * x + 0.6 * np.sin(2 * np.pi * y)))
    return np.stack([0.45 + 0.25 * rings, 0.3 + 0.18 * rings, 0.18 + 0.1 * rings], axis=-1)


def label(side: int = 32) -> np.ndarray:
    y, x = np.mgrid[:side, :side]
    stripes = ((x // 4 + y // 8) % 2)[..., None]
    return np.where(stripes, [0.8, 0.75, 0.2], [0.1, 0.25, 0.6])


if __name__ == "__main__":
    (FOLDER / "torus.obj").write_text(torus(), encoding="ascii")
    (FOLDER / "pebble.ply").write_text(pebble(), encoding="ascii")
    for name, picture in (("wood", wood()), ("label", label())):
        matplotlib.image.imsave(FOLDER / f"{name}.png", picture, metadata={"Software": None})
    channels = {name: np.ascontiguousarray(sky()[..., k]) for k, name in enumerate("RGB")}
    OpenEXR.File({}, channels).write(str(FOLDER / "sky.exr"))
