"""The film docs/tools.gif and the pictures docs/tools.png: `python benchmarks/blender_film.py [SCENE]`.

The film shows a scene here, and fits to it in the models of XPBD and of Blender, side by side, with the scene over
them. The pictures show frames of Blender's cloth as this program draws them, and as Blender renders them with the same
camera.
CLOTHFIT_BPY names a Python with Blender as a module (`make blender` makes one). Needs Pillow.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image, ImageColor

import clothfit
from clothfit.base.arrays import Array
from clothfit.formats.axes import facing, from_scene
from clothfit.pictures import gif
from clothfit.pictures.camera import LIGHT
from clothfit.pictures.picture_file import CLOTHS, GROUND
from clothfit.pictures.stage import Stage, stage
from clothfit.simulators.blender import AXES, program, stride
from clothfit.simulators.estimate import Options, estimate
from clothfit.simulators.xpbd import Settings

DOCS = Path(__file__).resolve().parents[1] / "docs"
sys.path.insert(0, str(DOCS))
from gallery import beside, save  # type: ignore[import-not-found]  # noqa: E402

RENDER = Path(__file__).with_name("blender_render.py")
FRAMES, WIDE, STILLS = 51, 300, 4
STEPS = 6  # of each fit
FAR = 10.0  # m, of the camera


def motions(scene: clothfit.Scene, command: list[str]) -> dict[str, Array]:
    """The motion here and those of both tools, by caption."""
    found = {"clothfit": clothfit.simulate(scene).positions}
    for name, options in (
        ("XPBD, fitted", Options("xpbd", Settings(1, 5), most=STEPS)),
        ("Blender, fitted", Options("blender", blender=command[0], most=STEPS)),
    ):
        (one,) = estimate(scene, None, options)
        print(f"{name}: {100 * one.mapped_rmse / one.travel:.2f} % mapped, {100 * one.rmse / one.travel:.2f} % fitted")
        found[name] = one.positions
    return found


def film(on: Stage, times: Array, shown: dict[str, Array]) -> None:
    """Write the film."""
    here = shown["clothfit"]
    parts = [
        [gif.picture(on, times, frame, x, None if x is here else here, WIDE) for frame in range(len(times))]
        for x in shown.values()
    ]
    save(beside(parts, list(shown)), [80] * len(times), DOCS / "tools.gif")


def rendered(
    scene: clothfit.Scene, on: Stage, x: Array, size: tuple[int, int], command: list[str]
) -> list[Image.Image]:
    """Frames (F, n, 3) as Blender renders them."""
    view = on.camera
    middle = 0.5 * (view.low + view.high)
    place = middle[0] * view.right + middle[1] * view.up - FAR * view.forward
    light = np.stack([view.right, view.up, view.forward], axis=1) @ LIGHT
    with tempfile.TemporaryDirectory() as folder:
        names, arrays = [str(Path(folder) / f"{k}.png") for k in range(len(x))], Path(folder) / "x.npz"
        np.savez(arrays, positions=from_scene(x, AXES), triangles=facing(scene.cloths[0].triangles, AXES))
        job = {
            "arrays": str(arrays), "size": size, "wide": float(view.high[0] - view.low[0]), "out": names,
            "ground": [part / 255 for part in ImageColor.getrgb(GROUND)], "cloth": CLOTHS[0],
        }  # fmt: skip
        for name, way in (("right", view.right), ("up", view.up), ("place", place), ("light", light)):
            job[name] = from_scene(way[None], AXES)[0].tolist()
        (Path(folder) / "job.json").write_text(json.dumps(job))
        subprocess.run([command[0], str(RENDER), str(Path(folder) / "job.json")], check=True, capture_output=True)
        return [Image.open(name).convert("RGB") for name in names]


def stills(scene: clothfit.Scene, on: Stage, times: Array, x: Array, command: list[str]) -> None:
    """Write the pictures: above as drawn here, below as rendered there."""
    frames = np.linspace(0, len(x) - 1, STILLS + 1).round().astype(int)[1:]
    own = [gif.picture(on, times, int(frame), x, None, WIDE) for frame in frames]
    there = rendered(scene, on, x[frames], own[0].size, command)
    width, height = own[0].size
    sheet = Image.new("RGB", (width * STILLS, 2 * height))
    for row, pictures in enumerate((own, there)):
        for column, each in enumerate(pictures):
            sheet.paste(each, (column * width, row * height))
    sheet.quantize(128).save(DOCS / "tools.png", optimize=True)


def main() -> None:
    """Fit, draw and render."""
    name = sys.argv[1] if len(sys.argv) > 1 else "side"
    scene = replace(clothfit.load(DOCS.parent / "examples" / f"{name}.json"), frames=FRAMES)
    command = program(None)
    shown, every = motions(scene, command), stride(scene)
    shown = {name: x if len(x) < FRAMES else x[::every] for name, x in shown.items()}
    times = scene.delta * every * np.arange(len(shown["clothfit"]))
    on = stage(scene, list(shown.values()), gif.GIF_FACES, gif.GIF_ASPECT, times)
    film(on, times, shown)
    stills(scene, on, times, shown["Blender, fitted"], command)


if __name__ == "__main__":
    main()
