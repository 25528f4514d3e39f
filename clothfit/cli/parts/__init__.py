"""The parts of single commands, each named after its command.

checkpoints serve both `estimate` and `control`. Of `estimate`: files (what is fitted to what, what is read and written)
→ records (log and pictures) → results (what is said of a fit, and its page); many is for several scenes.
To add an option of `new`: a field of `new_options.Asked`, its declaration and what it does in `cli/new.py`.
To add a kind of file to `info`: its name in the table of files, two functions in `info_records`.
"""
