"""What every folder may use and nothing of which knows about cloth: errors, messages, arrays, limits, memory, files.

errors and messages say what went wrong; arrays, limits and memory are about sizes; reading, writing and npz open files
safely; interrupts and threads are about the process; eigen is dense linear algebra; version is the
program's.
To add something: it belongs here only if two folders above need it and it imports nothing of the package but this
folder.
"""
