"""Long work beside what is played, in a process of its own each, that nothing has to wait for.

searches (recording a target, fits, forces through keys) and opening (a scene that is loaded) say what is done; worker
is the process that does it; task is what starts the process and hears it. To add one: its function, and a row in
`TASKS` of `worker`.
"""
