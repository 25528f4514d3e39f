"""Contact of a cloth with itself: vertices against triangles, edges against edges.

In this order: `nearest` (the closest points of a pair, and how they move), `rows` (pairs that are known, for `contact`,
which has their forces), `pairs` (which pairs are near, found by trees of boxes, and which would pass through each other
within a step) and `zones` (what moves together where forces do not suffice). Their blocks in the step's matrix are in
`solve.sparse`. A step looks for its pairs in `engine.contact_steps`, which keeps them for the derivatives.
"""
