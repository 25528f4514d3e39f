"""All inputs of a scene, and what of them comes from files."""

from __future__ import annotations

from collections.abc import Iterator

from clothfit.base.arrays import Array
from clothfit.engine.inputs.interpolation import resolved
from clothfit.scene.keys import Keys
from clothfit.scene.scene import Scene


def keyed(scene: Scene) -> Iterator[tuple[Keys, int | None]]:
    """The keys of a scene, and how many vertices each moves where it is a pin's."""
    for cloth in scene.cloths:
        for pin in cloth.pins:
            for keys in filter(None, (pin.position, pin.rotation)):
                yield keys, len(pin.vertices)
    moved = [each.position for each in scene.spheres]
    for each in scene.colliders:
        moved += [each.position, each.rotation, each.scaling, each.body.motion if each.body else None]
    frame = (scene.frame.position, scene.frame.rotation) if scene.frame else ()
    for keys in filter(None, (scene.wind_keys, scene.gravity_keys, *frame, *moved)):
        yield keys, None


def arrays_from_files(scene: Scene) -> list[Array]:
    """The times and values of all keys and forces, and the meshes, that the text of the scene has not. Raises
    InvalidScene where one cannot be read.
    """
    found = []
    for keys, _ in keyed(scene):
        if keys.file is not None:
            own = resolved(keys)
            found += [own.times, own.values]
    if scene.forces is not None:
        found += [scene.forces.times, scene.forces.values]
    if any(each.body and each.body.file for each in scene.colliders):
        from clothfit.engine.inputs.body_files import bodies_of  # what reads all formats, which few scenes need

        for each in bodies_of(scene.colliders):
            found += [each.surface.place, each.surface.triangles.astype(float)]
    return found
