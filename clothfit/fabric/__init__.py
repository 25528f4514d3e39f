"""What a cloth is made of, per area and per width, independent of its mesh.

hinges (the mesh: directions, edges, hinges) → membrane (stretch and shear) and bending, with balance (least squares) →
fabric (of a cloth, and the springs of a fabric on a mesh) → presets (real fabrics, with sources).
To add a real fabric: an entry in presets.json, each number with its source.
"""
