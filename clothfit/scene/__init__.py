"""The scene: JSON → text → schema → array checks → Scene → blocks of parameters → the vector that a fit changes.

kinds is the table of all parameters. text, schema, conforms and array_checks read and check; cloth and scene hold the
result; splice writes changed numbers back into the text; block and fit_vector turn flagged parameters into one vector.
To add a kind of parameter: see the page of `engine/forces`.
"""
