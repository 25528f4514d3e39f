"""Fill triangles and spheres of a picture, pixel by pixel: the nearest surface, in the light on its normal.

Where a surface is nearer than what is there (the depth buffer; E. Catmull, 1974), the pixel takes its colour in the
light on the normal, which is interpolated between the corners of a triangle (B. T. Phong, Illumination for computer
generated pictures, 1975). So a coarse mesh looks as smooth as the cloth that it stands for.

A place is (u, v, depth): pixels, v downwards, and m; a normal has the components right, up and forward.
"""

from __future__ import annotations

import numpy as np

from clothfit.kernels.kernel import kernel


@kernel
def lit(colour, share):
    """Part of a colour, 0 … 1, under light `share`, 0 … 1: darker towards 0, whiter towards 1."""
    dark = colour * (0.48 + 0.82 * share)
    white = min(max(2.6 * (share - 0.62), 0.0), 1.0)
    return min(max(dark + 0.45 * white * (1.0 - dark), 0.0), 1.0)


@kernel
def fill(places, towards, triangles, colours, light, back, image, depth):
    """Draw triangles (K, 3) between places (n, 3) in pixels and depth, with normals `towards` (n, 3), in colours
    (K, 3); a back is `back` times as bright.
    """
    height, width = depth.shape
    for t in range(len(triangles)):
        a, b, c = triangles[t]
        ua, va, ub, vb = places[a, 0], places[a, 1], places[b, 0], places[b, 1]
        uc, vc = places[c, 0], places[c, 1]
        area = (ub - ua) * (vc - va) - (vb - va) * (uc - ua)
        total = area + places[a, 2] + places[b, 2] + places[c, 2]
        if area == 0.0 or not np.isfinite(total):
            continue
        # v counts downwards: a positive area is seen clockwise, its normal away from the camera in a left-handed world
        side = 1.0 if area > 0.0 else -1.0
        bright = 1.0 if side > 0.0 else back
        low_u, high_u = max(int(np.floor(min(ua, ub, uc))), 0), min(int(np.ceil(max(ua, ub, uc))), width - 1)
        low_v, high_v = max(int(np.floor(min(va, vb, vc))), 0), min(int(np.ceil(max(va, vb, vc))), height - 1)
        for v in range(low_v, high_v + 1):
            for u in range(low_u, high_u + 1):
                x, y = u + 0.5, v + 0.5
                wa = ((ub - x) * (vc - y) - (vb - y) * (uc - x)) / area
                wb = ((uc - x) * (va - y) - (vc - y) * (ua - x)) / area
                wc = 1.0 - wa - wb
                if wa < 0.0 or wb < 0.0 or wc < 0.0:
                    continue
                z = wa * places[a, 2] + wb * places[b, 2] + wc * places[c, 2]
                if z >= depth[v, u]:
                    continue
                depth[v, u] = z
                i = wa * towards[a, 0] + wb * towards[b, 0] + wc * towards[c, 0]
                j = wa * towards[a, 1] + wb * towards[b, 1] + wc * towards[c, 1]
                k = wa * towards[a, 2] + wb * towards[b, 2] + wc * towards[c, 2]
                size = np.sqrt(i * i + j * j + k * k)
                turned = side / size if size > 0.0 else 0.0
                share = 0.5 + 0.5 * turned * (i * light[0] + j * light[1] + k * light[2])
                for channel in range(3):
                    image[v, u, channel] = lit(colours[t, channel], bright * share)


@kernel
def fill_sphere(place, radius, scale, colour, light, image, depth):
    """Draw a sphere with its centre at a place (3,) in pixels and depth, its radius in m, `scale` in pixels per m."""
    height, width = depth.shape
    size = radius * scale
    low_u, high_u = max(int(np.floor(place[0] - size)), 0), min(int(np.ceil(place[0] + size)), width - 1)
    low_v, high_v = max(int(np.floor(place[1] - size)), 0), min(int(np.ceil(place[1] + size)), height - 1)
    for v in range(low_v, high_v + 1):
        for u in range(low_u, high_u + 1):
            i, j = (u + 0.5 - place[0]) / size, (place[1] - v - 0.5) / size
            rest = 1.0 - i * i - j * j
            if rest < 0.0:
                continue
            z = place[2] - radius * np.sqrt(rest)
            if z < depth[v, u]:
                depth[v, u] = z
                share = 0.5 + 0.5 * (i * light[0] + j * light[1] - np.sqrt(rest) * light[2])
                for channel in range(3):
                    image[v, u, channel] = lit(colour[channel], share)
