"""A cloth that moves while it is watched: an engine in a thread, a page that shows it, and what other programs ask.

moving (one cloth, step by step) → changes (new values while it moves) → engine (a thread with the last frame) → task,
worker (a fit, or a scene that is loaded, in a process of its own) → session (a scene that is played and fitted) →
commands (what a message does) → server (HTTP and the WebSocket); client asks a server from Python. `wire` is the format
of frames, `web/` the page. To add a message: its function in `commands`, a row in docs/serve.md.
"""
