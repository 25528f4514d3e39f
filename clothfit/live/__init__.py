"""A cloth that moves while it is watched: an engine in a thread, a page that shows it, and what other programs ask.

moving (one cloth, step by step) → changes (new values while it moves) → engine (a thread with the last frame) →
fitting (a fit in a process of its own) → session (what a message does) → server (HTTP and the WebSocket); client asks a
server from Python. `wire` is the format of frames, `web/` the page. To add a message: its function in `session`, a row
in docs/serve.md.
"""
