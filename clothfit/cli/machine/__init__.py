"""The commands that are about this machine and no scene.

completion (what a shell needs to complete commands) and warmup (compiling all kernels once, before they are needed).
`cli.program` names the commands that are here.
"""
