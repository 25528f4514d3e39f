"""The parts of `clothfit estimate`.

files (what is fitted to what, what is read and written) → checkpoints and recording (what is kept on the way) →
outcomes (what is said of the result, and its page); plan and many are for several scenes.
"""
