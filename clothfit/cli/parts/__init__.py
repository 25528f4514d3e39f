"""The longer parts of single commands, each named after its command.

checkpoints serve both `estimate` and `control`. Of `estimate`: files (what is fitted to what, what is read and written)
→ results (what is said of a fit, its log and its page); many is for several scenes, simulator for other tools.
To add a kind of file to `info`: its name in the table of files, two functions in `info_records`.
"""
