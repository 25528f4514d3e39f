"""The scene: JSON → text → schema → array checks → Scene → blocks of parameters → the vector that a fit changes.

kinds is the table of all parameters. text, schema and array_checks read and check; cloth and scene hold the result;
splice writes changed numbers back into the text. keys are values at times, which wind, gravity, pins, colliders and the
axes follow; forces are applied to vertices, and come with a simulation. cloth also says, as directions
do, how it is woven, families which springs share a value. block and fit_vector turn flagged parameters into one vector.
To add what keys can move: a field in keys or in the schema, and its table in `engine/inputs`.
To add a kind of parameter: see the page of `engine/forces`.
"""
