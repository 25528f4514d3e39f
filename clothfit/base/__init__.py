"""What every folder may use and that knows nothing of cloth: errors, messages, arrays, limits, memory, files.

errors and messages say what went wrong; arrays, limits and memory are about sizes; reading, writing and npz are the
only places where files are opened; interrupts and threads are about the process.
To add something: it belongs here only if two folders above need it and it imports nothing of the package but this
folder.
"""
