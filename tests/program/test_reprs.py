"""What a prompt shows of the records: one short line of sizes and units, never arrays."""

import numpy as np
from helpers.scenes import even

from clothfit import Fit, as_motion, load, mesh
from clothfit.evaluation.evaluate import Distance, Evaluation

LONGEST = 160
"""Characters of a line that a window shows without scrolling, or nearly."""


def test_each_is_one_line_of_sizes_and_errors_without_arrays():
    scene = load(even("GL", 6, 3, 3))
    positions, seen = np.zeros((6, 9, 3)), np.arange(54).reshape(6, 9) % 9 < 3
    shown = {
        "9 vertices, 16 springs, 6 frames of 0.02 s, implicit, 17 values to fit": scene,
        "<Cloth: 9 vertices, 16 springs, 8 triangles, 0.18 kg": scene.cloths[0],
        "6 frames of 9 vertices in m, 0 … 0.1 s>": as_motion(scene, positions),
        "0.333 of them observed": as_motion(scene, positions, observed=seen),
        " triangles, 1 × 0 × 0.5 m>": mesh.plane(60, 1.0, 0.5),
        "converged, RMSE 12.3 mm over 6 frames, 0 values, 4 evaluations in 0.5 s>":
            Fit(scene, "converged", "auto", 1.0, 0.0123, 6, 4, 0.5, [], []),
        "diverged, cost inf": Fit(scene, "diverged", "auto", np.inf, np.inf, 6, 4, 0.5, [], []),
        "RMSE 1 nm over 6 frames, 2 mm over 500 frames>": Evaluation(Distance(6, 1e-9, 0), Distance(500, 2e-3, 1), []),
    }
    for words, each in shown.items():
        text = repr(each)
        assert words in text
        assert len(text) <= LONGEST
        assert not set("\n[") & set(text)
